"""The orchestrator is told to end, or dies: the run closes what it opened, and the experiment resumes."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import pytest
from tests.process.conftest import is_within_a_second, starved_for

Start = Callable[..., Any]

#: The second run moves until it is told to stop, and says when it was.
MOVING = """
grace_in_s = 5
def launch_mission(self, context):
    import time
    if context.run_id == "r_2" and not self.flag("stopped").exists():
        self.flag("moving").write_text("")
        time.sleep(60)
def stop_run(self, context):
    import time
    if self.flag("moving").exists() and not self.flag("stopped").exists():
        self.flag("stopped.new").write_text(str(time.time()))
        self.flag("stopped.new").rename(self.flag("stopped"))
def populate_run_data(self, context): return {"Energy": 1.5}
def flag(self, name): return Path(__file__).parent / name
"""


def resumes(start: Start, experiment: Any) -> bool:
    done = [row for row in experiment.table if row["status"] == "Done"]
    again = start(config=experiment.config)
    code = again.end()
    assert code == 0, again.output
    assert again.statuses == ["Done"] * 4
    assert [row for row in again.table if row["run_id"] in {row["run_id"] for row in done}] == done
    return again.nobody_is_left()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP], ids=lambda number: number.name)
def test_told_to_end_the_run_is_closed_and_marked_and_the_experiment_resumes(
    start: Start, number: signal.Signals
) -> None:
    experiment = start(MOVING)
    experiment.wait_for("moving")
    starved = starved_for()
    sent = experiment.send(number)
    assert is_within_a_second(sent, float(experiment.wait_for("stopped").read_text()), starved)
    assert experiment.end() == 130
    assert experiment.statuses == ["Done", "-", "-", "-"]
    assert experiment.nobody_is_left()
    assert resumes(start, experiment)


def test_a_second_ctrl_c_ends_at_once(start: Start) -> None:
    experiment = start(
        MOVING.replace("grace_in_s = 5", "grace_in_s = 90").replace(  # longer than the end is waited for
            "def stop_run(self, context):", "def stop_run(self, context):\n    self.hang()"
        )
        + "def hang(self):\n    import time\n    self.flag('closing').write_text('')\n    time.sleep(90)\n"
    )
    experiment.wait_for("closing")
    experiment.send(signal.SIGINT)
    time.sleep(1.0)  # two that come before the first is noticed are one
    experiment.send(signal.SIGINT)
    assert experiment.end() == 130
    assert experiment.nobody_is_left()


def test_ctrl_c_ends_a_callback_of_the_orchestrator(start: Start) -> None:
    experiment = start(
        """
        def before_run(self, context):
            import time
            (Path(__file__).parent / "waiting").write_text("")
            time.sleep(60)
        """
    )
    experiment.wait_for("waiting")
    experiment.send(signal.SIGINT)
    assert experiment.end() == 130
    assert experiment.statuses == ["-"] * 4


def test_killed_the_run_is_closed_within_a_second_and_the_experiment_resumes(start: Start) -> None:
    experiment = start(MOVING)
    experiment.wait_for("moving")
    starved = starved_for()
    sent = experiment.send(signal.SIGKILL)
    assert is_within_a_second(sent, float(experiment.wait_for("stopped").read_text()), starved)
    experiment.end()
    assert experiment.nobody_is_left()
    assert resumes(start, experiment)


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


def test_killed_the_log_of_the_unfinished_attempt_is_kept(start: Start) -> None:
    experiment = start(
        MOVING.replace(
            "    import time\n    if context", "    import time; print('moving off', flush=True)\n    if context"
        )
    )
    experiment.wait_for("moving")
    experiment.send(signal.SIGKILL)
    experiment.end()
    assert experiment.nobody_is_left()
    assert resumes(start, experiment)
    assert "moving off" in (experiment.folder / "earlier_attempts" / "r_2" / "1" / "log.txt").read_text()


def test_a_closed_terminal_ends_the_experiment_cleanly(start: Start, write_config: Any) -> None:
    config = write_config(MOVING)
    master, terminal = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "robot_runner", "run", str(config)],
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
        start_new_session=True,
        # The first terminal that a session leader opens becomes its controlling one: closing it sends SIGHUP.
        preexec_fn=lambda: os.close(os.open(os.ttyname(0), os.O_RDWR)),  # noqa: PLW1509 - pytest has no threads here
    )
    os.close(terminal)
    deadline = time.monotonic() + 30
    os.set_blocking(master, False)
    while not (config.parent / "moving").exists():
        assert time.monotonic() < deadline
        try:
            os.read(master, 65536)
        except BlockingIOError:
            time.sleep(0.02)
    closed = time.time()
    os.close(master)
    process.wait(timeout=30)
    assert float((config.parent / "stopped").read_text()) - closed < 1
    again = start(config=config)
    assert again.end() == 0
    assert again.statuses == ["Done"] * 4


def test_a_second_orchestrator_is_refused_and_told_who_holds_the_experiment(start: Start) -> None:
    experiment = start(MOVING)
    experiment.wait_for("moving")
    second = start(config=experiment.config)
    assert second.end() == 2
    assert f"process {experiment.process.pid}" in second.output
    experiment.send(signal.SIGTERM)
    assert experiment.end() == 130


def test_the_lock_of_a_dead_process_holds_nobody_up(start: Start) -> None:
    experiment = start(MOVING)
    experiment.wait_for("moving")
    experiment.send(signal.SIGKILL)
    experiment.end()
    assert (experiment.folder / ".lock").read_text()
    assert resumes(start, experiment)


def test_a_killed_guardian_fails_its_run_which_is_closed_and_the_next_run_has_another(start: Start) -> None:
    experiment = start(
        """
        def launch_mission(self, context):
            import os, signal, time
            if context.run_id in {"r_1", "r_3"}:
                os.kill(os.getppid(), signal.SIGKILL)
                time.sleep(60)
        def stop_run(self, context):
            (Path(__file__).parent / f"closed {context.run_id}").touch()
        """
    )
    assert experiment.end() == 1, experiment.output
    assert experiment.statuses == ["Failed", "Done", "Failed", "Done"]
    assert "r_1, r_3: launch_mission of config: its guardian was killed by SIGKILL" in experiment.output
    assert experiment.wait_for("closed r_1")
    assert experiment.wait_for("closed r_3")
    assert experiment.nobody_is_left()


def test_a_process_that_is_killed_while_it_waits_for_its_run_costs_no_run(start: Start) -> None:
    experiment = start(
        """
        def launch_mission(self, context):
            import os, signal, time
            for path in Path("/proc").glob("[0-9]*/stat"):
                pid, _, rest = path.read_text().partition(" (")
                if int(rest.rpartition(")")[2].split()[1]) == os.getppid() and int(pid) != os.getpid():
                    os.kill(int(pid), signal.SIGKILL)
                    while path.exists():  # until the guardian has buried it
                        time.sleep(0.01)
                    (Path(__file__).parent / f"killed in {context.run_id}").touch()
        """
    )
    assert experiment.end() == 0, experiment.output
    assert experiment.wait_for("killed in r_1")
    assert experiment.wait_for("killed in r_3")
    assert experiment.statuses == ["Done"] * 4
    assert experiment.nobody_is_left()


def test_a_guardian_that_is_killed_between_two_runs_costs_no_run(start: Start) -> None:
    experiment = start(
        """
        time_between_runs_in_ms = 1500
        def stop_run(self, context):
            import os, subprocess
            if context.run_id == "r_1":
                subprocess.Popen(["sh", "-c", f"sleep 0.5; kill -9 {os.getppid()}"], start_new_session=True)
        """
    )
    assert experiment.end() == 0, experiment.output
    assert experiment.statuses == ["Done"] * 4
    assert experiment.nobody_is_left()
