"""The summary for readers in a hurry, the table of means, and the section on how to replicate the experiment."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from operator import itemgetter
from typing import TYPE_CHECKING

from robot_runner.analysis.report.blocks import (
    Block,
    Card,
    Cards,
    Cell,
    Code,
    Facts,
    Paragraph,
    Remark,
    Remarks,
    Section,
    Table,
    Tone,
)
from robot_runner.analysis.report.material import ALL_RUNS, JOINT, Material
from robot_runner.analysis.report.tables import Field, build_table, field, text
from robot_runner.analysis.statistics.families import NO_PROOF
from robot_runner.analysis.statistics.outcome import Description, MeasureStatistics, Proportion
from robot_runner.analysis.statistics.robustness import gathered
from robot_runner.analysis.wording import MISSING, TIMES, digits_beside, listed, p_values_in_words, shown_number
from robot_runner.core.storage.cells import RunStatus

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.tested import Effect

#: The most interactions not shown, and the most conclusions with the same verdict, that are listed one by one.
_MOST_UNSHOWN = 2

_CONTENTS = (
    ("run_table.csv", "all runs with their treatments and measures; run_table.schema.json says what each column means"),
    ("runs/", "the raw measures and the log of each run"),
    ("config/", "the config and the local modules that it imports, as executed"),
    ("manifest.json", "host, versions, seed, and what was set by hand"),
    ("journal.jsonl", "everything that happened, in order"),
)


def summary_section(material: Material, threats: Sequence[Remark]) -> Section:
    """Return the summary section."""
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
    yield Card(f"{done:,} of {total:,}", "runs done", f"{f'{failed:,}' if failed else 'none'} failed{excluded}", tone)
    design = material.statistics.design
    factors = [name for name in material.results.factors if name in {*design.factors, *design.constant_factors}]
    if factors:
        counts = [material.runs[name].nunique() - (name in design.within) for name in factors]
        sizes = f" {TIMES} ".join(map(str, counts))
        yield Card(sizes, _plural(sizes, "treatment"), f"of {listed(factors, shown=3)}")
    if design.used:
        least, most = design.smallest_group, design.largest_group
        size = f"{least:,}" if least == most else f"{least:,} to {most:,}"
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
        of_all = material.statistics.standings
        standings = [each for each in of_all if each.measure == measure.name and not each.statement]
        conclusions = _briefly(measure.name, measure.test.effects)
        conclusion = " ".join([*conclusions, *gathered(standings, most=_MOST_UNSHOWN)])
    return Paragraph(conclusion, lead=measure.name, badges=material.badges(measure))


def _briefly(measure: str, effects: Sequence[Effect]) -> Iterator[str]:
    """Yield the conclusions on effects; of many interactions that are not shown, only their number.

    A design of five factors has 26 interactions, too many for a reader in a hurry.
    """
    unshown = [each for each in effects if len(each.factors) > 1 and each.conclusion.endswith(NO_PROOF)]
    few = len(unshown) <= _MOST_UNSHOWN
    yield from (each.conclusion for each in effects if few or each not in unshown)
    if not few:
        tested = ((each.p_value, each.adjusted_p_value) for each in unshown if each.p_value is not None)
        figures = p_values_in_words(*min(tested, key=itemgetter(0)))
        interactions = sum(len(each.factors) > 1 for each in effects)
        which = f"{len(unshown)} {'other ' * (len(unshown) < interactions)}interactions"
        yield f"The data do not show any of {which} on {measure} (the smallest p-value: {figures}); {NO_PROOF}"
        yield "The tests of each are below."


def replication_section(material: Material) -> Section:
    """Return the section on how to replicate the experiment, and what to compare."""
    name = material.results.folder.name
    if not material.manifest("config", "file"):
        missing = "The folder holds no config: these results were made elsewhere. Their authors know how."
        contents = tuple((file, what) for file, what in _CONTENTS if file != "config/")
        return Section("how-to-replicate", "How to replicate", (Paragraph(missing, Tone.WARNING), Facts(contents)))
    intro = (
        f"Everything that the experiment consists of is in its folder, {name}. These commands execute its config "
        "again, the same runs in the same order, with what was set by hand then, and compare the results with these; "
        "state as the bound what difference would not matter."
    )
    blocks: list[Block] = [Paragraph(intro), Code(_commands(material, name)), Paragraph(_order(material), Tone.NOTE)]
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
    return f"The seed {seed} was drawn; replicating takes the same one, so that the order of the runs will be the same."


_MOST_GROUPS = 6


def means_table(material: Material, name: str) -> Iterator[Table]:
    """Yield a table of the means of all measures, if there are few enough treatments."""
    described = {measure.name: measure.proportions or measure for measure in material.statistics.measures}
    groups: dict[str, dict[str, Description | Proportion]] = {
        name: {each.label: each for each in of.by_combination or of.by_treatment or (of.overall,)}
        for name, of in described.items()
        if of.overall is not None and of.overall.n
    }
    order = dict.fromkeys((*material.order, ALL_RUNS))
    names = [name for name in order if any(name in each for each in groups.values())]
    if not 1 <= len(names) <= _MOST_GROUPS:
        return

    def means(treatment: str) -> Field:
        return field(treatment, lambda measure: _mean(groups[measure].get(treatment)), is_number=True)

    are_answers = {isinstance(each, Proportion) for of in groups.values() for each in of.values()}
    what = "Means and proportions" if len(are_answers) > 1 else "Proportions" if True in are_answers else "Means"
    caption = f"{what} of all runs." if names == [ALL_RUNS] else f"{what} by {JOINT.join(material.factors)}."
    without = any(measure.left_out for measure in material.statistics.measures)
    runs = f"runs that are done{', but for values that the analysis leaves out,' if without else ''}"
    note = f"Mean of the {runs} and their standard deviation (± SD)." if False in are_answers else ""
    if True in are_answers:
        note = f"{note} Of a measure that is yes or no, how many of the {runs} say yes.".strip()
    yield build_table(name, caption, groups, (text("Measure", material.results.label), *map(means, names)), note)


def _mean(group: Description | Proportion | None) -> Cell:
    if isinstance(group, Proportion):
        told = MISSING if group.percent is None else f"{shown_number(group.percent)} % ({group.count} of {group.n})"
        return Cell(group.percent, told)
    if group is None or group.mean is None:
        return Cell(None, MISSING)
    spread = "" if group.sd is None else f" ± {shown_number(group.sd, 2)}"
    return Cell(group.mean, f"{shown_number(group.mean, digits_beside(group.mean, group.sd))}{spread}")
