"""Files of samples on board: who they belong to, and which of them nobody will fetch any more."""

from __future__ import annotations

import hashlib
import logging
import os
import secrets
import socket
import uuid
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.core.errors import LinkError

if TYPE_CHECKING:
    from robot_runner.core.links.on_board_session import OnBoardSession

__all__ = ["new_token", "remove_leftovers"]

_logger = logging.getLogger(__name__)

_OWNER_DIGITS = 16


def new_token() -> str:
    """Return what a new file of samples is named after: this machine, this process, and a number of its own."""
    return f"{_owner()}-{os.getpid()}-{secrets.token_hex(8)}"


def remove_leftovers(session: OnBoardSession) -> None:
    """Remove the samples on board that runs of this machine left which are dead, with the loops that still keep them.

    Those of other machines are left alone: their runs may be alive. What cannot be removed is no fault of this run.
    """
    try:
        for path in session.ask("leftovers", _owner(), answer="paths"):
            if _is_left(path):
                session.ask("discard", path, answer="discarded")
                _logger.info("removed the samples of a run that was killed: %s on %s", path, session.where)
    except LinkError as error:
        _logger.warning("what runs that were killed left on board could not be removed: %s", error)


def _owner() -> str:
    """Return what tells this machine from others, and a container from those beside it, whose processes it sees not."""
    space = ""
    with suppress(OSError):
        space = str(Path("/proc/self/ns/pid").readlink())
    told = f"{socket.gethostname()} {uuid.getnode()} {space}"
    return hashlib.sha256(told.encode()).hexdigest()[:_OWNER_DIGITS]


def _is_left(path: str) -> bool:
    """Return whether the process that a file belongs to is dead."""
    pid = path.rpartition("/")[2].split("-")[-2]
    if not pid.isdigit():
        return False
    try:
        os.kill(int(pid), 0)
    except ProcessLookupError:
        return True
    except (PermissionError, OverflowError):
        return False
    return False
