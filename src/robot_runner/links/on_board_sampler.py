"""A sampler on board of another computer: its samples are fetched at the end, or arrive while they are taken."""

from __future__ import annotations

import secrets
from contextlib import suppress
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from robot_runner.errors import LinkError
from robot_runner.links.clock_offset import ClockRecord
from robot_runner.links.counters import utilisation_of
from robot_runner.links.host import FileSample, SamplingReport, UtilisationSample
from robot_runner.links.on_board_messages import counter_sample, file_sample
from robot_runner.links.on_board_session import FORMS

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from robot_runner.links.on_board_session import OnBoardSession

__all__ = ["FileLines", "OnBoardSampler", "UtilisationCounters"]

S_co = TypeVar("S_co", covariant=True)


class Quantity(Protocol[S_co]):
    """What is sampled: how it is asked for, and what the lines that come back say."""

    @property
    def question(self) -> tuple[str, Sequence[str]]:
        """What the on-board loop calls it, and what it is to look at."""
        ...

    def understood(self, lines: Sequence[Sequence[str]], clock: ClockRecord, cores: int) -> Sequence[S_co]:
        """Return the samples of some lines, placed on the run's clock; damaged lines are left out."""
        ...


class UtilisationCounters:
    """CPU and memory of the computer, and of the processes that selectors match."""

    def __init__(self, processes: Sequence[str]) -> None:
        self._processes = tuple(processes)

    @property
    def question(self) -> tuple[str, Sequence[str]]:
        """What the on-board loop calls it, and the selectors."""
        return "utilisation", self._processes

    def understood(self, lines: Sequence[Sequence[str]], clock: ClockRecord, cores: int) -> Sequence[UtilisationSample]:
        """Return the utilisation between each two lines."""
        counters = [sample for line in lines if (sample := counter_sample(line[1:])) is not None]
        return utilisation_of(counters, cores=cores, selectors=len(self._processes), to_run=clock.to_run)


class FileLines:
    """The first line of each of some files."""

    def __init__(self, paths: Sequence[str]) -> None:
        self._paths = tuple(paths)

    @property
    def question(self) -> tuple[str, Sequence[str]]:
        """What the on-board loop calls it, and the paths."""
        return "files", self._paths

    def understood(self, lines: Sequence[Sequence[str]], clock: ClockRecord, cores: int) -> Sequence[FileSample]:
        """Return what stood in the files."""
        del cores
        to_run, count = clock.to_run, len(self._paths)
        return [one for line in lines if (one := file_sample(line[1:], to_run, files=count)) is not None]


class OnBoardSampler(Generic[S_co]):
    """Samples from the moment that it is made until `stop`.

    Args:
        session: with the computer; it samples for nobody else meanwhile.
        quantity: what is sampled.
        rate: samples a second.
        is_streamed: whether samples are sent at once. Otherwise they are kept in a file on the computer until they are
            fetched, so that measuring does not load the network; that file survives a connection that is lost.
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
        token = "-" if is_streamed else secrets.token_hex(8)
        kind, about = quantity.question
        path, cores, actual = session.ask(kind, rate, token, *about, answer="begun")
        self._path = None if path == "-" else path
        self._cores = int(cores)
        self._rate = float(actual)
        if not is_streamed and self._path is None:
            self._problems.append("there is no folder on board that samples can be kept in, so they were sent at once")

    @property
    def is_stopped(self) -> bool:
        """Whether it was stopped, so that its session can sample for somebody else."""
        return self._samples is not None

    def end(self) -> None:
        """Sample no more; the samples are on their way, and `stop` waits for them."""
        if not self._is_ended:
            self._is_ended = True
            with suppress(LinkError):  # `stop` finds it lost, and tells
                self._session.end()

    def stop(self) -> Sequence[S_co]:
        """End sampling and return the samples, oldest first; a second call returns the same.

        Nothing is raised: where the connection is lost, the samples that can be had are returned, and the report
        tells of it.
        """
        if self._samples is None:
            lines = self._lines()
            self._samples = self._quantity.understood(lines, self._clock, self._cores)
            if damaged := len(lines) - len(self._samples):
                self._problems.append(f"{damaged} {'sample' if damaged == 1 else 'samples'} arrived damaged")
        return self._samples

    def report(self) -> SamplingReport:
        """Say how it went; to be asked after `stop`."""
        return SamplingReport(
            rate=self._rate,
            problems=tuple(self._problems),
            clock=self._clock,
            cpu_seconds=self._cpu_seconds,
            form=FORMS[self._session.form].description,
        )

    def _lines(self) -> list[list[str]]:
        self.end()
        try:
            self._cpu_seconds = self._session.fetch()
        except LinkError as error:
            return self._rescued(error)
        self._close_record(self._session)
        return self._session.samples

    def _rescued(self, error: LinkError) -> list[list[str]]:
        """Return the samples that a lost connection leaves: those that were sent, or those that were kept on board."""
        self._problems.append(error.problem)
        if self._path is None:
            self._problems.append(f"the {len(self._session.samples)} samples that had arrived by then are kept")
            return self._session.samples
        try:
            session = self._reconnect()
        except LinkError as again:
            self._problems.append(f"the samples are still on board, in {self._path}: {again.problem}")
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
            self._problems.append(f"its clock could not be asked after the run: {error.problem}")
        else:
            self._clock = ClockRecord(self._clock.host, self._clock.before, after)
