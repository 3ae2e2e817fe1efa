"""The columns that tell runs apart: id, treatments, repetition."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.cli.aligned import Column, width_of
from robot_runner.cli.wording import shown_treatment
from robot_runner.design.columns import REPETITION

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robot_runner.design.factor import Factor
    from robot_runner.design.run_table_model import RunTableModel

__all__ = ["run_cells", "run_columns"]


def run_columns(model: RunTableModel, last_run_id: str) -> list[Column]:
    """Return the columns for the runs of a design."""
    columns = [Column("run", width_of(["run", last_run_id])), *map(_factor_column, model.factors)]
    if model.repetitions > 1:
        columns.append(Column(REPETITION, len(REPETITION), is_number=True))
    return columns


def run_cells(model: RunTableModel, run_id: str, combination: Mapping[str, object], repetition: int) -> list[str]:
    """Return the cells of one run."""
    cells = [run_id, *map(shown_treatment, combination.values())]
    return [*cells, str(repetition)] if model.repetitions > 1 else cells


def _factor_column(factor: Factor) -> Column:
    are_numbers = all(isinstance(each, int | float) and not isinstance(each, bool) for each in factor.treatments)
    return Column(factor.name, width_of([factor.name, *map(shown_treatment, factor.treatments)]), are_numbers)
