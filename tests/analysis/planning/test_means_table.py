"""A file of means says of each combination one thing, in one way."""

from __future__ import annotations

import csv
import os
from typing import TYPE_CHECKING

import pytest

from robot_runner.analysis.planning.means_table import means_file
from robot_runner.analysis.planning.planned_study import Study
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import AnalysisError

if TYPE_CHECKING:
    from pathlib import Path

STUDY = Study.of_model(
    "study",
    RunTableModel([Factor("Task", ["Video", "Network"]), Factor("Map", ["lab", "hall"])], repetitions=3),
    None,
    {"Energy": "J"},
)

_SEMICOLONS = "Write decimal points, or semicolons between the cells."
_EACH = "Give it a cell under each heading."


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("Task,Energy\nVideo,1\nNetwork,2\nVideo,9\n", "rows 1 and 3 are both of Video"),
        ("Energy\n1\n9\n", "rows 1 and 2 are both of all combinations"),
        ("Energy\n", "4 combinations of the design have no row"),
        ("Task,Energy,Energy.sd\nVideo,1,1\nNetwork,2,-3\n", "Energy.sd of Network x lab, Network x hall is below 0"),
    ],
)
def test_a_file_that_says_two_things_or_nothing_is_refused(tmp_path: Path, text: str, problem: str) -> None:
    path = tmp_path / "means.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(AnalysisError) as refused:
        means_file(STUDY, path, {"Energy": 1.0}, ["Energy"])
    assert problem in refused.value.problem


@pytest.mark.parametrize(
    "text",
    [
        "Task;Speed;Energy;Energy.sd\nVideo;0,1;8,5;1,5\nVideo;0,2;9;1,5\n",
        "Task\tSpeed\tEnergy\nVideo\t0,1\t8,5\nVideo\t0,2\t9\n",
    ],
    ids=["semicolons", "tabs"],
)
@pytest.mark.parametrize(("above", "encoding"), [("", "utf-8-sig"), ("sep={}\n", "cp1252")])
def test_means_that_a_german_excel_has_saved_are_read(tmp_path: Path, text: str, above: str, encoding: str) -> None:
    path = tmp_path / "means.csv"
    path.write_text(above.format(text[4]) + text.replace("Video", "Größe"), encoding=encoding)
    table = RunTableModel([Factor("Task", ["Größe"]), Factor("Speed", [0.1, 0.2])], repetitions=3)
    study = Study.of_model("study", table, None, {"Energy": "J"})
    found = means_file(study, path, {"Energy": 1.5}, ["Energy"])["Energy"]
    assert (found.means, found.spreads) == (
        {("Größe", "0.1"): 8.5, ("Größe", "0.2"): 9},
        {("Größe", "0.1"): 1.5, ("Größe", "0.2"): 1.5},
    )


@pytest.mark.parametrize(
    ("text", "line", "problem", "fix"),
    [
        ("Task,Energy\n\nVideo,8,5\n", ":3", "'Video,8,5' has 3 cells, and the heading has 2", _SEMICOLONS),
        ("Task,Energy\nVideo\n", ":2", "'Video' has 1 cell, and the heading has 2", _EACH),
        ("sep=;\nTask;Energy\nVideo;1;2\n", ":3", "'Video;1;2' has 3 cells, and the heading has 2", _EACH),
        ("Task,Energy,Energy\nVideo,8,5\n", "", "Energy is there twice", "Rename or delete one column."),
        ("", "", "no column is a measure", "Name one: Energy."),
    ],
)
def test_a_file_whose_rows_do_not_fit_its_heading_is_refused(
    tmp_path: Path, text: str, line: str, problem: str, fix: str
) -> None:
    """Where decimal commas stand between commas, half of a number would be taken for the whole."""
    path = tmp_path / "means.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(AnalysisError) as refused:
        means_file(STUDY, path, {"Energy": 1.0}, ["Energy"])
    assert (refused.value.problem, refused.value.fix) == (problem, fix)
    assert refused.value.where == f"--means {path}{line}"


@pytest.mark.parametrize(
    ("text", "doubt"),
    [
        ("Task\tEnergy\tEnergy.sd\nVideo\t1,234\t200\nNetwork\t1,500\t200\n", "1,234 may be 1.234 or 1234"),
        ("Task;Energy;Energy.sd\nVideo;1.234;200\nNetwork;1.500;200\n", "1.234 may be 1234 or 1.234"),
        ("Energy\tEnergy.sd\n1,234\t5\n0\t5\n", "1,234 may be 1.234 or 1234"),
        ('Task,Energy,Energy.sd\nVideo,"1,234",200\nNetwork,"1,500",200\n', "1,234 may be 1.234 or 1234"),
        ("Energy;Energy.sd;CPU\n1.234;0,5;1.2\n", "1.234 may be 1234 or 1.234"),
    ],
    ids=["commas", "points", "beside a zero", "quoted", "beside both"],
)
def test_a_mean_that_may_be_a_thousand_times_as_large_is_refused(tmp_path: Path, text: str, doubt: str) -> None:
    path = tmp_path / "means.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(AnalysisError, match="numbers of Energy can be read in two ways") as refused:
        means_file(STUDY, path, {}, ["Energy"])
    assert doubt in refused.value.problem


@pytest.mark.parametrize(
    ("text", "mean", "spread"),
    [
        ("Energy;Energy.sd\n1.234;0,5\n", 1234, 0.5),
        ("Energy\tEnergy.sd\n1,234\t0,5\n", 1.234, 0.5),
        ("Energy\tEnergy.sd\n1,234.5\t200\n", 1234.5, 200),
        ("Task;Energy\nVideo;80,5 %\nNetwork;90 %\n", 80.5, 39.62),
        ("Energy;Energy.sd\n12.345;1.2\n", 12.345, 1.2),
    ],
    ids=["points between thousands", "decimal commas", "commas between thousands", "percents", "decimal points"],
)
def test_one_number_tells_how_the_others_are_written(tmp_path: Path, text: str, mean: float, spread: float) -> None:
    path = tmp_path / "means.csv"
    path.write_text(text, encoding="utf-8")
    found = means_file(STUDY, path, {}, ["Energy"])["Energy"]
    assert (found.means["Video", "lab"], found.spreads["Video", "lab"]) == pytest.approx((mean, spread), abs=0.005)


@pytest.mark.parametrize("text", ["Energy,Energy.sd,,\n12.5,1.2,,\n", "Energy;Energy.sd\n12,5;1,2;;\n;;;\n"])
def test_separators_behind_the_last_cell_are_no_cells(tmp_path: Path, text: str) -> None:
    path = tmp_path / "means.csv"
    path.write_text(text, encoding="utf-8")
    assert means_file(STUDY, path, {}, ["Energy"])["Energy"].means["Video", "lab"] == 12.5


def test_a_mean_in_another_unit_is_no_number(tmp_path: Path) -> None:
    path = tmp_path / "means.csv"
    path.write_text("Energy\n8 kJ\n", encoding="utf-8")
    with pytest.raises(AnalysisError, match="has no number"):
        means_file(STUDY, path, {"Energy": 1.0}, ["Energy"])


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("Task,Energy\nPrüfung,1\n".encode("cp850"), "4 combinations of the design have no row"),
        (b"Task,Energy\nVideo," + b"1" * 200_000, "the file is not CSV: field larger than field limit (131072)"),
        (b"PK\x03\x04\0\0", "the file is not text: it holds zero bytes"),
    ],
    ids=["another code page", "long", "a workbook"],
)
def test_a_file_that_is_no_csv_is_refused_as_one_of_means(tmp_path: Path, content: bytes, problem: str) -> None:
    path = tmp_path / "means.csv"
    path.write_bytes(content)
    longest = csv.field_size_limit(131_072)  # another test of this process may have read a run table, which raises it
    try:
        with pytest.raises(AnalysisError) as refused:
            means_file(STUDY, path, {"Energy": 1.0}, ["Energy"])
    finally:
        csv.field_size_limit(longest)
    assert (refused.value.problem, refused.value.where) == (problem, f"--means {path}")
    assert "--table" not in (refused.value.fix or "")


def test_a_heading_that_is_a_name_of_pandas_is_told_as_any_other(tmp_path: Path) -> None:
    path = tmp_path / "means.csv"
    path.write_text("Task,self,Energy\nVideo,1,2\nNetwork,2,3\n", encoding="utf-8")
    with pytest.raises(AnalysisError, match="there is no factor or measure 'self'"):
        means_file(STUDY, path, {"Energy": 1.0}, ["Energy"])


def test_a_pipe_is_no_file_of_means(tmp_path: Path) -> None:
    """It is looked at before it is read, as in `--means <(tail -n 5 means.csv)`."""
    path = tmp_path / "pipe"
    os.mkfifo(path)
    with pytest.raises(AnalysisError, match="a pipe cannot be read twice"):
        means_file(STUDY, path, {"Energy": 1.0}, ["Energy"])


def test_a_row_too_many_names_the_column_that_is_missing(tmp_path: Path) -> None:
    path = tmp_path / "means.csv"
    path.write_text("Task,Energy\nVideo,1\nVideo,2\nNetwork,3\n", encoding="utf-8")
    with pytest.raises(AnalysisError) as refused:
        means_file(STUDY, path, {"Energy": 1.0}, ["Energy"])
    assert refused.value.fix == "Leave one out, or add the column Map."
