"""A long-lived process on another computer: started over SSH, controlled line by line, ended with the run."""

from __future__ import annotations

import hashlib
import logging
import os
import queue
import secrets
import shlex
import signal
import socket
import subprocess
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import Clock
from robot_runner.core.storage.outliving import is_alive
from robot_runner.measuring.device_clock import ClockExchange, ClockOffset, estimate_offset
from robot_runner.measuring.host import RESCAN
from robot_runner.measuring.on_board.loop import SCAN


@dataclass(frozen=True, slots=True)
class Form:
    """One way of sampling on board.

    Attributes:
        program: the file that is sent there.
        description: of what samples, in words.
        rescan: seconds between two searches for new processes, at the least.
    """

    program: str
    description: str
    rescan: float = RESCAN


#: The programs that can be sent, best first, by their names in the bootstrap program.
FORMS = {
    "python3": Form("loop.py", "a loop in Python that reads Linux's /proc", rescan=SCAN),
    "sh": Form("loop.sh", "a loop of the POSIX shell that reads Linux's /proc"),
    "ps": Form("loop.sh", "a loop of the POSIX shell that asks ps: CPU time in steps of up to a second"),
}

# The user's login shell at the other end may be any: for it this is one command with one quoted word. The sh that it
# starts reads a program up to a line `#end`, byte by byte, so that the input after it is left for the program.
_READ_PROGRAM = (
    'n="$(printf "\\n_")";n="${n%_}";p=;while IFS= read -r l&&[ "$l" != "#end" ];do p="$p$l$n";done;eval "$p"'
)
REMOTE_COMMAND = f"exec sh -c {shlex.quote(_READ_PROGRAM)}"

_END = "#end\n"
_GREETING = "robot-runner"
_VERSION = "1"
_SAMPLES = ("s", "f")
#: How long an answer may take, s: the first one waits for the connection.
_PATIENCE = 10.0
_FIRST_PATIENCE = 20.0
#: For how long, s, a loop that keeps its samples goes on after its connection was cut: so they are complete if the
#: network comes back during the mission, and a computer is not sampled for ever if it does not.
_LEASE = 600
#: How many times the clock is asked for: the least delay of eight is near the least possible.
_EXCHANGES = 8
#: How long a process may take to end once its input is closed, and again once it got a signal, s.
_LAST_WORDS = 2.0


class OnBoardSession:
    """A process that samples the computer on which it runs, and answers requests meanwhile.

    Each request raises a `LinkError` where the connection is lost, or no answer comes in time.

    Args:
        command: what starts a shell at the other end that executes `REMOTE_COMMAND`: ssh with its arguments.
        where: the computer, for messages.
        clock: the run's.
        form: one of `FORMS`; None takes the best one that works there.
        gist: returns the stderr of the command in one line.
        explain: returns a fix from the whole stderr of the command.

    Raises:
        LinkError: the command cannot be started, there is no answer, or the computer cannot be sampled.
    """

    def __init__(
        self,
        command: Sequence[str],
        *,
        where: str,
        clock: Clock,
        form: str | None = None,
        gist: Callable[[str], str] = lambda answer: answer.rpartition("\n")[2],
        explain: Callable[[str], str] = lambda _: "",
    ) -> None:
        self.where = where
        self.samples: list[list[str]] = []
        self.last_heard = time.monotonic()
        self._clock = clock
        self._gist, self._explain = gist, explain
        self._answers: queue.SimpleQueue[tuple[list[str], float]] = queue.SimpleQueue()
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the session
        self._process = self._start(command)
        self._listener = threading.Thread(target=self._listen, name=f"listener to {where}", daemon=True)
        self._listener.start()
        try:
            self.form = self._agree(form)
        except BaseException:  # also where the run ends now
            self.close()
            raise

    @property
    def is_alive(self) -> bool:
        """Whether the process still answers, as far as is known."""
        return self._listener.is_alive() and self._process.poll() is None

    def ask(self, *words: object, answer: str, patience: float = _PATIENCE) -> list[str]:
        """Send one line and return the fields of the line that answers it; a `LinkError` is also a refusal."""
        self._send("\t".join(map(str, words)) + "\n")
        return self._await(answer, patience)[0]

    def clock_offset(self) -> ClockOffset:
        """Ask for the time a few times and return the offset of the computer's clock from the run's."""
        return estimate_offset([self._exchange(number) for number in range(_EXCHANGES)])

    def end(self) -> None:
        """Make the process stop sampling, without waiting."""
        self._send("stop\n")

    def fetch(self) -> float | None:
        """Wait, after `end`, until all samples are in `samples`; return the CPU time of sampling, s, if known."""
        while True:
            try:
                seconds = self._await("end", _PATIENCE)[0][0]
            except LinkError:
                if self.is_alive and time.monotonic() - self.last_heard < _PATIENCE:  # still sending
                    continue
                raise
            return None if seconds == "-" else float(seconds)

    def recover(self, path: str) -> None:
        """Fetch, like `fetch`, the samples that a session with a lost connection kept, and end its process.

        Raises:
            LinkError: also where the computer has no such file.
        """
        self._send(f"recover\t{path}\n")
        self.fetch()

    def lost(self) -> LinkError:
        """Return the error for a lost connection, with ssh's own message and exit code."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_LAST_WORDS)
        code = self._process.poll()
        answer = self._answer()
        said = self._gist(answer)
        ended = "the loop fell silent" if code is None else f"the loop ended with code {code}"
        problem = f"the connection is lost: {ended}{f': {said}' if said else ''}"
        return LinkError(problem, where=self.where, fix=self._explain(answer))

    def close(self) -> None:
        """End the process at both ends; closing twice does nothing."""
        pipe = self._process.stdin
        if pipe is not None and not pipe.closed:
            with suppress(OSError):
                pipe.write(b"leave\n")  # otherwise the loop would take this for a connection that was cut
            with suppress(OSError):
                pipe.close()
        for ending in (None, signal.SIGTERM, signal.SIGKILL):
            if ending is not None:
                with suppress(ProcessLookupError):
                    os.killpg(self._process.pid, ending)
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_LAST_WORDS)
                break
        self._listener.join(_LAST_WORDS)
        if self._process.stdout is not None and not self._listener.is_alive():
            self._process.stdout.close()
        self._stderr.close()

    def _start(self, command: Sequence[str]) -> subprocess.Popen[bytes]:
        try:
            return subprocess.Popen(  # noqa: S603 - an argument list, from `ssh_command`
                list(command),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._stderr,
                start_new_session=True,
            )
        except OSError as error:
            self._stderr.close()
            problem = f"{command[0]} cannot be started: {error.strerror}"
            raise LinkError(problem, where=self.where, fix="Install the OpenSSH client.") from error

    def _agree(self, wanted: str | None) -> str:
        self._send(_program("bootstrap.sh") + _END)
        fields, _ = self._await(_GREETING, _FIRST_PATIENCE)
        offered = fields[1].split() if len(fields) > 1 and fields[0] == _VERSION else []
        form = wanted or next((form for form in FORMS if form in offered), None)
        if form is None or form not in offered:
            lack = f"cannot be sampled by {wanted}" if wanted else "has neither Linux's /proc nor a usable ps"
            fix = f"Choose among what it can: {', '.join(offered)}." if offered else "Install python3 there."
            raise LinkError(f"the computer {lack}", where=self.where, fix=fix)
        self._send(f"{form}\n{_program(FORMS[form].program)}\n{_END}lease\t{_LEASE}\n")
        return form

    def _exchange(self, number: int) -> ClockExchange:
        sent, wall_sent = self._clock.now(), time.time()
        self._send(f"clock\t{number}\n")
        while True:
            (asked, steady, wall), received = self._await("clock", _PATIENCE)
            if asked == str(number):  # not the late answer to a request that was given up
                break
        own_wall = wall_sent + (received - sent) / 2
        # The clock of a shell goes in steps, whose size is that of its last digit.
        resolution = 10.0 ** -len(steady.partition(".")[2])
        return ClockExchange(sent, received, float(steady), float(wall), own_wall, resolution)

    def _send(self, text: str) -> None:
        pipe = self._process.stdin
        try:
            if pipe is None or pipe.closed:
                raise BrokenPipeError
            pipe.write(text.encode())
            pipe.flush()
        except OSError as error:
            raise self.lost() from error

    def _await(self, kind: str, patience: float) -> tuple[list[str], float]:
        deadline = time.monotonic() + patience
        while (left := deadline - time.monotonic()) > 0:
            try:
                words, at = self._answers.get(timeout=left)
            except queue.Empty:
                break
            if not words:
                self._answers.put(([], at))  # so that the next call finds the same
                raise self.lost()
            if words[0] == kind:
                return words[1:], at
            if words[0] == "error":
                problem = f"the computer cannot do it: {' '.join(words[1:])}"
                raise LinkError(problem, where=self.where, fix="Look at it by hand.")
        problem = f"the computer did not answer within {patience:g} s"
        raise LinkError(problem, where=self.where, fix="Look at the network.")

    def _listen(self) -> None:
        for line in self._lines():
            self.last_heard = time.monotonic()
            words = line.decode("utf-8", "replace").rstrip("\n").split("\t")
            if words[0] in _SAMPLES:
                self.samples.append(words)
            else:
                self._answers.put((words, self._clock.now()))
        self._answers.put(([], self._clock.now()))

    def _lines(self) -> Iterator[bytes]:
        pipe = self._process.stdout
        with suppress(OSError, ValueError):
            while pipe is not None and (line := pipe.readline()):
                yield line

    def _answer(self) -> str:
        """Return the whole of what the command wrote to its stderr."""
        with suppress(OSError, ValueError):
            self._stderr.seek(0)
            return self._stderr.read(1 << 20).decode(errors="replace").strip()
        return ""


def _program(name: str) -> str:
    return files("robot_runner.measuring.on_board").joinpath(name).read_text(encoding="utf-8")


_logger = logging.getLogger(__name__)

_OWNER_DIGITS = 16


def new_token() -> str:
    """Return a name for a new file of samples, from this machine, this process, and a number."""
    return f"{_owner()}-{os.getpid()}-{secrets.token_hex(8)}"


def remove_leftovers(session: OnBoardSession) -> None:
    """Remove the samples on board of runs of this machine that were killed, with the loops that still keep them.

    Those of other machines stay: their runs may be alive. A failure to remove some does not fail this run.
    """
    try:
        for path in session.ask("leftovers", _owner(), answer="paths"):
            if _is_left(path):
                session.ask("discard", path, answer="discarded")
                _logger.info("removed the samples of a run that was killed: %s on %s", path, session.where)
    except LinkError as error:
        _logger.warning("samples that killed runs left on board could not be removed: %s", error)


def _owner() -> str:
    """Return a name that distinguishes this machine, or this container, whose processes alone are visible from here."""
    space = ""
    with suppress(OSError):
        space = str(Path("/proc/self/ns/pid").readlink())
    told = f"{socket.gethostname()} {uuid.getnode()} {space}"
    return hashlib.sha256(told.encode()).hexdigest()[:_OWNER_DIGITS]


def _is_left(path: str) -> bool:
    """Return whether the process that a file belongs to is dead."""
    pid = path.rpartition("/")[2].split("-")[-2]
    return pid.isdigit() and not is_alive(int(pid))
