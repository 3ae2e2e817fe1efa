"""Server-sent events: what a viewer is sent, in which order."""

from __future__ import annotations

import asyncio
import threading
from typing import Any

from robot_runner.page.event_stream import Channel


class EndingExperiment:
    """An experiment that ends while a new viewer's snapshot of it is taken."""

    is_behind = False

    def __init__(self) -> None:
        self._word = "running"
        self._snapshot_is_taken, self._has_ended = threading.Event(), threading.Event()

    def look(self) -> dict[str, Any]:
        if self._snapshot_is_taken.is_set():
            self._word = "done"
            self._has_ended.set()
        return {"state": self._word}

    def snapshot(self) -> dict[str, Any]:
        taken = {"state": self._word}
        self._snapshot_is_taken.set()
        self._has_ended.wait(0.2)  # on a busy machine, until others have looked again
        return taken


def test_a_viewer_who_comes_while_an_experiment_ends_is_told_so_last() -> None:
    async def told() -> bytes:
        channel = Channel(EndingExperiment(), every=0.01)
        viewer = await channel.join()
        messages = b""
        while b"done" not in messages or b"running" not in messages:
            messages += await viewer.get()
        channel.stop()
        return messages

    messages = asyncio.run(asyncio.wait_for(told(), 60))
    assert messages.index(b"running") < messages.index(b"done")
