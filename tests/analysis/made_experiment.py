"""Experiment folders made without executing anything."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robot_runner.core.design.batches import described_design
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.journal import Journal
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import write_manifest
from robot_runner.core.storage.run_table_rows import RunTableRows, write_run_table
from robot_runner.core.storage.table_columns import ColumnDescription, ColumnRole, TableLayout
from robot_runner.core.storage.table_schema import describe_columns, write_schema

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from robot_runner.core.design.design import CombinationDesign, Design

__all__ = ["make_experiment", "write_phases", "write_samples"]


def make_experiment(  # noqa: PLR0913 - keywords, of which a test gives two or three
    root: Path,
    factors: Sequence[Factor] = (Factor("Task", ["Video", "Network"]),),
    values: Callable[[dict[str, Any], int], dict[str, Any] | None] = lambda treatments, repetition: {"Energy": 1.0},
    *,
    repetitions: int = 3,
    measures: Sequence[str] = ("Energy",),
    units: dict[str, str] | None = None,
    shuffle: bool = False,
    blocks: str | None = None,
    analysis: dict[str, Any] | None = None,
    doubts: dict[str, str] | None = None,
    chosen: Design | CombinationDesign | None = None,
) -> ExperimentFolder:
    """Write an experiment; `values` gives a run's measures, or None for a run that is still to do.

    `doubts` has the reason for which all values of a run are doubtful, or missing, by its id. `chosen` is a design of
    its own.
    """
    folder = ExperimentFolder(root)
    folder.runs.mkdir(parents=True)
    columns = list(measures)
    model = RunTableModel(
        factors, repetitions=repetitions, data_columns=columns, shuffle=shuffle, seed=7, design=chosen
    )
    rows = RunTableRows.of_plan(model.plan(), TableLayout.of_model(model, measures))
    with Journal(folder.journal) as journal:
        for place in range(len(rows)):
            found = values(dict(rows.combination(place)), rows.repetition(place))
            if found is not None:
                _record(journal, rows, rows.run_id(place), found, place, (doubts or {}).get(rows.run_id(place)))
        journal.append("table_written")
    write_run_table(folder.run_table, rows)
    known = {
        name: ColumnDescription(
            name=name,
            role=ColumnRole.MEASURE,
            unit=(units or {}).get(name, ""),
            owner="Meter",
            doubts={run_id: (doubt,) for run_id, doubt in (doubts or {}).items()},
        )
        for name in measures
    }
    write_schema(folder.schema, describe_columns(rows, known))
    design = {
        "source": "config",
        **described_design(model),
        "blocks": blocks,
    }
    manifest = {"experiment_name": "made", "design": design, "seed": 7, "plugins": [], "executions": []}
    write_manifest(folder.manifest, manifest | ({"analysis": analysis} if analysis else {}))
    return folder


def _record(
    journal: Journal, rows: RunTableRows, run_id: str, found: dict[str, Any], place: int, doubt: str | None
) -> None:
    begin, end = (f"2026-01-31T12:{place // 60:02}:{place % 60:02}.{part}Z" for part in ("000", "900"))
    rows.record(
        run_id,
        status=RunStatus.DONE,
        measures=found,
        stamps={"start_measurement_at": begin, "stop_measurement_at": end},
    )
    which: dict[str, Any] = {"run": run_id, "attempt": 1}
    journal.append("attempt_started", at=begin, **which)
    journal.append("event", at=begin, **which, event="before_run", clock=9000.0)
    journal.append("event", at=begin, **which, event="start_measurement", clock=10.0)
    journal.append("event", at=end, **which, event="stop_measurement", clock=20.0)
    told = {"owner": "Meter", "origin": "measured", **({"doubts": [doubt]} if doubt else {})}
    measures = {name: {"value": value, **told} for name, value in found.items()}
    stamps = {"start_measurement": begin, "stop_measurement": end}
    ended = {"is_last": True, "status": "done", "seconds": 0.9, "stamps": stamps, "failure": None}
    journal.append("attempt_finished", at=end, **which, measures=measures, **ended)


def write_samples(
    folder: ExperimentFolder, run_id: str, text: str, *, plugin: str = "Meter", name: str = "samples.csv"
) -> Path:
    """Write a file of raw samples as it is."""
    path = folder.run(run_id) / plugin / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def write_phases(folder: ExperimentFolder, run_id: str, text: str) -> Path:
    """Write a file of phases as it is."""
    return write_samples(folder, run_id, text, plugin="Robot", name="phases.csv")
