"""A run, and its mission, are ended from anywhere: by `fail`, by `stop_mission`, and by what a thread raises."""

from __future__ import annotations

import _thread
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from tests.event_deadline import enforce_deadline_in
from tests.long_cases import long_but, soak_but
from tests.waiting import PATIENCE

from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.errors import PluginError, StorageError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.early_end import MissionStopped, RunFailed, RunInterrupted
from robot_runner.core.events.window import MissionTimes
from robot_runner.core.execution.interruption import InterruptGate, Interruption, stop_signals_handled
from robot_runner.core.execution.notices import AttemptFinished, SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.processes import forked, leave_after
from robot_runner.core.execution.run_records import failure_fields
from robot_runner.core.storage.journal import Journal, read_journal
from robot_runner.replication.explanation import explain_run
from robot_runner.testing import make_context

Execute = Callable[..., Any]

#: A system that is to be made safe, and a mission of an hour, which something ends.
HEAD = """
import threading, time
from pathlib import Path
from robot_runner import *
from robot_runner.plugins import System

class Arm(System):
    measures = ()
    def stop_run(self, context): print("arm closed")
    def make_safe(self, context): print("arm made safe")

def after(seconds, what):
    timer = threading.Timer(seconds, what)
    timer.daemon = True
    timer.start()

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = Path("results")
"""

TABLE = """
    def create_run_table(self):
        return RunTableModel([Factor("N", [1])], data_columns=["Energy"])
"""
BODY = """
plugins = [Arm()]
grace_in_s = 5
def start_run(self, context): {start}
def launch_mission(self, context):
    {mission}
    print("the mission went on")
def stop_measurement(self, context): print("measurement closed")
def stop_run(self, context): {stop}
def populate_run_data(self, context):
    {populate}
    print("populated")
    return {{"Energy": round(context.window.duration, 3)}}
def throw(self): raise ValueError("the thread's own")
"""
FAIL = "after(0.2, lambda: context.fail('too warm'))"
STOP = "after(0.2, lambda: context.stop_mission('goal reached'))"


def failure_of(executed: Any) -> Any:
    (outcome,) = [notice.outcome for notice in executed.notices if isinstance(notice, AttemptFinished)]
    return outcome.failure


def ended(execute: Execute, mission: str = "pass", **more: str) -> Any:
    known = ("run_process", "robot", "grace_in_s", "event_deadline_in_s")
    settings = {name: more.pop(name) for name in known if name in more}
    lines = {"start": "pass", "stop": "pass", "populate": "pass", **more}
    body = BODY.format(mission=mission.replace("\n", "\n    "), **lines)
    began = time.monotonic()
    executed = execute(body, head=HEAD, table=TABLE, **settings)
    assert time.monotonic() - began < 60, "the mission was not ended"
    return executed


@pytest.mark.parametrize("run_process", soak_but({"fork", "in_process"}, ["fork", "spawn", "in_process"]))
def test_a_thread_fails_the_run_with_its_reason_and_the_robot_is_made_safe(execute: Execute, run_process: str) -> None:
    executed = ended(execute, f"{FAIL}\ntime.sleep(3600)", run_process=run_process)
    (failure,) = executed.journal("failure")
    assert (failure["problem"], failure["owner"], failure["event"]) == ("too warm", "config", "launch_mission")
    assert "in <lambda>" in failure["traceback"]
    assert failure_of(executed).problem == "too warm"
    log = executed.log("r_1")
    assert [line for line in log.splitlines() if line.endswith(("closed", "safe", "on", "populated"))] == [
        "measurement closed",
        "arm closed",
        "arm made safe",
    ]
    assert "launch_mission of config failed: too warm" in log


@pytest.mark.parametrize("run_process", ["fork", "in_process"])
def test_a_request_to_stop_ends_the_run_without_a_live_screen_too(execute: Execute, run_process: str) -> None:
    mission = (
        '(context.experiment_folder / ".stop").touch()\ncontext.publish("Energy", 1.0)\ntime.sleep(6)\nprint("went on")'
    )
    executed = ended(execute, mission, run_process=run_process)
    assert executed.finished.interrupted
    assert [row["status"] for row in executed.table] == ["-"]
    log = executed.log("r_1")
    assert "went on" not in log
    assert "arm made safe" in log


@pytest.mark.parametrize("run_process", long_but(["fork", "in_process"], ["fork", "spawn", "in_process"]))
def test_a_thread_stops_the_mission_and_the_run_is_done(execute: Execute, run_process: str) -> None:
    executed = ended(execute, f"{STOP}\ntime.sleep(3600)", run_process=run_process)
    (row,) = executed.table
    assert row["status"] == "Done"
    assert 0.2 <= float(row["Energy"]) < 30.0  # the window
    (stopped,) = executed.journal("mission_stopped")
    assert (stopped["owner"], stopped["reason"]) == ("config", "goal reached")
    assert ("Mission", "stopped by config: goal reached") in explain_run(executed.folder, "r_1").facts
    log = executed.log("r_1")
    assert "the mission was stopped by config: goal reached" in log
    assert [line for line in log.splitlines() if line.endswith(("closed", "safe", "on", "populated"))] == [
        "measurement closed",
        "arm closed",
        "arm made safe",
        "populated",
    ]


@pytest.mark.parametrize(
    "mission",
    [
        "context.clock.sleep(3600)",
        "threading.Event().wait()",
        "joined = threading.Thread(target=time.sleep, args=(3600,), daemon=True)\njoined.start()\njoined.join()",
        "import subprocess; subprocess.run(['sleep', '3600'])",
        "import select; select.select([], [], [])",
        "import asyncio; asyncio.run(asyncio.sleep(3600))",
        "while True: pass",
    ],
    ids=["clock", "wait", "join", "subprocess", "select", "asyncio", "loop"],
)
def test_whatever_the_mission_does_in_python_ends_at_once(execute: Execute, mission: str) -> None:
    executed = ended(execute, f"{FAIL}\n{mission}")
    # Where it ends only once the grace is over, that is told besides.
    assert failure_of(executed).problem == "too warm"


#: A signal that comes right before a sleep begins is noticed after that sleep only.
LOSE_FIRST = """
import signal
ours, lost = signal.getsignal({signal}), []
signal.signal({signal}, lambda number, frame: ours(number, frame) if lost else lost.append(number))
"""


@pytest.mark.parametrize("ending", [FAIL, STOP], ids=["fail", "stop"])
def test_a_thread_ends_a_mission_whose_first_signal_comes_right_before_it_sleeps(execute: Execute, ending: str) -> None:
    lose = LOSE_FIRST.format(signal="signal.SIGURG")
    executed = ended(execute, f"{lose}{ending}\ntime.sleep(3600)", grace_in_s="100")
    assert "had not ended" not in str(failure_of(executed))
    assert "the mission went on" not in executed.log("r_1")


@pytest.mark.parametrize("run_process", long_but(["fork"], ["fork", "spawn"]))
def test_a_run_ends_whose_first_stop_request_comes_right_before_it_sleeps(execute: Execute, run_process: str) -> None:
    lose = LOSE_FIRST.format(signal="signal.SIGTERM")
    stop = '(context.experiment_folder / ".stop").touch()\ncontext.publish("Energy", 1.0)\ntime.sleep(3600)'
    executed = ended(execute, f"{lose}{stop}", grace_in_s="100", run_process=run_process)
    assert executed.finished.interrupted
    assert "arm closed\narm made safe" in executed.log("r_1")


@pytest.mark.long
def test_a_mission_on_the_simulated_robot_ends_from_a_topic_and_from_a_thread(execute: Execute) -> None:
    topic = """
    from robot_runner.plugins import connect_robot
    def look(message):
        if context.clock.now() > 2.0:
            context.stop_mission("two seconds are over")
            print("the callback went on")
    connect_robot(context).subscribe("odom", "nav_msgs/Odometry", look)
    context.clock.sleep(3600)
    """
    executed = ended(execute, "\n".join(line[4:] for line in topic.splitlines()), robot="simulated")
    assert [row["status"] for row in executed.table] == ["Done"]
    assert 2.0 < float(executed.table[0]["Energy"]) < 2.2
    assert "went on" not in executed.log("r_1")
    executed.folder.rename(executed.folder.with_name("first"))
    executed = ended(execute, f"{FAIL}\nwhile True: context.clock.sleep(1.0)", robot="simulated")
    assert failure_of(executed).problem == "too warm"


@pytest.mark.long
def test_a_run_can_be_failed_before_and_after_its_mission(execute: Execute) -> None:
    executed = ended(execute, start="context.fail('the door is open')")
    assert str(failure_of(executed)) == "start_run of config: the door is open"
    assert "arm made safe" in executed.log("r_1")
    assert "went on" not in executed.log("r_1")
    for name in ("stop", "populate"):
        executed.folder.rename(executed.folder.with_name(f"before {name}"))
        executed = ended(execute, **{name: "context.fail('the arm was moved')"})
        assert failure_of(executed).problem == "the arm was moved"
        assert "arm made safe" in executed.log("r_1")


def test_before_run_can_fail_its_run(execute: Execute) -> None:
    executed = execute("def before_run(self, context): context.fail('the battery is empty')", table=TABLE)
    assert str(failure_of(executed)) == "before_run of config: the battery is empty"


def test_the_mission_cannot_be_stopped_before_it_begins_and_is_stopped_once(execute: Execute) -> None:
    executed = ended(execute, start="context.stop_mission('too early')")
    assert "there is no mission going on" in failure_of(executed).problem
    executed.folder.rename(executed.folder.with_name("too early"))
    executed = ended(
        execute, "context.stop_mission('goal reached')", stop="context.stop_mission('late'); print('went through')"
    )
    assert [row["status"] for row in executed.table] == ["Done"]
    assert [record["reason"] for record in executed.journal("mission_stopped")] == ["goal reached"]
    assert "went through" in executed.log("r_1")


@pytest.mark.parametrize("reason", ["None", "7", "ValueError('stuck')"])
def test_a_mission_may_be_stopped_for_a_reason_that_is_no_text(execute: Execute, reason: str) -> None:
    executed = ended(execute, f"context.stop_mission({reason})")
    told = str(ValueError("stuck")) if "stuck" in reason else reason
    assert [record["reason"] for record in executed.journal("mission_stopped")] == [told]


def test_a_mission_that_does_not_leave_c_is_ended_when_the_grace_is_over(execute: Execute) -> None:
    hang = "import ctypes; m = ctypes.create_string_buffer(64); [ctypes.CDLL(None).pthread_mutex_lock(m) for _ in 'ab']"
    executed = ended(execute, f"{FAIL}\n{hang}", grace_in_s="1")
    expected = "too warm; launch_mission had not ended grace_in_s = 1 s later"
    assert str(failure_of(executed)) == f"launch_mission of config: {expected}"


def test_a_closing_event_that_hangs_is_told_with_its_owner_and_where_it_hangs(
    execute: Execute, monkeypatch: pytest.MonkeyPatch
) -> None:
    enforce_deadline_in("stop_measurement", monkeypatch)
    hang = "def stop_measurement(self): threading.Event().wait()"
    executed = execute(hang, head=HEAD, table=TABLE, event_deadline_in_s=1, grace_in_s=2)
    because = "the event took longer than event_deadline_in_s = 1 s"
    assert executed.finished.failures == (f"r_1: stop_measurement of config: {because}",)
    failed = "stop_measurement of config failed: the callback was still being executed when"
    _, _, stack = executed.log("r_1").partition(failed)
    assert "in stop_measurement" in stack


def test_a_mission_that_swallows_the_request_to_end_is_told_with_where_it_goes_on(
    execute: Execute, monkeypatch: pytest.MonkeyPatch
) -> None:
    enforce_deadline_in("launch_mission", monkeypatch)
    mission = "try: time.sleep(60)\nexcept BaseException: threading.Event().wait()"
    executed = ended(execute, mission, grace_in_s="2", event_deadline_in_s="1")
    assert str(failure_of(executed)).startswith("launch_mission of config: the event took longer")
    assert "threading.Event().wait()" in failure_of(executed).traceback


def late(*_: object) -> int:
    return 1


def refused(*_: object) -> int:
    raise RuntimeError("can't start new thread")


@pytest.mark.parametrize("closing", ["stop_measurement", "stop_run"])
@pytest.mark.parametrize("start", [late, refused])
def test_a_run_that_is_told_to_end_while_it_closes_has_failed_also_where_it_ends_before_a_thread_can_say_so(
    execute: Execute, monkeypatch: pytest.MonkeyPatch, closing: str, start: Callable[..., int]
) -> None:
    monkeypatch.setattr(_thread, "start_new_thread", start)
    told = f"def {closing}(self):\n    import os, signal\n    os.kill(os.getpid(), signal.SIGTERM)\n"
    executed = execute(f"{told}def populate_run_data(self): return {{'Energy': 1.0}}", head=HEAD, table=TABLE)
    (failure,) = executed.finished.failures
    problem = "the callback was still being executed when the run was told to end"
    assert failure == f"r_1: {closing} of config: {problem}"
    assert [row["status"] for row in executed.table] == ["Failed"]


#: Python drops what is raised in a `__del__`, and goes on with what follows.
DROPPED = """
class Held:
    def __del__(self): {during}
held = Held()
del held
time.sleep(3600)
"""


@pytest.mark.parametrize("run_process", ["fork", "in_process"])
@pytest.mark.parametrize("during", [f"{FAIL}; time.sleep(60)", "context.fail('too warm')"])
def test_a_request_to_end_that_python_drops_is_repeated(execute: Execute, run_process: str, during: str) -> None:
    executed = ended(execute, DROPPED.format(during=during), run_process=run_process, grace_in_s="50")
    assert str(failure_of(executed)) == "launch_mission of config: too warm"
    assert "arm closed" in executed.log("r_1")
    assert "Exception ignored" not in executed.log("r_1")


def no_thread(_timer: threading.Timer) -> None:
    raise RuntimeError("can't start new thread")


def test_a_thread_ends_a_callback_also_where_the_system_has_no_further_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    went_on = threading.Event()

    def end() -> None:
        gate.end_run(RunFailed("too warm"))
        went_on.set()

    def callback() -> None:
        gate.arm()
        threading.Thread(target=end).start()
        time.sleep(20)

    monkeypatch.setattr(threading.Timer, "start", no_thread)
    gate = InterruptGate()
    with gate.woken_by_threads(), pytest.raises(RunFailed, match="too warm"):
        callback()
    assert went_on.wait(20), "nothing is raised in the thread"


def test_a_dropped_request_to_end_stays_one_where_the_system_has_no_further_thread(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Held:
        def __del__(self) -> None:
            gate.end_run(RunFailed("too warm"))

    def callback() -> None:
        held = Held()
        gate.arm()
        del held
        gate.end_run(RunFailed("too cold"))

    monkeypatch.setattr(threading.Timer, "start", no_thread)
    gate = InterruptGate()
    with gate.woken_by_threads(), pytest.raises(RunFailed, match="too warm"):
        callback()


def test_a_mission_that_is_stopped_where_python_drops_it_ends_all_the_same(execute: Execute) -> None:
    executed = ended(execute, DROPPED.format(during=f"{STOP}; time.sleep(60)"))
    assert [row["status"] for row in executed.table] == ["Done"]
    assert "the mission went on" not in executed.log("r_1")


def test_a_run_whose_deadline_passes_where_python_drops_exceptions_closes_what_it_opened(
    execute: Execute, monkeypatch: pytest.MonkeyPatch
) -> None:
    enforce_deadline_in("launch_mission", monkeypatch)
    mission = DROPPED.format(during="time.sleep(60)")
    executed = ended(execute, mission, event_deadline_in_s="1", grace_in_s="50")
    assert str(failure_of(executed)).startswith("launch_mission of config: the event took longer")
    assert "arm closed" in executed.log("r_1")


def test_the_hook_for_other_exceptions_that_python_drops_stays(
    execute: Execute, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "unraisablehook", lambda lost: sys.stdout.write(f"dropped: {lost.exc_value}\n"))
    mission = DROPPED.format(during="raise KeyError('of its own')").replace("time.sleep(3600)", "pass")
    executed = ended(execute, mission)
    assert [row["status"] for row in executed.table] == ["Done"]
    assert "dropped: 'of its own'" in executed.log("r_1")


def test_what_a_thread_raises_fails_the_run_and_ends_the_mission(execute: Execute) -> None:
    executed = ended(execute, "after(0.2, self.throw)\ntime.sleep(3600)")
    (failure,) = executed.journal("failure")
    assert failure["problem"].endswith("raised ValueError: the thread's own")
    assert failure["problem"].startswith("thread Thread-")
    assert "in throw" in failure["traceback"]
    assert "arm made safe" in executed.log("r_1")


@pytest.mark.parametrize("run_process", ["fork", "in_process"])
def test_an_error_whose_text_cannot_be_made_is_told_of_by_its_type_and_the_robot_is_made_safe(
    execute: Execute, run_process: str
) -> None:
    mission = "raise type('Odd', (Exception,), {'__str__': lambda self: self.never_set})()"
    executed = ended(execute, mission, run_process=run_process)
    failure = failure_of(executed)
    assert (failure.event, failure.owner) == ("launch_mission", "config")
    assert failure.problem == "Odd: (its text could not be made: AttributeError)"
    assert "arm made safe" in executed.log("r_1")


def test_what_a_thread_raises_while_things_are_closed_is_a_finding(execute: Execute) -> None:
    stop = "t = threading.Thread(target=self.throw); t.start(); t.join()"
    executed = ended(execute, stop=stop)
    assert [row["status"] for row in executed.table] == ["Done"]
    assert any("the thread's own" in finding["problem"] for finding in executed.journal("finding"))


#: Two runs in one process: a thread of the first one does something while the second one is executed.
LATE = """
run_process = RunProcess.IN_PROCESS
begun, told, thread = threading.Event(), threading.Event(), None
def launch_mission(self, context):
    if context.run_number == 2:
        self.begun.set()
        self.thread.join()
        return
    def late():
        self.begun.wait()
        {deed}
    RobotRunnerConfig.thread = threading.Thread(target=late, name="late", daemon=True)
    self.thread.start()
def populate_run_data(self, context): return {{"Energy": float(context.run_number)}}
"""
TWO_RUNS = TABLE.replace("[1]", "[1, 2]")


@pytest.mark.parametrize(
    ("deed", "said"),
    [
        ("1 / 0", "ZeroDivisionError: division by zero"),
        ("context.publish('Energy', 9.0)", "r_1 has ended, and this is lost: measure 'Energy'"),
        ("context.doubt('it was dark')", "r_1 has ended, and this is lost: it was dark"),
        ("context.fail('too warm')", "r_1 has ended, and this is lost: too warm"),
    ],
)
def test_a_thread_that_its_run_has_left_neither_fails_a_later_one_nor_changes_its_own(
    execute: Execute, deed: str, said: str
) -> None:
    executed = execute(LATE.format(deed=deed), head=HEAD, table=TWO_RUNS)
    assert [(row["status"], row["Energy"]) for row in executed.table] == [("Done", "1.0"), ("Done", "2.0")]
    (finding,) = [each for each in executed.journal("finding") if each["owner"].startswith("thread")]
    assert (finding["run"], finding["owner"]) == ("r_2", "thread late of an earlier run")
    assert said in finding["problem"]
    kinds = [each["kind"] for each in executed.journal() if each.get("run") == "r_1"]
    assert kinds[-1] == "attempt_finished"


def test_without_a_run_around_it_a_context_ends_the_callback_in_place(tmp_path: Path) -> None:
    context = make_context(tmp_path, robot=None)
    with pytest.raises(RunFailed, match="too warm"):
        context.fail("too warm")
    context.times.begin()
    with pytest.raises(MissionStopped, match="goal reached"):
        context.stop_mission("goal reached")


@pytest.mark.long
def test_the_example_of_the_page_drives_a_metre_and_stops(tmp_path: Path) -> None:
    page = (Path(__file__).parents[3] / "docs" / "stop-or-fail.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    config = tmp_path / "one_metre.py"
    config.write_text(block, encoding="utf-8")
    finished = execute_experiment(prepare_or_refuse(config, {}), SilentObserver())
    assert finished.done_count == 2
    (stopped, _) = read_journal(finished.folder / "journal.jsonl", kinds=["mission_stopped"])
    assert stopped["reason"] == "one metre was driven"


def test_the_window_ends_when_the_mission_is_stopped_whatever_comes_after() -> None:
    times = MissionTimes(SystemClock())
    with pytest.raises(PluginError):
        times.stop()
    times.begin()
    assert times.stop()
    ended = time.monotonic()
    assert not times.stop()
    time.sleep(0.01)
    times.end_window()
    times.end()
    assert not times.stop()
    window = times.window()
    assert window is not None
    assert window.end <= ended


def test_a_make_safe_whose_decorator_hides_that_nothing_is_executed_is_a_failure_that_says_so(execute: Execute) -> None:
    hidden = HEAD.replace(
        '    def make_safe(self, context): print("arm made safe")',
        "    def make_safe(self, context): return self._stop()\n    async def _stop(self): print('arm made safe')",
    )
    executed = execute(
        BODY.format(mission="1 / 0", start="pass", stop="pass", populate="pass"), head=hidden, table=TABLE
    )
    problems = [failure["problem"] for failure in executed.journal("failure")]
    assert any("make_safe returned a coroutine: its body was never executed" in problem for problem in problems)


@pytest.mark.parametrize("reason", ["''", "None"])
def test_a_mission_may_be_stopped_without_a_reason(execute: Execute, reason: str) -> None:
    executed = ended(execute, f"context.stop_mission({reason})")
    assert executed.finished.done_count == 1


#: What the system did is in files, as its callbacks cannot print.
TOUCHING = """
import sys
from pathlib import Path
from robot_runner import *
from robot_runner.plugins import System

HERE = Path(__file__).parent

class Full:
    def write(self, text): raise OSError(28, "No space left on device")
    def flush(self): pass

FULL = Full()

class Arm(System):
    measures = ()
    def stop_run(self, context): (HERE / "closed").touch()
    def make_safe(self, context): (HERE / "safe").touch()

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = Path("results")
    plugins = [Arm()]
"""


@pytest.mark.parametrize("run_process", ["fork", "in_process"])
@pytest.mark.parametrize("deed", ["sys.stderr = None", "sys.stderr.close()", "sys.stderr = FULL"])
def test_a_log_that_cannot_be_written_hides_no_failure_and_the_robot_is_made_safe(
    execute: Execute, tmp_path: Path, run_process: str, deed: str
) -> None:
    body = f"def launch_mission(self, context):\n    {deed}\n    raise ValueError('a bump')"
    executed = execute(body, head=TOUCHING, table=TABLE, run_process=run_process)
    assert executed.finished.failures == ("r_1: launch_mission of config: ValueError: a bump",)
    assert (tmp_path / "closed").exists()
    assert (tmp_path / "safe").exists()


@pytest.mark.parametrize("event", ["start_run", "launch_mission", "stop_measurement"])
def test_a_run_in_this_process_is_closed_and_made_safe_before_a_full_disk_ends_the_experiment(
    execute: Execute, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, event: str
) -> None:
    append = Journal.append

    def append_if_there_is_room(journal: Journal, kind: str, **fields: Any) -> None:
        if (tmp_path / "full").exists():
            raise StorageError("it cannot be written: no space is left", where="journal", fix="Make room.")
        append(journal, kind, **fields)

    monkeypatch.setattr(Journal, "append", append_if_there_is_room)
    body = f"""
    def {event}(self, context): (HERE / "full").touch()
    def populate_run_data(self, context): (HERE / "populated").touch()
    def after_experiment(self): (HERE / "full").unlink()
    """
    with pytest.raises(StorageError, match="no space is left"):
        execute(body, head=TOUCHING, table=TABLE, run_process="in_process")
    assert (tmp_path / "closed").exists()
    assert (tmp_path / "safe").exists()
    assert not (tmp_path / "populated").exists()


def test_the_process_of_a_run_ends_also_where_a_callback_took_its_streams_away() -> None:
    child = os.fork()
    if child == 0:
        try:
            sys.stdout = None  # type: ignore[assignment]
            leave_after(lambda: None, lambda _kind, _fields: None)
        finally:
            os._exit(99)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


FORKING = """
import multiprocessing, time
from robot_runner import *

def asleep(telling):
    telling.send("begun")
    time.sleep(60)

def forked():
    fork = multiprocessing.get_context("fork")
    told, telling = fork.Pipe()
    process = fork.Process(target=asleep, args=(telling,))
    process.start()
    told.recv()  # until then, a signal meets what the process has inherited
    return process

def ended(process, by=lambda process: process.terminate()):
    by(process)
    process.join(20)
    code = process.exitcode
    process.kill()
    print("ended by", code, flush=True)
    assert code == -15, code

class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "forking"
    def before_experiment(self, context): self.server = forked()
    def before_run(self, context): ended(forked())
    def start_run(self, context): self.helper = forked()
    def launch_mission(self, context): ended(forked())
    def stop_run(self, context):
        ended(self.helper)
        ended(forked())
    def after_experiment(self, context): ended(self.server)
    def create_run_table(self): return RunTableModel([Factor("A", [1])])
"""


@pytest.mark.long
def test_a_process_that_a_callback_forks_ends_by_a_signal_as_any_other(tmp_path: Path) -> None:
    config = tmp_path / "forking.py"
    config.write_text(FORKING, encoding="utf-8")
    finished = execute_experiment(prepare_or_refuse(config), SilentObserver())
    assert finished.done_count == 1, finished.failures
    assert finished.findings == ()
    log = (tmp_path / "experiments" / "forking" / "runs" / "r_1" / "log.txt").read_text(encoding="utf-8")
    assert log == "ended by -15\n" * 3


class OfAStranger:
    def __dir__(self):
        raise OSError


@pytest.mark.parametrize(
    ("missing", "meant"),
    [
        (lambda context: context.run_variation, "combination"),
        (lambda context: context.execute_run, "combination"),
        (lambda context: context.run_dir, "run_folder"),
        (lambda context: context.publsh, "publish"),
        (lambda context: context.clock.sleeep, "sleep"),
        (lambda context: context.sleep, "clock.sleep"),
        (lambda context: context.of_no_such_kind, None),
        (lambda _: OfAStranger().anything, None),
        (lambda _: no_such_name, None),  # noqa: F821 - that is the case
    ],
)
def test_the_name_that_may_be_meant_is_told_of_a_callback_that_fails(
    tmp_path: Path, missing: Callable[[Any], object], meant: str | None
) -> None:
    with pytest.raises((AttributeError, NameError)) as error:
        missing(make_context(tmp_path))
    problem = failure_fields(error.value)["problem"]
    assert problem.partition(" (did you mean ")[2] == (f"{meant!r}?)" if meant else "")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_processes_of_the_experiment_itself_live_on_where_those_of_callbacks_end(number: int) -> None:
    def ended(fork: Callable[[], int]) -> int:
        (begun, begin), (told, tell) = os.pipe(), os.pipe()
        pid = fork()
        if pid == 0:
            with suppress(BaseException):
                os.write(begin, b".")
                os.read(told, 1)  # after the signal
                os._exit(7)
            os._exit(1)
        os.read(begun, 1)
        os.kill(pid, number)
        os.write(tell, b".")
        for each in (begun, begin, told, tell):
            os.close(each)
        return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])

    with stop_signals_handled(lambda _number, _frame: None):
        assert ended(forked) == 7  # a keeper, or who stops a robot: Ctrl-C reaches all of a terminal's processes
        assert ended(os.fork) == (1 if number == signal.SIGINT else -number)


def test_a_stop_signal_that_was_blocked_when_the_program_began_is_heard() -> None:
    taken: list[int] = []
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})  # as who starts us may have it
    try:
        with stop_signals_handled(lambda number, _frame: taken.append(number)):
            os.kill(os.getpid(), signal.SIGTERM)
            assert taken == [signal.SIGTERM]
        assert signal.SIGTERM in signal.pthread_sigmask(signal.SIG_BLOCK, ())
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def test_a_thread_ends_a_mission_also_where_the_signal_that_tells_was_blocked_when_the_program_began() -> None:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGURG})
    gate, begun = InterruptGate(), threading.Event()

    def end() -> None:
        begun.wait()
        gate.end_run(RunFailed("too hot"))

    def mission() -> None:
        gate.arm(is_mission=True)
        begun.set()
        time.sleep(PATIENCE)

    try:
        threading.Thread(target=end, daemon=True).start()
        with gate.woken_by_threads(), pytest.raises(RunFailed, match="too hot"):
            mission()
        assert signal.SIGURG in signal.pthread_sigmask(signal.SIG_BLOCK, ())
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def test_a_request_to_stop_that_came_right_before_a_callback_ends_it_as_it_begins() -> None:
    gate = InterruptGate()
    with Interruption() as interruption:
        interruption.request()
        with interruption.passed_on(gate), pytest.raises(RunInterrupted):
            gate.arm()
