"""The on-board computer: how busy its cores and its memory are, by task and motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.simulator.clock import STEP_NS
from robot_runner.simulator.drive import MOVING_WHEEL_SPEED

if TYPE_CHECKING:
    import numpy.typing as npt

    from robot_runner.simulator.drive import DifferentialDrive
    from robot_runner.simulator.parameters import Turtlebot3Parameters
    from robot_runner.simulator.tasks import TaskRunner

    Floats = npt.NDArray[np.float64]

__all__ = ["OnboardComputer", "Utilisation"]

_SECOND_NS = 1_000_000_000
_ROUNDING = 1e-9  # of a sample: the last one falls due at the very moment of the stop


@dataclass(frozen=True, slots=True)
class Utilisation:
    """Seconds on the simulation's clock, and CPU and memory utilisation in percent (0..100)."""

    time: float
    cpu: float
    memory: float


class OnboardComputer:
    """CPU: the mean since the sample before. Memory: what is in use at the moment of the sample."""

    def __init__(
        self,
        parameters: Turtlebot3Parameters,
        drive: DifferentialDrive,
        tasks: TaskRunner,
        noise: np.random.Generator,
    ) -> None:
        self._parameters = parameters
        self._drive = drive
        self._tasks = tasks
        self._noise = noise
        cpu, memory = noise.standard_normal(2).tolist()
        self._idle_cpu: float = parameters.cpu_idle + parameters.run_cpu_deviation * cpu
        self._idle_memory: float = parameters.memory_idle + parameters.run_memory_deviation * memory

    def samples(self, *, start_ns: int, stop_ns: int, rate: float) -> list[Utilisation]:
        """Return the samples taken `rate` times a second between two moments, the first one period after the first."""
        count = int((stop_ns - start_ns) * rate / _SECOND_NS + _ROUNDING)
        if count == 0:
            return []
        since_ns = np.rint(np.arange(count + 1) * (_SECOND_NS / rate)).astype(np.int64)
        times_ns = np.minimum(start_ns + since_ns, stop_ns)
        steps = times_ns // STEP_NS
        errors = self._noise.standard_normal((count, 2))
        cpu = self._busy(steps) + self._parameters.cpu_deviation * errors[:, 0]
        memory = self._memory(steps[1:]) + self._parameters.memory_deviation * errors[:, 1]
        rows = np.stack([times_ns[1:] / _SECOND_NS, np.clip(cpu, 0, 100), np.clip(memory, 0, 100)], axis=1)
        return [Utilisation(*row) for row in rows.tolist()]

    def _busy(self, ends: npt.NDArray[np.int64]) -> Floats:
        """Return the mean CPU utilisation between each two of these steps."""
        parameters = self._parameters
        first, last = int(ends[0]), int(ends[-1])
        by_task = np.array([parameters.cpu_computation, parameters.cpu_video, parameters.cpu_network, 0.0])
        speeds = np.abs(self._drive.wheel_speeds[first : last + 1]).max(axis=1)
        by_step = (
            self._idle_cpu
            + by_task[self._tasks.numbers(first, last)]
            + parameters.cpu_moving * (speeds > MOVING_WHEEL_SPEED)
        )
        total = np.concatenate([[0.0], np.cumsum(by_step[1:])])[ends - first]
        mean: Floats = np.diff(total) / np.diff(ends)
        return mean

    def _memory(self, ends: npt.NDArray[np.int64]) -> Floats:
        parameters = self._parameters
        by_task = np.array([parameters.memory_computation, parameters.memory_video, parameters.memory_network, 0.0])
        first, last = int(ends[0]), int(ends[-1])
        used: Floats = self._idle_memory + by_task[self._tasks.numbers(first, last)[ends - first]]
        return used
