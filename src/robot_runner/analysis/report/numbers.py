"""How numbers are put into words and cells."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from robot_runner.analysis.report.blocks import Cell, Column, Place, Tone

if TYPE_CHECKING:
    from collections.abc import Iterable

    from robot_runner.analysis.statistics.outcome import Interval

__all__ = [
    "ALPHA",
    "MINUS",
    "MISSING",
    "RHO",
    "TIMES",
    "interval_cells",
    "interval_columns",
    "listed",
    "number_cell",
    "p_cell",
    "sentence",
    "shown_duration",
    "shown_interval",
    "shown_number",
    "shown_p",
    "with_unit",
]

#: Stands where a value is missing.
MISSING = "\N{EN DASH}"
MINUS = "\N{MINUS SIGN}"
TIMES = "\N{MULTIPLICATION SIGN}"
ALPHA = "\N{GREEK SMALL LETTER ALPHA}"
RHO = "\N{GREEK SMALL LETTER RHO}"
_SMALLEST_P = 0.001
_DIGITS = 4
_LARGE, _SMALL, _HUGE = 1e4, 1e-4, 1e7


def shown_number(value: float | None, digits: int = _DIGITS) -> str:
    """Return a number in so many significant digits; whole parts are never rounded away.

    Example:
        >>> [shown_number(each) for each in (877.1234, 0.012346, 16, 123456.7)]
        ['877.1', '0.01235', '16', '123,457']
    """
    if value is None or not math.isfinite(value):
        return MISSING
    if value == 0:
        return "0"
    if isinstance(value, int) or (_LARGE <= abs(value) < _HUGE):
        text = f"{value:,.0f}"
    elif abs(value) < _SMALL or abs(value) >= _HUGE:
        text = f"{value:.{digits - 1}e}"
    else:
        text = f"{value:#.{digits}g}".rstrip(".")
        text = f"{value:,.0f}" if "e" in text and abs(value) > 1 else text  # it was rounded up to where exponents begin
    return text.replace("-", MINUS, 1) if text.startswith("-") else text


def with_unit(value: float | None, unit: str, digits: int = _DIGITS) -> str:
    """Return a number with its unit, as in `877.1 J`."""
    number = shown_number(value, digits)
    return f"{number} {unit}" if unit not in {"", "1"} and number != MISSING else number


def shown_p(p_value: float | None) -> str:
    """Return a p-value as papers print it.

    Example:
        >>> shown_p(0.0002), shown_p(0.04321)
        ('< 0.001', '0.043')
    """
    if p_value is None or not math.isfinite(p_value):
        return MISSING
    return "< 0.001" if p_value < _SMALLEST_P else f"{p_value:.3f}"


def shown_interval(interval: Interval | None, digits: int = _DIGITS) -> str:
    """Return a confidence interval in brackets, as in `[1.2, 3.4]`."""
    if interval is None:
        return MISSING
    return f"[{shown_number(interval.low, digits)}, {shown_number(interval.high, digits)}]"


def number_cell(value: float | None, digits: int = _DIGITS, tone: Tone = Tone.PLAIN) -> Cell:
    """Return a cell that holds a number."""
    return Cell(value, shown_number(value, digits), tone)


def interval_columns(name: str) -> tuple[Column, ...]:
    """Return the columns of a confidence interval: one for readers, and its ends for programs."""
    ends = (Column(f"{name}, {end}", is_number=True, place=Place.FILE) for end in ("low", "high"))
    return (Column(name, is_number=True, place=Place.PAGE), *ends)


def interval_cells(interval: Interval | None, digits: int = _DIGITS) -> tuple[Cell, ...]:
    """Return the cells of `interval_columns`."""
    low, high = (None, None) if interval is None else (interval.low, interval.high)
    return (Cell.of_text(shown_interval(interval, digits)), number_cell(low), number_cell(high))


def p_cell(p_value: float | None, *, is_significant: bool | None) -> Cell:
    """Return a cell that holds a p-value; one that is significant stands out."""
    return Cell(p_value, shown_p(p_value), Tone.GOOD if is_significant else Tone.PLAIN)


def sentence(text: str) -> str:
    """Return a text that begins with a capital letter and ends with a full stop.

    Example:
        >>> sentence("it is not a number")
        'It is not a number.'
    """
    text = text.strip()
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith(('.', '!', '?')) else '.'}" if text else ""


def listed(names: Iterable[Any], shown: int = 6) -> str:
    """Return names as a list that does not grow without end.

    Example:
        >>> listed("abc"), listed(range(9), shown=3)
        ('a, b, c', '0, 1, 2 and 6 more')
    """
    everything = [str(name) for name in names]
    if len(everything) <= shown + 1:
        return ", ".join(everything)
    return f"{', '.join(everything[:shown])} and {len(everything) - shown:,} more"


def shown_duration(seconds: float | None) -> str:
    """Return a duration as a person says it.

    Example:
        >>> [shown_duration(each) for each in (0.44, 3.44, 125, 3725, 200000)]
        ['0.44 s', '3.4 s', '2 min 05 s', '1 h 02 min', '2 d 7 h']
    """
    if seconds is None or not math.isfinite(seconds):
        return MISSING
    if seconds < 1:
        return f"{seconds:.2f} s"
    if seconds < 59.5:  # noqa: PLR2004 - rounds to a minute
        return f"{seconds:.1f} s" if seconds < 10 else f"{seconds:.0f} s"  # noqa: PLR2004 - a tenth says nothing beyond
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    days, hours = divmod(hours, 24)
    if days:
        return f"{days} d {hours} h"
    return f"{hours} h {minutes:02} min" if hours else f"{minutes} min {rest:02} s"
