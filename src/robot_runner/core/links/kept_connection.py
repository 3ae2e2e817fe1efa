"""One connection of the system's OpenSSH client that all commands of a run share, so that each takes milliseconds."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import IO

from robot_runner.core.errors import LinkError
from robot_runner.core.links.ssh_host import gist, remedy, ssh_command

__all__ = ["KeptConnection"]

#: How long it may take to connect, s: a little more than ssh itself allows.
_CONNECTING = 15.0
_POLL = 0.01
#: Keeps the session open until our end of its input is closed, which the system does for a process that was killed.
_HOLD = "cat >/dev/null"


class KeptConnection:
    """A master of OpenSSH's connection sharing, opened when it is first needed and again when it was lost.

    It ends with the process that opened it, however that ends: its session reads what this process never writes.

    Args:
        host: as ssh takes it.
        config: a file to take the place of the user's ssh config.
    """

    def __init__(self, host: str, config: Path | None) -> None:
        self._host = host
        self._config = config
        self._folder: Path | None = None
        self._master: subprocess.Popen[bytes] | None = None
        self._said: IO[bytes] | None = None
        self._lock = threading.Lock()

    @property
    def is_alive(self) -> bool:
        """Whether it is connected, as far as this end knows."""
        return self._master is not None and self._master.poll() is None

    def command(self, remote: str, *, within_s: float = _CONNECTING) -> list[str]:
        """Return the command line that executes `remote` over the connection, which is opened if it is not.

        Args:
            remote: for the login shell there.
            within_s: how long it may take to connect, s.

        Raises:
            LinkError: the host cannot be reached.
        """
        with self._lock:
            if not self.is_alive:
                self._close()
                self._connect(min(within_s, _CONNECTING))
        return self._line(remote, "-o", "ControlMaster=no")

    def close(self) -> None:
        """End the connection; closing twice does nothing."""
        with self._lock:
            self._close()

    def _line(self, remote: str, *options: str) -> list[str]:
        program, *rest = ssh_command(self._host, remote, config=self._config)
        return [program, "-S", f"{self._folder}/ssh", *options, *rest]

    def _connect(self, seconds: float) -> None:
        # Not where TMPDIR says: the path of a socket may have some hundred characters at most.
        self._folder = Path(tempfile.mkdtemp(prefix="robot-runner-", dir="/tmp"))
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
        self._await(self._folder / "ssh", seconds)

    def _await(self, socket: Path, seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while self.is_alive and not socket.exists():
            if time.monotonic() > deadline:
                self._close()
                raise self._unreachable(f"ssh timed out after {seconds:.3g} s")
            time.sleep(_POLL)
        if not self.is_alive:
            answer = self._answer()
            self._close()
            raise self._unreachable(answer)

    def _answer(self) -> str:
        if self._said is None:
            return ""
        self._said.seek(0)
        return self._said.read(100_000).decode(errors="replace").strip()

    def _unreachable(self, answer: str) -> LinkError:
        why = gist(answer) or "ssh ended without a word"
        return LinkError(f"{self._host} cannot be reached: {why}", where=self._host, fix=remedy(self._host, answer))

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
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = None
