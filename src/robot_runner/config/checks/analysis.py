"""The analysis plan: that it is about factors and measures that the experiment has."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robot_runner.config.parameters import Parameters
    from robot_runner.design.run_table_model import RunTableModel
    from robot_runner.errors import Finding
    from robot_runner.events.columns import MeasureColumns

__all__ = ["check_analysis"]


def check_analysis(parameters: Parameters, model: RunTableModel | None, columns: MeasureColumns) -> list[Finding]:
    """Return which names of the plan the run table does not have."""
    if parameters.analysis is None or model is None:
        return []
    return list(parameters.analysis.findings([factor.name for factor in model.factors], columns.names))
