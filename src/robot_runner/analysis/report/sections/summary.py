"""The report in brief: what a reader should know who reads nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.analysis.report.blocks import (
    Block,
    Card,
    Cards,
    Cell,
    Column,
    Paragraph,
    Remark,
    Remarks,
    Section,
    Table,
    Tone,
)
from robot_runner.analysis.report.material import JOINT, origin_badges
from robot_runner.analysis.report.numbers import MISSING, TIMES, listed, shown_number
from robot_runner.storage.run_status import RunStatus

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from robot_runner.analysis.report.blocks import Remark as Threat
    from robot_runner.analysis.report.material import Material
    from robot_runner.analysis.statistics.outcome import Description, MeasureStatistics

__all__ = ["summary_section"]

_MOST_GROUPS = 6


def summary_section(material: Material, threats: Sequence[Threat]) -> Section:
    """Return the section.

    Args:
        material: what the report is about.
        threats: those of the section on validity.
    """
    blocks: list[Block] = [Cards(tuple(_cards(material, threats)))]
    if material.results.is_running:
        blocks.append(_still_running())
    blocks += _means(material)
    hypotheses = material.statistics.hypotheses
    blocks += [Paragraph(each.conclusion, Tone.GOOD, lead=each.hypothesis.statement) for each in hypotheses]
    blocks += map(_conclusion, material.statistics.measures)
    return Section("in-brief", "In brief", tuple(blocks))


def _means(material: Material) -> Iterator[Block]:
    """Yield the means of all measures beside each other, where there are few enough treatments."""
    groups = {
        measure.name: {each.label: each for each in measure.by_combination or measure.by_treatment}
        for measure in material.statistics.measures
        if measure.overall is not None and measure.overall.n
    }
    names = [name for name in material.order if any(name in described for described in groups.values())]
    if not groups or not 1 < len(names) <= _MOST_GROUPS:
        return
    columns = (Column("Measure"), *(Column(name, is_number=True) for name in names))
    rows = tuple(
        (Cell.of_text(material.results.label(measure)), *(_mean(described.get(name)) for name in names))
        for measure, described in groups.items()
    )
    note = "Mean of the runs that are done, and their standard deviation (± SD)."
    yield Table("means", f"Means by {JOINT.join(material.results.factors)}.", columns, rows, note)


def _mean(group: Description | None) -> Cell:
    if group is None or group.mean is None:
        return Cell(None, MISSING)
    spread = "" if group.sd is None else f" ± {shown_number(group.sd, 2)}"
    return Cell(group.mean, f"{shown_number(group.mean)}{spread}")


def _still_running() -> Remarks:
    text = "Somebody executes it at this moment: this report is of the runs that were done when it was made."
    return Remarks((Remark("The experiment is not over", text, Tone.WARNING, "Note"),))


def _cards(material: Material, threats: Sequence[Threat]) -> Iterator[Card]:
    counts, total = material.counts, len(material.runs)
    failed = counts[RunStatus.FAILED]
    yield Card(
        f"{counts[RunStatus.DONE]:,} of {total:,}",
        "runs done",
        f"{failed:,} failed" if failed else "none failed",
        Tone.BAD if failed else Tone.GOOD if counts[RunStatus.DONE] == total else Tone.WARNING,
    )
    design = material.statistics.design
    factors = material.results.factors
    if factors:
        sizes = f" {TIMES} ".join(str(material.runs[name].nunique()) for name in factors)
        yield Card(sizes, "treatment" if sizes == "1" else "treatments", f"of {listed(factors, shown=3)}")
    if design.used:
        size = (
            f"{design.smallest_group:,}"
            if design.is_balanced
            else f"{design.smallest_group:,} to {design.largest_group:,}"
        )
        yield Card(size, "run each" if size == "1" else "runs each", "of a combination")
    measures = material.results.measures
    yield Card(f"{len(measures):,}", "measures" if len(measures) != 1 else "measure", listed(measures, shown=3))
    serious = sum(threat.tone in {Tone.WARNING, Tone.BAD} for threat in threats)
    yield Card(
        f"{len(threats):,}",
        "threats to validity noticed" if len(threats) != 1 else "threat to validity noticed",
        f"{serious:,} of weight",
        Tone.WARNING if serious else Tone.PLAIN,
    )


def _conclusion(measure: MeasureStatistics) -> Paragraph:
    if measure.test is None:
        why = measure.not_computed[0].why if measure.not_computed else "there is nothing to compare"
        text = f"Not tested: {why[:1].lower()}{why[1:].rstrip('.')}."
    else:
        text = " ".join(effect.conclusion for effect in measure.test.effects)
    return Paragraph(text, lead=measure.name, badges=origin_badges(measure.origin))
