"""A live page beside an execution: a process of its own, which ends with the command, and which nothing depends on."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from robot_runner.core.errors import ExecutionError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

#: How long the page may take to listen, and to end, s; a Raspberry Pi takes some seconds to import its libraries.
_DEADLINE, _ENDING = 60.0, 3.0


@contextmanager
def page_beside(folder: Path, address: str | None) -> Iterator[str]:
    """Serve the page of an experiment while the block lasts (`HOST:PORT`, HOST, or None for this machine alone).

    Raises:
        ExecutionError: the page cannot be served; says why.
    """
    host, colon, port = (address or "").rpartition(":")
    at = {"--host": host if colon else port, "--port": port if colon else ""}
    words = [word for option, value in at.items() if value for word in (option, value)]
    command = [sys.executable, "-P", "-m", "robot_runner", "watch", str(folder), "--until-closed", *words]
    # In a session of its own: Ctrl-C is meant for the experiment, and the page shows how that ends.
    with subprocess.Popen(  # noqa: S603 - our own program
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True
    ) as page:
        try:
            yield _told(page)
        finally:
            _end(page)


def _told(page: subprocess.Popen[bytes]) -> str:
    """Return what the page printed until it listened.

    Raises:
        ExecutionError: it ended instead.
    """
    said, end = b"", time.monotonic() + _DEADLINE
    while page.stdout is not None:
        ready, _, _ = select.select([page.stdout], [], [], max(0.0, end - time.monotonic()))
        if not ready:
            raise ExecutionError(
                f"the live page does not listen after {_DEADLINE:g} s", where="--page", fix="Leave --page out."
            )
        piece = os.read(page.stdout.fileno(), 65536)
        if not piece:
            break
        said += piece
    text = said.decode("utf-8", "replace")
    with suppress(subprocess.TimeoutExpired):
        page.wait(0.1 if text.startswith("Live page") else _ENDING)
        raise _refusal(text)
    return text


def _refusal(text: str) -> ExecutionError:
    lines = [line.strip() for line in text.splitlines()]
    problem = next((line.removeprefix("error: ") for line in lines if line.startswith("error: ")), "the page ended")
    fix = next((line.removeprefix("fix: ") for line in lines if line.startswith("fix: ")), "Leave --page out.")
    return ExecutionError(problem, where="--page", fix=fix)


def _end(page: subprocess.Popen[bytes]) -> None:
    if page.stdin is not None:
        with suppress(OSError):
            page.stdin.close()
    try:
        page.wait(_ENDING)
    except subprocess.TimeoutExpired:
        page.kill()
