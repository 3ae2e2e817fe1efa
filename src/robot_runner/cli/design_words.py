"""A run-table model in words and as plain data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robot_runner.cli.console import Column, width_of
from robot_runner.core.design.columns import REPETITION
from robot_runner.core.design.listed_runs import ListedRunTableModel
from robot_runner.core.words import counted, plain, shown_treatment

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robot_runner.core.design.factor import Factor
    from robot_runner.core.design.planned_runs import PlannedRun
    from robot_runner.core.design.run_table_model import RunTableModel
    from robot_runner.core.events.measure import MeasureColumn, MeasureColumns

__all__ = [
    "columns_as_json",
    "design_as_json",
    "in_words",
    "measures_in_words",
    "order_in_words",
    "run_as_json",
    "run_cells",
    "run_columns",
]


# The columns that tell runs apart: id, treatments, repetition.


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


def in_words(model: RunTableModel) -> str:
    """Return how many runs there are and what they come from.

    Example:
        >>> from robot_runner.core.design.factor import Factor
        >>> from robot_runner.core.design.run_table_model import RunTableModel
        >>> in_words(RunTableModel([Factor("Task", ["Video", "Network"]), Factor("Speed", [1])], repetitions=3))
        '6 runs: Task (2) x Speed (1) x 3 repetitions'
    """
    parts = [f"{factor.name} ({len(factor.treatments):,})" for factor in model.factors]
    if isinstance(model, ListedRunTableModel):
        return f"{counted(len(model.runs), 'run')}, listed one by one: {', '.join(parts) or 'nothing is varied'}"
    combinations = 1
    for factor in model.factors:
        combinations *= len(factor.treatments)
    runs = len(model.plan())
    excluded = combinations - runs // model.repetitions
    if model.repetitions > 1:
        parts.append(f"{model.repetitions:,} repetitions")
    less = f", {counted(excluded, 'combination')} excluded" if excluded else ""
    return f"{counted(runs, 'run')}: {' x '.join(parts)}{less}"


def order_in_words(model: RunTableModel) -> str:
    """Return in which order the runs are executed."""
    if not model.shuffle:
        return f"as written, in blocks of {model.blocks}" if model.blocks else "as written"
    seed = f"from seed {model.seed}" if model.seed_is_given else "from a seed that is drawn at the start and recorded"
    return f"randomised{f' within blocks of {model.blocks}' if model.blocks else ''}, {seed}"


def measures_in_words(columns: MeasureColumns) -> str:
    """Return the measure columns of the run table with their units."""
    return ", ".join(_with_unit(column) for column in columns.in_table) or "none"


def _with_unit(column: MeasureColumn) -> str:
    return f"{column.name} ({column.measure.unit})" if column.measure.unit not in {"", "1"} else column.name


def design_as_json(model: RunTableModel) -> dict[str, Any]:
    """Return factors, repetitions and order as plain data."""
    return {
        "run_count": len(model.plan()),
        "factors": {factor.name: list(map(plain, factor.treatments)) for factor in model.factors},
        "repetitions": model.repetitions,
        "order": {
            "is_randomised": model.shuffle,
            "blocks": model.blocks,
            "seed": model.seed if model.seed_is_given else None,
        },
    }


def columns_as_json(columns: MeasureColumns) -> list[dict[str, str]]:
    """Return the measure columns of the run table as plain data."""
    return [{"name": column.name, "unit": column.measure.unit, "owner": column.owner} for column in columns.in_table]


def run_as_json(run: PlannedRun) -> dict[str, Any]:
    """Return a planned run as plain data."""
    return {
        "run_id": run.run_id,
        "number": run.number,
        "combination": {name: plain(treatment) for name, treatment in run.combination.items()},
        "repetition": run.repetition,
        "block": run.block,
    }
