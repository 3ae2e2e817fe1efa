"""A sampler on another computer: its samples are fetched at the end, or arrive while they are taken."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Generic, TypeVar

from robot_runner.core.errors import LinkError
from robot_runner.measuring.cpu_counters import (
    CoreCounters,
    CounterSample,
    ProcessCounters,
    placed_cores,
    utilisation_of,
)
from robot_runner.measuring.device_clock import ClockMap, ClockRecord
from robot_runner.measuring.host import FileSample, SamplingReport, UtilisationSample
from robot_runner.measuring.on_board_session import FORMS, OnBoardSession, new_token

_KILOBYTE = 1024.0


def counter_sample(fields: Sequence[str]) -> CounterSample | None:
    """Return the counters of an `s` line, or None if it is damaged.

    Example:
        >>> sample = counter_sample("5.25|:200:150,0:100:90,1:100:60|8000:6000|0:42:77:1.5:4096".split("|"))
        >>> sample.whole, len(sample.cores), sample.processes[0].cpu
        (CoreCounters(total=200.0, idle=150.0), 2, 1.5)
    """
    try:
        time, cores, memory, processes = fields
        counters = dict(map(_core, cores.split(",")))
        whole = counters.pop(-1)
        total, available = map(float, memory.split(":"))
        return CounterSample(
            time=float(time),
            whole=whole,
            cores=placed_cores(counters),  # a core that is switched off is not in the line
            memory_total=total * _KILOBYTE,
            memory_available=available * _KILOBYTE,
            processes=tuple(map(_process, filter(None, processes.split(",")))),
        )
    except (ValueError, KeyError):
        return None


def _core(text: str) -> tuple[int, CoreCounters]:
    """Return the number of a core, -1 for all of them together, and its counters."""
    number, total, idle = text.split(":")
    return int(number or -1), CoreCounters(float(total), float(idle))


def _process(text: str) -> ProcessCounters:
    selector, pid, started, cpu, memory, *family = text.split(":")
    parent, children = family or ("0", "0")  # ps has neither
    return ProcessCounters(int(selector), int(pid), started, float(cpu), float(memory), int(parent), float(children))


def file_line(field: str) -> str | None:
    """Return the line of a file as it was sent, or None where it could not be read.

    A shell cannot keep NUL, which ends each word of a command line, and sends 1 instead.
    """
    return field[1:].replace("\1", "\0") if field.startswith("=") else None


def file_sample(fields: Sequence[str], to_run: ClockMap, *, files: int) -> FileSample | None:
    """Return the lines of an `f` line, or None if it is damaged."""
    try:
        time = to_run.to_run(float(fields[0]))
    except (ValueError, IndexError):
        return None
    lines = tuple(map(file_line, fields[1:]))
    return FileSample(time, lines) if len(lines) == files else None


S_co = TypeVar("S_co", covariant=True)


@dataclass(frozen=True, slots=True)
class Quantity(Generic[S_co]):
    """What is sampled.

    Attributes:
        kind: its name in the on-board loop.
        about: the selectors or paths that the loop samples.
        understood: returns the samples, on the run's clock and without damaged lines, from: the lines that were sent,
            the computer's clock, its number of cores, and how long (s) a new process may exist before it is seen.
    """

    kind: str
    about: Sequence[str]
    understood: Callable[[Sequence[Sequence[str]], ClockRecord, int, float], Sequence[S_co]]


def utilisation_counters(processes: Sequence[str]) -> Quantity[UtilisationSample]:
    """Return the utilisation of the computer, and of the processes that selectors match."""

    def understood(
        lines: Sequence[Sequence[str]], clock: ClockRecord, cores: int, rescan: float
    ) -> Sequence[UtilisationSample]:
        counters = [sample for line in lines if (sample := counter_sample(line[1:])) is not None]
        return utilisation_of(counters, cores=cores, selectors=len(processes), to_run=clock.to_run, rescan=rescan)

    return Quantity("utilisation", processes, understood)


def file_lines(paths: Sequence[str]) -> Quantity[FileSample]:
    """Return the first lines of files."""

    def understood(
        lines: Sequence[Sequence[str]], clock: ClockRecord, _cores: int, _rescan: float
    ) -> Sequence[FileSample]:
        to_run = clock.to_run
        return [one for line in lines if (one := file_sample(line[1:], to_run, files=len(paths))) is not None]

    return Quantity("files", paths, understood)


class OnBoardSampler(Generic[S_co]):
    """Samples from the moment that it is made until `stop`.

    Args:
        session: with the computer; it can take no other samples meanwhile.
        quantity: what is sampled.
        rate: samples a second.
        is_streamed: whether samples are sent at once. Otherwise they are kept in a file on the computer until they are
            fetched, so that measuring does not load the network; that file remains if the connection is lost.
        reconnect: opens another session with the computer, to recover such a file.

    Raises:
        LinkError: the computer does not begin to sample.
    """

    def __init__(
        self,
        session: OnBoardSession,
        quantity: Quantity[S_co],
        *,
        rate: float,
        is_streamed: bool,
        reconnect: Callable[[], OnBoardSession],
    ) -> None:
        self._session = session
        self._quantity = quantity
        self._reconnect = reconnect
        self._problems: list[str] = []
        self._is_ended = False
        self._samples: Sequence[S_co] | None = None
        self._cpu_seconds: float | None = None
        self._clock = ClockRecord(session.where, session.clock_offset())
        session.samples = []
        token = "-" if is_streamed else new_token()
        path, cores, actual = session.ask(quantity.kind, rate, token, *quantity.about, answer="begun")
        self._path = None if path == "-" else path
        self._cores = int(cores)
        self._rate = float(actual)
        if not is_streamed and self._path is None:
            self._problems.append("there is no folder on board that samples can be kept in, so they were sent at once")

    @property
    def is_stopped(self) -> bool:
        """Whether it was stopped, so that its session is free for another sampler."""
        return self._samples is not None

    def end(self) -> None:
        """Stop sampling; the samples are being sent, and `stop` waits for them."""
        if not self._is_ended:
            self._is_ended = True
            with suppress(LinkError):  # `stop` notices the lost connection, and reports it
                self._session.end()

    def stop(self) -> Sequence[S_co]:
        """End sampling and return the samples, oldest first; a second call returns the same.

        Nothing is raised: if the connection is lost, the samples that are available are returned, and the report says
        that it was lost.
        """
        if self._samples is None:
            lines = self._lines()
            self._samples = self._quantity.understood(lines, self._clock, self._cores, self._rescan)
            if damaged := len(lines) - len(self._samples):
                self._problems.append(f"{damaged} {'sample' if damaged == 1 else 'samples'} arrived damaged")
        return self._samples

    def report(self) -> SamplingReport:
        """Return the report; call it after `stop`."""
        return SamplingReport(
            rate=self._rate,
            problems=(*self._problems, *self._clock.doubts()),
            clock=self._clock,
            cpu_seconds=self._cpu_seconds,
            form=FORMS[self._session.form].description,
            rescan=self._rescan,
        )

    @property
    def _rescan(self) -> float:
        return max(FORMS[self._session.form].rescan, 1 / self._rate)

    def _lines(self) -> list[list[str]]:
        self.end()
        try:
            self._cpu_seconds = self._session.fetch()
        except LinkError as error:
            return self._rescued(error)
        self._close_record(self._session)
        return self._session.samples

    def _rescued(self, error: LinkError) -> list[list[str]]:
        """Return the samples that remain after a lost connection: those that were sent, or those kept on board."""
        self._problems.append(error.problem)
        if self._path is None:
            self._problems.append(f"the {len(self._session.samples)} samples that had arrived by then are kept")
            return self._session.samples
        try:
            session = self._reconnect()
        except LinkError as again:
            self._problems.append(
                f"the samples are still on board, in {self._path}: {again.problem}; the next run that samples this "
                "computer removes them"
            )
            return []
        return self._recovered(session, self._path)

    def _recovered(self, session: OnBoardSession, path: str) -> list[list[str]]:
        try:
            session.recover(path)
        except LinkError as error:
            self._problems.append(f"the samples could not be recovered from {path} on board: {error.problem}")
        else:
            self._problems.append(f"{len(session.samples)} samples were recovered over a second connection")
            self._close_record(session)
        finally:
            session.close()
        return session.samples

    def _close_record(self, session: OnBoardSession) -> None:
        try:
            after = session.clock_offset()
        except LinkError as error:
            self._problems.append(f"the computer's clock could not be asked after the run: {error.problem}")
        else:
            self._clock = ClockRecord(self._clock.host, self._clock.before, after)
