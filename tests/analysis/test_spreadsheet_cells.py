"""What is exported for spreadsheets has no formulas; the tables themselves are left as they are."""

from __future__ import annotations

import csv

import pytest
from tests.analysis.made_experiment import make_experiment

from robot_runner.analysis.exporting import harmless_cell
from robot_runner.core.design.factor import Factor

FORMULAS = [
    "=1+1",
    '=HYPERLINK("http://example.org","here")',
    "+cmd|' /C calc'!A0",
    "-2+3",
    "@SUM(1,1)",
    "\t=1+1",
    "\r=1+1",
    "\uff1d1+1",
    "-",
    "+1 m",
]


@pytest.mark.parametrize("text", FORMULAS)
def test_a_formula_becomes_text(text):
    assert harmless_cell(text).startswith("'")
    assert harmless_cell(text).replace("'", "") == text.replace("'", "")


@pytest.mark.parametrize(
    "text", ["-1.5", "+3", "-.5e-7", "1e+3", "0", "", "Video", "a=b", "r_1", "2026-11-22T16:16:25Z"]
)
def test_numbers_and_texts_stay(text):
    assert harmless_cell(text) == text


def test_a_formula_behind_another_separator_is_seen():
    assert harmless_cell("a;=1+1") == "a;'=1+1"
    assert harmless_cell("line\n@x") == "line\n'@x"


def test_the_command_writes_copies_and_changes_no_table(tmp_path, robot_runner):
    made = make_experiment(
        tmp_path / "made",
        [Factor("Task", ["=1+1", "Video"]), Factor("Offset", [-1.5, 2.0])],
        lambda treatments, repetition: {"Energy": -870.0},
        measures=["Energy"],
        units={"Energy": "J"},
    )
    (made.root / "report" / "tables").mkdir(parents=True)
    (made.root / "report" / "tables" / "means.csv").write_text("Task,Mean\r\n@x,-3.5\r\n", encoding="utf-8")
    before = made.run_table.read_bytes()
    answer = robot_runner("export", made.root, "--to", tmp_path / "out", "--spreadsheets")
    assert answer.code == 0, answer.err
    assert "Spreadsheets" in answer.out
    assert made.run_table.read_bytes() == before == (tmp_path / "out" / "run_table.csv").read_bytes()
    with (tmp_path / "out" / "spreadsheets" / "run_table.csv").open(encoding="utf-8-sig", newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["Task"] for row in rows} == {"'=1+1", "Video"}
    assert {float(row["Offset"]) for row in rows} == {-1.5, 2.0}
    assert {float(row["Energy"]) for row in rows} == {-870.0}
    assert (tmp_path / "out" / "spreadsheets" / "means.csv").read_text("utf-8-sig") == "Task,Mean\n'@x,-3.5\n"
    assert robot_runner("export", made.root, "--to", tmp_path / "plain").code == 0
    assert not (tmp_path / "plain" / "spreadsheets").exists()
