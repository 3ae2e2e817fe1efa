"""Computers that are sampled: protocols of links to them and of samplers, the contents of samples, and selectors."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar, runtime_checkable

from robot_runner.core.errors import LinkError, did_you_mean
from robot_runner.measuring.device_clock import ClockRecord

#: Seconds between two searches for new processes, where there is not one with nearly each sample (`loop.SCAN`).
RESCAN = 1.0


@dataclass(frozen=True, slots=True)
class ProcessUtilisation:
    """CPU and memory of the processes that one selector matched, at one moment.

    Attributes:
        count: how many processes there were.
        cpu: their share of all cores together since the sample before, %; above 100 where one is new, whose CPU time
            since it was started counts all at once. None where there is no sample before.
        memory: their share of the physical memory (resident, shared pages counted for each), 0..100 %; None where it is
            unknown how much the computer has.
        ended: how many have ended since the sample before.
        reaped: how many of these were children of others of the selector; if children count to the selector, what they
            used is in the counters of their parents.
        brief: how many of these were seen for so short a time that other such processes may have been missed.
        parents: how many of these had had children and were not reaped by a process of the selector.
    """

    count: int
    cpu: float | None
    memory: float | None
    ended: int = 0
    reaped: int = 0
    brief: int = 0
    parents: int = 0


@dataclass(frozen=True, slots=True)
class UtilisationSample:
    """CPU and memory utilisation of a computer at one moment.

    Attributes:
        time: seconds on the run's clock.
        cpu: share of all cores that was busy since the sample before, 0..100 %; None where there is no sample before.
        memory: share of the physical memory in use, 0..100 %; None where it is unknown how much the computer has.
        cores: the same as `cpu` for each core; empty where that is unknown.
        processes: one for each selector.
        host_time: seconds on the computer's own steady clock, as it stamped the sample; None where it has none.
    """

    time: float
    cpu: float | None
    memory: float | None
    cores: tuple[float | None, ...] = ()
    processes: tuple[ProcessUtilisation, ...] = ()
    host_time: float | None = None


@dataclass(frozen=True, slots=True)
class FileSample:
    """The first line of each of some files at one moment; None for a file that could not be read.

    Attributes:
        time: seconds on the run's clock.
    """

    time: float
    lines: tuple[str | None, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class SamplingReport:
    """What a sampler reports about itself once it was stopped.

    Attributes:
        rate: how often it sampled, Hz; a computer that cannot keep up with the requested rate may take a lower one.
        problems: what went wrong, one sentence each, such as a connection that was lost.
        clock: the relation of the computer's clock to the run's; None where they are the same.
        cpu_seconds: CPU time that sampling took on the computer itself, s; None if not known.
        form: how the samples were taken, in words.
        rescan: how long a new process may exist before it is seen, s.
    """

    rate: float
    problems: tuple[str, ...] = ()
    clock: ClockRecord | None = None
    cpu_seconds: float | None = None
    form: str = ""
    rescan: float = RESCAN

    @property
    def clock_facts(self) -> Mapping[str, object] | None:
        """The offsets of the computer's clock, for the journal and `quality.json`; None where it is the run's."""
        return None if self.clock is None else self.clock.facts()


@runtime_checkable
class UtilisationSampler(Protocol):
    """A small loop on the computer that samples utilisation until it is stopped."""

    def stop(self) -> Sequence[UtilisationSample]:
        """End the loop and return its samples, oldest first; a second call returns the same."""


@runtime_checkable
class FileSampler(Protocol):
    """A small loop on the computer that reads files until it is stopped."""

    def stop(self) -> Sequence[FileSample]:
        """End the loop and return its samples, oldest first; a second call returns the same."""


@runtime_checkable
class ReportingSampler(Protocol):
    """A sampler that has a report besides its samples."""

    def report(self) -> SamplingReport:
        """Return the report; call it after `stop`."""


def report_of(sampler: object, rate: float) -> SamplingReport:
    """Return the report of a sampler that was stopped; one with only the rate (Hz) where the sampler has none."""
    return sampler.report() if isinstance(sampler, ReportingSampler) else SamplingReport(rate=rate)


@runtime_checkable
class PromptSampler(Protocol):
    """A sampler that takes a sample on request, such as at the edges of the mission."""

    def take_now(self) -> None:
        """Take one more sample at once, out of turn."""


S_co = TypeVar("S_co", covariant=True)


@runtime_checkable
class TellingSampler(Protocol[S_co]):
    """A sampler that announces its samples while it samples, for live displays."""

    def tell(self, on_sample: Callable[[Callable[[], S_co]], None]) -> None:
        """Call `on_sample` at each further sample, in the thread that samples, with a function that returns the sample.

        So a sample that is not looked at is not computed.
        """


@runtime_checkable
class EndingSampler(Protocol):
    """A sampler whose samples take a while to arrive, so that it can be ended first, and waited for later."""

    def end(self) -> None:
        """Stop sampling without waiting; `stop` fetches the samples."""


@runtime_checkable
class HostLink(Protocol):
    """A computer: this one, the robot's on-board one over SSH, or a simulated one."""

    @property
    def is_simulated(self) -> bool:
        """Whether the computer is a simulated one."""

    def sample_utilisation(self, rate: float) -> UtilisationSampler:
        """Begin to sample CPU and memory utilisation `rate` times a second."""

    def close(self) -> None:
        """End all samplers and disconnect; closing twice does nothing."""


@runtime_checkable
class RemoteHost(Protocol):
    """A computer to which it takes a while to connect."""

    def connect(self) -> None:
        """Connect, so that sampling can begin at once."""


@runtime_checkable
class ProcessHost(HostLink, Protocol):
    """A computer whose processes can be sampled, too, and which may send its samples while it takes them."""

    def sample_processes(
        self, rate: float, processes: Sequence[str], *, is_streamed: bool = False
    ) -> UtilisationSampler:
        """Begin to sample the utilisation of the computer and of processes.

        Args:
            rate: samples a second, Hz.
            processes: what to look for: `pid:123`, `name:talker`, `node:/talker` (a ROS node, by the name that it was
                given on its command line), or `subject:Nav` (software under test, with all that it has started).
            is_streamed: whether samples are sent at once, or kept on the computer until they are fetched.

        Raises:
            LinkError: the computer cannot be reached or sampled, the link is closed, the rate is not above 0, or a
                selector holds a tab or the end of a line.
        """


@runtime_checkable
class FileHost(Protocol):
    """A computer whose one-line files can be read, such as those of Linux's /sys."""

    def list_files(self, pattern: str) -> list[str]:
        """Return the paths that match a pattern of the shell, sorted, such as `/sys/class/hwmon/*/name`."""

    def read_files(self, paths: Sequence[str]) -> list[str | None]:
        """Return the first line of each file, without the line's end; None for one that cannot be read."""

    def sample_files(self, rate: float, paths: Sequence[str], *, is_streamed: bool = False) -> FileSampler:
        """Begin to read the first line of each file `rate` times a second; a `LinkError` as of `ProcessHost`."""


#: The words before the colon of a selector.
KINDS = ("pid", "name", "node", "subject")
_SELECT = "Give a name, a number, node:/name or subject:Name."

#: The environment variable of software under test, and of all that it starts, that holds its plugin's name.
SUBJECT_VARIABLE = "ROBOT_RUNNER_SUBJECT"


def process_selector(process: str | int) -> str:
    """Return the selector of a process: a number is its pid, a text its name unless it begins with one of `KINDS`.

    Raises:
        LinkError: it is neither a number nor a text, is empty, or begins with another word and a colon.

    Example:
        >>> [process_selector(process) for process in (4711, "talker", "node:/talker")]
        ['pid:4711', 'name:talker', 'node:/talker']
    """
    if isinstance(process, bool) or not isinstance(process, int | str) or (isinstance(process, int) and process < 1):
        raise LinkError(f"{process!r} selects no process", where="processes", fix=_SELECT)
    if isinstance(process, int):
        return f"pid:{process}"
    text = process
    kind, colon, value = text.partition(":")
    if not colon:
        kind, value = "name", text
    if kind not in KINDS:
        raise LinkError(f"{text!r} selects no process", where="processes", fix=did_you_mean(kind, KINDS))
    if not value.strip() or (kind == "pid" and not value.isdigit()):
        raise LinkError(f"{text!r} selects no process", where="processes", fix=_SELECT)
    return f"{kind}:{value}"


def checked_words(words: Iterable[str]) -> list[str]:
    """Return words as a list; a `LinkError` says that one is empty, or holds a tab or the end of a line."""
    listed = list(words)
    for word in listed:
        if not word or any(character in word for character in "\t\n\0"):
            raise LinkError(f"{word!r} cannot be sent", where="host", fix="Leave out tabs and ends of lines.")
    return listed
