"""The firmware, built from its source and executed in simavr on a board whose sensor sees known currents."""

from __future__ import annotations

import json
import math
import mmap
import shutil
import struct
import subprocess
import time
from collections import deque
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.measuring.serial_line import Chunk

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.measuring.serial_line import SerialPort

ROOT = Path(__file__).parents[2]
FIRMWARE = ROOT / "firmware" / "ina219"
_BOARD = Path(__file__).parent / "board"
_DEADLINE = 300.0  # real seconds
_PAGE = struct.Struct("dddd")  # as board.c says


def missing_tools() -> str:
    """Return what is missing to build and execute the firmware, with the packages to install, or nothing."""
    wanted = {"avr-gcc": "gcc-avr avr-libc", "cc": "gcc", "make": "make"}
    packages = [package for program, package in wanted.items() if shutil.which(program) is None]
    packages += [] if Path("/usr/include/simavr/sim_avr.h").exists() else ["libsimavr-dev"]
    return f"not installed (Debian: apt install {' '.join(packages)})" if packages else ""


@dataclass(frozen=True)
class Build:
    """What was built: the firmware and the program that executes it."""

    firmware: Path
    board: Path


def build(folder: Path) -> Build:
    """Build both in a folder.

    Raises:
        AssertionError: a compiler refused; what it said is in the message.
    """
    firmware, board = build_firmware(folder), folder / "board"
    sources = [str(source) for source in sorted(_BOARD.glob("*.c"))]
    _execute(["cc", "-O2", "-std=gnu11", "-Wall", "-Wextra", "-Werror", "-o", str(board), *sources, "-lsimavr", "-lm"])
    return Build(firmware, board)


def build_firmware(folder: Path, *, flags: str = "") -> Path:
    """Build the firmware alone, with other settings, say; raises as `build` does."""
    _execute(["make", "-s", "-C", str(FIRMWARE), f"BUILD={folder}", f"FLAGS={flags}"])
    return folder / "ina219.elf"


def _execute(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, timeout=_DEADLINE, check=False)
    if done.returncode:
        raise AssertionError(done.stdout + done.stderr)


class BoardClock:
    """The board's time as a run's clock: it goes by only while it is slept on, as fast as the simulation can.

    Once it watches a line, the board's time stands still until the line has taken what was sent, so that nothing
    depends on how fast or how busy this machine is.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        file.write_bytes(_PAGE.pack(0.0, 0.0, -1.0, 0.0))
        with file.open("r+b") as opened:
            self._page = mmap.mmap(opened.fileno(), _PAGE.size)
        self._beyond = 0.0  # what was slept after the board had ended
        self.process: subprocess.Popen[str] | None = None
        self._line: SerialPort | None = None

    def now(self) -> float:
        return float(_PAGE.unpack(self._page)[0]) + self._beyond

    def sleep(self, seconds: float) -> None:
        target = self.now() + max(seconds, 0.0)
        self._page[8:16] = struct.pack("d", target - self._beyond)
        deadline = time.monotonic() + _DEADLINE
        while self.now() < target:
            if self.process is None or self.process.poll() is not None:
                self._beyond += target - self.now()
                self._await_loss(deadline)
                return
            if time.monotonic() > deadline:
                raise AssertionError(f"the board has not reached {target} s within {_DEADLINE} real seconds")
            time.sleep(0.001)

    def await_closing(self, count: int) -> None:
        """Wait until the board has noticed that its port was closed so often, and is ready to be opened again."""
        deadline = time.monotonic() + _DEADLINE
        while _PAGE.unpack(self._page)[3] < count and time.monotonic() < deadline:
            time.sleep(0.001)

    def _await_loss(self, deadline: float) -> None:
        """Wait until the line has noticed that the board is gone."""
        while self._line is not None and self._line._failure is None and time.monotonic() < deadline:
            time.sleep(0.001)

    def go_on(self) -> None:
        """Have the board's time go by itself from here on, as far as `show_taken` lets it."""
        self._page[8:16] = struct.pack("d", math.inf)

    def show_taken(self, count: int) -> None:
        """Have the board wait until so many bytes were handed over; to be called before its line is opened, too."""
        self._page[16:24] = struct.pack("d", count)

    def watch(self, line: SerialPort) -> None:
        """Have the board wait for this line; to be called when it was just opened, before the first sleep."""
        line._chunks = _Taken(self._page)
        self._line = line


class _Taken(deque[Chunk]):
    """What a line has taken, counted where the board sees it."""

    def __init__(self, page: mmap.mmap) -> None:
        super().__init__()
        self._page = page
        self._count = 0
        self._show()

    def append(self, chunk: Chunk) -> None:
        super().append(chunk)
        self._count += len(chunk.data)
        self._show()

    def _show(self) -> None:
        self._page[16:24] = struct.pack("d", self._count)


class Board:
    """A board that is being executed; `port` is where its serial line is."""

    def __init__(self, process: subprocess.Popen[str], port: str, clock: BoardClock | None) -> None:
        self.port = port
        self._process = process
        self._clock = clock
        self._facts: dict[str, Any] | None = None

    @property
    def clock(self) -> BoardClock:
        """The board's time; only of a board that was given one."""
        assert self._clock is not None
        return self._clock

    def facts(self) -> dict[str, Any]:
        """Wait until the board has ended and return what it says: seconds, bytes, corrupted, lamp."""
        if self._facts is None:
            said, _ = self._process.communicate(timeout=_DEADLINE)
            assert self._process.returncode == 0, "the firmware broke down"
            self._facts = json.loads(said)
        return self._facts

    def kill(self) -> None:
        """Pull the cable out."""
        self._process.kill()
        self._process.wait(_DEADLINE)


@contextmanager
def executed(built: Build, *, clock: BoardClock | None = None, **settings: object) -> Iterator[Board]:
    """Execute the firmware; it is switched on when its port is opened.

    Args:
        built: what `build` returned.
        clock: shows the board's time and holds it; without one it goes by itself.
        settings: as the board's program takes them, such as `load="0:0.7,15:0.95"`; None leaves one out.
    """
    given = {**settings, "firmware": built.firmware, "clock": clock.file if clock else None}
    words = [f"--{name.replace('_', '-')}={value}" for name, value in given.items() if value is not None]
    command = [str(built.board), *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            port = process.stdout.readline().strip()
            assert port, "the board did not start"
            if clock is not None:
                clock.process = process
            yield Board(process, port, clock)
        finally:
            process.kill()
