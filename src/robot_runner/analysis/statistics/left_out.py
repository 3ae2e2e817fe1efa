"""Values that the plan leaves out of the analysis of a measure, and the false positives due to the outlier rule."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.statistics.analysed_design import VALUE, Design
from robot_runner.analysis.statistics.descriptive import rounding_of
from robot_runner.analysis.statistics.disclosed import LeftOut, Reason
from robot_runner.analysis.statistics.execution_order import displaced_runs
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.design.outliers import Doubtful, Outliers

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from robot_runner.analysis.statistics.grouped_runs import Group
    from robot_runner.core.design.analysis_plan import AnalysisPlan

#: The false positives of a 5 % test, in percent, above which a warning is given.
MOST_FALSE_POSITIVES = 6.5

#: The fewest values for a rule by quartiles or the median.
_LEAST = 5

#: The standard deviation of normal values, in median absolute deviations.
_NORMAL = 1.4826

_ALPHA = 0.05
#: The number of simulated experiments: the rate of false positives is then known to 0.5 percentage points.
_EXPERIMENTS = 10_000
_SEED = 20210525


def left_out_of(
    design: Design, measure: str, plan: AnalysisPlan | None, doubtful: Sequence[str]
) -> tuple[LeftOut, ...]:
    """Return the values of a measure that are left out: of runs out of order, doubtful ones, then outliers.

    Runs that were executed out of the order of their design are left out with and without a plan: the model of the
    design is not valid for them.
    """
    data = design.data(measure)
    displaced = displaced_runs(design.results)
    found = _values_of(design, measure, displaced, Reason.DISPLACED)
    if plan is not None and plan.doubtful is Doubtful.LEAVE_OUT:
        others = {run_id: "the value is doubtful" for run_id in doubtful if run_id not in displaced}
        found += _values_of(design, measure, others, Reason.DOUBTFUL)
    if data is None or plan is None or plan.outliers is None:
        return found
    gone = {each.run_id for each in found}
    unit = design.results.unit(measure)
    outliers = (_outliers(group, measure, unit, plan.outliers, gone) for group in data.groups(data.factors))
    return (*found, *(each for several in outliers for each in several))


def doubtful_values(design: Design, measure: str, doubtful: Sequence[str]) -> tuple[LeftOut, ...]:
    """Return the values of these runs as left out because they are doubtful."""
    return _values_of(design, measure, dict.fromkeys(doubtful, "the value is doubtful"), Reason.DOUBTFUL)


def _values_of(design: Design, measure: str, whys: Mapping[str, str], reason: Reason) -> tuple[LeftOut, ...]:
    data = design.data(measure) or design.answers(measure)
    known = None if data is None else data.every.dropna(subset=[VALUE])
    every = {} if known is None else dict(zip(known[RUN_ID], known[VALUE], strict=True))
    return tuple(LeftOut(run_id, float(every[run_id]), reason, why) for run_id, why in whys.items() if run_id in every)


def _outliers(group: Group, measure: str, unit: str, rule: Outliers, gone: set[str]) -> Iterator[LeftOut]:
    kept = [place for place, run_id in enumerate(group.run_ids) if run_id not in gone]
    values = group.values[kept]
    low, high = rule.bounds.get(measure, (None, None))
    for place, value, is_far in zip(kept, values, outside(values, rule), strict=True):
        parts = [f"{_spread_rule(rule)} of {group.label}"] if is_far else []
        parts += [f"below {low:g} {unit}".rstrip()] if low is not None and value < low else []
        parts += [f"above {high:g} {unit}".rstrip()] if high is not None and value > high else []
        if parts:
            yield LeftOut(group.run_ids[place], float(value), Reason.OUTLIER, ", ".join(parts))


def _spread_rule(rule: Outliers) -> str:
    if rule.interquartile_ranges is not None:
        return f"more than {rule.interquartile_ranges:g} interquartile ranges beyond the quartiles"
    return f"more than {rule.median_deviations:g} median absolute deviations from the median"


def outside(values: Floats, rule: Outliers) -> NDArray[np.bool_]:
    """Return which values of one combination are outliers by interquartile ranges or median deviations.

    There are none among fewer than five values, or if the spread is 0. There may be any number of leading axes, (...,
    runs). Bounds of the rule are ignored.
    """
    none = np.zeros(values.shape, dtype=bool)
    if values.shape[-1] < _LEAST:
        return none
    if rule.interquartile_ranges is not None:
        first, third = np.quantile(values, [0.25, 0.75], axis=-1, keepdims=True)
        beyond = np.maximum(first - values, values - third) - rounding_of(values)
        far = beyond > rule.interquartile_ranges * (third - first)
        return np.asarray(far & (third > first))
    if rule.median_deviations is not None:
        distances = np.abs(values - np.median(values, axis=-1, keepdims=True))
        scale = _NORMAL * np.median(distances, axis=-1, keepdims=True)
        return np.asarray((distances - rounding_of(values) > rule.median_deviations * scale) & (scale > 0))
    return none


def false_positives(rule: Outliers, sizes: tuple[int, int]) -> float | None:
    """Return the false positives of Welch's t at 5 % after a rule has left out outliers, in percent.

    Two combinations of these sizes, with normal values and equal variances, are simulated. The result is None for a
    rule with bounds alone.
    """
    if rule.interquartile_ranges is None and rule.median_deviations is None:
        return None
    return _simulated(rule.interquartile_ranges, rule.median_deviations, sizes)


def rate_in_words(rate: float) -> str:
    """Return the end of a sentence on the false positives due to an outlier rule."""
    return (
        f"leaving values out by such a rule finds a difference where there is none in {rate:.1f} % at a level of 5 % "
        "(simulated for two combinations of so many runs, normal values and equal spreads)."
    )


@lru_cache(maxsize=64)
def _simulated(ranges: float | None, deviations: float | None, sizes: tuple[int, int]) -> float:
    rule = Outliers(interquartile_ranges=ranges, median_deviations=deviations)
    random = np.random.default_rng(_SEED)
    means, errors, freedoms = [], [], []
    for size in sizes:
        values = random.normal(size=(_EXPERIMENTS, size))
        kept = np.where(outside(values, rule), np.nan, values)
        count = np.sum(np.isfinite(kept), axis=-1)
        means.append(np.nanmean(kept, axis=-1))
        errors.append(np.nanvar(kept, axis=-1, ddof=1) / count)
        freedoms.append(count - 1)
    error = errors[0] + errors[1]
    freedom = error**2 / (errors[0] ** 2 / freedoms[0] + errors[1] ** 2 / freedoms[1])
    p_values = 2 * stats.t.sf(np.abs(means[0] - means[1]) / np.sqrt(error), freedom)
    return float(100 * np.mean(p_values < _ALPHA))
