from __future__ import annotations

import tempfile
from typing import TYPE_CHECKING

import pytest
from tests.legacy.earlier_configs import RUNNER, RUNNER_TABLE

from robot_runner.cli.smoke_test import covering_runs
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")

HEAD = """\
import time
from pathlib import Path
from robot_runner import *
from robot_runner.plugins import *

HERE = Path(__file__).parent


class Lap(System):
    measures = [Measure("Way", "m", "Way.", low=0.5)]
    smoke_parameters = {"seconds": 0.05}

    def __init__(self, seconds=60.0, room="lab", name=None):
        super().__init__(name=name)
        self.seconds, self.room = seconds, room

    def duration_s(self, combination):
        return self.seconds

    def launch_mission(self, context):
        time.sleep(self.seconds)

    def populate_run_data(self, context):
        context.publish("Way", 0.1 if context.combination["Speed"] == 3 else 1.0)


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = Path("results")
    watch_machines = False
    probe = False
"""
TABLE = """\
    def create_run_table(self):
        factors = [Factor("Room", ["lab", "hall"]), Factor("Speed", [1, 2, 3])]
        columns = ["Way", "Mood"]
        return RunTableModel(factors, repetitions=4, shuffle=True, blocks="Room", warm_up=2, data_columns=columns)
"""
STUDY = """
plugins = [Lap(room=treatment("Room"))]
time_between_runs_in_ms = 60000
operation_type = OperationType.SEMI
settle_s = 60.0
smoke = {"settle_s": 0.0}

def before_run(self, context): time.sleep(self.settle_s)
def populate_run_data(self, context): return {"Mood": 1.0 if context.combination["Room"] == "lab" else None}
"""


@pytest.fixture
def scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Have scratch folders made in a folder of the test's own."""
    folder = tmp_path / "scratch"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def test_few_runs_cover_all_treatments() -> None:
    model = RunTableModel(
        [Factor("A", range(5)), Factor("B", ["x", "y", "z"]), Factor("C", [True, False])], repetitions=3
    )
    plan = list(model.plan())
    chosen = covering_runs(plan)
    assert len(chosen) == 5, "as many as the longest factor has treatments"
    for name in "ABC":
        assert {run.combination[name] for run in chosen} == {run.combination[name] for run in plan}
    assert [run.number for run in chosen] == sorted(run.number for run in chosen)
    only = [run for run in plan if (run.combination["A"], run.combination["B"]) in {(0, "x"), (1, "x"), (1, "y")}]
    assert {run.combination["A"] for run in covering_runs(only)} == {0, 1}
    assert covering_runs([]) == []


def test_each_treatment_is_executed_once_and_what_it_proves_is_told(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path, scratch: Path
) -> None:
    write_config(STUDY, head=HEAD, table=TABLE)
    answer = robot_runner("smoke", "config.py")
    assert answer.code == 0
    assert "3 of 3 runs done, which have each treatment." in answer.out
    assert "w_1" not in answer.out
    assert "Executed  Room: " in answer.out
    assert "Executed  Speed: " in answer.out
    assert "Doubtful  Way: " in answer.out
    assert "No value  Mood, in " in answer.out
    assert "Not proved  3 combinations of treatments that no run had together" in answer.out
    assert "the rests between two runs" in answer.out
    assert "the operator's share between two runs" in answer.out
    assert "whole missions: Lap did less (Lap.seconds = 0.05)" in answer.out
    assert "Shortened   Lap.seconds = 0.05; settle_s = 0.0" in answer.out
    assert "longer runs without settle_s = 0.0" in answer.out
    assert "26 runs of 1 min 0" in answer.out, "the whole missions, and the other events of a run"
    assert "25 pauses of 1 min 00 s" in answer.out
    assert not (tmp_path / "results").exists(), "the study's own folder is not touched"
    assert list(scratch.iterdir()) == [], "and nothing is left of the scratch folder"


@pytest.mark.long
def test_the_folder_of_a_study_that_has_begun_stays_as_it_is(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path, scratch: Path
) -> None:
    write_config(STUDY, head=HEAD.replace("seconds=60.0", "seconds=0.01"), table=TABLE)
    settings = ["--set", "settle_s=0", "--set", "operation_type=auto", "--set", "time_between_runs_in_ms=0"]
    assert robot_runner("run", "config.py", *settings, "--only", "r_1").code == 0
    before = {path: path.read_bytes() for path in (tmp_path / "results").rglob("*") if path.is_file()}
    assert robot_runner("smoke", "config.py", *settings).code == 0
    assert {path: path.read_bytes() for path in (tmp_path / "results").rglob("*") if path.is_file()} == before


@pytest.mark.long
def test_a_config_of_an_earlier_tool_is_tried_beside_its_folder_too(
    robot_runner: Callable, tmp_path: Path, scratch: Path
) -> None:
    (tmp_path / "config.py").write_text(RUNNER + RUNNER_TABLE)
    assert robot_runner("run", "config.py", "--only", "run_1_repetition_0").code == 0
    own = tmp_path / "experiments"
    before = {path: path.read_bytes() for path in own.rglob("*") if path.is_file()}
    answer = robot_runner("smoke", "config.py", "--keep")
    assert "2 of 2 runs done, which have each treatment." in answer.out
    assert [path.name for path in scratch.glob("*/sorting/run_table.csv")] == ["run_table.csv"]
    assert {path: path.read_bytes() for path in own.rglob("*") if path.is_file()} == before


@pytest.mark.long
def test_a_failed_smoke_test_is_kept_and_named(
    robot_runner: Callable, write_config: Callable[..., Path], scratch: Path
) -> None:
    failing = """
def launch_mission(self, context):
    if context.combination["Speed"] == 2: raise ValueError("stuck")
"""
    write_config(failing, head=HEAD, table=TABLE)
    answer = robot_runner("smoke", "config.py")
    assert answer.code == 1
    assert "2 of 3 runs done" in answer.out
    assert "Not executed  Speed: 2" in answer.out
    assert "launch_mission of config: ValueError: stuck" in answer.out
    (kept,) = scratch.iterdir()
    assert f"Kept  scratch/{kept.name}" in answer.out
    assert (kept / "trial" / "journal.jsonl").exists()


@pytest.mark.parametrize(
    ("smoke", "problem", "fix"),
    [
        ('{"Lap.secnds": 1.0}', "the plugin has no parameter 'secnds'", "Did you mean 'seconds'?"),
        ('{"Lapp.seconds": 1.0}', "the config has no plugin of this name", "Did you mean 'Lap'?"),
        ('{"attemps": 1}', "the config has nothing of this name", "Did you mean 'attempts'?"),
        ('{"Lap.room": "lab"}', "room is bound to the factor 'Room'", "Leave it as it is"),
        ('{"attempts": 0}', "the value is 0", "It must be a whole number"),
        ("5", "the value is 5", "It must be names with values"),
    ],
)
def test_what_cannot_be_set_is_refused(
    robot_runner: Callable, write_config: Callable[..., Path], scratch: Path, smoke: str, problem: str, fix: str
) -> None:
    write_config(f"plugins = [Lap(room=treatment('Room'))]\nsmoke = {smoke}", head=HEAD, table=TABLE)
    answer = robot_runner("smoke", "config.py")
    assert answer.code == 2
    assert problem in answer.err
    assert fix in answer.err
    assert list(scratch.iterdir()) == []
