"""Doubts about the measures of a computer, by disturbances on it during a run."""

from __future__ import annotations

import math
import mmap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise
from operator import or_
from typing import TYPE_CHECKING, Any

from robot_runner.core.words import counted, enumerated

if TYPE_CHECKING:
    from robot_runner.meters.machine.machine_state import MachineState
    from robot_runner.meters.machine.others_load import Load
    from robot_runner.meters.machine.processor_state import Conditions

_PERCENT, _MEGA = 100.0, 1e6
_NAMED = 3
_FLAGS = {1: "under-voltage", 2: "a capped frequency", 4: "throttling", 8: "the soft temperature limit"}


@dataclass(frozen=True, slots=True)
class Thresholds:
    """The figures from which on disturbances are reported.

    BenchExec (`systeminfo.py`: CPUThrottleCheck, SwapCheck) considers results unreliable after any throttling and any
    swapped page. So do these, except for less than a megabyte of swap, which a desktop moves at any time. For load,
    steal and waiting for memory we know of no published figures; these are our own.

    Attributes:
        load: CPU time of others, percent of one core: an idle desktop stays below it, and a tenth of a core's power is
            about the smallest difference that an energy meter of some percent accuracy can show.
        cpu_seconds: the least CPU time of others that counts, s: Linux counts it in ticks of 10 ms.
        steal: time that a hypervisor gave to others, percent of one core.
        stall: time in which some process waited for memory, percent.
        swap: data moved to and from swap, bytes.
    """

    load: float = 10.0
    cpu_seconds: float = 0.1
    steal: float = 2.0
    stall: float = 1.0
    swap: float = 1e6


@dataclass(frozen=True, slots=True)
class MachineReport:
    """The state of one computer during one run.

    Attributes:
        host: its name; empty for this machine.
        run_id: the run.
        before: the state at the beginning.
        after: the state at the end.
        load: the load of the processor between them.
        polled: the conditions of the processor, from time to time, including those of `before` and `after`.
        thresholds: the figures from which on disturbances are reported.
    """

    host: str
    run_id: str
    before: MachineState
    after: MachineState
    load: Load
    polled: Sequence[Conditions]
    thresholds: Thresholds

    def problems(self) -> list[str]:
        """Return the reasons to doubt the computer's measures, with figures."""
        on = f"on {self.host} " if self.host else ""
        return [f"{on}{problem}" for find in (self._load, self._memory, self._processor) for problem in find()]

    def facts(self) -> dict[str, Any]:
        """Return the whole report as plain data."""
        conditions = self.after.conditions
        frequencies = [each.frequency for each in self.polled if each.frequency is not None]
        temperatures = [each.temperature for each in self.polled if each.temperature is not None]
        return {
            "host": self.host or "localhost",
            "seconds": round(self.load.seconds, 3),
            "percent_of_a_core": {
                "busy": _rounded(self.load.busy),
                "experiment": _rounded(self.load.ours),
                "others": _rounded(sum(share.percent for share in self.load.others)),
                "unseen": _rounded(self.load.unseen),
                "steal": _rounded(self._steal),
            },
            "others": [
                {"pid": each.pid, "name": each.name, "percent_of_a_core": _rounded(each.percent)}
                for each in self.load.others
            ],
            "swapped_pages": self._swapped,
            "waited_for_memory_s": _rounded(self._stalled),
            "governors": list(conditions.governors),
            "turbo": conditions.is_turbo,
            "frequency_hz": _spread(frequencies),
            "frequency_limit_hz": conditions.limit,
            "temperature_degc": _spread(temperatures),
            "throttlings": self._throttlings,
            "over_currents": self._over_currents,
            "firmware": [word for bit, word in _FLAGS.items() if self._fresh_flags & bit],
        }

    def _load(self) -> Iterator[str]:
        load, least = self.load, self.thresholds
        if load.foreign >= least.load and load.foreign * load.seconds / _PERCENT >= least.cpu_seconds:
            yield self._others()
        if (self._steal or 0.0) >= least.steal:
            yield f"the hypervisor gave {self._steal:.1f} % of a core to others during {self.run_id} (steal time)"

    def _others(self) -> str:
        named = [each for each in self.load.others if each.percent >= self.thresholds.load / 4] or self.load.others[:1]
        named = list(named)[:_NAMED]
        words = [f"{each.name}, pid {each.pid}" for each in named]
        unseen = self.load.unseen >= self.thresholds.load / 2
        if not unseen and len(named) == 1:
            return f"another process ({words[0]}) took {named[0].percent:.0f} % of a core during {self.run_id}"
        parts = [f"{word}: {each.percent:.0f} %" for word, each in zip(words, named, strict=True)]
        if unseen:
            parts.append(f"processes that cannot be seen from here: {self.load.unseen:.0f} %")
        return f"other processes took {self.load.foreign:.0f} % of a core during {self.run_id} ({'; '.join(parts)})"

    def _memory(self) -> Iterator[str]:
        # The page size of this machine, as another's is unknown; a page of a Raspberry Pi 5 has 16 KiB.
        moved = (self._swapped or 0) * mmap.PAGESIZE
        if moved >= self.thresholds.swap:
            yield f"{moved / _MEGA:,.1f} MB went to swap or came from there during {self.run_id}"
        stalled = self._stalled or 0.0
        if stalled / self.load.seconds * _PERCENT >= self.thresholds.stall:
            yield f"processes waited {stalled:.2f} s of {self.load.seconds:.1f} s for memory during {self.run_id}"

    def _processor(self) -> Iterator[str]:
        hottest = max((each.temperature for each in self.polled if each.temperature is not None), default=None)
        heat = "" if hottest is None else f" (the hottest zone had {hottest:.0f} \N{DEGREE SIGN}C)"
        if self._throttlings:
            times = counted(self._throttlings, "time")
            yield f"the processor was throttled for heat {times} during {self.run_id}{heat}"
        elif any(each.is_held_back for each in self.polled):
            yield f"the kernel or the firmware held the processor back during {self.run_id}{heat}"
        if self._over_currents:
            often = counted(self._over_currents, "time")
            yield f"the processor was throttled for its current or its voltage {often} during {self.run_id}"
        flags = self._fresh_flags
        if any(each.is_under_voltage for each in self.polled):
            flags |= 1
        if flags:
            words = enumerated(word for bit, word in _FLAGS.items() if flags & bit)
            yield f"the firmware reported {words} during {self.run_id}"
        yield from self._changes()

    def _changes(self) -> Iterator[str]:
        first, last = self.before.conditions, self.after.conditions
        if first.governors != last.governors:
            changed = f"the CPU governor changed from {enumerated(first.governors)} to {enumerated(last.governors)}"
            yield f"{changed} during {self.run_id}"
        if first.is_turbo != last.is_turbo:
            words = {True: "on", False: "off", None: "unknown"}
            yield f"turbo went from {words[first.is_turbo]} to {words[last.is_turbo]} during {self.run_id}"
        if first.limit and last.limit and not math.isclose(first.limit, last.limit, rel_tol=0.01):
            went = f"went from {first.limit / _MEGA:,.0f} to {last.limit / _MEGA:,.0f} MHz"
            yield f"the highest frequency that is allowed {went} during {self.run_id}"

    @property
    def _steal(self) -> float | None:
        stolen = _growth(self.before.stolen, self.after.stolen)
        return None if stolen is None else stolen / self.load.seconds * _PERCENT

    @property
    def _swapped(self) -> int | None:
        pages = _growth(self.before.swapped, self.after.swapped)
        return None if pages is None else int(pages)

    @property
    def _stalled(self) -> float | None:
        return _growth(self.before.stalled, self.after.stalled)

    @property
    def _throttlings(self) -> int | None:
        """How often it was throttled, by the counter that rose most: each core also counts for its package."""
        before, after = self.before.conditions.throttle_counts, self.after.conditions.throttle_counts
        if before is None or after is None:
            return None
        return max(max(0, later - sooner) for sooner, later in zip(before, after, strict=True))

    @property
    def _over_currents(self) -> int | None:
        grown = _growth(self.before.conditions.over_currents, self.after.conditions.over_currents)
        return None if grown is None else int(grown)

    @property
    def _fresh_flags(self) -> int:
        looks = (self.before.conditions, *self.polled, self.after.conditions)
        fresh = (later.firmware_flags & ~sooner.firmware_flags for sooner, later in pairwise(looks))
        return reduce(or_, fresh)


def _growth(before: float | None, after: float | None) -> float | None:
    return None if before is None or after is None else max(0.0, after - before)


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)


def _spread(values: Sequence[float]) -> dict[str, float] | None:
    if not values:
        return None
    return {"least": min(values), "mean": math.fsum(values) / len(values), "greatest": max(values)}
