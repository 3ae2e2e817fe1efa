"""Threats to validity that the tool itself noticed, by the four kinds of Wohlin et al. (the paper's reference 9)."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from robot_runner.analysis.figures.effects import draw_run_order
from robot_runner.analysis.report.blocks import Block, FigureBlock, Gallery, Paragraph, Remark, Remarks, Section, Tone
from robot_runner.analysis.report.material import origin_badges
from robot_runner.analysis.report.numbers import RHO, listed, shown_number
from robot_runner.analysis.report.outcome_section import failures_in_words
from robot_runner.analysis.wording import counted
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.layout import ExperimentFolder

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from robot_runner.analysis.report.material import Material
    from robot_runner.analysis.statistics.outcome import Drift, MeasureStatistics

__all__ = ["threats_of", "threats_section"]

_CONCLUSION = "Conclusion validity"
_INTERNAL = "Internal validity"
_CONSTRUCT = "Construct validity"
_EXTERNAL = "External validity"

_NUMBER = re.compile(r"\d+(?:[.,]\d+)*")
_LOW_POWER = 0.8
_FEW = 5


def threats_section(material: Material, threats: Sequence[Remark]) -> Section:
    """Return the section.

    Args:
        material: what the report is about.
        threats: as `threats_of` found them.
    """
    intro = (
        "What the tool noticed by itself, by the kinds of Wohlin et al., Experimentation in Software Engineering. It "
        "does not know the study: other threats are for its authors to name."
    )
    blocks: list[Block] = [Paragraph(intro, Tone.NOTE)]
    blocks.append(Remarks(tuple(threats)) if threats else Paragraph("Nothing was noticed.", Tone.GOOD))
    figures = tuple(
        _drift_figure(material, measure, measure.drift)
        for measure in material.statistics.measures
        if measure.drift is not None and (measure.name in material.drawn or measure.drift.is_significant)
    )
    if figures:
        blocks.append(
            Paragraph("Residuals over the order of execution show whether battery or room drifted.", Tone.NOTE)
        )
        blocks.append(Gallery(figures))
    return Section("threats-to-validity", "Threats to validity", tuple(blocks))


def threats_of(material: Material) -> tuple[Remark, ...]:
    """Return all threats, those of one kind together."""
    found = [*_conclusion(material), *_internal(material), *_construct(material), *_external(material)]
    return tuple(found)


def _conclusion(material: Material) -> Iterator[Remark]:
    statistics = material.statistics
    design = statistics.design
    if design.used and design.factors and not design.is_balanced:
        none = f"; {counted(design.empty_combinations, 'combination')} without any" if design.empty_combinations else ""
        text = f"Combinations have {design.smallest_group:,} to {design.largest_group:,} runs{none}."
        yield Remark("Groups are not equally large", text, Tone.NOTE, _CONCLUSION)
    if material.manifest("analysis_changes"):
        text = "It was changed after runs had been executed: only its first version counts as planned."
        yield Remark("The plan of the analysis was changed", text, Tone.WARNING, _CONCLUSION)
    if statistics.design.used and statistics.design.smallest_group < _FEW:
        size = counted(statistics.design.smallest_group, "run")
        text = f"The smallest group has {size}: intervals are wide, and assumptions can hardly be checked."
        yield Remark("Few repetitions", text, Tone.WARNING, _CONCLUSION)
    weak = [measure for measure in statistics.measures if _is_weak(measure)]
    if weak:
        powers = ", ".join(f"{each.name} {each.power.achieved_power:.2f}" for each in weak if each.power is not None)
        text = (
            f"No effect was found, and the power for effects as large as the observed ones is below {_LOW_POWER} "
            f"({powers}). That no effect was found does not mean that there is none."
        )
        yield Remark("Low power", text, Tone.WARNING, _CONCLUSION)
    if not statistics.is_planned and statistics.measures:
        text = "Measures and tests were chosen after the fact: p-values are those of an exploration."
        yield Remark("Nothing was fixed beforehand", text, Tone.NOTE, _CONCLUSION)
    missed = [*statistics.not_computed, *(each for measure in statistics.measures for each in measure.not_computed)]
    if missed:
        yield Remark("Not everything could be computed", listed(each.what for each in missed), Tone.NOTE, _CONCLUSION)


def _is_weak(measure: MeasureStatistics) -> bool:
    if measure.power is None or measure.test is None:
        return False
    found = any(effect.is_significant for effect in measure.test.effects)
    return not found and measure.power.achieved_power < _LOW_POWER


def _internal(material: Material) -> Iterator[Remark]:
    for measure in material.statistics.measures:
        if measure.drift is not None and measure.drift.warning:
            tone = Tone.BAD if measure.drift.is_confounded else Tone.WARNING
            yield Remark(f"{measure.name} drifts over the experiment", measure.drift.warning, tone, _INTERNAL)
    design = material.manifest("design", default={})
    if "shuffle" in design and not design["shuffle"] and design.get("source") != "run_table.csv":
        text = (
            "Runs were executed in the order in which they were written; what changes with time may pass for an effect."
        )
        yield Remark("The order was not randomised", text, Tone.WARNING, _INTERNAL)
    yield from _unfinished(material)
    yield from _circumstances(material)
    yield from _odd(material)
    yield from _gaps(material)


def _unfinished(material: Material) -> Iterator[Remark]:
    failed = material.counts[RunStatus.FAILED]
    if failed:
        reasons = " ".join(f"{runs}: {reason}" for runs, reason in failures_in_words(material))
        text = f"{counted(failed, 'run')} failed and {'is' if failed == 1 else 'are'} not in the statistics. {reasons}"
        yield Remark("Runs failed", text, Tone.BAD, _INTERNAL)
    left = material.counts[RunStatus.TODO] + material.counts[RunStatus.RUNNING]
    if left:
        text = f"{counted(left, 'run')} of {len(material.runs):,} {'is' if left == 1 else 'are'} still to do."
        yield Remark("The experiment is not complete", text, Tone.WARNING, _INTERNAL)
    attempts = material.results.attempts
    again = list(attempts.loc[attempts["attempt"] > 1, "run_id"].unique())
    if again:
        text = f"{listed(again)}: results are those of the last attempt, at another time than planned."
        yield Remark("Runs were executed more than once", text, Tone.NOTE, _INTERNAL)
    for name in material.results.measures:
        missing = int(material.done[name].isna().sum())
        if missing:
            text = f"No value in {missing:,} of {counted(len(material.done), 'run')} that are done."
            yield Remark(f"{name} has missing values", text, Tone.WARNING, _INTERNAL)


def _circumstances(material: Material) -> Iterator[Remark]:
    executions = material.manifest("executions", default=[])
    if len(executions) > 1:
        text = f"The experiment was executed in {len(executions)} parts; circumstances may have changed between them."
        yield Remark("Executed in parts", text, Tone.NOTE, _INTERNAL)
    if ExperimentFolder(material.results.folder).earlier_configs.is_dir():
        text = "Configs that were executed before are in earlier_configs/: see what changed, and for which runs."
        yield Remark("The config changed on the way", text, Tone.WARNING, _INTERNAL)
    deviations: dict[str, object] = dict(material.manifest("deviations", default={}))
    for execution in executions:
        deviations |= execution.get("deviations") or {}
    if deviations:
        shown = listed((f"{name} = {value}" for name, value in deviations.items()), shown=20)
        text = f"Set on the command line, against what the config says: {shown}."
        yield Remark("Parameters were set by hand", text, Tone.NOTE, _INTERNAL)


def _odd(material: Material) -> Iterator[Remark]:
    """Yield what plugins found odd; what differs in numbers alone is said once."""
    groups: dict[tuple[str, str], list[tuple[str, str, str]]] = {}
    frame = material.results.odd
    for run, owner, problem, fix in frame[["run_id", "owner", "problem", "fix"]].itertuples(index=False):
        key = (str(owner), _NUMBER.sub("#", str(problem)))
        groups.setdefault(key, []).append((str(run), str(problem), str(fix or "")))
    for (owner, _), members in groups.items():
        runs = listed(dict.fromkeys(run for run, _, _ in members))
        alike = "" if len({problem for _, problem, _ in members}) == 1 else ", and the like"
        text = f"{members[0][1]}{alike} ({runs}). {members[0][2]}".strip()
        yield Remark(f"{owner} noticed", f"{text[:1].upper()}{text[1:]}", Tone.WARNING, _INTERNAL)
    for finding in material.results.findings:
        yield Remark("The run table's file", f"{finding.problem}. {finding.fix}".strip(), Tone.NOTE, _INTERNAL)


def _gaps(material: Material) -> Iterator[Remark]:
    incomplete = [each for each in material.qualities if not each.is_complete]
    for plugin in dict.fromkeys(each.plugin for each in incomplete):
        mine = [each for each in incomplete if each.plugin == plugin]
        least = min((each.coverage for each in mine if each.coverage is not None), default=None)
        lost = sum(each.lost or 0 for each in mine)
        damaged = sum(each.corrupt or 0 for each in mine)
        covered = "" if least is None else f"; at the least {shown_number(least, 3)} % of the time is covered"
        text = f"{listed(each.run_id for each in mine)}: {lost:,} samples lost, {damaged:,} damaged{covered}."
        yield Remark(f"Samples of {plugin} have gaps", text, Tone.WARNING, _INTERNAL)


def _construct(material: Material) -> Iterator[Remark]:
    columns = material.results.columns
    by_word: dict[str, list[str]] = {}
    for name in material.results.measures:
        for badge in origin_badges(columns[name].origin):
            by_word.setdefault(badge.text, []).append(name)
    for word, names in by_word.items():
        whose = "simulated sensors" if word == "simulated" else "an estimating model"
        text = (
            f"{listed(names)} {'comes' if len(names) == 1 else 'come'} from {whose}: not evidence about a real robot."
        )
        yield Remark(f"Values are {word}", text, Tone.WARNING, _CONSTRUCT)
    saturated = [each for each in material.qualities if each.saturated]
    for plugin in dict.fromkeys(each.plugin for each in saturated):
        mine = [each for each in saturated if each.plugin == plugin]
        count = sum(each.saturated or 0 for each in mine)
        runs = listed(each.run_id for each in mine)
        text = f"{counted(count, 'sample')} reached the end of the sensor's range ({runs})."
        yield Remark(f"{plugin} was saturated", text, Tone.WARNING, _CONSTRUCT)


def _external(material: Material) -> Iterator[Remark]:
    constant = material.statistics.design.constant_factors
    if constant:
        text = f"{listed(constant)} had one treatment only among the runs that are done."
        yield Remark("Factors were not varied", text, Tone.NOTE, _EXTERNAL)


def _drift_figure(material: Material, measure: MeasureStatistics, drift: Drift) -> FigureBlock:
    labels = [material.labels[run_id] for run_id in drift.run_ids]
    return FigureBlock(
        f"order {measure.name}",
        f"{measure.name} over the order of execution: each run less the mean of its combination. Dashed: slope of "
        f"Theil and Sen, {shown_number(drift.slope, 3)} {measure.unit} a run "
        f"(Spearman's {RHO} = {shown_number(drift.correlation, 3)}).",
        f"Residuals of {measure.name} over the order of execution.",
        lambda: draw_run_order(
            drift.places,
            drift.residuals,
            labels,
            order=material.order,
            value_label=material.results.label(measure.name),
            slope=drift.slope,
        ),
    )
