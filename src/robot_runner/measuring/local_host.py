"""The computer that executes the run: its utilisation through psutil, its files read directly."""

from __future__ import annotations

import glob
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any, Generic, TypeVar

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import Clock
from robot_runner.core.events.window import Window
from robot_runner.core.links.declared_host import LOCAL
from robot_runner.measuring.cpu_counters import (
    CoreCounters,
    CounterSample,
    ProcessCounters,
    placed_cores,
    utilisation_of,
)
from robot_runner.measuring.host import SUBJECT_VARIABLE, FileSample, SamplingReport, UtilisationSample, checked_words
from robot_runner.measuring.on_board.loop import SCAN, YOUNG, is_node, names_of
from robot_runner.measuring.periodic import PeriodicSampler, Sampling

#: Which cores are switched on, such as `0,3-5`. Source: Linux, Documentation/admin-guide/cputopology.rst.
_ONLINE = "/sys/devices/system/cpu/online"


class LocalProcesses:
    """Finds processes and reads their counters.

    Args:
        psutil: the library, imported by the caller.
        selectors: as `process_selector` makes them.
    """

    def __init__(self, psutil: Any, selectors: Sequence[str]) -> None:
        self._psutil = psutil
        self._selectors = tuple(selectors)
        self._looks_for_subjects = any(one.startswith("subject:") for one in self._selectors)
        self._young_until: dict[int, float] = {}
        self._subjects: dict[int, str] = {}
        self._matched: dict[int, tuple[Any, tuple[int, ...]]] = {}
        self._next_scan = 0.0

    def counters(self) -> tuple[ProcessCounters, ...]:
        """Return the counters of each process that matches."""
        now = time.monotonic()
        if now >= self._next_scan:
            self._next_scan = now + SCAN
            self._scan(now)
        return tuple(counters for pid in list(self._matched) for counters in self._of(pid))

    def _of(self, pid: int) -> list[ProcessCounters]:
        process, places = self._matched[pid]
        try:
            with process.oneshot():
                times, memory, parent = process.cpu_times(), process.memory_info().rss, process.ppid()
        except self._psutil.Error:  # it has ended
            del self._matched[pid]
            return []
        started, used = repr(process.create_time()), times.user + times.system
        reaped = times.children_user + times.children_system  # always 0 on macOS
        # Where children belong to the selector, so do those that started and ended between two readings.
        children = [reaped if self._selectors[place].startswith("subject:") else 0.0 for place in places]
        told = zip(places, children, strict=True)
        return [ProcessCounters(place, pid, started, used, float(memory), parent, each) for place, each in told]

    def _scan(self, now: float) -> None:
        known, self._young_until = self._young_until, {}
        for pid in self._psutil.pids():
            # What did not exist at the search before is new, whatever the computer's clock has been set to since.
            until = known.get(pid) or now + YOUNG - (0.0 if known else self._age_of(pid))
            self._young_until[pid] = until
            if pid not in known or now < until:
                self._look_at(pid, self._matched.pop(pid, (None, ())))
        self._subjects = {pid: subject for pid, subject in self._subjects.items() if pid in self._young_until}

    def _age_of(self, pid: int) -> float:
        """Return the age of a process, s; 0 for one that has ended."""
        with suppress(self._psutil.Error):
            return max(0.0, time.time() - float(self._psutil.Process(pid).create_time()))
        return 0.0

    def _look_at(self, pid: int, known: tuple[Any, tuple[int, ...]]) -> None:
        before, places = known
        try:
            process = self._psutil.Process(pid)
            if process == before:
                process = before  # its start as first read, which setting the computer's clock does not change
            name, words = process.name(), process.cmdline()
        except self._psutil.ZombieProcess:  # it stays until its parent reaps it, whose counter then has its time
            if places:
                self._matched[pid] = known
            return
        except self._psutil.Error:
            return
        subject = self._subject_of(process) if self._looks_for_subjects else ""
        places = tuple(place for place, one in enumerate(self._selectors) if matches(one, pid, name, words, subject))
        if places:
            self._matched[pid] = (process, places)

    def _subject_of(self, process: Any) -> str:
        """Return the subject whose mark a process, or else the process that started it, has: sudo removes marks."""
        subject = ""
        with suppress(self._psutil.Error):  # another user's
            subject = str(process.environ().get(SUBJECT_VARIABLE, ""))
        with suppress(self._psutil.Error):
            subject = subject or self._subjects.get(process.ppid(), "")
        self._subjects[process.pid] = subject
        return subject


def matches(selector: str, pid: int, name: str, words: Sequence[str], subject: str = "") -> bool:
    """Whether a process is one that a selector means.

    Args:
        selector: as `process_selector` makes it.
        pid: the process's number.
        name: the process's name, as the system knows it.
        words: its command line.
        subject: the software under test that it belongs to; empty for none.

    Example:
        >>> matches("name:talker.py", 4711, "python3", ["/usr/bin/python3", "/opt/talker.py"])
        True
        >>> matches("node:/talker", 4711, "talker", ["/opt/talker", "--ros-args", "-r", "__node:=talker"])
        True
    """
    kind, _, value = selector.partition(":")
    if kind == "pid":
        return pid == int(value)
    if kind == "subject":
        return value == subject
    if kind == "node":
        return is_node(value, list(words))
    return value in names_of(list(words), name)


_INSTALL = "Install it: pip install 'robot-runner[psutil]'."

R = TypeVar("R")
S = TypeVar("S")


class LocalSampler(Generic[R, S]):
    """Samples in a thread of the run's process from the moment that it is made until `stop`."""

    def __init__(
        self,
        read: Callable[[], R],
        evaluate: Callable[[Sampling[R]], Sequence[S]],
        *,
        rate: float,
        clock: Clock,
        form: str,
    ) -> None:
        self._evaluate = evaluate
        self._form = form
        self._rate = rate
        self._samples: Sequence[S] | None = None
        self._sampler = PeriodicSampler(read, rate=rate, clock=clock)
        self._sampler.start()

    def tell(self, on_sample: Callable[[Callable[[], S]], None]) -> None:
        """Call `on_sample` at each further sample, in the thread that samples, with a function that returns it."""
        last: list[tuple[float, R]] = []

        def take(time: float, reading: R) -> None:
            last.append((time, reading))
            if len(last) > 1:
                times, readings = zip(*last, strict=True)
                on_sample(lambda: self._evaluate(Sampling(times, readings, Window(*times), self._rate))[-1])
                del last[0]

        self._sampler.on_reading = take

    def take_now(self) -> None:
        """Take one more sample at once, out of turn."""
        self._sampler.take_now()

    def stop(self) -> Sequence[S]:
        """End sampling and return the samples, oldest first; a second call returns the same."""
        if self._samples is None:
            self._samples = self._evaluate(self._sampler.stop())
        return self._samples

    def report(self) -> SamplingReport:
        """Return the report; call it after `stop`."""
        sampling = self._sampler.stop()
        failures = [f"{sampling.failures} readings failed: {sampling.first_failure}"] if sampling.failures else []
        return SamplingReport(
            rate=self._rate,
            problems=tuple(failures),
            cpu_seconds=sampling.cpu_seconds,
            form=self._form,
            rescan=max(SCAN, 1 / self._rate),
        )


class LocalHost:
    """This machine, sampled in a thread of the run's own process.

    Args:
        clock: the run's.

    Example:
        >>> from robot_runner.core.events.context import SystemClock
        >>> host = LocalHost(SystemClock())
        >>> host.read_files(["/dev/null", "/no/such/file"])
        ['', None]
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._samplers = ExitStack()
        self._is_closed = False

    @property
    def is_simulated(self) -> bool:
        """Always false."""
        return False

    def sample_utilisation(self, rate: float) -> LocalSampler[CounterSample, UtilisationSample]:
        """Begin to sample CPU and memory utilisation `rate` times a second; as `sample_processes`."""
        return self.sample_processes(rate, ())

    def sample_processes(
        self, rate: float, processes: Sequence[str], *, is_streamed: bool = False
    ) -> LocalSampler[CounterSample, UtilisationSample]:
        """Begin to sample the utilisation of this machine and of processes.

        Args:
            rate: samples a second, Hz.
            processes: what to look for, as `ProcessHost` takes it.
            is_streamed: ignored: there is no network in between.

        Raises:
            LinkError: psutil is not installed, or the link was closed.
        """
        del is_streamed
        counters = _Counters(checked_words(processes))
        count = len(processes)

        def evaluate(sampling: Sampling[CounterSample]) -> Sequence[UtilisationSample]:
            pairs = zip(sampling.times, sampling.readings, strict=True)
            readings = [replace(reading, time=at) for at, reading in pairs]
            return utilisation_of(readings, cores=counters.cores, selectors=count, rescan=max(SCAN, 1 / rate))

        return self._sampler(counters.read, evaluate, rate, "psutil, in a thread of the run's process")

    def sample_files(
        self, rate: float, paths: Sequence[str], *, is_streamed: bool = False
    ) -> LocalSampler[list[str | None], FileSample]:
        """Begin to read the first line of each file `rate` times a second; a `LinkError` once the link is closed."""
        del is_streamed
        listed = checked_words(paths)

        def evaluate(sampling: Sampling[list[str | None]]) -> Sequence[FileSample]:
            pairs = zip(sampling.times, sampling.readings, strict=True)
            return [FileSample(at, tuple(lines)) for at, lines in pairs]

        return self._sampler(lambda: self.read_files(listed), evaluate, rate, "files read in a thread of the run")

    def read_files(self, paths: Sequence[str]) -> list[str | None]:
        """Return the first line of each file, without the line's end; None for one that cannot be read."""
        return list(map(_first_line, paths))

    def list_files(self, pattern: str) -> list[str]:
        """Return the paths that match a pattern of the shell, sorted."""
        return sorted(glob.glob(pattern))  # noqa: PTH207 - the pattern is a whole path

    def close(self) -> None:
        """End all samplers; closing twice does nothing."""
        self._is_closed = True
        self._samplers.close()

    def _sampler(
        self, read: Callable[[], R], evaluate: Callable[[Sampling[R]], Sequence[S]], rate: float, form: str
    ) -> LocalSampler[R, S]:
        if self._is_closed:
            raise LinkError("the link was closed", where=LOCAL, fix="Use it before the run ends.")
        sampler = LocalSampler(read, evaluate, rate=rate, clock=self._clock, form=form)
        self._samplers.callback(sampler.stop)
        return sampler


class _Counters:
    """Reads psutil's counters."""

    def __init__(self, selectors: Sequence[str]) -> None:
        try:
            self._psutil: Any = import_module("psutil")
        except ModuleNotFoundError as error:
            raise LinkError("psutil cannot be imported", where=LOCAL, fix=_INSTALL) from error
        self._processes = LocalProcesses(self._psutil, selectors) if selectors else None
        self.cores = int(self._psutil.cpu_count() or 1)

    def read(self) -> CounterSample:
        """Return the counters of this moment; the caller adds their time."""
        cores = list(map(_core, self._psutil.cpu_times(percpu=True)))
        memory = self._psutil.virtual_memory()
        return CounterSample(
            time=0.0,
            # Not the sum of the cores, which would change by hours when one of them is switched off or on.
            whole=_core(self._psutil.cpu_times()),
            cores=placed_cores(dict(zip(_online_cores(len(cores)), cores, strict=True))),
            memory_total=memory.total,
            memory_available=memory.available,
            processes=self._processes.counters() if self._processes else (),
        )


def _online_cores(count: int) -> Sequence[int]:
    """Return the numbers of the cores that psutil lists: those that are switched on."""
    spans = [span.partition("-") for span in (_first_line(_ONLINE) or "").split(",")]
    try:
        numbers = [core for first, _, last in spans for core in range(int(first), int(last or first) + 1)]
    except ValueError:  # not Linux
        numbers = []
    return numbers if len(numbers) == count else range(count)


def _core(times: Any) -> CoreCounters:
    # Without the time of guests, which Linux has in that of the user already.
    guests = getattr(times, "guest", 0.0) + getattr(times, "guest_nice", 0.0)
    return CoreCounters(total=sum(times) - guests, idle=times.idle + getattr(times, "iowait", 0.0))


def _first_line(path: str) -> str | None:
    try:
        with Path(path).open(encoding="ascii", errors="replace") as file:
            return file.readline(4096).rstrip("\n")
    except OSError:
        return None
