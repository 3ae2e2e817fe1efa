"""Starts and stops the tasks, one at a time, and answers as a service does."""

from __future__ import annotations

import threading
from functools import partial
from typing import TYPE_CHECKING

from robot_runner_onboard.errors import TaskError
from robot_runner_onboard.worker import Worker

if TYPE_CHECKING:
    from typing import Callable, Mapping, Sequence, Tuple

    Answer = Tuple[bool, str]
    Command = Callable[[], Sequence[str]]

__all__ = ["TaskDesk"]


class TaskDesk:
    """The tasks of one robot, of which one at most is going on.

    Args:
        commands: by the name of each task what returns its worker's argument list, or raises `TaskError`.

    Example:
        >>> import sys
        >>> desk = TaskDesk({"computation": lambda: [sys.executable, "-m", "robot_runner_onboard.computation"]})
        >>> desk.start("computation")
        (True, 'computation started')
        >>> desk.start("computation")
        (False, 'computation is running already')
        >>> desk.stop_all()[0]
        True
    """

    def __init__(self, commands: Mapping[str, Command]) -> None:
        self._commands = dict(commands)
        self._lock = threading.Lock()  # ROS answers each caller in a thread of its own
        self._running: tuple[str, Worker] | None = None

    @property
    def worker_pid(self) -> int | None:
        """The process id of the task that is going on, or None."""
        running = self._running
        return running[1].pid if running is not None and running[1].is_alive else None

    def services(self) -> dict[str, Callable[[], Answer]]:
        """Return what answers each service, by the service's name."""
        services: dict[str, Callable[[], Answer]] = {"task/stop": self.stop_all}
        for name in self._commands:
            services[f"task/{name}/start"] = partial(self.start, name)
            services[f"task/{name}/stop"] = partial(self.stop, name)
        return services

    def start(self, name: str) -> Answer:
        """Start a task; not while another one is going on."""
        with self._lock:
            if self._running is not None:
                if self._running[1].is_alive:
                    return False, f"{self._running[0]} is running already"
                self._running[1].kill()  # it is dead: let go of its pipes
            self._running = None
            try:
                self._running = name, Worker(self._commands[name]())
            except TaskError as error:
                return False, f"{name} cannot be started: {error}"
            return True, f"{name} started"

    def stop(self, name: str) -> Answer:
        """Stop this task; no success if it is not going on, or failed meanwhile."""
        with self._lock:
            if self._running is None or self._running[0] != name:
                return False, f"{name} is not running"
            return self._stop_worker(*self._running)

    def stop_all(self) -> Answer:
        """Stop whatever is going on; that nothing is, is a success."""
        with self._lock:
            return (True, "nothing was running") if self._running is None else self._stop_worker(*self._running)

    def _stop_worker(self, name: str, worker: Worker) -> Answer:
        self._running = None
        try:
            return True, f"{name} stopped: {worker.stop()}"
        except TaskError as error:
            return False, f"{name} failed: {error}"
