"""Which process stands by for a run: it holds a lock, by which others await it, and kill it where it is stopped."""

from __future__ import annotations

import fcntl
import os
import signal
import sys
import time
from contextlib import suppress

from robot_runner.core.errors import ExecutionError, Finding
from robot_runner.core.execution.left_processes import has_locked
from robot_runner.core.storage.guarded_files import MissingFileError, open_descriptor, remove
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.lock_files import open_to_lock, was_open_to_strangers
from robot_runner.core.storage.outliving import is_stopped

#: How long the standby may take from the run's death on, s. Finding a robot's nodes takes tenths of a second, or up to
#: 8 s where one is switched off; stopping the robot takes 4 to 12 s; and where something fails, all of it is done at
#: least twice.
LONGEST = 40.0
#: How long it may take to die once it was killed, s.
_DYING = 5.0
#: The longest text that is read as a process id, in bytes.
_DIGITS = 20
#: How often it is checked whether a standby has ended, s.
LOOK = 0.02


def hold_standby_lock(folder: ExperimentFolder) -> None:
    """Hold the lock of `standing_by` until this process ends, as its descriptor stays open."""
    descriptor = open_to_lock(folder.standing_by, folder.root)
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, str(os.getpid()).encode(), 0)
    fcntl.flock(descriptor, fcntl.LOCK_SH)


def locked_by(folder: ExperimentFolder) -> int | None:
    """Return the process id of the standby; None where there is none, or only another user has locked the file."""
    try:
        descriptor = open_descriptor(folder.standing_by, folder.root, os.O_RDONLY)
    except MissingFileError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        with suppress(ValueError):
            pid, path = int(os.pread(descriptor, _DIGITS, 0)), folder.standing_by
            return pid if not was_open_to_strangers(path, folder.root) or has_locked(pid, path.resolve()) else None
    finally:
        os.close(descriptor)
    return None


def is_at_work(folder: ExperimentFolder) -> bool:
    """Return whether a slot has a standby that is not stopped."""
    pid = locked_by(folder)
    return pid is not None and not is_stopped(pid)


def kill_if_stopped(folder: ExperimentFolder) -> bool:
    """Kill the standby of a slot where it is stopped; return whether it was."""
    pid = locked_by(folder)
    if pid is None or not is_stopped(pid):
        return False
    _kill(pid, folder)
    return True


def _kill(pid: int, folder: ExperimentFolder) -> None:
    """Kill a process, unless it is not the standby: the number in the file may be wrong."""
    if pid > 1 and (sys.platform != "linux" or has_locked(pid, folder.standing_by.resolve())):
        with suppress(ProcessLookupError, PermissionError):
            os.kill(pid, signal.SIGKILL)


def await_standby(folder: ExperimentFolder) -> Finding | None:
    """Wait until the standbys of an earlier execution have ended; kill one that takes too long.

    Two processes must not command one robot. A standby that outlived its orchestrator may still be at work when the
    next execution begins. Return how long it was waited; None where there was no standby.

    Raises:
        ExecutionError: one is still there afterwards, as it is another user's process.
    """
    began = time.monotonic()
    # A list, not a generator: all of them are awaited.
    if not any([await_standby_at(slot) for slot in map(folder.at_slot, folder.used_slots())]):  # noqa: C419
        return None
    waited = time.monotonic() - began
    problem = f"an earlier execution was killed; its systems were still being made safe, which took {waited:.1f} s"
    return Finding.warning(str(folder.root), problem, "Check where the robot stands.")


def await_standby_at(slot: ExperimentFolder) -> bool:
    """Wait until a slot has no standby, and kill one that is stopped; return whether it was waited for."""
    began, stood_by, killed = time.monotonic(), False, 0
    while (pid := locked_by(slot)) is not None:
        if kill_if_stopped(slot):
            killed = pid
        stood_by = stood_by or pid != killed
        waited = time.monotonic() - began
        if waited > LONGEST:
            _kill(pid, slot)
        if waited > LONGEST + _DYING:
            problem = "systems of an earlier execution are still being made safe, and that cannot be ended from here"
            raise ExecutionError(problem, where=str(slot.root), fix=f"End process {pid} by hand.")
        time.sleep(LOOK)
    if was_open_to_strangers(slot.standing_by, slot.root):  # as earlier versions made it
        remove(slot.standing_by, slot.root)
    return stood_by
