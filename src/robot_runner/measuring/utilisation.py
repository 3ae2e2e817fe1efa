"""Means of utilisation over the measured window of a run, and how far they can be trusted."""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable, Container, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from robot_runner.core.events.measure import Measure, Over
from robot_runner.core.events.window import Window
from robot_runner.measuring.host import RESCAN, SamplingReport, UtilisationSample
from robot_runner.measuring.on_board_session import FORMS
from robot_runner.measuring.quality import Column, SampleQuality, quality_of, write_quality, write_samples
from robot_runner.measuring.series import Series, cut, mean, mean_of_intervals

#: The resolution of the CPU times that ps shows, s.
_PS_STEP = 1.0
#: Percentage of one core, over the window, above which the unseen CPU time of ended processes is doubted.
_UNSEEN_SHARE = 1.0
_NO_PROCESS = (
    "Start it before or during the mission, and compare its selector with what `ps -eo pid,comm,args` shows then; "
    "of one that ends sooner, take the CPUTime of Program(..., per='mission')."
)
_ENDED = "Have it end after the mission, or take the CPUTime of Program(..., per='mission'), which is exact."
_LATE = "Start it before the mission, or measure a computer that has a Python 3 (hosts.md)."
_RESIDENT = "ps reports the memory of processes only: Memory lacks the kernel's, and counts shared pages repeatedly"
_BETTER_FORM = "Install python3 there, or leave form out."
_CORES = "Name cores that are switched on: /sys/devices/system/cpu/online has their numbers."


class Doubt(NamedTuple):
    """What is doubtful about the samples.

    Attributes:
        problem: with figures.
        measures: the names of those concerned; empty for all.
        fix: what to do; empty for the profiler's default.
    """

    problem: str
    measures: tuple[str, ...] = ()
    fix: str = ""


@dataclass(frozen=True, slots=True)
class Selection:
    """What is measured besides the whole computer.

    Attributes:
        processes: selectors, as `process_selector` makes them.
        cores: numbers of cores.

    Example:
        >>> [measure.name for measure in Selection(("node:/talker",), (0,)).measures()]
        ['CPU_core0', 'CPU_talker', 'Memory_talker']
    """

    processes: tuple[str, ...] = ()
    cores: tuple[int, ...] = ()

    @property
    def labels(self) -> tuple[str, ...]:
        """A label for each selector, used in the names of measures."""
        return tuple(re.sub(r"\W+", "_", one.partition(":")[2]).strip("_") or "process" for one in self.processes)

    def measures(self) -> tuple[Measure, ...]:
        """Return a measure for each core, and two for each selector."""
        told = [
            (f"CPU_core{core}", f"CPU utilisation of core {core}, mean over the measured window.")
            for core in self.cores
        ]
        for label, selector in zip(self.labels, self.processes, strict=True):
            which = f"the processes {selector}"
            added_up = f"Resident sets of {which}, added up (what they share counts for each)"
            told += [
                (f"CPU_{label}", f"Share of all cores together that {which} used, mean over the measured window."),
                (f"Memory_{label}", f"{added_up}, as a share of the physical memory, mean over the window."),
            ]
        return tuple(Measure(name, "%", description, over=Over.MEAN) for name, description in told)


@dataclass(frozen=True, slots=True)
class Utilisation:
    """One run's samples and the window that they are evaluated over.

    Attributes:
        samples: oldest first.
        window: on the same clock; at first from the start to the stop of the sampler.
        selection: what was measured besides the whole computer.
        report: of the sampler.
        is_simulated: whether the computer is a simulated one.
    """

    samples: Sequence[UtilisationSample]
    window: Window
    selection: Selection
    report: SamplingReport
    is_simulated: bool

    @property
    def times(self) -> array[float]:
        """When each sample was taken, s."""
        return array("d", [sample.time for sample in self.samples])

    @property
    def quality(self) -> SampleQuality:
        """How good the samples are."""
        clock = self.report.clock
        return quality_of(
            self.times,
            self.window,
            self.report.rate,
            clock_offset=None if clock is None else clock.before.wall_offset,
            clock_uncertainty=None if clock is None else clock.uncertainty,
            cpu_seconds=self._own_seconds(),
        )

    def over(self, window: Window) -> Utilisation:
        """Return the same samples, to be evaluated over another window."""
        return replace(self, window=window)

    def means(self) -> dict[str, float | None]:
        """Return the means over the window, by measure.

        CPU utilisation is about the time since the sample before, memory about a moment.
        """
        return {
            "CPU": self._mean_of_intervals(lambda sample: sample.cpu),
            "Memory": self._mean(lambda sample: sample.memory),
            **{
                f"CPU_core{core}": self._mean_of_intervals(_core(core)) if self._covers(core) else None
                for core in self.selection.cores
            },
            **{name: value for place in range(len(self.selection.labels)) for name, value in self._process(place)},
        }

    def doubted(self, started: Container[str] = ()) -> Iterator[Doubt]:
        """Yield doubts besides those about the quality of the samples.

        Args:
            started: the names of software under test that the run has started; in a probe before the run, none.
        """
        yield from map(Doubt, self.report.problems)
        if self.report.form == FORMS["ps"].description and self.window.duration > 0:
            off = _PS_STEP / self.window.duration * 100
            steps = f"ps reports CPU time in whole seconds: over {self.window.duration:.1f} s"
            yield Doubt(f"{steps}, utilisation may be off by {off:.0f} % of a core for each process")
            yield Doubt(_RESIDENT, ("Memory",), _BETTER_FORM)
        for place, selector in enumerate(self.selection.processes):
            kind, _, name = selector.partition(":")
            if kind == "subject" and name not in started:
                continue
            label = self.selection.labels[place]
            names = (f"CPU_{label}", f"Memory_{label}")
            if self.samples and not self._was_seen(place):
                yield Doubt(f"no process {selector} was seen; {self._looks}", names, _NO_PROCESS)
            elif self.samples and not self._was_seen(place, within=self.window):
                problem = f"no process {selector} was there in the measured window, only before or after it"
                yield Doubt(problem, names, _NO_PROCESS)
            yield from (Doubt(problem, names, _ENDED) for problem in self._doubts_about_ends(place))
            if (share := self._unseen_memory(place)) > _UNSEEN_SHARE:
                problem = (
                    f"{selector} may have been there before it was seen: Memory_{label} may lack up to {share:.0f} %"
                )
                yield Doubt(f"{problem}; {self._looks}", names[1:], _LATE)
        for core in self.selection.cores:
            problem = f"the computer reports core {core} for a part of the window only: it was switched off meanwhile"
            if self.samples and not self._tells_of(core):
                yield Doubt(f"the computer reports no core {core}", (f"CPU_core{core}",), _CORES)
            elif self.quality.is_sufficient and not self._covers(core):
                yield Doubt(problem, (f"CPU_core{core}",), _CORES)

    def _unseen_memory(self, place: int) -> float:
        """Return how much memory processes may have held before they were seen, % of what they were seen to hold."""
        late = self.report.rescan - 1 / self.report.rate  # a sampler that searches at each sample is not late
        held = unseen = 0.0
        for sooner, later in pairwise(self.samples):
            if later.time > self.window.start and sooner.time < self.window.end:
                before, told = sooner.processes[place], later.processes[place]
                held += (told.memory or 0.0) * (later.time - sooner.time)
                if told.count > before.count:
                    more = max(0.0, (told.memory or 0.0) - (before.memory or 0.0))
                    unseen += more * max(0.0, min(late, sooner.time - self.window.start))
        return 100.0 * unseen / held if held else 0.0

    @property
    def _looks(self) -> str:
        every = "once a second" if self.report.rescan == RESCAN else f"every {self.report.rescan:.2g} s"
        return f"new ones are looked for {every}"

    def _doubts_about_ends(self, place: int) -> Iterator[str]:
        selector, label = self.selection.processes[place], self.selection.labels[place]
        has_children = selector.startswith("subject:")  # then the CPU time of children is in their parents' counters
        ended = brief = 0
        unseen = 0.0  # s, if each, or a child that was not found yet, had kept one core busy from its last sample on
        for sooner, later in pairwise(self.samples):
            if later.time > self.window.start and sooner.time < self.window.end:
                told = later.processes[place]
                lost = told.ended - told.reaped if has_children else told.ended
                ended, brief = ended + lost, brief + told.brief
                unseen += lost * (min(later.time, self.window.end) - max(sooner.time, self.window.start))
                unseen += told.parents * self.report.rescan if has_children else 0.0
        if brief and not has_children:
            yield (
                f"{_processes(brief, selector)} lasted less than {2 * self.report.rescan:.2g} s: {self._looks}, so "
                f"that others may have been missed, and CPU_{label} and Memory_{label} may be too low"
            )
        elif ended and unseen > self.window.duration * _UNSEEN_SHARE / 100:
            problem = f"{_processes(ended, selector)} ended after {'its' if ended == 1 else 'their'} last sample"
            yield f"{problem}: CPU_{label} may leave out up to {100 * unseen / self.window.duration:.1f} % of a core"

    def write(self, folder: Path, mission: Window | None) -> None:
        """Write `samples.csv`, and `quality.json` with the quality over `mission`, None where there was no mission."""
        write_samples(folder / "samples.csv", list(self._columns()))
        quality = None if mission is None else self.over(mission).quality
        details = {
            "is_simulated": self.is_simulated,
            "rate_hz": self.report.rate,
            "form": self.report.form,
            "problems": list(self.report.problems),
            "clock": self.report.clock_facts,
        }
        write_quality(folder / "quality.json", quality, mission, details, sampled=self.window)

    def _own_seconds(self) -> float | None:
        """Return the window's share of the CPU time that sampling took in all."""
        spent, times = self.report.cpu_seconds, self.times
        sampled = times[-1] - times[0] if len(times) else 0.0
        return spent if spent is None or not sampled else spent * min(1.0, self.window.duration / sampled)

    def _mean_of_intervals(self, pick: Callable[[UtilisationSample], float | None]) -> float | None:
        # The first sample only marks the beginning of the second one's time. Samples without a value are skipped, so
        # that the next one covers the time of both.
        told = [(sample.time, 0.0) for sample in self.samples[:1]]
        told += [(sample.time, value) for sample in self.samples[1:] if (value := pick(sample)) is not None]
        return mean_of_intervals(Series([time for time, _ in told], [value for _, value in told]), self.window)

    def _tells_of(self, core: int) -> bool:
        """Whether any sample has a value for the core: for one that is switched off it is None."""
        return any(_core(core)(sample) is not None for sample in self.samples)

    def _covers(self, core: int) -> bool:
        """Whether the samples with a value for a core cover enough of the window."""
        told = [sample.time for sample in self.samples if _core(core)(sample) is not None]
        return quality_of([*self.times[:1], *told], self.window, self.report.rate).is_sufficient

    def _mean(self, pick: Callable[[UtilisationSample], float | None]) -> float | None:
        told = [(sample.time, value) for sample in self.samples if (value := pick(sample)) is not None]
        series = Series([time for time, _ in told], [value for _, value in told])
        return mean(cut(series, self.window, reach=5 / self.report.rate))

    def _process(self, place: int) -> Iterator[tuple[str, float | None]]:
        label, was_seen = self.selection.labels[place], self._was_seen(place)
        cpu = self._mean_of_intervals(lambda sample: sample.processes[place].cpu)
        memory = self._mean(lambda sample: sample.processes[place].memory)
        yield f"CPU_{label}", cpu if was_seen else None
        yield f"Memory_{label}", memory if was_seen else None

    def _was_seen(self, place: int, *, within: Window | None = None) -> bool:
        return any(
            sample.processes[place].count
            for sample in self.samples
            if within is None or within.start <= sample.time <= within.end
        )

    def _columns(self) -> Iterator[Column]:
        yield Column("time_s", self.times)
        yield self._column("cpu_percent", lambda sample: sample.cpu)
        yield self._column("memory_percent", lambda sample: sample.memory)
        for core in range(max((len(sample.cores) for sample in self.samples), default=0)):
            if self._tells_of(core):
                yield self._column(f"cpu_core{core}_percent", _core(core))
        for place, label in enumerate(self.selection.labels):
            yield from self._process_columns(place, label)
        if any(sample.host_time is not None for sample in self.samples):
            yield Column("host_time_s", [sample.host_time for sample in self.samples])

    def _process_columns(self, place: int, label: str) -> Iterator[Column]:
        yield Column(f"count_{label}", [sample.processes[place].count for sample in self.samples], "%d")
        yield self._column(f"cpu_{label}_percent", lambda sample: sample.processes[place].cpu)
        yield self._column(f"memory_{label}_percent", lambda sample: sample.processes[place].memory)

    def _column(self, name: str, pick: Callable[[UtilisationSample], float | None]) -> Column:
        return Column(name, [pick(sample) for sample in self.samples], "%.3f")


def means_over(utilisation: Utilisation | None, window: Window) -> dict[str, float | None]:
    """Return the means over a window, by measure; empty where too little of it was sampled."""
    measured = utilisation.over(window) if utilisation is not None else None
    return measured.means() if measured is not None and measured.quality.is_sufficient else {}


def _processes(count: int, selector: str) -> str:
    return f"{count} {'process' if count == 1 else 'processes'} {selector}"


def _core(number: int) -> Callable[[UtilisationSample], float | None]:
    return lambda sample: sample.cores[number] if number < len(sample.cores) else None
