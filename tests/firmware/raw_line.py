"""The bytes of a board's line, without the profiler, beside those that were sent before they were corrupted."""

from __future__ import annotations

import os
from contextlib import contextmanager
from typing import TYPE_CHECKING

from robot_runner.meters.ina219.frames import FrameDecoder

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.firmware.simulated_board import Board

    from robot_runner.meters.ina219.frames import Frame


@contextmanager
def opened(board: Board) -> Iterator[int]:
    """Open the board's line, which switches the board on, and close it."""
    line = os.open(board.port, os.O_RDWR | os.O_NOCTTY)
    try:
        yield line
    finally:
        os.close(line)


def read_until_unplugged(board: Board) -> bytes:
    """Return all that is sent until the board ends, which waits for us: what is not read by then is lost."""
    received = b""
    board.clock.show_taken(0)
    board.clock.go_on()
    with opened(board) as line:
        while piece := _read(line):
            received += piece
            board.clock.show_taken(len(received))
    return received


def _read(line: int) -> bytes:
    """Return what has arrived; nothing where the other end is gone, whether that happens now or has happened before."""
    try:
        return os.read(line, 65536)
    except OSError:
        return b""


def decoded(data: bytes) -> list[Frame]:
    """Return the frames that the plugin finds."""
    decoder = FrameDecoder()
    return decoder.feed(data) + decoder.finish()


def intact(true: bytes, received: bytes) -> tuple[list[Frame], int]:
    """Return the frames of which no byte was changed on the way, and how many were hit.

    Bytes are changed and never lost, so a frame stands where it stood.
    """
    frames: list[Frame] = []
    at, hit = 0, 0
    while at + 8 <= len(received) and at + 8 + true[at + 3] <= len(received):
        end = at + 8 + true[at + 3]
        if true[at:end] == received[at:end]:
            frames += FrameDecoder().feed(true[at:end])
        else:
            hit += 1
        at = end
    return frames, hit
