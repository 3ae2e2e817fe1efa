"""Guards are watched while a run is measured, on a real and on a simulated clock, and do what they are for."""

from __future__ import annotations

import textwrap
import threading
from typing import TYPE_CHECKING

import pytest
from tests.core.execution.conftest import execute_in
from tests.long_cases import soak_but

from robot_runner import Condition, Guard, GuardAction, Look
from robot_runner.conditions.guard_watch import GuardWatch
from robot_runner.core.events.context import SystemClock
from robot_runner.measuring import periodic
from robot_runner.replication.explanation import explain_run
from robot_runner.testing import FakeClock, make_context

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

#: Comes true when a file is written: in the middle of the mission of the first attempt of the first run only.
HEAD = """\
from pathlib import Path
from robot_runner import *
import threading, time

ALARM = Path(__file__).parent / "alarm"

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = Path("results")
"""
BODY = """
attempts = {attempts}
guards = [Guard(text_in(ALARM, "hot"), GuardAction.{action})]
run_process = RunProcess.{process}
def start_run(self, context):
    ALARM.unlink(missing_ok=True)
def launch_mission(self, context):
    context.combination["Task"]
    print("launched", context.attempt, flush=True)
    if context.run_number == 1 and context.attempt <= {alarms}:
        ALARM.write_text("hot")
        deadline, journal = time.monotonic() + 60, context.experiment_folder / "journal.jsonl"
        while {lasts} and time.monotonic() < deadline:
            time.sleep(0.01)
    print("finished", context.attempt, flush=True)
def stop_run(self, context):
    print("threads", [each.name for each in threading.enumerate() if each.name == "sampler"])
def populate_run_data(self, context):
    return {{"Energy": 1.0}}
"""
TABLE = """\
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video", "Network"])], data_columns=["Energy"], seed=1)
"""


#: A mission that is not ended by a guard goes on until the guard has marked it.
MARKED = """'"kind":"guard"' not in journal.read_text()"""


def guarded(
    folder: Path, action: str, *, attempts: int = 2, alarms: int = 1, process: str = "FORK", lasts: str = "True"
) -> object:
    body = BODY.format(attempts=attempts, action=action, alarms=alarms, process=process, lasts=lasts)
    return execute_in(folder, body, head=HEAD, table=TABLE)


def test_a_run_is_marked_and_goes_on(tmp_path: Path) -> None:
    before = set(threading.enumerate())  # rospy, of another test, leaves threads for good
    executed = guarded(tmp_path, "MARK", lasts=MARKED)
    first, second = executed.journal("attempt_finished")
    assert (first["status"], second["status"]) == ("done", "done")
    (doubt,) = first["measures"]["Energy"]["doubts"]
    assert "after the measurement began, 'hot' is in" in doubt
    assert "doubts" not in second["measures"]["Energy"]
    (record,) = executed.journal("guard")
    assert (record["run"], record["action"]) == ("r_1", "mark")
    told = [text for label, text in explain_run(executed.folder, "r_1").facts if label == "Guard"]
    assert told == [f"mark: {doubt}"]
    assert "finished 1" in executed.log("r_1")
    assert "threads []" in executed.log("r_1")
    assert set(threading.enumerate()) <= before


@pytest.mark.long
@pytest.mark.parametrize("process", soak_but({"FORK", "IN_PROCESS"}, ["FORK", "SPAWN", "IN_PROCESS"]))
def test_an_attempt_is_repeated_while_there_is_one_left(tmp_path: Path, process: str) -> None:
    executed = guarded(tmp_path, "REPEAT", process=process)
    first, second, other = executed.journal("attempt_finished")
    assert [each["status"] for each in (first, second, other)] == ["failed", "done", "done"]
    assert first["seconds"] < 20
    assert "'hot' is in" in first["failure"]
    assert "guards" in first["failure"]
    assert "doubts" not in second["measures"]["Energy"]
    assert executed.finished.done_count == 2


def test_the_last_attempt_is_marked_instead_of_repeated(tmp_path: Path) -> None:
    executed = guarded(tmp_path, "REPEAT", attempts=1, lasts=MARKED)
    first, _ = executed.journal("attempt_finished")
    assert first["status"] == "done"
    assert first["measures"]["Energy"]["doubts"]
    assert executed.journal("guard")[0]["action"] == "mark"


def test_a_guard_stops_the_experiment(tmp_path: Path) -> None:
    executed = guarded(tmp_path, "STOP")
    finished = executed.finished
    assert (finished.done_count, finished.failed_count, finished.todo_count) == (0, 1, 1)
    assert finished.stopped_by == "a guard"
    (end,) = executed.journal("attempt_finished")
    assert end["is_last"]
    assert "finished" not in executed.log("r_1")


SIMULATED = """
robot = "simulated:initial_charge=40"
guards = [Guard({condition}, GuardAction.{action}), Guard(battery_below(5), GuardAction.STOP)]
def launch_mission(self, context):
    link = connect_robot(context)
    while True:
        link.publish("cmd_vel", "geometry_msgs/Twist", {{"linear": {{"x": 0.2}}}})
        context.clock.sleep(0.5)
        if context.clock.now() > 8:
            return
def populate_run_data(self, context):
    return {{"Energy": 1.0}}
"""
ONE_RUN = """\
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video"])], data_columns=["Energy"], seed=1)
"""


def simulated(folder: Path, condition: str, action: str) -> object:
    body = SIMULATED.format(condition=condition, action=action)
    head = HEAD.replace("import threading", "from robot_runner.plugins import connect_robot\nimport threading")
    return execute_in(folder, body, head=head, table=ONE_RUN)


@pytest.mark.long
def test_on_the_simulated_robot_time_goes_by_on_its_clock(tmp_path: Path) -> None:
    travelled = "topic_above('odom', 'nav_msgs/Odometry', 'pose.pose.position.x', 0.5)"
    executed = simulated(tmp_path, travelled, "MARK")
    (record,) = executed.journal("guard")
    assert 2.0 < record["after"] < 4.0
    assert executed.finished.done_count == 1


def test_a_guard_ends_the_mission_of_a_simulated_robot_at_once(tmp_path: Path) -> None:
    executed = simulated(tmp_path, "topic_above('odom', 'nav_msgs/Odometry', 'pose.pose.position.x', 0.5)", "STOP")
    (end,) = executed.journal("attempt_finished")
    assert end["status"] == "failed"
    (window,) = executed.journal("window") or [{"start": 0.0, "end": 0.0}]
    assert window["end"] - window["start"] < 5.0
    assert executed.finished.stopped_by == "a guard"


def test_a_look_that_raises_is_told_and_fails_nothing(tmp_path: Path) -> None:
    executed = simulated(tmp_path, "topic_above('odom', 'nav_msgs/Odometry', 'pose.pose.positoin', 0.5)", "MARK")
    assert executed.finished.done_count == 1
    problems = [finding.problem for finding in executed.finished.findings]
    assert any("could not be watched" in problem and "no field 'pose.pose.positoin'" in problem for problem in problems)


def test_a_guard_that_never_knew_what_it_watched_makes_the_run_doubtful(tmp_path: Path) -> None:
    body = """
    guards = [Guard(measure_below("Power", 5), GuardAction.STOP)]
    def launch_mission(self, context):
        context.combination["Task"]
        time.sleep(0.3)
    def populate_run_data(self, context):
        return {"Energy": 1.0}
    """
    executed = execute_in(tmp_path, textwrap.dedent(body), head=HEAD, table=TABLE)
    first, _ = executed.journal("attempt_finished")
    assert first["status"] == "done"
    (doubt,) = first["measures"]["Energy"]["doubts"]
    assert doubt.startswith("the guard 'the measure Power is below 5' watched nothing: ")
    assert "was not published yet" in doubt


class Blind(Condition):
    """What can be looked at at first, and then no more."""

    every_s = 0.05

    def __init__(self, look: Callable[[], Look]) -> None:
        self.last = look
        self.has_looked = False

    def __str__(self) -> str:
        return "the lab is on fire"

    def watch(self, context: object, opened: object) -> Callable[[], Look]:
        return self.look

    def look(self) -> Look:
        has_looked, self.has_looked = self.has_looked, True
        return self.last() if has_looked else Look(holds=False, seen="all is well")


def test_a_guard_whose_last_look_raised_makes_the_run_doubtful(tmp_path: Path) -> None:
    def fails() -> Look:
        raise ValueError("no such sensor")

    clock = FakeClock()
    context = make_context(tmp_path, robot=None, clock=clock)
    watch = GuardWatch([Guard(Blind(fails), GuardAction.STOP)])
    watch.start_measurement(context)
    clock.sleep(1.0)
    watch.stop_measurement(context)
    problems = [finding.problem for finding in context.broker.findings]
    assert "the guard 'the lab is on fire' knew nothing any more in the end: ValueError: no such sensor" in problems


def test_a_guard_whose_last_look_hangs_makes_the_run_doubtful_and_comes_true_no_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hangs, released = threading.Event(), threading.Event()

    def hang() -> Look:
        hangs.set()
        released.wait(60)
        return Look(holds=True)

    monkeypatch.setattr(periodic, "_PATIENCE", 0.01)
    context = make_context(tmp_path, robot=None, clock=SystemClock())
    before = set(threading.enumerate())
    watch = GuardWatch([Guard(Blind(hang), GuardAction.STOP)])
    watch.start_measurement(context)
    assert hangs.wait(60)
    watch.stop_measurement(context)
    released.set()
    for thread in set(threading.enumerate()) - before:
        thread.join(60)
    assert not [kind for kind, _ in context.broker.records if kind == "guard"], "the measurement was over by then"
    (told,) = [each.problem for each in context.broker.findings if "knew nothing any more in the end" in each.problem]
    assert told.endswith(": a look at it has not come back")
