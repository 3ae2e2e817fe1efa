from __future__ import annotations

import csv
import json
import subprocess
from typing import TYPE_CHECKING

import pytest

from robot_runner.core.execution.systems_state import SystemsFile
from robot_runner.core.storage.layout import ExperimentFolder

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")

MEASURING = """\
def launch_mission(self, context):
    print("hello from", context.run_id)

def populate_run_data(self, context):
    return {"Energy": 877.1234}
"""
FAILING = """\
mends = False

def launch_mission(self, context):
    if context.combination["Task"] == "Video" and not self.mends:
        raise ValueError("the camera is off")

def populate_run_data(self, context):
    return {"Energy": 1.5}
"""


def statuses(folder: Path) -> list[str]:
    with (folder / "results" / "trial" / "run_table.csv").open(encoding="utf-8", newline="") as file:
        return [row["status"] for row in csv.DictReader(file)]


def test_a_line_tells_of_each_start_and_each_end(robot_runner: Callable, write_config: Callable[..., Path]) -> None:
    write_config(MEASURING)
    answer = robot_runner("run", "config.py")
    assert answer.code == 0
    assert answer.err == ""
    assert "\x1b" not in answer.out
    lines = answer.out.splitlines()
    assert lines[0] == "trial: 4 runs, seed 1, results in results/trial"
    assert lines[1] == "run 1 of 4 (r_1) starts: Task=Video, Repetition=1"
    assert lines[2].startswith("run 1 of 4 (r_1) is done after ")
    assert lines[2].endswith(": Energy 877.1")
    assert sum(line.startswith("run ") for line in lines) == 8


@pytest.mark.long
def test_the_end_tells_how_it_went_and_where_the_results_are(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config(MEASURING)
    answer = robot_runner("run", "config.py")
    assert "All 4 runs are done (" in answer.out
    assert "Results  results/trial/run_table.csv" in answer.out
    assert "Next     for figures, tests and threats to validity: robot-runner report " in answer.out
    assert "hello from" not in answer.out
    assert (tmp_path / "results/trial/runs/r_1/log.txt").read_text() == "hello from r_1\n"
    assert statuses(tmp_path) == ["Done"] * 4


@pytest.mark.long
def test_an_experiment_whose_name_has_the_time_in_it_goes_on_by_the_command_that_is_told(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    path = write_config(FAILING)
    path.write_text(path.read_text().replace('"trial"', "f\"trial_{__import__('time').time_ns()}\""))
    first = robot_runner("run", "config.py")
    (name,) = (each.name for each in (tmp_path / "results").iterdir())
    assert f"robot-runner config.py --set experiment_name={name}" in first.out
    again = robot_runner("run", "config.py", "--set", f"experiment_name={name}")
    assert f"{name}: 4 runs, 2 of them done before" in again.out
    assert [each.name for each in (tmp_path / "results").iterdir()] == [name]


@pytest.mark.long
def test_a_failed_run_is_exit_code_1_with_its_reason_and_what_to_do(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config(FAILING)
    answer = robot_runner("run", "config.py", "--set", "attempts=2")
    assert answer.code == 1
    reason = "launch_mission of config: ValueError: the camera is off"
    assert f": {reason}; it is tried again\n" in answer.out
    assert "run 1 of 4 (r_1, attempt 2) failed after " in answer.out
    assert "2 of 4 runs done, 2 failed, 0 to do" in answer.out
    assert f"✗ r_1, r_3: {reason}\n" in answer.out
    assert "look at results/trial/runs/r_1/log.txt, then execute what is left (2 failed, 0 to do): " in answer.out
    assert "robot-runner config.py --set attempts=2\n" in answer.out
    assert "ValueError: the camera is off" in (tmp_path / "results/trial/runs/r_1/log.txt").read_text()
    assert statuses(tmp_path) == ["Failed", "Done"] * 2


@pytest.mark.long
def test_executing_it_again_resumes(robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path) -> None:
    write_config(FAILING)
    robot_runner("run", "config.py")
    changed = ["--set", "mends=yes"]
    refused = robot_runner("run", "config.py", *changed)
    assert refused.code == 2
    assert "error: --set mends: the parameter was not set and is set by --set mends=yes\n" in refused.err
    answer = robot_runner("run", "config.py", *changed, "--accept-changes")
    assert answer.code == 0
    assert answer.out.startswith("trial: 4 runs, 2 of them done before, seed 1, results in results/trial\n")
    assert "set by hand, and recorded as a deviation from the config: mends=yes\n" in answer.out
    assert "r_2" not in answer.out
    assert statuses(tmp_path) == ["Done"] * 4
    nothing = robot_runner("run", "config.py", *changed)
    assert nothing.code == 0
    assert "All 4 runs are done before: nothing was executed." in nothing.out
    assert "robot-runner config.py --set mends=yes --set experiment_name=..." in nothing.out


def test_only_some_runs_can_be_executed(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config(MEASURING)
    answer = robot_runner("run", "config.py", "--only", "r_2", "--only", "r_4")
    assert answer.code == 0
    assert "2 of 4 runs done, 0 failed, 2 to do" in answer.out
    assert "go on with the 2 runs that are left: robot-runner config.py\n" in answer.out
    assert statuses(tmp_path) == ["-", "Done", "-", "Done"]


@pytest.mark.long
def test_a_run_can_be_executed_again(robot_runner: Callable, write_config: Callable[..., Path]) -> None:
    write_config(MEASURING)
    robot_runner("run", "config.py")
    answer = robot_runner("run", "config.py", "--redo", "r_3")
    assert answer.code == 0
    assert [line.partition(")")[0] for line in answer.out.splitlines() if line.startswith("run ")] == [
        "run 3 of 4 (r_3, attempt 2",
        "run 3 of 4 (r_3, attempt 2",
    ]
    unknown = robot_runner("run", "config.py", "--redo", "r_33")
    assert unknown.code == 2
    assert "error: --redo r_33: the run table has no such run" in unknown.err


def test_a_policy_that_stops_leaves_runs_to_do(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config(FAILING)
    answer = robot_runner("run", "config.py", "--set", "on_failure=stop")
    assert answer.code == 1
    assert "Stopped by on_failure: 0 of 4 runs done, 1 failed, 3 to do" in answer.out
    assert statuses(tmp_path) == ["Failed", "-", "-", "-"]


@pytest.mark.long
def test_what_looked_odd_in_many_runs_is_said_once(robot_runner: Callable, write_config: Callable[..., Path]) -> None:
    write_config(
        """\
        def before_run(self, context):
            self.task = context.combination["Task"]

        def stop_run(self, context):
            context.warn(f"{context.run_number} of 190 samples lost", fix="Look at the cable.")

        def populate_run_data(self, context):
            return {"Energy": None}
        """
    )
    answer = robot_runner("run", "config.py")
    assert answer.code == 0
    odd = [line for line in answer.out.splitlines() if line.startswith("  ! ")]
    assert odd == [
        "  ! config: 1 of 190 samples lost, and the like (in r_1, r_2, r_3, r_4)",
        "  ! config: Energy has no value (in r_1, r_2, r_3, r_4)",
    ]
    assert answer.out.count("Look at the cable.") == 1


def test_callbacks_of_the_orchestrator_are_seen(robot_runner: Callable, write_config: Callable[..., Path]) -> None:
    write_config(
        "def before_run(self, context): print('put the robot in place for', context.run_id)" + "\n" + MEASURING
    )
    assert "put the robot in place for r_4\n" in robot_runner("run", "config.py").out


@pytest.mark.long
def test_a_table_that_differs_from_the_plan_refuses(robot_runner: Callable, write_config: Callable[..., Path]) -> None:
    config = write_config(MEASURING)
    robot_runner("run", "config.py")
    config.write_text(config.read_text().replace('"Network"', '"Radio"'))
    answer = robot_runner("run", "config.py")
    assert answer.code == 2
    assert "Network" in answer.err
    assert "Traceback" not in answer.err


#: A link that `before_experiment` opens for `after_experiment`, and that cannot be closed.
LEFT_OPEN = """
def before_experiment(self, context):
    from robot_runner.core.errors import LinkError
    from robot_runner.core.events.resources import opened_here
    class Line:
        def close(self): raise {error}
    self.left_open = opened_here()
    self.left_open.__enter__().open("line", Line)
"""
RAISING = "def after_experiment(self, context): raise OSError('the lab is closed')"
UNPLUGGED, MOVING = (
    "OSError(5, 'Input/output error')",
    "LinkError('THE ROBOT MAY BE MOVING', where='robot', fix='Stop it.')",
)
NOT_CLOSED = "what a callback of the experiment left open cannot be closed: "


@pytest.mark.parametrize(
    ("callbacks", "problems"),
    [
        (RAISING, ["after_experiment of config: OSError"]),
        (LEFT_OPEN.format(error=UNPLUGGED), [f"{NOT_CLOSED}OSError: [Errno 5] Input/output error"]),
        (LEFT_OPEN.format(error="RuntimeError('no context')"), [f"{NOT_CLOSED}RuntimeError: no context"]),
        (LEFT_OPEN.format(error=MOVING), ["robot: THE ROBOT MAY BE MOVING"]),
        (LEFT_OPEN.format(error=MOVING) + RAISING, ["after_experiment of config: OSError", "THE ROBOT MAY BE MOVING"]),
    ],
    ids=["its last callback", "a cable", "a library", "a robot", "two of them"],
)
def test_an_experiment_that_cannot_end_is_no_refusal_and_tells_what_is_done(
    robot_runner: Callable, write_config: Callable[..., Path], callbacks: str, problems: list[str]
) -> None:
    write_config(f"{callbacks}\n{MEASURING}")
    answer = robot_runner("run", "config.py")
    assert answer.code == 1
    assert all(problem in answer.err for problem in problems)
    assert "All 4 runs are done" in answer.out
    answer = robot_runner("run", "config.py", "--json", "--set", "experiment_name=again")
    told = json.loads(answer.out)
    assert (told["exit_code"], told["runs"]["done"]) == (1, 4)
    found = " ".join(f"{each['where']}: {each['problem']}" for each in told["findings"])
    assert all(problem in found for problem in problems)


def test_of_results_that_were_removed_meanwhile_nothing_is_told(
    robot_runner: Callable, write_config: Callable[..., Path]
) -> None:
    removing = "def before_run(self, context): import shutil; context.run_id == 'r_2' and shutil.rmtree('results')"
    write_config(f"{removing}\n{MEASURING}")
    answer = robot_runner("run", "config.py")
    assert answer.code == 1
    assert "No such file or directory" in answer.err
    assert "runs done" not in answer.out


def test_before_experiment_that_raises_is_a_refusal(robot_runner: Callable, write_config: Callable[..., Path]) -> None:
    write_config("def before_experiment(self, context): raise OSError('the lab is closed')")
    answer = robot_runner("run", "config.py")
    assert answer.code == 2
    assert "error: before_experiment of config: OSError: the lab is closed" in answer.err


@pytest.mark.long
def test_a_reader_that_goes_away_ends_nothing(program: str, write_config: Callable[..., Path], tmp_path: Path) -> None:
    write_config(MEASURING)
    with subprocess.Popen(
        [program, "run", "config.py"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as running:
        assert running.stdout is not None
        running.stdout.close()
        assert running.wait(timeout=60) == 0
    assert statuses(tmp_path) == ["Done"] * 4


@pytest.mark.long
def test_runs_to_redo_can_be_listed_with_commas(robot_runner: Callable, write_config: Callable[..., Path]) -> None:
    write_config("def populate_run_data(self, context): return {'Energy': context.attempt}")
    assert robot_runner("run", "config.py").code == 0
    assert robot_runner("run", "config.py", "--redo", "r_1, r_3", "--redo", "r_4").code == 0
    with open("results/trial/run_table.csv", encoding="utf-8", newline="") as file:  # noqa: PTH123 - as a reader would
        assert [row["Energy"] for row in csv.DictReader(file)] == ["2", "1", "2", "2"]


@pytest.mark.long
def test_json_tells_how_it_went_and_nothing_else_goes_to_stdout(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path
) -> None:
    write_config(f"{FAILING}\ndef before_experiment(self, context):\n    print('hello')\n")
    answer = robot_runner("run", "config.py", "--json")
    facts = answer.json
    assert answer.code == facts["exit_code"] == 1
    assert facts["runs"] == {"done": 2, "failed": 2, "to_do": 0}
    assert facts["run_table"] == str(tmp_path / "results" / "trial" / "run_table.csv")
    assert len(facts["failed"]) == len(facts["failures"]) == 2
    assert "hello" in answer.err
    assert "2 failed" in answer.err
    mended = robot_runner("run", "config.py", "--json", "--set", "mends=true", "--accept-changes")
    assert (mended.code, mended.json["runs"]["done"], mended.json["stopped_by"]) == (0, 4, None)


def test_json_of_what_is_refused_has_the_findings(robot_runner: Callable, write_config: Callable[..., Path]) -> None:
    write_config("attempts = 0")
    answer = robot_runner("run", "config.py", "--json")
    assert answer.code == answer.json["exit_code"] == 2
    assert answer.json["was_executed"] is False
    assert answer.json["findings"][0]["where"].endswith("attempts")
    unknown = robot_runner("run", "config.py", "--json", "--set", "atempts=3")
    assert (unknown.code, unknown.json["findings"][0]["fix"]) == (2, "Did you mean 'attempts'?")


@pytest.mark.parametrize("words", [("--workers", "many"), ("--cluster", "here")])
@pytest.mark.parametrize("command", [("run",), ("queue", "add")])
def test_what_an_option_stands_for_is_refused_under_its_name(
    robot_runner: Callable, write_config: Callable[..., Path], command: tuple[str, ...], words: tuple[str, str]
) -> None:
    write_config(MEASURING)
    answer = robot_runner(*command, "config.py", *words)
    assert answer.code == 2
    assert f"error: {' '.join(words)}: the value is {words[1]!r}" in answer.err


def test_a_value_of_the_config_is_refused_under_the_name_it_has_there(
    robot_runner: Callable, write_config: Callable[..., Path]
) -> None:
    write_config(f"workers = 0\n{MEASURING}")
    assert "RobotRunnerConfig.workers: the value is 0" in robot_runner("run", "config.py").err


def test_a_refusal_tells_of_a_robot_that_a_killed_execution_may_have_left_moving(
    robot_runner: Callable, write_config: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    file = SystemsFile(ExperimentFolder(tmp_path / "hall"))
    (tmp_path / "hall").mkdir()
    write_config("attempts = 0")
    told = []
    for step in (lambda: None, lambda: file.begin("dds://alice", {"run_id": "r_7"}), file.remove):
        step()
        answer = robot_runner("run", "config.py")
        assert answer.code == 2
        told.append("THE ROBOT MAY BE MOVING: an earlier execution was killed in r_7 (dds://alice)" in answer.err)
    assert told == [False, True, False]
