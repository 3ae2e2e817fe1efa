"""An instrument that speaks SCPI over TCP, as a laboratory supply's port 5025 does."""

from __future__ import annotations

import socketserver
import threading
import time
from contextlib import suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable


class ScpiServer:
    """A supply whose answers a test sets; a query that it does not know is answered by an entry in its error queue.

    Attributes:
        answers: what is answered to each query: a text, or a function that returns one.
        received: all lines, in order.
        delay: how long the next answer takes, s; used once.
        is_mute: whether it takes lines and answers none.
        has_queue: whether it tells of its errors.
        surplus: what it sends behind its next answer to a measurement without being asked; used once.
        banner: what it sends to who connects.
    """

    def __init__(self, **numbers: float) -> None:
        watts = {"voltage": 12.0, "current": 0.5, **numbers}
        self.answers: dict[str, str | Callable[[], str]] = {
            "*IDN?": "Robot Runner,Fake Supply,1,1.0",
            "MEAS:VOLT?": lambda: f"{watts['voltage']:+.5E}",
            "MEAS:CURR?": lambda: f"{watts['current']:+.5E}",
        }
        self.numbers = watts
        self.received: list[str] = []
        self.errors: list[str] = []
        self.delay = 0.0
        self.is_mute = False
        self.has_queue = True
        self.surplus = ""
        self.banner = ""
        outer = self

        class Handler(socketserver.StreamRequestHandler):
            def handle(self) -> None:
                with suppress(OSError):  # the other end did not wait
                    self.wfile.write(outer.banner.encode("ascii"))
                    for line in self.rfile:
                        answer = outer.answer(line.decode("ascii").strip())
                        if answer is not None:
                            self.wfile.write(answer.encode("ascii") + b"\n")

        self._server = socketserver.ThreadingTCPServer(("127.0.0.1", 0), Handler)
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
        self._thread.start()
        self.resource = f"TCPIP::127.0.0.1::{self._server.server_address[1]}::SOCKET"

    def answer(self, line: str) -> str | None:
        self.received.append(line)
        delay, self.delay = (self.delay, 0.0) if line.startswith("MEAS") else (0.0, self.delay)
        time.sleep(delay)
        if self.is_mute or (line == "SYST:ERR?" and not self.has_queue):
            return None
        if line == "SYST:ERR?":
            return self.errors.pop(0) if self.errors else '0,"No error"'
        surplus, self.surplus = (self.surplus, "") if line.startswith("MEAS") else ("", self.surplus)
        known = self.answers.get(line)
        if known is None and (line.endswith("?") or line not in {"*RST", "SYST:REM"}):
            self.errors.append('-113,"Undefined header"')
            return None
        answer = known() if callable(known) else known
        return f"{answer}\n{surplus}" if surplus and answer is not None else answer

    def stop(self) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
