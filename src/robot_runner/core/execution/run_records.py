"""The records of a run on their way to the orchestrator: JSON lines through a pipe."""

from __future__ import annotations

import json
import os
import select
import threading
import traceback
from contextlib import suppress
from typing import Any

from robot_runner.core.errors import ExecutionError, RobotRunnerError, nearest
from robot_runner.core.events.context import OTHER_NAMES, ExperimentContext
from robot_runner.core.events.early_end import RunInterrupted, undivided
from robot_runner.core.secret_names import sentences_without_secrets, without_environment_secrets

#: The last record of a run that ended by itself.
FINISHED = "finished"
#: The last event of a run, in which its measures are computed.
POPULATE = "populate_run_data"

#: The size up to which a write to a pipe is atomic, bytes (PIPE_BUF of Linux; POSIX requires 512).
_AT_ONCE = 4096
#: How long the run waits, once, for an orchestrator that does not read, s: held records are lost if the run is killed.
_PATIENCE = 0.5
#: How much may be held for an orchestrator that does not read, bytes: an hour of 50 records a second. Beyond that,
#: publishing fails the run, so that its robot is stopped.
_MOST_HELD = 32 << 20
_OF_CALLBACKS = ("shared", "measure")

_encode = json.JSONEncoder(ensure_ascii=True, separators=(",", ":"), default=str).encode


class RecordWriter:
    """The run's end of the pipe. Threads of plugins may use it, too.

    Measures of `populate_run_data` are sent in one write, with the next record of another kind, which always comes.
    Those of other events are sent at once, as a mission may last for hours.

    A mission must not wait long for an orchestrator that waits for a disk, or was suspended: the robot would carry out
    its last command. What the pipe does not take is held then, and sent with the next record. With `waits`, writing
    waits until the pipe has room, where no robot moves meanwhile.
    """

    def __init__(self, descriptor: int, *, waits: bool = False) -> None:
        os.set_blocking(descriptor, waits)
        self.descriptor = descriptor
        self._lock = threading.RLock()  # re-entrant: a signal handler may stop the mission, or fail the run
        self._is_sending = False
        self._event = ""
        self._held = bytearray()
        self._is_stalled = False

    def __call__(self, kind: str, fields: dict[str, Any]) -> None:
        """Send one record, with secrets of the environment masked; dropped where the orchestrator is gone.

        Raises:
            ExecutionError: a callback shares or publishes while the orchestrator has not read for too long.
        """
        line = f"{_encode([kind, sentences_without_secrets(fields)])}\n"
        with undivided, self._lock:  # where the mission ends now, nothing is torn, or told twice
            self._event = fields["event"] if kind == "event" else self._event
            self._held += line.encode()
            if self._is_sending or (kind == "measure" and self._event == POPULATE):
                return
            self._is_sending = True
            try:
                self._send(waits=kind == FINISHED)
            finally:
                self._is_sending = False
            if len(self._held) > _MOST_HELD and kind in _OF_CALLBACKS:
                problem = "the orchestrator does not take what the run tells: it was suspended, or waits for a disk"
                fix = "Let it go on (fg), or look at the disk of the results; then execute the run again."
                raise ExecutionError(problem, where=kind, fix=fix)

    def _send(self, *, waits: bool) -> None:
        """Write the held records: as much as the pipe takes, or with `waits` all of them."""
        while self._held:
            try:
                written = os.write(self.descriptor, self._held[:_AT_ONCE])
            except BlockingIOError:
                patience = None if waits else 0.0 if self._is_stalled else _PATIENCE
                if not _has_room(self.descriptor, patience):
                    self._is_stalled = True
                    return
                continue
            except BrokenPipeError:
                written = len(self._held)
            del self._held[:written]
            self._is_stalled = False

    def close(self) -> None:
        """Close this end: a process that does not report must not keep the pipe open."""
        os.close(self.descriptor)
        self.descriptor = -1


def _has_room(descriptor: int, seconds: float | None) -> bool:
    """Wait until a pipe has room, for `seconds` at most (None: without limit); return whether it has."""
    poll = select.poll()
    poll.register(descriptor, select.POLLOUT)
    return bool(poll.poll(None if seconds is None else 1000 * seconds))


class RecordReader:
    """The orchestrator's end of the pipe."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._pending = bytearray()  # to which pieces of a long record are added without copying it each time
        os.set_blocking(descriptor, False)

    def read(self) -> tuple[list[tuple[str, dict[str, Any]]], bool]:
        """Return the records that have arrived, and whether the pipe is still open; never waits."""
        is_open, has_line = True, False
        while True:
            try:
                data = os.read(self._descriptor, 65536)
            except BlockingIOError:
                break
            if not data:
                is_open = False
                break
            self._pending += data
            has_line = has_line or b"\n" in data
            if len(data) < 65536:  # noqa: PLR2004 - the size asked for: there is no more for now
                break
        if not has_line:
            return [], is_open
        *lines, self._pending = self._pending.split(b"\n")
        return [record for line in lines if (record := _decoded(line))], is_open


def _decoded(line: bytearray) -> tuple[str, dict[str, Any]] | None:
    try:
        kind, fields = json.loads(line.decode())
    except (ValueError, TypeError):  # another program wrote into the pipe
        return None
    return (kind, fields) if isinstance(kind, str) and isinstance(fields, dict) else None


def failure_fields(error: BaseException) -> dict[str, str]:
    """Return `problem`, with the type of the error unless it is ours, and `traceback`; secrets are masked."""
    text = text_of(error)
    kind = "" if isinstance(error, RobotRunnerError | RunInterrupted) else type(error).__name__
    problem = ": ".join(filter(None, (kind, text)))
    problem += _name_meant(error)
    if isinstance(error, EOFError) and "reading a line" in text:
        problem += " (nobody can type into a run: have a person asked before it, by `operator_steps`)"
    trace = "".join(traceback.format_exception(error))
    return {"problem": without_environment_secrets(problem), "traceback": without_environment_secrets(trace)}


def _name_meant(error: BaseException) -> str:
    """Return, in brackets, the nearest attribute for an AttributeError; else nothing."""
    if not isinstance(error, AttributeError) or not error.name or error.obj is None:
        return ""
    near = OTHER_NAMES.get(error.name) if isinstance(error.obj, ExperimentContext) else None
    with suppress(Exception):  # `dir` may execute a user's code
        near = near or nearest(error.name, dir(error.obj))
    return f" (did you mean {near!r}?)" if near else ""


def text_of(error: BaseException) -> str:
    """Return the text of an error, also of one whose `__str__` raises."""
    try:
        return str(error)
    except BaseException as later:  # noqa: BLE001 - a user's code
        return f"(its text could not be made: {type(later).__name__})"
