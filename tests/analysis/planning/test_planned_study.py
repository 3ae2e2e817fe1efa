"""A factor that only counts repetitions, as in the paper's Listing 1, is no factor of a study that is planned."""

from __future__ import annotations

from dataclasses import replace

import pytest

from robot_runner.analysis.planning.planned_study import Study
from robot_runner.analysis.planning.power_analysis import Assumptions, power_analysis
from robot_runner.analysis.planning.power_search import Search
from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import AnalysisError
from robot_runner.designs import OneFactorAtATime

TASK = Factor("Task", ["Idle", "Video"])
UNITS = {"Energy": "J"}


def study_of(name: str, plan: AnalysisPlan | None = None, blocks: str | None = None) -> Study:
    model = RunTableModel([TASK, Factor(name, range(1, 16))], blocks=blocks)
    return Study.of_model("study", model, plan, UNITS)


@pytest.mark.parametrize("name", ["Repetition", "repetition"])
def test_the_treatments_of_a_factor_that_counts_are_the_repetitions(name: str) -> None:
    study = study_of(name)
    assert study.factors == {"Task": ("Idle", "Video")}
    assert study.cells == (("Idle",), ("Video",))
    assert study.repetitions == 15
    assert study.runs(15) == 30


@pytest.mark.parametrize("name", ["Repetition", "repetition"])
def test_blocks_by_a_factor_that_counts_are_blocks_by_the_repetition(name: str) -> None:
    study = study_of(name, AnalysisPlan("Energy", blocks=name), blocks=name)
    results = study.results(4, {"Energy": [1.0] * 8})
    assert study.blocks == results.block == "Repetition"
    assert results.plan is not None
    assert results.plan.blocks == "Repetition"
    assert results.factors == ("Task",)
    assert results.runs["Repetition"].nunique() == 4


def test_a_design_of_its_own_says_what_to_do_about_a_factor_that_counts() -> None:
    design = OneFactorAtATime({"Task": "Idle", "Repetition": 1})
    model = RunTableModel([TASK, Factor("Repetition", [1, 2])], design=design)
    with pytest.raises(AnalysisError, match="counts the repetitions") as caught:
        Study.of_model("study", model, None, UNITS)
    assert "repetitions=2" in caught.value.fix


def test_blocks_that_runs_get_when_they_are_executed_are_refused() -> None:
    model = RunTableModel([Factor("Task", ["Video", "Network"])], repetitions=6)
    with pytest.raises(
        AnalysisError, match="compares within Robot, which runs get only when they are executed"
    ) as told:
        Study.of_model("study", model, AnalysisPlan("Energy", blocks="Robot"), {"Energy": "J"})
    assert "Factor('Robot', [...])" in told.value.fix
    robots = RunTableModel([*model.factors, Factor("Robot", ["a", "b"])], repetitions=3)
    assert Study.of_model("study", robots, AnalysisPlan("Energy", blocks="Robot"), {"Energy": "J"}).has_units


@pytest.mark.parametrize("of_blocks", [Assumptions(blocks=["5"]), Assumptions(responses=["5"])])
def test_what_is_said_of_blocks_is_refused_in_a_study_without_any(of_blocks: Assumptions) -> None:
    model = RunTableModel([Factor("Task", ["Video", "Network"])], repetitions=6)
    study = Study.of_model("study", model, None, {"Energy": "J"})
    assumptions = replace(of_blocks, spreads=["5"], differences=["Task=5"])
    with pytest.raises(AnalysisError, match="the study has no blocks"):
        power_analysis(study, assumptions, Search(first=3, last=4, simulations=500))


def test_a_treatment_that_is_excluded_everywhere_is_none_of_the_study() -> None:
    planner, world = Factor("Planner", ["A", "B", "C"]), Factor("World", ["x", "y"])
    model = RunTableModel([planner, world], repetitions=4, exclude_combinations=[{planner: ["C"]}])
    study = Study.of_model("study", model, None, UNITS)
    assert study.factors == {"Planner": ("A", "B"), "World": ("x", "y")}
    assumptions = Assumptions(spreads=["1"], differences=["Planner=3"])
    found = power_analysis(study, assumptions, Search(first=4, last=4, simulations=20))
    (scenario,) = found.scenarios
    assert [scenario.claims[place].label for place in scenario.sought] == ["effect of Planner on Energy"]
    assert scenario.scenario.measures[0].means[("B", "x")] - scenario.scenario.measures[0].means[("A", "x")] == 3
