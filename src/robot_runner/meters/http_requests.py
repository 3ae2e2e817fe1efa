"""Small requests over HTTP to devices and exporters of a lab, with a password that is in no config."""

from __future__ import annotations

import hashlib
import os
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from http.client import HTTPException
from pathlib import Path
from typing import Any

from robot_runner.core.errors import LinkError, PluginError

#: Much more than the page of an exporter; the answer of a device that never stops sending is cut off.
_MOST_BYTES = 32 << 20
_PIECE = 1 << 16
_UNAUTHORIZED, _FORBIDDEN = 401, 403
_NAME_PASSWORD = "Name its user, and where its password stands: password_env='NAME' or password_file='...'."  # noqa: S105


@dataclass(frozen=True, slots=True)
class Secret:
    """The source of a password, which a config names instead of the password.

    Attributes:
        env: the environment variable that holds it.
        file: the file whose first line it is.
    """

    env: str | None = None
    file: Path | None = None

    @classmethod
    def named(cls, env: str | None, file: str | Path | None, *, where: str) -> Secret | None:
        """Return the source of the password; None where there is none; a `PluginError` says that both are named."""
        if env is not None and file is not None:
            raise PluginError("password_env and password_file are named", where=where, fix="Leave one of them out.")
        if env is None and file is None:
            return None
        return cls(env, None if file is None else Path(file).expanduser())

    def read(self, where: str) -> str:
        """Return the password; a `LinkError` says that there is none, or that the file cannot be read."""
        if self.file is None:
            password = os.environ.get(self.env or "")
            if not password:
                problem = f"the environment variable {self.env}, which is to hold the password, is empty or not set"
                fix = f"Set it before you start: read -rs {self.env}; export {self.env}"
                raise LinkError(problem, where=where, fix=fix)
            return password
        try:
            lines = self.file.read_text(encoding="utf-8").splitlines()
        except (OSError, UnicodeDecodeError) as error:
            problem = f"the password cannot be read from {self.file}: {getattr(error, 'strerror', None) or error}"
            raise LinkError(problem, where=where, fix="Name a file that you can read: password_file='...'.") from error
        if not lines or not lines[0]:
            raise LinkError(f"{self.file} is empty", where=where, fix="Write the password into its first line.")
        return lines[0]


def check_url(url: str, *, where: str, schemes: tuple[str, ...] = ("http", "https")) -> str:
    """Return a URL without the `/` at its end; a `PluginError` says that it is malformed, or contains a password."""
    try:
        parts = urllib.parse.urlsplit(url)
        host, _ = parts.hostname, parts.port
    except ValueError as error:
        raise PluginError(f"{url!r} is not an address: {error}", where=where, fix=_example(schemes)) from error
    if parts.password is not None or parts.username is not None:
        fix = f"Leave it out of the config. {_NAME_PASSWORD}"
        raise PluginError(f"the address of {host} holds a user or a password", where=where, fix=fix)
    if parts.scheme not in schemes or not host or any(character.isspace() for character in url):
        raise PluginError(f"{url!r} is not an address of this kind", where=where, fix=_example(schemes))
    return url.rstrip("/")


def _example(schemes: tuple[str, ...]) -> str:
    return f"Give one such as '{schemes[0]}://192.168.0.20'."


class _Digest(urllib.request.HTTPDigestAuthHandler):
    """Digest authentication, also with SHA-256 (RFC 7616): Shelly's plugs need it and Python before 3.14 lacks it."""

    def get_algorithm_impls(self, algorithm: str) -> tuple[Callable[[str], str], Callable[[str, str], str]]:
        if algorithm != "SHA-256":
            known: tuple[Callable[[str], str], Callable[[str, str], str]] = super().get_algorithm_impls(algorithm)
            return known

        def digest(text: str) -> str:
            return hashlib.sha256(text.encode()).hexdigest()

        return digest, lambda secret, data: digest(f"{secret}:{data}")


class HttpDevice:
    """A device that answers GET requests.

    Args:
        url: of the device, such as `http://192.168.0.20`.
        timeout: how long each step of a request, and all of the body, may take, s.
        user: whose password it is.
        password: None for requests without one.
        where: for errors: whose device it is.
    """

    def __init__(self, url: str, *, timeout: float, user: str = "", password: str | None = None, where: str) -> None:
        self.url = url
        self._timeout = timeout
        self._where = where
        handlers: list[Any] = [urllib.request.ProxyHandler({})]  # no proxy, as the device is in the lab
        if password is not None:
            known = urllib.request.HTTPPasswordMgrWithDefaultRealm()
            known.add_password(None, url, user, password)
            handlers += [_Digest(known), urllib.request.HTTPBasicAuthHandler(known)]
        self._opener = urllib.request.build_opener(*handlers)

    def get(self, path: str = "", **headers: str) -> bytes:
        """Return the body of the answer; a `LinkError` says that the device does not answer, or refuses."""
        request = urllib.request.Request(self.url + path, headers=headers)  # noqa: S310 - the scheme was checked
        try:
            with closing(self._opener.open(request, timeout=self._timeout)) as answer:
                body = _body(answer, time.monotonic() + self._timeout)
        except urllib.error.HTTPError as error:
            with error:
                raise self._refused(error.code, error.reason) from error
        except ValueError as error:  # urllib raises it for an unknown kind of authentication
            raise self._refused(_UNAUTHORIZED, "authentication failed") from error
        except (OSError, HTTPException) as error:
            reason = getattr(error, "reason", None) or error
            said = "it timed out" if isinstance(reason, TimeoutError) else str(reason) or type(reason).__name__
            fix = "Look at its address, whether it is switched on, and at the network."
            raise LinkError(f"{self.url} does not answer: {said}", where=self._where, fix=fix) from error
        if len(body) > _MOST_BYTES:
            fix = "Check whether the address is right."
            raise LinkError(f"{self.url} sends more than {_MOST_BYTES >> 20} MiB", where=self._where, fix=fix)
        if answer.length:  # missing bytes of the announced length; a read with a size raises no error for them
            fix = "Check whether the device was restarted, and at the network."
            problem = f"the answer of {self.url} breaks off {answer.length} bytes before its end"
            raise LinkError(problem, where=self._where, fix=fix)
        return body

    def _refused(self, code: int, reason: str) -> LinkError:
        fix = _NAME_PASSWORD if code in {_UNAUTHORIZED, _FORBIDDEN} else "Look at its address and its kind."
        return LinkError(f"{self.url} refuses: {code} {reason}", where=self._where, fix=fix)


def _body(answer: Any, until: float) -> bytes:
    """Return the body, or its beginning if it is too long; a `TimeoutError` says that it goes on, as a stream does."""
    body = bytearray()
    while len(body) <= _MOST_BYTES and (piece := answer.read1(_PIECE)):
        body += piece
        if time.monotonic() > until:
            raise TimeoutError
    return bytes(body)
