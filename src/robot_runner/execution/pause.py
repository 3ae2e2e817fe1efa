"""Between two runs: the robot rests, or the user swaps its battery and says to go on."""

from __future__ import annotations

import os
import select
import time
from typing import TYPE_CHECKING

from robot_runner.storage.control import Command, forget_command, take_command

if TYPE_CHECKING:
    from pathlib import Path

    from robot_runner.execution.interruption import Interruption
    from robot_runner.execution.notices import Observer

__all__ = ["rest", "wait_for_user"]

#: How often a second terminal is listened to, in seconds.
_LISTEN = 0.2


def rest(seconds: float, interruption: Interruption, observer: Observer) -> None:
    """Let this much real time go by, or less if the user interrupts."""
    end = time.monotonic() + seconds
    while not interruption.is_requested and (left := end - time.monotonic()) > 0:
        _wait(min(left, observer.refresh_interval or left), interruption, None)
        observer.refresh()


def wait_for_user(control: Path, interruption: Interruption, observer: Observer) -> None:
    """Wait for a line on the observer's input, for `robot-runner continue` from elsewhere, or for an interruption."""
    forget_command(control)
    user_input = observer.user_input
    while not interruption.is_requested:
        said = _wait(min(_LISTEN, observer.refresh_interval or _LISTEN), interruption, user_input)
        if said == b"":  # the end of the input: nobody sits there any more
            user_input = None
        elif said is not None or take_command(control) is Command.CONTINUE:
            return
        observer.refresh()


def _wait(seconds: float, interruption: Interruption, user_input: int | None) -> bytes | None:
    descriptors = [interruption.descriptor] if user_input is None else [interruption.descriptor, user_input]
    readable, _, _ = select.select(descriptors, [], [], seconds)
    if interruption.descriptor in readable:
        interruption.forget_wakeups()
    return os.read(user_input, 4096) if user_input is not None and user_input in readable else None
