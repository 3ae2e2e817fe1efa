"""Serving a live page on a port of this machine: where it listens, its links, its end."""

from __future__ import annotations

import errno
import io
import ipaddress
import socket
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import ConfigError, ExecutionError
from robot_runner.page.page_access import Keys, Role, known_names

if TYPE_CHECKING:
    from io import RawIOBase

_EXTRA = "Install it with: pip install 'robot-runner[page]'"
_LARGEST_PORT = 65_535
#: An address for documentation (RFC 5737): by the route to it, the system tells our own address.
_ELSEWHERE = ("192.0.2.1", 9)
#: Connections at once: those of 100 viewers, and what they ask for.
_MOST_CONNECTIONS = 400


@dataclass(frozen=True, slots=True)
class Serving:
    """A page that already listens, so that its printed links are valid.

    Attributes:
        listener: the listening socket.
        folder: what is shown.
        keys: for looking and acting.
        names: host names by which it may be addressed.
        is_read_only: whether nobody may act.
        is_one: whether the folder is an experiment's own, which may not exist yet.
    """

    listener: socket.socket
    folder: Path
    keys: Keys
    names: frozenset[str]
    is_read_only: bool
    is_one: bool

    @classmethod
    def opened(
        cls,
        folder: Path,
        host: str,
        port: str,
        *,
        names: Sequence[str] = (),
        is_read_only: bool = False,
        has_new_links: bool = False,
        is_one: bool = False,
    ) -> Serving:
        """Listen at an address.

        Raises:
            ExecutionError: the extra is missing, or the port is in use.
            ConfigError: the address or the port is invalid.
            StorageError: the keys cannot be kept.
        """
        _require_extra()
        listener = _listening(host, _port(port))
        return cls(listener, folder, Keys.of_user(anew=has_new_links), known_names(names), is_read_only, is_one)

    @property
    def port(self) -> int:
        """The port, also if 0 was asked for."""
        return int(self.listener.getsockname()[1])

    @property
    def is_beyond_here(self) -> bool:
        """Whether other machines can reach it."""
        return not ipaddress.ip_address(self.listener.getsockname()[0]).is_loopback

    def link(self, role: Role, *, from_elsewhere: bool = False) -> str:
        """Return the URL for a browser, with the key for a role.

        The key is in the fragment, which browsers do not send: the page itself posts it once.
        """
        return f"http://{self._host(from_elsewhere=from_elsewhere)}:{self.port}/#key={self.keys.key(role)}"

    def code(self, link: str) -> str:
        """Return a link as a QR code for a terminal."""
        import segno  # noqa: PLC0415 - of the extra

        drawn = io.StringIO()
        segno.make(link, error="l").terminal(drawn, compact=True, border=2)
        return drawn.getvalue()

    def serve(self, until_closed: RawIOBase | None = None) -> None:
        """Serve until a signal comes, or the given stream is closed at its other end."""
        import uvicorn  # noqa: PLC0415 - of the extra

        from robot_runner.page.page_server import LivePage, PageSettings  # noqa: PLC0415
        from robot_runner.page.timed_connection import TimedConnection  # noqa: PLC0415

        settings = PageSettings(
            self.folder, self.port, self.names, self.keys, is_read_only=self.is_read_only, is_one=self.is_one
        )
        config = uvicorn.Config(
            LivePage(settings).app,
            log_config=None,
            log_level="error",  # nobody is to fill the terminal
            access_log=False,
            proxy_headers=False,
            server_header=False,
            ws="none",
            http=TimedConnection,
            interface="asgi3",
            loop="asyncio",
            limit_concurrency=_MOST_CONNECTIONS,
            timeout_keep_alive=20,
            timeout_graceful_shutdown=1,
            h11_max_incomplete_event_size=16_384,
        )
        server = uvicorn.Server(config)
        if until_closed is not None:
            threading.Thread(target=_end_with, args=(until_closed, server), daemon=True).start()
        server.run(sockets=[self.listener])

    def _host(self, *, from_elsewhere: bool) -> str:
        host = ipaddress.ip_address(self.listener.getsockname()[0])
        if host.is_unspecified:
            return _own_address() if from_elsewhere else "127.0.0.1"
        return f"[{host}]" if host.version == 6 else str(host)  # noqa: PLR2004 - IPv6


def _end_with(stream: RawIOBase, server: Any) -> None:
    while stream.read(1):
        pass
    server.should_exit = True


def _own_address() -> str:
    """Return the address of this machine in its network, without sending a packet."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(_ELSEWHERE)
        except OSError:
            return socket.gethostname()
        return str(probe.getsockname()[0])


def _require_extra() -> None:
    try:
        import segno  # noqa: F401, PLC0415
        import starlette  # noqa: F401, PLC0415
        import uvicorn  # noqa: F401, PLC0415
    except ImportError as error:
        problem = f"the live page needs the extra 'page': {error.name} is not installed"
        raise ExecutionError(problem, where="robot-runner watch", fix=_EXTRA) from error


def _port(text: str) -> int:
    if text.isascii() and text.isdecimal() and int(text) <= _LARGEST_PORT:
        return int(text)
    fix = f"Give a number of 0 to {_LARGEST_PORT:,}; 0 takes any."
    raise ConfigError(f"{text!r} is not a port", where="--port", fix=fix)


def _listening(host: str, port: int) -> socket.socket:
    name = "127.0.0.1" if host == "localhost" else host.removeprefix("[").removesuffix("]")
    try:
        address = ipaddress.ip_address(name)
    except ValueError:
        fix = "Give an address in figures: 127.0.0.1 for this machine alone, 0.0.0.0 for its networks."
        raise ConfigError(f"{host!r} is not an address", where="--host", fix=fix) from None
    listener = socket.socket(socket.AF_INET6 if address.version == 6 else socket.AF_INET)  # noqa: PLR2004 - IPv6
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((str(address), port))
        listener.listen(128)
    except OSError as error:
        listener.close()
        raise _not_listening(error, host, port) from error
    return listener


def _not_listening(error: OSError, host: str, port: int) -> ExecutionError:
    where = f"{host}:{port}"
    if error.errno == errno.EADDRINUSE:
        fix = f"Choose another one (--port {port + 1 if port < _LARGEST_PORT else port - 1}), or any (--port 0)."
        return ExecutionError(f"port {port} is in use, perhaps by another live page", where=where, fix=fix)
    if error.errno == errno.EADDRNOTAVAIL:
        fix = "Listen at 0.0.0.0: all that it has."
        return ExecutionError("this machine has no such address", where=where, fix=fix)
    if error.errno == errno.EACCES:
        return ExecutionError("you may not listen at this port", where=where, fix="Choose one of 1024 and more.")
    return ExecutionError(f"the page cannot listen there: {error.strerror}", where=where, fix="Choose another address.")
