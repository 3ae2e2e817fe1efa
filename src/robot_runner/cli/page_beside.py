"""A live page beside an execution: a process of its own, which ends with the command, and which nothing depends on."""

from __future__ import annotations

import os
import re
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from robot_runner.core.errors import ExecutionError

#: How long the page may take to listen, and to end, s; a Raspberry Pi takes some seconds to import its libraries.
_DEADLINE, _ENDING = 60.0, 3.0
_HERE = "127.0.0.1"
_PLACE = re.compile(r"^(?:--host|--port|\S+:\d+): ")


@contextmanager
def page_beside(folder: Path, address: str | None) -> Iterator[str]:
    """Serve the page of an experiment while the block lasts (`HOST:PORT`, HOST, or None for this machine alone).

    Raises:
        ExecutionError: the page cannot be served; says why.
    """
    host, port = (None, None) if address is None else _parts(address)
    words = [f"{option}={value}" for option, value in (("--host", host), ("--port", port)) if value is not None]
    command = [sys.executable, "-P", "-m", "robot_runner", "watch", str(folder), "--until-closed", *words]
    # In a session of its own: Ctrl-C is meant for the experiment, and the page shows how that ends.
    with subprocess.Popen(  # noqa: S603 - our own program
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True
    ) as page:
        try:
            yield _told(page, address)
        finally:
            _end(page)


def _parts(address: str) -> tuple[str | None, str | None]:
    """Return host and port of `HOST:PORT`, each None where it is left out.

    Example:
        >>> [_parts(each) for each in ("0.0.0.0", ":8080", "[::1]:8080", "::1")]
        [('0.0.0.0', None), (None, '8080'), ('[::1]', '8080'), ('::1', None)]
    """
    host, colon, port = address.rpartition(":")
    if not colon or (":" in host and not host.endswith("]")):  # of an IPv6 address without brackets all is the host
        return address, None
    return host or None, port


def _told(page: subprocess.Popen[bytes], address: str | None) -> str:
    """Return what the page printed until it listened.

    Raises:
        ExecutionError: it ended instead.
    """
    said, end = b"", time.monotonic() + _DEADLINE
    while page.stdout is not None:
        ready, _, _ = select.select([page.stdout], [], [], max(0.0, end - time.monotonic()))
        if not ready:
            raise _refused(f"the live page does not listen after {_DEADLINE:g} s", "", address)
        piece = os.read(page.stdout.fileno(), 65536)
        if not piece:
            break
        said += piece
    text = said.decode("utf-8", "replace")
    with suppress(subprocess.TimeoutExpired):
        page.wait(0.1 if text.startswith("Live page") else _ENDING)
        raise _refusal(text, address)
    return text


def _refusal(text: str, address: str | None) -> ExecutionError:
    """Return what the page said, under the option that asked for it: it knows those of `watch` alone."""
    lines = [line.strip() for line in text.splitlines()]
    problem = next((line.removeprefix("error: ") for line in lines if line.startswith("error: ")), "the page ended")
    fix = next((line.removeprefix("fix: ") for line in lines if line.startswith("fix: ")), "")
    host = (_parts(address)[0] if address else None) or _HERE
    return _refused(_PLACE.sub("", problem, count=1), re.sub(r"--port (\d+)", rf"--page-at {host}:\1", fix), address)


def _refused(problem: str, fix: str, address: str | None) -> ExecutionError:
    option = "--page" if address is None else "--page-at"
    return ExecutionError(problem, where=f"{option} {address or ''}".strip(), fix=fix or f"Leave {option} out.")


def _end(page: subprocess.Popen[bytes]) -> None:
    if page.stdin is not None:
        with suppress(OSError):
            page.stdin.close()
    try:
        page.wait(_ENDING)
    except subprocess.TimeoutExpired:
        page.kill()
