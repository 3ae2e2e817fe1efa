"""Ends what a program has started, if its supervisor was killed: it is found by a variable of its environment.

A supervisor that was stopped goes on.
"""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from pathlib import Path

from robot_runner.core.execution.left_processes import has_locked
from robot_runner.core.storage.outliving import has_in_environment, is_stopped, processes

_VARIABLE = "ROBOT_RUNNER_START"
#: How often to look whether they are gone, and how long that may take after they were killed, s.
_LOOK, _DYING = 0.05, 5.0


def mark_of(folder: Path) -> dict[str, str]:
    """Return the environment variable that marks the processes of a start, by its folder."""
    return {_VARIABLE: str(folder.absolute())}


def end_orphans(folder: Path) -> None:
    """Kill the processes that a start has left, and wait until they are gone (Linux).

    Processes of another user, and those that were started without the environment, stay.
    """
    # As bytes, as the system has it: a folder's name may be anything.
    assignment = os.fsencode(f"{_VARIABLE}={mark_of(folder)[_VARIABLE]}")
    deadline = time.monotonic() + _DYING
    while (left := [pid for pid in processes() if has_in_environment(pid, assignment)]) and time.monotonic() < deadline:
        for pid in left:
            with suppress(ProcessLookupError, PermissionError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(_LOOK)


def signal_stopped(locked: Path, number: signal.Signals) -> bool:
    """Send a signal to the stopped processes that hold the lock of a file (Linux); return whether there are any."""
    path = locked.resolve()
    found = [pid for pid in processes() if is_stopped(pid) and has_locked(pid, path)]
    for pid in found:
        with suppress(ProcessLookupError):
            os.kill(pid, number)
    return bool(found)


def wake_supervisor(events: Path) -> bool:
    """Have the supervisor of a start go on where somebody has stopped it, as nobody else ends the program.

    It holds the lock of `events`. Return whether it was stopped.
    """
    return signal_stopped(events, signal.SIGCONT)
