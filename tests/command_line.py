"""The command line called as a user calls it, in this process or in a real terminal."""

from __future__ import annotations

import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pexpect
import pyte
import pytest
from tests.waiting import PATIENCE

from robot_runner.cli.main import main

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

#: Beside the interpreter: the console script of this very environment.
PROGRAM = str(Path(sys.executable).with_name("robot-runner"))


@dataclass(frozen=True)
class Answer:
    """What a command answered."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out)


@pytest.fixture
def robot_runner(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., Answer]:
    """Return what calls the program with these words, in the test's own folder."""
    monkeypatch.chdir(tmp_path)

    def call(*words: object) -> Answer:
        capsys.readouterr()
        code = main([str(word) for word in words])
        said = capsys.readouterr()
        return Answer(code, said.out, said.err)

    return call


@pytest.fixture
def program() -> str:
    """Return the path of the console script."""
    return PROGRAM


class Terminal:
    """A pseudo-terminal in which the program is executed, and the screen that a person would see."""

    timeout = pexpect.TIMEOUT

    def __init__(
        self,
        words: list[str],
        folder: Path,
        *,
        columns: int = 100,
        lines: int = 40,
        environment: dict[str, str] | None = None,
    ) -> None:
        self.raw = ""
        self.screen = pyte.Screen(columns, lines)
        self._stream = pyte.ByteStream(self.screen)
        self.child = pexpect.spawn(
            PROGRAM,
            words,
            cwd=str(folder),
            dimensions=(lines, columns),
            timeout=60,
            env={
                "TERM": "xterm-256color",
                "PATH": f"{Path(PROGRAM).parent}:/usr/bin:/bin",
                "HOME": str(folder),
                "LANG": "C.UTF-8",
                **(environment or {}),
            },
        )
        self.child.logfile_read = self

    def write(self, data: bytes) -> None:
        self.raw += data.decode("utf-8", "replace")
        self._stream.feed(data)

    def flush(self) -> None:
        """Nothing is kept back."""

    @property
    def text(self) -> str:
        return "\n".join(line.rstrip() for line in self.screen.display).rstrip()

    @property
    def cursor_was_hidden(self) -> bool:
        return "\x1b[?25l" in self.raw

    def wait_for(self, pattern: str) -> None:
        self.child.expect(pattern)

    def wait_until_shown(self, *parts: str, times: int = 1) -> None:
        """Wait until all of this is on the screen at the same time, so often: it may be drawn anew at any moment."""
        deadline = time.monotonic() + PATIENCE
        while any(self.text.count(part) < times for part in parts):
            assert time.monotonic() < deadline, f"{parts} never stood together on\n{self.text}"  # it is drawn all along
            self.child.expect(r"[\s\S]+")  # all of it: who reads more slowly than is written holds the program up

    def finish(self) -> int:
        self.child.expect(pexpect.EOF)
        self.child.close()
        assert self.child.exitstatus is not None, f"it was killed by signal {self.child.signalstatus}"
        return self.child.exitstatus


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Callable[..., Terminal]]:
    """Return what executes the program in a pseudo-terminal."""
    opened: list[Terminal] = []

    def execute(*words: object, **settings: Any) -> Terminal:
        opened.append(Terminal([str(word) for word in words], tmp_path, **settings))
        return opened[-1]

    yield execute
    for each in opened:
        each.child.close(force=True)
