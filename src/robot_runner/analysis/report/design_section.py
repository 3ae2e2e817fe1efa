"""What was done: the design, the order, the robot, the instruments, the machine."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robot_runner.analysis.report.blocks import Block, Cell, Column, Facts, Paragraph, Part, Section, Table, Tone
from robot_runner.analysis.report.charts import points_chart
from robot_runner.analysis.report.material import origin_badges
from robot_runner.analysis.report.numbers import ALPHA, listed, sentence, shown_duration, with_unit
from robot_runner.analysis.report.tables import correction_in_words, description_table
from robot_runner.analysis.wording import counted

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from robot_runner.analysis.report.material import Material
    from robot_runner.analysis.statistics.outcome import MeasureStatistics

__all__ = ["description_section", "design_section", "order_in_words", "shown_stamp"]


# Descriptive statistics of each measure, with a chart of all runs.


def description_section(material: Material) -> Section:
    """Return the section."""
    blocks: list[Block] = []
    if not len(material.done):
        blocks.append(Paragraph("No run is done: there is nothing to describe.", Tone.WARNING))
        return Section("descriptive-statistics", "Descriptive statistics", tuple(blocks))
    chart = points_chart(material)
    blocks += [chart] if chart is not None else []
    blocks += [_part(material, measure) for measure in material.statistics.measures]
    return Section("descriptive-statistics", "Descriptive statistics", tuple(blocks))


def _part(material: Material, measure: MeasureStatistics) -> Part:
    label = material.results.label(measure.name)
    blocks: list[Block] = []
    meaning = material.results.columns[measure.name].description
    if meaning:
        blocks.append(Paragraph(meaning, Tone.NOTE))
    for factor in material.results.factors:
        groups = [group for group in measure.by_treatment if tuple(group.treatments) == (factor,)]
        if groups:
            name = f"describe {measure.name} by {factor}"
            blocks.append(description_table(name, f"{label} by {factor}.", factor, groups))
    if measure.by_combination:
        heading = " / ".join(material.results.factors)
        caption = f"{label} by combination."
        blocks.append(description_table(f"describe {measure.name}", caption, heading, measure.by_combination))
    if not measure.by_treatment and not measure.by_combination and measure.overall is not None:
        blocks.append(description_table(f"describe {measure.name}", f"{label}, all runs.", "Group", [measure.overall]))
    blocks += [Paragraph(text, Tone.NOTE) for text in _notes(measure)]
    return Part(f"describe-{measure.name}", label, tuple(blocks), origin_badges(measure.origin))


def _notes(measure: MeasureStatistics) -> Iterator[str]:
    groups = measure.by_combination or measure.by_treatment
    outliers = {outlier.run_id: outlier for group in groups for outlier in group.outliers}
    if outliers:
        named = ", ".join(
            f"{run_id} ({with_unit(outlier.value, measure.unit)}{', extreme' if outlier.is_extreme else ''})"
            for run_id, outlier in list(outliers.items())[:12]
        )
        more = f" and {len(outliers) - 12} more" if len(outliers) > 12 else ""  # noqa: PLR2004 - as many as fit a line
        yield f"{counted(len(outliers), 'outlier')} by Tukey's fences: {named}{more}. None was left out."
    for missed in measure.not_computed:
        yield f"Not computed: {missed.what}. {sentence(missed.why)}"


_GIBI = 2**30


def design_section(material: Material) -> Section:
    """Return the section."""
    blocks: list[Block] = [
        Facts(tuple(_facts(material))),
        _factor_table(material),
        _measure_table(material),
        Part("design-machine", "Machine and software", (Facts(tuple(_machine(material))),)),
    ]
    packages = material.manifest("software", "packages", default={})
    if packages:
        blocks.append(_packages(packages))
    return Section("what-was-done", "What was done", tuple(blocks))


def _facts(material: Material) -> Iterator[tuple[str, str]]:
    config = material.manifest("config", default={})
    yield "Experiment", material.results.name
    if config.get("file"):
        yield "Config", f"{config['file']}, class {config.get('class', '?')}"
    yield "Design", material.statistics.design.sentence
    yield "Order", order_in_words(material)
    yield "Robot", str(material.manifest("robot", default="not recorded"))
    deviations = material.manifest("deviations", default={})
    if deviations:
        yield "Set by hand", listed((f"{name} = {value}" for name, value in deviations.items()), shown=20)
    executions = material.manifest("executions", default=[])
    if executions:
        yield "Executed", _executions(executions)
    if material.results.plan is not None:
        plan = material.results.plan
        yield (
            "Fixed beforehand",
            f"measures {listed(plan.measures)}, {ALPHA} = {plan.alpha:g}, {correction_in_words(plan.correction)}",
        )


def order_in_words(material: Material) -> str:
    """Return how the order of the runs came about."""
    design = material.manifest("design", default={})
    seed = material.results.seed
    if design.get("source") == "run_table.csv":
        return "as in a run table that was made by hand"
    if not design.get("shuffle"):
        return "as written; not randomised" if "shuffle" in design else "not recorded"
    blocks = f" within blocks of {design['blocks']}" if design.get("blocks") else ""
    whence = "given in the config" if material.manifest("seed_is_given") else "drawn"
    return f"randomised{blocks}, from seed {seed} ({whence})"


def shown_stamp(stamp: object) -> str:
    """Return a time stamp to the second, as in `2026-01-31 12:00:00 UTC`."""
    text = str(stamp)
    return f"{text[:10]} {text[11:19]} UTC" if len(text) >= 19 else text  # noqa: PLR2004 - a date and a time


def _executions(executions: list[Mapping[str, Any]]) -> str:
    first = executions[0].get("started_at", "?")
    ends = [each["finished_at"] for each in executions if each.get("finished_at")]
    until = f" to {shown_stamp(ends[-1])}" if ends else ", and was not ended"
    times = "" if len(executions) == 1 else f", in {len(executions)} executions"
    return f"{shown_stamp(first)}{until}{times}"


def _factor_table(material: Material) -> Table:
    columns = (Column("Factor"), Column("Treatments"), Column("How many", is_number=True))
    names = [*material.results.factors, *([material.results.repetition] if material.results.repetition else [])]
    rows = []
    for name in names:
        values = material.runs[name]
        treatments = list(values.cat.categories) if hasattr(values, "cat") else sorted(values.dropna().unique())
        rows.append(
            (
                Cell.of_text(name),
                Cell.of_text(listed(treatments, shown=12)),
                Cell(len(treatments), str(len(treatments))),
            )
        )
    return Table("factors", "Factors and their treatments.", columns, tuple(rows))


def _measure_table(material: Material) -> Table:
    columns = (Column("Measure"), Column("Unit"), Column("Meaning"), Column("Instrument"), Column("Origin"))
    rows = []
    for name in material.results.measures:
        column = material.results.columns[name]
        is_real = column.origin in {None, "measured"}
        rows.append(
            (
                Cell.of_text(name),
                Cell.of_text(column.unit),
                Cell.of_text(column.description),
                Cell.of_text(_instrument(material, column.owner)),
                Cell.of_text(column.origin or "not recorded", Tone.PLAIN if is_real else Tone.WARNING),
            )
        )
    table = Table("measures", "Measures, what yields them, and where their values come from.", columns, tuple(rows))
    return table.without_blank("Meaning", "Unit", "Instrument")


def _instrument(material: Material, owner: str) -> str:
    for plugin in material.manifest("plugins", default=[]):
        if plugin.get("name") == owner:
            package = " ".join(str(each) for each in (plugin.get("package"), plugin.get("version")) if each)
            return f"{owner} ({package})" if package else owner
    return owner


def _machine(material: Material) -> Iterator[tuple[str, str]]:
    host, software = (material.manifest(key, default={}) for key in ("host", "software"))
    if host:
        yield "System", " ".join(str(host[key]) for key in ("system", "release", "machine") if host.get(key))
        cores, memory = host.get("cores"), host.get("memory_bytes")
        parts = [str(host.get("processor") or "")]
        parts += [counted(cores, "core")] if cores else []
        parts += [f"{memory / _GIBI:.0f} GiB of memory"] if memory else []
        if any(parts):
            yield "Processor", ", ".join(part for part in parts if part)
    if software.get("robot_runner"):
        yield "Robot Runner", str(software["robot_runner"])
    if software.get("python"):
        yield "Python", f"{software['python']} ({software.get('implementation', '')})".replace(" ()", "")
    seconds = material.results.attempts["seconds"].dropna()
    if len(seconds):
        yield "Time of all attempts", shown_duration(float(seconds.sum()))


def _packages(packages: Mapping[str, str]) -> Part:
    text = ", ".join(f"{name} {version}" for name, version in packages.items())
    facts = Facts((("Packages", text),))
    return Part(
        "design-packages", f"{counted(len(packages), 'installed package')}", (facts,), is_folded=True, is_printed=False
    )
