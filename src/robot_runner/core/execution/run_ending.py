"""How threads and callbacks end a run, or its mission, before its time, and how that is recorded."""

from __future__ import annotations

import _thread
import os
import sys
import threading
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from weakref import WeakSet

from robot_runner.core.events.early_end import MissionStopped, RunFailed, RunInterrupted, fails_run
from robot_runner.core.events.manager import RobotRunnerEvents
from robot_runner.core.execution.interruption import InterruptGate
from robot_runner.core.execution.run_records import failure_fields, text_of
from robot_runner.core.execution.task import Report

#: Threads that runs of this process have started and not ended: their exceptions must not fail a later run.
_left_over: WeakSet[threading.Thread] = WeakSet()


class RunEnding:
    """Knows whether a run has failed, and ends it, or its mission, from any of its threads.

    Attributes:
        has_failed: whether a failure was recorded.
        event: the event that is being emitted, None before the first one.
        callback: the event and the owner of what is being executed, as a failure names them.
    """

    def __init__(self, report: Report, gate: InterruptGate) -> None:
        self.has_failed = False
        self.event: RobotRunnerEvents | None = None
        self.callback = ("", "")
        self._report = report
        self._gate = gate
        self._gate.held_up = self._tell_held_up
        self._has_told_held_up = False
        self._held_up: list[tuple[str, str, dict[str, str]]] = []
        self._telling = _thread.allocate_lock()
        self._failed_by: set[str] = set()
        self._process = os.getpid()
        self._earlier_hook = threading.excepthook

    @contextmanager
    def from_any_thread(self) -> Iterator[None]:
        """Let other threads end what this one executes, for a while; an exception in one of them does so."""
        self._earlier_hook = threading.excepthook
        threading.excepthook = self._take_unhandled
        before = set(threading.enumerate())
        try:
            with self._gate.woken_by_threads(), fails_run(self.fail_for):
                yield
        finally:
            threading.excepthook = self._earlier_hook
            _left_over.update(set(threading.enumerate()) - before)
            self._tell()

    def fail(self, owner: str, reason: str) -> None:
        """Fail the run and end what it is doing; a second call for the same owner only ends it."""
        if owner not in self._failed_by:
            self._failed_by.add(owner)
            stack = "".join(traceback.format_stack()[:-2])  # as far as the caller of `context.fail`
            self._fail(owner, {"problem": reason, "traceback": stack})
        self._gate.end_run(RunFailed(reason))

    def stop_mission(self, owner: str, reason: str) -> None:
        """End the mission. It must be going on, and not have been stopped before."""
        _print_to_log(f"the mission was stopped by {owner}: {reason}\n")
        self._report("mission_stopped", {"owner": owner, "reason": reason})
        self._gate.end_mission(MissionStopped(reason))

    def fail_for(self, error: BaseException, where: str) -> None:
        """Fail the run for an exception that nothing else handles, and end what the run is doing."""
        if threading.current_thread() in _left_over:
            self._find(error, where)
            return
        problem = f"{where} raised {type(error).__name__}: {text_of(error)}"
        self._fail("", {**failure_fields(error), "problem": problem})
        self._gate.end_run(RunFailed(problem))

    def record(self, event: str, owner: str, error: BaseException) -> None:
        """Record the exception of a callback, except those of `fail` and `stop_mission`, recorded already."""
        told = RunInterrupted if self._has_told_held_up else RunFailed | MissionStopped
        if not isinstance(error, told):
            self._write(event, owner, failure_fields(error))

    def _tell_held_up(self, frame: FrameType | None) -> None:
        """Record once that a callback goes on after the stop request: it is closing, or has swallowed the request."""
        if self._has_told_held_up or self.has_failed or not self.callback[0]:
            return
        self._has_told_held_up = self.has_failed = True
        stack = "".join(traceback.format_stack(frame))
        fields = {"problem": "the callback was still being executed when the run was told to end", "traceback": stack}
        self._held_up.append((*self.callback, fields))
        # In a thread, as this is a signal handler: the interrupted code may hold the lock of the record writer. Not by
        # `threading`, which takes locks itself. Where the system has no further thread, it is told at the run's end.
        with suppress(RuntimeError):
            _thread.start_new_thread(self._tell, ())

    def _tell(self) -> None:
        """Record, once, what delayed the end of the run: at the latest before its last record."""
        with self._telling:
            while self._held_up:
                self._write(*self._held_up.pop())

    @property
    def _is_closing(self) -> bool:
        return self.event is not None and self.event.is_closing

    def _fail(self, owner: str, fields: dict[str, str]) -> None:
        self._write("" if self.event is None else self.event.value, owner, fields, ends_event=not self._is_closing)

    def _write(self, event: str, owner: str, fields: dict[str, str], **more: object) -> None:
        self.has_failed = True
        place = " of ".join(part for part in (event, owner) if part) or "the run"
        _print_to_log(f"{place} failed: {fields['problem']}\n{fields['traceback']}")
        self._report("failure", {"event": event, "owner": owner, **fields, **more})

    def _take_unhandled(self, raised: threading.ExceptHookArgs) -> None:
        if os.getpid() != self._process:  # a process that the run forked
            self._earlier_hook(raised)
        elif raised.exc_value is not None and not isinstance(raised.exc_value, SystemExit | RunInterrupted):
            where = f"thread {raised.thread.name if raised.thread else '(ended)'}"
            tell = self._find if self._is_closing else self.fail_for
            tell(raised.exc_value, where)

    def _find(self, error: BaseException, where: str) -> None:
        """Record as a finding the exception of a thread during closing, or after its run: it may be the cause."""
        if threading.current_thread() in _left_over:
            where += " of an earlier run"
        problem = f"{where} raised {type(error).__name__}: {text_of(error)}"
        _print_to_log(f"{problem}\n{failure_fields(error)['traceback']}")
        fix = "Look at its traceback in the run's log, and end the thread before what it uses is closed."
        self._report("finding", {"owner": where, "problem": problem, "fix": fix})


def _print_to_log(text: str) -> None:
    with suppress(Exception):  # a full disk, or a closed stream, must not keep what follows from stopping the robot
        sys.stderr.write(text)
