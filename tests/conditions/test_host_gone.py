"""A gate waits for a computer, and a guard notices that it is gone, over a real sshd."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING

import pytest
from tests.core.execution.conftest import execute_in
from tests.core.links.ssh_server import SshServer

if TYPE_CHECKING:
    from pathlib import Path

BODY = """
_there = [host_answers(**ROBOT), process_running("sshd", **ROBOT), clock_offset_below(5, **ROBOT)]
gates = [Gate(all_of(*_there), timeout_s=60)]
guards = [Guard(not_(host_answers(**ROBOT)).held_for(1.0), GuardAction.STOP)]
def launch_mission(self, context):
    context.combination["Task"]
    (HERE / "launched").touch()
    context.clock.sleep(60)
"""
HEAD = """\
from pathlib import Path
from robot_runner import *

HERE = Path(__file__).parent
ROBOT = dict(host="robot", ssh_config={config!r})

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = Path("results")
"""
TABLE = """\
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video", "Network"])])
"""


@pytest.mark.long
def test_a_robot_that_is_gone_ends_the_run_and_the_experiment(tmp_path: Path) -> None:
    (tmp_path / "sshd").mkdir()
    server = SshServer(tmp_path / "sshd")

    def pull_the_plug() -> None:
        deadline = time.monotonic() + 60
        while not (tmp_path / "launched").exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        server.stop()

    plug = threading.Thread(target=pull_the_plug)
    plug.start()
    try:
        executed = execute_in(tmp_path, BODY, head=HEAD.format(config=str(server.config)), table=TABLE)
    finally:
        plug.join()
        server.stop()
    assert executed.finished.stopped_by == "a guard"
    (end,) = executed.journal("attempt_finished")
    assert end["seconds"] < 55
    assert "not (robot answers) for 1 s" in end["failure"]
    opened = executed.journal("gate")[-1]
    assert (opened["state"], opened["run"]) == ("open", "r_1")
    assert "robot answers; process " in opened["seen"]
