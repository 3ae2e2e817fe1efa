"""`robot-runner power` prints a table, a curve and an answer, and refuses assumptions that do not suffice."""

from __future__ import annotations

import json
from argparse import Namespace
from typing import TYPE_CHECKING

import pytest
from scipy import stats

from robot_runner.analysis.commands.power import planned_experiment

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.command_line import Answer

CONFIG = """
from robot_runner import AnalysisPlan, ExperimentConfig, Factor, Hypothesis, RunTableModel


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "two_tasks"
    analysis = AnalysisPlan(hypotheses=[Hypothesis("Video costs more.", measure="Energy", factors="Task")])

    def create_run_table(self):
        factors = [Factor("Task", ["Idle", "Video"]), Factor("Speed", [0.1, 0.2])]
        return RunTableModel(factors, repetitions=3, data_columns=["Energy"])

    def populate_run_data(self, context):
        return {"Energy": 100 + 8 * (context.combination["Task"] == "Video") + 7 * (context.run_number % 4)}
"""

ASSUMED = ("--sd", "12", "--difference", "Task=15", "--simulations", "100", "--repetitions", "3..20")


@pytest.fixture
def study(tmp_path: Path) -> Path:
    config = tmp_path / "study.py"
    config.write_text(CONFIG, encoding="utf-8")
    return config


@pytest.mark.long
def test_it_answers_with_a_table_a_curve_a_figure_and_json(
    robot_runner: Callable[..., Answer], study: Path, tmp_path: Path
) -> None:
    answer = robot_runner("power", study, *ASSUMED, "--output", "power")
    assert answer.code == 0, answer.err
    told = json.loads((tmp_path / "power" / "power.json").read_text(encoding="utf-8"))
    (scenario,) = told["scenarios"]
    needed = scenario["needed"]["repetitions"]
    assert f"{needed} repetitions ({4 * needed} runs) find what is sought" in answer.out
    assert "█" in answer.out
    means = "-7.500 for Idle / 0.1, -7.500 for Idle / 0.2, 7.500 for Video / 0.1, 7.500 for Video / 0.2"
    assert f"Assumed means of Energy: {means}; standard deviation 12.00" in " ".join(answer.out.split()).replace(
        "\N{MINUS SIGN}", "-"
    )
    assert "* Video costs more." in answer.out
    assert {path.name for path in (tmp_path / "power").iterdir()} == {"power.json", "power.svg", "power.png"}
    point = next(each for each in scenario["points"] if each["repetitions"] == needed)
    assert point["least"]["low"] < point["least"]["power"] < point["least"]["high"]
    assert point["least"]["power"] >= told["power"] == 0.8
    assert point["simulations"] <= 100
    # The same seed gives the same figures, and another one others.
    again = robot_runner("power", study, *ASSUMED, "--json").json
    assert again == told
    assert robot_runner("power", study, *ASSUMED, "--json", "--seed", "2").json["scenarios"] != told["scenarios"]


@pytest.mark.long
def test_means_come_from_a_file_and_from_a_pilot(
    robot_runner: Callable[..., Answer], study: Path, tmp_path: Path
) -> None:
    (tmp_path / "means.csv").write_text("Task,Energy,Energy.sd\nIdle,100,10\nVideo,115,14\n", encoding="utf-8")
    words = ("--simulations", "100", "--repetitions", "3..30", "--json")
    (of_file,) = robot_runner("power", study, "--means", "means.csv", *words).json["scenarios"]
    combinations = {tuple(each["treatments"]): each for each in of_file["assumed"][0]["combinations"]}
    assert combinations["Video", "0.2"] == {"treatments": ["Video", "0.2"], "mean": 115.0, "sd": 14.0}
    assert robot_runner("run", study, "--plain").code == 0
    of_pilot = ("--pilot", "experiments/two_tasks", "--difference", "Task=6")
    assert "the same Energy" in robot_runner("power", study, *of_pilot, *words).err  # its runs do not vary
    pilot = robot_runner("power", study, *of_pilot, "--sd", "5", *words).json
    assert [each["title"] for each in pilot["scenarios"]] == ["the pilot's effects", "the smallest effects of interest"]
    assert any("uncertain" in note for note in pilot["notes"])


@pytest.mark.parametrize(
    ("words", "problem", "fix"),
    [
        ([], "nothing is assumed", "--pilot"),
        (["--sd", "12"], "no difference is assumed", "--difference"),
        (["--sd", "12"], "no difference is assumed", "or 0 where they are to be shown alike"),
        (["--difference", "Task=5"], "nothing is assumed of Energy", "--sd Energy="),
        (["--sd", "12", "--difference", "Tusk=5"], "no factor 'Tusk'", "'Task'"),
        (["--sd", "12", "--difference", "Speed=5"], "no difference of Task", "--difference Energy:Task="),
        (["--sd", "12", "--difference", "Enrgy:Task=5"], "no measure 'Enrgy'", "'Energy'"),
        (["--sd", "12", "--difference", "Task=five"], "no number", "a number"),
        (["--sd", "-1", "--difference", "Task=5"], "below 0", "standard deviation"),
        (["--sd", "12", "--difference", "Task=5", "--effect", "Tosk"], "no test is called 'Tosk'", "Task"),
        (["--sd", "12", "--difference", "Task=5", "--repetitions", "9..3"], "9..3", "end no lower"),
        (["--sd", "12", "--difference", "Task=5", "--repetitions", "many"], "many", "5..40"),
        (["--sd", "12", "--difference", "Task=5", "--power", "80"], "80", "between 0 and 1"),
        (["--sd", "12", "--difference", "Task=5", "--first-batch", "5"], "--first-batch is 5", "above it"),
        (["--means", "nowhere.csv"], "cannot be read", "CSV"),
        (["--pilot", "nowhere"], "no such file or folder", "study.py"),
        (["--powr", "0.8"], "--powr", "--power"),
    ],
)
def test_what_cannot_be_is_refused_with_a_way_out(
    robot_runner: Callable[..., Answer], study: Path, words: list[str], problem: str, fix: str
) -> None:
    answer = robot_runner("power", study, *words)
    assert answer.code == 2
    assert problem in answer.err
    assert fix in answer.err
    assert "Traceback" not in answer.err


#: Twelve people, each with every treatment.
PEOPLE = """
from robot_runner import ExperimentConfig, Factor, RunTableModel
from robot_runner.designs import Crossover


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "gaze"

    def create_run_table(self):
        factors = [Factor("Person", range(1, 13)), Factor("Place", [1, 2, 3]), Factor("Gaze", ["no", "shy", "yes"])]
        design = Crossover(unit="Person", period="Place", washout_in_s=1)
        return RunTableModel(factors, data_columns=["Trust"], shuffle=True, design=design)
"""

#: Seven treatments on seven days, which one repetition does not connect.
DAYS = """
from robot_runner import ExperimentConfig, Factor, RunTableModel
from robot_runner.designs import Blocks


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "days"

    def create_run_table(self):
        factors = [Factor("Day", range(7)), Factor("Map", list("abcdefg"))]
        return RunTableModel(factors, repetitions=3, data_columns=["Error"], shuffle=True, design=Blocks("Day"))
"""


@pytest.mark.long
def test_a_design_of_its_own_is_looked_at_from_a_single_repetition_on(
    robot_runner: Callable[..., Answer], study: Path
) -> None:
    study.write_text(PEOPLE, encoding="utf-8")
    words = ("power", study, "--sd", "0.8", "--difference", "Gaze=0.8", "--simulations", "2000")
    (scenario,) = robot_runner(*words, "--json").json["scenarios"]
    first = scenario["points"][0]
    assert (first["repetitions"], first["runs"]) == (1, 36)
    # Within people and places 20 degrees of freedom are left: 12 of each treatment, whose means are -0.4, 0 and 0.4.
    exact = stats.ncf.sf(stats.f.ppf(0.95, 2, 20), 2, 20, 12 * (0.4**2 + 0.4**2) / 0.8**2)
    assert first["least"]["low"] < exact < first["least"]["high"]
    assert "1 repetition (36 runs) finds what is sought in" in robot_runner(*words, "--repetitions", "1").out


@pytest.mark.long
def test_repetitions_that_make_no_design_are_passed_over(robot_runner: Callable[..., Answer], study: Path) -> None:
    study.write_text(DAYS, encoding="utf-8")
    words = ("--sd", "1", "--difference", "Map=4", "--simulations", "100", "--json")
    told = robot_runner("power", study, *words).json
    assert told["scenarios"][0]["points"][0]["repetitions"] == 2
    why = "With 1 repetition: some combinations are never compared within one Day, not even by way of others."
    assert why in told["notes"]


def test_an_order_that_is_not_given_is_drawn_from_the_seed_of_the_simulation(study: Path) -> None:
    def order(text: str, seed: int) -> object:
        study.write_text(CONFIG.replace('data_columns=["Energy"]', f'data_columns=["Energy"], shuffle=True{text}'))
        model = planned_experiment(Namespace(config=str(study), set=[], seed=seed))[1]
        return [run.run_id for run in model.plan()], [run.combination for run in model.plan()]

    assert order("", 1) == order("", 1) != order("", 2)
    assert order(", seed=5", 1) == order(", seed=5", 2)
