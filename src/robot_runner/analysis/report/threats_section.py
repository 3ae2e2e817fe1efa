"""Threats to validity that the tool noticed, by the four kinds of Wohlin et al. (the paper's reference 9)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from robot_runner.analysis.report.blocks import Block, Gallery, Paragraph, Remark, Remarks, Section, Tone
from robot_runner.analysis.report.design_section import shown_stamp
from robot_runner.analysis.report.machine_threats import machine_threats
from robot_runner.analysis.report.material import Material, by_plugin
from robot_runner.analysis.report.measure_figures import drift_figure
from robot_runner.analysis.report.outcome_section import failures_in_words
from robot_runner.analysis.statistics.disclosed import Beside
from robot_runner.analysis.statistics.execution_order import execution_order, robot_warnings
from robot_runner.analysis.statistics.experiment_statistics import order_warnings, planned_warnings
from robot_runner.analysis.statistics.lost_runs import (
    REPEATED,
    failed_by_treatment,
    limits_in_words,
    missing_by_treatment,
    repeated_by_treatment,
    repeats_in_words,
    unsuccessful_in_words,
)
from robot_runner.analysis.statistics.robustness import gathered
from robot_runner.analysis.wording import kind_of, listed, sentence, shown_number
from robot_runner.core.design.columns import EXCLUDED, RUN_ID
from robot_runner.core.events.measure import Quality
from robot_runner.core.secret_names import shown_settings
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.executed_runs import changes_in_words, moved_in_words
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.words import counted, enumerated

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.outcome import MeasureStatistics

    #: The title, text and weight of each threat.
    Threats = Iterator[tuple[str, str, Tone]]

#: The sizes from which an effect is large (Cohen 1988).
_LARGE = {"Cohen's d": 0.8, "Cohen's f": 0.4}
_FEW, _FEW_EFFECTS = 5, 2


def threats_section(material: Material, threats: Sequence[Remark]) -> Section:
    """Return the section on threats to validity."""
    intro = (
        "What the tool noticed by itself, by the kinds of Wohlin et al., Experimentation in Software Engineering. It "
        "does not know the study: other threats are for its authors to name."
    )
    blocks: list[Block] = [Paragraph(intro, Tone.NOTE)]
    blocks.append(Remarks(tuple(threats)) if threats else Paragraph("Nothing was noticed.", Tone.GOOD))
    figures = tuple(
        drift_figure(material, measure, measure.drift)
        for measure in material.statistics.measures
        if measure.drift is not None and (measure.name in material.drawn or measure.drift.warning)
    )
    if figures:
        doubt = "" if execution_order(material.results).is_known else ", which may be another than that of execution,"
        about = f"Residuals over the {material.order_of_runs}{doubt} show whether battery or room drifted."
        blocks += [Paragraph(about, Tone.NOTE), Gallery(figures)]
    return Section("threats-to-validity", "Threats to validity", tuple(blocks))


def threats_of(material: Material) -> tuple[Remark, ...]:
    """Return all threats, grouped by kind."""
    internal = (_drifts, _order, _extended, _excluded, _unfinished, _circumstances, machine_threats, _odd, _gaps)
    kinds = {
        "Conclusion validity": (_groups, _precision, _power, _plan, _registered, _planned_choices, _doubtful),
        "Internal validity": internal,
        "Construct validity": (_unread, _origins, _saturation, _limits),
        "External validity": (_constant_factors,),
    }
    return tuple(
        Remark(title, text, tone, kind)
        for kind, several in kinds.items()
        for find in several
        for title, text, tone in find(material)
    )


def _groups(material: Material) -> Threats:
    design = material.statistics.design
    if design.used and design.factors and not design.is_balanced:
        lacking = design.lacking_combinations
        none = f"; {counted(lacking, 'combination')} without any" if lacking else ""
        least, most = design.smallest_group, design.largest_group
        sizes = f"{least:,} to {most:,} runs" if least < most else f"{counted(least, 'run')} each"
        text = f"Combinations have {sizes}{none}."
        yield "Groups are not equally large", text, Tone.NOTE
    if design.used and design.smallest_group < _FEW:
        size = counted(design.smallest_group, "run")
        text = f"The smallest group has {size}: intervals are wide, and assumptions can hardly be checked."
        yield "Few repetitions", text, Tone.WARNING
    for text in repeats_in_words(material.results, design, material.results.measures):
        yield REPEATED, text, Tone.WARNING


def _plan(material: Material) -> Threats:
    statistics = material.statistics
    if material.manifest("analysis_changes"):
        text = "The plan was changed after runs had been executed: only its first version counts as planned."
        yield "The plan of the analysis was changed", text, Tone.WARNING
    if not statistics.is_planned and statistics.measures and len(material.done):
        text = "Measures and tests were chosen after the fact: p-values are those of an exploration."
        is_fixed = material.results.plan is not None
        yield "The plan was not followed" if is_fixed else "Nothing was fixed beforehand", text, Tone.NOTE
    missed = [*statistics.not_computed, *(each for measure in statistics.measures for each in measure.not_computed)]
    if missed:
        yield "Not everything could be computed", listed(dict.fromkeys(each.what for each in missed)), Tone.NOTE


def _registered(material: Material) -> Threats:
    found = material.registered
    if found is not None and found.problem:
        yield "The registration cannot be trusted", found.problem, Tone.BAD
    elif found is not None and found.deviations:
        text = f"Registered on {found.registered_at[:10]}. {sentence('; '.join(found.deviations))}"
        yield "Deviations from the registration", text, Tone.WARNING


def _planned_choices(material: Material) -> Threats:
    """Yield doubts that covariates, and rules for values that are left out, raise."""
    for measure in material.statistics.measures:
        for text in planned_warnings(measure):
            yield f"The planned analysis of {measure.name}", text, Tone.WARNING


def _doubtful(material: Material) -> Threats:
    """Yield, for each measure with doubtful values, their number and the conclusions that stand without them."""
    doubted = material.doubted[material.doubted["quality"].astype("str") == Quality.DOUBTFUL.value]
    for name, rows in doubted.groupby("measure", sort=False):
        standings = material.statistics.standings
        mine = [each for each in standings if each.measure == name and each.beside is not Beside.WITHOUT_COVARIATES]
        claims = [f"{each.statement}: {each.conclusion}" for each in mine if each.statement]
        told = " ".join([*claims, *gathered([each for each in mine if not each.statement], most=_FEW_EFFECTS)])
        runs = counted(len(material.done), "run")
        text = f"{len(rows):,} of {runs}: {listed(rows['run_id'])}; Outcome of each run has the reasons. {told}".strip()
        yield f"{name} has doubtful values", text, Tone.WARNING if all(each.stands for each in mine) else Tone.BAD


def _precision(material: Material) -> Threats:
    for known in material.precisions.values():
        if not known.is_reached:
            yield f"{known.measure} is not as precise as planned", known.sentence, Tone.WARNING


def _power(material: Material) -> Threats:
    weak = {each.name: each.power for each in material.statistics.measures if each.power and _is_silent(each)}
    shown = {
        name: f"{name} {power.effect_name} = {shown_number(power.detectable_effect, 3)}"
        for name, power in weak.items()
        if power.detectable_effect is not None and power.detectable_effect > _LARGE[power.effect_name]
    }
    if shown:
        text = (
            "No effect was found, and so many runs find with a power of 0.8 none but large ones: "
            f"{', '.join(shown.values())} and above. That no effect was found does not mean that there is none."
        )
        yield "Low power", text, Tone.WARNING


def _is_silent(measure: MeasureStatistics) -> bool:
    return measure.test is not None and not any(effect.is_significant for effect in measure.test.effects)


def _drifts(material: Material) -> Threats:
    for measure in material.statistics.measures:
        if (drift := measure.drift) is not None and drift.warning:
            what = "drifts over the experiment" if drift.is_significant else "is alike in runs that follow each other"
            yield f"{measure.name} {what}", drift.warning, Tone.BAD if drift.is_confounded else Tone.WARNING


def _order(material: Material) -> Threats:
    design = material.manifest("design", default={})
    if "shuffle" in design and not design["shuffle"] and design.get("source") != "run_table.csv":
        text = "Runs were executed in the order of the config; what changes with time may pass for an effect."
        yield "The order was not randomised", text, Tone.WARNING
    if design.get("is_reordered"):
        text = "The rows of run_table.csv were put into another order by hand, and runs were executed in that order."
        yield "The order was changed by hand", text, Tone.WARNING
    if material.moved:
        chosen = listed(_chosen_runs(material), shown=8)
        text = f"{sentence(moved_in_words(material.moved, material.executed))}{f' Chosen: {chosen}.' if chosen else ''}"
        yield "Runs were executed out of the order of the run table", text, Tone.WARNING
    for text in order_warnings(material.results):
        yield "The design does not hold for all runs", text, Tone.WARNING
    for text in robot_warnings(material.results, material.statistics.design):
        yield "Treatments are unevenly spread over robots", text, Tone.BAD


def _chosen_runs(material: Material) -> Iterator[str]:
    """Yield the options that chose runs on the command line, for each session."""
    for execution in material.manifest("executions", default=[]):
        for option, several in (execution.get("selection") or {}).items():
            yield from (f"--{option} {each}" for each in several)


def _excluded(material: Material) -> Threats:
    frame = material.excluded
    for reason, runs in frame.groupby(EXCLUDED, sort=False):
        times = sorted(shown_stamp(each.isoformat()) for each in runs["excluded_at"].dropna())
        when = f" ({times[0]}{f' to {times[-1]}' if times[-1] != times[0] else ''})" if times else ""
        text = f"{sentence(str(reason))} Not in the statistics: {listed(runs[RUN_ID], shown=20)}{when}."
        yield f"{counted(len(runs), 'run')} {'was' if len(runs) == 1 else 'were'} excluded", text, Tone.WARNING


def _searched(material: Material) -> Threats:
    results, planned = material.results, counted(len(material.results.runs), "run")
    searched = len(results.with_exploration.runs) - (len(results.runs) if results.only_confirming else 0)
    text = (
        f"The design decided on {counted(searched, 'run')} from the results of others. They are exploratory: the best "
        "of many looks better than it is, and they are not tested. "
    )
    if results.only_confirming and len(results.done):
        text += f"Statistics are of the {planned} that were planned beforehand to confirm it."
        yield "What was found by searching was measured again", text, Tone.NOTE
        return
    none = f"None of the {planned} that were to confirm it is done."
    text += none if results.only_confirming else "No further run confirms what was found: plan confirm=10, say."
    yield "What was found by searching is not confirmed", text, Tone.WARNING


def _extended(material: Material) -> Threats:
    batches = material.manifest("design", "batches", default=[])
    if material.results.is_adaptive:
        yield from _searched(material)
        return
    if not batches:
        return
    sizes = enumerated(f"{batch['runs']:,}" for batch in batches)
    text = (
        f"Its {len(batches)} batches, of {sizes} runs, were executed at other times, and each has an order of its own: "
        "what changed between them is taken out of the tests, which compare runs within batches. Where runs were added "
        "as the first had shown nothing, chance shows something in 8 % (added once) to 14 % (four times), not in 5 %."
    )
    yield "The experiment was extended", text, Tone.NOTE
    for batch in batches:
        for name, treatment in batch.get("defaults", {}).items():
            text = (
                f"{name} was added with batch {batch['batch']}; runs before count as {treatment}, which nobody set. "
                "Its other treatments were executed later only: they are compared within batches."
            )
            yield f"{name} is confounded with time", text, Tone.WARNING


def _unfinished(material: Material) -> Threats:
    failed = material.counts[RunStatus.FAILED]
    if failed:
        reasons = " ".join(f"{runs}: {reason}" for runs, reason in failures_in_words(material))
        uneven = failed_by_treatment(material.results, material.statistics.design)
        text = f"{counted(failed, 'run')} failed and {_are(failed)} not in the statistics.{uneven} {reasons}"
        yield "Runs failed", text, Tone.BAD
    left = material.counts[RunStatus.TODO] + material.counts[RunStatus.RUNNING]
    if left:
        text = f"{counted(left, 'run')} of {len(material.runs):,} {_are(left)} still to do."
        yield "The experiment is not complete", text, Tone.WARNING
    attempts = material.results.attempts
    again = attempts.loc[(attempts["attempt"] > 1) & attempts["run_id"].isin(material.done[RUN_ID]), "run_id"].unique()
    if len(again):
        text = f"{listed(again)}: results are those of the last attempt, at another time than planned."
        failures = attempts[attempts["run_id"].isin(again)].groupby("failure", sort=False)["run_id"]
        if earlier := [f"{listed(runs.unique())} ({failure})" for failure, runs in failures]:
            text += f" Earlier ones failed: {listed(earlier, shown=8)}."
        uneven = repeated_by_treatment(material.results, material.statistics.design)
        yield "Runs took more than one attempt", f"{text}{uneven}", Tone.WARNING if uneven else Tone.NOTE
    for text in unsuccessful_in_words(material.results, material.statistics.design):
        yield "Missions did not succeed", text, Tone.WARNING
    for name in material.results.measures:
        mine = material.doubted["measure"] == name
        missing = int((mine & (material.doubted["quality"] == Quality.MISSING.value)).sum())
        if missing:
            uneven = missing_by_treatment(material.results, material.statistics.design, name)
            text = f"No value in {missing:,} of {counted(len(material.done), 'run')} that are done.{uneven}"
            yield f"{name} has missing values", text, Tone.WARNING


def _are(count: int) -> str:
    return "is" if count == 1 else "are"


def _circumstances(material: Material) -> Threats:
    executions = material.manifest("executions", default=[])
    told = [each.get("changed") for each in executions]
    pairs = (pair for each in told for pair in (each or {}).items())
    others = {f"{name} ({fact['was']}, later {fact['is'] or 'absent'})" for name, fact in pairs}
    parts = f"The experiment was executed in {counted(len(executions), 'part')}"
    if others:
        text = f"{parts}, and later runs had another machine or software: {listed(sorted(others), shown=8)}."
        yield "Machine or software changed on the way", text, Tone.WARNING
    elif len(executions) > 1:
        is_known = None not in told[1:] and not material.results.attempts.attrs["workers"]  # those are other machines
        what = ", on one machine and software" if is_known else "; circumstances may have changed between them"
        yield "Executed in parts", f"{parts}{what}.", Tone.NOTE
    if ExperimentFolder(material.results.folder).earlier_configs.is_dir():
        text = "Configs that were executed before are in earlier_configs/: see what changed, and for which runs."
        yield "The config changed on the way", text, Tone.WARNING
    if values := list(_changed_values(executions)):
        text = f"What the config was given changed between executions: {listed(values, shown=20)}."
        yield "Values were changed on the way", text, Tone.WARNING
    deviations: dict[str, object] = dict(material.manifest("deviations", default={}))
    for execution in executions:
        deviations |= execution.get("deviations") or {}
    if changes := changes_in_words(material.results.manifest, shown=20):
        yield "The run table was changed by hand", f"{changes[:1].upper()}{changes[1:]}.", Tone.BAD
    if deviations:
        shown = listed((f"{name} = {value}" for name, value in shown_settings(deviations).items()), shown=20)
        text = f"Set on the command line, against what the config says: {shown}."
        yield "Parameters were set by hand", text, Tone.NOTE


def _changed_values(executions: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield each value that changed in a later execution, such as one from the environment."""
    for execution in executions:
        for name, pair in (execution.get("changed_values") or {}).items():
            was, now = (repr(pair[each]) if each in pair else "not given" for each in ("was", "is"))
            yield f"{name} from {was} to {now}"


def _odd(material: Material) -> Threats:
    """Yield anomalies that plugins reported; similar ones are told once."""
    groups: dict[tuple[str, str], list[tuple[str, str, str]]] = {}
    frame = material.results.odd
    for run, owner, problem, fix in frame[["run_id", "owner", "problem", "fix"]].itertuples(index=False):
        key = (str(owner), kind_of(str(problem), str(run)))
        groups.setdefault(key, []).append((str(run), str(problem), str(fix or "")))
    for (owner, _), members in groups.items():
        runs = listed(dict.fromkeys(run for run, _, _ in members))
        alike = "" if len({problem for _, problem, _ in members}) == 1 else ", and the like"
        text = f"{members[0][1]}{alike} ({runs}). {members[0][2]}".strip()
        yield f"{owner} noticed", f"{text[:1].upper()}{text[1:]}", Tone.WARNING
    for finding in material.results.findings:
        yield "The run table's file", f"{finding.problem}. {finding.fix}".strip(), Tone.NOTE


def _gaps(material: Material) -> Threats:
    for plugin, mine in by_plugin(each for each in material.qualities if not each.is_complete).items():
        least = min((each.coverage for each in mine if each.coverage is not None), default=None)
        lost, damaged = (sum(getattr(each, name) or 0 for each in mine) for name in ("lost", "corrupt"))
        covered = "" if least is None else f"; at the least {shown_number(least, 3)} % of the time is covered"
        text = f"{listed(each.run_id for each in mine)}: {lost:,} samples lost, {damaged:,} damaged{covered}."
        yield f"Samples of {plugin} have gaps", text, Tone.WARNING


def _saturation(material: Material) -> Threats:
    for plugin, mine in by_plugin(each for each in material.qualities if each.saturated).items():
        count = counted(sum(each.saturated or 0 for each in mine), "sample")
        text = f"{count} reached the end of the sensor's range ({listed(each.run_id for each in mine)})."
        yield f"{plugin} was saturated", text, Tone.WARNING


def _limits(material: Material) -> Threats:
    for name in material.results.measures:
        for text in limits_in_words(material.results, material.statistics.design, name):
            yield f"{name} may have a limit", text, Tone.WARNING


def _unread(material: Material) -> Threats:
    readers = material.results.readers
    if readers is None:
        return
    for factor in material.statistics.design.factors:  # without blocks, units and periods, which are not applied
        if factor not in readers:
            text = (
                f"No callback and no plugin looked at {factor} in any run: unless somebody applied it by hand, the "
                "treatments differ in name only, and that no effect is found says nothing."
            )
            yield f"{factor} may never have been applied", text, Tone.BAD


def _origins(material: Material) -> Threats:
    for word, names in material.origins.items():
        come, were = ("comes", "was") if len(names) == 1 else ("come", "were")
        text = {
            "simulated": f"{come} from simulated sensors: not evidence about a real robot.",
            "estimated": f"{come} from an estimating model: not evidence about a real robot.",
        }.get(word, f"{were} entered by a person: a slip is not told from what was seen.")
        yield f"Values are {word}", f"{listed(names)} {text}", Tone.WARNING


def _constant_factors(material: Material) -> Threats:
    constant = material.statistics.design.constant_factors
    if constant and len(material.done):
        text = f"{listed(constant)} had one treatment only among the runs that are done."
        yield "Factors were not varied", text, Tone.NOTE
