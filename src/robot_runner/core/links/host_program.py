"""Executing a program to its end, with a deadline and a limit for its output."""

from __future__ import annotations

import errno
import io
import os
import selectors
import signal
import subprocess
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import IO

from robot_runner.core.errors import LinkError
from robot_runner.core.links.ssh_command import passes_login
from robot_runner.core.words import one_line

#: How many bytes are kept in memory of a program's output, and of its errors.
MOST_KEPT = 16_000_000
_CHUNK = 65536
#: The same, with what a login writes before the program.
_MOST_HELD = MOST_KEPT + 65536
#: How often it is checked whether the program has ended, and how large its output file is, s.
_LOOK = 0.1
#: How long a program may take to end once it is told to, s, before it is killed.
_GRACE = 3.0
_SHOWN = 60
#: Characters that a shell expands in a pattern; all others are quoted.
_PATTERN = frozenset("*?[]")


def shell_path(path: str, *, is_pattern: bool = False) -> str:
    r"""Return a path as one word of the shell, with the home folder for `~/`.

    Example:
        >>> shell_path("~/my logs/*.log", is_pattern=True)
        '"$HOME"/my\\ logs/*.log'
    """
    home, rest = ('"$HOME"/', path[2:]) if path.startswith("~/") else ("", path)
    kept = _PATTERN if is_pattern else frozenset()
    return home + "".join(
        each if each.isalnum() or each in "/._-" or each in kept else f"\\{each}" if each != "\n" else "'\n'"
        for each in rest
    )


def last_lines(text: str, count: int) -> str:
    """Return the last lines that a program wrote, on one line."""
    return one_line(" / ".join(line.strip() for line in text.strip().splitlines()[-count:]))


def shortened(command: str) -> str:
    """Return a command on one line, shortened for an error."""
    line = one_line(command.strip())
    return line if len(line) <= _SHOWN else f"{line[: _SHOWN - 1]}…"


@dataclass(frozen=True, slots=True)
class Ended:
    """How a program ended.

    Attributes:
        is_in_time: whether it ended before its deadline.
        is_too_much: whether it was ended because it wrote more than allowed.
        is_cut: whether it wrote more than is kept in memory: `output` and `errors` have the beginning.
        has_begun: whether its script was executed; else `output` has what was executed in its place.
    """

    exit_status: int
    output: str
    errors: str
    seconds: float
    is_in_time: bool = True
    is_too_much: bool = False
    is_cut: bool = False
    has_begun: bool = True


class Program:
    """A script of `for_any_shell` in a session of its own; whatever ends `follow` ends it.

    Args:
        line: program and arguments.
        source: its input.
        target: a file for its output, instead of memory; `follow` leaves it where the output of the script begins.
        most: how many bytes of output are allowed.
        has_lifeline: whether its input is a pipe that is closed when it is to end.

    Raises:
        LinkError: it cannot be started.
    """

    def __init__(
        self,
        line: Sequence[str],
        *,
        source: IO[bytes] | None = None,
        target: IO[bytes] | None = None,
        most: int = MOST_KEPT,
        has_lifeline: bool = False,
    ) -> None:
        self._target = target
        self._most = most
        self._kept: dict[int, bytearray] = {}
        self._is_cut = False
        self._started = time.monotonic()
        try:
            self._process = subprocess.Popen(  # noqa: S603 - an argument list
                list(line),
                stdin=subprocess.PIPE if has_lifeline else source or subprocess.DEVNULL,
                stdout=target or subprocess.PIPE,
                stderr=subprocess.PIPE,
                start_new_session=True,
            )
        except OSError as error:
            is_long = error.errno == errno.E2BIG
            fix = "Shorten the command: copy a script there." if is_long else "Install it, or correct the PATH."
            raise LinkError(f"{line[0]} cannot be started: {error.strerror}", where="host", fix=fix) from error

    def follow(self, timeout_s: float) -> Ended:
        """Read its output until it ends, and end it if it takes too long or writes too much."""
        process = self._process
        both = (process.stdout, process.stderr)
        streams = list(filter(None, both))
        self._kept = {each.fileno(): bytearray() for each in streams}
        output, errors = (self._kept[each.fileno()] if each is not None else bytearray() for each in both)
        with selectors.DefaultSelector() as selector:
            for each in streams:
                selector.register(each, selectors.EVENT_READ)
            try:
                is_in_time = self._take_until(self._started + timeout_s, selector)
                is_too_much = self._is_too_much()
                if not is_in_time or is_too_much:
                    self._close_lifeline()
                    self._take_until(time.monotonic() + _GRACE if process.stdin else 0.0, selector, most=None)
            finally:
                self._end()
        said = io.BytesIO(output) if self._target is None else self._target
        if not (has_begun := passes_login(said)):
            said.seek(0)
        is_in_target = has_begun and self._target is not None
        written = "" if is_in_target else self._first_of(said)
        return Ended(
            process.returncode,
            written,
            self._first_of(io.BytesIO(errors)),
            time.monotonic() - self._started,
            is_in_time,
            is_too_much,
            self._is_cut,
            has_begun,
        )

    def _take_until(self, deadline: float, selector: selectors.BaseSelector, most: int | None = 0) -> bool:
        """Read until it ends; return whether that was before the deadline, and before it wrote too much."""
        while True:
            left = deadline - time.monotonic()
            has_ended = self._process.poll() is not None
            ready = selector.select(0 if has_ended else max(0.0, min(left, _LOOK))) if selector.get_map() else []
            for key, _ in ready:
                self._take(key.fd, key.fileobj, selector)
            if has_ended and not ready:  # programs that it left may keep its output open: they are not awaited
                return True
            if not selector.get_map() and not has_ended:
                with suppress(subprocess.TimeoutExpired):
                    self._process.wait(max(0.0, min(left, _LOOK)))
            if most is not None and self._is_too_much():
                return True
            if left <= 0 and not has_ended:
                return False

    def _take(self, descriptor: int, stream: object, selector: selectors.BaseSelector) -> None:
        data = os.read(descriptor, _CHUNK)
        if not data:
            selector.unregister(stream)  # type: ignore[arg-type] # what was registered
            return
        kept = self._kept[descriptor]
        self._is_cut |= len(kept) + len(data) > _MOST_HELD
        kept += data[: _MOST_HELD - len(kept)]

    def _first_of(self, said: IO[bytes]) -> str:
        first = said.read(MOST_KEPT)
        self._is_cut |= bool(said.read(1))
        return first.decode(errors="backslashreplace")

    def _is_too_much(self) -> bool:
        return self._target is not None and os.fstat(self._target.fileno()).st_size > self._most

    def _close_lifeline(self) -> None:
        if self._process.stdin is not None:
            with suppress(OSError):
                self._process.stdin.close()

    def _end(self) -> None:
        self._close_lifeline()
        if self._process.poll() is None:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        for each in filter(None, (self._process.stdout, self._process.stderr)):
            each.close()
