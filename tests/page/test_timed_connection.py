"""When a connection of the live page is closed by itself, with a loop whose time a test moves on."""

from __future__ import annotations

import asyncio
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


class Loop:
    """Keeps what is to be called later, and the tasks that answer, of which none ever ends."""

    def __init__(self) -> None:
        self.later: list[Callable[[], None]] = []

    def call_later(self, seconds: float, act: Callable[..., None], *values: object) -> None:
        assert seconds == 20
        self.later.append(lambda: act(*values))

    def create_task(self, task: Coroutine[Any, Any, None], **_: object) -> Any:
        task.close()
        return Task()

    def pass_time(self) -> None:
        due, self.later = self.later, []
        for act in due:
            act()


class Transport(asyncio.Transport):
    """Of nobody."""

    is_aborted = False

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        del name
        return default

    def is_closing(self) -> bool:
        return self.is_aborted

    def abort(self) -> None:
        self.is_aborted = True


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
    assert transport.is_aborted is is_closed
