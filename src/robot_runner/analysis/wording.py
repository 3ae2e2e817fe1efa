"""Numbers of statistics in sentences and cells: significant digits, p-values, intervals, units."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from robot_runner.core import words

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.tested import Interval

#: Shown in the place of a missing value.
MISSING = "\N{EN DASH}"
MINUS = "\N{MINUS SIGN}"
TIMES = "\N{MULTIPLICATION SIGN}"
ALPHA = "\N{GREEK SMALL LETTER ALPHA}"
RHO = "\N{GREEK SMALL LETTER RHO}"
#: The parts that differ between findings of one kind: processes in brackets that disturbed a run, and numbers.
_VARYING = re.compile(r"\([^()]*, pid \d+[^()]*\)|\d+(?:[.,]\d+)*")
_SMALLEST_P = 0.001
#: Usual levels of significance: a p-value is never rounded to one of them, so that readers see on which side it lies.
_LEVELS = (0.1, 0.05, 0.01, 0.005)
_P_DIGITS, _STATISTIC_DIGITS, _MOST_DIGITS = 3, 3, 17
#: Numbers that differ by less of themselves are equal but for rounding.
_ROUNDING = 1e-12
_DIGITS = 4
_LARGE, _SMALL, _HUGE = 1e4, 1e-4, 1e7
_RAISED = str.maketrans("0123456789-", "⁰¹²³⁴⁵⁶⁷⁸⁹⁻")


def shown_number(value: float | None, digits: int = _DIGITS) -> str:
    """Return a number with so many significant digits, as journals print it: from ten million on with a power of ten.

    Below that, all digits before the decimal point are kept; those of a whole number (int) always are.

    Example:
        >>> [shown_number(each) for each in (877.1234, 0.012346, 16, 123456.7)]
        ['877.1', '0.01235', '16', '123,457']
        >>> shown_number(1006000000.0) == f"1.006{TIMES}10⁹"
        True
    """
    if value is None or not math.isfinite(value):
        return MISSING
    if value == 0:
        return "0"
    if isinstance(value, int):
        text = f"{value:,}"  # a float would have 53 bits
    elif _LARGE <= abs(value) < _HUGE:
        text = f"{value:,.{max(0, digits - len(f'{abs(value):.0f}'))}f}"
    elif abs(value) < _SMALL or abs(value) >= _HUGE:
        mantissa, _, power = f"{value:.{digits - 1}e}".partition("e")
        text = f"{mantissa}{TIMES}10{str(int(power)).translate(_RAISED)}"
    else:
        text = f"{value:#.{digits}g}".rstrip(".")
        text = f"{value:,.0f}" if "e" in text and abs(value) > 1 else text  # rounding up made an exponent
    return text.replace("-", MINUS, 1) if text.startswith("-") else text


def digits_beside(value: float | None, spread: float | None) -> int:
    """Return how many significant digits a value needs, so that it shows two digits of its spread; four at least.

    A spread that is nothing but rounding counts as none.

    Example:
        >>> digits_beside(3.45238, 0.0001476), digits_beside(877.1, 4.7), digits_beside(5.1, 9e-16)
        (6, 4, 4)
    """
    if not value or not spread or spread <= _ROUNDING * abs(value):
        return _DIGITS
    return max(_DIGITS, _exponent(value) - _exponent(spread) + 2)


def _exponent(value: float) -> int:
    """Return the power of ten of a number's first digit, once it is rounded to two."""
    return int(f"{value:.1e}".partition("e")[2])


def labelled(name: str, unit: str) -> str:
    """Return a name with its unit, as in `Energy (J)`; a name that ends in the unit, as imported ones do, is kept."""
    has_it = unit in {"", "1"} or name.endswith((f"({unit})", f"[{unit}]"))
    return name if has_it else f"{name} ({unit})"


def kind_of(problem: str, run_id: str) -> str:
    """Return a finding without its numbers, processes and run id, so that similar findings can be grouped.

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
    """Return a level of confidence or a power in percent, without rounding 99.9 % to 100 %.

    Example:
        >>> shown_level(0.95), shown_level(1 - 0.001)
        ('95%', '99.9%')
    """
    return f"{100 * level:g}%"


def difference_unit(unit: str) -> str:
    """Return the unit of a difference: a difference of percentages is in percentage points."""
    return "percentage points" if unit == "%" else unit


def shown_p(p_value: float | None) -> str:
    """Return a p-value as papers print it, with more digits where it is close to a usual level of significance.

    Example:
        >>> shown_p(0.0002), shown_p(0.04321), shown_p(0.0496)
        ('< 0.001', '0.043', '0.0496')
    """
    if p_value is None or not math.isfinite(p_value):
        return MISSING
    if p_value < _SMALLEST_P:
        return f"< {_SMALLEST_P}"
    is_level = any(math.isclose(p_value, level, rel_tol=_ROUNDING) for level in _LEVELS)
    texts = (f"{p_value:.{digits}f}" for digits in range(_P_DIGITS, _MOST_DIGITS + 1))
    return next((text for text in texts if is_level or float(text) not in _LEVELS), repr(p_value))


def p_in_words(p_value: float) -> str:
    """Return a p-value for a sentence.

    Example:
        >>> p_in_words(0.0159), p_in_words(2e-16)
        ('p = 0.016', 'p < 0.001')
    """
    return f"p {'' if p_value < _SMALLEST_P else '= '}{shown_p(p_value)}"


def p_values_in_words(p_value: float, adjusted: float | None) -> str:
    """Return a p-value for a sentence, with the corrected one where they differ.

    Example:
        >>> p_values_in_words(0.0159, 0.0318), p_values_in_words(0.3, 0.3)
        ('p = 0.016, p = 0.032 after correction', 'p = 0.300')
    """
    if adjusted is None or adjusted == p_value:
        return p_in_words(p_value)
    return f"{p_in_words(p_value)}, {p_in_words(adjusted)} after correction"


def shown_test(name: str, freedom: Iterable[float], statistic: float | None) -> str:
    """Return a statistic with its degrees of freedom, as papers print it; trailing zeros are kept.

    Example:
        >>> shown_test("F", (2, 11.8642), 6.6), shown_test("t", (8 * (1 + 1e-15),), 1830.2)
        ('F(2, 11.86) = 6.60', 't(8) = 1,830')
    """
    degrees = ", ".join(f"{each:.0f}" if float(f"{each:.12g}").is_integer() else f"{each:.2f}" for each in freedom)
    return f"{name}({degrees}) = {shown_number(statistic, _STATISTIC_DIGITS)}"


def shown_coefficient(value: float | None) -> str:
    """Return a correlation or an effect size; a value below 1 is never rounded to 1.

    Example:
        >>> [shown_coefficient(each) for each in (0.5, 0.9944, 0.9996, 0.99996, 1.0, 12.34)]
        ['0.500', '0.994', '0.9996', '0.99996', '1.00', '12.3']
    """
    texts = (shown_number(value, digits) for digits in range(_STATISTIC_DIGITS, _MOST_DIGITS + 1))
    return next(text for text in texts if value is None or abs(value) >= 1 or text.lstrip(MINUS).rstrip("0") != "1.")


def shown_share(share: float) -> str:
    """Return a share in percent; a share below 1 is never rounded to 100%.

    Example:
        >>> [shown_share(each) for each in (0.94, 0.9999996, 1.0)]
        ['94%', '99.99996%', '100%']
    """
    texts = (f"{100 * share:.{digits}g}%" for digits in range(_STATISTIC_DIGITS, _MOST_DIGITS + 1))
    return next(text for text in texts if share >= 1 or text != "100%")


def shown_interval(interval: Interval | None, shown: Callable[[float | None], str] = shown_number) -> str:
    """Return a confidence interval in brackets, as in `[1.2, 3.4]`, its ends formatted by `shown`."""
    return MISSING if interval is None else f"[{shown(interval.low)}, {shown(interval.high)}]"


def about_intervals(intervals: Iterable[Interval | None], more: str = "") -> str:
    """Return a sentence that says what CI means in a table, with a trailing space; empty without intervals."""
    levels = dict.fromkeys(shown_level(each.level) for each in intervals if each is not None)
    return f"CI: {' or '.join(levels)} confidence interval{more}. " if levels else ""


def sentence(text: str) -> str:
    """Return a text with a capital letter in front and a full stop at its end.

    Example:
        >>> sentence("the measure is not a number")
        'The measure is not a number.'
    """
    text = text.strip()
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith(('.', '!', '?')) else '.'}" if text else ""


def listed(names: Iterable[object], shown: int = 6) -> str:
    """Return the first names as a list, and how many more there are; a report has room for more than a terminal.

    Example:
        >>> listed("abc"), listed(range(9), shown=3)
        ('a, b, c', '0, 1, 2 and 6 more')
    """
    return words.listed(map(str, names), shown)
