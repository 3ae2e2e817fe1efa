"""Programs that may outlive the run that started them, and are spared when its other processes are ended."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from robot_runner.core.storage.guarded_files import MissingFileError, make_experiment_folder, open_to_append, read_text

# The fields of /proc/<pid>/stat behind the program's name, from man 5 proc_pid_stat.
PARENT, GROUP, SESSION, STARTED = 1, 2, 3, 19


def process_stat(pid: int) -> list[str]:
    """Return the fields of a process after its name in `/proc/<pid>/stat`: state, parent, group, session, and so on.

    Empty where there is no such process, or no /proc (macOS).
    """
    try:
        text = Path(f"/proc/{pid}/stat").read_text(errors="replace")
    except OSError:
        return []
    return text.rpartition(")")[2].split()  # the second field is the name in brackets, and may hold anything


def is_stopped(pid: int) -> bool:
    """Return whether a process is stopped, by SIGSTOP or in a debugger (Linux)."""
    return process_stat(pid)[:1] in (["T"], ["t"])


def processes() -> Iterator[int]:
    """Yield the ids of all processes; none where there is no /proc (macOS)."""
    with suppress(FileNotFoundError):
        yield from map(int, filter(str.isdecimal, os.listdir("/proc")))  # noqa: PTH208 - a third of the time


def has_in_environment(pid: int, assignment: bytes) -> bool:
    """Return whether a process is alive and was started with a variable such as `b"NAME=value"` (Linux)."""
    try:
        environment = Path(f"/proc/{pid}/environ").read_bytes()
    except OSError:
        return False
    if assignment not in environment:  # nearly always
        return False
    stat = process_stat(pid)
    return bool(stat) and stat[0] != "Z" and assignment in environment.split(b"\0")


def ancestors(pid: int) -> Iterator[int]:
    """Yield a process, its parent, and so on."""
    while pid > 1:
        yield pid
        stat = process_stat(pid)
        pid = int(stat[PARENT]) if stat else 0


def spare(path: Path, pid: int) -> None:
    """Add to the file at `path` a process that, with all that it starts, may outlive its run.

    Raises:
        StorageError: the file cannot be written.
    """
    line = json.dumps([pid, _start_of(pid)]) + "\n"
    make_experiment_folder(path.parent)
    with open_to_append(path) as file:
        file.write(line.encode())


def outliving(path: Path) -> frozenset[int]:
    """Return the processes of the file at `path` that are alive and were started at the recorded time."""
    return frozenset(pid for pid, started in _read(path) if is_alive(pid) and _start_of(pid) == started)


def is_spared(pid: int, spared: frozenset[int]) -> bool:
    """Return whether a process is in `spared`, or was started by one of them: by descent, process group or session."""
    if not spared:
        return False
    stat = process_stat(pid)
    belongs = {int(stat[GROUP]), int(stat[SESSION])} if stat else set()
    return not spared.isdisjoint({*ancestors(pid), *belongs})


def _read(path: Path) -> Iterator[tuple[int, str]]:
    if not os.path.lexists(path):  # nearly always; a failing `open` takes twenty times as long
        return
    with suppress(MissingFileError):
        for line in read_text(path, errors="replace").splitlines():
            with suppress(ValueError, TypeError, OverflowError, RecursionError):  # torn by a power failure
                pid, started = json.loads(line)
                yield int(pid), str(started)


def program_name(pid: int) -> str | None:
    """Return the name of a process's program without its arguments; empty where it is not known, None if it is dead."""
    if not is_alive(pid) or process_stat(pid)[:1] == ["Z"]:
        return None
    with suppress(OSError):
        return Path(f"/proc/{pid}/comm").read_text(errors="replace").strip()
    return ""


def _start_of(pid: int) -> str:
    """Return when a process started, in clock ticks since boot: process ids are reused."""
    stat = process_stat(pid)
    return stat[STARTED] if stat else ""


def started_at(pid: int) -> str:
    """Return when a living process started, in clock ticks since boot; empty for a dead one, and without /proc."""
    return "" if process_stat(pid)[:1] in (["Z"], ["X"]) else _start_of(pid)


def is_alive(pid: int) -> bool:
    """Return whether there is a process with this id."""
    try:
        os.kill(pid, 0)
    except PermissionError:  # another user's
        return True
    except (ProcessLookupError, OverflowError, TypeError):
        return False
    return pid > 0
