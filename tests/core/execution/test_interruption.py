"""Ctrl-C while the stop signals begin to be handled, or cease to be: a program is then as it was before."""

from __future__ import annotations

import contextlib
import os
import signal
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tests.instructions import Instructions

from robot_runner.core.execution import interruption
from robot_runner.core.execution.interruption import STOP_SIGNALS, Interruption

if TYPE_CHECKING:
    from types import FrameType


def _interrupted(at: int | None) -> int:
    """Press Ctrl-C at an instruction of entering or leaving; return how many there are."""

    def press(frame: FrameType) -> None:
        signal.getsignal(signal.SIGINT)(signal.SIGINT, frame)  # type: ignore[misc, operator]

    files = interruption.__file__, contextlib.__file__
    with suppress(KeyboardInterrupt), Instructions(*files, at=at, act=press) as counted, Interruption():
        pass
    return counted.count


def test_a_program_that_is_interrupted_anywhere_has_the_signals_and_descriptors_that_it_had() -> None:
    def state() -> tuple[Any, ...]:
        wakeup = signal.set_wakeup_fd(-1)
        signal.set_wakeup_fd(wakeup)
        opened = {os.readlink(path) for path in Path("/proc/self/fd").iterdir() if path.is_symlink()}  # noqa: PTH115
        return [signal.getsignal(each) for each in STOP_SIGNALS], wakeup, sorted(opened)

    before = state()
    count = _interrupted(None)
    for at in range(1, count + 1, 3):
        _interrupted(at)
        assert state() == before, at
