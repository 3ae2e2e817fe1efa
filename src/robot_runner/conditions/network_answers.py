"""Conditions of the network: a port is open, a server answers."""

from __future__ import annotations

import re
import socket
import time
import urllib.parse
from collections.abc import Callable, Iterable
from contextlib import ExitStack, closing
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.core.design.numeric_range import is_whole
from robot_runner.core.errors import ConditionError, Finding
from robot_runner.core.events.condition import Condition, Look, LookAgain
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.links.declared_host import LOCAL

if TYPE_CHECKING:
    from urllib.request import OpenerDirector

#: How long a connection, or each step of a request, may take, s: enough within a lab.
_PATIENCE = 2.0
#: How much of an answer is searched for a text, and how much of it is taken at once, bytes.
_MOST_BYTES, _CHUNK = 1 << 20, 1 << 16
_MOST_PORT = 65535
_SUCCESS, _REDIRECTIONS = range(200, 300), range(300, 400)


def port_open(port: int, *, host: str = LOCAL) -> Condition:
    """Return the condition that a TCP port takes connections; each look is one connection, closed at once.

    Args:
        port: its number.
        host: the computer's name or address on the network.

    Raises:
        ConditionError: the port or the host is invalid.

    Example:
        >>> print(port_open(9090, host="robot.local"))
        port 9090 of robot.local is open
    """
    if not is_whole(port) or not 0 < port <= _MOST_PORT:
        raise ConditionError(f"{port!r} is not a port", where="port_open", fix=f"Give a number from 1 to {_MOST_PORT}.")
    if not isinstance(host, str) or not host or re.search(r"[\s@/]", host) or not _is_name(host):
        fix = "Give its name or address on the network, such as 'robot.local', without a user."
        raise ConditionError(f"{host!r} is not a computer of a network", where="port_open", fix=fix)
    return _PortOpen(port, host)


def http_answers(url: str, *, status: int | None = None, text: str = "") -> Condition:
    """Return the condition that a server answers a GET request as expected; it is asked four times a second.

    Args:
        url: of HTTP; proxies of the environment are not used.
        status: the expected status; by default any from 200 to 299. Redirections are followed, unless one is expected.
        text: must be in the answer.

    Raises:
        ConditionError: the URL is invalid or has a password, or the status or text is impossible.

    Example:
        >>> print(http_answers("http://localhost:8080/health", text="ok"))
        http://localhost:8080/health answers with 'ok'
    """
    if status is not None and (isinstance(status, bool) or status not in range(100, 600)):
        fix = "Give a number from 100 to 599, such as 200, or leave it out."
        raise ConditionError(f"{status!r} is not the status of an answer", where="http_answers", fix=fix)
    if not isinstance(text, str):
        raise ConditionError(f"{text!r} is not text", where="http_answers", fix="Give a text: text='ok'.")
    try:
        parts = urllib.parse.urlsplit(url)
        is_good = parts.scheme in {"http", "https"} and _is_name(parts.hostname or "") and parts.port != 0
    except (AttributeError, ValueError):  # it is no text, or cannot be an address
        is_good, parts = False, urllib.parse.urlsplit("")
    if parts.username is not None or parts.password is not None:
        fix = "Leave the user and the password out, and await another status: status=401."
        problem = f"the address of {parts.hostname} holds a user or a password"
        raise ConditionError(problem, where="http_answers", fix=fix)
    if not is_good or re.search(r"\s", url) or not (parts.path + parts.query).isascii():
        fix = "Give one such as 'http://localhost:8080/health', with other letters written as %C3%A4."
        raise ConditionError(f"{url!r} is not the address of a web server", where="http_answers", fix=fix)
    return _HttpAnswers(url, status, text)


def _is_name(host: str) -> bool:
    """Return whether this is a valid name or address of a computer on a network."""
    try:
        return bool(host.encode("idna"))
    except UnicodeError:  # a part of it is empty, or longer than 63 letters
        return False


@dataclass(frozen=True)
class _PortOpen(Condition):
    port: int
    host: str

    is_outside = True
    every_s = 0.1

    def __str__(self) -> str:
        return f"port {self.port} {'' if self.host == LOCAL else f'of {self.host} '}is open"

    def check(self, robot: str | None) -> Iterable[Finding]:
        del robot
        try:
            socket.getaddrinfo(self.host, self.port, type=socket.SOCK_STREAM)
        except OSError as error:
            problem = f"the name {self.host!r} is not known on this network: {error.strerror}"
            fix = "Check whether the name is right, or give the computer's address."
            yield Finding.warning(f"port_open({self.port}, host={self.host!r})", problem, fix)

    def watch(self, context: RobotRunnerContext, opened: ExitStack) -> LookAgain:
        del context, opened
        return self._look

    def _look(self) -> Look:
        try:
            with socket.create_connection((self.host, self.port), timeout=_PATIENCE) as connection:
                # Linux may connect a socket to itself, if its own ephemeral port is the one that is tried.
                is_open = connection.getsockname() != connection.getpeername()
        except OSError as error:
            reason = "no answer" if isinstance(error, TimeoutError) else error.strerror or str(error)
            return Look(holds=False, seen=f"port {self.port}: {reason}")
        return Look(is_open, f"port {self.port}: {'open' if is_open else 'closed'}")


@dataclass(frozen=True)
class _HttpAnswers(Condition):
    url: str
    status: int | None
    text: str

    is_outside = True
    every_s = 0.25

    def __str__(self) -> str:
        wanted = [f"status {self.status}"] if self.status is not None else []
        wanted += [repr(self.text)] if self.text else []
        return f"{self.url} answers{' with ' if wanted else ''}{' and '.join(wanted)}"

    def watch(self, context: RobotRunnerContext, opened: ExitStack) -> LookAgain:
        del context, opened
        import urllib.request  # noqa: PLC0415  # imports half of what a start does, and few conditions ask servers

        class Staying(urllib.request.HTTPRedirectHandler):
            def redirect_request(self, *_: object) -> None: ...

        # A redirection that is awaited is not followed: the answer would be that of the page to which it leads.
        staying = [Staying] if self.status in _REDIRECTIONS else []
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}), *staying)
        return lambda: self._look(opener)

    def _look(self, opener: OpenerDirector) -> Look:
        from http.client import HTTPException  # noqa: PLC0415  # as above

        try:
            status, has_text = _asked(opener, self.url, self.text.encode())
        except (OSError, HTTPException, ValueError) as error:  # a redirect may lead to an invalid address
            reason = getattr(error, "reason", None) or error
            said = "no answer" if isinstance(reason, TimeoutError) else getattr(reason, "strerror", None) or str(reason)
            return Look(holds=False, seen=f"{self.url}: {said or type(reason).__name__}")
        is_expected = status in _SUCCESS if self.status is None else status == self.status
        seen = f"status {status}{'' if has_text else f', without {self.text!r}'}"
        return Look(is_expected and has_text, seen, status)


def _asked(opener: OpenerDirector, url: str, text: bytes) -> tuple[int, bool]:
    """Return the status of an answer, whatever it is, and whether a text is in the beginning of its body."""
    from urllib.error import HTTPError  # noqa: PLC0415  # as above

    try:
        with closing(opener.open(url, timeout=_PATIENCE)) as answer:
            return answer.status, _has_text(answer.read1, text)
    except HTTPError as error:
        with error:
            return error.code, _has_text(error.read1, text)


def _has_text(read: Callable[[int], bytes], text: bytes) -> bool:
    """Return whether a text is in the beginning of an answer: that of a stream, such as a camera's, never ends."""
    body, end = b"", time.monotonic() + _PATIENCE
    while text not in body:
        data = read(_CHUNK) if len(body) < _MOST_BYTES and time.monotonic() < end else b""
        if not data:
            return False
        body += data
    return True
