"""Processes that a run left alive without a keeper: found by their marks, awaited, and ended.

A keeper ends all that its run started. Where the keeper was killed, two marks tell which processes are the run's:

- the keeper, the run, and what they fork hold a lock on one file in the experiment's folder, as long as they live;
- programs that they start have an environment variable with that folder.

So the run itself, the orchestrator, or the next execution of the experiment can do the keeper's work.

While runs are executed on other machines, a mark in the folder says where, and for how long they may go on once nobody
looks after them. Probes, gates and reboots have the same marks, in a folder of their own in the experiment folder.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import re
import shutil
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path

from robot_runner.core.errors import ExecutionError, Finding, StorageError
from robot_runner.core.execution.clock_jumps import now_counting_suspension
from robot_runner.core.storage.guarded_files import MissingFileError, open_descriptor, read_bytes, read_text, remove
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.lock_files import open_to_lock, this_boot, was_open_to_strangers
from robot_runner.core.storage.outliving import (
    ancestors,
    has_in_environment,
    is_spared,
    is_stopped,
    outliving,
    processes,
)

_VARIABLE = "ROBOT_RUNNER_RUN_OF"
#: How often it is checked whether a process has ended, and how long those that were killed may take, s.
_LOOK, _DYING = 0.05, 5.0
#: The longest text that is read as a process id, in bytes.
_DIGITS = 20
#: How the names of folders begin in which probes, gates and reboots are executed.
ASIDE = ".aside-"
#: How the name of a mark of runs elsewhere begins; the session follows, and answers to it have a longer name.
MARK_OF_ELSEWHERE = ".probe-"
_ELSEWHERE = re.compile(r"\.probe-[0-9a-f]{16}")
#: The largest mark that is read, bytes; the time for one that cannot be read, and the longest that is believed, s.
_MOST_BYTES, _USUAL, _LONGEST = 4096, 60.0, 86400.0
#: A damaged mark may name any number; no clock shows a moment so far from 1970, s.
_NO_MOMENT = 1e11


class RunMark:
    """The marks of one run: made before its keeper is forked, so that keeper and run inherit them.

    Attributes:
        descriptor: of the file that is locked; a process that replaces itself hands it on.

    Raises:
        StorageError: the folder's file system offers no locks of this kind.
    """

    def __init__(self, folder: ExperimentFolder) -> None:
        self._mark = _mark(folder)
        self.descriptor = open_to_lock(folder.alive, folder.root)
        # Unlike that of the experiment, this lock is held by every process that has the descriptor, inherited or not.
        try:
            fcntl.flock(self.descriptor, fcntl.LOCK_SH)
        except OSError as error:  # some offer the locks of `ExperimentLock` only
            os.close(self.descriptor)
            problem = f"the folder's file system offers no locks: {error.strerror}"
            fix = "Keep the results on a local disk (results_output_path)."
            raise StorageError(problem, where=str(folder.alive), fix=fix) from error

    def sign(self) -> None:
        """Mark this process as the run, and the programs that it starts from now on."""
        os.environ[_VARIABLE] = self._mark
        if sys.platform != "linux":  # there, the system sends no signal to a run whose parent dies
            os.ftruncate(self.descriptor, 0)
            os.pwrite(self.descriptor, str(os.getpid()).encode(), 0)

    def close(self) -> None:
        """Close the file in this process: the others still hold the lock."""
        os.close(self.descriptor)


@lru_cache(maxsize=16)
def _mark(folder: ExperimentFolder) -> str:
    """Return the value of the variable, which differs by slot: runs in flight at other slots are not left over."""
    root = str(folder.root.resolve())
    return root if folder.slot == 1 else f"{root}#{folder.slot}"


def marked_folders(folder: ExperimentFolder) -> list[ExperimentFolder]:
    """Return the folders with marks of an experiment: those of its slots, and those of probes, gates and reboots."""
    asides = [ExperimentFolder(path) for path in sorted(folder.root.glob(f"{ASIDE}*")) if not path.is_symlink()]
    return [*map(folder.at_slot, folder.used_slots()), *asides]


def left_processes(folder: ExperimentFolder) -> list[int]:
    """Return the processes that runs at a slot left alive, without those that may outlive them (Linux)."""
    name = os.fsencode(f"{_VARIABLE}={_mark(folder)}")
    alive = folder.alive.resolve()
    spared = outliving(folder.outliving)
    own = set(ancestors(os.getpid()))
    found = [pid for pid in processes() if pid not in own and (has_locked(pid, alive) or has_in_environment(pid, name))]
    return [pid for pid in found if not is_spared(pid, spared)]


def end_left_processes(folder: ExperimentFolder) -> list[int]:
    """Kill the processes that runs of this experiment left alive at a slot of this machine; return them."""
    killed: list[int] = []
    for seconds in left_processes_ended(folder, killed):
        time.sleep(seconds)
    return sorted(set(killed))


def left_processes_ended(folder: ExperimentFolder, killed: list[int]) -> Iterator[float]:
    """Do the same step by step: yield how long to wait each time, s; `killed` takes the processes."""
    deadline = time.monotonic() + _DYING
    while (pids := left_processes(folder)) and time.monotonic() < deadline:
        for pid in pids:
            with suppress(ProcessLookupError, PermissionError):
                os.kill(pid, signal.SIGKILL)
        killed += pids
        yield _LOOK


def await_left_processes(folder: ExperimentFolder, grace: float) -> Finding | None:
    """Wait for the processes that an earlier execution left alive, and end them, before anything is executed.

    A run gets SIGTERM and has `grace` seconds to close what it opened; then all that is left is killed. Return what was
    awaited and killed; None where nothing was alive.

    Raises:
        ExecutionError: it is still alive afterwards; that takes a system without /proc, or another user's process.
    """
    began = time.monotonic()
    slots = marked_folders(folder)
    alive = [slot for slot in slots if is_alive(slot)]
    was_alive = bool(alive)
    for slot in alive:
        _ask_to_stop(slot)
    _wait(lambda: not any(map(is_alive, alive)), grace)
    seconds = time.monotonic() - began
    killed = sorted(pid for slot in slots for pid in end_left_processes(slot))
    if was_alive and not _wait(lambda: not any(map(is_alive, alive)), _DYING):
        problem = "a run of an earlier execution is still alive, and cannot be ended from here"
        fix = "End it by hand: it has the file .alive in this folder open."
        raise ExecutionError(problem, where=str(folder.root), fix=fix)
    for slot in slots:
        if was_open_to_strangers(slot.alive, folder.root):  # as earlier versions made it; one could lock it for ever
            remove(slot.alive, folder.root)
        if slot.root != folder.root:  # a temporary folder
            shutil.rmtree(slot.root, ignore_errors=True)
    if not (was_alive or killed):
        return None
    count = sum(slot.root == folder.root for slot in alive)
    runs = f"{count} of its runs were still alive and were" if count > 1 else "its run was still alive and was"
    if not count:
        runs = "its work beside runs was still going on and was"
    waited = f"{runs} waited for ({seconds:.1f} s)" if was_alive else "its run had ended"
    left = f"; what was left of it was killed: {', '.join(map(str, killed))}" if killed else ""
    return Finding.warning(str(folder.root), f"an earlier execution was killed; {waited}{left}")


@dataclass(frozen=True, slots=True)
class RunsElsewhere:
    """Runs that other machines may go on with after their execution was killed.

    Attributes:
        where: as findings name it.
        seconds: for how long they may go on once nobody looks after them.
    """

    where: str
    seconds: float

    def content(self) -> bytes:
        """Return the bytes of the mark: the facts, by which clock it is stamped, and a number that nobody can guess."""
        clock = {"boot": this_boot(), "booted_at": time.time() - now_counting_suspension()}
        return json.dumps({**asdict(self), **clock, "number": os.urandom(32).hex()}).encode()

    @property
    def finding(self) -> Finding:
        """The warning while they are awaited."""
        problem = (
            f"an earlier execution was killed; its runs may go on there for {self.seconds:g} s, and none is begun "
            "before that"
        )
        fix = f"Where you know that none of them goes on, remove {MARK_OF_ELSEWHERE}* from the folder beforehand."
        return Finding.warning(self.where, problem, fix)


def runs_elsewhere(folder: ExperimentFolder) -> list[RunsElsewhere]:
    """Return the runs that may go on elsewhere, one for each execution over other machines that did not end."""
    return [_elsewhere(path, folder) for path in _marks_of_elsewhere(folder)]


def go_on_elsewhere(folder: ExperimentFolder) -> bool:
    """Return whether other machines may still execute runs: their orchestrator renews the mark with their leases."""
    marks = _marks_of_elsewhere(folder)
    return any(abs(_seconds_since_renewal(mark, folder)) < _elsewhere(mark, folder).seconds for mark in marks)


def renew_mark(mark: Path, folder: ExperimentFolder) -> None:
    """Stamp a mark of runs elsewhere with the present moment: they are still supervised.

    The stamp is of the clock as it was set when the mark was made, so that setting it changes nothing.

    Raises:
        OSError: it cannot be stamped.
    """
    now = _now_by_clock_of(mark, folder)
    os.utime(mark, None if now is None else (now, now), follow_symlinks=False)


def _seconds_since_renewal(mark: Path, folder: ExperimentFolder) -> float:
    now, stamps = _now_by_clock_of(mark, folder), mark.lstat()
    return time.time() - stamps.st_ctime if now is None else now - stamps.st_mtime


def _now_by_clock_of(mark: Path, folder: ExperimentFolder) -> float | None:
    """Return the present moment by the clock as it was set when a mark was made, s; None if that is not known.

    It is not after a reboot, or on another machine: the steady clock is another one there.
    """
    match _facts_of(mark, folder):
        case {"boot": str(boot), "booted_at": float() as booted_at} if boot and boot == this_boot():
            return booted_at + now_counting_suspension() if abs(booted_at) < _NO_MOMENT else None
    return None


def _marks_of_elsewhere(folder: ExperimentFolder) -> list[Path]:
    return [path for path in sorted(folder.root.iterdir()) if _ELSEWHERE.fullmatch(path.name)]


def _elsewhere(mark: Path, folder: ExperimentFolder) -> RunsElsewhere:
    match _facts_of(mark, folder):
        case {"where": str(where), "seconds": int() | float() as seconds} if 0 <= seconds <= _LONGEST:
            return RunsElsewhere(where, float(seconds))
    return RunsElsewhere("another machine", _USUAL)


def _facts_of(mark: Path, folder: ExperimentFolder) -> object:
    with suppress(StorageError, ValueError, RecursionError):
        return json.loads(read_bytes(mark, folder.root, limit=_MOST_BYTES))
    return None


def forget_runs_elsewhere(folder: ExperimentFolder, *, but: Path | None = None) -> None:
    """Remove the marks of runs elsewhere, except `but`, and the answers to them."""
    for path in folder.root.glob(f"{MARK_OF_ELSEWHERE}*"):
        if path != but:
            remove(path, folder.root)


def _wait(is_so: Callable[[], bool], seconds: float) -> bool:
    deadline = time.monotonic() + seconds
    while not is_so():
        if time.monotonic() >= deadline:
            return False
        time.sleep(_LOOK)
    return True


def is_alive(folder: ExperimentFolder) -> bool:
    """Whether a keeper, a run, or what they forked is alive; what may outlive its run does not count."""
    if not _is_locked(folder.alive, folder.root):
        return False
    holders, spared = _holders(folder.alive), outliving(folder.outliving)
    if not holders:  # none is visible: there is no /proc, or it is another user's process
        return not (sys.platform == "linux" and was_open_to_strangers(folder.alive, folder.root))
    return not all(is_spared(pid, spared) or is_stopped(pid) for pid in holders)


def is_subject_left(folder: ExperimentFolder) -> bool:
    """Whether software under test of `per="experiment"` is still alive or being ended, or its robot being stopped.

    Its supervisor holds the lock of a file in the folder of its start for as long as that takes. One that is stopped
    does not count, as of a run: the next execution ends it.
    """
    return any(_is_locked_by_us(path, folder.root) for path in folder.subjects.glob("*/*/*.jsonl"))


def _is_locked_by_us(path: Path, root: Path) -> bool:
    with suppress(OSError, StorageError):  # no file that a start has written
        return _is_locked(path, root) and (sys.platform != "linux" or not all(map(is_stopped, _holders(path))))
    return False


def _holders(path: Path) -> list[int]:
    """Return the other processes that hold the lock of a file; another user's are not seen."""
    locked = path.resolve()
    return [pid for pid in processes() if pid != os.getpid() and has_locked(pid, locked)]


def _is_locked(path: Path, root: Path) -> bool:
    try:
        descriptor = open_descriptor(path, root, os.O_RDWR)
    except MissingFileError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno in {errno.EACCES, errno.EAGAIN}
    finally:
        os.close(descriptor)
    return False


def _ask_to_stop(folder: ExperimentFolder) -> None:
    """Send SIGTERM to the run, unless it has ended; on Linux the system did so when its keeper died (an empty file)."""
    with suppress(OSError, StorageError, ValueError, OverflowError):
        run = int(read_text(folder.alive, folder.root, limit=_DIGITS))
        if run > 1 and os.getpgid(run) == run:
            os.kill(run, signal.SIGTERM)


def has_locked(pid: int, path: Path) -> bool:
    """Return whether a process holds the lock of a file (Linux); having it open, as an editor does, is not enough."""
    # Each execution looks at every file of every process: thousands, for which `Path` takes four times as long.
    folder, locked = f"/proc/{pid}/fd", str(path)
    try:
        return any(_is_lock(folder, name, locked) for name in os.listdir(folder))  # noqa: PTH208
    except OSError:  # it has ended, or is another user's
        return False


def _is_lock(folder: str, name: str, locked: str) -> bool:
    try:
        if os.readlink(f"{folder}/{name}") != locked:  # noqa: PTH115
            return False
        return "FLOCK" in Path(f"{folder}info/{name}").read_text()
    except OSError:  # closed meanwhile
        return False
