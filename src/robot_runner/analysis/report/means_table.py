"""The means of all measures by treatment: in brief, and beside pictures of the mission."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.analysis.report.blocks import Cell
from robot_runner.analysis.report.material import JOINT
from robot_runner.analysis.report.tables import Field, build_table, field, text
from robot_runner.analysis.wording import MISSING, shown_number

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.analysis.report.blocks import Table
    from robot_runner.analysis.report.material import Material
    from robot_runner.analysis.statistics.outcome import Description

__all__ = ["means_table"]

_MOST_GROUPS = 6


def means_table(material: Material, name: str) -> Iterator[Table]:
    """Yield the means of all measures beside each other, where there are few enough treatments.

    Args:
        material: what the report is about.
        name: of the table's files; unique in the document.
    """
    groups = {
        measure.name: {each.label: each for each in measure.by_combination or measure.by_treatment}
        for measure in material.statistics.measures
        if measure.overall is not None and measure.overall.n
    }
    names = [name for name in material.order if any(name in described for described in groups.values())]
    if not groups or not 1 < len(names) <= _MOST_GROUPS:
        return

    def means(treatment: str) -> Field:
        return field(treatment, lambda measure: _mean(groups[measure].get(treatment)), is_number=True)

    caption = f"Means by {JOINT.join(material.results.factors)}."
    note = "Mean of the runs that are done, and their standard deviation (± SD)."
    yield build_table(name, caption, groups, (text("Measure", material.results.label), *map(means, names)), note)


def _mean(group: Description | None) -> Cell:
    if group is None or group.mean is None:
        return Cell(None, MISSING)
    spread = "" if group.sd is None else f" ± {shown_number(group.sd, 2)}"
    return Cell(group.mean, f"{shown_number(group.mean)}{spread}")
