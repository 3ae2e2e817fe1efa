"""A computer that is reached with the system's own OpenSSH client."""

from __future__ import annotations

import shutil
import subprocess
from contextlib import ExitStack
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from robot_runner.core.errors import Finding, LinkError
from robot_runner.core.links.host import checked_words
from robot_runner.core.links.on_board_leftovers import remove_leftovers
from robot_runner.core.links.on_board_sampler import FileLines, OnBoardSampler, UtilisationCounters, file_line
from robot_runner.core.links.on_board_session import REMOTE_COMMAND, OnBoardSession

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from robot_runner.core.events.context import Clock
    from robot_runner.core.links.clock_offset import ClockOffset
    from robot_runner.core.links.host import FileSample, UtilisationSample
    from robot_runner.core.links.on_board_sampler import Quantity

__all__ = ["SshHost", "checked_destination", "execute", "failure", "gist", "remedy", "ssh_command", "ssh_findings"]


#: Never ask a person; notice within 15 s that the other end is gone; leave out what the user's config may forward.
_OPTIONS = (
    *("-T", "-x", "-a"),
    *("-o", "BatchMode=yes"),
    *("-o", "ConnectTimeout=10"),
    *("-o", "ServerAliveInterval=5"),
    *("-o", "ServerAliveCountMax=3"),
    *("-o", "ClearAllForwardings=yes"),
    *("-o", "RemoteCommand=none"),
    *("-o", "LogLevel=ERROR"),
)
_CHECK_SECONDS = 15.0

_INSTALL = "Install the OpenSSH client (Debian, Ubuntu: sudo apt install openssh-client)."
#: What ssh says, above its last line, of a host whose key is another one than before.
_CHANGED_KEY = "remote host identification has changed"
_MAYBE_AN_ATTACK = (
    "This may be an attack: somebody may stand between you and {host}. Find out why its key changed; only if that has "
    "a good reason, such as a system that was installed anew, have ssh forget the old one: {forget}."
)
_REMEDIES = (
    ("permission denied", "Give it this machine's key: ssh-copy-id {host}."),
    (_CHANGED_KEY, _MAYBE_AN_ATTACK),
    ("host key verification failed", "Connect once by hand, and say yes to its key: ssh {host}."),
    ("could not resolve hostname", "Look at the name, and at the network."),
    ("connection refused", "Start the SSH server there (Debian, Ubuntu: sudo apt install openssh-server)."),
    ("timed out", "Look whether it is switched on, and at the network."),
    ("no route to host", "Look whether it is switched on, and at the network."),
)
_REMEDY = "Try it by hand: ssh {host} true."


def checked_destination(host: str) -> str:
    """Return the host as ssh takes it: `robot`, `pi@robot` or `ssh://pi@robot:2222`.

    Raises:
        LinkError: it is empty, holds blanks, or would pass for an option of ssh.

    Example:
        >>> checked_destination("pi@robot")
        'pi@robot'
    """
    if not host or host.startswith("-") or any(character.isspace() or character == "\0" for character in host):
        raise LinkError(
            f"{host!r} is no host that ssh could connect to",
            where="host",
            fix="Name it as for ssh: 'robot', 'pi@robot' or 'ssh://pi@robot:2222'; this machine is 'localhost'.",
        )
    return host


def ssh_command(host: str, remote: str, *, config: Path | None = None) -> list[str]:
    """Return the command line that executes `remote` on a host, with the user's ssh config or the one given.

    Raises:
        LinkError: the host's name cannot be.

    Example:
        >>> ssh_command("pi@robot", "true")[-3:]
        ['--', 'pi@robot', 'true']
    """
    own = [] if config is None else ["-F", str(config)]
    return ["ssh", *own, *_OPTIONS, "--", checked_destination(host), remote]


def remedy(host: str, answer: str) -> str:
    """Return what mends what ssh complains of.

    Args:
        host: as ssh takes it.
        answer: the whole of what ssh wrote to its stderr: what matters may stand above the last line.

    Example:
        >>> remedy("pi@robot", "pi@robot: Permission denied (publickey).")
        "Give it this machine's key: ssh-copy-id pi@robot."
    """
    text = answer.lower()
    known = (fix for sign, fix in _REMEDIES if sign in text)
    told = (line.strip() for line in answer.splitlines() if line.strip().startswith("ssh-keygen "))
    return next(known, _REMEDY).format(host=host, forget=next(told, "ssh-keygen -R followed by its name"))


def gist(answer: str) -> str:
    """Return in one line what ssh answered: its last line, and whether the host's key has changed.

    Example:
        >>> gist("ssh: connect to host robot port 22: Connection refused")
        'ssh: connect to host robot port 22: Connection refused'
    """
    said = answer.strip().splitlines()
    last = said[-1] if said else ""
    return f"{last} (the key of the host is not the one that is known)" if _CHANGED_KEY in answer.lower() else last


def ssh_findings(where: str, host: str, *, config: Path | None = None) -> list[Finding]:
    """Return what stands in the way of executing something on a host: it is tried, and changes nothing there.

    Args:
        where: the plugin that asks.
        host: as ssh takes it.
        config: a file to take the place of the user's ssh config.
    """
    try:
        command = ssh_command(host, "exit 0", config=config)
    except LinkError as error:
        return [Finding.error(where, error.problem, error.fix)]
    if shutil.which("ssh") is None:
        return [Finding.error(where, f"{host} is reached by ssh, which is not installed", _INSTALL)]
    if config is not None and not config.is_file():
        return [Finding.error(where, f"there is no ssh config {config}", "Name a file that is there.")]
    answer = _tried(command)
    if answer is None:
        return []
    return [Finding.error(where, f"{host} cannot be reached: {gist(answer)}", remedy(host, answer))]


def _tried(command: list[str]) -> str | None:
    """Execute a command and return what ssh answered if it failed, or None if it did not."""
    try:
        return failure(execute(command, timeout=_CHECK_SECONDS))
    except subprocess.TimeoutExpired:
        return f"ssh timed out after {_CHECK_SECONDS:g} s"


def execute(command: list[str], *, timeout: float) -> subprocess.CompletedProcess[bytes]:
    """Execute a command of `ssh_command` to its end, with nothing to read, for so many seconds at most.

    Raises:
        OSError: it cannot be started.
        subprocess.TimeoutExpired: it takes longer.
    """
    return subprocess.run(  # noqa: S603 - an argument list; the host's name was checked
        command,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        timeout=timeout,
        check=False,
        start_new_session=True,
    )


def failure(done: subprocess.CompletedProcess[bytes]) -> str | None:
    """Return the whole of what was answered to a command that failed, for `gist` and `remedy`; None if it did not."""
    if done.returncode == 0:
        return None
    return done.stderr.decode(errors="replace").strip() or f"ssh ended with code {done.returncode}"


S = TypeVar("S")


class SshHost:
    """A computer at the other end of ssh, on which a small loop samples.

    The user's own ssh config, agent, keys, jump hosts and known hosts apply. Nothing is installed there: the loop is
    sent when a session begins and gone when it ends. A session stays open for the run; a second sampler at the same
    time gets a session of its own.

    Args:
        host: as ssh takes it: `robot`, `pi@robot`, `ssh://pi@robot:2222`.
        clock: the run's.
        config: a file to take the place of the user's ssh config.
        form: `python3`, `sh` or `ps`; left out, the best that the computer can do.
        command: what starts the shell at the other end; left out, ssh.

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
        """Connect, so that sampling can begin at once.

        Raises:
            LinkError: the computer cannot be reached or sampled.
        """
        self._session()

    def sample_utilisation(self, rate: float) -> OnBoardSampler[UtilisationSample]:
        """Begin to sample CPU and memory utilisation `rate` times a second; as `sample_processes`."""
        return self.sample_processes(rate, ())

    def sample_processes(
        self, rate: float, processes: Sequence[str], *, is_streamed: bool = False
    ) -> OnBoardSampler[UtilisationSample]:
        """Begin to sample the utilisation of the computer and of processes.

        Args:
            rate: samples a second, Hz.
            processes: what to look for: `pid:123`, `name:talker` or `node:/talker`.
            is_streamed: whether samples are sent at once, or kept there until they are fetched.

        Raises:
            LinkError: the computer cannot be reached or sampled, or the rate is not positive.
        """
        return self._sampler(UtilisationCounters(checked_words(processes)), rate, is_streamed=is_streamed)

    def sample_files(
        self, rate: float, paths: Sequence[str], *, is_streamed: bool = False
    ) -> OnBoardSampler[FileSample]:
        """Begin to read the first line of each file `rate` times a second.

        Raises:
            LinkError: as `sample_processes`.
        """
        return self._sampler(FileLines(checked_words(paths)), rate, is_streamed=is_streamed)

    def read_files(self, paths: Sequence[str]) -> list[str | None]:
        """Return the first line of each file, without the line's end; None for one that cannot be read.

        Raises:
            LinkError: the computer cannot be reached.
        """
        return [file_line(field) for field in self._session().ask("read", *checked_words(paths), answer="lines")]

    def list_files(self, pattern: str) -> list[str]:
        """Return the paths that match a pattern of the shell, sorted.

        Raises:
            LinkError: the computer cannot be reached.
        """
        return sorted(self._session().ask("list", *checked_words([pattern]), answer="paths"))

    def clock_offset(self) -> ClockOffset:
        """Return how the computer's clock stands to this machine's.

        Raises:
            LinkError: the computer cannot be reached.
        """
        return self._session().clock_offset()

    def close(self) -> None:
        """End all samplers and sessions; closing twice does nothing."""
        self._is_closed = True
        with ExitStack() as closing:
            for session in self._sessions:
                closing.callback(session.close)
            for session, sampler in self._samplers:
                if session.is_alive:  # a run that was broken off: nothing may be left behind on board
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
            explain=partial(remedy, self._host),
        )
