"""Server-sent events of followed experiments: computed once for all viewers, and never blocked by a slow one."""

from __future__ import annotations

import asyncio
import itertools
import json
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from robot_runner.core.storage.declared_shapes import finite
from robot_runner.page.followed_experiment import FollowedExperiment

if TYPE_CHECKING:
    from starlette.types import Receive, Scope, Send

#: How often a followed experiment is looked at, s: what is recorded is seen within a second.
_EVERY = 0.25
#: The same where there is more to read, s: time for other tasks.
_AT_ONCE = 0.01
#: Without viewers for this long, an experiment is no longer followed, s; its rows are dropped later.
_PATIENCE = 20.0
#: How many messages a viewer may be behind before it has to begin anew.
_MOST_BEHIND = 32
#: How often a message tells pages that the connection is alive, s; how long a viewer may take nothing, s.
_KEEP_ALIVE, _DEAD = 15.0, 30.0
_MOST_FOLLOWED = 24

_encode = json.JSONEncoder(ensure_ascii=False, separators=(",", ":"), allow_nan=False, default=str).encode


def as_json(value: object) -> bytes:
    """Return a value as compact JSON in UTF-8; numbers that JSON does not have, such as infinity, as text."""
    try:
        text = _encode(value)
    except ValueError:
        text = _encode(finite(value))
    return text.encode("utf-8", "replace")


def _event(name: str, data: object) -> bytes:
    # Compact JSON has no line ends, so that an event is one line.
    return b"event: " + name.encode() + b"\ndata: " + as_json(data) + b"\n\n"


class Viewer:
    """A viewer's queue of messages."""

    def __init__(self) -> None:
        self._messages: asyncio.Queue[bytes] = asyncio.Queue()

    def put(self, message: bytes) -> None:
        """Add a message; a viewer who is too far behind gets a request to begin anew instead."""
        if self._messages.qsize() >= _MOST_BEHIND:
            while not self._messages.empty():
                self._messages.get_nowait()
            message = _event("again", {})
        self._messages.put_nowait(message)

    async def get(self) -> bytes:
        """Return all waiting messages; if none came for a while, one that says that this server is there."""
        try:
            async with asyncio.timeout(_KEEP_ALIVE):
                first = await self._messages.get()
        except TimeoutError:
            return _event("here", {})
        rest = [self._messages.get_nowait() for _ in range(self._messages.qsize())]
        return b"".join([first, *rest])


class Followed(Protocol):
    """Something that can be followed, with its parts by name."""

    @property
    def is_behind(self) -> bool:
        """Whether there is more to read at once."""

    def look(self) -> Mapping[str, Any]:
        """Read what is new; return the parts that may have changed."""

    def snapshot(self) -> Mapping[str, Any]:
        """Return all parts."""


class Channel:
    """Something followed, its viewers, and the task that looks at it while there are any."""

    def __init__(self, followed: Followed, every: float) -> None:
        self._followed, self._every = followed, every
        self._viewers: set[Viewer] = set()
        self._last: dict[str, bytes] = {}
        self._task: asyncio.Task[None] | None = None
        #: Held from a look or a snapshot until it is sent, so that nobody is told an earlier state after a later one.
        self._turn = asyncio.Lock()
        self.used_at = time.monotonic()
        self.has_looked = asyncio.Event()

    def __len__(self) -> int:
        return len(self._viewers)

    def wake(self) -> None:
        """Start the task, if it does not run; without viewers it ends after a while."""
        self.used_at = time.monotonic()
        if self._task is None or self._task.done():
            self.has_looked.clear()
            self._task = asyncio.create_task(self._follow())

    async def join(self) -> Viewer:
        """Return a new viewer, with the snapshot as its first message."""
        self.wake()
        await self.has_looked.wait()
        viewer = Viewer()
        async with self._turn:
            for name, data in (await asyncio.to_thread(self._followed.snapshot)).items():
                viewer.put(_event(name, data))
            self._viewers.add(viewer)
        return viewer

    def leave(self, viewer: Viewer) -> None:
        """Remove a viewer."""
        self._viewers.discard(viewer)
        self.used_at = time.monotonic()

    def stop(self) -> None:
        """Look no more."""
        if self._task is not None:
            self._task.cancel()

    async def _follow(self) -> None:
        while self._viewers or time.monotonic() - self.used_at < _PATIENCE:
            async with self._turn:
                self._tell(await asyncio.to_thread(self._followed.look))
            self.has_looked.set()
            await asyncio.sleep(_AT_ONCE if self._followed.is_behind else self._every)
        self.has_looked.clear()

    def _tell(self, parts: Mapping[str, Any]) -> None:
        for name, data in parts.items():
            message = _event(name, data)
            # Rows are changes; all other parts are complete, and sent only if they differ.
            if name == "rows" or self._last.get(name) != message:
                if name != "rows":
                    self._last[name] = message
                for viewer in self._viewers:
                    viewer.put(message)


class Followers:
    """The experiments with viewers, each followed once."""

    def __init__(self) -> None:
        self._followed: dict[Path, tuple[FollowedExperiment, Channel]] = {}

    @property
    def viewers(self) -> int:
        """The number of viewers."""
        return sum(len(channel) for _, channel in self._followed.values())

    def channel(self, folder: Path) -> tuple[FollowedExperiment, Channel]:
        """Return a followed experiment and its channel, which is made at first use."""
        if folder not in self._followed:
            self._make_room()
            experiment = FollowedExperiment(folder)
            self._followed[folder] = (experiment, Channel(experiment, _EVERY))
        return self._followed[folder]

    async def looked_at(self, folder: Path) -> FollowedExperiment:
        """Return an experiment after a look at it, for a single request."""
        experiment, channel = self.channel(folder)
        channel.wake()
        await channel.has_looked.wait()
        return experiment

    def close(self) -> None:
        """Look no more."""
        for _, channel in self._followed.values():
            channel.stop()

    def _make_room(self) -> None:
        idle = sorted(
            (folder for folder, (_, channel) in self._followed.items() if not len(channel)),
            key=lambda each: self._followed[each][1].used_at,
        )
        for folder in itertools.islice(idle, max(0, len(self._followed) - _MOST_FOLLOWED + 1)):
            self._followed.pop(folder)[1].stop()


class EventStream:
    """A response of server-sent events, until the viewer leaves.

    https://html.spec.whatwg.org/multipage/server-sent-events.html

    Args:
        channel: the followed experiment or list.
        headers: of the response.
    """

    def __init__(self, channel: Channel, headers: Mapping[str, str]) -> None:
        self._channel = channel
        self._headers = headers

    async def __call__(self, _scope: Scope, receive: Receive, send: Send) -> None:
        """Send the snapshot, and then all messages."""
        head = {
            **self._headers,
            "content-type": "text/event-stream",
            "cache-control": "no-store",
            "x-accel-buffering": "no",
        }
        raw = [(name.encode(), value.encode()) for name, value in head.items()]
        await send({"type": "http.response.start", "status": 200, "headers": raw})
        viewer = await self._channel.join()
        leaving = asyncio.create_task(_left(receive))
        sending = asyncio.create_task(_send_all(viewer, send))
        try:
            await asyncio.wait({leaving, sending}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._channel.leave(viewer)
            for task in (leaving, sending):
                task.cancel()
                with suppress(asyncio.CancelledError, OSError, TimeoutError):
                    await task


async def _left(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass


async def _send_all(viewer: Viewer, send: Send) -> None:
    while True:
        body = await viewer.get()
        # Not `wait_for`: that of Python 3.11 swallows a cancellation that comes as it ends.
        async with asyncio.timeout(_DEAD):
            await send({"type": "http.response.body", "body": body, "more_body": True})
