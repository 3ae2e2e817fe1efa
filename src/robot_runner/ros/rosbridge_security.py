"""Encryption and authentication of a connection to a rosbridge: TLS, HTTP credentials and rosauth.

Secrets are read from a variable or a file when the connection is opened; the robot's address names only where they are,
so that nothing of them reaches the run's data.
"""

from __future__ import annotations

import base64
import errno
import hashlib
import math
import os
import secrets
import select
import socket
import ssl
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from robot_runner.core.errors import LinkError

_WHERE = "robot"
_TLS_OPTIONS = ("ca", "cert", "key", "fingerprint")
_SECRETS = tuple(f"{kind}_{place}" for kind in ("password", "token", "rosauth") for place in ("env", "file"))
#: The part of an address after `?` that says how the connection is secured.
SECURITY_OPTIONS = (*_TLS_OPTIONS, "user", *_SECRETS)
_SHA256_HEX = 64
#: rosauth takes secrets of this length, and no other (ros_mac_authentication.cpp).
_ROSAUTH_LENGTH = 16
#: How long, s, an authentication by rosauth is valid: as long as an experiment may take.
_ROSAUTH_SECONDS = 7 * 86_400

#: Codes of X509_V_ERR_… (openssl/x509_vfy.h), and what each is to a user.
_EXPIRED, _NOT_YET, _HOSTNAME, _ADDRESS = 10, 9, 62, 64


@dataclass(frozen=True, slots=True)
class RosbridgeSecurity:
    """What the address of a rosbridge says of security; nothing in it is secret.

    What reads files and secrets raises a `LinkError` where one is not where the address says, or cannot be used.

    Attributes:
        is_tls: whether the connection is encrypted, and the server has to prove its identity.
        ca: certificates that are trusted; None for those of the system.
        cert: our own certificate, for servers that ask for one.
        key: the key of it; None where it is in the same file.
        fingerprint: SHA-256 of the one certificate that is trusted, in hexadecimal, lower case; empty to check by `ca`.
        user: for HTTP's Basic authentication.
        password: where the password is: `env:NAME` or `file:PATH`; empty where there is none. `token` and `rosauth`
            likewise.
        token: for HTTP's Bearer authentication.
        rosauth: the secret that rosauth has on the robot.
    """

    is_tls: bool = False
    ca: Path | None = None
    cert: Path | None = None
    key: Path | None = None
    fingerprint: str = ""
    user: str = ""
    password: str = ""
    token: str = ""
    rosauth: str = ""

    @classmethod
    def of(cls, options: Mapping[str, str], *, is_tls: bool) -> RosbridgeSecurity:
        """Take the options of an address; raise a `LinkError` if they do not go together, or have a wrong value."""
        if vain := [name for name in _TLS_OPTIONS if name in options and not is_tls]:
            raise _refused(f"{vain[0]} is given, and the address is not one of TLS", "Write rosbridge+tls://….")
        ca, cert, key = (Path(path).expanduser() if (path := options.get(name)) else None for name in _TLS_OPTIONS[:3])
        fingerprint = options.get("fingerprint", "").replace(":", "").casefold()
        if fingerprint and not (len(fingerprint) == _SHA256_HEX and set(fingerprint) <= set("0123456789abcdef")):
            fix = "Give the SHA-256 of the server's certificate: openssl x509 -in cert.pem -noout -fingerprint -sha256."
            raise _refused(f"the fingerprint has {len(fingerprint)} characters of hexadecimal, not 64", fix)
        user, password, token = options.get("user", ""), _place(options, "password"), _place(options, "token")
        if bool(user) != bool(password) or (password and token):
            fix = "Give user= with password_env= (or password_file=), or token_env= (or token_file=) alone."
            raise _refused("user, password and token do not go together", fix)
        return cls(is_tls, ca, cert, key, fingerprint, user, password, token, _place(options, "rosauth"))

    @property
    def sends_secrets(self) -> bool:
        """Whether a password or a token is sent over the connection."""
        return bool(self.password or self.token)

    def check(self) -> None:
        """Check that files and secrets exist; nothing is connected."""
        self.headers()
        self.authentication("here", "there")
        if self.is_tls:
            self.context()

    def context(self) -> ssl.SSLContext:
        """Return what a server's certificate is checked by; one with a fingerprint is checked by that alone."""
        try:
            context = ssl.create_default_context(cafile=self.ca)
            if self.ca is not None:  # from Python 3.13 on, an authority that a lab has made with few options is refused
                context.verify_flags &= ~ssl.VERIFY_X509_STRICT
            if self.cert is not None:
                context.load_cert_chain(self.cert, self.key, password=_no_passphrase)
        except (OSError, ValueError) as error:
            named = " or ".join(str(path) for path in (self.ca, self.cert, self.key) if path is not None)
            reason = getattr(error, "strerror", None) or getattr(error, "reason", None) or str(error)
            fix = "Give files in PEM, readable by you; a key has no passphrase here."
            raise _refused(f"{named} cannot be used: {reason}", fix) from error
        if self.fingerprint:
            context.check_hostname = False
            context.verify_mode = ssl.CERT_NONE
        return context

    def headers(self) -> dict[str, str]:
        """Return the HTTP headers with our credentials."""
        if self.token:
            return {"Authorization": f"Bearer {_secret(self.token)}"}
        if self.password:
            both = f"{self.user}:{_secret(self.password)}".encode()
            return {"Authorization": f"Basic {base64.b64encode(both).decode('ascii')}"}
        return {}

    def authentication(self, client: str, dest: str) -> dict[str, Any] | None:
        """Return the operation that authenticates us by rosauth; None if that is not used.

        Source: rosauth, ros_mac_authentication.cpp: the SHA-512 of secret, client, dest, rand, t, level and end.
        """
        if not self.rosauth:
            return None
        secret = _secret(self.rosauth)
        if len(secret) != _ROSAUTH_LENGTH:
            fix = f"Give the same {_ROSAUTH_LENGTH} characters as rosauth has in its secret_file_location."
            raise _refused(f"the secret of rosauth has {len(secret)} characters", fix)
        now = int(time.time())
        facts = {"client": client, "dest": dest, "rand": secrets.token_hex(16), "t": now, "level": "user"}
        facts["end"] = now + _ROSAUTH_SECONDS
        mac = hashlib.sha512((secret + "".join(map(str, facts.values()))).encode()).hexdigest()
        return {"op": "auth", "mac": mac, **facts}


def _no_passphrase() -> str:
    raise ValueError("the key has a passphrase")  # caught above; else OpenSSL would ask at the terminal


def _place(options: Mapping[str, str], kind: str) -> str:
    given = [f"{source}:{options[name]}" for source in ("env", "file") if (name := f"{kind}_{source}") in options]
    if len(given) > 1:
        raise _refused(f"{kind}_env and {kind}_file are both given", "Leave one of them out.")
    return given[0] if given else ""


def _secret(place: str) -> str:
    """Return what a variable or a file holds; no error of it says what that is."""
    source, _, name = place.partition(":")
    if source == "env":
        value = os.environ.get(name, "")
        if not value:
            raise _refused(f"the variable {name} is not set, or empty", f"export {name}=…")
        return value
    try:
        value = Path(name).expanduser().read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not text"
        raise _refused(
            f"the secret in {name} cannot be read: {reason}", "Name a file of text that you can read."
        ) from error
    if not value or "\n" in value:
        raise _refused(f"the file {name} is empty, or has several lines", "Put the secret there, in one line.")
    return value


def _refused(problem: str, fix: str) -> LinkError:
    return LinkError(problem, where=_WHERE, fix=fix)


# The socket: what a server's certificate says is seen before anything of ours is sent.

_T = TypeVar("_T")
#: How often a thread that waits for the network checks whether another one has closed the socket, s: no event tells.
_LOOK = 0.5


class TurnTakingSocket(ssl.SSLSocket):
    """A connection by TLS that one thread reads and another writes, as those of websockets do.

    OpenSSL keeps one state for both, and Python does not lock it: where both are in it at once, a request was lost, or
    the connection was. So they take turns, and wait for the network outside of these. Once the handshake is over, the
    timeout is that of sending alone; what is to be read may take as long as it likes.
    """

    _turn: threading.Lock | None = None
    _sending: float | None = None

    def do_handshake(self, block: bool = False) -> None:
        """Do the handshake with the timeout that the socket has; from then on threads take turns."""
        super().do_handshake(block)
        self._sending = self.gettimeout()
        super().settimeout(0.0)
        self._turn = threading.Lock()

    def settimeout(self, value: float | None) -> None:
        """Set how long the network may take nothing of what is sent, s; until the handshake is over, of anything."""
        if self._turn is None:
            super().settimeout(value)
        else:
            self._sending = value

    def recv(self, buflen: int = 1024, flags: int = 0) -> bytes:
        """Receive bytes, without a timeout."""
        return self._in_turn(partial(super().recv, buflen, flags), None)

    def sendall(self, data: Any, flags: int = 0) -> None:
        """Send all of it; raise a `TimeoutError` if the network takes nothing more."""
        rest = memoryview(data)
        while rest:
            rest = rest[self._in_turn(partial(super().send, rest, flags), self._sending) :]

    def _in_turn(self, act: Callable[[], _T], timeout: float | None) -> _T:
        deadline = math.inf if timeout is None else time.monotonic() + timeout
        while self._turn is not None:
            with self._turn:
                try:
                    return act()
                except ssl.SSLWantReadError:
                    awaited = select.POLLIN
                except ssl.SSLWantWriteError:
                    awaited = select.POLLOUT
            if time.monotonic() > deadline:
                raise TimeoutError("the network takes nothing more")
            self._await(awaited, min(_LOOK, deadline - time.monotonic()))
        return act()  # a socket that listens

    def _await(self, event: int, seconds: float) -> None:
        if self.fileno() < 0:  # another thread has closed it
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        poller = select.poll()
        poller.register(self, event)
        poller.poll(max(0.0, seconds) * 1000)


def secure_socket(
    host: str, port: int, security: RosbridgeSecurity, timeout: float, sending: float, *, where: str
) -> ssl.SSLSocket:
    """Connect by TLS to a server that has proved its identity within a timeout (s): its certificate is of this host.

    From then on, the network may take nothing of what is sent for `sending` (s).

    Raises:
        LinkError: the certificate is not trusted, of another host or out of date, or TLS is not spoken there.
        OSError: no server can be reached there.
    """
    deadline = time.monotonic() + timeout
    plain = socket.create_connection((host, port), timeout=timeout)
    try:
        plain.settimeout(max(0.01, deadline - time.monotonic()))
        context = security.context()
        context.sslsocket_class = TurnTakingSocket
        secure = context.wrap_socket(plain, server_hostname=host)
        if security.fingerprint:
            _check_fingerprint(secure, security.fingerprint, where)
    except ssl.SSLCertVerificationError as error:
        plain.close()
        raise _distrusted(error, host, where) from error
    except TimeoutError as error:
        plain.close()
        raise _no_tls(where, f"it does not answer as TLS within {timeout:g} s") from error
    except (ssl.SSLError, ConnectionError) as error:
        plain.close()
        raise _no_tls(where, getattr(error, "reason", None) or str(error)) from error
    except BaseException:
        plain.close()
        raise
    secure.settimeout(sending)
    return secure


def _check_fingerprint(secure: ssl.SSLSocket, expected: str, where: str) -> None:
    found = hashlib.sha256(secure.getpeercert(binary_form=True) or b"").hexdigest()
    if found != expected:
        secure.close()
        problem = f"the server's certificate has another fingerprint: {found}"
        fix = "If it was renewed, compare this with the robot's own certificate, and give it. Otherwise: it is another."
        raise LinkError(problem, where=where, fix=fix)


def _distrusted(error: ssl.SSLCertVerificationError, host: str, where: str) -> LinkError:
    code, reason = error.verify_code, error.verify_message.rstrip(".")
    if code in {_HOSTNAME, _ADDRESS}:
        problem, fix = f"the server's certificate is not one of {host!r}: {reason}", "Name the host as it does."
    elif code == _EXPIRED:
        problem, fix = "the server's certificate has expired", "Renew it on the robot; or look at this machine's clock."
    elif code == _NOT_YET:
        problem = "the server's certificate is not valid yet"
        fix = "Look at this machine's clock, and at the robot's."
    else:
        problem = f"the server's certificate is not trusted: {reason}"
        fix = "Give the one that signed it (ca=lab-ca.pem), or the fingerprint of a self-signed one (fingerprint=…)."
    return LinkError(problem, where=where, fix=fix)


def _no_tls(where: str, reason: str) -> LinkError:
    fix = "Start the server with certfile and keyfile, or behind a proxy with TLS; or write rosbridge:// without TLS."
    return LinkError(f"no TLS connection can be made there: {reason}", where=where, fix=fix)


def speaks_tls(host: str, port: int, timeout: float) -> bool:
    """Whether a server that does not answer in plain text speaks TLS."""
    context = ssl.create_default_context()
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    try:
        with (
            socket.create_connection((host, port), timeout=timeout) as plain,
            context.wrap_socket(plain, server_hostname=host),
        ):
            return True
    except OSError:
        return False
