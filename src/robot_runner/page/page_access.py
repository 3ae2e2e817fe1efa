"""Access to a page, for looking or acting: keys in links, logins in cookies, and where requests come from."""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import re
import secrets
import socket
import time
from collections import OrderedDict
from collections.abc import Iterable, Mapping
from enum import IntEnum

from robot_runner.core.storage.guarded_files import MissingFileError, open_to_write, read_text, remove
from robot_runner.core.storage.layout import user_folder
from robot_runner.core.storage.system_refusals import storage_errors


class Role(IntEnum):
    """What a viewer may do; acting includes looking."""

    NOBODY = 0
    LOOKS = 1
    ACTS = 2


#: How long a login lasts, s: a study of a month.
LOGIN_LASTS = 31 * 24 * 3600
_SECRET_BYTES = 32


class Keys:
    """The keys of one user's pages, all derived from one secret, so that links and logins outlive the server.

    Nothing of it is kept in the folder of an experiment.

    Args:
        secret: what they are derived from.

    Example:
        >>> keys = Keys(b"only a test")
        >>> keys.role_of_key(keys.key(Role.LOOKS)), keys.role_of_key("guessed")
        (<Role.LOOKS: 1>, <Role.NOBODY: 0>)
        >>> keys.role_of_login(keys.login(Role.ACTS))
        <Role.ACTS: 2>
    """

    def __init__(self, secret: bytes) -> None:
        self._secret = secret

    @classmethod
    def of_user(cls, *, anew: bool = False) -> Keys:
        """Return the keys of this user.

        Args:
            anew: make a new secret, so that all earlier links and logins are void.

        Raises:
            StorageError: the secret cannot be kept.
        """
        path = user_folder("XDG_STATE_HOME") / "page-secret"
        with storage_errors(path.parent, "made"):
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        if anew:
            remove(path)
        try:
            found = bytes.fromhex(read_text(path, limit=4096).strip())
        except (MissingFileError, ValueError):
            found = b""
        if len(found) != _SECRET_BYTES:
            found = secrets.token_bytes(_SECRET_BYTES)
            with open_to_write(path, mode=0o600) as file:
                file.write(found.hex().encode())
        return cls(found)

    def key(self, role: Role) -> str:
        """Return the key for a link."""
        return self._signed(f"key {role.name}")[:32]

    def role_of_key(self, key: str) -> Role:
        """Return the role of a key."""
        return next((role for role in (Role.ACTS, Role.LOOKS) if _is_same(key, self.key(role))), Role.NOBODY)

    def login(self, role: Role) -> str:
        """Return the content of the cookie for a role."""
        until = int(time.time()) + LOGIN_LASTS
        return f"{role.name}.{until}.{self._signed(f'login {role.name} {until}')}"

    def role_of_login(self, login: str) -> Role:
        """Return the role of a cookie."""
        name, _, rest = login.partition(".")
        until, _, signature = rest.partition(".")
        if name not in Role.__members__ or not (until.isascii() and until.isdecimal() and len(until) < 12):  # noqa: PLR2004 - until the year 33658
            return Role.NOBODY
        is_valid = _is_same(signature, self._signed(f"login {name} {until}")) and int(until) > time.time()
        return Role[name] if is_valid else Role.NOBODY

    def _signed(self, text: str) -> str:
        return hmac.new(self._secret, text.encode(), hashlib.sha256).hexdigest()


def _is_same(one: str, other: str) -> bool:
    return hmac.compare_digest(one.encode("utf-8", "replace"), other.encode())


# Where a request comes from.


def known_names(more: Iterable[str] = ()) -> frozenset[str]:
    """Return the host names of this machine, in lower case."""
    name = socket.gethostname().casefold()
    return frozenset({"localhost", name, f"{name.partition('.')[0]}.local", *(each.casefold() for each in more)})


def is_known_host(header: str, names: frozenset[str]) -> bool:
    """Return whether a request was addressed to this machine.

    That prevents DNS rebinding: a page elsewhere sends its own name. Numeric addresses cannot be rebound. The port may
    be any, as proxies and tunnels have their own.

    Example:
        >>> is_known_host("127.0.0.1:8642", frozenset()), is_known_host("evil.example:8642", frozenset())
        (True, False)
    """
    host = re.sub(r":[0-9]*$", "", header)
    try:
        ipaddress.ip_address(host.removeprefix("[").removesuffix("]"))
    except ValueError:
        return host.casefold().removesuffix(".") in names
    return True


def is_of_same_origin(headers: Mapping[str, str], *, is_action: bool) -> bool:
    """Return whether a request comes from our own page.

    Args:
        headers: of the request, in lower case.
        is_action: whether it changes anything: then a header must say where it comes from.
    """
    site, origin = headers.get("sec-fetch-site"), headers.get("origin")
    if site is not None and site not in {"same-origin", "none"}:
        return False
    if origin is not None:
        return origin.partition("://")[2] == headers.get("host")
    return not is_action or site == "same-origin"


class RateLimit:
    """Limits how often each address may do something (token bucket).

    Args:
        burst: how often at once.
        rate: how often a second in the long run.

    Example:
        >>> limit = RateLimit(burst=2, rate=0.0)
        >>> [limit.lets_pass("10.0.0.1") for _ in range(3)]
        [True, True, False]
    """

    #: How many addresses are remembered.
    _MOST = 2_000

    def __init__(self, *, burst: float, rate: float) -> None:
        self._burst, self._rate = burst, rate
        self._left: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def lets_pass(self, address: str) -> bool:
        """Take one token of an address; return whether there was one."""
        now = time.monotonic()
        left, at = self._left.pop(address, (self._burst, now))
        left = min(self._burst, left + (now - at) * self._rate)
        self._left[address] = (left - 1 if left >= 1 else left, now)
        while len(self._left) > self._MOST:
            self._left.popitem(last=False)
        return left >= 1
