"""The statistics of a whole experiment: of each measure, and of the hypotheses that were fixed beforehand."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from robot_runner.analysis.statistics.assumptions import equal_variances, normality, quantile_pairs
from robot_runner.analysis.statistics.batch_strata import comparable
from robot_runner.analysis.statistics.correlations import correlations_of, drift_of
from robot_runner.analysis.statistics.descriptive import describe
from robot_runner.analysis.statistics.design import design_of
from robot_runner.analysis.statistics.families import concluded
from robot_runner.analysis.statistics.outcome import ExperimentStatistics, MeasureStatistics
from robot_runner.analysis.statistics.post_hoc import carry_out_contrast, compare_pairs, missing_intervals
from robot_runner.analysis.statistics.power import power_of
from robot_runner.analysis.statistics.robustness import doubtful_runs, standing_effects, standing_hypotheses
from robot_runner.analysis.statistics.tested import NotComputed
from robot_runner.analysis.statistics.tests import Choices, carry_out, model_of
from robot_runner.core.design.analysis_plan import Correction
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.errors import AnalysisError, did_you_mean
from robot_runner.core.words import counted

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from robot_runner.analysis.results import Results
    from robot_runner.analysis.statistics.design import Design, MeasureData
    from robot_runner.analysis.statistics.outcome import Description, Power
    from robot_runner.analysis.statistics.tested import AssumptionCheck, ContrastTest
    from robot_runner.core.design.analysis_plan import AnalysisPlan
    from robot_runner.core.design.hypothesis import Hypothesis

__all__ = ["analyse", "measure_statistics"]


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
    design: Design, name: str, choices: Choices, *, plan: AnalysisPlan | None = None
) -> MeasureStatistics:
    """Compute the statistics of one measure from the runs that are done; p-values are not adjusted yet.

    Args:
        design: of the experiment.
        name: the measure.
        choices: what was chosen for the analysis beforehand.
        plan: what was planned; None where nothing was, or where it is not kept.
    """
    gathered = _Gathered()
    column = design.results.columns[name]
    data = design.data(name)
    is_primary = plan is not None and name in plan.measures
    is_planned = plan is not None and name in (*plan.measures, *plan.secondary)
    if data is None or not len(data.frame) or float(np.max(np.abs(data.values))) > _LARGEST:
        why = "the measure is not a number." if data is None else "no run that is done has a value."
        if data is not None and len(data.frame):
            why = f"the measure has values beyond {_LARGEST:g}, too large to compute with."
        missing = (NotComputed(f"statistics of {name}", why),)
        return MeasureStatistics(name, column.unit, column.origin, is_planned, is_primary, not_computed=missing)
    compared, note, apart = comparable(data)
    gathered.missing += apart
    found = model_of(compared, choices.estimand, choices.statistic)
    if compared.factors or not apart:
        gathered.take(found)
    model = None if isinstance(found, NotComputed) else found
    test = None if model is None else carry_out(compared, model, choices)
    test = test if test is None or not note else replace(test, notes=(note, *test.notes))
    post_hoc, missed = ((), ()) if model is None or test is None else compare_pairs(compared, model, test, choices)
    gathered.missing += missed
    if test is not None:
        gathered.missing += missing_intervals(test, post_hoc)
    claimed = [] if model is None or plan is None else [each for each in plan.hypotheses if _is_contrast(each, name)]
    contrasts: list[ContrastTest | None] = [
        gathered.take(carry_out_contrast(model, each, choices)) for each in claimed if model is not None
    ]
    return MeasureStatistics(
        name,
        column.unit,
        column.origin,
        is_planned,
        is_primary,
        overall=describe(data.described_groups([])[0]),
        by_treatment=tuple(each for factor in data.factors for each in _described(gathered, data, (factor,))),
        by_combination=_described(gathered, data, data.factors) if len(data.factors) > 1 else (),
        assumptions=_assumptions(gathered, data, choices.alpha),
        quantiles=quantile_pairs(data.residuals(), tuple(data.frame[RUN_ID])),
        test=test,
        post_hoc=post_hoc,
        contrasts=tuple(each for each in contrasts if each is not None),
        drift=gathered.take(drift_of(data, choices.alpha, column.unit)),
        power=_power(gathered, data, choices.alpha),
        not_computed=tuple(dict.fromkeys(gathered.missing)),
    )


def _is_contrast(hypothesis: Hypothesis, measure: str) -> bool:
    return hypothesis.measure == measure and (hypothesis.contrast is not None or hypothesis.within is not None)


def _described(gathered: _Gathered, data: MeasureData, factors: tuple[str, ...]) -> tuple[Description, ...]:
    groups = data.described_groups(factors)
    if len(groups) > _MOST_DESCRIBED:
        why = f"there are {len(groups):,} groups, more than {_MOST_DESCRIBED}."
        gathered.missing.append(NotComputed(f"descriptions by {' x '.join(factors)}", why))
        return ()
    return tuple(map(describe, groups))


def _power(gathered: _Gathered, data: MeasureData, alpha: float) -> Power | None:
    if len(data.factors) > 1:
        why = f"power depends on the effects of all {len(data.factors)} factors; it is computed for one factor only."
        return gathered.take(NotComputed("power", why))
    if not data.factors:
        return None
    return gathered.take(power_of(data.groups(data.factors), alpha, is_blocked=data.is_blocked))


def _assumptions(gathered: _Gathered, data: MeasureData, alpha: float) -> tuple[AssumptionCheck, ...]:
    """Return how residuals are distributed, whether spreads differ, then how each group is distributed."""
    groups = data.groups(data.factors) if data.factors else []
    all_groups = [normality(data.residuals(), alpha), equal_variances(groups, alpha)] if groups else []
    if len(groups) > _MOST_DESCRIBED:
        groups = []
    checks = [*all_groups, *(normality(group.values, alpha, group.treatments) for group in groups)]
    found = [gathered.take(check) for check in checks]
    return tuple(check for check in found if check is not None)


_ALPHA = 0.05

#: Among more measures pairs are too many to be of use.
_MOST_CORRELATED = 20


def analyse(
    results: Results,
    *,
    measures: Sequence[str] | None = None,
    alpha: float | None = None,
    correction: Correction | None = None,
) -> ExperimentStatistics:
    """Compute the statistics of an experiment from the runs that are done.

    All values count; measures that have doubtful ones are computed once more without these, to see what stands.
    What the analysis plan fixed before the experiment is marked as planned, everything else as exploratory; so is
    everything where alpha or the correction are other than the plan's.

    Args:
        results: the experiment.
        measures: which measures; None for those of the plan, then all others.
        alpha: the level of significance; None for that of the plan, or 0.05.
        correction: how p-values are adjusted; None for that of the plan, or Holm.

    Raises:
        AnalysisError: there is no such measure, or alpha is no probability.

    Example:
        >>> from robot_runner.analysis import analyse, load_results
        >>> analyse(load_results("experiments/basic_experiment")).measure("Energy").test.reason  # doctest: +SKIP
    """
    plan = results.plan
    chosen_alpha = alpha if alpha is not None else plan.alpha if plan else _ALPHA
    chosen_correction = correction or (plan.correction if plan else Correction.HOLM)
    if not 0 < chosen_alpha < 1:
        raise AnalysisError(f"alpha is {chosen_alpha!r}", where="analyse", fix="Give a number between 0 and 1.")
    kept = plan if plan is not None and (chosen_alpha, chosen_correction) == (plan.alpha, plan.correction) else None
    planned = (*kept.measures, *kept.secondary) if kept is not None else ()
    design = design_of(results, blocks=kept.blocks if kept is not None else None)
    choices = Choices(chosen_alpha, chosen_correction)
    if kept is not None:
        choices = replace(choices, estimand=kept.estimand, statistic=kept.statistic)
    names = _chosen(results, measures, planned)
    # Errors are controlled among all primary measures, whichever are asked for.
    others = [name for name in (kept.measures if kept else ()) if name in results.columns and name not in names]
    computed = [measure_statistics(design, name, choices, plan=kept) for name in (*names, *others)]
    doubtful = doubtful_runs(results)
    again = {
        each.name: measure_statistics(
            replace(design, without=frozenset(doubtful[each.name])), each.name, choices, plan=kept
        )
        for each in computed
        if each.name in doubtful and each.test is not None
    }
    done, judged = concluded(computed, kept, chosen_alpha, chosen_correction)
    redone, rejudged = concluded(
        [again.get(each.name, each) for each in computed], kept, chosen_alpha, chosen_correction
    )
    told = done[: len(names)]
    without = tuple(each for each in redone[: len(names)] if each.name in again)
    numeric = [data for each in told if each.overall and (data := design.data(each.name)) is not None]
    correlations, missing = correlations_of(numeric[:_MOST_CORRELATED], chosen_correction)
    return ExperimentStatistics(
        alpha=chosen_alpha,
        correction=chosen_correction,
        is_planned=kept is not None,
        design=design.summary(),
        measures=told,
        correlations=correlations,
        hypotheses=judged,
        warnings=tuple(_warnings(design, told)),
        not_computed=(*missing, *_not_correlated(numeric)),
        without_doubtful=without,
        standings=(
            *standing_effects(told, without, doubtful),
            *standing_hypotheses(judged, rejudged, {name: doubtful[name] for name in again}),
        ),
    )


def _chosen(results: Results, measures: Sequence[str] | None, planned: Sequence[str]) -> list[str]:
    if measures is None:
        present = [name for name in planned if name in results.columns]
        return list(dict.fromkeys([*present, *results.measures]))
    for name in measures:
        if name not in results.runs.columns or name not in results.columns:
            fix = did_you_mean(name, results.measures)
            raise AnalysisError(f"there is no measure {name!r}", where=results.name, fix=fix)
    return sorted(measures, key=lambda name: name not in planned)


def _not_correlated(numeric: Sequence[object]) -> tuple[NotComputed, ...]:
    if len(numeric) <= _MOST_CORRELATED:
        return ()
    why = f"there are {len(numeric)}: only the first {_MOST_CORRELATED} were correlated."
    return (NotComputed("correlations of all measures", why),)


def _warnings(design: Design, measures: Sequence[MeasureStatistics]) -> Iterator[str]:
    """Yield threats to validity, the gravest first."""
    summary = design.summary()
    for measure in measures:
        if measure.drift is not None and measure.drift.warning:
            yield measure.drift.warning
    if summary.left_out:
        is_one = summary.left_out == 1
        yield f"{counted(summary.left_out, 'run')} of the table {'is' if is_one else 'are'} not done and left out."
    if summary.factors and not summary.is_balanced:
        yield (
            f"The combinations have {summary.smallest_group} to {summary.largest_group} runs"
            f"{f', and {summary.empty_combinations} have none' if summary.empty_combinations else ''}."
        )
    if design.results.manifest.get("design", {}).get("shuffle") is False and summary.factors:
        yield "The order of the runs was not randomised: whatever changes with time may pass for an effect."
    if design.results.manifest.get("analysis_changes"):
        yield "The analysis plan was changed after runs had been executed: only the first version counts as planned."
