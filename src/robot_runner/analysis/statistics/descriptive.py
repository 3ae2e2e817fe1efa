"""Descriptive statistics: n, mean, standard deviation, quartiles, confidence interval of the mean, outliers."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import stats

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.statistics.outcome import Description, Outlier
from robot_runner.analysis.statistics.tested import Interval
from robot_runner.core.design.repeated_intervals import CONFIDENCE, METHOD, half_width_of

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.grouped_runs import Group


@contextmanager
def quiet() -> Iterator[None]:
    """Keep libraries from warning, of values that hardly vary say: what they cannot compute is no finite number."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        yield


#: The squared variances of larger values are beyond floating-point numbers; those of smaller ones vanish.
_LARGEST, _SMALLEST = 1e70, 1e-70

#: A bootstrap draws from so few values hardly more than their ends: its intervals would be far too narrow.
_LEAST_FOR_BOOTSTRAP = 5

#: How often a bootstrap draws; the error of an interval's end is then well below its width.
_RESAMPLES = 5000
#: Of many values each draw takes longer, and draws differ less.
_MANY = 200
_RESAMPLES_OF_MANY = 2000

#: Intervals are the same each time they are computed.
_SEED = 20210525

#: Tukey's fences (Tukey, Exploratory Data Analysis, 1977): interquartile ranges beyond the quartiles.
_FENCE = 1.5
_OUTER_FENCE = 3.0
#: Sums of few fractions differ by less, in steps of the last digit; whole numbers are as they were counted.
STEPS_OF_NOISE = 8
#: What computing with values may add to them, as a share of the largest: 45 units in the last place.
_UNITS_IN_LAST_PLACE = 1e-14

#: Fewer values have no spread to speak of.
_LEAST_FOR_SPREAD = 2
#: What means of units that are equal differ by once they were computed, of their size.
_ROUNDING = 1e-13
_T = "t distribution"
_LEAST_FOR_OUTLIERS = 4


def out_of_range(values: Floats) -> str:
    """Return why values cannot be computed with, as what a measure has; empty where they can."""
    largest = float(np.max(np.abs(values), initial=0.0))
    if largest > _LARGEST:
        return f"has values beyond {_LARGEST:g}, too large to compute with."
    if 0 < largest < _SMALLEST:
        return f"has no value above {_SMALLEST:g}: they are too small to compute with."
    return ""


def step_of(values: Floats) -> float:
    """Return how far apart neighbouring numbers are at the size of the largest value."""
    return float(np.spacing(np.max(np.abs(values))))


def are_equal(values: Floats) -> bool:
    """Return whether values are the same, but for what adding up leaves of fractions, such as 0.1 + 0.2.

    Example:
        >>> are_equal(np.array([0.1 + 0.2, 0.3])), are_equal(np.array([2.0**53, 2.0**53 + 2]))
        (True, False)
    """
    widest = float(np.ptp(values))
    return widest == 0 or (widest <= STEPS_OF_NOISE * step_of(values) and bool(np.any(values % 1)))


def describe(group: Group, *, level_of_looks: float | None = None) -> Description:
    """Describe the values of one group.

    Quartiles are interpolated linearly (type 7 of Hyndman and Fan 1996, as R and numpy do by default).

    Args:
        group: the runs.
        level_of_looks: the level of each interval, where runs were added until one was narrow; see `known_precision`.

    Example:
        >>> from robot_runner.analysis.statistics.grouped_runs import Group
        >>> describe(Group({"Task": "Video"}, np.array([1.0, 2.0, 3.0]), ("r_1", "r_2", "r_3"))).median
        2.0
    """
    values = group.values
    if not len(values):
        nothing: dict[str, Any] = dict.fromkeys(
            ("mean", "sd", "median", "first_quartile", "third_quartile", "minimum", "maximum", "mean_interval")
        )
        return Description(treatments=group.treatments, n=0, missing=group.missing, **nothing)
    first, median, third = (float(each) for each in np.quantile(values, [0.25, 0.5, 0.75]))
    is_flat = np.ptp(values) == 0  # a sum of equal values may be rounded, and then their mean and their spread are
    return Description(
        treatments=group.treatments,
        n=len(values),
        missing=group.missing,
        mean=float(median if is_flat else np.mean(values)),
        sd=(0.0 if is_flat else float(np.std(values, ddof=1))) if len(values) >= _LEAST_FOR_SPREAD else None,
        median=median,
        first_quartile=first,
        third_quartile=third,
        minimum=float(np.min(values)),
        maximum=float(np.max(values)),
        mean_interval=_mean_interval(group, level_of_looks),
        outliers=_outliers(group, first, third),
    )


def _mean_interval(group: Group, level_of_looks: float | None) -> Interval | None:
    """Return Student's interval; a bootstrap's is narrower than it claims (83 % at n = 5, normal or not).

    Where units have several runs of the group, what varies by chance is the units.
    """
    values = group.values
    if len(values) < _LEAST_FOR_SPREAD or np.ptp(values) == 0:
        return None
    if group.of_units is not None:
        return _interval_of_units(group, *group.of_units, level_of_looks)
    if level_of_looks is not None:
        mean, half_width = float(np.mean(values)), half_width_of(values.tolist(), level_of_looks)
        return Interval(mean - half_width, mean + half_width, CONFIDENCE, METHOD)
    low, high = stats.t.interval(CONFIDENCE, len(values) - 1, loc=np.mean(values), scale=stats.sem(values))
    return Interval(float(low), float(high), CONFIDENCE, _T)


def _interval_of_units(group: Group, variance: float, units: int, level_of_looks: float | None) -> Interval | None:
    """Return the interval of a mean, of units that vary as a whole; None where nothing tells how much they do."""
    mean, error = float(np.mean(group.values)), math.sqrt(variance)
    if units < _LEAST_FOR_SPREAD or error <= _ROUNDING * float(np.max(np.abs(group.values))):
        return None
    half_width = float(stats.t.isf((1 - (level_of_looks or CONFIDENCE)) / 2, units - 1)) * error
    method = _T if level_of_looks is None else METHOD
    return Interval(mean - half_width, mean + half_width, CONFIDENCE, f"{method}{group.in_words}")


def bootstrap_interval(values: Floats, statistic: Callable[..., Any], level: float) -> Interval | None:
    """Return a bootstrap confidence interval of a statistic: bias-corrected and accelerated (BCa), else by percentiles.

    Source: Efron and Tibshirani, An Introduction to the Bootstrap (1993), chapter 14.

    Args:
        values: what is drawn from.
        statistic: takes an array and `axis`.
        level: the confidence.

    Returns:
        None for fewer than five values, or where no draw differs from another.
    """
    if len(values) < _LEAST_FOR_BOOTSTRAP or np.ptp(values) == 0:
        return None
    for method in ("BCa", "percentile"):
        with quiet():  # a degenerate distribution: percentiles are tried next
            found = stats.bootstrap(
                (values,),
                statistic,
                n_resamples=_RESAMPLES if len(values) <= _MANY else _RESAMPLES_OF_MANY,
                confidence_level=level,
                method=method,
                vectorized=True,
                batch=500,
                rng=np.random.default_rng(_SEED),
            ).confidence_interval
        if np.isfinite(found.low) and np.isfinite(found.high) and found.low < found.high:
            return Interval(float(found.low), float(found.high), level, f"bootstrap ({method})")
    return None


def rounding_of(values: Floats) -> Any:
    """Return by how much values, shape (..., runs), may be off by rounding, shape (..., 1).

    One that is on a fence is not beyond it: in binary, 13.9 is not 12.7 + 1.5 (12.7 - 11.9).
    """
    return _UNITS_IN_LAST_PLACE * np.max(np.abs(values), axis=-1, keepdims=True)


def _outliers(group: Group, first: float, third: float) -> tuple[Outlier, ...]:
    if len(group.values) < _LEAST_FOR_OUTLIERS:
        return ()
    beyond = np.maximum(first - group.values, group.values - third) - rounding_of(group.values)
    width = third - first
    return tuple(
        Outlier(run_id, float(value), is_extreme=bool(distance > _OUTER_FENCE * width))
        for run_id, value, distance in zip(group.run_ids, group.values, beyond, strict=True)
        if distance > _FENCE * width and distance > 0
    )
