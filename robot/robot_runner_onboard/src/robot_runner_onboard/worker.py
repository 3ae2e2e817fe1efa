"""The node's side: a task in a process of its own, so that it loads a core alone and always can be ended."""

from __future__ import annotations

import queue
import subprocess
import threading
import time
from contextlib import suppress
from typing import TYPE_CHECKING

from robot_runner_onboard.channel import DONE, FAILED, READY
from robot_runner_onboard.errors import TaskError

if TYPE_CHECKING:
    from typing import Sequence, TextIO

__all__ = ["Worker"]

#: Callers of a service usually wait 5 s for its answer.
_START_PATIENCE = 4.0
_STOP_PATIENCE = 3.0
_ENDED = "@ended"


class Worker:
    """A worker's process, started when it is made.

    Args:
        command: its argument list.
        patience: how long, in seconds, it may take until it works.

    Raises:
        TaskError: it cannot be started, or says why it cannot work.
    """

    def __init__(self, command: Sequence[str], patience: float = _START_PATIENCE) -> None:
        self._said: queue.Queue[tuple[str, str]] = queue.Queue()
        try:
            self._process = subprocess.Popen(
                list(command),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                universal_newlines=True,
                start_new_session=True,  # a Ctrl-C in the node's terminal is not meant for it
            )
        except OSError as error:
            raise TaskError(f"{command[0]} cannot be started: {error}") from error
        threading.Thread(target=self._listen, args=(self._process.stdout,), daemon=True).start()
        self._wait_until_ready(patience)

    @property
    def is_alive(self) -> bool:
        """Whether its process lives."""
        return self._process.poll() is None

    @property
    def pid(self) -> int:
        """The id of its process."""
        return self._process.pid

    def stop(self, patience: float = _STOP_PATIENCE) -> str:
        """End it and return what it did.

        Raises:
            TaskError: it had failed, or had to be killed.
        """
        deadline = time.monotonic() + patience
        try:
            self._end_input()
            word, text = self._next(deadline)
            self._process.wait(max(0.1, deadline - time.monotonic()))
        except (queue.Empty, subprocess.TimeoutExpired):
            raise TaskError(f"it did not end within {patience:g} s and was killed") from None
        finally:
            self.kill()
        if word == DONE:
            return text
        raise TaskError(self._complaint(word, text))

    def kill(self) -> None:
        """End it at once, if it still lives."""
        if self.is_alive:
            self._process.kill()
            self._process.wait()
        self._end_input()

    def _wait_until_ready(self, patience: float) -> None:
        try:
            word, text = self._next(time.monotonic() + patience)
        except queue.Empty:
            self.kill()
            raise TaskError(f"it did not begin within {patience:g} s") from None
        if word != READY:
            self.kill()
            raise TaskError(self._complaint(word, text))

    def _complaint(self, word: str, text: str) -> str:
        if word == FAILED and text:
            return text
        return f"it ended with code {self._process.wait()}; the log of its node says why"

    def _end_input(self) -> None:
        with suppress(BrokenPipeError):  # it may be gone already
            self._process.stdin.close()  # type: ignore[union-attr]  # it is a pipe

    def _next(self, deadline: float) -> tuple[str, str]:
        return self._said.get(timeout=max(0.0, deadline - time.monotonic()))

    def _listen(self, reports: TextIO) -> None:
        """Take what it says; other lines, such as a log of ROS, are not for us."""
        with reports:
            for line in reports:
                word, _, text = line.strip().partition(" ")
                if word in (READY, DONE, FAILED):
                    self._said.put((word, text))
        self._said.put((_ENDED, ""))
