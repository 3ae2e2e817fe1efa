"""The run's process dies, hangs or shouts: the run fails with the cause, the others are executed, nobody is left."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

Start = Callable[..., Any]

FAULTS = {
    "exception": ("raise RuntimeError('the wheel fell off')", "RuntimeError: the wheel fell off"),
    "sys.exit": ("sys.exit(0)", "SystemExit: 0"),
    "os._exit": ("os._exit(3)", "the run's process exited with code 3"),
    "segmentation fault": ("ctypes.string_at(0)", "the run's process was killed by SIGSEGV"),
    "abort": ("os.abort()", "the run's process was killed by SIGABRT"),
    "killed": ("os.kill(os.getpid(), signal.SIGKILL)", "the run's process was killed by SIGKILL"),
    "killed by a signal without a name": ("os.kill(os.getpid(), 40)", "the run's process was killed by signal 40"),
    "out of memory": (
        "resource.setrlimit(resource.RLIMIT_AS, (1 << 29, 1 << 29)); bytearray(1 << 30)",
        "MemoryError",
    ),
    "endless loop": ("exec('while True: pass')", "took longer than event_deadline_in_s = 3 s"),
    "hang in C": ("ctypes.PyDLL(None).sleep(60)", "took longer than event_deadline_in_s = 3 s"),
    "deaf to signals": (
        "signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(60)",
        "took longer than event_deadline_in_s = 3 s",
    ),
    "stopped": ("os.kill(os.getpid(), signal.SIGSTOP)", "took longer than event_deadline_in_s = 3 s"),
    "closes every descriptor": ("os.closerange(0, 256)", "the run's process exited with code"),
    "nonsense in the pipe": (
        "[shout(number) for number in range(3, 20)]; os._exit(5)",
        "the run's process exited with code 5",
    ),
}

BODY = """
event_deadline_in_s = {deadline_s}
grace_in_s = 1
def launch_mission(self, context):
    import ctypes, os, resource, signal, stat, sys, time
    def shout(number):
        try: stat.S_ISFIFO(os.fstat(number).st_mode) and os.write(number, b'nonsense\\n')
        except OSError: pass
    (context.raw_data_folder / "raw.txt").write_text("raw")
    print("said before the fault", flush=True)
    if context.run_id == "r_2": {fault}
def populate_run_data(self, context): return {{"Energy": 1.5}}
"""


@pytest.mark.long
@pytest.mark.parametrize("name", FAULTS)
def test_a_run_that_dies_fails_with_the_cause_and_the_others_are_executed(start: Start, name: str) -> None:
    fault, reason = FAULTS[name]
    deadline_s = 3 if "event_deadline_in_s" in reason else 60  # runs without a fault are to keep to it, however busy
    experiment = start(BODY.format(fault=fault, deadline_s=deadline_s))
    assert experiment.end() == 1
    assert experiment.statuses == ["Done", "Failed", "Done", "Done"]
    assert [row["Energy"] for row in experiment.table] == ["1.5", "", "1.5", "1.5"]
    assert reason in experiment.output
    assert (experiment.folder / "runs" / "r_2" / "config" / "raw.txt").read_text() == "raw"
    assert "said before the fault" in (experiment.folder / "runs" / "r_2" / "log.txt").read_text(errors="replace")
    assert experiment.nobody_is_left()


@pytest.mark.long
def test_a_grandchild_that_holds_everything_open_is_ended_with_its_run(start: Start) -> None:
    experiment = start(
        """
        def launch_mission(self, context):
            import subprocess
            subprocess.Popen(["sleep", "600"], close_fds=False)
        """
    )
    assert experiment.end() == 0
    assert experiment.statuses == ["Done"] * 4
    assert experiment.nobody_is_left()


@pytest.mark.long
def test_output_of_hundreds_of_megabytes_is_kept_and_does_not_hold_anything_up(start: Start) -> None:
    experiment = start(
        """
        def launch_mission(self, context):
            if context.run_id == "r_1":
                for _ in range(300): print("x" * 1_000_000)
        """
    )
    assert experiment.end() == 0
    assert (experiment.folder / "runs" / "r_1" / "log.txt").stat().st_size > 300_000_000


@pytest.mark.long
def test_thousands_of_measures_and_shared_values_do_not_block_the_run(start: Start) -> None:
    experiment = start(
        """
        def launch_mission(self, context):
            for number in range(20_000 if context.run_id == "r_1" else 1): context.share(number=number)
            context.publish("Energy", 1)
        """
    )
    assert experiment.end() == 0


@pytest.mark.long
def test_a_failed_run_that_is_tried_again_keeps_every_attempt(start: Start) -> None:
    experiment = start(
        """
        attempts = 3
        def launch_mission(self, context):
            import os
            print("attempt", context.attempt, flush=True)
            if context.run_id == "r_1" and context.attempt < 3: os._exit(1)
        """
    )
    assert experiment.end() == 0
    logs = sorted((experiment.folder / "earlier_attempts" / "r_1").glob("*/log.txt"))
    assert [log.read_text() for log in logs] == ["attempt 1\n", "attempt 2\n"]
