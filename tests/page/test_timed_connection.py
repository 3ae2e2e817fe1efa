"""When a connection of the live page is closed by itself, with a loop whose time a test moves on."""

from __future__ import annotations

import asyncio
import socket
from typing import TYPE_CHECKING, Any

import pytest

pytest.importorskip("uvicorn", reason="the extra 'page' is not installed")

import uvicorn
from uvicorn.server import ServerState

from robot_runner.page.timed_connection import TimedConnection

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

BEGUN = b"POST /api/login HTTP/1.1\r\nHost: lab\r\nContent-Length: 9\r\n\r\n"
WHOLE = b"GET /api/events HTTP/1.1\r\nHost: lab\r\n\r\n"


class Task:
    """An answer that never ends."""

    def add_done_callback(self, act: object) -> None:
        """Call nothing."""


class Timer:
    """What is to be called later, unless it is cancelled."""

    def __init__(self, act: Callable[[], None]) -> None:
        self.act = act

    def cancel(self) -> None:
        self.act = lambda: None


class Loop:
    """Keeps what is to be called later, and the tasks that answer, of which none ever ends."""

    def __init__(self) -> None:
        self.later: list[Timer] = []

    def call_later(self, seconds: float, act: Callable[..., None], *values: object) -> Timer:
        assert seconds == 20
        self.later.append(Timer(lambda: act(*values)))
        return self.later[-1]

    def create_task(self, task: Coroutine[Any, Any, None], **_: object) -> Any:
        task.close()
        return Task()

    def pass_time(self) -> None:
        due, self.later = self.later, []
        for timer in due:
            timer.act()


class Transport(asyncio.Transport):
    """Of nobody."""

    is_closed = False

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        del name
        return default

    def is_closing(self) -> bool:
        return self.is_closed

    def close(self) -> None:
        self.is_closed = True


async def _app(scope: object, receive: object, send: object) -> None:
    """Never executed."""


@pytest.mark.parametrize(
    ("arrived", "is_closed"),
    [
        pytest.param([b"", b""], True, id="nothing"),
        pytest.param([b"GET / HTTP/1.1\r\n", b"A: b\r\n"], True, id="header by header"),
        pytest.param([BEGUN, b"{", b'"'], True, id="a body without its end"),
        pytest.param([WHOLE, b"", b""], False, id="a request that is being answered"),
    ],
)
def test_who_never_completes_a_request_is_hung_up_on(arrived: list[bytes], is_closed: bool) -> None:
    loop, transport = Loop(), Transport()
    config = uvicorn.Config(_app, log_config=None, timeout_keep_alive=20, interface="asgi3", ws="none")
    connection = TimedConnection(config, ServerState(), {}, _loop=loop)  # type: ignore[arg-type]
    connection.connection_made(transport)
    for data in arrived:
        if data:
            connection.data_received(data)
        loop.pass_time()
    assert transport.is_closed is is_closed


LENGTH = 8_000_000  # more than the system holds for a reader that pauses


class AnsweringLoop(Loop):
    """One whose tasks are executed, by the loop of the test."""

    def create_task(self, task: Coroutine[Any, Any, None], **settings: Any) -> Any:
        return asyncio.get_running_loop().create_task(task, **settings)


async def _send_body(scope: object, receive: object, send: Any) -> None:
    headers = [(b"content-length", b"%d" % LENGTH)]
    await send({"type": "http.response.start", "status": 200, "headers": headers})
    await send({"type": "http.response.body", "body": bytes(LENGTH)})


async def _received_after_a_pause(behind: bytes) -> int:
    """Return how much is received of a response by who asks, sends what is `behind`, and pauses before reading."""
    loop, later = asyncio.get_running_loop(), AnsweringLoop()
    config = uvicorn.Config(_send_body, log_config=None, timeout_keep_alive=20, interface="asgi3", ws="none")
    ours, theirs = socket.socketpair()
    theirs.setblocking(False)
    with theirs:
        _, connection = await loop.connect_accepted_socket(
            lambda: TimedConnection(config, ServerState(), {}, _loop=later),  # type: ignore[arg-type]
            ours,
        )
        connection.data_received(WHOLE)
        await asyncio.gather(*connection.tasks)
        if behind:
            connection.data_received(behind)
        for _ in range(4):
            later.pass_time()
        received = 0
        while data := await loop.sock_recv(theirs, 1 << 20):
            received += len(data)
    return received


@pytest.mark.parametrize("behind", [b"", WHOLE[:9]])
def test_who_pauses_while_reading_gets_the_whole_response(behind: bytes) -> None:
    """Of 8 MB, 2.8 MB arrived: what was not sent yet was thrown away."""
    assert asyncio.run(_received_after_a_pause(behind)) > LENGTH
