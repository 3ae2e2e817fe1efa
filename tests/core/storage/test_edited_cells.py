"""Who looks at results is told which cells of executed runs somebody has changed."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.storage.executed_runs import edited_findings
from robot_runner.core.storage.journal import Journal
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.table_columns import TableLayout

if TYPE_CHECKING:
    from pathlib import Path

MODEL = RunTableModel([Factor("Speed", [0.1, 10])], repetitions=3, data_columns=["Energy"])
ENDED: dict[str, Any] = {"seconds": 1.0, "failure": None, "stamps": {}}
TABLE = """\
run_id,status,Speed,Repetition,Energy
r_1,Done,0.1,1,11.0
r_2,Done,10,1,21.5
r_3,Done,0.1,2,
r_4,-,10,2,
r_5,Done,0.1,3,
r_6,-,10,3,
"""


def problems(folder: Path, old: str = "", new: str = "", *, is_known: bool = True) -> list[str]:
    folder.mkdir(exist_ok=True)
    table = folder / "run_table.csv"
    with Journal(folder / "journal.jsonl") as journal:
        for run, speed, repetition, energy in (("r_1", "0.1", 1, 11), ("r_2", "10", 1, 21.5), ("r_3", "0.1", 2, None)):
            journal.append("attempt_started", run=run, attempt=1, combination={"Speed": speed}, repetition=repetition)
            measures = {"Energy": {"value": energy, "owner": "Ina219", "origin": "measured"}}
            journal.append("attempt_finished", run=run, attempt=1, status="done", **{**ENDED, "measures": measures})
        journal.append("attempt_started", run="r_5", attempt=1, combination={"Speed": "0.1"}, repetition=3)
        journal.append("attempt_finished", run="r_5", attempt=1, status="done", **ENDED, measures={})
        if is_known:
            journal.append("table_written", sha256=hashlib.sha256(TABLE.encode()).hexdigest())
        change: dict[str, Any] = {"run": "r_3", "column": "Energy", "was": "", "is": "12"}
        journal.append("deviation", **change)
    table.write_text(TABLE.replace("0.1,2,", "0.1,2,12").replace(old, new) if old else TABLE, encoding="utf-8")
    layout = TableLayout.of_model(MODEL, ["Energy"])
    found = edited_findings(folder / "journal.jsonl", table, read_run_table(table, layout, MODEL.plan()))
    return [
        finding.problem.removeprefix("cells of runs that were executed were changed by hand: ") for finding in found
    ]


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("r_1,Done,0.1", "r_1,Done,10", "Speed of r_1 is '10', and was '0.1'"),
        ("r_1,Done,0.1", "r_1,Done,slow", "Speed of r_1 is 'slow', and was '0.1'"),
        ("0.1,1,11.0", "0.1,2,11.0", "Repetition of r_1 is '2', and was '1'"),
        ("21.5", "21.6", "Energy of r_2 is '21.6', and was '21.5'"),
        ("21.5", "", "Energy of r_2 is empty, and was '21.5'"),
        ("0.1,3,", "0.1,3,9.5", "Energy of r_5 is '9.5', and was empty"),
        ("21.5", "9" * 400, f"Energy of r_2 is '{'9' * 400}', and was '21.5'"),  # beyond what a float holds
    ],
)
def test_a_label_and_a_value_that_were_changed_are_named(tmp_path: Path, old: str, new: str, told: str) -> None:
    assert problems(tmp_path, old, new) == [told]


@pytest.mark.parametrize(
    ("old", "new"),
    [("11.0", "11"), ("r_4,-,10", "r_4,-,0.1"), ("Done,10,1", "Done,10.0,1"), ("Done,0.1,1", 'Done,"0,10",1')],
)
def test_other_digits_and_runs_that_are_to_do_are_not(tmp_path: Path, old: str, new: str) -> None:
    assert problems(tmp_path, old, new) == []


def test_a_text_that_reads_as_another_treatment_or_lost_its_zeros_is_named(tmp_path: Path) -> None:
    model = RunTableModel([Factor("Version", ["1.1", "1.10"])], data_columns=["Serial"])
    table = tmp_path / "run_table.csv"
    with Journal(tmp_path / "journal.jsonl") as journal:
        for run, version in (("r_1", "1.1"), ("r_2", "1.10")):
            journal.append("attempt_started", run=run, attempt=1, combination={"Version": version})
            measures = {"Serial": {"value": "007", "owner": "config", "origin": "measured"}}
            journal.append("attempt_finished", run=run, attempt=1, status="done", **{**ENDED, "measures": measures})
    layout = replace(TableLayout.of_model(model, ["Serial"]), types={"Version": "string", "Serial": "string"})
    table.write_text("run_id,status,Version,Serial\nr_1,Done,1.1,007\nr_2,Done,1.1,7\n", encoding="utf-8")  # as by R
    (found,) = edited_findings(tmp_path / "journal.jsonl", table, read_run_table(table, layout, model.plan()))
    assert found.problem.endswith(": Version of r_2 is '1.1', and was '1.10', Serial of r_2 is '7', and was '007'")
    table.write_text("run_id,status,Version,Serial\nr_1,Done,1.100,007\nr_2,Done,1.10,007\n", encoding="utf-8")
    (found,) = edited_findings(tmp_path / "journal.jsonl", table, read_run_table(table, layout))
    assert found.problem.endswith(": Version of r_1 is '1.100', and was '1.1'")


def test_a_file_that_is_as_it_was_written_is_not_compared(tmp_path: Path) -> None:
    assert problems(tmp_path / "now") == [], "though r_3 has no value any more: so it was written"
    older = problems(tmp_path / "older", is_known=False)
    assert older == ["Energy of r_3 is empty, and was '12'"], "of an older version, nothing tells how it was written"
