"""What a program has started goes on where its supervisor was killed: it is found by a variable of its environment."""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from pathlib import Path

from robot_runner.core.storage.outliving import has_in_environment, processes

_VARIABLE = "ROBOT_RUNNER_START"
#: How often we look whether they are gone, and how long what was killed may take, s.
_LOOK, _DYING = 0.05, 5.0


def mark_of(folder: Path) -> dict[str, str]:
    """Return the variable that tells the processes of a start by its folder."""
    return {_VARIABLE: str(folder.absolute())}


def end_orphans(folder: Path) -> None:
    """Kill what a start has left alive, and wait until it is gone (Linux).

    What has become another user, or was started without the environment, stays.
    """
    # As the system has it, whatever a folder is called.
    assignment = os.fsencode(f"{_VARIABLE}={mark_of(folder)[_VARIABLE]}")
    deadline = time.monotonic() + _DYING
    while (left := [pid for pid in processes() if has_in_environment(pid, assignment)]) and time.monotonic() < deadline:
        for pid in left:
            with suppress(ProcessLookupError, PermissionError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(_LOOK)
