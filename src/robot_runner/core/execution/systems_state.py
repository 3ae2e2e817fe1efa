"""Which process is responsible for a run's systems: known to the run, its keeper, its standby and the orchestrator."""

from __future__ import annotations

import os
import tempfile
import threading
from enum import IntEnum

#: The longest reason that is kept of why a system could not be made safe, bytes.
_REASON = 2000
#: Behind it stand the commanded topics, a line each.
_TOPICS = 1 + _REASON
#: The longest list of them, bytes; a robot has one or two.
_LONGEST_LIST = 100_000


class Care(IntEnum):
    """Who has the care of a run's systems."""

    NOBODY_YET = 0
    RUN = 1
    SAFE = 2
    STANDBY = 3
    MADE_SAFE = 4
    OUT_OF_REACH = 5


class SystemsState:
    """What the processes of a run tell each other of its systems: a file without a name, which all of them inherit.

    Attributes:
        descriptor: of that file; a process that replaces itself hands it on.
    """

    def __init__(self, descriptor: int | None = None) -> None:
        if descriptor is None:
            with tempfile.TemporaryFile() as file:
                descriptor = os.dup(file.fileno())
        self.descriptor = descriptor
        self._lock = threading.Lock()

    @property
    def care(self) -> Care:
        """Who has the care of the systems now."""
        return Care((os.pread(self.descriptor, 1, 0) or b"\0")[0])

    @property
    def reason(self) -> str:
        """Why they could not be made safe; or what is not known of a robot that was told to stand still."""
        return os.pread(self.descriptor, _REASON, 1).rstrip(b"\0").decode("utf-8", "replace")

    @property
    def commanded(self) -> list[tuple[str, str]]:
        """The full name and the type of each topic on which the run commands a velocity."""
        lines = os.pread(self.descriptor, _LONGEST_LIST, _TOPICS).decode().splitlines()
        return [(topic, message_type) for topic, _, message_type in (line.partition(" ") for line in lines)]

    def add_commanded(self, topic: str, message_type: str) -> None:
        """Say, in the run, that velocities will be commanded on a topic."""
        with self._lock:
            end = max(_TOPICS, os.fstat(self.descriptor).st_size)
            os.pwrite(self.descriptor, f"{topic} {message_type}\n".encode(), end)

    def set(self, care: Care, reason: str = "") -> None:
        """Say who has it from now on."""
        os.pwrite(self.descriptor, reason.encode("utf-8", "backslashreplace")[:_REASON].ljust(_REASON, b"\0"), 1)
        os.pwrite(self.descriptor, bytes([care]), 0)

    def close(self) -> None:
        """Let go of the file."""
        os.close(self.descriptor)
