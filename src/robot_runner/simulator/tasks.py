"""The tasks of the paper's mission on the on-board computer, and when they ran."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import numpy.typing as npt

__all__ = ["NO_TASK", "Task", "TaskRunner"]


class Task(Enum):
    """What the on-board computer can be told to do (paper, section II-C)."""

    COMPUTATION = "computation"
    VIDEO = "video"
    NETWORK = "network"


#: Stands for no task where tasks are numbered in the order of their definition.
NO_TASK = len(Task)

_NUMBERS = {task: number for number, task in enumerate(Task)}


class TaskRunner:
    """The on-board computer's task, of which there is one at a time, and the history of all of them.

    Example:
        >>> runner = TaskRunner(np.random.default_rng(1), deviation=1.0)
        >>> runner.start(Task.VIDEO, step=200)
        True
        >>> runner.start(Task.NETWORK, step=300)
        False
    """

    def __init__(self, noise: np.random.Generator, *, deviation: float) -> None:
        self._noise = noise
        self._deviation = deviation / 100
        self._steps = [0]
        self._numbers = [NO_TASK]
        self._gains = [1.0]
        self.running: Task | None = None

    def start(self, task: Task, *, step: int) -> bool:
        """Start a task from this step on and return whether it was started: not while another one runs."""
        if self.running is not None:
            return False
        self.running = task
        self._note(step, _NUMBERS[task], 1.0 + self._deviation * self._noise.standard_normal())
        return True

    def stop(self, *, step: int) -> Task | None:
        """Stop whatever runs from this step on and return it, or None if nothing ran."""
        stopped, self.running = self.running, None
        if stopped is not None:
            self._note(step, NO_TASK, 1.0)
        return stopped

    def numbers(self, first: int, last: int) -> npt.NDArray[np.int64]:
        """Return the number of the task that ran at each of the steps `first` to `last`, both included."""
        return np.array(self._numbers)[self._entries(first, last)]

    def gains(self, first: int, last: int) -> npt.NDArray[np.float64]:
        """Return by what factor the task that ran at each of these steps differed from its usual power."""
        return np.array(self._gains)[self._entries(first, last)]

    def _entries(self, first: int, last: int) -> npt.NDArray[np.int64]:
        return np.searchsorted(np.array(self._steps), np.arange(first, last + 1), side="right") - 1

    def _note(self, step: int, number: int, gain: float) -> None:
        self._steps.append(step)
        self._numbers.append(number)
        self._gains.append(gain)
