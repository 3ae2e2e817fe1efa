"""The sections on what was done (design, search, order, robot, machine) and on descriptive statistics."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple

import pandas as pd

from robot_runner.analysis.plan_file import choices_in_words
from robot_runner.analysis.report.blocks import Block, Cell, Facts, Paragraph, Part, Section, Table, Tone, one_word
from robot_runner.analysis.report.charts import points_chart
from robot_runner.analysis.report.machine_threats import described_workers
from robot_runner.analysis.report.material import JOINT, Material, correction_in_words
from robot_runner.analysis.report.tables import build_table, field, interval, number, text
from robot_runner.analysis.statistics.known_precision import KnownPrecision, repeated_interval
from robot_runner.analysis.statistics.nested_factors import IDLE
from robot_runner.analysis.statistics.tested import Interval, named_within
from robot_runner.analysis.wording import ALPHA, MINUS, about_intervals, digits_beside, listed, sentence, with_unit
from robot_runner.core.design.batch import CONFIRMATION
from robot_runner.core.design.columns import RUN_ID, STATUS
from robot_runner.core.design.outliers import Doubtful
from robot_runner.core.design.repeated_intervals import METHOD
from robot_runner.core.events.measure import Quality
from robot_runner.core.secret_names import shown_settings
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.executed_runs import moved_in_words
from robot_runner.core.words import EMPTY, counted, shown_commit, shown_duration

if TYPE_CHECKING:
    from robot_runner.analysis.results import Results
    from robot_runner.analysis.statistics.outcome import Description, MeasureStatistics, Proportion

_GIBI = 2**30
_MOST_NAMED = 12  # outliers that fit on a line


def design_section(material: Material) -> Section:
    """Return the section on what was done."""
    title = "Software of the import" if material.is_imported else "Machine and software"
    blocks: list[Block] = [
        Facts(tuple(_facts(material))),
        _factor_table(material),
        _measure_table(material),
        *searched_part(material),
        Part("design-machine", title, (Facts(tuple(_machine(material))),)),
    ]
    packages: Mapping[str, str] = material.manifest("software", "packages", default={})
    if packages:
        facts = Facts((("Packages", ", ".join(f"{name} {version}" for name, version in packages.items())),))
        title = counted(len(packages), "installed package") + " of the import" * material.is_imported
        blocks.append(Part("design-packages", title, (facts,), is_folded=True, is_printed=False))
    return Section("what-was-done", "What was done", tuple(blocks))


def _facts(material: Material) -> Iterator[tuple[str, str]]:
    config = material.manifest("config", default={})
    yield "Experiment", material.results.name
    if config.get("file"):
        yield "Config", f"{config['file']}, class {config.get('class', '?')}"
    yield "Design", material.statistics.design.sentence
    notes = material.manifest("design", "facts", "notes", default=[])
    if isinstance(notes, list) and notes:
        yield "Of the design", listed(notes)
    yield "Order", order_in_words(material)
    yield from _batches(material)
    for known in material.precisions.values():
        yield f"Repeated for {known.measure}", f"{known.asked}; {counted(known.repetitions, 'repetition')} in the end"
    if material.results.warm_ups:
        yield "Warm-up", f"{listed(material.results.warm_ups)}: executed and kept, not analysed"
    robot = material.manifest("robot", default="none" if "robot" in material.results.manifest else "not recorded")
    several = [f"{name} ({link})" for name, link in material.manifest("robots", default={}).items()]
    yield ("Robots", f"{listed(several)}, which took turns") if several else ("Robot", str(robot))
    deviations = material.manifest("deviations", default={})
    if deviations:
        settings = (f"{name} = {value}" for name, value in shown_settings(deviations).items())
        yield "Set by hand", listed(settings, shown=20)
    executions = material.manifest("executions", default=[])
    if executions:
        yield "Executed", _executions(executions)
    plan = material.results.plan
    if plan is not None:
        correction = correction_in_words(plan.correction)
        names = f"measures {listed(plan.measures)}{f', secondary {listed(plan.secondary)}' * bool(plan.secondary)}"
        choices = f"{names}, {ALPHA} = {plan.alpha:g}, {correction}"
        yield "Fixed beforehand", "; ".join([choices, *choices_in_words(plan, material.results.unit)])
    if material.registered is not None:
        yield "Registration", material.registered.sentence
        if material.registered.power:
            yield "Registered power", " ".join(material.registered.power)


def order_in_words(material: Material) -> str:
    """Return the origin of the order of the runs in words, and how many runs were executed out of it."""
    design = material.manifest("design", default={})
    order = _planned_order(material, design)
    if design.get("source") == "run_table.csv":
        order = "as in a run table that was made by hand"
    elif design.get("is_reordered"):
        order = f"changed by hand in run_table.csv; planned: {order}"
    moved = moved_in_words(material.moved, material.executed)
    return f"{order}; {moved}" if moved else order


def _batches(material: Material) -> Iterator[tuple[str, str]]:
    if decides := material.manifest("design", "facts", "decides", default=""):
        yield "Decided while it was executed", sentence(str(decides))
    for batch in material.manifest("design", "batches", default=[])[1:]:
        blocks = f" within blocks of {batch['blocks']}" if batch.get("blocks") else ""
        order = f"randomised{blocks} from seed {batch['seed']}" if batch.get("shuffle") else f"as written{blocks}"
        runs = f"{counted(batch['runs'], 'run')} ({batch['first']} to {batch['last']})"
        name = "Confirmation" if batch.get("role") == CONFIRMATION else f"Batch {batch['batch']}"
        yield name, f"{runs}, added on {shown_stamp(batch.get('at', ''))}; {order}"


def _planned_order(material: Material, design: Mapping[str, Any]) -> str:
    if not design.get("shuffle"):
        return "as written; not randomised" if "shuffle" in design else "not recorded"
    blocks = f" within blocks of {design['blocks']}" if design.get("blocks") else ""
    whence = "given in the config" if material.manifest("seed_is_given") else "drawn"
    return f"randomised{blocks}, from seed {material.results.seed} ({whence})"


def shown_stamp(stamp: object) -> str:
    """Return a time stamp to the second, as in `2026-01-31 12:00:00 UTC`."""
    text = str(stamp)
    return f"{text[:10]} {text[11:19]} UTC" if len(text) >= 19 else text  # noqa: PLR2004 - a date and a time


def _executions(executions: list[Mapping[str, Any]]) -> str:
    first = executions[0].get("started_at", "?")
    ends = [each["finished_at"] for each in executions if each.get("finished_at")]
    until = f" to {shown_stamp(ends[-1])}" if ends else ", and was not ended"
    times = "" if len(executions) == 1 else f", in {len(executions)} executions"
    stamps = [stamp for each in executions for stamp in map(each.get, ("started_at", "finished_at")) if stamp]
    moments = pd.to_datetime(stamps, utc=True, format="ISO8601", errors="coerce").dropna()
    set_back = "; the stamps go back: a clock was set, or another machine's differs"
    return f"{shown_stamp(first)}{until}{times}{'' if moments.is_monotonic_increasing else set_back}"


def _factor_table(material: Material) -> Table:
    repetition = material.results.repetition
    names = [*material.results.factors, *([repetition] if repetition else [])]
    within = material.statistics.design.within

    def treatments(name: str) -> list[Any]:
        values = material.runs[name]
        found = list(values.cat.categories if hasattr(values, "cat") else sorted(values.dropna().unique()))
        return [each for each in found if name not in within or str(each) != IDLE]

    fields = (
        text("Factor", lambda name: named_within(name, within.get(name, ""))),
        text("Unit", material.results.unit),
        text("Treatments", lambda name: listed([each if each != "" else EMPTY for each in treatments(name)], shown=12)),
        number("How many", lambda name: len(treatments(name))),
    )
    return build_table("factors", "Factors and their treatments.", names, fields).without_blank("Unit")


def _measure_table(material: Material) -> Table:
    def origin_tone(column: Any) -> Tone:
        return Tone.PLAIN if column.origin in {None, "measured"} else Tone.WARNING

    fields = (
        text("Measure", "name"),
        text("Unit", "unit"),
        text("Meaning", "description"),
        text("Instrument", lambda column: _instrument(material, column.owner)),
        text("Origin", lambda column: column.origin or "not recorded", origin_tone),
    )
    columns = [material.results.columns[name] for name in material.results.measures]
    caption = "Measures, what yields them, and where their values come from."
    return build_table("measures", caption, columns, fields).without_blank("Meaning", "Unit", "Instrument")


def _instrument(material: Material, owner: str) -> str:
    for plugin in material.manifest("plugins", default=[]):
        if plugin.get("name") == owner:
            package = " ".join(str(each) for each in (plugin.get("package"), plugin.get("version")) if each)
            return f"{owner} ({package})" if package else owner
    return owner


def _machine(material: Material) -> Iterator[tuple[str, str]]:
    host, software = (material.manifest(key, default={}) for key in ("host", "software"))
    if material.is_imported:
        yield "Machine", "not recorded: the runs were executed elsewhere"
    yield from described_workers(material)
    if host:
        yield "System", " ".join(str(host[key]) for key in ("system", "release", "machine") if host.get(key))
        cores, memory = host.get("cores"), host.get("memory_bytes")
        parts = [str(host.get("processor") or "")]
        parts += [counted(cores, "core")] if cores else []
        parts += [f"{memory / _GIBI:.0f} GiB of memory"] if memory else []
        if any(parts):
            yield "Processor", ", ".join(filter(None, parts))
    if software.get("robot_runner"):
        yield "Robot Runner", str(software["robot_runner"])
    executions = material.manifest("executions", default=[])
    commits = dict.fromkeys(shown_commit(each.get("repository")) for each in executions)
    if any(commits):
        yield "Config's repository", "; ".join(filter(None, commits))
    for factor, revisions in material.manifest("revisions", default={}).items():
        yield from ((f"{factor} {name}", shown_commit(facts)) for name, facts in revisions.items())
    if software.get("python"):
        yield "Python", f"{software['python']} ({software.get('implementation', '')})".replace(" ()", "")
    seconds = material.results.attempts["seconds"].dropna()
    if len(seconds):
        yield "Time of all attempts", shown_duration(float(seconds.sum()))


def description_section(material: Material) -> Section:
    """Return the section of descriptive statistics, with a chart of all runs."""
    name, title = "descriptive-statistics", "Descriptive statistics"
    if not len(material.done):
        return Section(name, title, (Paragraph("No run is done: there is nothing to describe.", Tone.WARNING),))
    chart = points_chart(material)
    parts = (_part(material, measure) for measure in material.statistics.measures)
    return Section(name, title, (*([chart] if chart is not None else []), *parts))


def _part(material: Material, measure: MeasureStatistics) -> Part:
    label = material.results.label(measure.name)
    meaning = material.results.columns[measure.name].description
    blocks: list[Block] = [Paragraph(meaning, Tone.NOTE)] if meaning else []
    blocks += _description_tables(material, measure, label)
    if measure.name in material.precisions:
        blocks += _precision_blocks(material.precisions[measure.name], label)
    blocks += [Paragraph(note, Tone.NOTE) for note in _notes(measure)]
    return Part(f"describe-{measure.name}", label, tuple(blocks), material.badges(measure))


def _precision_blocks(known: KnownPrecision, label: str) -> Iterator[Block]:
    yield Paragraph(known.sentence, Tone.PLAIN if known.is_reached else Tone.WARNING, lead="Precision.")
    if not known.differences:
        return
    fields = (
        text("Treatments", "of"),
        number("Repetitions", "n"),
        number("Difference of means", "mean"),
        interval("CI of the difference", repeated_interval),
    )
    note = f"CI: 95 % confidence interval, {METHOD}; it holds wherever the experiment stopped."
    caption = f"{label}: differences between treatments, compared within repetitions."
    yield build_table(f"precision {known.measure}", caption, known.differences, fields, note)


def _description_tables(material: Material, measure: MeasureStatistics, label: str) -> Iterator[Table]:
    name = f"describe {one_word(measure.name)}"
    of = measure.proportions or measure
    table: Callable[..., Table] = _description_table if measure.proportions is None else _proportion_table
    for factor in material.factors:
        groups = [group for group in of.by_treatment if tuple(group.treatments) == (factor,)]
        if groups:
            yield table(f"{name} by {factor}", f"{label} by {factor}.", factor, groups)
    if of.by_combination:
        yield table(name, f"{label} by combination.", JOINT.join(of.by_combination[0].treatments), of.by_combination)
    elif not of.by_treatment and of.overall is not None:
        yield table(name, f"{label}, all runs.", "Group", [of.overall])


def _proportion_table(name: str, caption: str, heading: str, groups: Sequence[Proportion]) -> Table:
    fields = (
        text(heading, "label"),
        number("n", "n"),
        number("Missing", "missing", warns=True),
        number("Yes", "count"),
        number("Yes (%)", "percent"),
        interval("CI (%)", "interval"),
    )
    note = _about_intervals(group.interval for group in groups).rstrip()
    return build_table(name, caption, groups, fields, note).without_blank("Missing")


def _description_table(name: str, caption: str, heading: str, groups: Sequence[Description]) -> Table:
    def outliers(group: Description) -> Cell:
        run_ids = [outlier.run_id for outlier in group.outliers]
        return Cell(" ".join(run_ids) or None, listed(run_ids))

    def digits(group: Description) -> int:
        return digits_beside(group.mean, group.sd)

    fields = (
        text(heading, "label"),
        number("n", "n"),
        number("Missing", "missing", warns=True),
        number("Mean", "mean", digits),
        number("SD", "sd"),
        number("Median", "median", digits),
        number("IQR", "interquartile_range"),
        number("Minimum", "minimum", digits),
        number("Maximum", "maximum", digits),
        interval("CI of the mean", "mean_interval", digits=digits),
        field("Outliers", outliers),
    )
    told = _about_intervals(group.mean_interval for group in groups)
    note = f"{told}SD: standard deviation (n {MINUS} 1). IQR: interquartile range."
    if any((group.minimum or 0) >= 0 > group.mean_interval.low for group in groups if group.mean_interval):
        # It is not known which measures cannot be negative, and readers can compute an untruncated interval again.
        note += " An interval reaches below 0 where no value does: there are few runs for so large a spread."
    return build_table(name, caption, groups, fields, note).without_blank("Missing", "Outliers")


def _about_intervals(intervals: Iterable[Interval | None]) -> str:
    """Return a sentence on the level and the method of a table's intervals."""
    found = [each for each in intervals if each is not None]
    return about_intervals(found, f", {' or '.join(dict.fromkeys(each.method for each in found))}")


def _notes(measure: MeasureStatistics) -> Iterator[str]:
    groups = measure.by_combination or measure.by_treatment
    # One run that went wrong may stand behind dozens that a narrow box made outliers: it decides the tests.
    found = [(abs(each.value - (group.median or 0.0)), each) for group in groups for each in group.outliers]
    outliers = {each.run_id: each for _, each in sorted(found, key=lambda pair: -pair[0])}
    if outliers:
        named = [
            f"{run_id} ({with_unit(outlier.value, measure.unit)}{', extreme' if outlier.is_extreme else ''})"
            for run_id, outlier in outliers.items()
        ]
        first = ", the farthest from their medians first" if len(outliers) > 1 else ""
        many = f"{counted(len(outliers), 'outlier')} by Tukey's fences{first}"
        yield f"{many}: {listed(named, shown=_MOST_NAMED)}. None of these was left out."
    for missed in measure.not_computed:
        yield f"Not computed: {missed.what}. {sentence(missed.why)}"


_NOTE = (
    "Means of the runs of the search, in the order in which combinations came up. They are exploratory: the best of "
    "many looks better than it is."
)


def searched_part(material: Material) -> Iterator[Part]:
    """Yield the part on the combinations that an adaptive design tried."""
    results = material.results.with_exploration
    measures = list((material.manifest("design", "parameters", "directions", default={}) or {}).keys())
    if not results.is_adaptive or not all(name in results.runs for name in measures):
        return
    runs = results.runs
    if results.batch is not None:
        runs = runs[~runs[results.batch].isin(results.confirming_batches)]
    factors = list(results.factors)
    note, plan = _NOTE, results.plan
    if plan is not None and plan.doubtful is Doubtful.LEAVE_OUT:
        runs, left_out = _without_doubtful(runs, results, measures)
        note += f" {sentence(counted(left_out, 'doubtful value'))} left out, as planned." * bool(left_out)
    by_combination = runs.groupby(factors, observed=True, sort=False)
    tried = [_tried(treatments, own, measures) for treatments, own in by_combination]
    tried.sort(key=attrgetter("place"))
    columns = [text(name, _reader("treatments", place)) for place, name in enumerate(factors)]
    columns += [number("Runs done", "done")]
    columns += [number(results.label(name), _reader("means", place)) for place, name in enumerate(measures)]
    table = build_table("searched", "What was tried in search of the best.", tried, columns, note)
    yield Part("design-searched", "What was tried", (table,), is_folded=len(tried) > _FEW)


#: Tables with more rows are folded.
_FEW = 30


def _without_doubtful(runs: pd.DataFrame, results: Results, measures: list[str]) -> tuple[pd.DataFrame, int]:
    """Return the runs without their doubtful values, and the number of these."""
    told = results.quality
    doubtful = told[(told["quality"] == Quality.DOUBTFUL.value) & told["run_id"].isin(runs[RUN_ID])]
    without, count = runs.copy(), 0
    for name in measures:
        is_doubtful = without[RUN_ID].isin(doubtful.loc[doubtful["measure"] == name, "run_id"])
        without[name] = without[name].mask(is_doubtful)
        count += int(is_doubtful.sum())
    return without, count


class _Tried(NamedTuple):
    """A combination: the number of its runs that are done, their means, and the place of its first run."""

    treatments: list[str]
    done: int
    means: list[float | None]
    place: int


def _tried(treatments: tuple[Any, ...], runs: pd.DataFrame, measures: list[str]) -> _Tried:
    done = runs[runs[STATUS] == RunStatus.DONE.value]
    means = (pd.to_numeric(done[name], errors="coerce").mean() for name in measures)
    known = [None if pd.isna(mean) else float(mean) for mean in means]
    return _Tried([str(each) for each in treatments], len(done), known, runs.index[0])


def _reader(part: str, place: int) -> Callable[[_Tried], Any]:
    return lambda tried: getattr(tried, part)[place]
