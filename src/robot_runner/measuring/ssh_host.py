"""A computer that is reached with the system's OpenSSH client."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import Clock
from robot_runner.core.links.ssh_command import gist, remedy, ssh_command
from robot_runner.measuring.device_clock import ClockOffset
from robot_runner.measuring.host import FileSample, UtilisationSample, checked_words
from robot_runner.measuring.on_board_sampler import (
    OnBoardSampler,
    Quantity,
    file_line,
    file_lines,
    utilisation_counters,
)
from robot_runner.measuring.on_board_session import REMOTE_COMMAND, OnBoardSession, remove_leftovers

S = TypeVar("S")


class SshHost:
    """A computer at the other end of ssh, on which a small loop samples.

    The user's own ssh config, agent, keys, jump hosts and known hosts apply. Nothing is installed there: the loop is
    sent when a session begins and is gone when it ends. A session stays open for the run; a second sampler at the same
    time gets a session of its own. Each method but `close` raises a `LinkError` if the computer cannot be reached
    or sampled, or the link is closed.

    Args:
        host: in one of ssh's forms: `robot`, `pi@robot`, `ssh://pi@robot:2222`.
        clock: the run's.
        config: a file to use instead of the user's ssh config.
        form: `python3`, `sh` or `ps`; None takes the best one that works there.
        command: what starts the shell at the other end; None for ssh.

    Example:
        >>> from robot_runner.core.events.context import SystemClock
        >>> host = SshHost("here", SystemClock(), command=["sh", "-c", REMOTE_COMMAND])  # without ssh, to show it
        >>> host.read_files(["/dev/null", "/no/such/file"])
        ['', None]
        >>> host.close()
    """

    def __init__(
        self,
        host: str,
        clock: Clock,
        *,
        config: Path | None = None,
        form: str | None = None,
        command: Sequence[str] | None = None,
    ) -> None:
        self._host = host
        self._config = config
        self._clock = clock
        self._form = form
        self._command = command or ssh_command(host, REMOTE_COMMAND, config=config)
        self._sessions: list[OnBoardSession] = []
        self._samplers: list[tuple[OnBoardSession, OnBoardSampler[Any]]] = []
        self._is_closed = False

    @property
    def is_simulated(self) -> bool:
        """Always false."""
        return False

    def connect(self) -> None:
        """Connect, so that sampling can begin at once."""
        self._session()

    def sample_utilisation(self, rate: float) -> OnBoardSampler[UtilisationSample]:
        """Begin to sample CPU and memory utilisation `rate` times a second; as `sample_processes`."""
        return self.sample_processes(rate, ())

    def sample_processes(
        self, rate: float, processes: Sequence[str], *, is_streamed: bool = False
    ) -> OnBoardSampler[UtilisationSample]:
        """Begin to sample the utilisation of the computer and of processes; as of `ProcessHost`."""
        return self._sampler(utilisation_counters(checked_words(processes)), rate, is_streamed=is_streamed)

    def sample_files(
        self, rate: float, paths: Sequence[str], *, is_streamed: bool = False
    ) -> OnBoardSampler[FileSample]:
        """Begin to read the first line of each file `rate` times a second; as of `FileHost`."""
        return self._sampler(file_lines(checked_words(paths)), rate, is_streamed=is_streamed)

    def read_files(self, paths: Sequence[str]) -> list[str | None]:
        """Return the first line of each file, without the line's end; None for one that cannot be read."""
        return [file_line(field) for field in self._session().ask("read", *checked_words(paths), answer="lines")]

    def list_files(self, pattern: str) -> list[str]:
        """Return the paths that match a pattern of the shell, sorted."""
        return sorted(self._session().ask("list", *checked_words([pattern]), answer="paths"))

    def clock_offset(self) -> ClockOffset:
        """Return the offset of the computer's clock from the run's."""
        return self._session().clock_offset()

    def close(self) -> None:
        """End all samplers and sessions; closing twice does nothing."""
        self._is_closed = True
        with ExitStack() as closing:
            for session in self._sessions:
                closing.callback(session.close)
            for session, sampler in self._samplers:
                if session.is_alive:  # after an aborted run: leave nothing behind on board
                    closing.callback(sampler.stop)
            self._sessions, self._samplers = [], []

    def _sampler(self, quantity: Quantity[S], rate: float, *, is_streamed: bool) -> OnBoardSampler[S]:
        if not rate > 0:
            raise LinkError(f"the sample rate is {rate!r} Hz", where=self._host, fix="Give a rate above 0.")
        session = self._session()
        sampler = OnBoardSampler(session, quantity, rate=rate, is_streamed=is_streamed, reconnect=self._connected)
        self._samplers.append((session, sampler))
        return sampler

    def _session(self) -> OnBoardSession:
        """Return a session that is free."""
        if self._is_closed:
            raise LinkError("the link was closed", where=self._host, fix="Use it before the run ends.")
        busy = [session for session, sampler in self._samplers if not sampler.is_stopped]
        for session in self._sessions:
            if session.is_alive and session not in busy:
                return session
        session = self._connected()
        if not self._sessions:
            remove_leftovers(session)
        self._sessions.append(session)
        return session

    def _connected(self) -> OnBoardSession:
        return OnBoardSession(
            self._command,
            where=self._host,
            clock=self._clock,
            form=self._form,
            gist=gist,
            explain=partial(remedy, self._host, config=self._config),
        )
