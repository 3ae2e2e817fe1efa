"""What is assumed of a study is of its factors and measures, and of nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from robot_runner.analysis.planning.assumed_values import differences_of
from robot_runner.analysis.planning.planned_study import Study
from robot_runner.analysis.planning.power_analysis import Assumptions, scenarios_of
from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import AnalysisError

if TYPE_CHECKING:
    from pathlib import Path


def test_a_difference_of_a_conditional_factor_is_of_the_runs_to_which_it_applies() -> None:
    factors = [
        Factor("Sensor", ["camera", "lidar"]),
        Factor("Resolution", ["720p", "1080p", "4k"], when={"Sensor": "camera"}),
    ]
    study = Study.of_model("study", RunTableModel(factors, repetitions=3), None, {"Energy": "J"})
    assert study.varied == ("Sensor", "Resolution")
    (difference,) = differences_of(study, ["Resolution=4"], ["Energy"])
    assert [difference.at(study, cell) for cell in study.cells] == [-2, 0, 2, 0]
    with pytest.raises(AnalysisError) as refused:
        differences_of(study, ["Sensor x Resolution=4"], ["Energy"])
    assert refused.value.problem == "Sensor has one treatment where Resolution applies"


def test_a_share_beside_a_file_of_means_moves_these_and_keeps_their_differences(tmp_path: Path) -> None:
    study = Study.of_model(
        "study", RunTableModel([Factor("Task", ["Video", "Network"])], repetitions=3), None, {"Ok": "", "Energy": "J"}
    )
    path = tmp_path / "means.csv"
    path.write_text("Task,Ok,Energy\nVideo,80%,3\nNetwork,90%,4\n", encoding="utf-8")
    told = Assumptions(means=path, measures=["Ok"], shares=["Ok=50"])
    (scenario,) = scenarios_of(study, told)
    assert scenario.measures[0].means == {("Video",): 45, ("Network",): 55}
    with pytest.raises(AnalysisError, match="Energy is a number, and not yes or no"):
        scenarios_of(study, Assumptions(means=path, measures=["Energy"], shares=["Energy=50"], spreads=["Energy=1"]))


@pytest.mark.parametrize(
    ("shares", "spreads", "problem"),
    [
        (["Okk=85"], [], "--share: there is no measure 'Okk'"),
        (["0.85"], [], "--share: '0.85' reads as a fraction → Give percent: 85 (or 0.85%, if so few say yes)."),
        (["Ok=60"], ["Ok=3"], "--sd Ok=3: Ok is yes or no"),
        (["60"], ["3"], "--sd 3: Ok is yes or no"),
    ],
)
def test_a_share_that_cannot_be_meant_is_refused(shares: list[str], spreads: list[str], problem: str) -> None:
    study = Study.of_model("study", RunTableModel([Factor("Task", ["Video", "Network"])]), None, {"Ok": ""})
    with pytest.raises(AnalysisError) as refused:
        scenarios_of(study, Assumptions(shares=shares, spreads=spreads, differences=["Task=0.1"]))
    assert problem in str(refused.value)


def test_less_than_one_percent_is_a_share_where_it_is_written_so() -> None:
    study = Study.of_model("study", RunTableModel([Factor("Task", ["Video", "Network"])]), None, {"Ok": ""})
    (scenario,) = scenarios_of(study, Assumptions(shares=["0.5%"], differences=["Task=0.2"]))
    assert scenario.measures[0].means == pytest.approx({("Video",): 0.4, ("Network",): 0.6})


@pytest.mark.parametrize("option", ["spreads", "shares", "differences", "blocks", "responses"])
def test_what_is_said_of_a_measure_that_is_not_simulated_is_refused(option: str) -> None:
    """It would have no effect, and the answer would be of other assumptions than the user has typed."""
    table = RunTableModel([Factor("Task", ["Video", "Network"])], repetitions=3, blocks="Repetition", shuffle=True)
    study = Study.of_model("study", table, AnalysisPlan(["Energy"]), {"Energy": "J", "Energie": "J", "CPU": "%"})
    given = {"spreads": ["Energy=5"], "differences": ["Energy:Task=5"]}
    said = "{}:Task=5" if option == "differences" else "{}=5"
    with pytest.raises(AnalysisError) as refused:
        scenarios_of(study, Assumptions(**(given | {option: [*given.get(option, ()), said.format("CPU")]})))
    assert refused.value.problem == "CPU is not simulated, only Energy"
    assert refused.value.fix == "Name all of them (--measure Energy --measure CPU), or leave it out."
    with pytest.raises(AnalysisError) as refused:
        scenarios_of(study, Assumptions(**(given | {option: [*given.get(option, ()), said.format("Energie")]})))
    fix = "Did you mean 'Energy'? Name all of them (--measure Energy --measure Energie), or leave it out."
    assert refused.value.fix == fix
