"""What the processes of a run need of the operating system: forking, leaving, parents, orphans, groups."""

from __future__ import annotations

import ctypes
import os
import select
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from io import TextIOWrapper
from typing import NoReturn, TextIO

from robot_runner.core.errors import ExecutionError
from robot_runner.core.execution.run_records import FINISHED, failure_fields
from robot_runner.core.execution.task import Report
from robot_runner.core.storage.masked_log import MaskedText
from robot_runner.core.storage.outliving import (
    GROUP,
    PARENT,
    SESSION,
    is_alive,
    is_spared,
    process_stat,
    processes,
)

#: Where nothing wakes us, we look this often, in seconds.
_LOOK = 0.02
#: A poll cannot wait longer than 24 days, s.
_A_DAY = 86_400.0

# From <linux/prctl.h>; Python's library has no prctl.
_PR_SET_PDEATHSIG = 1
_PR_SET_CHILD_SUBREAPER = 36
_prctl = None
if sys.platform == "linux":
    _prctl = ctypes.CDLL(None).prctl
    _prctl.argtypes = [ctypes.c_int, *[ctypes.c_ulong] * 4]


def adopt_orphans() -> None:
    """Become the parent of whatever a descendant leaves behind when it ends, whatever its session (Linux only)."""
    if _prctl is not None:
        _prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def stop_with_parent() -> None:
    """Have SIGTERM sent to this process when its parent dies (Linux only)."""
    if _prctl is not None:
        _prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)


class _Part:
    """Whether this process was forked to be a part of the experiment: a keeper, a standby, who watches a deadline.

    It then takes stop signals as the orchestrator does, and not as a process that a callback has forked.
    """

    is_one = False


def is_part() -> bool:
    """Whether this process was made by `forked`, and has not begun to be a run."""
    return _Part.is_one


def begin_run_of_its_own() -> None:
    """Be a run from now on: what it forks is forked by callbacks."""
    _Part.is_one = False


def forked() -> int:
    """Fork a part of the experiment, as `os.fork`, without the warning of libraries that have threads in C.

    Raises:
        ExecutionError: the system refuses another process.
    """
    parent, was = os.getpid(), _Part.is_one
    _Part.is_one = True  # before the fork: a signal may come in the first moment of the new process
    try:
        return _forked()
    finally:
        if os.getpid() == parent:
            _Part.is_one = was


def _forked() -> int:
    try:
        if sys.version_info < (3, 12) or threading.active_count() > 1:
            return os.fork()
        # Python counts the threads of C libraries (OpenBLAS) as well and warns; these know how to be forked.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            return os.fork()
    except OSError as error:
        raise no_process(error) from error


def no_process(error: OSError) -> ExecutionError:
    """Return the error that the process of a run cannot be started, as the system allows no more of something."""
    fix = (
        "End other programs, use fewer workers, or raise the limits of processes and open files (ulimit -u, ulimit -n)."
    )
    return ExecutionError(f"no process can be started for the run: {error.strerror}", where="this machine", fix=fix)


def leave_after(work: Callable[[], None], report: Report) -> NoReturn:
    """Do the work of a forked process and leave it; nothing of the orchestrator's is executed or cleaned up here."""
    code = 1
    try:
        work()
        code = 0
    except BaseException as error:  # noqa: BLE001 - the last resort: it must be known before the process ends
        report("failure", {"event": "", "owner": "", **failure_fields(error)})
        report(FINISHED, {})  # the exit code that follows says less
    finally:
        try:
            sys.stdout.flush()
            sys.stderr.flush()
        finally:  # also where the disk is full, or a callback closed a stream or took it away
            os._exit(code)


def flush_streams() -> None:
    """Hand what was printed to the system; a callback may have closed a stream, or taken it away."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, OSError, ValueError):
            stream.flush()


def settle_streams() -> None:
    """Print line by line, in UTF-8, and not on the orchestrator's screen, which may stand in for the streams.

    Reading a line from its keyboard would draw that screen, too. What the environment keeps secret is not printed.
    """
    # Both names: the stream beneath is closed with the last of them.
    sys.stdout = sys.__stdout__ = _settled(sys.__stdout__)  # type: ignore[assignment, misc]
    sys.stderr = sys.__stderr__ = _settled(sys.__stderr__)  # type: ignore[assignment, misc]
    sys.stdin = sys.__stdin__


def _settled(stream: TextIO | None) -> TextIO | None:
    if not isinstance(stream, TextIOWrapper):
        return stream
    with suppress(OSError):  # a full disk: the orchestrator has said so
        stream.flush()
    return MaskedText(stream.detach(), encoding="utf-8", errors="backslashreplace", line_buffering=True)


def use_no_streams() -> None:
    """Let go of the inherited streams: a program that reads the orchestrator's output must not wait for our end."""
    nothing = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        os.dup2(nothing, descriptor)
    os.close(nothing)


def has_children() -> bool:
    """Reap the children that have ended, and return whether any is left."""
    try:
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass
    except ChildProcessError:
        return False
    return True


def children() -> Iterator[int]:
    """Return the ids of this process's children, of adopted ones too; of none where there is no /proc (macOS)."""
    own = str(os.getpid())
    return (pid for pid in processes() if process_stat(pid)[PARENT:GROUP] == [own])


def group_ended(leader: int, grace: float, spared: Callable[[], frozenset[int]]) -> Iterator[float]:
    """Ask a process that is not our child to stop; kill it, and its group, when it has not after `grace` seconds.

    Yields how long to wait each time, s.

    Args:
        leader: the id of the process, and of its group.
        grace: how long it may take.
        spared: returns those of the group that may go on.
    """
    deadline = time.monotonic() + grace
    with suppress(ProcessLookupError):
        os.kill(leader, signal.SIGTERM)
        while time.monotonic() < deadline:
            yield _LOOK
            os.kill(leader, 0)  # raises once the process is gone
    kill_group(leader, spared)


def kill_group(leader: int, spared: Callable[[], frozenset[int]]) -> None:
    """Kill the rest of a process group, except the processes that `spared` returns and their descendants."""
    with suppress(ProcessLookupError, PermissionError):  # macOS: no permission where all of them are zombies
        os.killpg(leader, 0)  # nearly always nobody is left, and `spared` has not to be asked
        if not (going_on := spared()):
            os.killpg(leader, signal.SIGKILL)
            return
        for pid in processes():
            if process_stat(pid)[GROUP:SESSION] == [str(leader)] and not is_spared(pid, going_on):
                is_killed(pid)


def is_killed(pid: int) -> bool:
    """Kill a process and return whether that is allowed: one that became another user by `sudo` stays."""
    try:
        os.kill(pid, signal.SIGKILL)
    except (PermissionError, ProcessLookupError):
        return False
    return True


def ends(pid: int, seconds: float | None = None) -> bool:
    """Wait until a process has ended, as a zombie too; return whether it has within so many seconds, a day at most."""
    if hasattr(os, "pidfd_open"):
        try:
            descriptor = os.pidfd_open(pid)
        except ProcessLookupError:
            return True
        poll = select.poll()
        poll.register(descriptor, select.POLLIN)
        has_ended = bool(poll.poll(None if seconds is None else min(seconds, _A_DAY) * 1000))
        os.close(descriptor)
        return has_ended
    deadline = None if seconds is None else time.monotonic() + seconds
    while _goes_on(pid):  # macOS
        if deadline is not None and time.monotonic() >= deadline:
            return False
        time.sleep(_LOOK)
    return True


def _goes_on(pid: int) -> bool:
    with suppress(ChildProcessError):
        return os.waitpid(pid, os.WNOHANG) == (0, 0)
    return is_alive(pid)
