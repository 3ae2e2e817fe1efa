"""An experiment that pauses between two runs: asked for from another terminal, without ending anything."""

from __future__ import annotations

import json
import re
import signal
from typing import TYPE_CHECKING

import pytest
from tests.long_cases import soak_but

from robot_runner.core.storage.journal import read_journal

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")

UNTIL_TOLD = """
def launch_mission(self, context):
    while context.run_number == 1 and not Path("go").exists():
        context.clock.sleep(0.05)
"""
TABLE = """\
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video", "Network"])], data_columns=[])
"""


def kinds(folder: Path) -> list[str]:
    wanted = {"paused", "continued", "attempt_started", "experiment_finished"}
    return [record["kind"] for record in read_journal(folder / "results" / "trial" / "journal.jsonl", kinds=wanted)]


@pytest.mark.long
def test_it_pauses_after_the_present_run_and_goes_on(
    terminal: Callable, write_config: Callable[..., Path], tmp_path: Path, robot_runner: Callable
) -> None:
    write_config(UNTIL_TOLD, table=TABLE)
    shown = terminal("run", "config.py")
    shown.wait_for("launch_mission")
    assert robot_runner("pause", "config.py").out.startswith("trial pauses after r_1. To go on")
    shown.wait_for("pauses after this run")
    assert "and pauses before the next run" in " ".join(robot_runner("status", "config.py").out.split())
    assert robot_runner("continue", "config.py").out == "trial does not pause.\n"
    assert robot_runner("pause", "results/trial").code == 0
    (tmp_path / "go").touch()
    shown.wait_for("Paused before run 2 of 2. To go on: press ENTER")
    facts = json.loads(robot_runner("status", "config.py", "--json").out)
    assert (facts["is_paused"], facts["done"], facts["holder"]["pid"]) == (True, 1, shown.child.pid)
    assert "is paused (process" in robot_runner("status", "config.py").out
    assert "is paused already" in robot_runner("pause", "config.py").out
    assert robot_runner("continue", "config.py").out == "trial goes on.\n"
    assert shown.finish() == 0
    assert kinds(tmp_path) == ["attempt_started", "paused", "continued", "attempt_started", "experiment_finished"]
    assert not (tmp_path / "results" / "trial" / ".pause").exists()
    refused = robot_runner("pause", "config.py")
    assert (refused.code, "the experiment is not being executed" in refused.err) == (2, True)
    assert "There is nothing to pause; all its runs are done." in refused.err


@pytest.mark.long
@pytest.mark.parametrize("ending", soak_but([signal.SIGKILL], [signal.SIGINT, signal.SIGKILL]))
def test_a_pause_ends_with_its_session(
    terminal: Callable,
    write_config: Callable[..., Path],
    tmp_path: Path,
    robot_runner: Callable,
    ending: signal.Signals,
) -> None:
    write_config(UNTIL_TOLD, table=TABLE)
    shown = terminal("run", "config.py", "--plain")
    shown.wait_for("starts")
    assert robot_runner("pause", "config.py").code == 0
    (tmp_path / "go").touch()
    shown.wait_for("Paused before run 2 of 2")
    shown.child.kill(ending)
    if ending is signal.SIGINT:
        assert shown.finish() == 130
        assert "Interrupted: 1 of 2 runs done, 0 failed, 1 to do" in shown.text
    else:
        shown.child.wait()
    facts = json.loads(robot_runner("status", "config.py", "--json").out)
    assert (facts["holder"], facts["is_paused"], facts["pause_is_requested"]) == (None, False, False)
    resumed = robot_runner("run", "config.py")
    assert resumed.code == 0
    assert "Paused" not in resumed.out
    told = robot_runner("status", "config.py").out
    broken = ", 1 of them broken off" if ending is signal.SIGKILL else ""
    assert re.search(rf"Sessions +2{broken}; .* in all", told)
    assert re.search(r"Started +20.*Z\n +Resumed +20.*Z", told)


@pytest.mark.long
def test_an_answer_to_a_step_is_taken_though_a_pause_was_asked_for_which_begins_then(
    terminal: Callable, write_config: Callable[..., Path], tmp_path: Path, robot_runner: Callable
) -> None:
    step = 'OperatorStep("swap the battery", first=True, ask=[Question("voltage", float)])'
    write_config(f"operator_steps = [{step}]", table=TABLE)
    shown = terminal("run", "config.py")
    shown.wait_for("swap the battery")
    assert robot_runner("pause", "config.py").code == 0
    told = " ".join(robot_runner("status", "config.py").out.split())
    assert "continue results/trial --answer voltage=...; pauses then, which robot-runner continue" in told
    assert robot_runner("continue", "config.py", "--answer", "voltage=11.8").out == (
        "trial goes on: 'swap the battery' is done.\n"
    )
    shown.wait_for("Paused before run 1 of 2")
    refused = robot_runner("continue", "config.py", "--answer", "voltage=11.9")
    assert (refused.code, "the experiment does not wait" in refused.err) == (2, True)
    assert robot_runner("continue", "config.py").out == "trial goes on.\n"
    assert shown.finish() == 0
    (answered,) = read_journal(tmp_path / "results" / "trial" / "journal.jsonl", kinds={"operator_step"})
    assert answered["answers"] == {"voltage": 11.8}


@pytest.mark.long
def test_enter_ends_a_pause_in_its_own_terminal(
    terminal: Callable, write_config: Callable[..., Path], tmp_path: Path, robot_runner: Callable
) -> None:
    write_config(UNTIL_TOLD, table=TABLE)
    shown = terminal("run", "config.py")
    shown.wait_for("launch_mission")
    assert robot_runner("pause", "config.py").code == 0
    (tmp_path / "go").touch()
    shown.wait_for("Paused before run 2 of 2")
    shown.child.sendline("")
    assert shown.finish() == 0


@pytest.mark.long
def test_the_command_that_goes_on_can_be_pasted(
    terminal: Callable, write_config: Callable[..., Path], tmp_path: Path, robot_runner: Callable
) -> None:
    write_config(f"experiment_name = 'my study'\n{UNTIL_TOLD}", table=TABLE)
    shown = terminal("run", "config.py", "--plain")
    shown.wait_for("starts")
    assert "robot-runner continue 'results/my study'\n" in robot_runner("pause", "config.py").out
    assert robot_runner("continue", "config.py").code == 0
    (tmp_path / "go").touch()
    assert shown.finish() == 0
