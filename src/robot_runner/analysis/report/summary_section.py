"""The sections in brief, for readers in a hurry, and on how to replicate the experiment."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from robot_runner.analysis.report.blocks import (
    Block,
    Card,
    Cards,
    Code,
    Facts,
    Paragraph,
    Remark,
    Remarks,
    Section,
    Tone,
)
from robot_runner.analysis.report.means_table import means_table
from robot_runner.analysis.wording import TIMES, listed
from robot_runner.core.storage.cells import RunStatus

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from robot_runner.analysis.report.material import Material
    from robot_runner.analysis.statistics.outcome import MeasureStatistics

__all__ = ["replication_section", "summary_section"]

_CONTENTS = (
    ("run_table.csv", "all runs with their treatments and measures; run_table.schema.json says what each column means"),
    ("runs/", "the raw measures and the log of each run"),
    ("config/", "the config and the local modules that it imports, as executed"),
    ("manifest.json", "host, versions, seed, and what was set by hand"),
    ("journal.jsonl", "everything that happened, in order"),
)


def summary_section(material: Material, threats: Sequence[Remark]) -> Section:
    """Return the section.

    Args:
        material: what the report is about.
        threats: those of the section on validity.
    """
    blocks: list[Block] = [Cards(tuple(_cards(material, threats)))]
    if material.results.is_running:
        note = "The experiment is being executed: this report is of the runs that were done when it was made."
        blocks.append(Remarks((Remark("The experiment is not over", note, Tone.WARNING, "Note"),)))
    blocks += means_table(material, "means")
    hypotheses = material.statistics.hypotheses
    blocks += [Paragraph(each.conclusion, Tone.GOOD, lead=each.hypothesis.statement) for each in hypotheses]
    blocks += [_conclusion(material, measure) for measure in material.statistics.measures]
    return Section("in-brief", "In brief", tuple(blocks))


def _cards(material: Material, threats: Sequence[Remark]) -> Iterator[Card]:
    excluded = f", {len(material.excluded):,} excluded" if len(material.excluded) else ""
    total, done, failed = len(material.runs), material.counts[RunStatus.DONE], material.counts[RunStatus.FAILED]
    tone = Tone.BAD if failed else Tone.GOOD if done == total else Tone.WARNING
    yield Card(
        f"{done:,} of {total:,}",
        "runs done",
        f"{failed:,} failed{excluded}" if failed else f"none failed{excluded}",
        tone,
    )
    factors, design = material.results.factors, material.statistics.design
    if factors:
        sizes = f" {TIMES} ".join(str(material.runs[name].nunique()) for name in factors)
        yield Card(sizes, _plural(sizes, "treatment"), f"of {listed(factors, shown=3)}")
    if design.used:
        largest = "" if design.is_balanced else f" to {design.largest_group:,}"
        size = f"{design.smallest_group:,}{largest}"
        yield Card(size, f"{_plural(size, 'run')} each", "of a combination")
    measures = material.results.measures
    yield Card(f"{len(measures):,}", _plural(str(len(measures)), "measure"), listed(measures, shown=3))
    serious = sum(threat.tone in {Tone.WARNING, Tone.BAD} for threat in threats)
    label = f"{_plural(str(len(threats)), 'threat')} to validity noticed"
    tone = Tone.WARNING if serious else Tone.PLAIN
    yield Card(f"{len(threats):,}", label, f"{serious:,} of weight", tone)


def _plural(count: str, noun: str) -> str:
    return noun if count == "1" else f"{noun}s"


def _conclusion(material: Material, measure: MeasureStatistics) -> Paragraph:
    if measure.test is None:
        why = measure.not_computed[0].why if measure.not_computed else "there is nothing to compare"
        conclusion = f"Not tested: {why[:1].lower()}{why[1:].rstrip('.')}."
    else:
        standings = [each for each in material.statistics.standings if each.measure == measure.name]
        conclusions = [effect.conclusion for effect in measure.test.effects]
        conclusion = " ".join([*conclusions, *(each.conclusion for each in standings if not each.statement)])
    return Paragraph(conclusion, lead=measure.name, badges=material.badges(measure))


def replication_section(material: Material) -> Section:
    """Return the section on how to replicate the experiment, and what to compare."""
    name = material.results.folder.name
    intro = (
        f"Everything that the experiment consists of is in its folder, {name}. These commands execute its config "
        "again, the same runs in the same order, with what was set by hand then, and compare the results with these; "
        "state as the bound what difference would not matter."
    )
    blocks: list[Block] = [Paragraph(intro)]
    if material.manifest("config", "file"):
        blocks += [Code(_commands(material, name)), Paragraph(_order(material), Tone.NOTE)]
    else:
        missing = "The folder holds no config: these results were made elsewhere. Their authors know how."
        blocks.append(Paragraph(missing, Tone.WARNING))
    blocks.append(Facts(_CONTENTS))
    return Section("how-to-replicate", "How to replicate", tuple(blocks))


def _commands(material: Material, name: str) -> str:
    version = material.manifest("software", "robot_runner")
    pinned = f"=={version}" if version else ""
    extras = "analysis,sim" if str(material.manifest("robot", default="")).startswith("simulated") else "analysis"
    return (
        f"pip install {shlex.quote(f'robot-runner[{extras}]{pinned}')}\n"
        f"robot-runner replicate {shlex.quote(name)} --bound 5%\n"
        "\n"
        "# One file that others can check and replicate\n"
        f"pip install {shlex.quote(f'robot-runner[replication]{pinned}')}\n"
        f"robot-runner pack {shlex.quote(name)}\n"
        f"robot-runner replicate {shlex.quote(f'{name}.zip')} --bound 5%"
    )


def _order(material: Material) -> str:
    seed = material.results.seed
    if seed is None:
        return "The order of the runs comes from no recorded seed: the run table has it, and it is taken from there."
    if material.manifest("seed_is_given"):
        return f"The config gives seed {seed}: the order of the runs will be the same."
    return f"The order was drawn (seed {seed}); replicating takes the same seed, so that the order will be the same."
