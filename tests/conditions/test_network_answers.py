"""Ports and web servers of loopback are awaited."""

from __future__ import annotations

import socket
import threading
import time
from contextlib import ExitStack, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING

import pytest
from tests.loopback_port import claim_port

from robot_runner import ConditionError, http_answers, port_open
from robot_runner.core.events.context import SystemClock
from robot_runner.testing import make_context

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from robot_runner import Condition, RobotRunnerContext


@pytest.fixture
def context(tmp_path: Path) -> RobotRunnerContext:
    return make_context(tmp_path, clock=SystemClock(), robot=None)


class Handler(BaseHTTPRequestHandler):
    began = 0.0

    def do_GET(self) -> None:
        if self.path == "/slow":
            time.sleep(5)
        if self.path == "/stream":
            self.stream()
            return
        if self.path == "/elsewhere":
            self.send_response(302)
            self.send_header("Location", "http://robot..local/")
            self.end_headers()
            return
        is_ready = self.path == "/up" or (self.path != "/down" and time.monotonic() - self.began > 0.6)
        self.send_response(200 if is_ready else 503)
        self.end_headers()
        with suppress(OSError):  # whoever asked for what is slow has left
            self.wfile.write(b"state: ready" if is_ready else b"state: starting")

    def stream(self) -> None:
        self.send_response(200)
        self.end_headers()
        with suppress(OSError):  # until nobody listens any more
            for _ in range(600):
                self.wfile.write(b"data: 1\n\n")
                time.sleep(0.1)

    def log_message(self, *_: object) -> None: ...


@pytest.fixture
def server() -> Iterator[str]:
    Handler.began = time.monotonic()
    with ThreadingHTTPServer(("127.0.0.1", claim_port()), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def test_a_port_is_open_once_a_program_listens(context: RobotRunnerContext) -> None:
    port = claim_port()
    with pytest.raises(ConditionError, match=f"port {port}: Connection refused"):
        port_open(port).wait(context, timeout_s=0.2)
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", port))
        timer = threading.Timer(0.3, listener.listen)
        timer.start()
        assert port_open(port).wait(context, timeout_s=20.0).holds
        timer.join()


def test_a_connection_to_oneself_is_no_open_port(monkeypatch: pytest.MonkeyPatch, context: RobotRunnerContext) -> None:
    with socket.socket() as own:  # simultaneous open: what Linux may do where the port is one that it hands out
        own.bind(("127.0.0.1", claim_port()))
        own.connect(own.getsockname())
        monkeypatch.setattr(socket, "create_connection", lambda *_, **__: own)
        look = port_open(own.getsockname()[1]).watch(context, ExitStack())()
    assert not look.holds
    assert look.seen.endswith("closed")


def test_a_server_is_awaited_until_it_answers_as_expected(server: str, context: RobotRunnerContext) -> None:
    assert http_answers(server).wait(context, timeout_s=20.0).value == 200
    assert time.monotonic() - Handler.began > 0.6
    assert http_answers(f"{server}/up", text="ready").wait(context, timeout_s=20.0).seen == "status 200"
    with pytest.raises(ConditionError, match="status 200, without 'gone'"):
        http_answers(f"{server}/up", text="gone").wait(context, timeout_s=0.1)


def test_another_status_may_be_what_is_awaited(server: str, context: RobotRunnerContext) -> None:
    assert http_answers(f"{server}/down", status=503, text="starting").wait(context, timeout_s=20.0).value == 503


def test_a_redirection_may_be_what_is_awaited_and_is_not_followed_then(
    server: str, context: RobotRunnerContext
) -> None:
    assert http_answers(f"{server}/elsewhere", status=302).wait(context, timeout_s=20.0).value == 302


def test_a_server_that_is_silent_or_not_there_does_not_answer(server: str, context: RobotRunnerContext) -> None:
    look = http_answers(f"{server}/slow").watch(context, ExitStack())()
    assert not look.holds
    assert "timed out" in look.seen or "no answer" in look.seen
    look = http_answers(f"http://127.0.0.1:{claim_port()}").watch(context, ExitStack())()
    assert look.seen.endswith("Connection refused")


def test_a_server_that_leads_to_an_address_that_is_none_does_not_answer(
    server: str, context: RobotRunnerContext
) -> None:
    look = http_answers(f"{server}/elsewhere").watch(context, ExitStack())()
    assert not look.holds
    assert "label empty" in look.seen  # Python 3.11 adds "or too long"


@pytest.mark.parametrize(("text", "holds"), [("", True), ("data", True), ("ready", False)])
def test_a_look_at_an_answer_that_never_ends_has_an_end(
    server: str, context: RobotRunnerContext, text: str, holds: bool
) -> None:
    began = time.monotonic()
    assert http_answers(f"{server}/stream", text=text).watch(context, ExitStack())().holds is holds
    assert time.monotonic() - began < 30


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (lambda: port_open(0), "0 is not a port"),
        (lambda: port_open(True), "True is not a port"),
        (lambda: port_open(22, host="pi@robot"), "'pi@robot' is not a computer of a network"),
        (lambda: port_open(22, host="robot..local"), "'robot..local' is not a computer of a network"),
        (lambda: http_answers("ftp://robot"), "'ftp://robot' is not the address of a web server"),
        (lambda: http_answers("http://robot..local/"), "'http://robot..local/' is not the address of a web server"),
        (lambda: http_answers("http://robot/büro"), "'http://robot/büro' is not the address of a web server"),
        (lambda: http_answers(8080), "8080 is not the address of a web server"),
        (lambda: http_answers("http://robot:port/"), "is not the address of a web server"),
        (lambda: http_answers("http://robot/", status="200"), "'200' is not the status of an answer"),
        (lambda: http_answers("http://robot/", text=b"ok"), "b'ok' is not text"),
        (lambda: port_open(22, host=None), "None is not a computer of a network"),
        (lambda: http_answers("http://admin:geheim@robot/"), "the address of robot holds a user or a password"),
    ],
)
def test_what_is_no_address_is_refused(make: Callable[[], Condition], problem: str) -> None:
    with pytest.raises(ConditionError, match=problem) as error:
        make()
    assert "geheim" not in str(error.value)


def test_a_name_that_no_network_knows_is_found_before_the_experiment() -> None:
    (finding,) = port_open(22, host="no-such-robot.invalid").check(None)
    assert "'no-such-robot.invalid' is not known" in finding.problem
    assert list(port_open(22).check(None)) == []
