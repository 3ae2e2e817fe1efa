"""A simulated robot in real time, moving: whatever dies, it stands still within a second."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
from tests.process.conftest import wait_until
from tests.processor_wait import OWN_WAITS, ProcessorWait

if TYPE_CHECKING:
    from pathlib import Path

Start = Callable[..., Any]

HEAD = f"""\
import json, os, time
from pathlib import Path
from robot_runner import *
from robot_runner.plugins import System, connect_robot
from robot_runner.plugins.systems import BasicTurtlebot3

HERE = Path(__file__).parent

class Watcher(System):
    '''Looks at the robot from outside: it is closed last, and writes down when the robot stood still.'''
    def start_run(self, context):
        robot = connect_robot(context)
        robot.subscribe("odom", "nav_msgs/Odometry", self.look)
        self.clock = context.clock
        (HERE / "begun").touch()
    def launch_mission(self, context):
        (HERE / "launched.new").write_text(str(time.time()))
        (HERE / "launched.new").rename(HERE / "launched")
    def look(self, message):
        self.speed = message["twist"]["twist"]["linear"]["x"]
        if self.speed > 0.15 and not (HERE / "moving").exists():
            (HERE / "moving").write_text(str(os.getpid()))
    def stop_run(self, context):
        self.note(context)
    def make_safe(self, context):
        self.note(context)
    def note(self, context):
        context.clock.sleep(0.5)
        (HERE / "speed").write_text(str(self.speed))
        (HERE / "still.new").write_text(json.dumps([time.time(), {OWN_WAITS}]))
        (HERE / "still.new").rename(HERE / "still")

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"
    robot = "simulated:real_time_factor=1"
    plugins = [Watcher(), BasicTurtlebot3(sleep_s=0.2, drive_s=30, task_s=1, rotate_s=5)]
    grace_in_s = 5
    event_deadline_in_s = 60
"""
TABLE = """\
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video"])])
"""


@pytest.fixture
def moving(start: Start, write_config: Callable[..., Path]) -> Any:
    experiment = start(config=write_config("", head=HEAD, table=TABLE))
    experiment.wait_for("moving")
    return experiment


def stood_still(experiment: Any, since: float, wait: ProcessorWait) -> bool:
    is_in_time = experiment.stops_within_a_second(since, wait, "still")
    return is_in_time and abs(float((experiment.config.parent / "speed").read_text())) < 0.01


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP], ids=lambda n: n.name)
def test_when_the_orchestrator_goes_the_robot_stands_still_within_a_second(moving: Any, number: signal.Signals) -> None:
    wait = ProcessorWait(moving.processes())
    sent = moving.send(number)
    assert stood_still(moving, sent, wait)
    moving.end()
    assert moving.nobody_is_left()


@pytest.mark.long
def test_when_the_mission_raises_the_robot_stands_still_within_a_second(
    start: Start, write_config: Callable[..., Path]
) -> None:
    bump = "(HERE / 'raised').touch(); raise RuntimeError('a bump')"
    head = HEAD.replace(
        "        if self.speed > 0.15",
        f"        if self.speed > 0.15 and self.clock.now() > 2: {bump}\n        if self.speed > 0.15",
    )
    experiment = start(config=write_config("", head=head, table=TABLE))
    experiment.wait_for("begun")
    wait = ProcessorWait(experiment.processes())
    raised = experiment.wait_for("raised", meanwhile=wait.restart).stat().st_mtime
    assert stood_still(experiment, raised, wait)
    assert experiment.end() == 1
    assert "a bump" in experiment.output


#: A deadline of the mission alone, for a robot that moves by then: a busy machine may be late with all else.
DEADLINE = """\
    event_deadline_in_s = 3

    from robot_runner.core.execution import local_places
    def deadlines_there(self, deadlines=local_places._Supervision._deadlines):
        of_run, of_event = deadlines(self)
        if of_event is None or self._builder.event != "launch_mission":
            return of_run, None
        return of_run, of_event if (HERE / "moving").exists() else max(of_event, time.monotonic() + 0.05)
    local_places._Supervision._deadlines = deadlines_there
"""


def test_when_a_deadline_passes_the_robot_stands_still_within_a_second(
    start: Start, write_config: Callable[..., Path]
) -> None:
    config = write_config("", head=HEAD.replace("    event_deadline_in_s = 60\n", DEADLINE), table=TABLE)
    experiment = start(config=config)
    deadline, moving = float(experiment.text_of("launched")) + 3.0, config.parent / "moving"
    wait = ProcessorWait(experiment.processes())
    wait_until(lambda: wait.restart() or (time.time() > deadline and moving.exists()), "the deadline has passed")
    assert stood_still(experiment, max(deadline, moving.stat().st_mtime), wait)
    assert experiment.end() == 1
    assert "event_deadline_in_s = 3" in experiment.output
