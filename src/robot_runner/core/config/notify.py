"""Notifications: at which moments they are sent, and where their secret addresses come from."""

from __future__ import annotations

import importlib.util
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from robot_runner.core.design.numeric_range import is_whole
from robot_runner.core.errors import Finding, did_you_mean

#: The moments at which notifications can be sent.
NOTIFIED_OF = ("end", "failure", "waiting")
_VARIABLE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_MOST_BYTES = 64 * 1024
_INSTALL = "Install it: pip install 'robot-runner[notify]'. Or go without: --set notify=none"


@dataclass(frozen=True, slots=True)
class Notify:
    """Notifies people by mail, ntfy, Slack, Telegram and others (https://appriseit.com) how the experiment goes on.

    The addresses hold passwords: they are in an environment variable or in a file, one a line, and nowhere else.

    Attributes:
        on: when to notify: at the `end` of the experiment, at the `failure` of a run, while it is `waiting` for a
            person or for a condition.
        every: also each time that so many runs have ended; None for never.
        url_from: an environment variable, or a file (its name has a `/`, or it is a Path).

    Example:
        >>> Notify(on=["end", "failure"], every=10, url_from="~/.config/robot-runner/notify").every
        10
    """

    on: Sequence[str] = NOTIFIED_OF
    every: int | None = None
    url_from: str | Path = "ROBOT_RUNNER_NOTIFY"

    def __repr__(self) -> str:
        shown = "'...'" if _is_address(self.url_from) else repr(str(self.url_from))  # it must not stand in a message
        return f"Notify(on={self.on!r}, every={self.every!r}, url_from={shown})"

    @property
    def source(self) -> str:
        """Where the addresses come from, in words."""
        return f"the file {self.url_from}" if self.is_file else f"the environment variable {self.url_from}"

    @property
    def is_file(self) -> bool:
        """Whether a file holds the addresses."""
        return isinstance(self.url_from, Path) or "/" in self.url_from


def _is_address(source: object) -> bool:
    return "://" in str(source)


def addresses_from(notify: Notify) -> tuple[str, ...]:
    """Return the addresses; none where the variable or the file is missing or empty."""
    if notify.is_file:
        try:
            with Path(notify.url_from).expanduser().open(encoding="utf-8") as file:
                text = file.read(_MOST_BYTES)
        except (OSError, UnicodeDecodeError, RuntimeError):
            return ()
    else:
        text = os.environ.get(str(notify.url_from), "")
    lines = (line.strip() for line in text.splitlines())
    return tuple(line for line in lines if line and not line.startswith("#"))


def check_notify(where: str, notify: Notify | None) -> Iterator[Finding]:
    """Yield findings on why notifications could not be sent."""
    if notify is None:
        return
    malformed = list(_malformed(where, notify))
    yield from malformed
    if malformed:
        return
    if not addresses_from(notify):
        fix = "Write the address there, such as ntfy://TOPIC (https://appriseit.com lists them)."
        yield Finding.warning(where, f"nobody will be notified: {notify.source} names no address", fix)
    elif importlib.util.find_spec("apprise") is None:
        yield Finding.error(where, "notifications need apprise, which is not installed", _INSTALL)


def _malformed(where: str, notify: Notify) -> Iterator[Finding]:
    if not isinstance(notify.on, list | tuple | set | frozenset):
        yield Finding.error(where, f"on is {notify.on!r}", f"Give a list of {', '.join(map(repr, NOTIFIED_OF))}.")
    else:
        for each in notify.on:
            if each not in NOTIFIED_OF:
                yield Finding.error(where, f"on holds {each!r}", did_you_mean(str(each), NOTIFIED_OF))
    every = notify.every
    if every is not None and (not is_whole(every) or every < 1):
        yield Finding.error(where, f"every is {every!r}", "Give a whole number of runs, 1 or more.")
    source = notify.url_from
    if _is_address(source):
        fix = "Name an environment variable or a file that holds it: configs are kept with the results."
        yield Finding.error(where, "url_from is an address itself", fix)
    elif not isinstance(source, str | Path):
        yield Finding.error(where, f"url_from is {source!r}", "Name an environment variable or a file.")
    elif not isinstance(source, Path) and "/" not in source and not _VARIABLE.fullmatch(source):
        yield Finding.error(where, f"{source!r} names no environment variable", "Or write a file's name with a '/'.")
