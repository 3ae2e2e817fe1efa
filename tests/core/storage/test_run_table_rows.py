"""The run table in memory keeps what is recorded of each run, all of it or nothing."""

from __future__ import annotations

import tracemalloc
from typing import Any

import pytest

from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import DesignError, MeasureError, StorageError
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.run_table_rows import RunTableRows
from robot_runner.core.storage.table_columns import TableLayout

STAMP = "2026-01-31T12:00:00.250Z"


def rows_of(repetitions: int = 2, **model: Any) -> RunTableRows:
    design = RunTableModel([Factor("Task", ["Video", "Network"])], repetitions=repetitions, **model)
    return RunTableRows.of_plan(design.plan(), TableLayout.of_model(design, ["CPU", "Energy"]))


def test_a_planned_table_is_to_do_from_the_first_to_the_last() -> None:
    rows = rows_of()
    assert [rows.run_id(place) for place in range(len(rows))] == ["r_1", "r_2", "r_3", "r_4"]
    assert rows.count(RunStatus.TODO) == 4
    assert [dict(rows.combination(place)) for place in range(2)] == [{"Task": "Video"}, {"Task": "Network"}]
    assert [rows.repetition(place) for place in range(4)] == [1, 1, 2, 2]


def test_rows_are_mappings_in_the_order_of_the_columns() -> None:
    rows = rows_of()
    rows.record("r_1", status=RunStatus.DONE, stamps={"start_run_at": STAMP}, measures={"Energy": 877})
    assert next(iter(rows)) == rows.row(0)
    assert tuple(rows.row(0)) == rows.layout.columns
    assert {name: value for name, value in rows.row(0).items() if value is not None} == {
        "run_id": "r_1",
        "status": RunStatus.DONE,
        "start_run_at": STAMP,
        "Task": "Video",
        "Repetition": 1,
        "Energy": 877,
    }


def test_without_repetitions_there_is_no_such_column() -> None:
    rows = rows_of(repetitions=1)
    assert "Repetition" not in rows.row(0)
    assert rows.repetition(1) == 1


def test_a_random_order_is_kept() -> None:
    model = RunTableModel([Factor("N", range(20))], shuffle=True, seed=3)
    rows = RunTableRows.of_plan(model.plan(), TableLayout.of_model(model, []))
    assert [rows.combination(place)["N"] for place in range(20)] == [run.combination["N"] for run in model.plan()]


def test_statuses_are_counted_as_they_change() -> None:
    rows = rows_of()
    rows.record("r_2", status=RunStatus.RUNNING)
    rows.record("r_2", status=RunStatus.FAILED)
    rows.record("r_3", status=RunStatus.DONE)
    assert [rows.count(status) for status in RunStatus] == [2, 0, 1, 1]
    assert [rows.status(place) for place in (1, 2)] == [RunStatus.FAILED, RunStatus.DONE]


def test_what_is_not_recorded_stays() -> None:
    rows = rows_of()
    rows.record("r_1", measures={"Energy": 1.5, "CPU": 2})
    rows.record("r_1", measures={"CPU": None})
    assert (rows.row(0)["Energy"], rows.row(0)["CPU"]) == (1.5, None)
    assert rows.status(0) is RunStatus.TODO


def test_clearing_a_run_forgets_what_its_attempt_left() -> None:
    rows = rows_of()
    rows.record("r_1", status=RunStatus.FAILED, stamps={"start_run_at": STAMP}, measures={"Energy": 1.5})
    rows.clear("r_1")
    assert rows.row(0) == rows_of().row(0)
    assert rows.count(RunStatus.TODO) == 4


@pytest.mark.parametrize("run_id", ["r_0", "r_5", "r_01", "r_", "x", "R_1", "r_-1"])
def test_a_run_that_is_not_there_is_refused(run_id: str) -> None:
    with pytest.raises(StorageError) as caught:
        rows_of().record(run_id, status=RunStatus.DONE)
    assert str(caught.value) == f"run_id: there is no run {run_id!r} → Name one from 'r_1' to 'r_4'."


@pytest.mark.parametrize(
    ("keywords", "kind", "text"),
    [
        (
            {"measures": {"Enrgy": 1}},
            MeasureError,
            "run 'r_1': there is no measure column 'Enrgy' → Did you mean 'Energy'?",
        ),
        (
            {"measures": {"CPU": 1, "Energy": [1]}},
            MeasureError,
            (
                "measure 'Energy': [1] is of type list → "
                "Give a finite number, a bool, a string, or None for a missing value."
            ),
        ),
        (
            {"stamps": {"start_rn_at": STAMP}},
            StorageError,
            "run 'r_1': there is no time-stamp column 'start_rn_at' → Did you mean 'start_run_at'?",
        ),
    ],
)
def test_a_record_that_cannot_be_changes_nothing(keywords: Any, kind: type[Exception], text: str) -> None:
    rows = rows_of()
    with pytest.raises(kind) as caught:
        rows.record("r_1", status=RunStatus.DONE, **keywords)
    assert str(caught.value) == text
    assert rows.row(0) == rows_of().row(0)


def test_a_measure_called_like_a_factor_is_refused() -> None:
    model = RunTableModel([Factor("Memory", [1, 2])])
    with pytest.raises(DesignError) as caught:
        TableLayout.of_model(model, ["Memory"])
    assert str(caught.value) == (
        "run table: two columns are called 'Memory' → Rename the factor, or choose other measures with data_columns."
    )


@pytest.mark.long
def test_a_large_table_takes_few_bytes_a_run() -> None:
    model = RunTableModel([Factor("A", range(300)), Factor("B", range(200))], shuffle=True)
    layout = TableLayout.of_model(model, ["CPU", "Energy"])
    tracemalloc.start()
    try:
        rows = RunTableRows.of_plan(model.plan(), layout)
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert held / len(rows) < 410
