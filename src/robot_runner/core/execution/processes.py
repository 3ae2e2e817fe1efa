"""System calls around processes: forking, exiting, parents, orphans, process groups."""

from __future__ import annotations

import ctypes
import os
import select
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from io import TextIOWrapper
from pathlib import Path
from typing import NoReturn, TextIO

from robot_runner.core.errors import ExecutionError
from robot_runner.core.execution.run_records import FINISHED, failure_fields
from robot_runner.core.execution.task import Report
from robot_runner.core.storage.masked_log import MaskedText
from robot_runner.core.storage.outliving import GROUP, PARENT, SESSION, is_alive, is_spared, process_stat, processes

#: How often it is checked whether a process has ended, where nothing can be polled, s.
_LOOK = 0.02
#: One poll waits no longer, s: its limit is 24 days.
_A_DAY = 86_400.0

# From <linux/prctl.h>; Python's library has no prctl.
_PR_SET_PDEATHSIG = 1
_PR_SET_CHILD_SUBREAPER = 36
_prctl = None
if sys.platform == "linux":
    _prctl = ctypes.CDLL(None).prctl
    _prctl.argtypes = [ctypes.c_int, *[ctypes.c_ulong] * 4]


def adopt_orphans() -> None:
    """Become the parent of orphaned descendants, whatever their session (Linux only)."""
    if _prctl is not None:
        _prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def stop_with_parent() -> None:
    """Let the system send SIGTERM to this process when its parent dies (Linux only)."""
    if _prctl is not None:
        _prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)


def memory_kills() -> int:
    """Return how many processes the system has killed for lack of memory since it was started; 0 except on Linux."""
    with suppress(OSError, ValueError):
        counters = Path("/proc/vmstat").read_text(encoding="ascii")
        return int(counters.partition("\noom_kill ")[2].partition("\n")[0])
    return 0


class _Part:
    """Whether this process was forked as a part of the experiment: a keeper, a standby, a watcher.

    It then handles stop signals as the orchestrator does, unlike a process that a callback has forked.
    """

    is_one = False


def is_part() -> bool:
    """Return whether this process was made by `forked`, and has not become a run."""
    return _Part.is_one


def begin_run_of_its_own() -> None:
    """Note that this process is a run from now on: its later forks are those of callbacks."""
    _Part.is_one = False


def forked() -> int:
    """Fork a part of the experiment, as `os.fork`, without the warning of libraries that have threads in C.

    Raises:
        ExecutionError: the system refuses another process.
    """
    parent, was = os.getpid(), _Part.is_one
    _Part.is_one = True  # before the fork: a signal may come in the first moment of the new process
    try:
        if sys.version_info < (3, 12) or threading.active_count() > 1:
            return os.fork()
        # Python counts the threads of C libraries (OpenBLAS), too, and warns; these libraries can be forked.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            return os.fork()
    except OSError as error:
        raise no_process(error) from error
    finally:
        if os.getpid() == parent:
            _Part.is_one = was


#: The fix where the system has no process, descriptor or memory left.
FEWER_PROCESSES = (
    "End other programs, use fewer workers, or raise the limits of processes and open files (ulimit -u, ulimit -n)."
)


def no_process(error: OSError, purpose: str = "the run") -> ExecutionError:
    """Return the error for a system that has no process, descriptor or memory left for some purpose."""
    problem = f"no process can be started for {purpose}: {error.strerror}"
    return ExecutionError(problem, where="this machine", fix=FEWER_PROCESSES)


@contextmanager
def needed_process(purpose: str) -> Iterator[None]:
    """Raise an error with a fix where the system refuses to fork another process.

    Raises:
        ExecutionError: the system has no process, descriptor or memory left for it.
    """
    try:
        yield
    except OSError as error:
        raise no_process(error, purpose) from error


def leave_after(work: Callable[[], None], report: Report) -> NoReturn:
    """Do the work of a forked process and exit, without the clean-up that is the orchestrator's."""
    code = 1
    try:
        work()
        code = 0
    except BaseException as error:  # noqa: BLE001 - the last resort: it must be reported before the process ends
        report("failure", {"event": "", "owner": "", **failure_fields(error)})
        report(FINISHED, {})  # otherwise the exit code would be reported as a second failure
    finally:
        try:
            sys.stdout.flush()
            sys.stderr.flush()
        finally:  # also where the disk is full, or a callback closed a stream or took it away
            os._exit(code)


def flush_streams() -> None:
    """Flush what was printed; a callback may have closed or replaced a stream."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, OSError, ValueError):
            stream.flush()


def settle_streams() -> None:
    """Print line by line, in UTF-8, to the original streams: the orchestrator's screen may have replaced them.

    Values of the environment that are secret are masked.
    """
    # Both names: the stream beneath is closed with the last of them.
    sys.stdout = sys.__stdout__ = _settled(sys.__stdout__)  # type: ignore[assignment, misc]
    sys.stderr = sys.__stderr__ = _settled(sys.__stderr__)  # type: ignore[assignment, misc]
    sys.stdin = sys.__stdin__


def _settled(stream: TextIO | None) -> TextIO | None:
    if not isinstance(stream, TextIOWrapper):
        return stream
    with suppress(OSError):  # a full disk, which the orchestrator reports
        stream.flush()
    return MaskedText(stream.detach(), encoding="utf-8", errors="backslashreplace", line_buffering=True)


def use_no_streams() -> None:
    """Close the inherited streams: a program that reads the orchestrator's output must not wait for this process."""
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
    """Yield the ids of this process's children, adopted ones included; none where there is no /proc (macOS)."""
    own = str(os.getpid())
    return (pid for pid in processes() if process_stat(pid)[PARENT:GROUP] == [own])


def group_ended(leader: int, grace: float, spared: Callable[[], frozenset[int]]) -> Iterator[float]:
    """Ask a process that is not our child to stop; kill it, and its group, when it has not after `grace` seconds.

    Yields how long to wait each time, s. `leader` is also the id of the group; `spared` returns its processes that may
    go on.
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
        os.killpg(leader, 0)  # nearly always no process is left, and `spared` need not read its file
        if not (going_on := spared()):
            os.killpg(leader, signal.SIGKILL)
            return
        for pid in processes():
            if process_stat(pid)[GROUP:SESSION] == [str(leader)] and not is_spared(pid, going_on):
                try_kill(pid)


def try_kill(pid: int) -> bool:
    """Kill a process; return False where that is not allowed (it became another user by `sudo`), or it is gone."""
    try:
        os.kill(pid, signal.SIGKILL)
    except (PermissionError, ProcessLookupError):
        return False
    return True


def await_end(pid: int, seconds: float | None = None) -> bool:
    """Wait until a process has ended, if only as a zombie; return whether it has within `seconds` (at most a day)."""
    return bool(await_an_end([pid], seconds))


def await_an_end(pids: Collection[int], seconds: float | None = None) -> list[int]:
    """Wait until one of several processes has ended; return those that have, of none within `seconds` nothing."""
    poll, watched = select.poll(), dict[int, int]()
    with ExitStack() as opened:
        for pid in pids:
            try:
                descriptor = end_descriptor(pid)
            except ProcessLookupError:
                return [pid]
            if descriptor is not None:
                opened.callback(os.close, descriptor)
                poll.register(descriptor, select.POLLIN)
                watched[descriptor] = pid
        if len(watched) == len(pids):
            ready = poll.poll(None if seconds is None else min(seconds, _A_DAY) * 1000)
            return [watched[descriptor] for descriptor, _ in ready]
    deadline = None if seconds is None else time.monotonic() + seconds
    while not (ended := [pid for pid in pids if not _goes_on(pid)]):
        if deadline is not None and time.monotonic() >= deadline:
            break
        time.sleep(_LOOK)
    return ended


def end_descriptor(pid: int) -> int | None:
    """Return a descriptor that can be read once a process has ended; None where the system has none.

    These are macOS, Linux before 5.3 (such as JetPack 4), containers that refuse it, and no descriptor that is free.

    Raises:
        ProcessLookupError: there is no such process.
    """
    try:
        return os.pidfd_open(pid)
    except ProcessLookupError:
        raise
    except (AttributeError, OSError):
        return None


def _goes_on(pid: int) -> bool:
    if stat := process_stat(pid):
        return stat[0] not in {"Z", "X"}  # a zombie is not reaped here: its exit status is for its parent
    with suppress(ChildProcessError):  # macOS
        return os.waitpid(pid, os.WNOHANG) == (0, 0)
    return is_alive(pid)
