"""The statistics of a whole experiment: of each measure, and of the preregistered hypotheses."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from robot_runner.analysis.results import Results, results_of
from robot_runner.analysis.run_frame import require_choice, several
from robot_runner.analysis.statistics.analysed_design import Design, design_of
from robot_runner.analysis.statistics.correlations import correlations_of
from robot_runner.analysis.statistics.disclosed import Beside, LeftOut, Reason, runs_without_value
from robot_runner.analysis.statistics.execution_order import displaced_runs, followed_failures, robot_warnings
from robot_runner.analysis.statistics.families import concluded
from robot_runner.analysis.statistics.left_out import MOST_FALSE_POSITIVES, doubtful_values, left_out_of, rate_in_words
from robot_runner.analysis.statistics.lost_runs import lost_warnings
from robot_runner.analysis.statistics.measure_statistics import measure_statistics
from robot_runner.analysis.statistics.outcome import ExperimentStatistics, MeasureStatistics, Standing
from robot_runner.analysis.statistics.robustness import Otherwise, doubtful_runs, standing_effects, standing_hypotheses
from robot_runner.analysis.statistics.tested import NotComputed
from robot_runner.analysis.statistics.tests import Choices
from robot_runner.analysis.wording import listed
from robot_runner.core.design.analysis_plan import AnalysisPlan, Correction
from robot_runner.core.design.outliers import Doubtful
from robot_runner.core.errors import AnalysisError, did_you_mean
from robot_runner.core.words import counted

_ALPHA = 0.05

#: A progress callback: the name of the step, how many items are done, and the total.
OnStep = Callable[[str, int, int], object]


def unheard(_what: str, _done: int, _total: int) -> None:
    """Ignore progress."""


#: The most measures that are correlated: more have too many pairs to be useful.
_MOST_CORRELATED = 20


def analyse(
    results: Results | Path | str,
    *,
    measures: str | Sequence[str] | None = None,
    alpha: float | None = None,
    correction: Correction | None = None,
    plan: AnalysisPlan | None = None,
    on_step: OnStep = unheard,
) -> ExperimentStatistics:
    """Compute the statistics of an experiment from the runs that are done.

    All values are used. Measures with doubtful values are also analysed without these, to see which conclusions stand.
    Analyses that the plan fixed before the experiment are marked as planned, all others as exploratory. If alpha or the
    correction differs from the plan's, everything is exploratory.

    Args:
        results: of the experiment, or its folder.
        measures: the measures; None for those of the plan, then all others.
        alpha: the level of significance; None for that of the plan, or 0.05.
        correction: of p-values; None for that of the plan, or Holm.
        plan: replaces the plan that was fixed before the experiment, for imported results for example; everything is
            exploratory then.
        on_step: is called with the name of the step, the number of measures that are done, and their total.

    Raises:
        AnalysisError: there is no such measure, alpha is not between 0 and 0.5, there is no such correction, or the
            plan has names that the results lack.

    Example:
        >>> from robot_runner.analysis import analyse, load_results
        >>> analyse(load_results("experiments/basic_experiment")).measure("Energy").test.reason  # doctest: +SKIP
    """
    results = results_of(results).confirming
    is_given = plan is not None
    plan = results.plan if plan is None else _checked(plan, results)
    chosen_alpha = alpha if alpha is not None else plan.alpha if plan else _ALPHA
    chosen_correction = correction or (plan.correction if plan else Correction.HOLM)
    require_choice(chosen_correction, Correction, "correction", "analyse")
    if not 0 < chosen_alpha < 0.5:  # noqa: PLR2004 - 1 - 2 alpha is a level of confidence
        meant = f"Give one below 0.5: {1 - chosen_alpha:.3g} for a confidence of {chosen_alpha:.3g}."
        fix = meant if 0 < chosen_alpha < 1 else "Give a number between 0 and 1."
        raise AnalysisError(f"alpha is {chosen_alpha!r}", where="analyse", fix=fix)
    kept = plan if plan is not None and (chosen_alpha, chosen_correction) == (plan.alpha, plan.correction) else None
    planned = (*kept.measures, *kept.secondary) if kept is not None else ()
    design = design_of(results, blocks=kept.blocks if kept is not None else None)
    choices = Choices(chosen_alpha, chosen_correction)
    if kept is not None:
        choices = replace(choices, estimand=kept.estimand, statistic=kept.statistic)
        design = replace(design, covariates=kept.covariates)
    names = _chosen(results, None if measures is None else several(measures), planned)
    # The error rate is controlled over all primary measures, whichever are requested.
    others = [name for name in (kept.measures if kept else ()) if name in results.columns and name not in names]
    doubtful = doubtful_runs(results)
    analysed: list[_Analysed] = []
    for name in (*names, *others):
        on_step("statistics of measures", len(analysed), len(names) + len(others))
        analysed.append(_analysed(design, name, choices, kept, doubtful.get(name, ())))
    conclude = partial(concluded, plan=kept, alpha=chosen_alpha, correction=chosen_correction)
    done, judged = conclude([each.planned for each in analysed])
    is_planned = kept is not None and not is_given
    told = tuple(replace(each, is_planned=each.is_planned and is_planned) for each in done[: len(names)])
    beside: dict[Beside, tuple[MeasureStatistics, ...]] = {}
    standings: list[Standing] = []
    for which in Beside:
        again = {each.planned.name: each.beside[which] for each in analysed if which in each.beside}
        redone, rejudged = conclude([again.get(each.planned.name, each.planned) for each in analysed])
        beside[which] = tuple(each for each in redone[: len(names)] if each.name in again)
        otherwise = Otherwise(which, {each.planned.name: each.runs[which] for each in analysed}, design.covariates)
        standings += standing_effects(told, beside[which], otherwise)
        both = [pair for pair in zip(done, redone, strict=True) if pair[0].name in again]
        standings += standing_hypotheses(judged, rejudged, otherwise, both)
    measured = replace(design, covariates=())  # a measure adjusted for a covariate would not correlate with it
    correlated = () if results.is_exploratory else told
    known = [(of.name, replace(measured, without=runs_without_value(of.left_out))) for of in correlated if of.overall]
    numeric = [data for name, of in known if (data := of.data(name)) is not None]
    correlations, missing = correlations_of(numeric[:_MOST_CORRELATED], chosen_correction)
    return ExperimentStatistics(
        alpha=chosen_alpha,
        correction=chosen_correction,
        is_planned=is_planned,
        design=design.summary(),
        measures=told,
        correlations=correlations,
        hypotheses=judged,
        warnings=tuple(_warnings(design, told)),
        not_computed=(*missing, *_not_correlated(numeric)),
        without_doubtful=beside[Beside.WITHOUT_DOUBTFUL],
        standings=tuple(standings),
        with_all_runs=beside[Beside.ALL_RUNS],
        without_covariates=beside[Beside.WITHOUT_COVARIATES],
        plan=kept,
    )


def _checked(plan: AnalysisPlan, results: Results) -> AnalysisPlan:
    columns = [name for name in (results.repetition, results.block) if name is not None]
    treatments = {name: list(map(str, results.runs[name].cat.categories)) for name in results.factors}
    findings = [*plan.findings([*results.factors, *columns], results.measures)]
    findings += [each for of in plan.hypotheses for each in of.treatment_findings(treatments) if each.is_error]
    AnalysisError.refuse(findings)
    return plan


class _Analysed(NamedTuple):
    """The planned analysis of a measure, and its sensitivity analyses, with the runs that each leaves out or adds."""

    planned: MeasureStatistics
    beside: dict[Beside, MeasureStatistics]
    runs: dict[Beside, tuple[str, ...]]


def _analysed(
    design: Design, name: str, choices: Choices, plan: AnalysisPlan | None, doubtful: Sequence[str]
) -> _Analysed:
    """Compute the planned analysis of a measure, and its sensitivity analyses."""
    left_out = left_out_of(design, name, plan, doubtful)

    def compute(design: Design, left_out: Sequence[LeftOut]) -> MeasureStatistics:
        return measure_statistics(design, name, choices, plan=plan, left_out=left_out)

    planned = compute(design, left_out)
    gone = tuple(each.run_id for each in left_out)
    doubted = tuple(run_id for run_id in doubtful if run_id not in gone)
    runs = {Beside.WITHOUT_DOUBTFUL: doubted, Beside.ALL_RUNS: gone, Beside.WITHOUT_COVARIATES: ()}
    beside = {}
    if planned.test is not None or planned.left_out:
        if doubted:
            beside[Beside.WITHOUT_DOUBTFUL] = compute(design, (*left_out, *doubtful_values(design, name, doubted)))
        if gone:
            beside[Beside.ALL_RUNS] = compute(design, ())
    if design.covariates and name not in design.covariates and planned.overall is not None:
        beside[Beside.WITHOUT_COVARIATES] = compute(replace(design, covariates=()), left_out)
    if plan is not None and plan.doubtful is Doubtful.REFUSE and doubted:
        beside.setdefault(Beside.ALL_RUNS, planned)
        why = f"the plan draws no conclusion on a measure with doubtful values ({listed(doubted)})."
        planned = _refused(planned, why)
    if design.results.is_exploratory:
        return _Analysed(replace(_refused(planned, SEARCHED), power=None, drift=None), {}, runs)
    return _Analysed(planned, beside, runs)


#: The reason why runs of a search are not tested.
SEARCHED = (
    "the design decided on the runs from their results: they are exploratory, and the best of many looks better than "
    "it is. Plan confirm=10, say, for runs that are tested."
)


def _refused(measure: MeasureStatistics, why: str) -> MeasureStatistics:
    """Return a measure without tests; its descriptions stay."""
    missing = (NotComputed("the test", why), *measure.not_computed)
    return replace(measure, test=None, post_hoc=(), contrasts=(), adjustment=None, not_computed=missing)


def _chosen(results: Results, measures: Sequence[str] | None, planned: Sequence[str]) -> list[str]:
    if measures is None:
        present = [name for name in planned if name in results.columns]
        return list(dict.fromkeys([*present, *results.measures]))
    for name in measures:
        if name not in results.measures:
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
    yield from order_warnings(design.results)
    yield from robot_warnings(design.results, summary)
    for measure in measures:
        if measure.drift is not None and measure.drift.warning:
            yield measure.drift.warning
        yield from planned_warnings(measure)
    if summary.left_out:
        is_one = summary.left_out == 1
        yield f"{counted(summary.left_out, 'run')} of the table {'is' if is_one else 'are'} not done and left out."
    yield from lost_warnings(design.results, summary, [measure.name for measure in measures])
    if summary.factors and not summary.is_balanced:
        least, most = summary.smallest_group, summary.largest_group
        sizes = f"{least} to {most} runs" if least < most else f"{counted(least, 'run')} each"
        yield (
            f"The combinations have {sizes}"
            f"{f', and {summary.lacking_combinations} have none' if summary.lacking_combinations else ''}."
        )
    if design.results.manifest.get("design", {}).get("shuffle") is False and summary.factors:
        yield "The order of the runs was not randomised: whatever changes with time may pass for an effect."
    if design.results.manifest.get("analysis_changes"):
        yield "The analysis plan was changed after runs had been executed: only the first version counts as planned."


def order_warnings(results: Results) -> Iterator[str]:
    """Yield warnings on runs that were executed out of the order of the design, or after failed attempts."""
    if displaced := displaced_runs(results):
        were, are = ("was", "is") if len(displaced) == 1 else ("were", "are")
        runs = listed([f"{run_id} ({why})" for run_id, why in displaced.items()])
        yield (
            f"{counted(len(displaced), 'run')} {were} executed out of the order that the design holds, so that its "
            f"model does not fit, and {are} left out: {runs}."
        )
    if followed := followed_failures(results):
        pairs = [f"{run_id} after {before}" for run_id, before in followed.items()]
        yield (
            f"{counted(len(followed), 'run')} followed an attempt that failed, so that what is carried over from the "
            f"treatment before may be less than it takes: {listed(pairs)}."
        )


def planned_warnings(measure: MeasureStatistics) -> Iterator[str]:
    """Yield warnings on the covariates and on the outlier rule of the plan."""
    if measure.adjustment is not None:
        yield from measure.adjustment.warnings
    lacking = [each.run_id for each in measure.left_out if each.reason is Reason.COVARIATE]
    if lacking:
        yield (
            f"{measure.name} is compared without {counted(len(lacking), 'run')} of which a covariate is missing "
            f"({listed(lacking)}); descriptions have {'it' if len(lacking) == 1 else 'them'}."
        )
    rate = measure.rule_false_positives
    if rate is not None and rate > MOST_FALSE_POSITIVES:
        outliers = [each.run_id for each in measure.left_out if each.reason is Reason.OUTLIER]
        yield f"{measure.name} is analysed without {counted(len(outliers), 'outlier')}: {rate_in_words(rate)}"
