"""Correlations of measures, and their drift over the order of execution."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import combinations, permutations
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from scipy import stats

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.analysis.statistics.analysed_design import PLACE, VALUE, MeasureData
from robot_runner.analysis.statistics.descriptive import are_equal, quiet
from robot_runner.analysis.statistics.designed_columns import grouped, residuals_from, residuals_of
from robot_runner.analysis.statistics.effect_sizes import correlation_magnitude
from robot_runner.analysis.statistics.outcome import Correlation, Drift
from robot_runner.analysis.statistics.post_hoc import adjusted_known
from robot_runner.analysis.statistics.tested import Interval, NotComputed, NoVariation
from robot_runner.analysis.statistics.theil_sen import theil_sen
from robot_runner.analysis.wording import difference_unit, p_in_words, shown_coefficient, with_unit
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.words import enumerated

if TYPE_CHECKING:
    from robot_runner.core.design.analysis_plan import Correction

_LEAST = 4
_LEVEL = 0.95

#: Up to this many values, p-values are exact, from all permutations: for four values that rise together, Student's t
#: yields p = 0, and the exact p-value is 2/24.
_MOST_PERMUTED = 8


def correlations_of(
    measures: Sequence[MeasureData], correction: Correction
) -> tuple[tuple[Correlation, ...], tuple[NotComputed, ...]]:
    """Correlate each pair of measures, over all runs and within combinations of treatments.

    If several runs share a block, plot, subject or batch, there is neither p-value nor interval: these need independent
    runs.
    """
    found: list[Correlation] = []
    missing: list[NotComputed] = []
    for first, second in combinations(map(_Correlated, measures), 2):
        result = _correlation(first, second)
        (found if isinstance(result, Correlation) else missing).append(result)  # type: ignore[arg-type]
    after = adjusted_known((each.p_value for each in found), correction)
    listed = (replace(each, adjusted_p_value=value) for each, value in zip(found, after, strict=True))
    return tuple(listed), tuple(missing)


@dataclass(frozen=True)
class _Correlated:
    """A measure that is correlated with all others."""

    data: MeasureData

    @cached_property
    def residuals(self) -> Mapping[str, float]:
        """The residual of each run from its model, by the run's id."""
        return dict(zip(self.data.frame[RUN_ID], residuals_of(self.data)[0], strict=True))


def _correlation(one: _Correlated, other: _Correlated) -> Correlation | NotComputed:
    first, second = one.data, other.data
    what = f"correlation of {first.name} and {second.name}"
    joined = first.frame[[RUN_ID, VALUE]].merge(second.frame[[RUN_ID, VALUE]], on=RUN_ID, suffixes=("_1", "_2"))
    x, y = (joined[f"{VALUE}_{which}"].to_numpy(dtype=np.float64) for which in (1, 2))
    if len(joined) < _LEAST:
        return NotComputed(what, f"a correlation takes {_LEAST} runs that have both measures.")
    if _is_flat(x, x) or _is_flat(y, y):
        is_equal = are_equal(x) or are_equal(y)
        why = "all values of one of them are equal" if is_equal else "one of them hardly varies relative to its size"
        return NotComputed(what, f"{why}.")
    with quiet():  # values that hardly vary
        pearson = stats.pearsonr(x, y)
        rho, p_value = spearman(x, y)
        ends = pearson.confidence_interval(_LEVEL)
    if not math.isfinite(pearson.statistic) or not math.isfinite(p_value):
        return NotComputed(what, "the values hardly vary.")
    interval = Interval(float(ends.low), float(ends.high), _LEVEL, "Fisher's z")
    # With runs in six rooms that differ, half of all pairs of uncorrelated measures would seem correlated.
    units = [name for name in first.unit_names if name] or (list(map(str, first.batches)) if first.is_extended else [])
    is_known = len(set(units)) == len(units)
    return Correlation(
        first=first.name,
        second=second.name,
        n=len(joined),
        pearson=float(pearson.statistic),
        pearson_interval=interval if is_known and math.isfinite(interval.low) else None,
        spearman=rho,
        p_value=p_value if is_known else None,
        adjusted_p_value=p_value if is_known else None,
        within=_within(one, other),
        magnitude=correlation_magnitude(rho),
    )


#: The last binary places of a correlation of 1.
_LAST_PLACES = 4 * np.finfo(np.float64).eps


def spearman(x: Floats, y: Floats) -> tuple[float, float]:
    """Return Spearman's rho and its p-value, which is exact, from all permutations, for few values.

    Example:
        >>> [round(each, 3) for each in spearman(np.arange(4.0), np.array([1.0, 2.0, 4.0, 8.0]))]
        [1.0, 0.083]
    """
    found = stats.spearmanr(x, y)
    rho, p_value = float(found.statistic), float(found.pvalue)
    if 1 - abs(rho) <= _LAST_PLACES:  # values that only rise, or only fall
        rho = math.copysign(1.0, rho)
    if len(x) <= _MOST_PERMUTED and math.isfinite(rho):
        ranks, others = (stats.rankdata(each) - (len(x) + 1) / 2 for each in (x, y))
        sums = np.abs(others[_orders(len(x))] @ ranks)
        p_value = float(np.mean(sums >= abs(float(others @ ranks)) - _TIED))
    return rho, p_value


@lru_cache(maxsize=_MOST_PERMUTED)
def _orders(count: int) -> Numbers:
    return np.array(list(permutations(range(count))))


def _within(one: _Correlated, other: _Correlated) -> float | None:
    """Return Pearson's r of the residuals of both measures; None without factors or without variation."""
    shared = [run_id for run_id in one.residuals if run_id in other.residuals]
    x, y = (np.array([each.residuals[run_id] for run_id in shared]) for each in (one, other))
    if not one.data.factors or any(_is_flat(left, each.data.values) for left, each in ((x, one), (y, other))):
        return None
    return float(stats.pearsonr(x, y).statistic)


def _is_flat(residuals: Floats, values: Floats) -> bool:
    """Return whether residuals are rounding alone, relative to the values."""
    return float(np.ptp(residuals)) < 1e-12 * max(1e-300, float(np.max(np.abs(values))))


_DRIFT_LEAST = 6  # with fewer runs no order can be significant
_DIGITS = 9  # of places within blocks, whose means are fractions
_SAME_PLACE = 1 - 1e-6  # consecutive runs within blocks differ by this at least; missing runs leave smaller ranges
_TIED = 1e-9  # residuals that differ by less than this share of the largest are ties


def drift_of(data: MeasureData, alpha: float, unit: str = "", *, is_ordered: bool = True) -> Drift | NotComputed:
    """Test for a drift of the residuals over the order of execution (Spearman's rho, Theil-Sen slope).

    Unless `is_ordered`, the sentence names the order of the table, as that of execution is not known.
    """
    what = "drift over the order of execution"
    places = executed = data.frame[PLACE].to_numpy(dtype=np.float64)
    # Combinations and blocks differ in their mean place as well: the order is adjusted by the same model as the values.
    left, freedom = residuals_of(data, executed)
    within = (tuple(grouped(data)) or ("treatments",)) if freedom < len(executed) - 1 else ()
    if within:
        places = np.round(left - left.min(), _DIGITS) + 1
    if freedom + 1 < _DRIFT_LEAST:
        more = ", in addition to those that its model takes" if within else ""
        return NotComputed(what, f"the test of a drift takes {_DRIFT_LEAST} runs with a value{more}.")
    order = np.argsort(places, kind="stable")
    places, residuals = places[order], residuals_of(data)[0][order]
    if np.ptp(places) < _SAME_PLACE:
        return NotComputed(what, "the model takes out what tells the order, such as rows, columns and covariates.")
    if _is_flat(residuals, data.values):
        return NoVariation(what, "within each combination all values are equal.")
    step = _TIED * float(np.max(np.abs(residuals)))
    tied = np.round(residuals / step) * step  # subtracting means leaves rounding differences between equal values
    with quiet():
        rho, p_value = spearman(places, tied)
        if within:  # the t test with the degrees of freedom that the model leaves
            t_value = abs(rho) * np.sqrt((freedom - 1) / np.maximum(1 - rho**2, 0.0))
            p_value = float(2 * stats.t.sf(t_value, freedom - 1))
        slope = theil_sen(places, tied, _LEVEL)
    if not np.isfinite(p_value):
        return NotComputed(what, "the values hardly vary.")
    over = "order of execution" if is_ordered else "order of the table, which may be another than that of execution,"
    over += f" within {enumerated(within)}" if within else ""
    is_significant = bool(p_value < alpha)
    is_confounded = _are_treatments_uneven(data, executed, alpha)
    if is_significant:
        warning = _warning(data.name, unit, (slope.slope, rho, p_value), is_confounded, over)
    else:
        warning = _alike(data, executed, is_confounded, over)
    return Drift(
        places=tuple(map(round, places.tolist())),
        residuals=tuple(map(float, residuals)),
        run_ids=tuple(data.frame[RUN_ID].to_numpy()[order]),
        correlation=rho,
        p_value=p_value,
        slope=slope.slope,
        slope_interval=Interval(slope.low, slope.high, _LEVEL, "Theil-Sen"),
        is_significant=is_significant,
        is_confounded=is_confounded,
        warning=warning,
        within=within,
    )


#: Residuals of runs that follow each other correlate by chance in 1 % of experiments; of weaker ones, the variance of
#: a mean is less than half larger than of independent runs.
_ALIKE_BY_CHANCE, _ALIKE = 0.01, 0.2


def _alike(data: MeasureData, executed: Floats, is_confounded: bool, order: str) -> str:
    """Return what to say where runs that follow each other are alike; empty where not, or the design may explain it.

    The first autocorrelation of the ranks is normal about 0 with a variance of 1 / n (Wald and Wolfowitz, 1943). Within
    treatments and blocks, whose residuals add up to 0, it is lower, and found less often.
    """
    residuals = residuals_of(data)[0][np.argsort(executed, kind="stable")]
    ranks = stats.rankdata(np.round(residuals / (_TIED * float(np.max(np.abs(residuals))))))
    with quiet():
        correlation = float(np.corrcoef(ranks[:-1], ranks[1:])[0, 1])
    p_value = float(stats.norm.sf(correlation * np.sqrt(len(ranks))))
    if not (data.known.is_plain and correlation >= _ALIKE and p_value < _ALIKE_BY_CHANCE):
        return ""
    figures = f"r = {shown_coefficient(correlation)}, {p_in_words(p_value)}"
    head = f"{data.name} is alike in runs that follow each other in the {order} ({figures})"
    if is_confounded:
        return (
            f"{head}, and treatments are unevenly spread over that order: what such runs share may pass for an effect."
        )
    return f"{head}, and tested as if they were independent. Blocks of runs close in time would allow for it."


def _are_treatments_uneven(data: MeasureData, places: Floats, alpha: float) -> bool:
    """Return whether some treatments were executed earlier than others, within blocks and the like.

    This is the test of Kruskal and Wallis; in complete blocks that of Friedman.
    """
    left, freedom = residuals_from(grouped(data).values(), (), places)
    for factor in data.factors:
        treatments = pd.Series(left).groupby(data.frame[factor].to_numpy(), observed=True)
        with quiet():  # one run in each block
            statistic = freedom * np.sum(treatments.transform("mean") ** 2) / np.sum(left**2)
        if stats.chi2.sf(statistic, treatments.ngroups - 1) < alpha:
            return True
    return False


def _warning(measure: str, unit: str, found: tuple[float, float, float], is_confounded: bool, order: str) -> str:
    slope, rho, p_value = found
    # If most values are equal, as counts may be, the median of the pairwise slopes is 0 and has no direction.
    amount = f" by about {with_unit(abs(slope), difference_unit(unit))} a run" if slope else ""
    figures = f"rho = {shown_coefficient(rho)}, {p_in_words(p_value)}"
    head = f"{measure} {'rises' if rho > 0 else 'falls'} over the {order}{amount} ({figures})"
    if is_confounded:
        return f"{head}, and treatments are unevenly spread over that order: the drift may pass for an effect."
    return f"{head}: something that changes with time, such as the battery or the room, may add to it."
