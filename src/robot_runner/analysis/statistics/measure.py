"""Everything about one measure."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import numpy as np

from robot_runner.analysis.statistics.assumptions import normality, quantile_pairs
from robot_runner.analysis.statistics.carrying_out import carry_out
from robot_runner.analysis.statistics.choice import choose_test
from robot_runner.analysis.statistics.described import NotComputed
from robot_runner.analysis.statistics.descriptive import describe
from robot_runner.analysis.statistics.drift import drift_of
from robot_runner.analysis.statistics.outcome import MeasureStatistics
from robot_runner.analysis.statistics.post_hoc import compare_pairs
from robot_runner.analysis.statistics.power import power_of
from robot_runner.design.columns import RUN_ID

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.choice import Choice
    from robot_runner.analysis.statistics.described import Description
    from robot_runner.analysis.statistics.design import Design, MeasureData
    from robot_runner.analysis.statistics.tested import AssumptionCheck, MeasureTest, PostHoc, Power
    from robot_runner.design.analysis_plan import Correction

__all__ = ["measure_statistics"]

_Found = TypeVar("_Found")

#: Groups are described one by one up to this number; the table would not be read, and the bootstrap takes its time.
_MOST_DESCRIBED = 200

#: The square of a larger value, summed up, comes near the end of floating-point numbers.
_LARGEST = 1e100


class _Gathered:
    """What could not be computed, noted on the way."""

    def __init__(self) -> None:
        self.missing: list[NotComputed] = []

    def take(self, result: _Found | NotComputed) -> _Found | None:
        """Return a result, or None after noting why there is none."""
        if isinstance(result, NotComputed):
            self.missing.append(result)
            return None
        return result


def measure_statistics(
    design: Design, name: str, *, alpha: float, correction: Correction, is_planned: bool
) -> MeasureStatistics:
    """Compute the statistics of one measure from the runs that are done."""
    gathered = _Gathered()
    column = design.results.columns[name]
    data = design.data(name)
    if data is None or not len(data.frame) or float(np.max(np.abs(data.values))) > _LARGEST:
        why = "it is not a number." if data is None else "no run that is done has a value."
        if data is not None and len(data.frame):
            why = f"it has values beyond {_LARGEST:g}, which cannot be reckoned with."
        gathered.missing.append(NotComputed(f"statistics of {name}", why))
        return MeasureStatistics(name, column.unit, column.origin, is_planned, not_computed=tuple(gathered.missing))
    choice = gathered.take(choose_test(data, alpha))
    test = carry_out(data, choice, alpha) if choice else None
    post_hoc = _compared(gathered, data, choice, test, alpha, correction)
    residuals = choice.fit.residuals if choice else data.residuals()
    return MeasureStatistics(
        name,
        column.unit,
        column.origin,
        is_planned,
        overall=describe(data.described_groups([])[0]),
        by_treatment=tuple(each for factor in data.factors for each in _described(gathered, data, (factor,))),
        by_combination=_described(gathered, data, data.factors) if len(data.factors) > 1 else (),
        assumptions=_assumptions(gathered, data, choice, alpha),
        quantiles=quantile_pairs(residuals, tuple(data.frame[RUN_ID])),
        test=test,
        post_hoc=post_hoc,
        drift=gathered.take(drift_of(data, alpha, column.unit)),
        power=_power(gathered, data, alpha),
        not_computed=tuple(dict.fromkeys(gathered.missing)),
    )


def _described(gathered: _Gathered, data: MeasureData, factors: tuple[str, ...]) -> tuple[Description, ...]:
    groups = data.described_groups(factors)
    if len(groups) > _MOST_DESCRIBED:
        why = f"there are {len(groups):,} groups, more than {_MOST_DESCRIBED}."
        gathered.missing.append(NotComputed(f"descriptions by {' x '.join(factors)}", why))
        return ()
    return tuple(map(describe, groups))


def _power(gathered: _Gathered, data: MeasureData, alpha: float) -> Power | None:
    if len(data.factors) > 1:
        why = f"it is for one factor, and {len(data.factors)} are varied: power depends on the effects of all of them."
        gathered.take(NotComputed("power", why))
    if len(data.factors) != 1:
        return None
    return gathered.take(power_of(data.groups(data.factors), alpha, is_blocked=data.is_blocked))


def _compared(
    gathered: _Gathered,
    data: MeasureData,
    choice: Choice | None,
    test: MeasureTest | None,
    alpha: float,
    correction: Correction,
) -> tuple[PostHoc, ...]:
    if choice is None or test is None:
        return ()
    post_hoc, missing = compare_pairs(data, choice, test, alpha, correction)
    gathered.missing += missing
    return post_hoc


def _assumptions(
    gathered: _Gathered, data: MeasureData, choice: Choice | None, alpha: float
) -> tuple[AssumptionCheck, ...]:
    """Return what the choice rests on, then the normality of each group."""
    deciding = [gathered.take(check) for check in choice.checks] if choice else []
    groups = data.groups(data.factors) if data.factors else []
    if len(groups) > _MOST_DESCRIBED:
        groups = []
    of_groups = [gathered.take(normality(group.values, alpha, group.treatments)) for group in groups]
    return tuple(check for check in (*deciding, *of_groups) if check is not None)
