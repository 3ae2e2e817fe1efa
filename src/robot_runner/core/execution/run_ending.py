"""What ends a run from any of its threads: on purpose, and an exception that nobody else handles there."""

from __future__ import annotations

import os
import sys
import threading
import traceback
from contextlib import contextmanager
from typing import TYPE_CHECKING

from robot_runner.core.errors import RobotRunnerError
from robot_runner.core.events.early_end import MissionStopped, RunFailed, RunInterrupted
from robot_runner.core.events.unhandled import fails_run
from robot_runner.core.secret_names import without_environment_secrets

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.core.events.manager import RobotRunnerEvents
    from robot_runner.core.execution.interruption import InterruptGate
    from robot_runner.core.execution.task import Report

__all__ = ["RunEnding", "failure_fields"]


class RunEnding:
    """Knows whether a run has failed, and ends it, or its mission, from any of its threads.

    Args:
        report: takes the failures.
        gate: reaches the callback that is being executed.

    Attributes:
        has_failed: whether a failure was recorded.
        event: the event that is being emitted, None before the first one.
    """

    def __init__(self, report: Report, gate: InterruptGate) -> None:
        self.has_failed = False
        self.event: RobotRunnerEvents | None = None
        self._report = report
        self._gate = gate
        self._failed_by: set[str] = set()
        self._process = os.getpid()
        self._earlier_hook = threading.excepthook

    @contextmanager
    def from_any_thread(self) -> Iterator[None]:
        """While this lasts, other threads can end what this one executes, and an exception in one of them does."""
        self._earlier_hook = threading.excepthook
        threading.excepthook = self._take_unhandled
        try:
            with self._gate.woken_by_threads(), fails_run(self.fail_for):
                yield
        finally:
            threading.excepthook = self._earlier_hook

    def fail(self, owner: str, reason: str) -> None:
        """Fail the run and end what it is doing; a second call for the same owner only ends it."""
        if owner not in self._failed_by:
            self._failed_by.add(owner)
            stack = "".join(traceback.format_stack()[:-2])  # as far as the caller of `context.fail`
            self._fail(owner, {"problem": reason, "traceback": stack})
        self._gate.end_run(RunFailed(reason))

    def stop_mission(self, owner: str, reason: str) -> None:
        """End the mission, which is going on and was not stopped before."""
        sys.stderr.write(f"the mission was stopped by {owner}: {reason}\n")  # into the run's log
        self._report("mission_stopped", {"owner": owner, "reason": reason})
        self._gate.end_mission(MissionStopped(reason))

    def fail_for(self, error: BaseException, where: str) -> None:
        """Fail the run for what was raised where nobody else handles it, and end what it is doing."""
        problem = f"{where} raised {type(error).__name__}: {error}"
        self._fail("", {**failure_fields(error), "problem": problem})
        self._gate.end_run(RunFailed(problem))

    def record(self, event: str, owner: str, error: BaseException) -> None:
        """Record what a callback raised; what `fail` and `stop_mission` raise in it is recorded already."""
        if not isinstance(error, RunFailed | MissionStopped):
            self._write(event, owner, failure_fields(error))

    @property
    def _is_closing(self) -> bool:
        return self.event is not None and self.event.is_closing

    def _fail(self, owner: str, fields: dict[str, str]) -> None:
        self._write("" if self.event is None else self.event.value, owner, fields, ends_event=not self._is_closing)

    def _write(self, event: str, owner: str, fields: dict[str, str], **more: object) -> None:
        self.has_failed = True
        place = " of ".join(part for part in (event, owner) if part) or "the run"
        sys.stderr.write(f"{place} failed: {fields['problem']}\n{fields['traceback']}")  # into the run's log
        self._report("failure", {"event": event, "owner": owner, **fields, **more})

    def _take_unhandled(self, raised: threading.ExceptHookArgs) -> None:
        if os.getpid() != self._process:  # a process that the run forked
            self._earlier_hook(raised)
        elif raised.exc_value is not None and not isinstance(raised.exc_value, SystemExit | RunInterrupted):
            where = f"thread {raised.thread.name if raised.thread else '(ended)'}"
            if self._is_closing:
                self._find(raised.exc_value, where)
            else:
                self.fail_for(raised.exc_value, where)

    def _find(self, error: BaseException, where: str) -> None:
        """Record that a thread raised something while things are closed: it may have tripped over one of them."""
        problem = f"{where} raised {type(error).__name__}: {error}"
        sys.stderr.write(f"{problem}\n{failure_fields(error)['traceback']}")
        fix = "Look at its traceback in the run's log, and end the thread before what it uses is closed."
        self._report("finding", {"owner": where, "problem": problem, "fix": fix})


def failure_fields(error: BaseException) -> dict[str, str]:
    """Return the problem in one line, and the traceback, without what the environment keeps secret."""
    text = str(error)
    problem = text if isinstance(error, RobotRunnerError | RunInterrupted) else f"{type(error).__name__}: {text}"
    trace = "".join(traceback.format_exception(error))
    return {"problem": without_environment_secrets(problem), "traceback": without_environment_secrets(trace)}
