"""The report in brief: what a reader should know who reads nothing else."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from robot_runner.analysis.report.blocks import (
    Block,
    Card,
    Cards,
    Cell,
    Code,
    Column,
    Facts,
    Paragraph,
    Remark,
    Remarks,
    Section,
    Table,
    Tone,
)
from robot_runner.analysis.report.material import JOINT, origin_badges
from robot_runner.analysis.report.numbers import MISSING, TIMES, listed, shown_number
from robot_runner.core.storage.cells import RunStatus

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from robot_runner.analysis.report.blocks import Remark as Threat
    from robot_runner.analysis.report.material import Material
    from robot_runner.analysis.statistics.outcome import Description, MeasureStatistics

__all__ = ["replication_section", "summary_section"]


# How to replicate the experiment, and what to compare.


def replication_section(material: Material) -> Section:
    """Return the section."""
    name = material.results.folder.name
    blocks: list[Block] = [Paragraph(_intro(material))]
    if material.manifest("config", "file"):
        blocks.append(Code("\n".join(_commands(material, name))))
        blocks.append(Paragraph(_order(material), Tone.NOTE))
    else:
        text = "The folder holds no config: these results were made elsewhere. Their authors know how."
        blocks.append(Paragraph(text, Tone.WARNING))
    blocks.append(Facts(tuple(_contents())))
    return Section("how-to-replicate", "How to replicate", tuple(blocks))


def _intro(material: Material) -> str:
    return (
        f"Everything that the experiment consists of is in its folder, {material.results.folder.name}. This executes "
        "its config again, the same runs in the same order, with what was set by hand then, and compares the results "
        "with these; state as the bound what difference would not matter."
    )


def _commands(material: Material, name: str) -> Iterator[str]:
    version = material.manifest("software", "robot_runner")
    pinned = f"=={version}" if version else ""
    robot = str(material.manifest("robot", default=""))
    extras = "analysis,sim" if robot.startswith("simulated") else "analysis"
    yield f"pip install {shlex.quote(f'robot-runner[{extras}]{pinned}')}"
    yield f"robot-runner replicate {shlex.quote(name)} --bound 5%"
    yield ""
    yield "# One file that others can check and replicate"
    yield f"pip install {shlex.quote(f'robot-runner[replication]{pinned}')}"
    yield f"robot-runner pack {shlex.quote(name)}"
    yield f"robot-runner replicate {shlex.quote(f'{name}.zip')} --bound 5%"


def _order(material: Material) -> str:
    seed = material.results.seed
    if seed is None:
        return "The order of the runs comes from no recorded seed: it is in the run table, and is taken from there."
    if material.manifest("seed_is_given"):
        return f"The config gives seed {seed}: the order of the runs will be the same."
    return f"The order was drawn (seed {seed}); replicating takes the same seed, so that the order will be the same."


def _contents() -> Iterator[tuple[str, str]]:
    yield (
        "run_table.csv",
        "all runs with their treatments and measures; run_table.schema.json says what each column means",
    )
    yield "runs/", "the raw measures and the log of each run"
    yield "config/", "the config and the local modules that it imports, as executed"
    yield "manifest.json", "host, versions, seed, and what was set by hand"
    yield "journal.jsonl", "everything that happened, in order"


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
