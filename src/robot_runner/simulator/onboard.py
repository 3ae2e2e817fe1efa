"""The on-board computer: its CPU and memory utilisation, by task and motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import Enum
from itertools import pairwise

import numpy as np

from robot_runner.measuring.host import UtilisationSample
from robot_runner.simulator.drive import MOVING_WHEEL_SPEED, DifferentialDrive
from robot_runner.simulator.simulated_clock import STEP_NS
from robot_runner.simulator.turtlebot3_parameters import Floats, Integers, NoiseStreams, Turtlebot3Parameters


class Task(Enum):
    """The tasks of the on-board computer (paper, section II-C)."""

    COMPUTATION = "computation"
    VIDEO = "video"
    NETWORK = "network"


#: The number of no task; tasks are numbered in the order of their definition.
NO_TASK = len(Task)

_NUMBERS = {task: number for number, task in enumerate(Task)}


class TaskRunner:
    """The on-board computer's task, at most one at a time, and the history of all tasks.

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
        """Start a task from this step on, unless another one runs; return whether it was started."""
        if self.running is not None:
            return False
        self.running = task
        self._note(step, _NUMBERS[task], 1.0 + self._deviation * self._noise.standard_normal())
        return True

    def stop(self, *, step: int) -> Task | None:
        """Stop the running task from this step on and return it, or None if there was none."""
        stopped, self.running = self.running, None
        if stopped is not None:
            self._note(step, NO_TASK, 1.0)
        return stopped

    def numbers(self, first: int, last: int) -> Integers:
        """Return the number of the running task at each of the steps `first` to `last`, both included."""
        return np.array(self._numbers)[self._entries(first, last)]

    def gains(self, first: int, last: int) -> Floats:
        """Return the factor of the running task's power at each of these steps, relative to its nominal power."""
        return np.array(self._gains)[self._entries(first, last)]

    def _entries(self, first: int, last: int) -> Integers:
        return np.searchsorted(np.array(self._steps), np.arange(first, last + 1), side="right") - 1

    def _note(self, step: int, number: int, gain: float) -> None:
        self._steps.append(step)
        self._numbers.append(number)
        self._gains.append(gain)


_SECOND_NS = 1_000_000_000
_ROUNDING = 1e-9  # of a sample: the last one is due exactly at the stop


class OnboardComputer:
    """CPU: the mean since the sample before. Memory: that in use at the moment of the sample."""

    def __init__(
        self, parameters: Turtlebot3Parameters, drive: DifferentialDrive, tasks: TaskRunner, streams: NoiseStreams
    ) -> None:
        self._parameters = parameters
        self._drive = drive
        self._tasks = tasks
        self._noise = streams.numbered("utilisation samples", width=2)
        cpu, memory = streams.named("onboard").standard_normal(2).tolist()
        self._idle_cpu: float = parameters.cpu_idle + parameters.run_cpu_deviation * cpu
        self._idle_memory: float = parameters.memory_idle + parameters.run_memory_deviation * memory

    def samples(
        self, *, start_ns: int, stop_ns: int, rate: float, also_ns: Sequence[int] = ()
    ) -> list[UtilisationSample]:
        """Return the samples taken `rate` times a second between two moments, and at the other moments.

        Their times and their noise depend only on the clock, not on the start of sampling. CPU utilisation is None if
        no time has passed since the sample before.
        """
        first, last = int(start_ns * rate / _SECOND_NS + _ROUNDING) + 1, int(stop_ns * rate / _SECOND_NS + _ROUNDING)
        beat_ns = np.rint(np.arange(first, last + 1) * (_SECOND_NS / rate)).astype(np.int64)
        times_ns = np.union1d(np.minimum(beat_ns, stop_ns), np.array(also_ns, dtype=np.int64))
        if not len(times_ns):
            return []
        steps = times_ns // STEP_NS
        errors = self._noise.at(steps)
        cpu = self._busy(np.concatenate([[start_ns // STEP_NS], steps])) + self._parameters.cpu_deviation * errors[:, 0]
        memory = self._memory(steps) + self._parameters.memory_deviation * errors[:, 1]
        rows = np.stack([times_ns / _SECOND_NS, np.clip(cpu, 0, 100), np.clip(memory, 0, 100)], axis=1)
        return [
            UtilisationSample(time, None if math.isnan(cpu) else cpu, memory) for time, cpu, memory in rows.tolist()
        ]

    def _busy(self, ends: Integers) -> Floats:
        """Return the mean CPU utilisation between each two of these steps; NaN between a step and itself."""
        parameters = self._parameters
        first, last = int(ends[0]), int(ends[-1])
        by_task = np.array([parameters.cpu_computation, parameters.cpu_video, parameters.cpu_network, 0.0])
        speeds = np.abs(self._drive.wheel_speeds[first : last + 1]).max(axis=1)
        by_step = (
            self._idle_cpu
            + by_task[self._tasks.numbers(first, last)]
            + parameters.cpu_moving * (speeds > MOVING_WHEEL_SPEED)
        )
        # Separate sums: the rounding of one cumulative sum would depend on the start of sampling.
        pairs = pairwise((ends - first).tolist())
        total = np.add.reduce  # as `mean` does, without its checks of the argument
        means = [
            total(by_step[sooner + 1 : later + 1]) / (later - sooner) if later > sooner else math.nan
            for sooner, later in pairs
        ]
        return np.array(means)

    def _memory(self, ends: Integers) -> Floats:
        parameters = self._parameters
        by_task = np.array([parameters.memory_computation, parameters.memory_video, parameters.memory_network, 0.0])
        first, last = int(ends[0]), int(ends[-1])
        used: Floats = self._idle_memory + by_task[self._tasks.numbers(first, last)[ends - first]]
        return used
