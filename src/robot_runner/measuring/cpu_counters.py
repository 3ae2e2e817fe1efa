"""From counters of CPU time to utilisation: the busy share between two readings of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest

from robot_runner.measuring.device_clock import ClockMap
from robot_runner.measuring.host import RESCAN, ProcessUtilisation, UtilisationSample

#: A process that lasts this many periods of looking for new ones is not missed.
_BRIEF = 2


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
        selector: the selector's place in the list of selectors, from 0.
        pid: of the process.
        started: distinguishes it from an earlier process with the same pid, such as the time of its start.
        cpu: CPU time that it has used, s.
        memory: physical memory that it holds, bytes.
        parent: the process that started it, or that adopted it; 0 where that was not looked up.
        children: CPU time of its children that have ended and were reaped, s; 0 where they do not belong to what was
            selected.
    """

    selector: int
    pid: int
    started: str
    cpu: float
    memory: float
    parent: int = 0
    children: float = 0.0


@dataclass(frozen=True, slots=True)
class CounterSample:
    """One reading of a computer's counters.

    Attributes:
        time: on the clock that stamped it, s.
        whole: all cores together.
        cores: each core, None for one that is switched off; empty where that is unknown.
        memory_total: physical memory, bytes; 0 where that is unknown.
        memory_available: how much of it programs could still get, bytes.
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
    samples: Iterable[CounterSample],
    *,
    cores: int,
    selectors: int = 0,
    to_run: ClockMap | None = None,
    rescan: float = RESCAN,
) -> list[UtilisationSample]:
    """Return the utilisation between each two readings; the first sample has none.

    Counters move in steps (10 ms on most Linux machines), so that a reading may find them unchanged: then its sample
    has no CPU utilisation either, and the next one covers the time of both.

    Args:
        samples: oldest first.
        cores: how many the computer has.
        selectors: how many selectors of processes there were.
        rescan: how long a new process may exist before it is seen, s.
        to_run: converts the samples' times to the run's clock; without it, they are on it already.

    Example:
        >>> first = CounterSample(0.0, CoreCounters(0, 0), (), 8e9, 6e9)
        >>> later = CounterSample(1.0, CoreCounters(400, 300), (), 8e9, 6e9)
        >>> [(sample.cpu, sample.memory) for sample in utilisation_of([first, later], cores=4)]
        [(None, 25.0), (25.0, 25.0)]
    """
    found: list[UtilisationSample] = []
    families = [_Family(_BRIEF * rescan) for _ in range(selectors)]
    spent = [0.0] * selectors
    before: CounterSample | None = None
    for sample in samples:
        for place, family in enumerate(families):
            spent[place] += family.spent(sample.time, [one for one in sample.processes if one.selector == place])
        cpu = None if before is None else _busy(before.whole, sample.whole)
        seconds = None if cpu is None or before is None else (sample.time - before.time) * cores
        found.append(
            UtilisationSample(
                time=sample.time if to_run is None else to_run.to_run(sample.time),
                cpu=cpu,
                memory=_share(sample.memory_total - sample.memory_available, sample.memory_total),
                cores=_cores(before, sample),
                processes=tuple(
                    _process(sample, place, spent[place], seconds, family) for place, family in enumerate(families)
                ),
                host_time=None if to_run is None else sample.time,
            )
        )
        if before is None or sample.whole.total != before.whole.total:
            before, spent = sample, [0.0] * selectors
    return found


def counted_before(ended: Mapping[int, tuple[int, float]]) -> dict[int, float]:
    """Return, by process, the CPU time of its ended children that was counted while they lived, s.

    When a child ends, the parent's counter of children grows by all that it has used, also what was counted already.

    Args:
        ended: the processes that have ended since the last reading, by pid: the parent of each, and what it and its own
            ended children had used by then, s.

    Example:
        >>> counted_before({8: (7, 0.5), 9: (8, 20.0)})
        {7: 20.5}
    """
    found: dict[int, float] = {}
    for pid, (_, used) in ended.items():
        reaper = _reaper(pid, ended)
        found[reaper] = found.get(reaper, 0.0) + used
    return found


def _reaper(pid: int, ended: Mapping[int, tuple[int, float]]) -> int:
    # If the parent ended, too, its counter is gone: the process that reaped the parent has counted both.
    reaper, passed = ended[pid][0], {pid}
    while reaper in ended and reaper not in passed:
        passed.add(reaper)
        reaper = ended[reaper][0]
    return reaper


class _Family:
    """The CPU time of one selector's processes between readings, with children that started and ended in between.

    Args:
        brief: a process that lasts no longer may be missed, s.

    Attributes:
        ended: how many had ended at the last reading.
        reaped: how many of them were reaped by another process of the selector, as far as that can be known.
        brief: how many of them started after the first reading, and were too short-lived for others like them to be
            seen for certain.
        parents: how many of those that no other one reaped had had children, which may have ended with them.
    """

    def __init__(self, brief: float) -> None:
        self._brief = brief
        self.ended = self.reaped = self.brief = self.parents = 0
        self._since: dict[tuple[int, str], float] = {}
        self._seen: dict[tuple[int, str], ProcessCounters] = {}
        self._last: dict[int, ProcessCounters] | None = None
        self._counted: dict[int, float] = {}

    def spent(self, time: float, processes: Sequence[ProcessCounters]) -> float:
        """Return the CPU time, s, from the reading before to that of `time`; 0 at the first reading."""
        now = {one.pid: one for one in processes}
        ended = {
            pid: (one.parent, one.cpu + one.children)
            for pid, one in (self._last or {}).items()
            if pid not in now or now[pid].started != one.started
        }
        self._take_ends(time, now, ended)
        # A child may end after its parent was read, and before it is read itself: then the parent's counter has it at
        # the next reading.
        late, self._counted = self._counted, counted_before(ended)
        spent = 0.0
        for pid, one in now.items():
            # One that did not exist at the reading before was started since.
            old = self._seen.get((pid, one.started))
            own, children = (old.cpu, old.children) if old else (0.0, 0.0)
            reaped = max(0.0, one.children - children)
            new = max(0.0, reaped - late.get(pid, 0.0))
            counted = self._counted.get(pid, 0.0)
            self._counted[pid] = max(0.0, counted - new)
            spent += max(0.0, one.cpu - own) + max(0.0, new - counted)
            self._seen[pid, one.started] = one
        is_first, self._last = self._last is None, now
        return 0.0 if is_first else spent

    def _take_ends(
        self, time: float, now: Mapping[int, ProcessCounters], ended: Mapping[int, tuple[int, float]]
    ) -> None:
        last = self._last or {}
        lasted = [time - self._since.pop((pid, last[pid].started)) for pid in ended]
        self.ended, self.brief = len(ended), sum(seconds < self._brief for seconds in lasted)
        left = [last[pid] for pid in ended if _reaper(pid, ended) not in now]
        self.reaped = len(ended) - len(left)
        above = {one.parent for one in last.values()}
        self.parents = sum(one.children > 0 or one.pid in above for one in left)
        for one in now.values():
            # How long one has existed that was there at the first reading is unknown.
            self._since.setdefault((one.pid, one.started), -math.inf if self._last is None else time)


def _busy(before: CoreCounters | None, after: CoreCounters | None) -> float | None:
    if before is None or after is None or after.total <= before.total:
        return None
    # The counter of idle time of some kernels goes back by a step now and then.
    return min(100.0, max(0.0, 100.0 * (1.0 - (after.idle - before.idle) / (after.total - before.total))))


def _cores(before: CounterSample | None, sample: CounterSample) -> tuple[float | None, ...]:
    # The last one may have been switched off or on since.
    pairs = zip_longest(() if before is None else before.cores, sample.cores)
    return tuple(_busy(*pair) for pair in pairs)[: len(sample.cores)]


def _process(
    sample: CounterSample, selector: int, spent: float, seconds: float | None, family: _Family
) -> ProcessUtilisation:
    matched: Sequence[ProcessCounters] = [one for one in sample.processes if one.selector == selector]
    return ProcessUtilisation(
        count=len(matched),
        # Above 100 where one is new: it may have computed for a second before it was found, which must not be lost.
        cpu=None if not seconds else 100.0 * spent / seconds,
        memory=_share(sum(one.memory for one in matched), sample.memory_total),
        ended=family.ended,
        reaped=family.reaped,
        brief=family.brief,
        parents=family.parents,
    )


def _share(part: float, whole: float) -> float | None:
    return min(100.0, 100.0 * part / whole) if whole > 0 else None
