"""A thread for what a stop request must not interrupt."""

from __future__ import annotations

import _thread
import os
import queue
import threading
from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")


class OwnThread:
    """Executes functions one after the other in a thread of its own, while the callers wait.

    A stop request raises an exception in the thread of a callback, wherever that is: in the midst of a message, say, of
    which a part has been sent or kept for sending. The robot would then take the stop command that follows for the rest
    of that message. Stop requests do not interrupt other threads.

    Only what C does as a whole is used on the caller's side. `threading.Thread`, `Condition` and `Future` are written
    in Python: an exception within them leaves their locks taken, so that the next caller would wait for ever.

    The thread does not keep the interpreter from exiting, and executes until then, also what `atexit` calls. A forked
    process starts its own.

    Example:
        >>> OwnThread().call(lambda: 1 + 1)
        2
    """

    def __init__(self) -> None:
        self._process = 0
        self._tasks: queue.SimpleQueue[_Task | None] = queue.SimpleQueue()

    def call(self, act: Callable[[], T]) -> T:
        """Return what `act` returns, or raise what it raises; `act` is completed even if the wait is interrupted."""
        if self._process != os.getpid():
            self._tasks = queue.SimpleQueue()
            _thread.start_new_thread(_work, (self._tasks,))
            self._process = os.getpid()
        task = _Task(act)
        self._tasks.put(task)
        task.is_over.acquire()
        if task.error is not None:
            raise task.error
        return task.returned  # type: ignore[no-any-return]

    def close(self) -> None:
        """End the thread, once it has executed what waits."""
        self._tasks.put(None)


class _Task:
    """A function to execute; `returned` or `error` is its outcome once `is_over` is released."""

    __slots__ = ("act", "error", "is_over", "returned")

    def __init__(self, act: Callable[[], Any]) -> None:
        self.act = act
        self.returned: Any = None
        self.error: BaseException | None = None
        self.is_over = threading.Lock()
        self.is_over.acquire()


def _work(tasks: queue.SimpleQueue[_Task | None]) -> None:
    while (task := tasks.get()) is not None:
        try:
            task.returned = task.act()
        except BaseException as error:  # noqa: BLE001 - the caller raises it
            task.error = error
        task.is_over.release()
