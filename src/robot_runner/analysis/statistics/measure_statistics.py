"""The statistics of one measure: descriptions, tests, pairs, contrasts and covariates, before p-values are adjusted."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from robot_runner.analysis.statistics.adjusted_means import AdjustedMeans
from robot_runner.analysis.statistics.adjustment import adjustment_of
from robot_runner.analysis.statistics.analysed_design import VALUE, Design, MeasureData
from robot_runner.analysis.statistics.assumptions import LEAST, equal_variances, few_values, normality, quantile_pairs
from robot_runner.analysis.statistics.batch_strata import comparable
from robot_runner.analysis.statistics.contrasts import rounding_of
from robot_runner.analysis.statistics.correlations import drift_of
from robot_runner.analysis.statistics.descriptive import are_equal, describe, out_of_range, step_of
from robot_runner.analysis.statistics.designed_columns import grouped, residuals_of
from robot_runner.analysis.statistics.detectable_effect import power_of, units_of
from robot_runner.analysis.statistics.disclosed import LeftOut, Reason
from robot_runner.analysis.statistics.execution_order import execution_order
from robot_runner.analysis.statistics.families import contrasts_of
from robot_runner.analysis.statistics.known_precision import level_of_looks
from robot_runner.analysis.statistics.left_out import false_positives
from robot_runner.analysis.statistics.outcome import Description, MeasureStatistics, Power
from robot_runner.analysis.statistics.post_hoc import MOST_PAIRS, carry_out_contrast, compare_pairs, missing_intervals
from robot_runner.analysis.statistics.proportion_contrasts import carry_out_contrast_of_proportions
from robot_runner.analysis.statistics.proportions import carry_out_proportions, compare_proportions, proportions_of
from robot_runner.analysis.statistics.shares import compare_shares
from robot_runner.analysis.statistics.surface_model import SurfaceModel
from robot_runner.analysis.statistics.tested import (
    AssumptionCheck,
    ContrastTest,
    MeasureTest,
    NotComputed,
    NoVariation,
    PostHoc,
)
from robot_runner.analysis.statistics.tests import Choices, carry_out, planned_model_of
from robot_runner.analysis.wording import shown_number
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.words import counted, enumerated, listed

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.grouped_runs import Group
    from robot_runner.core.design.analysis_plan import AnalysisPlan

_Found = TypeVar("_Found")

#: The most groups that are described one by one: nobody would read a longer table.
_MOST_DESCRIBED = 200

_PAIR = 2


class _Gathered:
    """Collects the results that could not be computed."""

    def __init__(self) -> None:
        self.missing: list[NotComputed] = []

    def take(self, result: _Found | NotComputed) -> _Found | None:
        """Return a result; record a missing one and return None."""
        if isinstance(result, NotComputed):
            self.missing.append(result)
            return None
        return result

    def take_all(self, results: Iterable[_Found | NotComputed]) -> tuple[_Found, ...]:
        """Return the results that could be computed, and record the others."""
        return tuple(each for result in results if (each := self.take(result)) is not None)


def measure_statistics(
    design: Design, name: str, choices: Choices, *, plan: AnalysisPlan | None = None, left_out: Sequence[LeftOut] = ()
) -> MeasureStatistics:
    """Compute the statistics of one measure from the runs that are done; p-values are not adjusted yet.

    The plan is None if there is none, or if it is not followed.
    """
    every, without = design.data(name), frozenset(each.run_id for each in left_out)
    design = design if without == design.without else replace(design, without=without)
    gathered = _Gathered()
    column = design.results.columns[name]
    data = design.data(name)
    is_primary = plan is not None and name in plan.measures
    is_planned = plan is not None and name in (*plan.measures, *plan.secondary)
    told = MeasureStatistics(name, column.unit, column.origin, is_planned, is_primary, left_out=tuple(left_out))
    answers = design.answers(name)
    if answers is not None and len(answers.frame):
        return _of_answers(answers, replace(told, unit="%"), gathered, choices, plan)
    odd = out_of_range(data.values) if data is not None else ""
    if data is None or not len(data.frame) or odd:
        why = f"the measure {odd}" if odd else "no run that is done has a value."
        if data is None and answers is None:
            why = _no_numbers(design.results.done[name].dropna().tolist())
        return replace(told, not_computed=(NotComputed(f"statistics of {name}", why),))
    compared, note, apart = comparable(data)
    coarse = _too_coarse(data)
    gathered.missing += [*coarse, *apart]
    found = planned_model_of(compared, choices.estimand, choices.statistic)
    if compared.factors or not apart:
        gathered.take(found)
    model = None if isinstance(found, NotComputed) else found
    test = None if model is None else carry_out(compared, model, choices)
    test = test if test is None or not note else replace(test, notes=(note, *test.notes))
    post_hoc, missed = ((), ()) if model is None or test is None else compare_pairs(compared, model, test, choices)
    gathered.missing += missed
    if test is not None:
        gathered.missing += missing_intervals(test, post_hoc)
    adjustment = None
    if isinstance(model, AdjustedMeans):
        adjustment = adjustment_of(compared, model, choices, design.results.unit)
    contrasts: tuple[ContrastTest, ...] = ()
    if model is not None:
        contrasts = gathered.take_all(carry_out_contrast(model, each, choices) for each in contrasts_of(plan, name))
    looks = level_of_looks(design.results, name)
    return replace(
        told,
        overall=describe(data.described_groups([])[0], level_of_looks=looks),
        by_treatment=tuple(each for factor in data.factors for each in _described(gathered, data, (factor,), looks)),
        by_combination=_described(gathered, data, data.factors, looks) if len(data.factors) > 1 else (),
        assumptions=_assumptions(gathered, data, choices.alpha),
        quantiles=quantile_pairs(residuals_of(data)[0], tuple(data.frame[RUN_ID])),
        test=test,
        post_hoc=post_hoc,
        contrasts=contrasts,
        drift=gathered.take(
            drift_of(data, choices.alpha, column.unit, is_ordered=execution_order(design.results).is_known)
        ),
        power=_power(gathered, data, choices.alpha),
        not_computed=tuple(dict.fromkeys(map(_of_coarse, gathered.missing) if coarse else gathered.missing)),
        left_out=(*left_out, *_lacking(data)),
        rule_false_positives=_rule_false_positives(every, plan, left_out),
        adjustment=adjustment,
        surface=model.surface(choices.alpha) if isinstance(model, SurfaceModel) else None,
        kept_together=tuple(grouped(data)),
    )


def _no_numbers(told: Sequence[object]) -> str:
    """Return why values that are not all numbers cannot be analysed."""
    if not told:
        return "no run that is done has a value."
    texts = [str(each) for each in told if not isinstance(each, int | float) or not math.isfinite(each)]
    if texts and len(texts) == len(told) and all(map(_reads_as_number, told)):
        return f"its values are texts that read as numbers, such as {texts[0]!r}: publish them as numbers (float)."
    if not texts:
        return "some of its values are True or False, and others numbers: publish all as one of them."
    if len(texts) == len(told):
        return "its values are neither numbers nor True and False."
    are = "is not a number" if len(set(texts)) == 1 else "are not numbers"
    return f"in {len(texts)} of {counted(len(told), 'run')} it is {listed(dict.fromkeys(texts))}, which {are}."


def _reads_as_number(told: object) -> bool:
    try:
        return isinstance(told, str) and math.isfinite(float(told))
    except ValueError:
        return False


def _too_coarse(data: MeasureData) -> tuple[NotComputed, ...]:
    """Return a finding if differences of runs are within rounding of the values, such as times in ns since 1970."""
    groups = [group.values for group in data.groups(data.factors)]
    if max(np.max(np.abs(each - each.mean())) for each in groups) > rounding_of(data.values):
        return ()
    if all(map(are_equal, groups)):
        return ()
    step, widest = step_of(data.values), max(float(np.ptp(each)) for each in groups)
    told = f"numbers as large as these are told apart by {shown_number(step, 3)} only"
    differ = f"runs of a group differ by {shown_number(widest, 3)}"
    fix = "Publish how far values are from a fixed one, such as the time since the mission began"
    return (NotComputed("spreads in full", f"{told}, and {differ}: they are rounded. {fix}."),)


def _of_coarse(missing: NotComputed) -> NotComputed:
    """Return the true reason for coarse values: they are not equal, but differ by too little."""
    if not isinstance(missing, NoVariation):
        return missing
    return replace(missing, why="runs differ by too little relative to the size of their values.")


def _of_answers(
    answers: MeasureData, measure: MeasureStatistics, gathered: _Gathered, choices: Choices, plan: AnalysisPlan | None
) -> MeasureStatistics:
    hypotheses = contrasts_of(plan, measure.name)
    found = compare_shares(answers, choices, hypotheses)
    if found is None:
        test, pairs = _exact(answers, choices, gathered)
        contrasts = tuple(carry_out_contrast_of_proportions(answers, each, choices) for each in hypotheses)
    else:
        test, pairs, contrasts = found.test, found.pairs, found.contrasts
        gathered.missing += found.missed
    known = gathered.take_all(contrasts)
    if plan is not None and plan.covariates:
        gathered.missing.append(NotComputed("adjustment for covariates", "it is of means, and not of proportions."))
    proportions = proportions_of(answers, _MOST_DESCRIBED)
    described = {tuple(each.treatments): None for each in (*proportions.by_treatment, *proportions.by_combination)}
    gathered.missing += [each for names in described for each in _of_one_unit(answers.described_groups(names))]
    if len(answers.factors) > 1 and not proportions.by_combination:
        why = f"there are more than {_MOST_DESCRIBED} groups."
        gathered.missing.append(NotComputed(f"descriptions by {' x '.join(answers.factors)}", why))
    return replace(
        measure,
        proportions=proportions,
        test=test,
        post_hoc=pairs,
        contrasts=known,
        not_computed=tuple(gathered.missing),
    )


def _exact(
    answers: MeasureData, choices: Choices, gathered: _Gathered
) -> tuple[MeasureTest | None, tuple[PostHoc, ...]]:
    """Return the exact test of a yes-or-no measure, and its pairs."""
    test = gathered.take(carry_out_proportions(answers, choices))
    return test, () if test is None else gathered.take_all(compare_proportions(answers, choices, MOST_PAIRS))


def _lacking(data: MeasureData) -> Iterator[LeftOut]:
    lacking = data.lacking
    values = dict(zip(data.every[RUN_ID], data.every[VALUE], strict=True)) if lacking else {}
    for run_id, names in lacking.items():
        yield LeftOut(run_id, float(values[run_id]), Reason.COVARIATE, f"{enumerated(names)} is missing")


def _rule_false_positives(
    every: MeasureData | None, plan: AnalysisPlan | None, left_out: Sequence[LeftOut]
) -> float | None:
    """Return the false positives due to the outlier rule, for the sizes of the groups; None if it left out nothing."""
    if every is None or plan is None or plan.outliers is None:
        return None
    sizes = sorted(len(group.values) for group in every.groups(every.factors))
    is_used = any(each.reason is Reason.OUTLIER for each in left_out)
    return false_positives(plan.outliers, (sizes[0], sizes[-1])) if is_used and sizes[0] >= _PAIR else None


def _described(
    gathered: _Gathered, data: MeasureData, factors: tuple[str, ...], looks: float | None
) -> tuple[Description, ...]:
    groups = data.described_groups(factors) if len(factors) > 1 else data.applied_groups(factors)
    if len(groups) > _MOST_DESCRIBED:
        why = f"there are {len(groups):,} groups, more than {_MOST_DESCRIBED}."
        gathered.missing.append(NotComputed(f"descriptions by {' x '.join(factors)}", why))
        return ()
    gathered.missing += _of_one_unit(groups)
    return tuple(describe(group, level_of_looks=looks) for group in groups)


def _of_one_unit(groups: Sequence[Group]) -> Iterator[NotComputed]:
    """Yield the groups without interval because all their runs are of one unit."""
    if alone := [group for group in groups if group.of_units is not None and group.of_units[1] == 1]:
        why = f"all runs of a group are of one {alone[0].unit}, so that nothing tells how much these differ."
        yield NotComputed(f"the interval of {listed([group.label for group in alone])}", why)


def _power(gathered: _Gathered, data: MeasureData, alpha: float) -> Power | None:
    if data.covariates:
        why = "it is computed for comparisons without covariates; adjusted ones find smaller effects."
        return gathered.take(NotComputed("power", why))
    if len(data.factors) > 1:
        why = f"power depends on the effects of all {len(data.factors)} factors; it is computed for one factor only."
        return gathered.take(NotComputed("power", why))
    if not data.factors or not data.known.is_plain:
        return None
    units = units_of(data)
    found = units if isinstance(units, NotComputed) else power_of(data.groups(data.factors), units, alpha)
    return gathered.take(found)


def _assumptions(gathered: _Gathered, data: MeasureData, alpha: float) -> tuple[AssumptionCheck, ...]:
    """Return the checks of the residuals' normality, of equal variances, then of each group's normality."""
    groups = data.groups(data.factors) if data.factors else []
    checks: list[AssumptionCheck | NotComputed] = []
    if groups:
        left, freedom = residuals_of(data)
        of_residuals = normality(left, alpha, freedom=freedom)
        kept_apart = tuple(grouped(data)) or (("blocks",) if data.is_blocked else ())
        checks = [of_residuals, equal_variances(groups, alpha, within=kept_apart)]
    if len(groups) <= _MOST_DESCRIBED:
        checks += few_values([group.treatments for group in groups if len(group.values) < LEAST])
        tested = [group for group in groups if len(group.values) >= LEAST]
        checks += [normality(group.values, alpha, group.treatments) for group in tested]
    return gathered.take_all(checks)
