"""`run_table.csv` as it is written: for people, R, pandas and spreadsheets."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.run_table_rows import RunTableRows, write_run_table
from robot_runner.core.storage.table_columns import TableLayout

if TYPE_CHECKING:
    from pathlib import Path


def rows_of(treatments: Any, repetitions: int = 1) -> RunTableRows:
    model = RunTableModel([Factor("Task", treatments)], repetitions=repetitions)
    return RunTableRows.of_plan(model.plan(), TableLayout.of_model(model, ["CPU", "Energy"]))


def test_it_reads_as_the_papers_figure_does(tmp_path: Path) -> None:
    rows = rows_of(["Video", "Network"], repetitions=2)
    rows.record(
        "r_1",
        status=RunStatus.DONE,
        stamps={"start_run_at": "2026-01-31T12:00:00.250Z"},
        measures={"CPU": 16.5, "Energy": 877},
    )
    rows.record("r_2", status=RunStatus.FAILED)
    rows.record("r_3", status=RunStatus.RUNNING)
    write_run_table(tmp_path / "run_table.csv", rows)
    assert (tmp_path / "run_table.csv").read_bytes().decode() == (
        "run_id,status,before_run_at,start_run_at,start_measurement_at,launch_mission_at,stop_measurement_at,"
        "stop_run_at,populate_run_data_at,continue_at,Task,Repetition,CPU,Energy\n"
        "r_1,Done,,2026-01-31T12:00:00.250Z,,,,,,,Video,1,16.5,877\n"
        "r_2,Failed,,,,,,,,,Network,1,,\n"
        "r_3,Running,,,,,,,,,Video,2,,\n"
        "r_4,-,,,,,,,,,Network,2,,\n"
    )


def test_it_does_not_begin_as_a_sylk_file_does(tmp_path: Path) -> None:
    write_run_table(tmp_path / "run_table.csv", rows_of([1]))
    assert not (tmp_path / "run_table.csv").read_bytes().startswith(b"ID")


def test_cells_with_commas_quotes_and_line_ends_are_quoted(tmp_path: Path) -> None:
    rows = rows_of(["a,b", 'say "hi"', "one\ntwo", "one\rtwo", "é 日本"])
    rows.record("r_1", measures={"CPU": "x,y"})
    write_run_table(tmp_path / "run_table.csv", rows)
    text = (tmp_path / "run_table.csv").read_bytes().decode()
    assert '"a,b","x,y",\n' in text
    assert '"say ""hi""",,\n' in text
    assert '"one\ntwo",,\n' in text
    assert '"one\rtwo",,\n' in text
    assert ",é 日本,,\n" in text


def test_tables_of_any_length_have_all_their_rows(tmp_path: Path) -> None:
    for count in (1, 499, 500, 501, 1000):
        write_run_table(tmp_path / "run_table.csv", rows_of(range(count)))
        lines = (tmp_path / "run_table.csv").read_text(encoding="utf-8").splitlines()
        assert [line.split(",")[0] for line in lines] == ["run_id", *(f"r_{number}" for number in range(1, count + 1))]
