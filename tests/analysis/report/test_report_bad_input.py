"""Whatever an experiment lacks, its report says what could not be computed and why."""

from __future__ import annotations

import html
import itertools
import re
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import pytest
from tests.analysis.experiment_folders import Folder

from robot_runner.analysis.figures.style import FigureFormat
from robot_runner.analysis.report.rendering import csv_of, latex_label, latex_of
from robot_runner.analysis.report.writing import ReportFormat, write_report

if TYPE_CHECKING:
    from pathlib import Path

    from robot_runner.analysis.report.writing import WrittenReport

HOSTILE = [
    "<script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    r"50% of $x_1$ & \input{/etc/passwd} #~^",
    "../../../escape",
    "a|b *c* `d` [e](javascript:f)",
    "=1+1",
    "Grüße, 速度 🤖",
]


def text_of(folder, **settings):
    """What a reader reads: the page's text, without style, scripts and markup."""
    page = write_report(folder.root, figures=(), **settings).document.read_text(encoding="utf-8")
    page = re.sub(r"<(style|script).*?</\1>", " ", page, flags=re.DOTALL)
    return re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]+>", " ", page)))


def p_values(text):
    return re.findall(r"\bp\s*[<=]\s*0\.\d+", text)


def test_without_a_run_that_is_done_there_is_a_report_that_says_so(two_tasks):
    text = text_of(two_tasks(statuses=dict.fromkeys(range(10), "-")))
    assert "0 of 10" in text
    assert "No run is done: there is nothing to describe." in text
    assert "There is nothing to draw: no run is done." in text
    assert "had one treatment only" not in text  # it had none
    assert "after the fact" not in text  # there is none yet
    assert p_values(text) == []


def test_a_column_of_numbers_and_texts_is_not_called_one_of_texts(two_tasks):
    text = text_of(two_tasks(video=(870.1, "inf", 869.0, 874.2, 871.3)))
    assert "In 1 of 10 runs it is inf, which is not a number." in text
    assert "There is nothing to draw: no run that is done has a number." in text
    text = text_of(two_tasks(video=("a",) * 5, network=("b",) * 5))
    assert "Its values are neither numbers nor True and False." in text


def test_whole_numbers_of_more_than_53_bits_are_shown_as_they_are(make_folder):
    rows = [("a", 1764000000000000797 + place) for place in range(3)]
    folder = make_folder(factors={"Task": ["a"]}, rows=rows, measures={"Begun": "ns"}, types={"Begun": "integer"})
    assert "1,764,000,000,000,000,799" in text_of(folder)


def test_when_all_runs_failed_their_reasons_are_told(two_tasks):
    text = text_of(two_tasks(statuses=dict.fromkeys(range(10), "Failed")))
    assert "10 failed" in text
    assert "the robot fell over" in text
    assert p_values(text) == []


@pytest.mark.long
def test_runs_that_failed_are_a_threat_and_are_left_out(two_tasks):
    text = text_of(two_tasks(statuses={0: "Failed", 7: "Failed"}))
    assert "2 runs failed and are not in the statistics." in text
    assert "r_1, r_8" in text
    assert "8 of 10" in text


@pytest.mark.long
def test_an_experiment_that_is_not_over_has_a_report_so_far(two_tasks):
    text = text_of(two_tasks(statuses={9: "-"}))
    assert "1 run of 10 is still to do." in text
    assert "9 of 10" in text
    assert "Groups are not equally large" in text


@pytest.mark.long
def test_one_treatment_alone_is_described_and_not_tested(make_folder):
    rows = [("Video", value) for value in (1.0, 1.1, 0.9, 1.2)]
    text = text_of(make_folder(factors={"Task": ["Video"]}, rows=rows, measures={"Energy": "J"}))
    assert "1.050" in text
    assert "Factors were not varied" in text
    assert p_values(text) == []


@pytest.mark.long
def test_no_factor_at_all_is_described_and_not_tested(make_folder):
    rows = [(value,) for value in (1.0, 1.1, 0.9, 1.2)]
    text = text_of(make_folder(factors={}, rows=rows, measures={"Energy": "J"}))
    assert "1.050" in text
    assert p_values(text) == []


def test_one_repetition_is_not_tested(two_tasks):
    text = text_of(two_tasks(video=(870.0,), network=(830.0,)))
    assert p_values(text) == []
    assert "Few repetitions" in text
    assert "870" in text


@pytest.mark.long
def test_values_that_are_all_equal_are_not_tested(two_tasks):
    text = text_of(two_tasks(video=(870.0,) * 5, network=(870.0,) * 5))
    assert p_values(text) == []
    assert "Not computed" in text


@pytest.mark.long
def test_missing_values_are_counted(two_tasks):
    text = text_of(two_tasks(video=(870.1, None, 869.0, 874.2, 871.3)))
    assert "No value in 1 of 10 runs that are done." in text


def test_a_measure_without_any_value_is_not_computed(two_tasks):
    text = text_of(two_tasks(video=(None,) * 5, network=(None,) * 5))
    assert p_values(text) == []
    assert "Not computed" in text


@pytest.mark.long
def test_groups_of_unequal_size_are_told(two_tasks):
    text = text_of(two_tasks(video=(870.1, 872.4, 869.0), network=(834.0, 836.1, 833.2, 838.0, 835.5, 836.0)))
    assert "Combinations have 3 to 6 runs" in text
    assert p_values(text)


@pytest.mark.long
def test_groups_of_equal_size_beside_empty_ones_have_one_size(make_folder):
    rows = [(one, other, 1.0 + 0.1 * each) for one, other in ("ap", "aq", "bp") for each in (1, 3, 2)]
    text = text_of(make_folder(factors={"A": ["a", "b"], "B": ["p", "q"]}, rows=rows, measures={"Energy": "J"}))
    assert re.search(r"\b3 runs each of a combination", text)
    assert "3 to 3" not in text


@pytest.mark.long
def test_without_moments_the_order_of_the_table_is_not_taken_for_that_of_execution(tmp_path):
    rows = [(task, 870.0 + place + (task == "b")) for place, task in enumerate("ababababab")]
    folder = Folder(tmp_path / "trial", {"Task": ["a", "b"]}, rows, {"Energy": "J"})
    folder.write()
    (tmp_path / "trial" / "journal.jsonl").unlink()
    text = text_of(folder)
    assert "Energy over the order of the table within treatments: each run less the mean" in text
    assert "Residuals over the order of the table, which may be another than that of execution" in text


def test_values_that_are_too_small_to_compute_with_are_told(two_tasks):
    text = text_of(two_tasks(video=(1e-300, 3e-300, 2e-300), network=(5e-300, 7e-300, 6e-300)))
    assert p_values(text) == []
    assert "too small to compute with" in text


@pytest.mark.long
def test_a_measure_that_is_no_number_is_shown_and_not_computed(make_folder):
    rows = [("a", "ok", 1.0), ("a", "stuck", 1.1), ("b", "ok", 1.2), ("b", "ok", 1.3)]
    folder = make_folder(
        factors={"Task": ["a", "b"]}, rows=rows, measures={"Verdict": "", "Energy": "J"}, types={"Verdict": "string"}
    )
    text = text_of(folder)
    assert "stuck" in text
    assert re.search(r"Verdict.{0,200}number", text)


@pytest.mark.long
def test_a_factor_of_a_hundred_levels_has_a_report(make_folder):
    levels = [f"level {number}" for number in range(100)]
    rows = [(level, 1.0 + place * 0.01 + repeat * 0.1) for place, level in enumerate(levels) for repeat in range(2)]
    folder = make_folder(factors={"Speed": levels}, rows=rows, measures={"Energy": "J"})
    folder.write_samples("Meter", "samples.csv", "time_s,power_W", lambda place: [f"{t},{place}" for t in range(12)])
    text = text_of(folder)
    assert "94 combinations between them left out" in text
    assert "level 99" in text


@pytest.mark.long
def test_two_factors_are_drawn_and_told_together(make_folder):
    rows = [
        (task, speed, 100.0 + 10 * (task == "b") + 5 * (speed == "fast") + repeat * 0.7 + place * 0.1)
        for place, (task, speed) in enumerate(itertools.product("abc", ["slow", "fast"]))
        for repeat in range(4)
    ]
    folder = make_folder(factors={"Task": list("abc"), "Speed": ["slow", "fast"]}, rows=rows, measures={"Energy": "J"})
    text = text_of(folder)
    assert "Interactions of factors" in text
    assert "a / slow" in text


@dataclass(frozen=True)
class Hostile:
    """An experiment in which every name is an attack, with its report: a page, Markdown, and files of figures."""

    root: Path
    page: str
    markdown: str
    written: WrittenReport
    strays: set[Path]


@pytest.fixture(scope="module")
def hostile(tmp_path_factory):
    around = tmp_path_factory.mktemp("hostile")
    factor, measure = HOSTILE[1], HOSTILE[2]
    folder = Folder(
        around / "experiment",
        factors={factor: HOSTILE},
        rows=[(level, 10.0 + place + repeat * 0.5) for place, level in enumerate(HOSTILE) for repeat in range(3)],
        measures={measure: "<b>J</b>"},
        name=HOSTILE[0],
        failure=HOSTILE[1],
        statuses={0: "Failed"},
        manifest={"deviations": {"robot": HOSTILE[0]}, "robot": HOSTILE[0], "host": {"system": HOSTILE[1]}},
    )
    folder.write()
    folder.write_samples(
        "Meter", "samples.csv", "time_s,<i>power</i>_W", lambda place: [f"{t},{place}" for t in range(30)]
    )
    before = set(around.rglob("*"))
    written = write_report(folder.root, figures=(FigureFormat.PNG,))
    strays = {path for path in around.rglob("*") if "report" not in path.parts} ^ before
    markdown = write_report(folder.root, ReportFormat.MARKDOWN, output=around / "markdown", figures=()).document
    texts = (path.read_text(encoding="utf-8") for path in (written.document, markdown))
    return Hostile(folder.root, *texts, written, strays)


def test_names_are_text_in_the_page(hostile):
    page = hostile.page
    assert page.count("<script>alert") == 0
    assert "<img src=x" not in page
    assert "<b>J</b>" not in page
    assert "<i>power</i>" not in page
    assert HOSTILE[0] in html.unescape(page)
    # Data of charts stand in a script element, which must not end within them.
    for data in re.findall(r'<script type="application/json">(.*?)</script>', page, re.DOTALL):
        assert "<" not in data


def test_names_are_text_in_latex(hostile):
    for path in hostile.written.tables:
        if path.suffix == ".tex":
            body = path.read_text(encoding="utf-8")
            assert r"\input" not in body
            assert not re.search(r"(?<!\\)\$x", body)
            begun, ended = (re.findall(rf"\\{which}\{{(table\*?|tabular)\}}", body) for which in ("begin", "end"))
            assert Counter(begun) == Counter(ended)
            assert body.count(r"\begin") == len(begun)
            assert body.count(r"\end") == len(ended)
            assert len([each for each in begun if each != "tabular"]) == 1


def test_names_are_text_in_markdown(hostile):
    prose = re.sub(r"```.*?```", "", hostile.markdown, flags=re.DOTALL)
    assert "<script>" not in prose.replace("\\<", "")
    rows = [line for line in prose.splitlines() if line.startswith("|")]
    assert all(len(re.findall(r"(?<!\\)\|", line)) >= 2 for line in rows)
    assert not re.search(r"(?<!\\)\]\(javascript:", prose)


def test_files_are_written_nowhere_else(hostile):
    written = hostile.written
    assert hostile.strays == set()
    for path in (*written.tables, *written.figures):
        assert re.fullmatch(r"[A-Za-z0-9_-]+\.(csv|tex|svg|pdf|png)", path.name)
    assert len(set(written.tables)) == len(written.tables)
    assert len(set(written.figures)) == len(written.figures)


@pytest.mark.long
def test_names_that_differ_in_signs_alone_get_files_of_their_own(make_folder):
    rows = [("x", 1.0, 2.0), ("x", 1.1, 2.2), ("y", 1.2, 2.1), ("y", 1.3, 2.3)]
    folder = make_folder(factors={"T": ["x", "y"]}, rows=rows, measures={"a/b": "J", "a b": "J"})
    written = write_report(folder.root, figures=(FigureFormat.SVG,))
    assert len({path.name.casefold() for path in written.figures}) == len(written.figures)
    assert len({path.name.casefold() for path in written.tables}) == len(written.tables)


@pytest.mark.long
def test_tables_have_as_many_cells_as_columns_everywhere(hostile):
    from robot_runner.analysis.report.document import report_document
    from robot_runner.analysis.report.material import Material
    from robot_runner.analysis.results import load_results
    from robot_runner.analysis.statistics.experiment_statistics import analyse

    results = load_results(hostile.root)
    document = report_document(Material(results, analyse(results)), made="")
    assert document.tables
    for table in document.tables:
        assert {len(row) for row in table.rows} <= {len(table.columns)}
        assert csv_of(table)
        assert latex_of(table, latex_label)


@pytest.mark.long
def test_values_that_a_person_entered_are_not_said_to_be_a_model_s(two_tasks):
    text = text_of(two_tasks(origin="entered by hand"))
    assert "Energy was entered by a person" in text
    assert "estimating model" not in text
    assert "simulated or estimated" not in text
