"""Numbers of statistics in sentences and cells: significant digits, p-values, intervals, units."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from robot_runner.core import words

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.tested import Interval

#: Stands where a value is missing.
MISSING = "\N{EN DASH}"
MINUS = "\N{MINUS SIGN}"
TIMES = "\N{MULTIPLICATION SIGN}"
ALPHA = "\N{GREEK SMALL LETTER ALPHA}"
RHO = "\N{GREEK SMALL LETTER RHO}"
#: What differs between findings of one kind: the processes in brackets that disturbed a run, and numbers.
_VARYING = re.compile(r"\([^()]*, pid \d+[^()]*\)|\d+(?:[.,]\d+)*")
_SMALLEST_P = 0.001
#: Usual levels of significance: no p-value is rounded to one, so that it is seen on which side it lies.
_LEVELS = (0.1, 0.05, 0.01, 0.005)
_P_DIGITS, _STATISTIC_DIGITS, _MOST_DIGITS = 3, 3, 17
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
    if isinstance(value, int):
        text = f"{value:,}"  # and not as a float, which has 53 bits
    elif _LARGE <= abs(value) < _HUGE:
        text = f"{value:,.0f}"
    elif abs(value) < _SMALL or abs(value) >= _HUGE:
        text = f"{value:.{digits - 1}e}"
    else:
        text = f"{value:#.{digits}g}".rstrip(".")
        text = f"{value:,.0f}" if "e" in text and abs(value) > 1 else text  # it was rounded up to where exponents begin
    return text.replace("-", MINUS, 1) if text.startswith("-") else text


def labelled(name: str, unit: str) -> str:
    """Return a name with its unit, as in `Energy (J)`; a name that ends in it, as imported headings do, is left."""
    has_it = unit in {"", "1"} or name.endswith((f"({unit})", f"[{unit}]"))
    return name if has_it else f"{name} ({unit})"


def kind_of(problem: str, run_id: str) -> str:
    """Return what a finding has in common with those of its kind about other runs, which are told together.

    Example:
        >>> kind_of("12 samples were lost during slow_a", "slow_a")
        '# samples were lost during #'
    """
    return _VARYING.sub("#", problem.replace(run_id, "#"))


def with_unit(value: float | None, unit: str, digits: int = _DIGITS) -> str:
    """Return a number with its unit, as in `877.1 J`."""
    number = shown_number(value, digits)
    return f"{number} {unit}" if unit not in {"", "1"} and number != MISSING else number


def shown_level(level: float) -> str:
    """Return a level of confidence or a power in percent, not rounded: 99.9 % is not certain.

    Example:
        >>> shown_level(0.95), shown_level(1 - 0.001)
        ('95%', '99.9%')
    """
    return f"{100 * level:g}%"


def difference_unit(unit: str) -> str:
    """Return the unit of a difference: that of percentages is not a percentage of anything."""
    return "percentage points" if unit == "%" else unit


def shown_p(p_value: float | None) -> str:
    """Return a p-value as papers print it, in more digits where it is close to a usual level of significance.

    Example:
        >>> shown_p(0.0002), shown_p(0.04321), shown_p(0.0496)
        ('< 0.001', '0.043', '0.0496')
    """
    if p_value is None or not math.isfinite(p_value):
        return MISSING
    if p_value < _SMALLEST_P:
        return f"< {_SMALLEST_P}"
    texts = (f"{p_value:.{digits}f}" for digits in range(_P_DIGITS, _MOST_DIGITS + 1))
    return next((text for text in texts if p_value in _LEVELS or float(text) not in _LEVELS), repr(p_value))


def p_in_words(p_value: float) -> str:
    """Return a p-value as it stands in a sentence.

    Example:
        >>> p_in_words(0.0159), p_in_words(2e-16)
        ('p = 0.016', 'p < 0.001')
    """
    return f"p {'' if p_value < _SMALLEST_P else '= '}{shown_p(p_value)}"


def p_values_in_words(p_value: float, adjusted: float | None) -> str:
    """Return a p-value as it stands in a sentence, with that after correction where it is another.

    Example:
        >>> p_values_in_words(0.0159, 0.0318), p_values_in_words(0.3, 0.3)
        ('p = 0.016, p = 0.032 after correction', 'p = 0.300')
    """
    if adjusted is None or adjusted == p_value:
        return p_in_words(p_value)
    return f"{p_in_words(p_value)}, {p_in_words(adjusted)} after correction"


def shown_test(name: str, freedom: Iterable[float], statistic: float | None) -> str:
    """Return a statistic with its degrees of freedom, as papers print it; zeros at its end are digits, too.

    Example:
        >>> shown_test("F", (2, 11.8642), 6.6), shown_test("t", (8,), 1830.2)
        ('F(2, 11.86) = 6.60', 't(8) = 1,830')
    """
    degrees = ", ".join(f"{each:.0f}" if float(each).is_integer() else f"{each:.2f}" for each in freedom)
    return f"{name}({degrees}) = {shown_number(statistic, _STATISTIC_DIGITS)}"


def shown_coefficient(value: float | None) -> str:
    """Return a correlation or an effect size; what is less than 1 is not rounded to it.

    Example:
        >>> [shown_coefficient(each) for each in (0.5, 0.9944, 0.9996, 0.99996, 1.0, 12.34)]
        ['0.500', '0.994', '0.9996', '0.99996', '1.00', '12.3']
    """
    texts = (shown_number(value, digits) for digits in range(_STATISTIC_DIGITS, _MOST_DIGITS + 1))
    return next(text for text in texts if value is None or abs(value) >= 1 or text.lstrip(MINUS).rstrip("0") != "1.")


def shown_share(share: float) -> str:
    """Return a share in percent; what is less than all of it is not rounded to 100%.

    Example:
        >>> [shown_share(each) for each in (0.94, 0.9999996, 1.0)]
        ['94%', '99.99996%', '100%']
    """
    texts = (f"{100 * share:.{digits}g}%" for digits in range(_STATISTIC_DIGITS, _MOST_DIGITS + 1))
    return next(text for text in texts if share >= 1 or text != "100%")


def shown_interval(interval: Interval | None, shown: Callable[[float | None], str] = shown_number) -> str:
    """Return a confidence interval in brackets, as in `[1.2, 3.4]`, its ends as `shown` writes such numbers."""
    return MISSING if interval is None else f"[{shown(interval.low)}, {shown(interval.high)}]"


def about_intervals(intervals: Iterable[Interval | None], more: str = "") -> str:
    """Return a sentence on what a table has as CI, with a space behind it; nothing where it has none."""
    levels = dict.fromkeys(shown_level(each.level) for each in intervals if each is not None)
    return f"CI: {' or '.join(levels)} confidence interval{more}. " if levels else ""


def sentence(text: str) -> str:
    """Return a text that begins with a capital letter and ends with a full stop.

    Example:
        >>> sentence("the measure is not a number")
        'The measure is not a number.'
    """
    text = text.strip()
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith(('.', '!', '?')) else '.'}" if text else ""


def listed(names: Iterable[object], shown: int = 6) -> str:
    """Return names as a list that does not grow without end; a report has room for more than a terminal.

    Example:
        >>> listed("abc"), listed(range(9), shown=3)
        ('a, b, c', '0, 1, 2 and 6 more')
    """
    return words.listed(map(str, names), shown)
