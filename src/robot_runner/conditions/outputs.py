"""Conditions of files: a text in an output, a file that is complete."""

from __future__ import annotations

import codecs
import os
import re
import stat
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from robot_runner.core.design.numeric_range import is_number
from robot_runner.core.errors import ConditionError
from robot_runner.core.events.condition import Condition, Look, LookAgain
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.words import one_line

#: How much of a text is kept to be searched together with new text, characters: much longer than a line of a log.
_KEPT = 1 << 16
#: How much is read at once, bytes.
_CHUNK = 1 << 20
#: How much of the last read is compared to notice that a file was written anew, bytes.
_COMPARED = 256
#: How much of the last line is shown, characters.
_SHOWN = 80


def text_in(path: str | Path, text: str | re.Pattern[str], *, new_only: bool = False) -> Condition:
    """Return the condition that a file, such as the output of a program, holds a text.

    Args:
        path: the file, which need not exist yet; a relative path begins in the run's folder.
        text: a text, or a compiled regular expression.
        new_only: whether only text counts that is written after the wait has begun: for a file that is continued from
            run to run, such as a system log.

    Raises:
        ConditionError: it is not text, or an empty one.

    Example:
        >>> print(text_in("server/output.txt", "ready"))
        'ready' is in server/output.txt
    """
    pattern = re.compile(re.escape(text)) if isinstance(text, str) else text
    if not isinstance(pattern, re.Pattern) or not isinstance(pattern.pattern, str):
        fix = "Give text_in a text, or a pattern of text: re.compile('...')."
        raise ConditionError(f"{text!r} is not text", where=str(path), fix=fix)
    if not pattern.pattern:
        raise ConditionError("no text is looked for", where=str(path), fix="Give text_in a text that is not empty.")
    return _TextIn(Path(path), pattern, text if isinstance(text, str) else pattern.pattern, new_only)


def file_complete(path: str | Path, *, steady_s: float = 1.0, end: str | bytes | None = None) -> Condition:
    r"""Return the condition that a file is there and has been written to its end.

    Args:
        path: the file; a relative path begins in the run's folder.
        steady_s: for how long its size must not have changed, s of real time.
        end: what it ends with once it is complete, such as `b"</mission>\n"`; then its size need not be steady.

    Raises:
        ConditionError: the time is none, or the end is empty.

    Example:
        >>> print(file_complete("map.pgm"))
        map.pgm is complete (of one size for 1 s)
    """
    if end is not None and (not end or not isinstance(end, str | bytes)):
        raise ConditionError(f"no file ends with {end!r}", where=str(path), fix="Give a text, or leave it out.")
    if not is_number(steady_s) or steady_s < 0:
        raise ConditionError(f"steady_s is {steady_s!r}", where=str(path), fix="Give steady_s a number of seconds.")
    return _FileComplete(Path(path), steady_s, end.encode() if isinstance(end, str) else end)


@dataclass(frozen=True)
class _TextIn(Condition):
    path: Path
    pattern: re.Pattern[str]
    text: str
    new_only: bool

    is_outside = True

    def __str__(self) -> str:
        return f"{self.text!r} is in {self.path}"

    def watch(self, context: RobotRunnerContext, opened: ExitStack) -> LookAgain:
        del opened
        path = context.run_path / self.path
        reader = _GrowingText(path, self.pattern)
        if self.new_only:
            reader.skip()
        found = ""

        def look() -> Look:
            nonlocal found
            if not found:
                problem = reader.read()
                if reader.match is None:
                    return Look(holds=False, seen=problem or f"last line: {reader.last_line!r}")
                found = one_line(reader.match[0])[:_SHOWN]
            return Look(holds=True, seen=f"found {found!r}", value=found)

        return look


class _GrowingText:
    """Follows the text of a growing file until a pattern is found.

    Attributes:
        text: the latest part of it.
        match: of the pattern, once it was found.
    """

    def __init__(self, path: Path, pattern: re.Pattern[str]) -> None:
        self.text = ""
        self.match: re.Match[str] | None = None
        self._path, self._pattern = path, pattern
        self._place = 0
        self._file = (0, 0)
        self._read_last = b""
        self._decoder = codecs.getincrementaldecoder("utf-8")("replace")

    @property
    def last_line(self) -> str:
        """The last line that is not blank, in a form that can be shown."""
        lines = self.text[-4 * _SHOWN :].strip().splitlines()
        return one_line(lines[-1])[-_SHOWN:] if lines else ""

    def skip(self) -> None:
        """Skip the present content."""
        try:
            status = self._path.stat()
        except OSError:
            return
        self._file, self._place = (status.st_dev, status.st_ino), status.st_size

    def read(self) -> str:
        """Read what was added; return why nothing can be read, or empty."""
        try:
            # Non-blocking, should the file be a named pipe.
            descriptor = os.open(self._path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            return f"{self._path.name} cannot be read: {error.strerror}"
        try:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode):
                return f"{self._path.name} is not a file"
            self._go_to_place(descriptor, status)
            while self.match is None and (data := os.read(descriptor, _CHUNK)):
                self._place += len(data)
                self._read_last = (self._read_last + data)[-_COMPARED:]
                self.text = self.text[-_KEPT:] + self._decoder.decode(data)
                self.match = self._pattern.search(self.text)  # now, as the text is not kept as a whole
        finally:
            os.close(descriptor)
        return ""

    def _go_to_place(self, descriptor: int, status: os.stat_result) -> None:
        file = (status.st_dev, status.st_ino)
        begin = self._place - len(self._read_last)
        # Another file of this name, or one that was emptied, and may have grown beyond our place since.
        is_anew = status.st_size < self._place or os.pread(descriptor, len(self._read_last), begin) != self._read_last
        if file != self._file or is_anew:
            self._place, self._read_last, self.text = 0, b"", ""  # what stood there does not go on
            self._decoder.reset()
        self._file = file
        os.lseek(descriptor, self._place, os.SEEK_SET)


@dataclass(frozen=True)
class _FileComplete(Condition):
    path: Path
    steady_s: float
    end: bytes | None

    is_outside = True

    def __str__(self) -> str:
        return f"{self.path} is complete ({f'of one size for {self.steady_s:g} s' if self.end is None else 'it ends'})"

    def watch(self, context: RobotRunnerContext, opened: ExitStack) -> LookAgain:
        del opened
        path = context.run_path / self.path
        is_complete = self._is_steady() if self.end is None else self._has_end

        def look() -> Look:
            try:
                status = path.stat()
                if not stat.S_ISREG(status.st_mode):
                    return Look(holds=False, seen=f"{path.name} is not a file")
                return Look(is_complete(path, status), f"{status.st_size} bytes", status.st_size)
            except OSError as error:
                return Look(holds=False, seen=f"{path.name} cannot be read: {error.strerror}")

        return look

    def _is_steady(self) -> Callable[[Path, os.stat_result], bool]:
        seen: tuple[int, int, int] | None = None
        since = 0.0

        def is_steady(path: Path, status: os.stat_result) -> bool:
            nonlocal seen, since
            del path
            state = (status.st_ino, status.st_size, status.st_mtime_ns)
            if state != seen:
                seen, since = state, time.monotonic()
            return status.st_size > 0 and time.monotonic() - since >= self.steady_s

        return is_steady

    def _has_end(self, path: Path, status: os.stat_result) -> bool:
        end = self.end or b""
        if status.st_size < len(end):
            return False
        with path.open("rb") as file:
            file.seek(status.st_size - len(end))
            return file.read(len(end)) == end
