"""A person says yes, from another terminal, and the run goes on."""

from __future__ import annotations

import subprocess
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING

import pytest

from robot_runner import ConditionError, confirmed
from robot_runner.core.events.context import SystemClock
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.lock import send_continue
from robot_runner.testing import make_context

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

CONFIG = """\
from robot_runner import *

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"

    def launch_mission(self, context):
        confirmed("the robot has left the lift").wait(context, timeout_s=50)

    def create_run_table(self):
        return RunTableModel([Factor("Far", ["no"])])
"""


@pytest.mark.long
def test_a_run_goes_on_once_a_person_has_said_so(tmp_path: Path, program: str, robot_runner: Callable) -> None:
    (tmp_path / "config.py").write_text(CONFIG)
    folder = tmp_path / "results" / "trial"
    words = [program, "run", "config.py", "--plain"]
    with subprocess.Popen(words, cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 50
        while "waits for you" not in (status := robot_runner("status", folder).out) and time.monotonic() < deadline:
            time.sleep(0.1)
        assert "the robot has left the lift, in r_1" in status
        answer = robot_runner("continue", folder)
        said, _ = process.communicate(timeout=60)
    assert (answer.code, process.returncode) == (0, 0)
    assert "'the robot has left the lift' is done" in answer.out
    assert "r_1 waits until a person says that the robot has left the lift: robot-runner continue " in said
    assert "waits for you" not in robot_runner("status", folder).out


@pytest.mark.long
def test_runs_that_ask_at_the_same_time_are_answered_one_after_another(
    tmp_path: Path, program: str, robot_runner: Callable
) -> None:
    robots = 'robot = Robots("simulated://alice", "simulated://bob")'
    config = CONFIG.replace("    def launch", f"    {robots}\n\n    def launch", 1)
    (tmp_path / "config.py").write_text(config.replace('["no"]', '["no", "yes"]'))
    folder = tmp_path / "results" / "trial"
    words = [program, "run", "config.py", "--plain"]
    with subprocess.Popen(words, cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL) as process:
        journal, deadline = folder / "journal.jsonl", time.monotonic() + 50
        while time.monotonic() < deadline and not (journal.exists() and journal.read_text().count('"asked"') == 2):
            time.sleep(0.1)
        asked = []
        for _ in range(2):
            (told,) = [line for line in robot_runner("status", folder).out.splitlines() if "To do" in line]
            asked.append(told.partition(", in ")[2])
            assert robot_runner("continue", folder).code == 0
            while time.monotonic() < deadline and journal.read_text().count('"answered"') < len(asked):
                time.sleep(0.1)
        assert process.wait(60) == 0
    assert sorted(asked) == ["r_1 (alice)", "r_2 (bob)"]


def test_what_was_said_before_does_not_count(tmp_path: Path) -> None:
    context = make_context(tmp_path, clock=SystemClock(), robot=None)
    control = ExperimentFolder.found_at(tmp_path).control
    send_continue(control)
    with ExitStack() as opened:
        look = confirmed("it is dark").watch(context, opened)
        assert not look().holds
        send_continue(control)
        assert look().holds
        assert look().holds
        assert not control.exists()
    assert [kind for kind, _ in context.broker.records] == ["asked", "answered"]


def test_nothing_is_no_question() -> None:
    with pytest.raises(ConditionError, match="nothing is to be confirmed"):
        confirmed("  ")
    with pytest.raises(ConditionError, match="nothing is to be confirmed"):
        confirmed(None)
