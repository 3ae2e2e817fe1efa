"""Descriptive statistics of each measure, with a chart of all runs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.analysis.report.blocks import Block, Paragraph, Part, Section, Tone
from robot_runner.analysis.report.charts import points_chart
from robot_runner.analysis.report.material import origin_badges
from robot_runner.analysis.report.numbers import sentence, with_unit
from robot_runner.analysis.report.tables import description_table
from robot_runner.analysis.wording import counted

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.analysis.report.material import Material
    from robot_runner.analysis.statistics.outcome import MeasureStatistics

__all__ = ["description_section"]


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
