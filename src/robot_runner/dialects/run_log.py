"""What `before_run` prints belongs to the run's log, though it is called before the run has its process."""

from __future__ import annotations

import io
import os
import sys
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from typing import TYPE_CHECKING, Any, TextIO

from robot_runner.storage.run_folders import open_log

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.storage.layout import ExperimentFolder

__all__ = ["printed_to_log"]


@contextmanager
def printed_to_log(folder: ExperimentFolder) -> Iterator[None]:
    """Have what is printed go to the log of the run that begins; the user sees it where the user is asked something."""
    terminal, keyboard = sys.stdout, sys.stdin
    with os.fdopen(open_log(folder), "a", encoding="utf-8", errors="backslashreplace") as log:
        said = _Said(log)
        sys.stdin = _Asking(keyboard, said, terminal)
        try:
            with redirect_stdout(said), redirect_stderr(said):
                yield
        finally:
            sys.stdin = keyboard


class _Said(io.TextIOBase):
    """Writes to the log, and remembers what the user has not seen."""

    def __init__(self, log: TextIO) -> None:
        self._log = log
        self.unseen: list[str] = []

    def writable(self) -> bool:
        return True

    def write(self, text: str) -> int:
        self.unseen.append(text)
        return self._log.write(text)

    def flush(self) -> None:
        if not self._log.closed:
            self._log.flush()


class _Asking(io.TextIOBase):
    """A keyboard: whoever reads from it first shows what was said, as a question may be part of it."""

    def __init__(self, keyboard: Any, said: _Said, terminal: TextIO) -> None:
        self._keyboard = keyboard
        self._said = said
        self._terminal = terminal

    def readable(self) -> bool:
        return True

    def readline(self, size: int | None = -1, /) -> str:  # type: ignore[override] # a text stream's own
        self._show()
        return str(self._keyboard.readline(-1 if size is None else size))

    def read(self, size: int | None = -1, /) -> str:
        self._show()
        return str(self._keyboard.read(-1 if size is None else size))

    def fileno(self) -> int:
        return int(self._keyboard.fileno())

    def isatty(self) -> bool:
        return bool(self._keyboard.isatty())

    def _show(self) -> None:
        self._terminal.write("".join(self._said.unseen))
        self._terminal.flush()
        self._said.unseen.clear()
