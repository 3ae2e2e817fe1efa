"""The statistics of a whole experiment."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.analysis.statistics.correlations import correlations_of
from robot_runner.analysis.statistics.described import NotComputed
from robot_runner.analysis.statistics.design import design_of
from robot_runner.analysis.statistics.hypotheses import judge
from robot_runner.analysis.statistics.measure import measure_statistics
from robot_runner.analysis.statistics.outcome import ExperimentStatistics
from robot_runner.analysis.wording import counted
from robot_runner.design.analysis_plan import Correction
from robot_runner.errors import AnalysisError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from robot_runner.analysis.results import Results
    from robot_runner.analysis.statistics.design import Design
    from robot_runner.analysis.statistics.outcome import MeasureStatistics

__all__ = ["analyse"]

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
