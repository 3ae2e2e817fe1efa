"""What an experiment that is repeated until it is precise claims: its intervals, and its tests, where it stopped."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from benchmarks.null_designs import DISTRIBUTIONS
from benchmarks.table import Row
from robot_runner.core.design.precise_estimates import LOOKS_IN_A_ROW
from robot_runner.core.design.repeated_intervals import CONFIDENCE, level_at_each_look, t_quantile

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

__all__ = ["precise_stopping"]

#: Repetitions at the first look, from as few as are accepted, and at the last.
_LEASTS, _MOST = (3, 5, 10), 30
#: What a test is used at, in a row beside the looks that the rule asks for: the first precise look is the last.
_ONE_LOOK = 1
_ALPHA = 0.05
#: The bounds that are to hold, in percent.
_COVERED, _SIZE = 94.5, (3.5, 6.5)
_SKEWED = "none: Student's t has none of skewed values, either"
_HELD = {"normal", "uniform", "t5", "t3"}
#: The half widths that are wanted, in standard deviations: from one that 5 repetitions reach to one that 30 do not.
_WIDTHS = (1.5, 1.0, 0.8, 0.6, 0.5, 0.4)
#: The one that runs are counted for.
_COUNTED = 0.6
_MEAN, _SHARE = 100.0, 0.02


def precise_stopping(random: np.random.Generator, count: int) -> Iterator[Row]:
    """Yield coverage of intervals, false positives of tests and numbers of runs where experiments stopped.

    Args:
        random: what values come from.
        count: experiments a row; each row is the worst of several wanted widths.
    """
    for name, draw in DISTRIBUTIONS.items():
        values = draw(random, (count, _MOST))
        for least in _LEASTS:
            yield _mean_row(name, values, least)
    normal = random.standard_normal((count, _MOST))
    alone = [_mean_covered(normal, wanted, 5, CONFIDENCE, _ONE_LOOK)[0] for wanted in _WIDTHS]
    yield _worst("mean, normal, 5 and more, by Student's t at each look", alone, "less: why it is not used")
    for spreads in ((1, 1), (1, 3), (1, 10)):
        drawn = [_relative(random, count, spreads, wanted) for wanted in _WIDTHS]
        for least in _LEASTS:
            yield from _rows_of_two(drawn, spreads, least)


def _mean_row(name: str, values: Floats, least: int) -> Row:
    """Return how often intervals of a mean hold it, with how many runs, beside those where the spread is known."""
    level = level_at_each_look(least, _MOST)
    found = {wanted: _mean_covered(values, wanted, least, level) for wanted in _WIDTHS}
    row = _worst(
        f"mean, {name}, {least} and more",
        [covered for covered, _ in found.values()],
        f"{_COVERED} % and more" if name in _HELD else _SKEWED,
    )
    oracle = (stats.norm.ppf(0.5 + CONFIDENCE / 2) / _COUNTED) ** 2
    runs = f"{found[_COUNTED][1]:.1f} runs to {_COUNTED} sd ({max(least, math.ceil(oracle))} of a known spread)"
    return row._replace(bound=runs)


def _rows_of_two(drawn: Sequence[tuple[Floats, float]], spreads: tuple[int, int], least: int) -> Iterator[Row]:
    """Yield how often intervals of a difference hold it, and how often Welch's test finds one, of two treatments."""
    what = f"spreads {spreads[0]} : {spreads[1]}, {least} and more"
    covered = [_difference_covered(values, wanted, least) for values, wanted in drawn]
    yield _worst(f"difference, {what}", covered, f"{_COVERED} % and more")
    for of in ("means", "differences"):
        yield _sized(f"Welch's test, {of} precise, {what}", [_size(*each, of, least) for each in drawn])
    early = [_size(*each, "means", least, _ONE_LOOK) for each in drawn]
    told = _sized(f"the same where the first precise look is the last, {what}", early)
    yield told._replace(floor="more: why it is not the last", ratio="")


def _worst(what: str, covered: Sequence[float], expected: str) -> Row:
    worst = min(covered)
    held = "holds" if worst >= _COVERED else "misses"
    return Row(f"interval of a {what}", f"{worst:.1f} %", expected, held if expected[0].isdigit() else "")


def _sized(what: str, sizes: Sequence[float]) -> Row:
    lowest, highest = _SIZE
    held = "holds" if lowest <= min(sizes) and max(sizes) <= highest else "misses"
    return Row(what, f"{min(sizes):.1f} to {max(sizes):.1f} %", f"{lowest} to {highest} %", held)


def _looks(values: Floats, level: float, least: int) -> tuple[Floats, Floats]:
    """Return the mean and half the width of its interval at each look, of experiments in rows."""
    n = np.arange(1, _MOST + 1)
    mean = values.cumsum(axis=1) / n
    squares = np.maximum((values**2).cumsum(axis=1) - n * mean**2, 0)
    mean, squares, n = mean[:, least - 1 :], squares[:, least - 1 :], n[least - 1 :]
    quantile = np.array([t_quantile(0.5 + level / 2, int(each) - 1) for each in n])
    return mean, quantile * np.sqrt(squares / (n - 1) / n)


def _stops(is_precise: NDArray[np.bool_], in_a_row: int = LOOKS_IN_A_ROW) -> NDArray[np.intp]:
    """Return at which look each experiment stops: the first that is precise, as those before it, or the last."""
    settled = is_precise.copy()
    for before in range(1, in_a_row):
        settled[:, before:] &= is_precise[:, :-before]
        settled[:, :before] = False
    settled[:, -1] = True
    first: NDArray[np.intp] = np.argmax(settled, axis=1)
    return first


def _mean_covered(
    values: Floats, wanted: float, least: int, level: float, in_a_row: int = LOOKS_IN_A_ROW
) -> tuple[float, float]:
    """Return how often, in percent, the interval holds the mean, which is 0, and after how many runs.

    The standard deviation is 1.
    """
    mean, half_width = _looks(values, level, least)
    stop, rows = _stops(half_width <= wanted, in_a_row), np.arange(len(values))
    return 100 * float((np.abs(mean[rows, stop]) <= half_width[rows, stop]).mean()), least + float(stop.mean())


def _relative(random: np.random.Generator, count: int, spreads: tuple[int, int], wanted: float) -> tuple[Floats, float]:
    """Return two treatments without a difference, and the half width wanted of them: 2 % of the mean."""
    width = _SHARE * _MEAN
    scale = np.array(spreads)[:, None, None] * width / wanted / max(spreads)
    return _MEAN + scale * random.standard_normal((2, count, _MOST)), width


def _differences(values: Floats, wanted: float, least: int) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return the differences and half the widths of their intervals at each look, and which are precise."""
    mean, half_width = _looks(values[0] - values[1], level_at_each_look(least, _MOST), least)
    whole, _ = _looks((values[0] + values[1]) / 2, CONFIDENCE, least)
    return mean, half_width, half_width <= np.abs(whole) * wanted / _MEAN


def _difference_covered(values: Floats, wanted: float, least: int) -> float:
    mean, half_width, is_precise = _differences(values, wanted, least)
    stop, rows = _stops(is_precise), np.arange(len(mean))
    return 100 * float((np.abs(mean[rows, stop]) <= half_width[rows, stop]).mean())


def _size(values: Floats, wanted: float, of: str, least: int, in_a_row: int = LOOKS_IN_A_ROW) -> float:
    """Return how often, in percent, Welch's test finds a difference where experiments stopped."""
    if of == "means":
        looks = [_looks(each, level_at_each_look(least, _MOST), least) for each in values]
        is_precise = np.logical_and(*(half_width <= np.abs(mean) * wanted / _MEAN for mean, half_width in looks))
    else:
        is_precise = _differences(values, wanted, least)[2]
    stop = _stops(is_precise, in_a_row)
    found = 0
    for look in np.unique(stop):
        here = values[:, stop == look, : least + look]
        found += int((stats.ttest_ind(here[0], here[1], axis=1, equal_var=False).pvalue < _ALPHA).sum())
    return 100 * found / len(stop)
