"""The orchestrator is told to end, or dies: the run closes what it opened, and the experiment resumes."""

from __future__ import annotations

import contextlib
import os
import pty
import signal
import subprocess
import sys
import textwrap
import time
import uuid
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from tests.process.conftest import MARK, PATIENCE, Experiment, wait_until
from tests.processor_wait import OWN_WAITS, ProcessorWait

from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.execution.notices import SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.storage.journal import read_journal

Start = Callable[..., Any]

#: The second run moves until it is told to stop, and says when it was.
MOVING = f"""
grace_in_s = 5
def launch_mission(self, context):
    import time
    if context.run_id == "r_2" and not self.flag("stopped").exists():
        self.flag("moving").write_text("")
        time.sleep(60)
def stop_run(self, context):
    import json, time
    if self.flag("moving").exists() and not self.flag("stopped").exists():
        self.flag("stopped.new").write_text(json.dumps([time.time(), {OWN_WAITS}]))
        self.flag("stopped.new").rename(self.flag("stopped"))
def populate_run_data(self, context): return {{"Energy": 1.5}}
def flag(self, name): return Path(__file__).parent / name
"""


def resumes(experiment: Any) -> bool:
    """Execute what is left in this process, and return whether what was done is as it was."""
    done = done_rows(experiment)
    assert execute_experiment(prepare_or_refuse(experiment.config), SilentObserver()).done_count == 4
    assert experiment.statuses == ["Done"] * 4
    return keeps(experiment, done)


def done_rows(experiment: Any) -> list[dict[str, str]]:
    return [row for row in experiment.table if row["status"] == "Done"]


def keeps(experiment: Any, done: list[dict[str, str]]) -> bool:
    return [row for row in experiment.table if row["run_id"] in {row["run_id"] for row in done}] == done


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP], ids=lambda number: number.name)
def test_told_to_end_the_run_is_closed_and_marked_and_the_experiment_resumes(
    start: Start, number: signal.Signals
) -> None:
    experiment = start(MOVING)
    experiment.wait_for("moving")
    wait = ProcessorWait(experiment.processes())
    sent = experiment.send(number)
    assert experiment.stops_within_a_second(sent, wait)
    assert experiment.end() == 130
    assert experiment.statuses == ["Done", "-", "-", "-"]
    assert experiment.nobody_is_left()
    assert resumes(experiment)


@pytest.mark.long
def test_a_second_ctrl_c_ends_at_once(start: Start) -> None:
    experiment = start(
        MOVING.replace("grace_in_s = 5", "grace_in_s = 90").replace(
            "def stop_run(self, context):", "def stop_run(self, context):\n    self.hang()"
        )
        + "def hang(self):\n    import time\n    self.flag('closing').write_text('')\n    time.sleep(90)\n"
    )
    experiment.wait_for("closing")
    experiment.send(signal.SIGINT)
    # Two that come before the first is noticed are one.
    assert any("Ctrl-C again kills it at once" in line for line in experiment.process.stdout)
    wait = ProcessorWait([os.getpid(), *experiment.processes()])
    sent = experiment.send(signal.SIGINT)
    wait_until(lambda: wait.look() or experiment.process.poll() is not None, "it has ended")
    assert time.time() - sent - wait.seconds < 3.0
    assert experiment.end() == 130
    assert experiment.nobody_is_left()


@pytest.mark.long
def test_ctrl_c_ends_a_callback_of_the_orchestrator(start: Start) -> None:
    experiment = start(
        """
        def before_run(self, context):
            import time
            (Path(__file__).parent / "waiting").write_text("")
            # Not one long sleep: CPython notices a signal that comes right before a sleep when that is over.
            for _ in range(120): time.sleep(1)
        """
    )
    experiment.wait_for("waiting")
    experiment.send(signal.SIGINT)
    assert experiment.end() == 130
    assert experiment.statuses == ["-"] * 4


def test_killed_the_run_is_closed_within_a_second_and_the_experiment_resumes_and_keeps_the_log(start: Start) -> None:
    printing = "    import time; print('moving off', flush=True)\n    if context"
    experiment = start(MOVING.replace("    import time\n    if context", printing))
    experiment.wait_for("moving")
    wait = ProcessorWait(experiment.processes())
    sent = experiment.send(signal.SIGKILL)
    assert experiment.stops_within_a_second(sent, wait)
    experiment.end()
    assert experiment.nobody_is_left()
    assert (experiment.folder / ".lock").read_text(), "the lock of a dead process holds nobody up"
    done = done_rows(experiment)
    again = start(config=experiment.config)
    assert again.end() == 0, again.output
    assert again.statuses == ["Done"] * 4
    assert keeps(again, done)
    assert again.nobody_is_left()
    assert "moving off" in (experiment.folder / "earlier_attempts" / "r_2" / "1" / "log.txt").read_text()


@pytest.mark.long
def test_killed_a_run_is_closed_whose_config_has_a_broken_pipe_end_its_program(start: Start) -> None:
    experiment = start(f"import signal; signal.signal(signal.SIGPIPE, signal.SIG_DFL)\n{MOVING}")
    experiment.wait_for("moving")
    experiment.send(signal.SIGKILL)
    experiment.wait_for("stopped")
    experiment.end()
    assert experiment.nobody_is_left()


@pytest.mark.long
def test_killed_while_the_run_hangs_in_c_nobody_is_left(start: Start) -> None:
    experiment = start(
        """
        grace_in_s = 0.5
        def launch_mission(self, context):
            import ctypes
            (Path(__file__).parent / "hanging").write_text("")
            ctypes.PyDLL(None).sleep(60)
        """
    )
    experiment.wait_for("hanging")
    experiment.send(signal.SIGKILL)
    experiment.end()
    assert experiment.nobody_is_left()


@contextlib.contextmanager
def at_terminal(config: Any, *wrapper: str) -> Iterator[tuple[Experiment, int]]:
    """Execute an experiment at a terminal of its own; yields it, and the end that is closed when the terminal is."""
    master, terminal = pty.openpty()
    mark = uuid.uuid4().hex
    process = subprocess.Popen(
        [*wrapper, sys.executable, "-m", "robot_runner", "run", str(config)],
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
        cwd=config.parent,
        start_new_session=True,
        env={**os.environ, MARK: mark},
        # The first terminal that a session leader opens becomes its controlling one: closing it sends SIGHUP.
        preexec_fn=lambda: os.close(os.open(os.ttyname(0), os.O_RDWR)),  # noqa: PLW1509 - pytest has no threads here
    )
    os.close(terminal)
    os.set_blocking(master, False)

    def show() -> None:  # as a terminal does; one that nobody reads would hold the program up
        with contextlib.suppress(OSError):  # there is nothing, or with `nohup` nobody who writes to it
            os.read(master, 65536)

    experiment = Experiment(config, process, mark)
    try:
        experiment.wait_for("moving", meanwhile=show)
        yield experiment, master
    finally:
        process.kill()
        process.wait(timeout=PATIENCE)


@pytest.mark.long
def test_a_closed_terminal_ends_the_experiment_cleanly(write_config: Any) -> None:
    config = write_config(MOVING)
    with at_terminal(config) as (experiment, terminal):
        wait = ProcessorWait(experiment.processes())
        closed = time.time()
        os.close(terminal)
        assert experiment.stops_within_a_second(closed, wait)
        experiment.process.wait(timeout=PATIENCE)
    assert resumes(experiment)


@pytest.mark.long
def test_with_nohup_a_closed_terminal_ends_nothing(write_config: Any) -> None:
    with at_terminal(write_config(MOVING), "nohup") as (experiment, terminal):
        os.close(terminal)
        time.sleep(1.0)  # the request of a terminal that is closed comes twice in a row
        assert experiment.process.poll() is None
        experiment.send(signal.SIGTERM)
        assert experiment.process.wait(timeout=PATIENCE) == 130


@pytest.mark.long
def test_a_second_orchestrator_is_refused_and_told_who_holds_the_experiment(start: Start) -> None:
    experiment = start(MOVING)
    experiment.wait_for("moving")
    second = start(config=experiment.config)
    assert second.end() == 2
    assert f"process {experiment.process.pid}" in second.output
    experiment.send(signal.SIGTERM)
    assert experiment.end() == 130


@pytest.mark.long
def test_a_killed_keeper_fails_its_attempt_and_the_run_is_closed_and_the_experiment_goes_on(start: Start) -> None:
    experiment = start(
        """
        def launch_mission(self, context):
            import os, signal, time
            if context.run_id in {"r_1", "r_3"}:
                context.share(noted="before the keeper was killed")
                os.kill(os.getppid(), signal.SIGKILL)
                time.sleep(60)
        def stop_run(self, context):
            for number in range(20_000): context.share(number=number)  # more than the pipe takes unless it is read
            (Path(__file__).parent / f"closed {context.run_id}").touch()
        """
    )
    assert experiment.end() == 1, experiment.output
    assert experiment.statuses == ["Failed", "Done", "Failed", "Done"]
    assert "r_1, r_3: launch_mission of config: the run's keeper was killed by SIGKILL" in experiment.output
    assert experiment.wait_for("closed r_1")
    assert experiment.wait_for("closed r_3")
    assert (experiment.folder / "journal.jsonl").read_text().count("before the keeper was killed") == 2
    assert experiment.nobody_is_left()


@pytest.mark.long
def test_a_killed_keeper_whose_run_hangs_in_c_costs_the_attempt_and_nobody_is_left(start: Start) -> None:
    experiment = start(
        """
        grace_in_s = 0.5
        def launch_mission(self, context):
            import ctypes, os, signal
            if context.run_id == "r_2":
                os.kill(os.getppid(), signal.SIGKILL)
                ctypes.PyDLL(None).sleep(60)
        """
    )
    assert experiment.end() == 1, experiment.output
    assert experiment.statuses == ["Done", "Failed", "Done", "Done"]
    assert "the run's keeper was killed by SIGKILL" in experiment.output
    assert experiment.nobody_is_left()


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells a process that its parent died")
def test_killed_together_with_the_keeper_the_run_is_closed_within_a_second_and_ends(start: Start) -> None:
    experiment = start(
        MOVING.replace('        self.flag("moving")', '        self.note_keeper()\n        self.flag("moving")')
        + """
def note_keeper(self):
    import os
    self.flag("keeper").write_text(str(os.getppid()))
"""
    )
    experiment.wait_for("moving")
    keeper = int((experiment.config.parent / "keeper").read_text())
    wait = ProcessorWait(experiment.processes())
    os.kill(experiment.process.pid, signal.SIGSTOP)  # so that neither has the time to do anything about the other
    os.kill(keeper, signal.SIGSTOP)
    sent = experiment.send(signal.SIGKILL)
    os.kill(keeper, signal.SIGKILL)
    assert experiment.stops_within_a_second(sent, wait)
    experiment.end()
    assert experiment.nobody_is_left()
    assert resumes(experiment)


SUSPENDED = """
def launch_mission(self, context):
    if context.run_id != "r_2": return
    self.flag("moving").touch()
    while not self.flag("suspended").exists(): context.clock.sleep(0.01)
    for number in range(self.shared): context.share(number=number, way="x" * 150)
    self.flag("arrived").touch()
def flag(self, name): return Path(__file__).parent / name
"""


@pytest.mark.long
@pytest.mark.parametrize(
    ("settings", "shared", "seconds"),
    [("shared = 9000", 9000, 0.0), ("shared, run_deadline_in_s = 30, 10", 30, 10.5)],
    ids=["more than a pipe takes", "for longer than the deadline"],
)
def test_a_mission_goes_on_while_its_orchestrator_is_suspended_and_what_it_said_is_kept(
    start: Start, settings: str, shared: int, seconds: float
) -> None:
    experiment = start(settings + SUSPENDED)
    begun = experiment.wait_for("moving").stat().st_mtime
    experiment.send(signal.SIGSTOP)
    (experiment.config.parent / "suspended").touch()
    experiment.wait_for("arrived")
    time.sleep(max(0.0, begun + seconds - time.time()))
    experiment.send(signal.SIGCONT)
    assert experiment.end() == 0, experiment.output
    assert experiment.statuses == ["Done"] * 4
    records = read_journal(experiment.folder / "journal.jsonl", kinds={"shared"})
    assert [each["values"]["number"] for each in records] == list(range(shared))


@pytest.mark.long
def test_a_keeper_that_does_not_answer_is_given_up_and_its_run_is_ended(start: Start) -> None:
    experiment = start(
        """
        event_deadline_in_s = 1
        grace_in_s = 0.5
        def before_experiment(self, context):
            from robot_runner.core.execution import local_places
            local_places._KEEPER_MARGIN = 0.5
            def in_the_mission(self, deadlines=local_places._Supervision._deadlines):
                return deadlines(self) if self._builder.event == "launch_mission" else (None, None)
            local_places._Supervision._deadlines = in_the_mission  # all else may take longer on a busy machine
        def launch_mission(self, context):
            import os, signal, time
            if context.run_id == "r_2":
                os.kill(os.getppid(), signal.SIGSTOP)
                time.sleep(60)
        """
    )
    assert experiment.end() == 1, experiment.output
    assert experiment.statuses == ["Done", "Failed", "Done", "Done"]
    assert "took longer than event_deadline_in_s = 1 s" in experiment.output
    assert experiment.nobody_is_left()


@pytest.mark.long
def test_there_is_one_keeper_and_one_run_and_between_two_runs_there_is_neither(start: Start) -> None:
    experiment = start(
        """
        time_between_runs_in_ms = 200
        def before_run(self, context): self.note(f"before {context.run_id}")
        def launch_mission(self, context): self.note(f"in {context.run_id}")
        def note(self, when):
            import os
            mark = os.environb[b"ROBOT_RUNNER_TEST_MARK"]
            count = 0
            for path in Path("/proc").glob("[0-9]*/environ"):
                try: count += mark in path.read_bytes()
                except OSError: pass
            with (Path(__file__).parent / "counts").open("a") as file: print(when, count, file=file)
        """
    )
    assert experiment.end() == 0, experiment.output
    lines = experiment.text_of("counts").splitlines()
    assert lines == [line for run in range(1, 5) for line in (f"before r_{run} 1", f"in r_{run} 3")]


@pytest.mark.long
def test_a_stop_signal_that_was_sent_to_the_keeper_ends_nothing(start: Start) -> None:
    experiment = start(
        """
        def launch_mission(self, context):
            import os, signal, time
            for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP): os.kill(os.getppid(), number)
            time.sleep(0.2)
        """
    )
    assert experiment.end() == 0, experiment.output
    assert experiment.statuses == ["Done"] * 4


#: An orphan as a daemon makes it: forked twice, with a session of its own, so that no process group reaches it.
ORPHAN = """
def orphan(self):
    import os, subprocess
    if (pid := os.fork()) == 0:
        os.setsid()
        program = subprocess.Popen(["sleep", "600"], start_new_session=True)
        with (Path(__file__).parent / "orphans").open("a") as file: print(program.pid, file=file)
        os._exit(0)
    os.waitpid(pid, 0)
"""


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="only Linux hands orphans to a process that asks for them")
def test_an_orphan_with_a_session_of_its_own_is_ended_with_its_run(start: Start) -> None:
    experiment = start(
        """
        def launch_mission(self, context): self.orphan()
        def before_run(self, context):
            import os
            orphans = Path(__file__).parent / "orphans"
            for pid in orphans.read_text().split() if orphans.exists() else []:
                assert not Path(f"/proc/{pid}").exists(), f"{pid} outlives its run"
        """
        + textwrap.indent(ORPHAN, "        ")
    )
    assert experiment.end() == 0, experiment.output
    assert len(experiment.text_of("orphans").split()) == 4
    assert experiment.nobody_is_left()


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="only Linux hands orphans to a process that asks for them")
def test_killed_the_orphans_of_the_run_are_ended_as_well(start: Start) -> None:
    moving = MOVING.replace('        self.flag("moving")', '        self.orphan()\n        self.flag("moving")')
    experiment = start(moving + ORPHAN)
    experiment.wait_for("moving")
    experiment.send(signal.SIGKILL)
    experiment.end()
    assert experiment.text_of("orphans")
    assert experiment.nobody_is_left()


@pytest.mark.long
def test_what_happened_before_the_run_died_is_in_the_journal(start: Start) -> None:
    experiment = start(
        """
        def launch_mission(self, context):
            import os, signal
            for number in range(5000): context.share(number=number)
            context.warn("the last word", fix="")
            os.kill(os.getpid(), signal.SIGKILL)
        """,
        "--only",
        "r_1",
    )
    assert experiment.end() == 1, experiment.output
    journal = (experiment.folder / "journal.jsonl").read_text()
    assert journal.count('"kind":"shared"') == 5000
    assert "the last word" in journal
