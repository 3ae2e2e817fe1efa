"""The report of an experiment as a document, whatever it will be written as."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.analysis.report.blocks import Badge, Document, Tone
from robot_runner.analysis.report.numbers import listed
from robot_runner.analysis.report.sections.description import description_section
from robot_runner.analysis.report.sections.design import design_section, shown_stamp
from robot_runner.analysis.report.sections.figures import figures_section
from robot_runner.analysis.report.sections.outcome import outcome_section
from robot_runner.analysis.report.sections.replication import replication_section
from robot_runner.analysis.report.sections.summary import summary_section
from robot_runner.analysis.report.sections.tests import tests_section
from robot_runner.analysis.report.sections.threats import threats_of, threats_section
from robot_runner.analysis.wording import counted

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.analysis.report.material import Material

__all__ = ["report_document"]


def report_document(material: Material, *, made: str) -> Document:
    """Return the report of an experiment; its figures are not drawn yet.

    Args:
        material: what it is about.
        made: when and by what it is made.
    """
    threats = threats_of(material)
    return Document(
        kicker="Experiment report",
        title=material.results.name,
        subtitle=" · ".join(_subtitle(material)),
        badges=tuple(_badges(material)),
        sections=(
            summary_section(material, threats),
            design_section(material),
            outcome_section(material),
            description_section(material),
            figures_section(material),
            tests_section(material),
            threats_section(material, threats),
            replication_section(material),
        ),
        made=made,
    )


def _subtitle(material: Material) -> Iterator[str]:
    yield counted(len(material.runs), "run")
    if material.results.factors:
        yield (
            f"factors: {listed(material.results.factors)}"
            if len(material.results.factors) > 1
            else (f"factor: {material.results.factors[0]}")
        )
    executions = material.manifest("executions", default=[])
    if executions:
        yield shown_stamp(executions[0].get("started_at", ""))[:10]


def _badges(material: Material) -> Iterator[Badge]:
    robot = str(material.manifest("robot", default=""))
    if robot.partition(":")[0] == "simulated":
        yield Badge("simulated robot", Tone.WARNING, "Nothing in this report was measured on a real robot.")
    elif material.is_simulated:
        yield Badge("some values not measured", Tone.WARNING, "Some measures are simulated or estimated.")
    if material.results.is_running:
        yield Badge("still being executed", Tone.WARNING)
