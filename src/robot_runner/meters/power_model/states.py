"""The states of the robot and its computer, piece by piece, from raw data of other plugins."""

from __future__ import annotations

import csv
import math
import re
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from robot_runner.core.errors import AnalysisError
from robot_runner.core.events.window import Window
from robot_runner.core.storage.guarded_files import MissingFileError, open_text
from robot_runner.meters.counters import unwrapped
from robot_runner.meters.network import wraps_at

#: Phases in which the robot stands still; every other one is a motion.
_STILL = frozenset({"", "sleep", "task"})
_CORE = re.compile(r"cpu_core(\d+)_percent")
_FREQUENCY = re.compile(r"frequency_cpu(\d+)_Hz")
_BYTES = re.compile(r".+_[rt]x_bytes")
_GPU = re.compile(r"gpu\d+_gpu_percent")
_PERCENT, _MEGA = 100.0, 1e6


@dataclass(frozen=True, slots=True, kw_only=True)
class Sources:
    """The plugins whose raw data contain the states of the robot; None for none.

    Attributes:
        utilisation: with `cpu_percent`, `memory_percent` and the utilisation of each core in its `samples.csv`.
        phases: with `phase` and `task` in its `phases.csv`.
        frequency: with `frequency_cpu<n>_Hz`, as LinuxThermal; the utilisation of the cores is from `utilisation`.
        network: with `<interface>_rx_bytes` and `<interface>_tx_bytes`, as Network.
        gpu: with `gpu<n>_gpu_percent`, as Nvml.
    """

    utilisation: str | None = None
    phases: str | None = None
    frequency: str | None = None
    network: str | None = None
    gpu: str | None = None


@dataclass(frozen=True, slots=True)
class RobotState:
    """The state of the robot during a short time in which it did not change.

    Attributes:
        start: s on the run's clock.
        end: s on the run's clock.
        cpu: CPU utilisation, 0..100 %; None where it was not sampled.
        memory: memory in use, 0..100 %; None where it was not sampled.
        phase: the phase of the mission, such as `forward`; empty between missions.
        task: the task that the on-board computer worked on; empty for none.
        has_moved: whether the robot has moved in this run, now or before: it draws more from then on.
        cores: for each core its frequency in MHz, and the share of the time that it was busy, 0..1; None where these
            were not sampled.
        network: traffic over the network, in and out, MB/s; None where it was not sampled.
        gpu: sum of the utilisations of the GPUs, 0..100 % each; None where it was not sampled.

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
        """The phase, if the robot moves in it; else empty."""
        return "" if self.phase in _STILL else self.phase

    @property
    def seconds(self) -> float:
        """The duration, s."""
        return self.end - self.start


def read_states(run_folder: Path, window: Window, sources: Sources) -> list[RobotState]:
    """Return the states of the robot in a window of a run, on the run's clock, oldest first, without gaps.

    Raises:
        AnalysisError: a file is missing or malformed.
    """
    mission = _Mission(_read_phases(run_folder / sources.phases / "phases.csv") if sources.phases else ())
    computer = _Computer(run_folder, sources)
    edges = {window.start, window.end, *computer.edges()}
    edges.update(time for phase in mission.phases for time in (phase.start, phase.end))
    within = sorted(edge for edge in edges if window.start <= edge <= window.end)
    first_motion = mission.first_motion()
    states = []
    for start, end in pairwise(within):
        middle = (start + end) / 2
        cpu, memory = computer.utilisation(start, end)
        phase, task = mission.at(middle)
        states.append(
            RobotState(
                *(start, end, cpu, memory, phase, task),
                has_moved=middle >= first_motion,
                cores=computer.cores(start, end),
                network=computer.network(start, end),
                gpu=computer.gpu(start, end),
            )
        )
    return states


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
        """Return the phase and the task of a moment; both empty outside of missions."""
        place = bisect_right(self.phases, time, key=lambda phase: phase.start) - 1
        if place < 0 or time >= self.phases[place].end:
            return "", ""
        return self.phases[place].name, self.phases[place].task

    def first_motion(self) -> float:
        """Return when the robot first began to move; infinite if it never did."""
        return min((phase.start for phase in self.phases if phase.name not in _STILL), default=math.inf)


def _read_phases(path: Path) -> list[_Phase]:
    rows = _rows_of(path, ("start_s", "end_s", "phase", "task"))
    phases = (
        _Phase(_number_of(path, row["start_s"]), _number_of(path, row["end_s"]), row["phase"], row["task"])
        for row in rows
    )
    return sorted(phases, key=lambda phase: phase.start)


@dataclass(frozen=True, slots=True)
class _Sampled:
    """Columns of numbers that were sampled together, oldest first; empty for a part that was not sampled."""

    times: Sequence[float] = ()
    columns: Sequence[Sequence[float]] = ()

    def around(self, start: float, end: float) -> tuple[int, int] | None:
        """Return the places of the samples that enclose a span; None if there are none."""
        after = bisect_left(self.times, end)
        if after == 0 or after == len(self.times) or self.times[after - 1] > start:
            return None
        return after - 1, after


class _Computer:
    """The states of the parts of a computer over a run; None for a part that was not sampled.

    Raises:
        AnalysisError: a file or its columns are missing.
    """

    def __init__(self, run_folder: Path, sources: Sources) -> None:
        def read(plugin: str | None, wanted: re.Pattern[str]) -> _Sampled:
            return _Sampled() if plugin is None else _read(run_folder / plugin / "samples.csv", wanted)

        used = sources.utilisation
        self._used = _read_utilisation(run_folder / used / "samples.csv") if used else _Sampled()
        self._frequencies = read(sources.frequency, _FREQUENCY)
        self._busy = read(used, _CORE) if sources.frequency is not None else _Sampled()
        self._traffic = read(sources.network, _BYTES)
        self._gpus = read(sources.gpu, _GPU)
        clocked, sampled = len(self._frequencies.columns), len(self._busy.columns)
        if used and clocked != sampled:
            problem = f"there are the frequencies of {clocked} cores, and {sampled} cores were sampled"
            path = run_folder / str(sources.frequency) / "samples.csv"
            fix = "Sample both on the same computer, or leave the frequency out."
            raise AnalysisError(problem, where=str(path), fix=fix)

    def edges(self) -> set[float]:
        """Return the times, s, at which something may have changed."""
        parts = (self._used, self._frequencies, self._traffic, self._gpus)
        return {time for sampled in parts for time in sampled.times}

    def utilisation(self, start: float, end: float) -> tuple[float | None, float | None]:
        """Return CPU and memory of the sample that covers a span: the first one at its end or later."""
        places = self._used.around(start, end)
        if places is None:
            return None, None
        cpu, memory = (column[places[1]] for column in self._used.columns)
        return cpu, memory

    def cores(self, start: float, end: float) -> tuple[tuple[int, float], ...] | None:
        """Return frequency (MHz) and busy share of the time (0..1) of each core over a span."""
        busy, clocked = self._busy.around(start, end), self._frequencies.around(start, end)
        if busy is None or clocked is None:
            return None
        shares = [column[busy[1]] / _PERCENT for column in self._busy.columns]
        clocks = [round(column[clocked[0]] / _MEGA) for column in self._frequencies.columns]
        return tuple(zip(clocks, shares, strict=True))

    def network(self, start: float, end: float) -> float | None:
        """Return the network traffic in a span, in and out, MB/s."""
        places = self._traffic.around(start, end)
        if places is None:
            return None
        before, after = places
        counts = [[int(column[before]), int(column[after])] for column in self._traffic.columns]
        total = sum(unwrapped(each, wraps_at(counts))[-1] for each in counts)
        return total / _MEGA / (self._traffic.times[after] - self._traffic.times[before])

    def gpu(self, start: float, end: float) -> float | None:
        """Return the sum of the GPUs' utilisations in a span, 0..100 % each."""
        places = self._gpus.around(start, end)
        return None if places is None else sum(column[places[1]] for column in self._gpus.columns)


def _read_utilisation(path: Path) -> _Sampled:
    times, cpu, memory = read_numbers(path, ("time_s", "cpu_percent", "memory_percent"))
    [every] = read_numbers(path, ("time_s",))
    if every[:1] < times[:1]:  # the first sample has no utilisation, and marks the beginning of the second one's time
        times, cpu, memory = [every[0], *times], [math.nan, *cpu], [math.nan, *memory]
    return _Sampled(times, (cpu, memory))


def _read(path: Path, wanted: re.Pattern[str]) -> _Sampled:
    columns = [name for name in _table_of(path)[0] if wanted.fullmatch(name)]
    if not columns:
        problem = f"the file has no column like {wanted.pattern!r}"
        raise AnalysisError(problem, where=str(path), fix="Name a plugin that samples it.")
    times, *numbers = read_numbers(path, ("time_s", *columns))
    return _Sampled(times, numbers)


def read_numbers(path: Path, columns: Sequence[str]) -> list[list[float]]:
    """Return these columns of a file of samples, without rows in which one of them is empty.

    Raises:
        AnalysisError: the file or one of the columns is missing, or a cell is not a number.
    """
    values: list[list[float]] = [[] for _ in columns]
    for row in _rows_of(path, columns):
        if not all(row[column] for column in columns):
            continue
        for column, cells in zip(columns, values, strict=True):
            cells.append(_number_of(path, row[column]))
    return values


def _rows_of(path: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    """Return the rows of a file with these columns; an `AnalysisError` says that one is missing, or the file."""
    heading, rows = _table_of(path)
    missing = [column for column in columns if column not in heading]
    if missing:
        fix = "Name a plugin whose raw data hold it."
        raise AnalysisError(f"the file has no column {missing[0]!r}", where=str(path), fix=fix)
    return rows


def _table_of(path: Path) -> tuple[Sequence[str], list[dict[str, str]]]:
    try:
        with open_text(path) as file:
            reader = csv.DictReader(file)
            return reader.fieldnames or (), list(reader)
    except MissingFileError as error:
        fix = "Have the experiment's plugins measure it, or name the plugin that does."
        raise AnalysisError("there is no such file", where=str(path), fix=fix) from error


def _number_of(path: Path, cell: str | None) -> float:
    try:
        return float(cell or "")
    except ValueError as error:
        fix = "Leave this run out: its raw data are damaged."
        raise AnalysisError(f"{cell!r} is not a number", where=str(path), fix=fix) from error
