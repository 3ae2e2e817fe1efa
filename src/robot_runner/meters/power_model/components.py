"""What the parts of a computer did: each core at its frequency, the network, the GPU; as other plugins sampled it."""

from __future__ import annotations

import re
from bisect import bisect_left
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.core.errors import AnalysisError
from robot_runner.meters.counters import unwrapped
from robot_runner.meters.network import wraps_at
from robot_runner.meters.power_model.raw_columns import heading_of, read_numbers

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

_CORE = re.compile(r"cpu_core(\d+)_percent")
_BYTES = re.compile(r".+_[rt]x_bytes")
_GPU = re.compile(r"gpu\d+_gpu_percent")
_PERCENT, _MEGA = 100.0, 1e6


@dataclass(frozen=True, slots=True, kw_only=True)
class ComponentSources:
    """The plugins whose `samples.csv` tell of the parts of a computer; None for none.

    Attributes:
        frequency: has `frequency_cpu<n>_Hz`, as LinuxThermal; how busy the cores are comes with the utilisation.
        network: has `<interface>_rx_bytes` and `<interface>_tx_bytes`, as Network.
        gpu: has `gpu<n>_gpu_percent`, as Nvml.
    """

    frequency: str | None = None
    network: str | None = None
    gpu: str | None = None


@dataclass(frozen=True, slots=True)
class _Sampled:
    """Some numbers that were sampled together, oldest first."""

    times: Sequence[float]
    columns: Sequence[Sequence[float]]

    def until(self, start: float, end: float) -> tuple[int, int] | None:
        """Return the places of the samples that enclose a span; None where there are none."""
        after = bisect_left(self.times, end)
        if after == 0 or after == len(self.times) or self.times[after - 1] > start:
            return None
        return after - 1, after


@dataclass(frozen=True, slots=True)
class Components:
    """What the parts of a computer did over a run; a part that was not sampled tells None at any time."""

    busy: _Sampled | None = None
    frequencies: _Sampled | None = None
    traffic: _Sampled | None = None
    gpus: _Sampled | None = None

    def edges(self) -> Iterator[float]:
        """Yield the times, s, at which something may have changed."""
        for sampled in (self.frequencies, self.traffic, self.gpus):
            yield from sampled.times if sampled else ()

    def cores(self, start: float, end: float) -> tuple[tuple[int, float], ...] | None:
        """Return frequency (MHz) and share of the time that it was busy (0..1) of each core over a span."""
        if self.busy is None or self.frequencies is None:
            return None
        busy, clocked = self.busy.until(start, end), self.frequencies.until(start, end)
        if busy is None or clocked is None:
            return None
        shares = [column[busy[1]] / _PERCENT for column in self.busy.columns]
        clocks = [round(column[clocked[0]] / _MEGA) for column in self.frequencies.columns]
        return tuple(zip(clocks, shares, strict=True))

    def network(self, start: float, end: float) -> float | None:
        """Return what went over the network in a span, in and out, MB/s."""
        places = self.traffic and self.traffic.until(start, end)
        if not self.traffic or not places:
            return None
        before, after = places
        counts = [[int(column[before]), int(column[after])] for column in self.traffic.columns]
        total = sum(unwrapped(each, wraps_at(counts))[-1] for each in counts)
        return total / _MEGA / (self.traffic.times[after] - self.traffic.times[before])

    def gpu(self, start: float, end: float) -> float | None:
        """Return how busy the GPUs were in a span, 0..100 % each, added up."""
        places = self.gpus and self.gpus.until(start, end)
        return sum(column[places[1]] for column in self.gpus.columns) if self.gpus and places else None


def read_components(run_folder: Path, sources: ComponentSources, *, utilisation: str | None) -> Components:
    """Return what the parts of the computer did in a run.

    Raises:
        AnalysisError: a file is not there, or does not hold what is looked for.
    """

    def read(plugin: str | None, wanted: re.Pattern[str]) -> _Sampled | None:
        return None if plugin is None else _read(run_folder / plugin / "samples.csv", wanted)

    frequencies = read(sources.frequency, re.compile(r"frequency_cpu(\d+)_Hz"))
    busy = read(utilisation, _CORE) if sources.frequency is not None else None
    if frequencies and busy and len(frequencies.columns) != len(busy.columns):
        clocked, sampled = len(frequencies.columns), len(busy.columns)
        raise AnalysisError(
            f"there are the frequencies of {clocked} cores, and {sampled} cores were sampled",
            where=str(run_folder / str(sources.frequency) / "samples.csv"),
            fix="Sample both on the same computer, or leave the frequency out.",
        )
    return Components(busy, frequencies, read(sources.network, _BYTES), read(sources.gpu, _GPU))


def _read(path: Path, wanted: re.Pattern[str]) -> _Sampled:
    columns = [name for name in heading_of(path) if wanted.fullmatch(name)]
    if not columns:
        raise AnalysisError(
            f"the file has no column like {wanted.pattern!r}", where=str(path), fix="Name a plugin that samples it."
        )
    times, *numbers = read_numbers(path, ("time_s", *columns))
    return _Sampled(times, numbers)
