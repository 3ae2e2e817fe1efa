"""A meter that is a program: it is started, its output is read while it runs, and it is ended, by force if needed."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from robot_runner.core.errors import PluginError
from robot_runner.core.events.context import Clock
from robot_runner.core.execution.processes import stop_with_parent

#: How often output is read, s: the stamps of records are late by this much at most.
_LOOK = 0.01
#: How long a program may take after SIGTERM, which follows its own stop signal, before it is killed, s.
_LAST_GRACE = 1.0
#: How long to wait for the end of a process that was killed, s.
_DEATH = 5.0


@dataclass(frozen=True, slots=True)
class Record:
    """A piece of output, without the separator that ended it.

    Attributes:
        received_at: when it was read, s on the run's clock.
        text: its content.
        is_ended: whether a separator ended it; if not, the program ended within it, or writes no last separator.
    """

    received_at: float
    text: str
    is_ended: bool = True


@dataclass(frozen=True, slots=True)
class Ending:
    """How a program ended.

    Attributes:
        exit_code: its exit code; negative for the signal that ended it; None if nothing could end it.
        was_asked: whether it got the stop signal; False if it ended by itself before.
        was_killed: whether SIGKILL was needed.
        complaint: the last line that it wrote to stderr; empty for none.
    """

    exit_code: int | None
    was_asked: bool
    was_killed: bool
    complaint: str


class ChildProgram:
    """A program that is executed until it is stopped, by force if needed.

    In a process group of its own, it gets SIGTERM, on Linux, if this process dies before it could end it; in this
    process's group, it is ended with the group. Its stdin is a pipe that is never written to: so a program that ends at
    the end of its input ends with this process.

    Args:
        command: the program and its arguments.
        output: takes what it writes to stdout.
        errors: takes what it writes to stderr, and can be read; closed when the program has ended.
        has_own_group: whether it gets a process group of its own.
        environment: variables in addition to those of this process.

    Attributes:
        said: all that it wrote to stderr, once it was stopped.

    Raises:
        PluginError: it cannot be started.
    """

    def __init__(
        self,
        command: Sequence[str],
        *,
        output: IO[bytes],
        errors: IO[bytes],
        has_own_group: bool = True,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self._errors = errors
        self.said = ""
        self._ending: Ending | None = None
        try:
            self.process = subprocess.Popen(  # noqa: S603 - the user's own command
                command,
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=errors,
                env={**os.environ, **environment} if environment else None,
                process_group=0 if has_own_group else None,
                preexec_fn=stop_with_parent if has_own_group else None,  # noqa: PLW1509 - one system call, no lock
            )
        except OSError as error:
            errors.close()
            problem = f"{command[0]!r} cannot be started: {error.strerror}"
            raise PluginError(problem, where=" ".join(command), fix="Install it, or give its full path.") from error
        self._group = -self.process.pid if has_own_group else None

    @property
    def is_running(self) -> bool:
        """Whether it has not ended yet."""
        return self.process.poll() is None

    def wait(self, is_enough: Callable[[], bool], *, seconds: float) -> bool:
        """Wait for a condition, at most `seconds` of real time or until the program ends; return whether it holds."""
        deadline = time.monotonic() + seconds
        while not is_enough():
            if not self.is_running:
                time.sleep(2 * _LOOK)  # the last of its output may not have been read yet
                return is_enough()
            if time.monotonic() >= deadline:
                return False
            time.sleep(_LOOK)
        return True

    def stop(self, stop_signal: signal.Signals, *, grace: float) -> Ending:
        """End it and return how it ended; a second call returns the same.

        First the program alone gets its stop signal, so that it can end what it started itself; then its group gets
        SIGTERM, and then SIGKILL.

        Args:
            stop_signal: the signal at which it writes what it has, and ends.
            grace: how long it may take for that, s.
        """
        if self._ending is None:
            was_asked = self.is_running
            was_killed = was_asked and not self._end(stop_signal, grace)
            if self._group is not None:
                self._send(self._group, signal.SIGTERM)  # for processes that it may have left behind
            self._stop_following()
            if self.process.stdin is not None:
                self.process.stdin.close()
            self._is_gone_within(_DEATH)
            with self._errors:
                self._errors.seek(0)
                self.said = self._errors.read().decode(errors="replace")
            complaint = next((line.strip() for line in reversed(self.said.split("\n")) if line.strip()), "")
            self._ending = Ending(self.process.poll(), was_asked, was_killed, complaint)
        return self._ending

    def _stop_following(self) -> None:
        """Read the last of its output; does nothing here, where the output is not read."""

    def _end(self, stop_signal: signal.Signals, grace: float) -> bool:
        """Return whether it ended without being killed."""
        everything = self._group or self.process.pid
        self._send(self.process.pid, stop_signal)
        if self._is_gone_within(grace):
            return True
        self._send(everything, signal.SIGTERM)
        if self._is_gone_within(_LAST_GRACE):
            return True
        self._send(everything, signal.SIGKILL)
        return False

    def _is_gone_within(self, seconds: float) -> bool:
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(seconds)
            return True
        return False

    @staticmethod
    def _send(pid: int, number: signal.Signals) -> None:
        try:
            os.kill(pid, number)
        except ProcessLookupError:
            return
        except PermissionError:  # it was started by sudo
            command = ["sudo", "-n", "kill", f"-{number.name.removeprefix('SIG')}", "--", str(pid)]
            with suppress(OSError, subprocess.TimeoutExpired):
                subprocess.run(  # noqa: S603 - our own words
                    command, stdin=subprocess.DEVNULL, capture_output=True, timeout=_DEATH, check=False
                )


class MeterProcess(ChildProgram):
    """A program in a process group of its own, whose output is read from a file while it grows.

    Args:
        command: the program and its arguments.
        output: the file that it writes its records to; None for its stdout.
        folder: takes `stdout.txt` and `stderr.txt`.
        clock: the run's, for the stamps.
        separator: what ends a record.
        environment: variables beside those of this process.

    Attributes:
        unread: why its output cannot be read; empty where it can.

    Raises:
        PluginError: it cannot be started.
    """

    def __init__(
        self,
        command: Sequence[str],
        *,
        output: Path | None,
        folder: Path,
        clock: Clock,
        separator: str = "\n",
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self._output = output or folder / "stdout.txt"
        self._clock = clock
        self._separator = separator.encode()
        self._records: list[Record] = []
        self._rest = bytearray()  # what comes without a separator is added to it without copying it each time
        self.unread = ""
        self._offset = 0
        errors = (folder / "stderr.txt").open("w+b")
        with (folder / "stdout.txt").open("wb") as out:
            super().__init__(command, output=out, errors=errors, environment=environment)
        self._has_ended = threading.Event()
        self._follower = threading.Thread(target=self._follow, name=f"output of {command[0]}", daemon=True)
        self._follower.start()

    @property
    def records(self) -> list[Record]:
        """The output received so far, oldest first."""
        return list(self._records)

    def _stop_following(self) -> None:
        self._has_ended.set()
        self._follower.join()

    def _follow(self) -> None:
        while not self._has_ended.wait(_LOOK):
            self._take()
        self._take()
        if self._rest.strip():
            self._records.append(Record(self._clock.now(), self._rest.decode(errors="replace"), is_ended=False))

    def _take(self) -> None:
        try:
            with self._output.open("rb") as file:
                file.seek(self._offset)
                fresh = file.read()
        except FileNotFoundError:  # the program has not made it yet
            return
        except OSError as error:  # it may be another user's, where sudo starts the program
            self.unread = f"{self._output.name}: {error.strerror}"
            return
        self.unread = ""
        if not fresh:
            return
        now = self._clock.now()
        self._offset += len(fresh)
        sought_from = max(0, len(self._rest) - len(self._separator) + 1)
        self._rest += fresh
        if self._rest.find(self._separator, sought_from) >= 0:
            *whole, self._rest = self._rest.split(self._separator)
            self._records += [Record(now, piece.decode(errors="replace")) for piece in whole]
