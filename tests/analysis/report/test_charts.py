"""The charts that answer to a pointer show what was measured, whatever its size."""

from __future__ import annotations

import json
import re
from itertools import pairwise

import numpy as np
import pytest
from tests.analysis.experiment_folders import two_tasks

from robot_runner.analysis import load_results
from robot_runner.analysis.figures.courses import Course, MissionCourses
from robot_runner.analysis.report import charts, outcome_section
from robot_runner.analysis.report.charts import course_chart
from robot_runner.analysis.report.document import report_document
from robot_runner.analysis.report.material import Material
from robot_runner.analysis.report.outcome_section import attempt_spans
from robot_runner.analysis.report.writing import write_report
from robot_runner.analysis.statistics.experiment_statistics import analyse
from robot_runner.analysis.wording import MISSING

PRESSURES = (101325.01, 101325.02, 101325.03, 101325.05)


def _points(root):
    page = write_report(root, figures=()).document.read_text(encoding="utf-8")
    return json.loads(re.search(r'<script type="application/json">(.*?)</script>', page)[1])


@pytest.mark.long
def test_large_values_that_differ_little_differ_in_the_chart_of_runs(tmp_path):
    points = _points(two_tasks(tmp_path / "trial", PRESSURES, (123456789, 2.0)).root)
    assert points["measures"][0]["values"] == [*PRESSURES, 123456789, 2.0]
    assert points["place"] == "Place in the order of execution"


@pytest.mark.parametrize(
    ("kind", "values"), [("number", (102.25, 1000.5, 8.0, 2e-5)), ("integer", (16, 9, 1234567, 0))]
)
def test_a_point_is_told_as_the_table_of_runs_has_its_value(tmp_path, kind, values):
    root = two_tasks(tmp_path / "trial", values, (4, None), types={"Energy": kind}).root
    results = load_results(root)
    made = report_document(Material(results, analyse(results)), made="")
    [chart] = [each for each in made.charts if each.kind == "points"]
    [runs] = [each for each in made.tables if each.name == "runs"]
    [place] = [at for at, column in enumerate(runs.columns) if column.name == "Energy (J)"]
    cells = [row[place].text for row in runs.rows]
    assert chart.data["measures"][0]["texts"] == [f"{cell} J" if cell != MISSING else cell for cell in cells]


def test_of_many_runs_the_chart_shows_an_even_share_and_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(charts, "_MOST_POINTS", 3)
    results = load_results(two_tasks(tmp_path / "trial", PRESSURES, PRESSURES).root)
    chart = charts.points_chart(Material(results, analyse(results)))
    assert chart.data["runs"] == ["r_1", "r_4", "r_5", "r_8"]
    assert chart.caption.startswith("8 runs in the order of execution. One in 3 of each treatment is shown. ")
    assert {len(chart.data[name]) for name in ("order", "group")} == {len(chart.data["measures"][0]["values"])} == {4}


def test_of_many_runs_the_timeline_shows_an_even_share_and_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(outcome_section, "_MOST_ROWS", 3)
    results = load_results(two_tasks(tmp_path / "trial", PRESSURES, PRESSURES).root)
    made = report_document(Material(results, analyse(results)), made="")
    [timeline] = [figure for figure in made.figures if figure.name == "timeline"]
    assert timeline.caption.endswith(" Of 8 runs, one in 3 of each treatment is shown.")
    assert timeline.alternative.startswith("4 attempts ")
    shown = [label.get_text() for label in timeline.draw().axes[0].get_yticklabels()]
    assert shown == ["r_1", "r_4", "r_5", "r_8"]


def test_an_even_share_of_runs_in_turn_has_all_treatments():
    is_shown, share = charts.even_share(["a", "b", "c"] * 20, 10)
    assert (sum(is_shown), share) == (12, 6)
    assert [label for label, each in zip(["a", "b", "c"] * 20, is_shown, strict=True) if each] == ["a", "b", "c"] * 4


@pytest.mark.long
def test_without_known_times_nobody_speaks_of_an_order_of_execution(tmp_path):
    folder = two_tasks(tmp_path / "trial", PRESSURES, PRESSURES)
    folder.files.journal.unlink()
    assert _points(folder.root)["place"] == "Place in the order of the table"


@pytest.mark.long
def spans_of(folder):
    """Return the bars of the timeline of an experiment."""
    results = load_results(folder.root)
    return attempt_spans(Material(results, analyse(results)))


def test_the_order_of_execution_is_the_journals_also_where_the_clock_was_set_back(tmp_path):
    folder = two_tasks(tmp_path / "trial", PRESSURES, PRESSURES)
    told = folder.files.journal.read_text().splitlines()
    is_before = re.compile(r'"run": ?"r_[12]"').search
    later = [line if is_before(line) else line.replace("T12:", "T11:") for line in told]
    folder.files.journal.write_text("".join(f"{line}\n" for line in later))
    points = _points(folder.root)
    assert points["place"] == "Place in the order of execution"
    assert points["runs"] == [f"r_{number}" for number in range(1, 9)]
    spans = spans_of(folder)
    assert [span.run_id for span in spans] == points["runs"]
    assert all(one.start < other.start and one.end <= other.start for one, other in pairwise(spans))


def test_a_clock_that_was_set_between_runs_leaves_no_gap_among_them(tmp_path):
    folder = two_tasks(tmp_path / "trial", PRESSURES, PRESSURES)

    before = spans_of(folder)
    told = folder.files.journal.read_text().splitlines()
    place = next(number for number, line in enumerate(told) if re.search(r'attempt_started.*"r_3"', line))
    later = [line.replace("T12:", "T13:") for line in told[place:]]
    was_set = '{"kind":"clock_set","at":"2026-01-01T13:00:00.000Z","seconds":3600.0}'
    folder.files.journal.write_text("".join(f"{line}\n" for line in (*told[:place], was_set, *later)))
    assert [(each.run_id, each.start) for each in spans_of(folder)] == [(each.run_id, each.start) for each in before]


@pytest.mark.parametrize("hour", ["T11:", "T13:"])
@pytest.mark.parametrize("since", ["start_measurement", "stop_measurement", "attempt_finished"])
def test_a_clock_that_was_set_during_a_run_moves_no_bar_of_the_timeline(tmp_path, since, hour):
    folder = two_tasks(tmp_path / "trial", PRESSURES, PRESSURES)

    before = spans_of(folder)
    told = folder.files.journal.read_text().splitlines()
    place = next(number for number, line in enumerate(told) if re.search(rf'(?=.*"{since}").*"r_3"', line))
    end = next(number for number, line in enumerate(told) if re.search(r'attempt_finished.*"r_3"', line))
    later = [line.replace("T12:", hour) for line in told[place:]]
    seconds = 3600.0 if hour == "T13:" else -3600.0
    later.insert(end - place, f'{{"kind":"clock_set","at":"2026-01-01{hour}00:00.000Z","seconds":{seconds}}}')
    folder.files.journal.write_text("".join(f"{line}\n" for line in (*told[:place], *later)))
    assert spans_of(folder) == before


def test_the_timeline_tells_no_measurement_outside_of_its_attempt(tmp_path):
    folder = two_tasks(tmp_path / "trial", PRESSURES, PRESSURES)  # r_3 on a machine with another time
    told = folder.files.journal.read_text().splitlines()
    is_its = re.compile(r'"kind": ?"event".*"r_3"').search
    folder.files.journal.write_text(
        "".join(f"{each.replace('T12:', 'T13:') if is_its(each) else each}\n" for each in told)
    )
    found = {span.run_id: span.measured for span in spans_of(folder)}
    assert found.pop("r_3") is None
    assert all(found.values())


def test_a_course_is_rounded_by_its_spread():
    run = Course("r_1", 1.0, np.arange(3), *(np.array(PRESSURES[:3]) + shift for shift in (0.0, -0.001, 0.001)), runs=1)
    later = Course("r_2", 1.0, np.array([1, 2]), *[np.array([101325.04, np.nan])] * 3, runs=1)
    chart = course_chart("c", MissionCourses("Pressure", "Pa", ("a",), {"a": [run, later]}, 1.0))
    group = chart.data["groups"][0]
    assert group["each"][0]["values"] == list(PRESSURES[:3])
    assert group["each"][1]["values"] == [None, 101325.04, None]
    assert chart.data["time"] == [0.5, 1.5, 2.5]
