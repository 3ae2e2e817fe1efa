"""The figures of the measures and of the mission."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.analysis.report.blocks import Block, Gallery, Paragraph, Part, Section, Tone
from robot_runner.analysis.report.measure_figures import distribution_figures, interaction_figures
from robot_runner.analysis.report.mission_figures import mission_parts
from robot_runner.analysis.report.trajectories import trajectory_part
from robot_runner.analysis.wording import counted

if TYPE_CHECKING:
    from robot_runner.analysis.report.material import Material

__all__ = ["figures_section"]


def figures_section(material: Material) -> Section:
    """Return the section."""
    measures = [measure for measure in material.statistics.measures if measure.name in material.drawn]
    blocks: list[Block] = [*mission_parts(material), *trajectory_part(material)]
    distributions = [each for measure in measures for each in distribution_figures(material, measure)]
    if distributions:
        blocks.append(Part("distributions", "Measures by treatment", (Gallery(tuple(distributions)),)))
    interactions = [each for measure in measures for each in interaction_figures(material, measure)]
    if interactions:
        blocks.append(Part("interactions", "Interactions of factors", (Gallery(tuple(interactions)),)))
    others = len(material.statistics.measures) - len(measures)
    if others:
        words = f"{counted(others, 'more measure')} {'is' if others == 1 else 'are'} not drawn"
        blocks.append(Paragraph(f"{words}: name those to draw by --measure.", Tone.NOTE))
    if not blocks:
        blocks.append(Paragraph("There is nothing to draw: no run is done.", Tone.WARNING))
    return Section("figures", "Figures", tuple(blocks))
