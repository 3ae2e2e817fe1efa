"""How the orchestrator waits: the user may interrupt, and screens go on."""

from __future__ import annotations

import os
import select
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.core.execution.interruption import Interruption

__all__ = ["Patience"]


@dataclass(frozen=True, slots=True)
class Patience:
    """What goes on while the orchestrator waits.

    Attributes:
        refresh: called every `refresh_interval` seconds; never where that is None.
    """

    interruption: Interruption
    refresh: Callable[[], None]
    refresh_interval: float | None

    def refresh_screen(self) -> None:
        """Bring a live screen up to date."""
        if self.refresh_interval is not None:
            self.refresh()

    def wait(self, seconds: float, user_input: int | None = None) -> bytes | None:
        """Wait this long at most, for the user's interruption or input; return the latter, or None."""
        descriptors = [self.interruption.descriptor, *([] if user_input is None else [user_input])]
        readable, _, _ = select.select(descriptors, [], [], min(seconds, self.refresh_interval or seconds))
        if self.interruption.descriptor in readable:
            self.interruption.forget_wakeups()
        self.refresh_screen()
        return os.read(user_input, 4096) if user_input is not None and user_input in readable else None

    def rest(self, seconds: float) -> None:
        """Let this much real time go by, or less if the user interrupts."""
        end = time.monotonic() + seconds
        while not self.interruption.is_requested and (left := end - time.monotonic()) > 0:
            self.wait(left)
