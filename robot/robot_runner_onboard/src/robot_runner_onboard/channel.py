"""The worker's side of what a task's node and its worker say to each other.

The worker writes lines: `@ready` once it works, then `@done` or `@failed`, each with a text. It goes on until its
standard input ends, which also happens when its node dies: no task outlives its node.
"""

from __future__ import annotations

import select
import signal
import sys
import traceback
from contextlib import suppress
from typing import TYPE_CHECKING

from robot_runner_onboard.errors import TaskError

if TYPE_CHECKING:
    from typing import Callable, TextIO

__all__ = ["DONE", "FAILED", "READY", "Channel", "serve"]

READY, DONE, FAILED = "@ready", "@done", "@failed"


class Channel:
    """What a worker hears from its node and tells it.

    Args:
        orders: ends when the worker is to end; a file of the system, as `select` takes it.
        reports: takes what the worker says.
    """

    def __init__(self, orders: TextIO, reports: TextIO) -> None:
        self._orders = orders
        self._reports = reports

    def is_over(self, wait: float = 0.0) -> bool:
        """Whether the worker is to end, or is told so within this many seconds."""
        readable, _, _ = select.select([self._orders], [], [], max(0.0, wait))
        return bool(readable)

    def ready(self) -> None:
        """Say that the task is going on."""
        self.say(READY)

    def say(self, word: str, text: str = "") -> None:
        """Say something to the node; one that is gone needs to hear nothing."""
        with suppress(BrokenPipeError):
            print(word, " ".join(text.split()), file=self._reports, flush=True)


def serve(work: Callable[[Channel], str]) -> int:
    """Do a worker's work until its node has it end; return the exit code.

    Args:
        work: says `ready` once it works, returns what it did, and raises `TaskError` if it cannot go on.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the node, which then ends its worker
    channel = Channel(sys.stdin, sys.stdout)
    try:
        done = work(channel)
    except TaskError as error:
        channel.say(FAILED, str(error))
        return 1
    except Exception as error:  # noqa: BLE001 - whatever it is, the caller of the service must hear of it
        traceback.print_exc()
        channel.say(FAILED, f"{type(error).__name__}: {error}")
        return 1
    channel.say(DONE, done)
    return 0
