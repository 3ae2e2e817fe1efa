"""What a run's own process does before and after the run: streams, signals, and the line to its orchestrator."""

from __future__ import annotations

import os
import sys
from io import TextIOWrapper
from typing import TYPE_CHECKING

from robot_runner.execution.guardian import register_with_guardian
from robot_runner.execution.interruption import InterruptGate
from robot_runner.execution.records import FINISHED, RecordWriter
from robot_runner.execution.run import execute_run, failure_fields

if TYPE_CHECKING:
    from robot_runner.config.experiment import Experiment
    from robot_runner.execution.task import RunTask

__all__ = ["execute_in_child", "settle_child"]


def settle_child(log: int, guardian: int) -> InterruptGate:
    """Make this process the process of a run.

    It leads a group of its own, so that Ctrl-C reaches the orchestrator alone; what it prints goes to the run's log;
    it reads nothing; it hears the word to end; and it is ended if its orchestrator dies.
    """
    os.setpgid(0, 0)
    _redirect(log)
    gate = InterruptGate()
    gate.listen()
    register_with_guardian(guardian)
    return gate


def execute_in_child(experiment: Experiment, task: RunTask, records: int, gate: InterruptGate) -> None:
    """Execute the run, report through the pipe, and leave: nothing of the orchestrator's may be cleaned up here."""
    report = RecordWriter(records)
    code = 1
    try:
        execute_run(experiment, task, report, gate)
        report(FINISHED, {})
        code = 0
    except BaseException as error:  # noqa: BLE001 - the last resort: it must be known before the process ends
        report("failure", {"event": "", "owner": "", **failure_fields(error)})
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _redirect(log: int) -> None:
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(log, 1)
    os.dup2(log, 2)
    os.close(nothing)
    # What stands in their place belongs to the orchestrator's screen.
    sys.stdout, sys.stderr = sys.__stdout__, sys.__stderr__
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(encoding="utf-8", errors="backslashreplace", line_buffering=True)
