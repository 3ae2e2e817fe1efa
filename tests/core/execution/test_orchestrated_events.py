"""The events of the orchestrating process: their deadlines, what `continue` is told and yields, and how it ended."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
from tests.core.execution.conftest import execute_in
from tests.event_deadline import enforce_deadline_in
from tests.long_cases import soak_but

from robot_runner.core.errors import ExecutionError
from robot_runner.core.events.manager import EventManager, OwnerKind, RobotRunnerEvents
from robot_runner.core.execution.notices import OutcomeAmended
from robot_runner.core.execution.orchestrator_events import DeadlinePassed, EventDeadline
from robot_runner.core.storage import journal

if TYPE_CHECKING:
    from pathlib import Path

Execute = Callable[..., Any]

PUBLISHING = """
operation_type = OperationType.SEMI
quality_columns = True
def before_experiment(self): return True
def continue_experiment(self, context):
    context.publish("Energy", 4.5)
    context.doubt("read from a sticker", measures=["Energy"])
    return True
"""
TWO_RUNS = """\
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video", "Network"])], data_columns=["Energy"])
"""


def test_what_continue_publishes_is_a_measure_of_the_run_that_is_over(execute: Execute) -> None:
    executed = execute(PUBLISHING, table=TWO_RUNS)
    assert [row["Energy"] for row in executed.table] == ["4.5", ""]
    assert executed.table[0]["Energy.quality"] == "doubtful: read from a sticker"
    (amended,) = [each for each in executed.notices if isinstance(each, OutcomeAmended)]
    assert (amended.run_id, amended.outcome.measures["Energy"].value) == ("r_1", 4.5)
    findings = [str(finding) for finding in executed.finished.findings]
    assert not any("r_1, config: Energy has no value" in finding for finding in findings)
    assert any("r_2, config: Energy has no value" in finding for finding in findings)
    assert sum("r_1, config: read from a sticker" in finding for finding in findings) == 1
    table = executed.folder / "run_table.csv"
    written = table.read_text(encoding="utf-8")
    table.unlink()
    assert execute(PUBLISHING, table=TWO_RUNS).finished.done_count == 2
    assert table.read_text(encoding="utf-8") == written, "the journal has it, and the time of the event"


def test_a_doubt_from_the_run_is_about_what_continue_publishes_later(execute: Execute) -> None:
    body = PUBLISHING.replace('    context.doubt("read from a sticker", measures=["Energy"])\n', "")
    body += "def stop_run(self, context): context.doubt('it was dark', measures=['Energy'])\n"
    executed = execute(body, table=TWO_RUNS)
    assert [row["Energy.quality"] for row in executed.table] == ["doubtful: it was dark", "missing: it was dark"]


def test_the_time_of_a_continue_that_publishes_nothing_is_in_the_journal_as_well(execute: Execute) -> None:
    body = PUBLISHING[: PUBLISHING.index("    context.publish")] + "    return True\n"
    executed = execute(body, table=TWO_RUNS, run_process="in_process")
    table = executed.folder / "run_table.csv"
    written = table.read_text(encoding="utf-8")
    assert executed.table[0]["continue_at"]
    table.unlink()
    assert execute(body, table=TWO_RUNS, run_process="in_process").finished.done_count == 2
    assert table.read_text(encoding="utf-8") == written


@pytest.mark.parametrize(("publishes", "more"), [("pass", 0), ("context.publish('Energy', 4.5)", 1)])
def test_what_continue_publishes_is_flushed_to_the_disk_and_its_time_alone_with_the_next_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, publishes: str, more: int
) -> None:
    flushed: list[int] = []
    monkeypatch.setattr(journal, "fsync_file", flushed.append)

    def count(name: str, body: str) -> int:
        flushed.clear()
        folder = tmp_path / name
        folder.mkdir()
        execute_in(folder, f"def before_experiment(self): return True\n{body}", table=TWO_RUNS)
        return len(flushed)

    continued = f"operation_type = OperationType.SEMI\ndef continue_experiment(self, context):\n    {publishes}\n"
    assert count("asked", f"{continued}    return True\n") == count("not_asked", "") + more


def test_what_continue_publishes_by_a_wrong_name_ends_the_experiment_and_is_kept(execute: Execute) -> None:
    with pytest.raises(ExecutionError, match="measure 'Enrgy' was not declared"):
        execute(PUBLISHING.replace('"Energy", 4.5', '"Enrgy", 4.5'), table=TWO_RUNS)


def test_continue_is_told_of_the_run_that_is_over_and_of_the_next(execute: Execute, tmp_path: Path) -> None:
    executed = execute(
        """
        operation_type = OperationType.SEMI
        def before_experiment(self): return True
        def continue_experiment(self, context):
            following = context.next_run
            with (Path(__file__).parent / "told.txt").open("a") as file:
                task = following.combination["Task"]
                print(context.run_id, following.run_id, following.run_number, task, following.repetition, file=file)
            return True
        """
    )
    told = (tmp_path / "told.txt").read_text(encoding="utf-8").splitlines()
    assert told == ["r_1 r_2 2 Network 1", "r_2 r_3 3 Video 2", "r_3 r_4 4 Network 2"]
    readers = {end["run"]: end["readers"] for end in executed.journal("attempt_finished")}
    assert list(readers.values()) == [{}, {"Task": ["config"]}, {"Task": ["config"]}, {"Task": ["config"]}]


@pytest.mark.parametrize("event", ["before_experiment", "after_experiment"])
def test_an_event_of_the_experiment_that_takes_too_long_ends_it_and_is_named(
    execute: Execute, monkeypatch: pytest.MonkeyPatch, event: str
) -> None:
    enforce_deadline_in(event, monkeypatch)
    started = time.monotonic()
    with pytest.raises(ExecutionError) as ended:
        execute(f"def {event}(self): __import__('time').sleep(60)", event_deadline_in_s=0.3)
    assert time.monotonic() - started < 30
    assert ended.value.where == f"{event} of config"
    assert ended.value.problem == "the event took longer than event_deadline_in_s = 0.3 s"


def test_before_run_that_takes_too_long_fails_its_run_and_the_others_are_executed(execute: Execute) -> None:
    executed = execute(
        """
        def before_run(self, context):
            if context.run_id == "r_2":
                import signal
                left, again = signal.getitimer(signal.ITIMER_REAL)
                assert 0 < left <= 300
                signal.setitimer(signal.ITIMER_REAL, 0.4, again)  # as if so much of them had gone by
            while context.run_id == "r_2":
                try: context.clock.sleep(0.01)
                except Exception: pass  # as a callback does that looks again and again
        """,
        event_deadline_in_s=300,
    )
    assert [row["status"] for row in executed.table] == ["Done", "Failed", "Done", "Done"]
    reason = "before_run of config: the event took longer than event_deadline_in_s = 300 s"
    assert executed.finished.failures == (f"r_2: {reason}",)


def test_continue_that_takes_too_long_ends_the_experiment_and_is_named(
    execute: Execute, monkeypatch: pytest.MonkeyPatch
) -> None:
    enforce_deadline_in("continue", monkeypatch)
    with pytest.raises(ExecutionError) as ended:
        execute(
            """
            operation_type = OperationType.SEMI
            def before_experiment(self): return True
            def continue_experiment(self, context): input_that_never_comes = __import__("threading").Event().wait()
            """,
            event_deadline_in_s=0.3,
        )
    assert ended.value.where == "continue of config"


def test_a_callback_that_swallows_everything_is_ended_after_the_grace(
    execute: Execute, monkeypatch: pytest.MonkeyPatch
) -> None:
    enforce_deadline_in("before_run", monkeypatch)
    executed = execute(
        """
        caught = 0
        def before_run(self, context):
            while self.caught < 1:
                try: context.clock.sleep(60)
                except BaseException: self.caught += 1
            context.clock.sleep(60)
        """,
        event_deadline_in_s=0.2,
        grace_in_s=1.0,
        on_failure="stop",
    )
    assert "event_deadline_in_s" in executed.finished.failures[0]


@pytest.mark.long
def test_a_callback_that_hangs_in_c_ends_the_orchestrator_and_the_experiment_resumes(
    write_config: Callable[..., Path], program: str, tmp_path: Path
) -> None:
    hanging = """
    event_deadline_in_s = 300
    grace_in_s = 0.1
    hangs_next = False
    def before_experiment(self):  # only what hangs has a deadline that a busy machine may miss
        from robot_runner.core.execution.orchestrator_events import EventDeadline
        def begin(deadline, what, seconds, grace, begin=EventDeadline.__init__):
            is_short = self.hangs_next and what.startswith("before_run")
            begin(deadline, what, 0.3 if is_short else seconds, grace)
        EventDeadline.__init__ = begin
    def before_run(self, context):
        import hashlib
        is_mended = (Path(__file__).parent / "mended").exists()
        self.hangs_next = context.run_id == "r_1" and not is_mended
        if context.run_id == "r_2" and not is_mended:
            hashlib.pbkdf2_hmac("sha512", b"", b"", 1_000_000_000)
    """
    write_config(hanging)
    killed = subprocess.run(
        [program, "run", "config.py"], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=60
    )
    assert killed.returncode == -9
    assert "error: before_run of config: the event took longer than event_deadline_in_s = 0.3 s" in killed.stderr
    (tmp_path / "mended").touch()
    resumed = subprocess.run(
        [program, "run", "config.py"], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=60
    )
    assert (resumed.returncode, "3 runs" not in resumed.stdout) == (0, True), resumed.stderr
    assert "1 of them done before" in resumed.stdout


def test_before_and_after_experiment_that_both_raise_are_both_told(execute: Execute) -> None:
    with pytest.raises(ExecutionError) as ended:
        execute(
            """
            def before_experiment(self): raise ValueError("no robot")
            def after_experiment(self): raise ValueError("no lamp either")
            """
        )
    assert [(each.where, each.problem) for each in ended.value.findings] == [
        ("before_experiment of config", "ValueError: no robot (config.py:9)"),
        ("after_experiment of config", "ValueError: no lamp either (config.py:10)"),
    ]


ENDING = """
def after_experiment(self, context):
    import json
    told = context.ended
    facts = {name: getattr(told, name) for name in ("done", "failed", "todo", "is_interrupted", "failure")}
    facts |= {"is_complete": told.is_complete, "failures": list(told.failures), "findings": len(told.findings)}
    (Path(__file__).parent / "ended.json").write_text(json.dumps(facts))
"""


def test_after_experiment_is_told_how_it_ended(execute: Execute, tmp_path: Path) -> None:
    execute(f"{ENDING}\ndef launch_mission(self, context): assert context.run_id != 'r_3', 'the lamp is off'")
    told = json.loads((tmp_path / "ended.json").read_text(encoding="utf-8"))
    findings = told.pop("findings")
    assert findings > 0
    assert told == {
        "done": 3,
        "failed": 1,
        "todo": 0,
        "is_interrupted": False,
        "is_complete": False,
        "failure": "",
        "failures": ["r_3: launch_mission of config: AssertionError: the lamp is off"],
    }


def test_after_experiment_is_told_what_ended_it_before_its_time(execute: Execute, tmp_path: Path) -> None:
    with pytest.raises(ExecutionError):
        execute(f"{ENDING}\ndef before_experiment(self): raise ValueError('no robot')")
    told = json.loads((tmp_path / "ended.json").read_text(encoding="utf-8"))
    assert "before_experiment of config: ValueError: no robot" in told["failure"]
    assert (told["done"], told["todo"]) == (0, 4)


TELLING = """
quality_columns = True
def before_run(self, context):
    token = __import__("os").environ["LAB_TOKEN"]
    context.doubt(f"the meter took {token}", measures=["Energy"])
    context.warn(f"the plug took {token}")
def launch_mission(self, context):
    token = __import__("os").environ["LAB_TOKEN"]
    context.doubt(f"the arm took {token}", measures=["Energy"])
    context.fail(f"refused {token}")
"""


@pytest.mark.parametrize("run_process", ["fork", "in_process"])
def test_what_the_environment_keeps_secret_is_hidden_in_whichever_process_a_callback_tells_it(
    execute: Execute, monkeypatch: pytest.MonkeyPatch, run_process: str
) -> None:
    monkeypatch.setenv("LAB_TOKEN", "swordfish-77")
    executed = execute(TELLING, table=TWO_RUNS.replace(', "Network"', ""), run_process=run_process)
    kept = [each for each in executed.folder.rglob("*") if each.is_file()]
    assert [each.name for each in kept if b"swordfish" in each.read_bytes()] == []
    told = [*map(str, executed.finished.findings), *executed.finished.failures]
    assert [each.count("REDACTED") for each in told] == [1, 1, 1, 1], told
    assert "swordfish" not in str(executed.notices)


HANDING_ON = """
operation_type = OperationType.SEMI
def before_experiment(self): return True
def before_run(self, context):
    context.share(door="open", steps={"a": [1, None]}, chart="x" * 200_000)  # longer than an argument may be
    context.publish("Energy", 2.5)
def populate_run_data(self, context):
    shared = context.plugin_data["config"]
    assert (shared["door"], shared["steps"], len(shared["chart"])) == ("open", {"a": [1, None]}, 200_000)
    return {"Energy": context.measures["Energy"] * context.run_number}
def continue_experiment(self, context):
    context.warn(f"Energy was {context.measures['Energy']}")
    return True
"""


@pytest.mark.parametrize("run_process", soak_but({"fork", "in_process"}, ["fork", "spawn", "in_process"]))
def test_what_before_run_shares_and_publishes_is_there_in_the_run_and_its_measures_in_continue(
    execute: Execute, run_process: str
) -> None:
    executed = execute(HANDING_ON, table=TWO_RUNS, run_process=run_process)
    assert [row["Energy"] for row in executed.table] == ["2.5", "5.0"], executed.finished.failures
    assert any("Energy was 2.5" in str(each) for each in executed.finished.findings)


def test_a_deadline_that_is_longer_than_the_system_can_wait_is_none() -> None:
    with EventDeadline("an event", 1e300, 1e300):
        pass


def test_a_watcher_that_fails_does_not_go_on_as_the_experiment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(EventDeadline, "_end_orchestrator_unless_told", lambda *_: 1 / 0)
    process = os.getpid()
    try:
        with EventDeadline("an event", 60.0, 1.0):
            pass
    finally:
        if os.getpid() != process:
            os.kill(process, signal.SIGKILL)


def test_a_deadline_passes_also_where_its_signal_was_blocked_when_the_program_began() -> None:
    events, event = EventManager(), RobotRunnerEvents.BEFORE_EXPERIMENT
    events.subscribe(event, lambda: time.sleep(60.0), owner="config", kind=OwnerKind.CONFIG)
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})
    try:
        with EventDeadline("an event", 0.01, 1.0):
            emission = events.emit(event, lambda _owner: None)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    assert [type(failure.error) for failure in emission.failures] == [DeadlinePassed]


def test_a_request_to_stop_of_a_second_terminal_is_recorded_also_where_it_ends_a_callback(execute: Execute) -> None:
    body = """
def before_run(self, context):
    (context.experiment_folder / ".stop").touch()
    context.clock.sleep(60)
"""
    executed = execute(body)
    assert executed.finished.interrupted
    assert len(executed.journal("stop_requested")) == 1


def test_an_error_in_evaluated_code_fails_its_run_and_no_more(execute: Execute) -> None:
    executed = execute("def before_run(self, context):\n    if context.run_number == 1: eval('1/0', {})")
    (failure,) = executed.finished.failures
    assert failure == "r_1: before_run of config: ZeroDivisionError: division by zero (config.py:10)"
    assert executed.finished.done_count == 3


def test_an_error_whose_text_ends_the_program_fails_its_run_and_no_more(execute: Execute) -> None:
    odd = "type('Odd', (Exception,), {'__str__': lambda self: exit(3)})()"
    executed = execute(f"def before_run(self, context):\n    if context.run_number == 1: raise {odd}")
    (failure,) = executed.finished.failures
    assert failure == "r_1: before_run of config: Odd: (its text could not be made: SystemExit) (config.py:10)"
    assert executed.finished.done_count == 3
