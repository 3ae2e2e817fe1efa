"""Gates are awaited before each attempt, in a process of their own, and what follows is as the config says."""

from __future__ import annotations

import os
import re
import threading
from collections import defaultdict
from typing import TYPE_CHECKING

import pytest
from tests.conftest import written_config
from tests.core.execution.conftest import Executed, RecordingObserver

from robot_runner import ConditionError, Gate, GatePolicy, Guard, GuardAction, port_open
from robot_runner.core.config.preparation import prepare, prepare_or_refuse
from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.execution import local_places, run_events
from robot_runner.core.execution.experiment_status import read_status
from robot_runner.core.execution.notices import (
    AttemptFinished,
    ExperimentStarted,
    FindingsNoticed,
    GatePassed,
    GateWaiting,
    Notice,
    Paused,
)
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.storage.lock import leave_request

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

#: Holds from the second look on, at each wait anew, and says in which process it was looked at.
HEAD = """\
from pathlib import Path
from robot_runner import *
import os, threading, time

HERE = Path(__file__).parent

class SecondLook(Condition):
    def __str__(self):
        return "it was looked at twice"
    def watch(self, context, opened):
        opened.callback((HERE / "closed").touch)
        threading.Thread(target=time.sleep, args=(0.1,)).start()
        looks = []
        def look():
            looks.append(context.run_id)
            (HERE / "looked").open("a").write(f"{os.getpid()} {context.run_id} {context.attempt}\\n")
            return Look(len(looks) > 1, f"look {len(looks)}")
        return look

class Never(SecondLook):
    def __str__(self):
        return "pigs fly"
    def watch(self, context, opened):
        return lambda: Look(False, "none in sight")

class Broken(Never):
    def watch(self, context, opened):
        raise ZeroDivisionError("the sensor is gone")

class Deadly(Never):
    def watch(self, context, opened):
        os._exit(9)

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = Path("results")
"""
BODY = """
attempts = 1
def launch_mission(self, context):
    context.combination["Task"]
    (HERE / "launched").open("a").write(f"{context.run_id}\\n")
def populate_run_data(self, context):
    return {"Energy": 1.0}
"""
ONE_RUN = """\
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video"])], data_columns=["Energy"])
"""


def gated(execute: Callable, gates: str, body: str = BODY) -> object:
    return execute(f"gates = [{gates}]\n{body}", head=HEAD)


def test_a_gate_is_awaited_before_each_run_in_a_process_of_its_own(execute: Callable, tmp_path: Path) -> None:
    before = set(threading.enumerate())  # of other tests
    executed = gated(execute, "Gate(SecondLook(), timeout_s=60)")
    looked = [line.split() for line in (tmp_path / "looked").read_text().splitlines()]
    assert [run for _, run, _ in looked] == ["r_1", "r_1", "r_2", "r_2", "r_3", "r_3", "r_4", "r_4"]
    assert len({pid for pid, _, _ in looked} | {str(os.getpid())}) == 5
    assert set(threading.enumerate()) <= before
    assert (tmp_path / "closed").exists()
    assert executed.finished.done_count == 4

    kept = executed.journal("gate")
    assert [each["state"] for each in kept] == ["waiting", "open"] * 4
    assert [each["run"] for each in kept[1::2]] == ["r_1", "r_2", "r_3", "r_4"]
    assert kept[1]["seen"] == "look 2"
    assert read_status(executed.folder).gate_seconds == pytest.approx(sum(each["seconds"] for each in kept[1::2]))
    order = [record["kind"] for record in executed.journal("gate", "attempt_started")]
    assert order == ["gate", "gate", "attempt_started"] * 4
    waiting = [notice for notice in executed.notices if isinstance(notice, GateWaiting)]
    assert (waiting[0].run_number, waiting[0].run_count, waiting[0].seen) == (1, 4, "look 1")
    passed = [notice for notice in executed.notices if isinstance(notice, GatePassed)]
    assert [notice.state for notice in passed] == ["open"] * 4


def test_a_process_stands_by_for_each_run_and_for_no_gate(execute: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr(local_places, "Standby", lambda _systems, _experiment, task: asked.append(task.run_id))
    assert gated(execute, "Gate(SecondLook(), timeout_s=60)").finished.done_count == 4
    assert asked == ["r_1", "r_2", "r_3", "r_4"]


class _Pausing(RecordingObserver):
    """Somebody who asks for a pause as soon as a gate is awaited, and ends it."""

    def notice(self, notice: Notice) -> None:
        super().notice(notice)
        told = [type(each) for each in self.notices]
        if isinstance(notice, GateWaiting) and told.count(GateWaiting) == 1:
            leave_request(self.folder / ".pause")
        elif isinstance(notice, Paused):
            (notice.folder / ".pause").unlink()

    @property
    def folder(self) -> Path:
        return next(each.folder for each in self.notices if isinstance(each, ExperimentStarted))


def test_a_pause_that_is_asked_for_while_a_gate_is_awaited_comes_before_the_run_and_the_gate_again_after_it(
    tmp_path: Path,
) -> None:
    config = written_config(tmp_path, f"gates = [Gate(SecondLook())]\n{BODY}", head=HEAD, table=ONE_RUN)
    observer = _Pausing()
    finished = execute_experiment(prepare_or_refuse(config), observer)
    executed = Executed(config, finished, observer.notices)
    told = executed.journal("gate", "paused", "continued", "attempt_started")
    assert [each.get("state", each["kind"]) for each in told] == [
        *("waiting", "open", "paused", "continued"),
        *("waiting", "open", "attempt_started"),
    ]
    assert finished.done_count == 1


def test_a_pause_that_is_asked_for_before_another_attempt_comes_before_it(tmp_path: Path) -> None:
    fails_once = "attempts = 2\ndef start_run(self, context):\n    assert context.attempt > 1\n"
    body = f"gates = [Gate(SecondLook())]\n{BODY}{fails_once}"
    config = written_config(tmp_path, body, head=HEAD, table=ONE_RUN)

    class Pausing(_Pausing):
        def notice(self, notice: Notice) -> None:
            RecordingObserver.notice(self, notice)
            if isinstance(notice, AttemptFinished) and not notice.is_last:
                leave_request(self.folder / ".pause")
            elif isinstance(notice, Paused):
                (notice.folder / ".pause").unlink()

    observer = Pausing()
    finished = execute_experiment(prepare_or_refuse(config), observer)
    told = Executed(config, finished, observer.notices).journal("paused", "attempt_started")
    assert [each["kind"] for each in told] == ["attempt_started", "paused", "attempt_started"]
    assert finished.done_count == 1


@pytest.mark.long
def test_several_gates_are_passed_one_after_another(execute: Callable) -> None:
    executed = gated(execute, "Gate(SecondLook()), Gate(SecondLook().held_for(0.1))")
    opened = [each["condition"] for each in executed.journal("gate") if each["state"] == "open"]
    assert opened == ["it was looked at twice", "it was looked at twice for 0.1 s"] * 4


def test_a_gate_that_is_not_passed_stops_the_experiment_and_leaves_the_run_to_do(
    execute: Callable, tmp_path: Path
) -> None:
    executed = gated(execute, "Gate(Never(), timeout_s=0.2)")
    finished = executed.finished
    assert finished.stopped_by
    assert finished.stopped_by == "a gate"
    assert (finished.done_count, finished.failed_count, finished.todo_count) == (0, 0, 4)
    assert not (tmp_path / "launched").exists()
    assert executed.journal("attempt_started") == []
    (told,) = (finding for finding in finished.findings if finding.where == "before r_1")
    assert "after 0.2 s it still did not hold that pigs fly: none in sight" in told.problem


def test_a_run_behind_a_gate_that_is_not_passed_may_be_executed_and_doubted(execute: Callable) -> None:
    executed = gated(execute, "Gate(Never(), timeout_s=0.1, on_timeout=GatePolicy.DOUBT), Gate(SecondLook())")
    assert executed.finished.done_count == 4
    ends = executed.journal("attempt_finished")
    assert all("pigs fly" in end["measures"]["Energy"]["doubts"][0] for end in ends)
    states = [each["state"] for each in executed.journal("gate") if each["run"] == "r_1" and each["state"] != "waiting"]
    assert states == ["timed out", "open"]


def test_a_run_behind_a_gate_that_is_not_passed_may_fail_unexecuted(execute: Callable, tmp_path: Path) -> None:
    executed = gated(
        execute,
        "Gate(Never(), timeout_s=0.1, on_timeout=GatePolicy.FAIL)",
        BODY.replace("attempts = 1", "attempts = 2"),
    )
    assert executed.finished.failed_count == 4
    assert "pigs fly" in executed.finished.failures[0]
    assert not (tmp_path / "launched").exists()
    assert [each["attempt"] for each in executed.journal("gate") if each["state"] == "timed out"] == [1, 2] * 4


def test_a_gate_may_be_waited_for_beyond_its_time_which_is_told(execute: Callable) -> None:
    slow = "Gate(SecondLook().held_for(0.7), timeout_s=0.1, on_timeout=GatePolicy.WAIT)"
    executed = execute(
        f"gates = [{slow}]\n{BODY}",
        head=HEAD,
        table=ONE_RUN,
    )
    assert executed.finished.done_count == 1
    (notice,) = (notice for notice in executed.notices if isinstance(notice, FindingsNoticed))
    assert "takes longer than 100 ms" in notice.findings[0].problem


@pytest.mark.parametrize(
    ("condition", "reason"),
    [("Broken()", "ZeroDivisionError: the sensor is gone"), ("Deadly()", "the run's process exited with code 9")],
)
@pytest.mark.parametrize("policy", ["STOP", "WAIT", "DOUBT"])
def test_a_gate_that_cannot_be_awaited_is_not_awaited_for_ever(
    execute: Callable, condition: str, reason: str, policy: str
) -> None:
    executed = gated(execute, f"Gate({condition}, timeout_s=60, on_timeout=GatePolicy.{policy})")
    assert executed.finished.done_count == (4 if policy == "DOUBT" else 0)
    assert bool(executed.finished.stopped_by) == (policy != "DOUBT")
    assert executed.journal("gate")[0]["problem"] == reason
    assert any(reason in finding.problem for finding in executed.finished.findings)


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (lambda: Gate("port 8080"), "'port 8080' is not a condition"),
        (lambda: Gate(port_open(1), timeout_s=0), "timeout_s is 0"),
        (lambda: Gate(port_open(1), timeout_s=True), "timeout_s is True"),
        (lambda: Gate(port_open(1), on_timeout="stop"), "'stop' is not a GatePolicy"),
        (lambda: Guard(None), "None is not a condition"),
        (lambda: Guard(port_open(1), GatePolicy.STOP), "is not a GuardAction"),
    ],
)
def test_what_is_no_gate_and_no_guard_is_refused(make: Callable, problem: str) -> None:
    with pytest.raises(ConditionError, match=problem) as error:
        make()
    assert error.value.fix


def test_what_can_never_hold_is_found_before_anything_is_executed(write_config: Callable) -> None:
    config = write_config("""
        gates = [
            Gate(all_of(load_below(101), battery_above(40))),
            Gate(any_of(temperature_below(-300), measure_above("Energy", 5), confirmed("all is well"))),
        ]
        guards = [Guard(all_of(load_above(90), load_below(10))), Guard(not_(topic_present("scan")), GuardAction.STOP)]
        """)
    findings = defaultdict(list)
    for finding in prepare(config).findings:
        findings[re.search(r"\w+\[\d\]|$", finding.where)[0]].append(finding.problem)
    assert findings["gates[0]"] == ["the condition is about a robot, and the experiment names none"]
    assert findings["gates[1]"] == [
        "the temperature of this machine is never below -300 °C",
        "before a run nothing is published, so that never is true: the measure Energy is above 5",
        "before a run, a person is asked by a step and not by a gate: a person says that all is well",
    ]
    assert findings["guards[0]"] == [
        "never are both true: the load of this machine is below 10 %, and the load of this machine is above 90 %"
    ]
    assert findings["guards[1]"] == ["the condition is about a robot, and the experiment names none"]


def test_a_guard_and_a_gate_are_no_strings(write_config: Callable) -> None:
    config = write_config("gates = ['port 8080 is open']\nguards = GuardAction.MARK")
    problems = [finding.fix for finding in prepare(config).findings]
    assert any("a list of Gate(...)" in fix for fix in problems)
    assert any("a list of Guard(...)" in fix for fix in problems)


def test_actions_have_names() -> None:
    assert [action.value for action in GuardAction] == ["mark", "repeat", "stop"]


AWAY = """\
gates = [Gate(SecondLook(), timeout_s={timeout_s})]
robot = "simulated"
"""


@pytest.mark.parametrize("timeout_s", [60, 0.5])
def test_a_robot_that_cannot_be_reached_is_waited_for(
    execute: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, timeout_s: float
) -> None:
    def open_clock(*_: object, **__: object) -> SystemClock:
        with (tmp_path / "tried").open("a") as file:
            file.write("x")
        if (tmp_path / "tried").stat().st_size < 3:
            raise LinkError("there is no ROS master", where="robot", fix="Start one.")
        return SystemClock()

    monkeypatch.setattr(run_events, "open_clock", open_clock)
    executed = execute(AWAY.format(timeout_s=timeout_s) + BODY, head=HEAD, table=ONE_RUN)
    kept = executed.journal("gate")
    assert (kept[0]["state"], kept[0]["seen"]) == ("waiting", "robot: there is no ROS master → Start one.")
    assert executed.finished.done_count == (1 if timeout_s > 1 else 0)
    assert kept[-1]["state"] == ("open" if timeout_s > 1 else "timed out")


def test_a_gate_that_does_not_ask_the_robot_needs_none(
    execute: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def open_clock(robot: str | None, *_: object, **__: object) -> SystemClock:
        with (tmp_path / "opened").open("a") as file:
            file.write(f"{robot} ")
        return SystemClock()

    monkeypatch.setattr(run_events, "open_clock", open_clock)
    body = f"gates = [Gate(not_(port_open(1)))]\nrobot = 'simulated'\n{BODY}"
    assert execute(body, head=HEAD, table=ONE_RUN).finished.done_count == 1
    assert (tmp_path / "opened").read_text() == "None simulated "
