"""Between two runs: the robot rests, or the user swaps its battery and says to go on."""

from __future__ import annotations

import os
import select
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.storage.control import Command, forget_command, take_command

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from robot_runner.execution.interruption import Interruption

__all__ = ["Patience", "rest", "wait_for_user"]

#: How often a second terminal is listened to, in seconds.
_LISTEN = 0.2


@dataclass(frozen=True, slots=True)
class Patience:
    """What goes on while the orchestrator waits.

    Attributes:
        refresh: called every `refresh_interval` seconds; never where that is None.
    """

    interruption: Interruption
    refresh: Callable[[], None]
    refresh_interval: float | None

    def wait(self, seconds: float, user_input: int | None = None) -> bytes | None:
        """Wait this long at most, for the user's interruption or input; return the latter, or None."""
        descriptors = [self.interruption.descriptor, *([] if user_input is None else [user_input])]
        readable, _, _ = select.select(descriptors, [], [], min(seconds, self.refresh_interval or seconds))
        if self.interruption.descriptor in readable:
            self.interruption.forget_wakeups()
        if self.refresh_interval is not None:
            self.refresh()
        return os.read(user_input, 4096) if user_input is not None and user_input in readable else None


def rest(seconds: float, patience: Patience) -> None:
    """Let this much real time go by, or less if the user interrupts."""
    end = time.monotonic() + seconds
    while not patience.interruption.is_requested and (left := end - time.monotonic()) > 0:
        patience.wait(left)


def wait_for_user(control: Path, user_input: int | None, patience: Patience) -> None:
    """Wait for a line on `user_input`, for `robot-runner continue` from elsewhere, or for an interruption."""
    forget_command(control)
    while not patience.interruption.is_requested:
        said = patience.wait(_LISTEN, user_input)
        if said == b"":  # the end of the input: nobody sits there any more
            user_input = None
        elif said is not None or take_command(control) is Command.CONTINUE:
            return
