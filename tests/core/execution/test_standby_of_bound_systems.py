"""Who makes a system safe late does so with the treatments of its own run, whatever has begun beside it."""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.execution.progress_manager import ProgressManager
from robot_runner.core.execution.recovery import Resumption
from robot_runner.core.execution.standby import standby_of
from robot_runner.core.execution.systems_state import Care
from robot_runner.core.treatments import bind

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

HEAD = """\
from pathlib import Path
from robot_runner import *
from robot_runner.plugins import System

HERE = Path(__file__).parent

class Lamp(System):
    def __init__(self, *, room):
        super().__init__()
        self.room = room
    def claims(self, robot):
        return ()
    def make_safe(self, context):
        (HERE / "made_safe").write_text(f"{self.room} {context.combination['Room']}")

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"
    workers = 2
    plugins = [Lamp(room=treatment("Room"))]
"""
TABLE = """
    def create_run_table(self):
        return RunTableModel([Factor("Room", ["kitchen", "hall"])])
"""


@pytest.mark.filterwarnings("ignore:.*multi-threaded:DeprecationWarning")
def test_a_system_is_made_safe_with_the_treatments_of_its_own_run(write_config: Callable[..., Path]) -> None:
    experiment = prepare_or_refuse(write_config("", head=HEAD, table=TABLE))
    with ProgressManager(experiment, Resumption()) as progress:
        first, second = (progress.task_of(run) for run in progress.pending())
        (lamp,) = experiment.systems
        bind(lamp, first.combination)
        standby = standby_of(experiment, replace(first, attempt=1))
        assert standby is not None
        bind(lamp, second.combination)  # the next run begins beside it
        standby.state.set(Care.RUN)
        dead = subprocess.Popen([sys.executable, "-c", ""])
        dead.wait()
        for seconds in standby.looked_after(dead.pid):
            time.sleep(seconds)
        assert standby.state.care is Care.MADE_SAFE
        standby.state.close()
    assert (experiment.config_path.parent / "made_safe").read_text(encoding="utf-8") == "kitchen kitchen"
