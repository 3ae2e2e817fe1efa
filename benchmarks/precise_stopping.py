"""What an experiment that is repeated until it is precise claims: its intervals, and its tests, where it stopped."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from benchmarks.null_designs import DISTRIBUTIONS
from benchmarks.table import Row
from robot_runner.core.design.repeated_intervals import CONFIDENCE, level_at_each_look, t_quantile

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

__all__ = ["precise_stopping"]

#: The first and the last look; and the first with which tests, too, hold their level.
_LEAST, _LEAST_FOR_TESTS, _MOST = 5, 10, 30
_ALPHA = 0.05
#: The bounds that are to hold, in percent; of the tests after few repetitions, that which the report tells.
_COVERED, _SIZE, _SIZE_OF_FEW = 94.5, (3.5, 6.5), (3.5, 8.0)
_SKEWED = "none: Student's t has none of skewed values, either"
#: The half widths that are wanted, in standard deviations: from one that 5 repetitions reach to one that 30 do not.
_WIDTHS = (1.5, 1.0, 0.8, 0.6, 0.5, 0.4)
_MEAN, _SHARE = 100.0, 0.02


def precise_stopping(random: np.random.Generator, count: int) -> Iterator[Row]:
    """Yield coverage of intervals and false positives of tests at the repetition where experiments stopped.

    Args:
        random: what values come from.
        count: experiments a row; each row is the worst of several wanted widths.
    """
    bound = f"{_COVERED} % and more"
    for name, draw in DISTRIBUTIONS.items():
        covered = [_mean_covered(draw(random, (count, _MOST)), wanted) for wanted in _WIDTHS]
        yield _worst(f"mean, {name}", covered, bound if name in {"normal", "uniform", "t5", "t3"} else _SKEWED)
    alone = [_mean_covered(random.standard_normal((count, _MOST)), wanted, CONFIDENCE) for wanted in _WIDTHS]
    yield _worst("mean, normal, by Student's t at each look", alone, "less: why it is not used")
    for spreads in ((1, 1), (1, 3)):
        drawn = [_relative(random, count, spreads, wanted) for wanted in _WIDTHS]
        covered = [_difference_covered(values, wanted) for values, wanted in drawn]
        yield _worst(f"difference, spreads {spreads[0]} : {spreads[1]}", covered, bound)
    for least in (_LEAST, _LEAST_FOR_TESTS):
        for spreads in ((1, 1), (1, 3), (1, 10)):
            drawn = [_relative(random, count, spreads, wanted) for wanted in _WIDTHS]
            for of in ("means", "differences"):
                yield _sized(least, spreads, of, [_size(values, wanted, of, least) for values, wanted in drawn])


def _worst(what: str, covered: Sequence[float], expected: str) -> Row:
    worst = min(covered)
    held = "holds" if worst >= _COVERED else "misses"
    return Row(f"interval of a {what}", f"{worst:.1f} %", expected, held if expected[0].isdigit() else "")


def _sized(least: int, spreads: tuple[int, int], of: str, sizes: Sequence[float]) -> Row:
    what = f"Welch's test, {of} precise, spreads {spreads[0]} : {spreads[1]}, {least} and more"
    lowest, highest = _SIZE if least == _LEAST_FOR_TESTS or spreads == (1, 1) else _SIZE_OF_FEW
    held = "holds" if lowest <= min(sizes) and max(sizes) <= highest else "misses"
    return Row(what, f"{min(sizes):.1f} to {max(sizes):.1f} %", f"{lowest} to {highest} %", held)


def _looks(values: Floats, level: float, least: int = _LEAST) -> tuple[Floats, Floats]:
    """Return the mean and half the width of its interval at each look, of experiments in rows."""
    n = np.arange(1, _MOST + 1)
    mean = values.cumsum(axis=1) / n
    squares = np.maximum((values**2).cumsum(axis=1) - n * mean**2, 0)
    mean, squares, n = mean[:, least - 1 :], squares[:, least - 1 :], n[least - 1 :]
    quantile = np.array([t_quantile(0.5 + level / 2, int(each) - 1) for each in n])
    return mean, quantile * np.sqrt(squares / (n - 1) / n)


def _stops(is_precise: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return at which look each experiment stops: the first that is precise, or the last."""
    is_precise[:, -1] = True
    first: NDArray[np.intp] = np.argmax(is_precise, axis=1)
    return first


def _mean_covered(values: Floats, wanted: float, level: float | None = None) -> float:
    """Return how often, in percent, the interval holds the mean, which is 0; the standard deviation is 1."""
    mean, half_width = _looks(values, level or level_at_each_look(_LEAST, _MOST))
    stop, rows = _stops(half_width <= wanted), np.arange(len(values))
    return 100 * float((np.abs(mean[rows, stop]) <= half_width[rows, stop]).mean())


def _relative(random: np.random.Generator, count: int, spreads: tuple[int, int], wanted: float) -> tuple[Floats, float]:
    """Return two treatments without a difference, and the half width wanted of them: 2 % of the mean."""
    width = _SHARE * _MEAN
    scale = np.array(spreads)[:, None, None] * width / wanted / max(spreads)
    return _MEAN + scale * random.standard_normal((2, count, _MOST)), width


def _difference_stops(values: Floats, wanted: float, least: int = _LEAST) -> tuple[Floats, Floats, NDArray[np.intp]]:
    mean, half_width = _looks(values[0] - values[1], level_at_each_look(least, _MOST), least)
    whole, _ = _looks((values[0] + values[1]) / 2, CONFIDENCE, least)
    return mean, half_width, _stops(half_width <= np.abs(whole) * wanted / _MEAN)


def _difference_covered(values: Floats, wanted: float) -> float:
    mean, half_width, stop = _difference_stops(values, wanted)
    rows = np.arange(len(stop))
    return 100 * float((np.abs(mean[rows, stop]) <= half_width[rows, stop]).mean())


def _size(values: Floats, wanted: float, of: str, least: int) -> float:
    """Return how often, in percent, Welch's test finds a difference where experiments stopped."""
    if of == "means":
        looks = [_looks(each, level_at_each_look(least, _MOST), least) for each in values]
        precise = [half_width <= np.abs(mean) * wanted / _MEAN for mean, half_width in looks]
        stop = _stops(np.logical_and(*precise))
    else:
        stop = _difference_stops(values, wanted, least)[2]
    found = 0
    for look in np.unique(stop):
        here = values[:, stop == look, : least + look]
        found += int((stats.ttest_ind(here[0], here[1], axis=1, equal_var=False).pvalue < _ALPHA).sum())
    return 100 * found / len(stop)
