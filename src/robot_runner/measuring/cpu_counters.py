"""From counters of CPU time to utilisation: what was busy between two looks at them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import zip_longest
from typing import TYPE_CHECKING

from robot_runner.measuring.host import ProcessUtilisation, UtilisationSample

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from robot_runner.measuring.device_clock import ClockMap


@dataclass(frozen=True, slots=True)
class CoreCounters:
    """CPU time of one core, or of all together, since the computer started; in any one unit.

    Attributes:
        total: all of it.
        idle: the part in which nothing was computed, waiting for disks included.
    """

    total: float
    idle: float


@dataclass(frozen=True, slots=True)
class ProcessCounters:
    """One process that a selector matched.

    Attributes:
        selector: the selector's place in the list that was asked for, from 0.
        pid: the process.
        started: anything that tells it from another process that had the same pid before, such as when it was started.
        cpu: CPU time that it has used, s.
        memory: physical memory that it holds, bytes.
    """

    selector: int
    pid: int
    started: str
    cpu: float
    memory: float


@dataclass(frozen=True, slots=True)
class CounterSample:
    """One look at a computer's counters.

    Attributes:
        time: on the clock that stamped it, s.
        whole: all cores together.
        cores: each core, None for one that is switched off; empty where the computer does not tell.
        memory_total: physical memory, bytes; 0 where the computer does not tell.
        memory_available: what programs could still get of it, bytes.
        processes: those that selectors matched.
    """

    time: float
    whole: CoreCounters
    cores: tuple[CoreCounters | None, ...]
    memory_total: float
    memory_available: float
    processes: tuple[ProcessCounters, ...] = ()


def placed_cores(counters: Mapping[int, CoreCounters]) -> tuple[CoreCounters | None, ...]:
    """Return the counters of cores in the order of their numbers, None for those in between that are switched off.

    Example:
        >>> placed_cores({0: CoreCounters(9, 5), 2: CoreCounters(9, 9)})[1] is None
        True
    """
    return tuple(map(counters.get, range(max(counters, default=-1) + 1)))


def utilisation_of(
    samples: Iterable[CounterSample], *, cores: int, selectors: int = 0, to_run: ClockMap | None = None
) -> list[UtilisationSample]:
    """Return the utilisation between each two looks; the first sample has none.

    Counters move in steps (10 ms on most Linux machines), so that a look may find them where they were: its sample has
    no CPU utilisation either, and the next one tells of the time of both.

    Args:
        samples: oldest first.
        cores: how many the computer has.
        selectors: how many selectors of processes there were.
        to_run: brings the samples' times to the run's clock; left out, they are on it already.

    Example:
        >>> first = CounterSample(0.0, CoreCounters(0, 0), (), 8e9, 6e9)
        >>> later = CounterSample(1.0, CoreCounters(400, 300), (), 8e9, 6e9)
        >>> [(sample.cpu, sample.memory) for sample in utilisation_of([first, later], cores=4)]
        [(None, 25.0), (25.0, 25.0)]
    """
    found: list[UtilisationSample] = []
    seen: dict[tuple[int, int, str], float] = {}
    spent = [0.0] * selectors
    before: CounterSample | None = None
    for sample in samples:
        for process in sample.processes:
            key = (process.selector, process.pid, process.started)
            # One that was not there at the look before was started since.
            spent[process.selector] += max(0.0, process.cpu - seen.get(key, process.cpu if before is None else 0.0))
            seen[key] = process.cpu
        cpu = None if before is None else _busy(before.whole, sample.whole)
        seconds = None if cpu is None or before is None else (sample.time - before.time) * cores
        found.append(
            UtilisationSample(
                time=sample.time if to_run is None else to_run.to_run(sample.time),
                cpu=cpu,
                memory=_share(sample.memory_total - sample.memory_available, sample.memory_total),
                cores=_cores(before, sample),
                processes=tuple(_process(sample, place, spent[place], seconds) for place in range(selectors)),
                host_time=None if to_run is None else sample.time,
            )
        )
        if before is None or sample.whole.total != before.whole.total:
            before, spent = sample, [0.0] * selectors
    return found


def _busy(before: CoreCounters | None, after: CoreCounters | None) -> float | None:
    if before is None or after is None or after.total <= before.total:
        return None
    # The counter of idle time of some kernels goes back by a step now and then.
    return min(100.0, max(0.0, 100.0 * (1.0 - (after.idle - before.idle) / (after.total - before.total))))


def _cores(before: CounterSample | None, sample: CounterSample) -> tuple[float | None, ...]:
    # The last one may have been switched off or on since.
    pairs = zip_longest(() if before is None else before.cores, sample.cores)
    return tuple(_busy(*pair) for pair in pairs)[: len(sample.cores)]


def _process(sample: CounterSample, selector: int, spent: float, seconds: float | None) -> ProcessUtilisation:
    matched: Sequence[ProcessCounters] = [one for one in sample.processes if one.selector == selector]
    return ProcessUtilisation(
        count=len(matched),
        # Above 100 where one is new: it may have computed for a second before it was found, which must not be lost.
        cpu=None if not seconds else 100.0 * spent / seconds,
        memory=_share(sum(one.memory for one in matched), sample.memory_total),
    )


def _share(part: float, whole: float) -> float | None:
    return min(100.0, 100.0 * part / whole) if whole > 0 else None
