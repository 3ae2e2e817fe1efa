"""What a run's own process does before and after the run: its task, its log, its group, the way it leaves."""

from __future__ import annotations

import os
import sys
from io import TextIOWrapper
from typing import TYPE_CHECKING, NoReturn

from robot_runner.execution.interruption import InterruptGate
from robot_runner.execution.records import FINISHED, RecordWriter
from robot_runner.execution.run import execute_run, failure_fields
from robot_runner.storage.run_folders import open_log

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.config.experiment import Experiment
    from robot_runner.execution.task import RunTask

__all__ = ["await_task", "execute_in_child", "settle_streams"]


def await_task(tasks: int) -> bytes:
    """Return the task that this process is for, once it is told; empty where there is none any more."""
    told = b""
    while more := os.read(tasks, 65536):
        told += more
    os.close(tasks)
    return told


def execute_in_child(experiment: Experiment, make_task: Callable[[], RunTask | None], records: int) -> NoReturn:
    """Be the process of a run, and leave: nothing of the orchestrator's may be cleaned up here.

    It leads a group of its own, so that all that it starts can be ended with it; it hears the word to end; what it
    prints goes to the run's log.

    Args:
        experiment: what the run is one of.
        make_task: waits for the task; None for none.
        records: where to report.
    """
    code = 1
    report = RecordWriter(records)
    try:
        gate = InterruptGate()
        gate.listen()
        task = make_task()
        if task is not None:
            _print_to(open_log(experiment.folder))
            execute_run(experiment, task, report, gate)
            report(FINISHED, {})
        code = 0
    except BaseException as error:  # noqa: BLE001 - the last resort: it must be known before the process ends
        report("failure", {"event": "", "owner": "", **failure_fields(error)})
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def settle_streams() -> None:
    """Print as a run does: line by line, in UTF-8, and not on the orchestrator's screen, which may stand in between."""
    sys.stdout, sys.stderr = sys.__stdout__, sys.__stderr__
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(encoding="utf-8", errors="backslashreplace", line_buffering=True)


def _print_to(log: int) -> None:
    os.dup2(log, 1)
    os.dup2(log, 2)
    os.close(log)
