"""The statistics of a whole experiment: of each measure, and of the hypotheses that were fixed beforehand."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import numpy as np

from robot_runner.analysis.statistics.choice import choose_test, normality, quantile_pairs
from robot_runner.analysis.statistics.correlations import correlations_of, drift_of
from robot_runner.analysis.statistics.descriptive import describe
from robot_runner.analysis.statistics.design import design_of
from robot_runner.analysis.statistics.outcome import ExperimentStatistics, HypothesisOutcome, MeasureStatistics
from robot_runner.analysis.statistics.post_hoc import adjusted, compare_pairs
from robot_runner.analysis.statistics.power import power_of
from robot_runner.analysis.statistics.tested import NotComputed
from robot_runner.analysis.statistics.tests import carry_out
from robot_runner.analysis.wording import p_in_words
from robot_runner.core.design.analysis_plan import Correction
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.errors import AnalysisError, did_you_mean
from robot_runner.core.words import counted

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from robot_runner.analysis.results import Results
    from robot_runner.analysis.statistics.choice import Choice
    from robot_runner.analysis.statistics.design import Design, MeasureData
    from robot_runner.analysis.statistics.outcome import Description, Power
    from robot_runner.analysis.statistics.tested import AssumptionCheck, Effect, MeasureTest, PostHoc
    from robot_runner.core.design.analysis_plan import Hypothesis

__all__ = ["analyse", "judge", "measure_statistics"]


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
        why = "the measure is not a number." if data is None else "no run that is done has a value."
        if data is not None and len(data.frame):
            why = f"the measure has values beyond {_LARGEST:g}, too large to compute with."
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
        why = f"power depends on the effects of all {len(data.factors)} factors; it is computed for one factor only."
        return gathered.take(NotComputed("power", why))
    if not data.factors:
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


def judge(
    hypotheses: Sequence[Hypothesis], measures: Sequence[MeasureStatistics], alpha: float, correction: Correction
) -> tuple[HypothesisOutcome, ...]:
    """Return the outcome of each hypothesis; p-values are adjusted for the number of hypotheses that were tested."""
    by_name = {measure.name: measure for measure in measures}
    effects = [_effect(hypothesis, by_name.get(hypothesis.measure)) for hypothesis in hypotheses]
    tested = [effect.p_value for effect in effects if effect is not None and effect.p_value is not None]
    after = iter(adjusted(tested, correction))
    outcomes = []
    for hypothesis, effect in zip(hypotheses, effects, strict=True):
        if effect is None or effect.p_value is None:
            why = _reason(hypothesis, by_name.get(hypothesis.measure))
            outcomes.append(HypothesisOutcome(hypothesis, None, None, None, f"It could not be tested: {why}"))
        else:
            outcomes.append(_outcome(hypothesis, effect, effect.p_value, next(after), alpha))
    return tuple(outcomes)


def _effect(hypothesis: Hypothesis, measure: MeasureStatistics | None) -> Effect | None:
    if measure is None or measure.test is None:
        return None
    return next((each for each in measure.test.effects if set(each.factors) == set(hypothesis.factors)), None)


def _outcome(
    hypothesis: Hypothesis, effect: Effect, p_value: float, adjusted_p_value: float, alpha: float
) -> HypothesisOutcome:
    is_supported = adjusted_p_value < alpha
    verdict = "The data support it" if is_supported else "The data do not support it, which is no proof of the contrary"
    conclusion = f"{verdict} ({p_in_words(adjusted_p_value)} after correction). {effect.conclusion}"
    return HypothesisOutcome(hypothesis, p_value, adjusted_p_value, is_supported, conclusion)


def _reason(hypothesis: Hypothesis, measure: MeasureStatistics | None) -> str:
    if measure is None:
        return f"there is no measure {hypothesis.measure}."
    if measure.test is None:
        return measure.not_computed[0].why if measure.not_computed else "there is no test."
    return f"the test has no effect of {' x '.join(hypothesis.factors)}."


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
    keeps_plan = plan is not None and (chosen_alpha, chosen_correction) == (plan.alpha, plan.correction)
    planned = plan.measures if plan is not None and keeps_plan else ()
    design = design_of(results)
    computed = tuple(
        measure_statistics(design, name, alpha=chosen_alpha, correction=chosen_correction, is_planned=name in planned)
        for name in _chosen(results, measures, planned)
    )
    numeric = [data for each in computed if each.overall and (data := design.data(each.name)) is not None]
    correlations, missing = correlations_of(numeric[:_MOST_CORRELATED], chosen_correction)
    hypotheses = plan.hypotheses if plan is not None and keeps_plan else ()
    return ExperimentStatistics(
        alpha=chosen_alpha,
        correction=chosen_correction,
        is_planned=keeps_plan,
        design=design.summary(),
        measures=computed,
        correlations=correlations,
        hypotheses=judge(hypotheses, computed, chosen_alpha, chosen_correction),
        warnings=tuple(_warnings(design, computed)),
        not_computed=(*missing, *_not_correlated(numeric)),
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
