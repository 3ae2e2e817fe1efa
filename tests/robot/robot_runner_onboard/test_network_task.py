"""The network task fetches one address until it is stopped, and says what it could not fetch."""

from __future__ import annotations

import http.server
import threading
from contextlib import contextmanager
from types import SimpleNamespace
from typing import TYPE_CHECKING

import pytest
from robot_runner_onboard import network
from robot_runner_onboard.errors import TaskError
from robot_runner_onboard.network import request

if TYPE_CHECKING:
    from collections.abc import Iterator


class Orders:
    """A channel whose node has the task end when it is asked for the given time."""

    def __init__(self, looks: int) -> None:
        self.looks = looks
        self.waits: list[float] = []
        self.is_ready = False

    def ready(self) -> None:
        self.is_ready = True

    def is_over(self, wait: float = 0.0) -> bool:
        self.waits.append(wait)
        self.looks -= 1
        return self.looks < 0


class _Pages(http.server.BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        answered = self.server.answered = getattr(self.server, "answered", 0) + 1  # type: ignore[attr-defined]
        status = 503 if answered in self.server.failures else 200  # type: ignore[attr-defined]
        self.send_response(status)
        self.send_header("Content-Length", "4")
        self.end_headers()
        self.wfile.write(b"page")

    def log_message(self, *_: object) -> None: ...


@contextmanager
def page_server(failures: frozenset[int] = frozenset()) -> Iterator[http.server.HTTPServer]:
    """Serve pages on loopback; those numbered in `failures`, from 1, are answered with 503."""
    server = http.server.HTTPServer(("127.0.0.1", 0), _Pages)
    server.failures = failures  # type: ignore[attr-defined]
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def address(server: http.server.HTTPServer) -> str:
    return f"http://127.0.0.1:{server.server_port}/"


@pytest.fixture(autouse=True)
def no_proxy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("no_proxy", "127.0.0.1")


def test_requests_are_issued_until_the_task_is_stopped() -> None:
    orders = Orders(4)
    with page_server() as server:
        assert request(orders, address(server), 0.0) == "5 requests, 0 failed, 20 bytes"
    assert orders.is_ready
    assert server.answered == 5


@pytest.mark.parametrize("is_told", [True, False], ids=["its length is told", "in chunks"])
def test_a_large_resource_is_broken_off_when_the_task_is_stopped(
    monkeypatch: pytest.MonkeyPatch, is_told: bool
) -> None:
    gone = threading.Event()

    def send_half(page: _Pages) -> None:
        page.send_response(200)
        if is_told:
            page.send_header("Content-Length", "2000")
        page.end_headers()
        page.wfile.write(b"-" * 1000)
        gone.wait(20.0)

    monkeypatch.setattr(_Pages, "do_GET", send_half)
    with page_server() as server:
        try:
            assert request(Orders(0), address(server), 0.0) == "1 requests, 0 failed, 1000 bytes"
        finally:
            gone.set()


def test_a_resource_that_ends_too_soon_is_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    def send_half(page: _Pages) -> None:
        page.send_response(200)
        page.send_header("Content-Length", "2000")
        page.end_headers()
        page.wfile.write(b"-" * 1000)

    monkeypatch.setattr(_Pages, "do_GET", send_half)
    with page_server() as server, pytest.raises(TaskError, match="cannot be fetched"):
        request(Orders(9), address(server), 0.0)


def test_the_rate_is_kept_on_a_schedule(monkeypatch: pytest.MonkeyPatch) -> None:
    orders, clock = Orders(3), SimpleNamespace(monotonic=lambda: 7.0)  # however long requests take, nobody sleeps
    with page_server() as server:
        monkeypatch.setattr(network, "time", clock)
        request(orders, address(server), 2.0)
    assert orders.waits == [0.5, 1.0, 1.5, 2.0]  # each is due later


def test_a_request_that_fails_now_and_then_is_counted() -> None:
    with page_server(frozenset({2, 3, 5})) as server:
        assert request(Orders(5), address(server), 0.0) == "3 requests, 3 failed, 12 bytes"


def test_a_server_that_is_gone_ends_the_task() -> None:
    with page_server(frozenset(range(3, 10))) as server, pytest.raises(TaskError, match=r"503 .* \(after 2 requests\)"):
        request(Orders(100), address(server), 0.0)


def test_an_address_where_nobody_answers_is_refused_at_once() -> None:
    with page_server() as server:
        gone = address(server)
    orders = Orders(3)
    with pytest.raises(TaskError, match=r"cannot be fetched: .*refused"):
        request(orders, gone, 0.0)
    assert not orders.is_ready
