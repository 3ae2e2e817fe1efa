"""A report is one document, with its tables and figures as files beside it."""

from __future__ import annotations

import csv
import json
import re

import pytest

from robot_runner.analysis.figures.style import FigureFormat
from robot_runner.analysis.report.writing import ReportFormat, write_report
from robot_runner.core.errors import AnalysisError, StorageError

SECTIONS = [
    "in-brief",
    "what-was-done",
    "outcome-of-each-run",
    "descriptive-statistics",
    "figures",
    "tests",
    "threats-to-validity",
    "how-to-replicate",
]


def test_the_sections_stand_in_their_order_with_links(lone_page):
    page = lone_page.document.read_text(encoding="utf-8")
    assert re.findall(r'<section id="([^"]+)"', page) == SECTIONS
    assert re.findall(r'<a href="#([^"]+)">', page)[: len(SECTIONS)] == SECTIONS


def test_it_lies_in_the_experiment_s_folder_unless_told_otherwise(plain_report, lone_page):
    assert plain_report.document.parts[-3:] == ("trial", "report", "report.html")
    assert lone_page.document.parts[-3:] == ("elsewhere", "deep", "report.html")


def test_each_figure_is_written_in_each_format(plain_report):
    kinds = [{path.stem for path in plain_report.figures if path.suffix == f".{kind.value}"} for kind in FigureFormat]
    assert kinds[0] == kinds[1] == kinds[2]
    assert {"distribution_Energy_by_Task", "qq_Energy", "order_Energy", "timeline"} <= kinds[0]
    heads = {".svg": b"<?xml", ".pdf": b"%PDF", ".png": b"\x89PNG"}
    assert all(path.read_bytes().startswith(heads[path.suffix]) for path in plain_report.figures)


@pytest.mark.long
def test_figures_are_the_same_files_each_time(plain_report, tmp_path):
    experiment = plain_report.document.parents[1]
    again = write_report(experiment, output=tmp_path, figures=(FigureFormat.SVG, FigureFormat.PNG)).figures
    first = [path for path in plain_report.figures if path.suffix != ".pdf"]
    assert [path.name for path in again] == [path.name for path in first]
    assert [path.read_bytes() for path in again] == [path.read_bytes() for path in first]


def test_tables_are_written_as_csv_with_full_precision_and_as_latex(plain_report):
    by_name = {path.name: path for path in plain_report.tables}
    with by_name["runs.csv"].open(newline="", encoding="utf-8") as file:
        assert next(csv.DictReader(file))["Energy (J)"] == "870.123456789"
    latex = by_name["runs.tex"].read_text(encoding="utf-8")
    assert r"\begin{tabular}" in latex
    assert "870.1" in latex
    assert r"r\_1" in latex


@pytest.mark.long
def test_markdown_refers_to_figures_that_are_there(two_tasks):
    told = []
    written = write_report(two_tasks().root, ReportFormat.MARKDOWN, figures=(), on_step=lambda *step: told.append(step))
    assert list(dict.fromkeys(what for what, _, _ in told)) == ["statistics of measures", "figures", "tables"]
    assert [done for what, done, _ in told if what == "figures"] == list(range(len(written.figures)))
    text = written.document.read_text(encoding="utf-8")
    paths = re.findall(r"!\[.*?\]\((.*?)\)", text)
    assert paths
    assert all((written.document.parent / path).is_file() for path in paths)
    assert next(line for line in text.splitlines() if line.startswith("## ")) == "## In brief"


def test_json_holds_everything_and_draws_nothing(two_tasks):
    written = write_report(two_tasks().root, ReportFormat.JSON)
    assert written.figures == written.tables == ()
    assert [path.name for path in written.document.parent.iterdir()] == ["report.json"]
    facts = json.loads(written.document.read_text(encoding="utf-8"))
    assert facts["experiment"] == "trial"
    assert len(facts["runs"]) == 10
    [energy] = facts["statistics"]["measures"]
    assert energy["test"]["effects"][0]["is_significant"] is True
    assert {threat["kind"] for threat in facts["threats"]} <= {
        "Conclusion validity",
        "Internal validity",
        "Construct validity",
        "External validity",
    }


def test_a_page_needs_no_figures_beside_it(lone_page):
    assert lone_page.figures == ()
    assert not (lone_page.document.parent / "figures").exists()
    assert "data:image/svg+xml," in lone_page.document.read_text(encoding="utf-8")


@pytest.mark.long
def test_it_is_made_anew_over_an_earlier_one(two_tasks):
    folder = two_tasks()
    earlier = folder.root / "report" / "report.html"
    earlier.parent.mkdir()
    earlier.write_text("old", encoding="utf-8")
    assert write_report(folder.root, figures=()).document == earlier
    assert "In brief" in earlier.read_text(encoding="utf-8")


def test_one_measure_can_be_chosen(make_folder):
    rows = [("a", 1.0, 2.0), ("a", 1.1, 2.2), ("b", 1.2, 2.1), ("b", 1.3, 2.3)]
    folder = make_folder(factors={"Task": ["a", "b"]}, rows=rows, measures={"Energy": "J", "CPU": "%"})
    facts = json.loads(write_report(folder.root, ReportFormat.JSON, measures=["CPU"]).document.read_text())
    assert [measure["name"] for measure in facts["statistics"]["measures"]] == ["CPU"]


def test_a_measure_that_is_not_there_is_named(two_tasks):
    with pytest.raises(AnalysisError, match="'Enery'") as caught:
        write_report(two_tasks().root, measures=["Enery"])
    assert "'Energy'" in caught.value.fix


def test_a_folder_without_an_experiment_is_refused(tmp_path):
    with pytest.raises(StorageError):
        write_report(tmp_path)


def test_a_folder_that_cannot_be_written_is_named(two_tasks, tmp_path):
    blocked = tmp_path / "blocked"
    blocked.write_text("a file")
    with pytest.raises(StorageError, match="cannot be") as caught:
        write_report(two_tasks().root, output=blocked / "report")
    assert "blocked" in caught.value.where
