"""What can be learnt from designs within a budget: durations, what is told apart, power, and a recommendation."""

from __future__ import annotations

import json
from dataclasses import replace
from textwrap import dedent

import pytest

from robot_runner.analysis.planning.candidate_designs import RunTimes, candidates_of, most_repetitions
from robot_runner.analysis.planning.design_comparison import Asked, compare_designs
from robot_runner.analysis.planning.power_analysis import Assumptions
from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.hypothesis import Hypothesis
from robot_runner.core.design.numeric_range import Range
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.designs.crossover import Crossover
from robot_runner.designs.response_surface import CentralComposite
from robot_runner.designs.squares import GraecoLatinSquare, LatinSquare

FACTORS = [Factor(name, ["low", "high"]) for name in ("Speed", "Load", "Map", "Floor")]


def asked(budget, **assumed):
    return Asked("study", None, {"Energy": "J"}, Assumptions(**assumed), (), budget)


def compared(model, times, question, hard=()):
    found = compare_designs(candidates_of(model, hard), times, question)
    return {each.name: each for each in found.designs}, found


@pytest.mark.long
def test_designs_are_compared_by_what_they_tell_and_find():
    times = RunTimes(lambda _: 95.0, 5.0, {"Floor": 600.0})
    designs, found = compared(RunTableModel(FACTORS, seed=7), times, asked(4 * 3600.0), ["Floor"])
    full, fraction = designs["full factorial"], designs["fraction of resolution IV"]
    assert full.aliased == "nothing"
    assert fraction.combinations == 8
    assert fraction.aliased.startswith("Speed = Load x Map x Floor, Load = ")
    # Floors change in half of all steps of a randomised order, which takes most of the time; whole plots save that.
    split = designs["split plot, Floor in whole plots"]
    assert split.runs > 2 * full.runs
    assert all(each.seconds <= 4 * 3600 for each in designs.values() if each.repetitions)
    # 14 effects are corrected together; ten whole plots, which vary no more than runs here, tell of floors with eight
    # degrees of freedom, and of what changes within them as well: of how each responds to it.
    powers = dict(split.powers)
    assert powers["effect of Floor on Energy"] == pytest.approx(powers["effect of Map on Energy"], abs=0.04)
    assert split.power > full.power + 0.2
    assert found.recommended == split.name
    assert "No design reaches 80%" in " ".join(found.reasons)
    json.dumps(found.as_mapping())


def test_the_budget_decides_how_often_runs_are_repeated():
    model = RunTableModel(FACTORS[:2], repetitions=3)
    candidate = next(candidates_of(model, []))
    times = RunTimes(lambda combination: 100.0 if combination["Speed"] == "low" else 50.0, 10.0, {})
    # Once: 2 x 100 + 2 x 50 + 3 x 10 = 330 s; each more 340 s.
    assert [most_repetitions(candidate, times, budget) for budget in (329.0, 330.0, 669.0, 670.0)] == [0, 1, 1, 2]
    designs, found = compared(model, times, asked(100.0))
    assert "more than the budget" in designs["full factorial"].problem
    assert not found.recommended
    assert "allow more time" in found.reasons[0]


@pytest.mark.long
def test_an_interaction_is_sought_among_designs_that_tell_it():
    times = RunTimes(lambda _: 60.0, 0.0, {})
    question = Asked(
        "study",
        None,
        {"Energy": "J"},
        Assumptions(spreads=["1"], differences=["Speed x Load=2"]),
        ("Speed x Load",),
        7200.0,
    )
    designs, found = compared(RunTableModel(FACTORS, seed=7), times, question)
    assert "no test is called" in designs["one factor at a time"].problem
    assert designs[found.recommended].powers[0][0] == "interaction of Speed and Load on Energy"


ADDED = "effects in part with interactions of blocks, which are taken to be none"
SQUARED = "what goes beyond squares and interactions of two factors, which is taken to be none"
THREE = {name: Factor(name, [1, 2, 3]) for name in ("Day", "Hour", "Operator", "Planner")}
NUMBERS = [Factor("Speed", Range(0.1, 0.3)), Factor("Load", Range(0.0, 2.0))]


@pytest.mark.long
@pytest.mark.parametrize(
    ("factors", "design", "told"),
    [
        ([THREE["Day"], THREE["Hour"], THREE["Planner"]], LatinSquare("Day", "Hour"), ADDED),
        (list(THREE.values()), GraecoLatinSquare("Day", "Hour", "Operator"), ADDED),
        ([Factor("Robot", list("ABCDEF")), THREE["Hour"], THREE["Planner"]], Crossover("Robot", "Hour"), ADDED),
        (NUMBERS, CentralComposite(), SQUARED),
    ],
    ids=["Latin square", "Graeco-Latin square", "crossover", "central composite"],
)
def test_a_design_that_takes_interactions_to_be_none_says_which(factors, design, told):
    own = next(candidates_of(RunTableModel(factors, design=design), []))
    (found,) = compare_designs([own], RunTimes(lambda _: 60.0, 0.0, {}), asked(36000.0)).designs
    assert found.aliased == told
    assert found.tells == (2 if told == SQUARED else 0)


def test_a_covering_array_that_is_the_full_factorial_is_no_design_of_its_own():
    names = [each.name for each in candidates_of(RunTableModel(FACTORS[:2]), [])]
    assert "full factorial" in names
    assert "covering array of pairs" not in names
    assert "covering array of pairs" in [each.name for each in candidates_of(RunTableModel(FACTORS[:3]), [])]


CONFIG = dedent("""
    from robot_runner import ExperimentConfig, Factor, Measure, RunTableModel


    class RobotRunnerConfig(ExperimentConfig):
        experiment_name = "study"
        robot = "simulated:turtlebot3"

        def create_run_table(self):
            return RunTableModel(
                [Factor("Speed", ["low", "high"]), Factor("Floor", ["wood", "carpet"])],
                data_columns=[Measure("Energy", unit="J", description="of the mission")],
            )
""")


@pytest.mark.long
def test_the_command_prints_and_refuses(tmp_path, robot_runner):
    (tmp_path / "study.py").write_text(CONFIG)
    config = tmp_path / "study.py"
    words = ("--budget", "1h", "--run-time", "95s", "--hard", "Floor=5min")
    found = robot_runner("design", config, *words, "--json").json
    assert found["recommended"] in [each["design"] for each in found["designs"]]
    assert all(each["seconds"] <= 3600 for each in found["designs"] if each["repetitions"])
    for words, problem in (
        (["--budget", "8"], "--budget is '8'"),
        (["--budget", "8h"], "how long a run takes is not known"),
        (["--budget", "8h", "--run-time", "95s", "--hard", "Flor"], "there is no factor 'Flor'"),
        (["--budget", "8h", "--run-time", "95s", "--measure", "Energi"], "there is no measure 'Energi'"),
    ):
        refused = robot_runner("design", config, *words)
        assert refused.code in {1, 2}, refused.err
        assert problem in " ".join(refused.err.split()), refused.err
    shown = robot_runner("design", config, "--budget", "1h", "--run-time", "95s").out
    assert "Recommended: " in shown
    assert "(--sd and --difference, or --pilot)" in shown, "it takes no --means"


def test_a_factor_that_counts_repetitions_is_refused_with_their_number(tmp_path, robot_runner):
    config = tmp_path / "study.py"
    config.write_text(CONFIG.replace('Factor("Floor", ["wood", "carpet"])', 'Factor("Repetition", range(1, 16))'))
    answer = robot_runner("design", config, "--budget", "2h", "--run-time", "60s")
    assert answer.code == 2
    assert "the factor 'Repetition' counts the repetitions" in answer.err
    assert "Give repetitions=15 in its place" in answer.err


@pytest.mark.long
def test_a_design_that_does_not_test_what_is_sought_has_no_power_and_says_so():
    plan = AnalysisPlan(hypotheses=[Hypothesis("Loads slow it down.", measure="Energy", factors=("Speed", "Load"))])
    question = replace(asked(3600.0, spreads=["1"], differences=["Speed x Load=3"]), plan=plan)
    names = {"full factorial", "one factor at a time"}
    candidates = [each for each in candidates_of(RunTableModel(FACTORS[:2], seed=7), []) if each.name in names]
    full, one_at_a_time = compare_designs(candidates, RunTimes(lambda _: 95.0, 5.0, {}), question).designs
    assert full.power is not None
    assert (one_at_a_time.power, one_at_a_time.problem) == (None, "it does not test Loads slow it down.")
