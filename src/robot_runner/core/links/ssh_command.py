"""Command lines of the system's OpenSSH client, and a kept connection for many commands."""

from __future__ import annotations

import fcntl
import io
import os
import shlex
import shutil
import subprocess
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import IO

from robot_runner.core.errors import Finding, LinkError

#: No questions; notice within 15 s that the host is gone; no forwarding from the user's config.
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
#: In the messages of ssh for a host whose key has changed.
_CHANGED_KEY = "remote host identification has changed"
_MAYBE_AN_ATTACK = (
    "This may be an attack: somebody may stand between you and {host}. Find out why its key changed; only if that has "
    "a good reason, such as a system that was installed again, have ssh forget the old one: {forget}."
)
_REMEDIES = (
    (
        "permission denied",
        "Give it this machine's key, ssh-copy-id {by_hand}, or load one that has a passphrase into the agent: ssh-add.",
    ),
    (_CHANGED_KEY, _MAYBE_AN_ATTACK),
    ("host key verification failed", "Connect once by hand, and say yes to its key: ssh {by_hand}."),
    ("could not resolve hostname", "Look at the name, and at the network."),
    ("connection refused", "Start the SSH server there (Debian, Ubuntu: sudo apt install openssh-server)."),
    ("timed out", "Check whether it is switched on, and at the network."),
    ("no route to host", "Check whether it is switched on, and at the network."),
)
_REMEDY = "Try it by hand: ssh {by_hand} true."

#: A line of its own that precedes what a command writes; before it stands what the login writes, as from a `.bashrc`.
BEGIN = "robot-runner begins"
#: What all shells take as it is within single quotes: fish does not so take a backslash before another one or before a
#: quote, nor csh an exclamation mark or a line feed.
_PLAIN = frozenset(range(ord(" "), ord("~") + 1)) - frozenset(b"\\'!")
_MOST_IN_LINE = 1 << 16
#: The fix where the login of a host executes something else than what it is asked to.
LET_EXECUTE = "Let this account execute commands there: look at its login shell, and at ForceCommand."


def checked_destination(host: str) -> str:
    """Return the host as ssh takes it: `robot`, `pi@robot` or `ssh://pi@robot:2222`.

    Raises:
        LinkError: it is empty, contains blanks, or would be an option of ssh.

    Example:
        >>> checked_destination("pi@robot")
        'pi@robot'
    """
    is_text = isinstance(host, str) and bool(host)
    if not is_text or host.startswith("-") or any(character.isspace() or character == "\0" for character in host):
        fix = "Name it as for ssh: 'robot', 'pi@robot' or 'ssh://pi@robot:2222'; this machine is 'localhost'."
        raise LinkError(f"{host!r} is not a host that ssh could connect to", where="host", fix=fix)
    return host


def for_any_shell(script: str) -> str:
    r"""Return a command by which any login shell has the host's `sh` execute a script; `passes_login` finds its output.

    Example:
        >>> print(for_any_shell("echo it's"))
        exec sh -c 'echo; echo robot-runner begins; eval "$(printf %b "$1")"' sh 'echo it\0047s'
    """
    encoded = "".join(chr(each) if each in _PLAIN else f"\\0{each:03o}" for each in os.fsencode(script))
    return f"""exec sh -c 'echo; echo {BEGIN}; eval "$(printf %b "$1")"' sh '{encoded}'"""


def passes_login(said: IO[bytes]) -> bool:
    """Move behind what a login wrote before a command of `for_any_shell`; false if the command was not executed."""
    said.seek(0)
    while line := said.readline(_MOST_IN_LINE):
        if line == f"{BEGIN}\n".encode():
            return True
    return False


def ssh_command(host: str, remote: str, *, config: Path | None = None) -> list[str]:
    """Return the command line by which the `sh` of a host executes `remote`, with the user's ssh config or another.

    What it writes follows what the login writes: see `passes_login`.

    Raises:
        LinkError: the host's name is invalid.

    Example:
        >>> ssh_command("pi@robot", "true")[-3:-1]
        ['--', 'pi@robot']
    """
    own = [] if config is None else ["-F", str(config)]
    return ["ssh", *own, *_OPTIONS, "--", checked_destination(host), for_any_shell(remote)]


def remedy(host: str, answer: str, *, config: Path | None = None) -> str:
    """Return the fix for an error of ssh, by all that it wrote: the cause may be above the last line.

    Example:
        >>> remedy("pi@robot", "Host key verification failed.")
        'Connect once by hand, and say yes to its key: ssh pi@robot.'
    """
    by_hand = host if config is None else f"-F {shlex.quote(str(config))} {host}"
    text = answer.lower()
    known = (fix for sign, fix in _REMEDIES if sign in text)
    told = (line.strip() for line in answer.splitlines() if line.strip().startswith("ssh-keygen "))
    return next(known, _REMEDY).format(
        host=host, by_hand=by_hand, forget=next(told, "ssh-keygen -R followed by its name")
    )


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
    """Return findings on why nothing can be executed on a host; it is tried without changing anything there."""
    try:
        command = ssh_command(host, "echo here", config=config)
    except LinkError as error:
        return [Finding.error(where, error.problem, error.fix)]
    if shutil.which("ssh") is None:
        return [Finding.error(where, f"{host} is reached by ssh, which is not installed", _INSTALL)]
    if config is not None and not config.is_file():
        return [Finding.error(where, f"there is no ssh config {config}", "Name a file that is there.")]
    try:
        done = execute(command, timeout=_CHECK_SECONDS)
        answer, said = failure(done), done.stdout.decode(errors="replace")
    except subprocess.TimeoutExpired:
        answer, said = f"ssh timed out after {_CHECK_SECONDS:g} s", ""
    if answer is None:
        other = f"{host} did not execute the command: {gist(said)}"
        return [] if said == "here\n" else [Finding.error(where, other, LET_EXECUTE)]
    return [Finding.error(where, f"{host} cannot be reached: {gist(answer)}", remedy(host, answer, config=config))]


def execute(command: list[str], *, timeout: float) -> subprocess.CompletedProcess[bytes]:
    """Execute a command of `ssh_command` to its end, without input, for `timeout` seconds at most.

    What it returns has nothing of what the login wrote.

    Raises:
        OSError: it cannot be started.
        subprocess.TimeoutExpired: it takes longer.
    """
    done = subprocess.run(  # noqa: S603 - an argument list; the host's name was checked
        command, stdin=subprocess.DEVNULL, capture_output=True, timeout=timeout, check=False, start_new_session=True
    )
    said = io.BytesIO(done.stdout)
    if passes_login(said):
        done.stdout = said.read()
    return done


def failure(done: subprocess.CompletedProcess[bytes]) -> str | None:
    """Return all that ssh wrote for a failed command, for `gist` and `remedy`; None if it succeeded."""
    if done.returncode == 0:
        return None
    return done.stderr.decode(errors="replace").strip() or f"ssh ended with code {done.returncode}"


#: How long it may take to connect, s: a little more than ssh itself allows.
_CONNECTING = 15.0
#: How long the master, a process on this machine, may take to answer, s.
_ANSWERING = 5.0
_POLL = 0.01
#: Keeps the session open until this process closes its input, or dies.
_HOLD = "cat >/dev/null"
#: Where the folders of sockets are, and how their names begin: not in TMPDIR, as the path of a socket may have some
#: hundred characters at most.
_SOCKETS, _PREFIX = Path("/tmp"), "robot-runner-ssh-"  # noqa: S108 - each is its owner's alone


class KeptConnection:
    """A master of OpenSSH's connection sharing, opened when it is first needed and again when it was lost.

    It ends with the process that opened it, however that ends, by `_HOLD`.
    """

    def __init__(self, host: str, config: Path | None) -> None:
        self._host = host
        self._config = config
        self._folder: _SocketFolder | None = None
        self._master: subprocess.Popen[bytes] | None = None
        self._said: IO[bytes] | None = None
        self._lock = threading.Lock()

    def is_connected(self) -> bool:
        """Return whether the master still answers."""
        if not self._has_master:
            return False
        try:
            return execute(self._line("true", "-O", "check"), timeout=_ANSWERING).returncode == 0
        except (OSError, subprocess.TimeoutExpired):
            return False

    def command(self, remote: str, *, within_s: float = _CONNECTING) -> list[str]:
        """Return the command line that executes `remote` over the connection; open it first, within so many s.

        Raises:
            LinkError: the host cannot be reached.
        """
        with self._lock:
            if not self._has_master:
                self._close()
                self._connect(min(within_s, _CONNECTING))
        return self._line(remote, "-o", "ControlMaster=no")

    def close(self) -> None:
        """End the connection; closing twice does nothing."""
        with self._lock:
            self._close()

    @property
    def _has_master(self) -> bool:
        return self._master is not None and self._master.poll() is None

    def _line(self, remote: str, *options: str) -> list[str]:
        program, *rest = ssh_command(self._host, remote, config=self._config)
        socket = "none" if self._folder is None else str(self._folder.socket)
        return [program, "-S", socket, *options, *rest]

    def _connect(self, seconds: float) -> None:
        self._folder = folder = _SocketFolder()
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - as long as the connection
        try:
            self._master = subprocess.Popen(  # noqa: S603 - an argument list; the host's name was checked
                self._line(_HOLD, "-M", "-o", "ControlPersist=no"),
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=self._said,
                start_new_session=True,
            )
        except OSError as error:
            self._close()
            raise self._unreachable(f"ssh cannot be started: {error}") from error
        self._await(folder.socket, seconds)

    def _await(self, socket: Path, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while self._has_master and not socket.exists():
            if time.monotonic() > deadline:
                self._close()
                raise self._unreachable(f"ssh timed out after {seconds:.3g} s")
            time.sleep(_POLL)
        if not self._has_master:
            answer = self._answer()
            self._close()
            raise self._unreachable(answer)

    def _answer(self) -> str:
        if self._said is None:
            return ""
        self._said.seek(0)
        return self._said.read(100_000).decode(errors="replace").strip()

    def _unreachable(self, answer: str) -> LinkError:
        why = gist(answer) or "ssh ended without a message"
        fix = remedy(self._host, answer, config=self._config)
        return LinkError(f"{self._host} cannot be reached: {why}", where=self._host, fix=fix)

    def _close(self) -> None:
        master, self._master = self._master, None
        if master is not None:
            if master.stdin is not None:
                with suppress(OSError):
                    master.stdin.close()
            master.terminate()
            try:
                master.wait(2.0)
            except subprocess.TimeoutExpired:
                master.kill()
                master.wait()
        if self._said is not None:
            self._said.close()
            self._said = None
        if self._folder is not None:
            self._folder.remove()
            self._folder = None


class _SocketFolder:
    """A folder for the socket of a connection, locked for as long as its process lives.

    A killed process leaves its folder; making one removes those that are not locked.

    Attributes:
        socket: the path of the socket.
    """

    def __init__(self) -> None:
        for left in _SOCKETS.glob(f"{_PREFIX}*"):
            _remove_left(left)
        while True:
            self._path = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=_SOCKETS))
            self._descriptor = os.open(self._path, os.O_RDONLY)
            with suppress(OSError):  # without locks, left folders are not removed, either
                fcntl.flock(self._descriptor, fcntl.LOCK_SH)
            if self._path.exists():  # else another process has removed it before it was locked
                break
            os.close(self._descriptor)
        self.socket = self._path / "ssh"

    def remove(self) -> None:
        shutil.rmtree(self._path, ignore_errors=True)
        os.close(self._descriptor)


def _remove_left(folder: Path) -> None:
    """Remove a folder of this user's that no process has locked."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        try:
            if os.fstat(descriptor).st_uid == os.geteuid():
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder, ignore_errors=True)  # its ssh may remove its socket at the same time
        finally:
            os.close(descriptor)
