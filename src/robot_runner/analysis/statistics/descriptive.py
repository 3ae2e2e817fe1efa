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
    """Suppress warnings of libraries, such as those on values that hardly vary: check that results are finite."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        yield


#: Squared variances of larger values overflow, and those of smaller ones underflow.
_LARGEST, _SMALLEST = 1e70, 1e-70

#: The fewest values for a bootstrap: with fewer, its intervals are far too narrow.
_LEAST_FOR_BOOTSTRAP = 5

#: The number of bootstrap draws; the error of an interval's end is then well below its width.
_RESAMPLES = 5000
#: From this many values on, fewer draws are made: each takes longer, and draws differ less.
_MANY = 200
_RESAMPLES_OF_MANY = 2000

#: A fixed seed, so that intervals are reproducible.
_SEED = 20210525

#: Tukey's fences (Tukey, Exploratory Data Analysis, 1977): interquartile ranges beyond the quartiles.
_FENCE = 1.5
_OUTER_FENCE = 3.0
#: Fractions that differ by no more than this many units in the last place are equal; whole numbers are exact.
STEPS_OF_NOISE = 8
#: The rounding error of computing with values, relative to the largest: 45 units in the last place.
_UNITS_IN_LAST_PLACE = 1e-14

#: The fewest values that have a standard deviation.
_LEAST_FOR_SPREAD = 2
#: The relative difference, by rounding, of computed means of units that are equal.
_ROUNDING = 1e-13
_T = "t distribution"
_LEAST_FOR_OUTLIERS = 4


def out_of_range(values: Floats) -> str:
    """Return why values are out of the range of computation, as the predicate of a sentence; empty if they are not."""
    largest = float(np.max(np.abs(values), initial=0.0))
    if largest > _LARGEST:
        return f"has values beyond {_LARGEST:g}, too large to compute with."
    if 0 < largest < _SMALLEST:
        return f"has no value above {_SMALLEST:g}: they are too small to compute with."
    return ""


def step_of(values: Floats) -> float:
    """Return the distance of neighbouring floating-point numbers at the size of the largest value."""
    return float(np.spacing(np.max(np.abs(values))))


def are_equal(values: Floats) -> bool:
    """Return whether values are equal, except for rounding of sums of fractions such as 0.1 + 0.2.

    Example:
        >>> are_equal(np.array([0.1 + 0.2, 0.3])), are_equal(np.array([2.0**53, 2.0**53 + 2]))
        (True, False)
    """
    widest = float(np.ptp(values))
    return widest == 0 or (widest <= STEPS_OF_NOISE * step_of(values) and bool(np.any(values % 1)))


def describe(group: Group, *, level_of_looks: float | None = None) -> Description:
    """Describe the values of one group.

    Quartiles are interpolated linearly (type 7 of Hyndman and Fan 1996, as R and numpy do by default). If runs were
    added until an interval was narrow, `level_of_looks` is the level of each; see `known_precision`.

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
    is_flat = np.ptp(values) == 0  # the sum of equal values may be rounded, which would change mean and spread
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
    """Return Student's interval; that of a bootstrap is too narrow (83 % coverage at n = 5, normal or not).

    If units have several runs of the group, the interval is based on units.
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
    """Return the interval of a mean, based on units; None if their variance is unknown or 0."""
    mean, error = float(np.mean(group.values)), math.sqrt(variance)
    if units < _LEAST_FOR_SPREAD or error <= _ROUNDING * float(np.max(np.abs(group.values))):
        return None
    half_width = float(stats.t.isf((1 - (level_of_looks or CONFIDENCE)) / 2, units - 1)) * error
    method = _T if level_of_looks is None else METHOD
    return Interval(mean - half_width, mean + half_width, CONFIDENCE, f"{method}{group.in_words}")


def bootstrap_interval(values: Floats, statistic: Callable[..., Any], level: float) -> Interval | None:
    """Return a bootstrap confidence interval of a statistic: bias-corrected and accelerated (BCa), else by percentiles.

    Source: Efron and Tibshirani, An Introduction to the Bootstrap (1993), chapter 14. The statistic is a function of an
    array and `axis`. The result is None for fewer than five values, or if all draws are equal.
    """
    if len(values) < _LEAST_FOR_BOOTSTRAP or np.ptp(values) == 0:
        return None
    for method in ("BCa", "percentile"):
        with quiet():  # for a degenerate distribution, percentiles are next
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
    """Return the rounding error of values, shape (..., runs), as shape (..., 1).

    A value on a fence is not beyond it, but in binary, 13.9 is not 12.7 + 1.5 (12.7 - 11.9).
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
