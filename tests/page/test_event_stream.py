"""Server-sent events: what a viewer is sent, in which order."""

from __future__ import annotations

import asyncio
import threading
from typing import Any

from robot_runner.page.event_stream import Channel, EventStream


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


def test_nothing_is_left_of_viewers_who_have_gone() -> None:
    """In Python 3.11 each went on for ever, unseen, until the page had answered 400 of them and nobody any more."""

    async def gone() -> None:
        channel = Channel(EndingExperiment(), every=0.01)
        left = asyncio.Event()

        async def receive() -> dict[str, str]:
            await left.wait()
            return {"type": "http.disconnect"}

        async def send(message: dict[str, Any]) -> None:
            if message["type"] == "http.response.body":
                left.set()  # as the viewer is sent something
                await asyncio.sleep(0)

        for _ in range(20):
            left.clear()
            await EventStream(channel, {})({"type": "http"}, receive, send)
        channel.stop()

    asyncio.run(asyncio.wait_for(gone(), 60))
