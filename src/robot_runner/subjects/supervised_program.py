"""One start of a program under its supervisor: the files of its output, and the supervisor's events about it."""

from __future__ import annotations

import fcntl
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Self

from robot_runner.core.errors import PluginError, StorageError
from robot_runner.core.execution.processes import FEWER_PROCESSES, needed_process
from robot_runner.core.links.commanded_topics import MAY_BE_MOVING
from robot_runner.core.links.ssh_command import gist, remedy, ssh_command
from robot_runner.core.storage.guarded_files import open_to_read, read_bytes
from robot_runner.core.storage.shared_claims import held_against_users
from robot_runner.core.words import listed, one_line
from robot_runner.subjects.orphans import end_orphans, mark_of, wake_supervisor
from robot_runner.subjects.remote_supervision import BOOTSTRAP, LEASE

#: How long a supervisor may take to start its program, s: here, and over a network.
_PATIENCE, _FAR_PATIENCE = 20.0, 40.0
#: How much longer than its own deadlines a supervisor may take to end everything, s. If the network is cut, a remote
#: one ends it once its lease is over.
_LAST_PATIENCE = 15.0
_LOOK = 0.01
#: How often a supervisor that has been asked to end its program is woken, in case somebody has stopped it, s.
_WAKE = 1.0
#: The fix where the folder of caches cannot be written.
NAME_A_FOLDER = "Set XDG_CACHE_HOME to a folder of your own."
#: How much of the end of an output is shown.
_SHOWN_BYTES, _SHOWN_LINES = 4096, 3
#: Fixes by the system's message for a program that could not be started.
_REMEDIES = {
    "Exec format error": "Give a script a first line such as #!/bin/sh; a program has to be built for this computer.",
    "Permission denied": "Make it executable: chmod +x.",
    "Resource temporarily unavailable": FEWER_PROCESSES,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """What is to be started, and how it is ended.

    Attributes:
        command: the program and its arguments.
        environment: variables in addition to the inherited ones; None removes one.
        folder: where it is executed; None for where Robot Runner is, or the user's home on another computer.
        stop_signal: the signal at which the program ends.
        stops_group: whether its whole process group gets that, as by Ctrl-C, instead of the program alone.
        grace_s: how long it may take for that, s.
        last: a command to execute once everything has ended.
        last_s: how long that may take, s.
        host: the computer in one of ssh's forms; None for this one.
        ssh_config: a file to use instead of the user's ssh config.
        lock: a file that is locked until everything has ended: the next start waits for the end of this one.
    """

    command: tuple[str, ...]
    environment: Mapping[str, str | None]
    folder: str | None = None
    stop_signal: signal.Signals = signal.SIGTERM
    stops_group: bool = False
    grace_s: float = 10.0
    last: tuple[str, ...] | None = None
    last_s: float = 60.0
    host: str | None = None
    ssh_config: Path | None = None
    lock: Path | None = None

    @property
    def ending_s(self) -> float:
        """How long its end may take, s."""
        return self.grace_s + (self.last_s if self.last else 0.0) + 2 * _LAST_PATIENCE

    def line(self, stdout: Path, stderr: Path) -> bytes:
        """Return the task as a line for the supervisor."""
        fields: dict[str, Any] = {
            "command": self.command,
            "environment": {**self.environment, **mark_of(stdout.parent)},
            "folder": self.folder,
            "stdout": str(stdout),
            "stderr": str(stderr),
            "stop_signal": int(self.stop_signal),
            "stops_group": self.stops_group,
            "grace": self.grace_s,
            "last": self.last,
            "last_seconds": self.last_s,
            "lease": None,
        }
        if self.host is not None:
            fields |= {"where": self.host, "ssh": ssh_command(self.host, BOOTSTRAP, config=self.ssh_config)}
        return json.dumps(fields).encode() + b"\n"


@dataclass(frozen=True, slots=True)
class Ended:
    """How a program ended.

    Attributes:
        code: its exit code; negative for the signal that ended it; None where that is unknown.
        how: the same in words.
        was_asked: whether we asked it to.
        was_killed: whether another signal than its stop signal was needed.
        cpu: the CPU time of the program and of the children that it awaited, s; None where that is unknown.
        astray: the CPU time until then of the other processes that it had started, s.
        uncounted: whether the system does not count the CPU time of its children, as it ignores their ends.
    """

    code: int | None
    how: str
    was_asked: bool = False
    was_killed: bool = False
    cpu: float | None = None
    astray: float = 0.0
    uncounted: bool = False


class Start:
    """The files of one start of a program; any process may read them while the program goes on.

    They are `stdout.txt`, `stderr.txt`, and the supervisor's `events.jsonl`.

    Attributes:
        begun_at: when it was started, on the monotonic clock; on another computer, when that was reported.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.begun_at = time.monotonic()
        self.stdout = folder / "stdout.txt"
        self.stderr = folder / "stderr.txt"
        self.events = folder / "events.jsonl"

    @property
    def pid(self) -> int | None:
        """The program's process id, on the computer where it is executed; None before it was started."""
        pid = self._told("started").get("started")
        return int(pid) if pid is not None else None

    @property
    def refusal(self) -> str:
        """Why it could not be started; empty where it could."""
        return str(self._told("refused").get("refused", ""))

    def ended(self) -> Ended | None:
        """Return how it ended, or None where it goes on."""
        supervised = self.is_supervised()  # before its events are read, the last of which it writes before it ends
        told = self._told("ended")
        if told:
            code = told["ended"]
            used = (told.get("cpu"), told.get("astray", 0.0), told.get("uncounted", False))
            return Ended(code, _how(code), bool(told["asked"]), bool(told["killed"]), *used)
        lost = self._told("lost")
        if lost:
            return Ended(None, f"the connection is lost: {gist(str(lost['lost']))}")
        return None if supervised else Ended(None, "its supervisor was killed")

    def remarks(self, *, may_drive: bool) -> list[str]:
        """Return what went wrong at the end: what could not be ended, or cleaned up, and may drive a robot."""
        left = self._told("gone").get("gone") or []
        unclean = self._told("unclean").get("unclean")
        told = [f"could not be ended with all that it started: process {listed(map(str, left))}"] if left else []
        told += [f"left something behind: {unclean}"] if unclean else []
        if self._told("lost").get("lost"):
            more = f", and commands the robot until then: {MAY_BE_MOVING}" if may_drive else ""
            told += [f"was out of reach when it was to end; it is ended there {LEASE:g} s after the connection{more}"]
        return told

    def await_end(self, seconds: float) -> None:
        """Wait until its supervisor has ended, for so long at most."""
        deadline = time.monotonic() + seconds
        while self.is_supervised() and time.monotonic() < deadline:
            time.sleep(_LOOK)

    def end_orphans(self) -> None:
        """End what its supervisor could not end because it was killed."""
        if not self.is_supervised() and not self._told("gone") and not self.refusal:
            end_orphans(self.folder)

    def last_lines(self) -> str:
        """Return the end of what it wrote to stderr, or else to stdout, on one line."""
        return last_lines_of(self.stderr, _SHOWN_LINES) or last_lines_of(self.stdout, _SHOWN_LINES)

    def death(self, name: str, ended: Ended) -> str:
        """Return the message about an unexpected end; `name` is the plugin's."""
        said = self.last_lines()
        return f"{name} has died: {ended.how}{f'; it wrote last: {said}' if said else ''}"

    def is_supervised(self) -> bool:
        """Whether its supervisor is alive, which it is until all that it started has ended."""
        try:
            with open_to_read(self.events) as file:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except (OSError, StorageError):
            return False
        return False

    def _told(self, kind: str) -> dict[str, Any]:
        """Return the supervisor's event of a kind; empty where there is none."""
        try:
            lines = read_bytes(self.events).split(b"\n")[:-1]
        except StorageError:
            return {}
        for line in lines:
            with suppress(ValueError, RecursionError):
                if isinstance(event := json.loads(line), dict) and kind in event:
                    return event
        return {}


class SupervisedProgram(Start):
    """A program that this process has started; its supervisor ends it with this process.

    `begun` is called with this, and the process id of the supervisor, which is always on this machine, before that
    starts anything.

    Raises:
        RobotRunnerError: it cannot be started.
    """

    def __init__(
        self, folder: Path, task: Task, *, name: str, begun: Callable[[Self, int], object] = lambda *_: None
    ) -> None:
        super().__init__(folder)
        folder.mkdir(parents=True, exist_ok=True)
        self._task = task
        self._name = name
        for path in (self.stdout, self.stderr):
            path.touch()
        module = "supervisor.py" if task.host is None else "remote_supervision.py"
        # Unbuffered, and isolated from modules in the folder in which it is started.
        words = [sys.executable, "-I", str(Path(__file__).with_name(module))]
        with self._turn() as turn, self.events.open("wb") as events, needed_process(name):
            self._supervisor = subprocess.Popen(  # noqa: S603 - our own program
                words,
                stdin=subprocess.PIPE,
                stdout=events,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
                pass_fds=[*turn, *held_against_users()],
            )
        begun(self, self._supervisor.pid)
        self._say(task.line(self.stdout, self.stderr))
        self._await_start()

    def stop(self) -> Ended:
        """End the program with everything that it started, and return how it ended; a second call returns the same."""
        if self._supervisor.stdin is not None and not self._supervisor.stdin.closed:
            self._say(b"stop\n")
            with suppress(OSError):
                self._supervisor.stdin.close()
        deadline = time.monotonic() + self._task.ending_s
        while self._supervisor.poll() is None:
            wake_supervisor(self.events)  # it may be stopped at any time
            with suppress(subprocess.TimeoutExpired):
                self._supervisor.wait(_WAKE)
            if time.monotonic() > deadline:
                self._supervisor.kill()
                self._supervisor.wait()
        self.end_orphans()
        return self.ended() or Ended(None, "it is not known how")

    @contextmanager
    def _turn(self) -> Iterator[tuple[int, ...]]:
        """Wait until an earlier start has ended; yield what the supervisor has to inherit to make a later one wait.

        After a run was killed, its supervisor may still be at work.
        """
        if self._task.lock is None:
            yield ()
            return
        deadline = time.monotonic() + self._task.ending_s

        def wait() -> None:
            if time.monotonic() > deadline:
                fix = f"Find the process that has this file open, and end it: lsof {self._task.lock}"
                raise PluginError("an earlier start of it goes on", where=self._name, fix=fix)
            time.sleep(_LOOK)

        with locked(self._task.lock, wait) as lock:
            yield (lock.fileno(),)

    def _say(self, data: bytes) -> None:
        pipe = self._supervisor.stdin
        with suppress(OSError):  # it has ended, which its events show
            if pipe is not None:
                pipe.write(data)
                pipe.flush()

    def _await_start(self) -> None:
        deadline = time.monotonic() + (_PATIENCE if self._task.host is None else _FAR_PATIENCE)
        while self.pid is None:
            ended = self.ended() if self._supervisor.poll() is not None or self.refusal else None
            is_late = ended is not None or time.monotonic() > deadline
            if is_late and self.pid is None:  # else it has begun, and perhaps ended, since it was looked for
                raise self._refused(ended)
            time.sleep(_LOOK)
        # The time for the supervisor, and a connection, does not count as the program's.
        steady = self._told("started").get("steady")
        self.begun_at = float(steady) if steady is not None and self._task.host is None else time.monotonic()

    def _refused(self, ended: Ended | None) -> PluginError:
        refusal, lost = self.refusal, str(self._told("lost").get("lost", ""))
        with suppress(ProcessLookupError):
            os.killpg(self._supervisor.pid, signal.SIGKILL)
        self._supervisor.wait()
        host = self._task.host
        if refusal:
            problem = f"{self._task.command[0]!r} cannot be started: {refusal}"
            fix = _REMEDIES.get(refusal, "Install it, or give its full path.")
            return PluginError(problem, where=self._name, fix=fix)
        if host is not None and lost:
            return PluginError(f"{host} cannot be reached: {gist(lost)}", where=self._name, fix=remedy(host, lost))
        problem = f"{self._task.command[0]!r} was not started: {ended.how if ended else 'its supervisor is silent'}"
        return PluginError(problem, where=self._name, fix="Execute it by hand to see why.")


def last_start(folder: Path) -> Start | None:
    """Return the last of the starts in a folder, which are numbered from 1; None where there is none."""
    starts = [path for path in folder.glob("*") if path.name.isdecimal()]
    return Start(max(starts, key=lambda path: int(path.name))) if starts else None


@contextmanager
def locked(path: Path, wait: Callable[[], object]) -> Iterator[IO[str]]:
    """Lock a file in the user's folder of caches; call `wait` repeatedly while another process has it locked.

    Raises:
        StorageError: the file cannot be made.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("w")
    except OSError as error:
        problem = f"your folder of caches cannot be written: {error.strerror}"
        raise StorageError(problem, where=str(path.parent), fix=NAME_A_FOLDER) from error
    with file:
        while True:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                wait()
        yield file


def last_lines_of(path: Path, most: int) -> str:
    """Return the last lines of a text file that are not blank, on one line; empty where it cannot be read."""
    try:
        with path.open("rb") as file:
            file.seek(max(0, path.stat().st_size - _SHOWN_BYTES))
            end = file.read().decode(errors="replace")
    except OSError:
        return ""
    lines = [line.strip() for line in end.splitlines() if line.strip()]
    return one_line(" | ".join(lines[-most:]))


def _how(code: int | None) -> str:
    if code is None:
        return "nothing could end it"
    if code >= 0:
        return f"exit code {code}"
    named = {each.value: each.name for each in signal.Signals}  # not all of those for real time have a name
    return f"{named.get(-code, f'signal {-code}')} ended it"
