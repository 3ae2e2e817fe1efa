"""The report of an experiment that was repeated until it was precise shows the intervals that hold then."""

from __future__ import annotations

import copy
import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from tests.analysis.made_experiment import make_experiment
from tests.analysis.report.agreement import disagreements

from robot_runner.analysis import load_results
from robot_runner.analysis.report.writing import ReportFormat, write_report
from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.outliers import Outliers
from robot_runner.core.design.precision import Precision, rules_as_mapping
from robot_runner.core.design.repeated_intervals import half_width_of, level_at_each_look
from robot_runner.core.execution.experiment_status import read_status

if TYPE_CHECKING:
    from pathlib import Path

    from robot_runner.core.storage.layout import ExperimentFolder

FACTORS = (Factor("Task", ["Video", "Idle"]), Factor("Speed", [1, 2]))


def made(root: Path, *rules: Precision, least: int = 5, spread: float = 1.0, values: Any = None) -> ExperimentFolder:
    random = np.random.default_rng(3)

    def usual(treatments: dict[str, Any], repetition: int) -> dict[str, Any]:
        mean = 100 + 20 * (treatments["Task"] == "Video") + repetition
        return {"Energy": mean + spread * random.normal(), "Time": random.normal(50, 1)}

    folder = make_experiment(
        root, FACTORS, values or usual, measures=["Energy", "Time"], units={"Energy": "J"}, repetitions=8
    )
    manifest = json.loads(folder.manifest.read_text(encoding="utf-8"))
    manifest["repeat_until"] = rules_as_mapping(rules, least)
    folder.manifest.write_text(json.dumps(manifest), encoding="utf-8")
    return folder


def report(folder: ExperimentFolder, kind: ReportFormat = ReportFormat.JSON) -> str:
    written = write_report(load_results(folder.root), kind, output=folder.root.parent / kind.value, figures=())
    return written.document.read_text(encoding="utf-8")


@pytest.mark.long
@pytest.mark.parametrize("half_width", ["5 %", "0.1 J"])
def test_the_planned_measure_has_intervals_that_hold_after_all_looks(tmp_path: Path, half_width: str) -> None:
    folder = made(tmp_path / "made", Precision("Energy", half_width=half_width, at_most=30))
    found = json.loads(report(folder))
    (known,) = found["precision"]
    runs = load_results(folder.root).runs
    values = runs[(runs["Task"] == "Video") & (runs["Speed"] == 1)]["Energy"]
    energy, time = found["statistics"]["measures"]
    interval = energy["by_combination"][0]["mean_interval"]
    half = half_width_of(list(values), level_at_each_look(5, 30))
    assert (interval["high"] - interval["low"]) / 2 == pytest.approx(half)
    assert interval["method"] == "repeated interval (Jennison and Turnbull 1989)"
    assert time["by_combination"][0]["mean_interval"]["method"] == "t distribution"
    difference = next(each for each in known["differences"] if each["of"] == "Video - Idle")
    assert difference["n"] == 8
    assert abs(difference["mean"] - 20) < difference["half_width"] < 2, "drift between repetitions falls out"
    assert known["is_reached"] is (half_width == "5 %")
    assert disagreements(found) == []
    assert any("not as precise as planned" in each["title"] for each in found["threats"]) is not known["is_reached"]


@pytest.mark.long
def test_a_report_that_contradicts_itself_about_precision_is_found(tmp_path: Path) -> None:
    found = json.loads(report(made(tmp_path / "made", Precision("Energy", half_width="5 %", at_most=30))))
    for name, wrong in (("is_reached", False), ("asked", "until nobody looks"), ("repetitions", 9)):
        broken = copy.deepcopy(found)
        broken["precision"][0][name] = wrong
        assert disagreements(broken), name
    broken = copy.deepcopy(found)
    broken["precision"][0]["means"][0]["half_width"] *= 1.01
    assert disagreements(broken)


@pytest.mark.long
def test_the_report_says_what_was_asked_for_and_what_becomes_of_the_tests(tmp_path: Path) -> None:
    page = report(made(tmp_path / "made", Precision("Energy", half_width="5 %", at_most=30)), ReportFormat.MARKDOWN)
    assert "at least 5, at most 30 repetitions; 8 repetitions in the end" in page
    assert "(4 of 4 means precise)" in page
    assert "at 5 %, 3.5 to 6.5 % of experiments without a difference show one" in page
    assert "differences between treatments, compared within repetitions" in page
    assert "skewed" not in page
    rule = Precision("Energy", half_width="0.1 J", at_most=30, of="differences")
    early = report(made(tmp_path / "early", rule), ReportFormat.MARKDOWN)
    assert "up to 9 %, as it ended before the rule was followed to its end, of experiments" in early


def test_the_report_says_that_intervals_of_skewed_values_hold_less_often(tmp_path: Path) -> None:
    random = np.random.default_rng(5)

    def values(treatments: dict[str, Any], repetition: int) -> dict[str, Any]:
        return {"Energy": 10 + random.lognormal(), "Time": random.normal(50, 1)}

    rules = [Precision(measure, half_width="5 %", at_most=30) for measure in ("Energy", "Time")]
    folder = made(tmp_path / "made", *rules, values=values)
    energy, time = (each["sentence"] for each in json.loads(report(folder))["precision"])
    assert "Values are skewed (" in energy
    assert "the intervals hold in 88 to 95 %" in energy
    assert "skewed" not in time


@pytest.mark.long
def test_values_that_the_plan_leaves_out_are_left_out_of_the_precision(tmp_path: Path) -> None:
    folder = made(tmp_path / "made", Precision("Energy", half_width="5 %", at_most=30))
    manifest = json.loads(folder.manifest.read_text(encoding="utf-8"))
    manifest["analysis"] = AnalysisPlan("Energy", outliers=Outliers(bounds={"Energy": (None, 127)})).as_mapping()
    folder.manifest.write_text(json.dumps(manifest), encoding="utf-8")
    found = json.loads(report(folder))
    gone = len(found["statistics"]["measures"][0]["left_out"])
    assert gone > 0
    assert sum(each["n"] for each in found["precision"][0]["means"]) == 32 - gone
    assert f"without {gone} values that the analysis leaves out" in found["precision"][0]["sentence"]
    assert disagreements(found) == []


def test_several_rules_have_one_level_and_the_one_that_is_furthest_off_is_shown(tmp_path: Path) -> None:
    rules = (
        Precision("Energy", half_width="5 %", at_most=30),
        Precision("Energy", half_width="0.1 J", at_most=8),
        Precision("Time", half_width="0.1", at_most=12, of="differences"),
    )
    folder = made(tmp_path / "made", *rules)
    found = json.loads(report(folder))
    energy, time = found["precision"]
    assert energy["level"] == time["level"] == level_at_each_look(5, 30), "all are looked at until the last gives up"
    assert not energy["is_reached"]
    assert {each["wanted"] for each in energy["means"]} == {0.1}
    assert time["means"], "means are known as well where differences were asked for"
    assert disagreements(found) == []
    status = read_status(folder.root)
    assert status.repeated.endswith("at least 5, at most 30 repetitions")
