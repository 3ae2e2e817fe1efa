"""What the robot did, piece by piece, as other plugins left it in the folder of a run."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

from robot_runner.meters.power_model.components import ComponentSources, read_components
from robot_runner.meters.power_model.raw_columns import number_of, read_numbers, rows_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from robot_runner.core.events.window import Window

#: Phases in which the robot stands still; every other one is a motion.
_STILL = frozenset({"", "sleep", "task"})


@dataclass(frozen=True, slots=True)
class RobotState:
    """What the robot did during a short while in which nothing of it changed.

    Attributes:
        start: when it began, s on the run's clock.
        end: when it ended, s on the run's clock.
        cpu: CPU utilisation, 0..100 %; None where it was not sampled.
        memory: memory in use, 0..100 %; None where it was not sampled.
        phase: the phase of the mission, such as `forward`; empty between missions.
        task: the task that the on-board computer worked on; empty for none.
        has_moved: whether the robot has moved in this run, now or before: it draws more from then on.
        cores: for each core its frequency in MHz, and the share of the time that it was busy, 0..1; None where these
            were not sampled.
        network: what went over the network, in and out, MB/s; None where it was not sampled.
        gpu: how busy the GPUs were, 0..100 % each, added up; None where it was not sampled.

    Example:
        >>> RobotState(5.0, 5.1, cpu=12.0, memory=25.0, phase="forward", task="", has_moved=True).motion
        'forward'
    """

    start: float
    end: float
    cpu: float | None = None
    memory: float | None = None
    phase: str = ""
    task: str = ""
    has_moved: bool = False
    cores: tuple[tuple[int, float], ...] | None = None
    network: float | None = None
    gpu: float | None = None

    @property
    def motion(self) -> str:
        """The phase, where it is one in which the robot moves; else empty."""
        return "" if self.phase in _STILL else self.phase

    @property
    def seconds(self) -> float:
        """How long it lasted, s."""
        return self.end - self.start


@dataclass(frozen=True, slots=True)
class _Phase:
    start: float
    end: float
    name: str
    task: str


@dataclass(frozen=True, slots=True)
class _Mission:
    phases: Sequence[_Phase]  # in the order of their start

    def at(self, time: float) -> tuple[str, str]:
        """Return the phase and the task of a moment; both empty where the mission was not going on."""
        place = bisect_right(self.phases, time, key=lambda phase: phase.start) - 1
        if place < 0 or time >= self.phases[place].end:
            return "", ""
        return self.phases[place].name, self.phases[place].task

    def first_motion(self) -> float:
        """Return when the robot first began to move; infinite if it never did."""
        return min((phase.start for phase in self.phases if phase.name not in _STILL), default=math.inf)


@dataclass(frozen=True, slots=True)
class _Utilisation:
    times: Sequence[float]
    cpu: Sequence[float]
    memory: Sequence[float]

    def between(self, start: float, end: float) -> tuple[float | None, float | None]:
        """Return CPU and memory of the sample that tells of this span: the first one taken at its end or later."""
        place = bisect_left(self.times, end)
        if place == 0 or place == len(self.times) or self.times[place - 1] > start:
            return None, None
        return self.cpu[place], self.memory[place]


def read_states(
    run_folder: Path,
    window: Window,
    *,
    utilisation: str | None,
    phases: str | None,
    components: ComponentSources | None = None,
) -> list[RobotState]:
    """Return what the robot did in a window of a run, oldest first, without gaps.

    Args:
        run_folder: the folder of the run.
        window: the span of time, on the run's clock.
        utilisation: the plugin whose `samples.csv` holds `cpu_percent` and `memory_percent`; None for none.
        phases: the plugin whose `phases.csv` holds `phase` and `task`; None for none.
        components: the plugins that tell of the parts of the computer; None for none.

    Raises:
        AnalysisError: a file is not there, or not as it should be.
    """
    sampled = _read_utilisation(run_folder / utilisation / "samples.csv") if utilisation else _Utilisation((), (), ())
    mission = _Mission(_read_phases(run_folder / phases / "phases.csv") if phases else ())
    parts = read_components(run_folder, components or ComponentSources(), utilisation=utilisation)
    edges = {window.start, window.end, *sampled.times, *parts.edges()}
    edges.update(time for phase in mission.phases for time in (phase.start, phase.end))
    within = sorted(edge for edge in edges if window.start <= edge <= window.end)
    first_motion = mission.first_motion()
    states = []
    for start, end in pairwise(within):
        middle = (start + end) / 2
        cpu, memory = sampled.between(start, end)
        phase, task = mission.at(middle)
        states.append(
            RobotState(
                *(start, end, cpu, memory, phase, task),
                has_moved=middle >= first_motion,
                cores=parts.cores(start, end),
                network=parts.network(start, end),
                gpu=parts.gpu(start, end),
            )
        )
    return states


def _read_utilisation(path: Path) -> _Utilisation:
    times, cpu, memory = read_numbers(path, ("time_s", "cpu_percent", "memory_percent"))
    [every] = read_numbers(path, ("time_s",))
    if every[:1] < times[:1]:  # the first sample has no utilisation, and tells from when on the second one does
        times, cpu, memory = [every[0], *times], [math.nan, *cpu], [math.nan, *memory]
    return _Utilisation(times, cpu, memory)


def _read_phases(path: Path) -> list[_Phase]:
    rows = rows_of(path, ("start_s", "end_s", "phase", "task"))
    phases = (
        _Phase(number_of(path, row["start_s"]), number_of(path, row["end_s"]), row["phase"], row["task"])
        for row in rows
    )
    return sorted(phases, key=lambda phase: phase.start)
