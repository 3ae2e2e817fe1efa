"""What carries runs: each in a process of its own, forked or spawned, or in the orchestrator itself."""

from __future__ import annotations

import os
import sys
import threading
import warnings
from contextlib import AbstractContextManager, redirect_stderr, redirect_stdout
from typing import TYPE_CHECKING, Protocol, Self

from robot_runner.config.choices import RunProcess
from robot_runner.execution.child import execute_in_child, settle_child
from robot_runner.execution.guardian import Guardian
from robot_runner.execution.interruption import InterruptGate
from robot_runner.execution.records import FINISHED
from robot_runner.execution.run import execute_run
from robot_runner.execution.spawning import WORKER, describe_task
from robot_runner.execution.supervision import Limits, RunProcessHandle, Watch, supervise
from robot_runner.storage.run_folders import open_log

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.config.experiment import Experiment
    from robot_runner.execution.outcome import OutcomeBuilder
    from robot_runner.execution.task import RunOutcome, RunTask

__all__ = ["Executor", "executor_for"]


class Executor(AbstractContextManager["Executor"], Protocol):
    """Executes one run and returns how it went, whatever becomes of the run. Entered once an experiment."""

    def execute(self, task: RunTask, builder: OutcomeBuilder, watch: Watch) -> RunOutcome:
        """Execute one attempt; `builder` holds what was known of it before."""
        ...


def executor_for(experiment: Experiment) -> Executor:
    """Return the executor that the config's `run_process` asks for."""
    match experiment.parameters.run_process:
        case RunProcess.FORK:
            return _ProcessExecutor(experiment, _fork)
        case RunProcess.SPAWN:
            return _ProcessExecutor(experiment, _spawn)
        case RunProcess.IN_PROCESS:
            return _InProcessExecutor(experiment)


class _ProcessExecutor:
    """A fresh process a run; how it is started is all that differs between forking and spawning."""

    def __init__(self, experiment: Experiment, start: Callable[[Experiment, RunTask, int, int], int]) -> None:
        self._experiment = experiment
        self._start = start
        parameters = experiment.parameters
        self._limits = Limits(parameters.run_deadline_in_s, parameters.event_deadline_in_s, parameters.grace_in_s)
        self._guardian = Guardian(parameters.grace_in_s)

    def __enter__(self) -> Self:
        self._guardian.__enter__()
        return self

    def __exit__(self, *raised: object) -> None:
        self._guardian.__exit__(*raised)

    def execute(self, task: RunTask, builder: OutcomeBuilder, watch: Watch) -> RunOutcome:
        records, records_end = os.pipe()
        try:
            process = RunProcessHandle(self._start(self._experiment, task, records_end, self._guardian.line), records)
        except BaseException:
            os.close(records)
            raise
        finally:
            os.close(records_end)
        try:
            return supervise(process, builder, limits=self._limits, watch=watch)
        finally:
            process.end(self._limits.grace)  # still alive only if we cannot go on ourselves: the disk is full, say
            self._guardian.run_has_ended()


def _fork(experiment: Experiment, task: RunTask, records: int, guardian: int) -> int:
    sys.stdout.flush()
    sys.stderr.flush()
    pid = _forked()
    if pid:
        return pid
    try:
        gate = settle_child(open_log(experiment.folder), guardian)
        execute_in_child(experiment, task, records, gate)
    finally:
        os._exit(70)  # never back into the orchestrator's code


def _forked() -> int:
    if sys.version_info < (3, 12) or threading.active_count() > 1:
        return os.fork()
    # Python counts the threads of C libraries (OpenBLAS) as well and warns; these know how to be forked.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


def _spawn(experiment: Experiment, task: RunTask, records: int, guardian: int) -> int:
    # The new interpreter gets copies that it inherits; ours are not inherited by anybody else.
    copies = [os.dup(descriptor) for descriptor in (records, guardian)]
    try:
        for descriptor in copies:
            os.set_inheritable(descriptor, True)  # noqa: FBT003 - the system's own signature
        arguments = [sys.executable, "-m", WORKER, describe_task(experiment, task, *copies)]
        return os.posix_spawn(sys.executable, arguments, os.environ)
    finally:
        for descriptor in copies:
            os.close(descriptor)


class _InProcessExecutor:
    def __init__(self, experiment: Experiment) -> None:
        self._experiment = experiment

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        return None

    def execute(self, task: RunTask, builder: OutcomeBuilder, watch: Watch) -> RunOutcome:
        def report(kind: str, fields: dict[str, object]) -> None:
            builder.take(kind, fields)
            watch.report(kind, fields)
            watch.refresh()

        with (
            os.fdopen(open_log(self._experiment.folder), "a", encoding="utf-8") as log,
            redirect_stdout(log),
            redirect_stderr(log),
        ):
            gate = InterruptGate()
            with watch.interruption.passed_on(gate):
                execute_run(self._experiment, task, report, gate)
        report(FINISHED, {})
        return builder.outcome(interrupted=watch.interruption.is_requested)
