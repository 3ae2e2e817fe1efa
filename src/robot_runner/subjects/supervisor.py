"""Supervises one program with everything that it starts: a program of its own, here or on another computer.

It imports nothing of Robot Runner, as its text is sent to computers that have none, and needs Python 3.6 or newer.

    in    one line of JSON, the task; then `stop`, or the end of the input (the sender is gone): end the program.
          With a `lease`, something has to arrive every so many seconds: a network that is cut does not end the input.
          Where that ends after `stop`, who waits for the end was killed: the program is killed, too.
    out   one line of JSON for each event: `{"started": pid, "at": ..., "steady": ...}`, the times by the wall clock and
          the steady clock, or `{"refused": why}`; where output is
          forwarded `{"out": text}` and `{"err": text}`, a character a byte; `{"ended": code, "asked": ..., ...}` once
          the program has ended, and `{"gone": [...]}` once all that it started has ended, too, or could not be ended.

The task: `command`, `environment` (None removes a variable), `folder`, `stdout` and `stderr` (files to append to;
None forwards the output), `stop_signal`, `stops_group` (its whole process group gets that), `grace` (s), `last`
(a command to execute once all has ended, such as one that removes containers), `last_seconds`, `lease` (s or None).
"""

# Importing pathlib would double the time that Python needs to start on a small computer.
# ruff: noqa: PTH111, PTH112, PTH208, PTH123

import ctypes
import fcntl
import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

# From <linux/prctl.h>.
DIE_WITH_PARENT, ADOPT_ORPHANS = 1, 36
#: How long a process may take after SIGTERM before it is killed, and how long after that until it is gone, s.
LAST_GRACE, DEATH = 2.0, 5.0
#: How often to look whether processes have ended, s.
LOOK = 0.02
#: Up to this much forwarded output waits for the network, bytes; then the program's writes block.
WAITING = 1 << 20
LINUX = sys.platform.startswith("linux")
LIBRARY = ctypes.CDLL(None) if LINUX else None


def prctl(option: int, value: int) -> None:
    """Call Linux's prctl, which Python's library lacks; do nothing on other systems."""
    if LIBRARY is not None:
        LIBRARY.prctl(option, ctypes.c_ulong(value), 0, 0, 0)


def parents() -> "dict[int, int]":
    """Return the parent of each process, by its id."""
    if not os.path.isdir("/proc/self"):
        told = subprocess.run(["ps", "-A", "-o", "pid=,ppid="], stdout=subprocess.PIPE, check=False).stdout  # noqa: S607
        return {int(pid): int(parent) for pid, parent in (line.split() for line in told.splitlines())}
    found = {}
    for name in os.listdir("/proc"):
        if name.isdigit():
            try:
                with open(f"/proc/{name}/stat", "rb") as file:
                    fields = file.read().rpartition(b")")[2].split()  # the program's name may hold anything
            except OSError:
                continue  # it has ended
            if fields[0] != b"Z":
                found[int(name)] = int(fields[1])
    return found


def descendants(pid: int) -> "list[int]":
    """Return all descendants of a process."""
    tree, last = parents(), {pid}
    found = []  # type: list[int]
    while last:
        last = {child for child, parent in tree.items() if parent in last}
        found += last
    return found


def tell(pid: int, number: int) -> bool:
    """Send a signal to a process; return whether that is possible."""
    try:
        os.kill(pid, number)
    except (ProcessLookupError, PermissionError):  # it has ended, or has become another user
        return False
    return True


def used_by(pid: int) -> float:
    """Return the CPU time of a process and of the children that it has awaited, s; 0 where it cannot be read."""
    try:
        with open(f"/proc/{pid}/stat", "rb") as file:
            times = file.read().rpartition(b")")[2].split()[11:15]
    except OSError:
        return 0.0
    return sum(map(int, times)) / os.sysconf("SC_CLK_TCK")


def leaves_children_uncounted(pid: int) -> bool:
    """Whether a process ignores the ends of its children, so that Linux reaps them and drops their CPU time."""
    try:
        with open(f"/proc/{pid}/status", "rb") as file:
            ignored = next((line for line in file if line.startswith(b"SigIgn:")), b"SigIgn: 0")
    except OSError:
        return False
    return bool(int(ignored.split()[1], 16) >> (signal.SIGCHLD - 1) & 1)


class Supervisor:
    """Starts the program of a task, and waits until all of it has ended."""

    def __init__(self, task: "dict[str, Any]") -> None:
        self.task = task
        self.waiting = bytearray()
        self.code = None  # type: int | None
        self.cpu = None  # type: float | None
        self.astray = 0.0  # CPU time of the orphans that were reaped here, s
        self.uncounted = False
        self.pipes = {}  # type: dict[int, str]
        self.wakes, wake = os.pipe()
        for end in (self.wakes, wake):
            os.set_blocking(end, False)
        signal.set_wakeup_fd(wake)
        self.is_told = False
        self.is_deserted = False
        signal.signal(signal.SIGCHLD, lambda *_: None)
        for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
            signal.signal(number, self.take_signal)
        self.heard = time.monotonic()

    def take_signal(self, *_: object) -> None:
        """Treat a signal as a stop request."""
        self.is_told = True

    def supervise(self) -> None:
        """Start the program, wait for its end, end what it left, and report all of it."""
        prctl(ADOPT_ORPHANS, 1)
        try:
            self.start()
        except OSError as error:
            self.say(refused=error.strerror or str(error))
            return
        self.say(started=self.pid, at=time.time(), steady=self.begun)
        while self.code is None and not self.is_told:
            self.look(1.0)
        asked = self.code is None
        killed = asked and not self.end_program()
        astray = self.astray + sum(map(used_by, descendants(os.getpid())))
        times = {"cpu": self.cpu, "astray": astray, "uncounted": self.uncounted}
        self.say(ended=self.code, asked=asked, killed=killed, **times, at=time.time())
        left = self.end_rest()
        self.wait(lambda: not self.pipes, 1.0)  # the last of the output
        self.clean_up()
        self.say(gone=left)

    def start(self) -> None:
        """Start the program; raise an `OSError` if it cannot be started."""
        task = self.task
        outputs = []
        for name, path in (("out", task["stdout"]), ("err", task["stderr"])):
            if path is None:
                reader, writer = os.pipe()
                os.set_blocking(reader, False)
                self.pipes[reader] = name
                outputs.append(writer)
            else:
                outputs.append(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644))
        try:
            self.begun = time.monotonic()
            # Kept, as Python would reap the program once the object is gone.
            self.program = self.spawn(task["command"], outputs)
            self.pid = self.program.pid
        finally:
            for output in outputs:
                os.close(output)

    def spawn(self, command: "list[str]", outputs: "list[int]") -> "subprocess.Popen[bytes]":
        """Start a command with the task's environment and folder."""
        changed = self.task["environment"]
        environment = {name: value for name, value in {**os.environ, **changed}.items() if value is not None}
        folder = self.task["folder"]
        return subprocess.Popen(  # noqa: S603 - the task's own command
            command,
            stdin=subprocess.DEVNULL,
            stdout=outputs[0],
            stderr=outputs[1],
            cwd=None if folder is None else os.path.expanduser(folder),
            env=environment,
            preexec_fn=lambda: prctl(DIE_WITH_PARENT, signal.SIGKILL),  # noqa: PLW1509 - no threads here
            start_new_session=True,
        )

    def look(self, seconds: float) -> None:
        """Wait at most this long for input, output, or an end, and handle it."""
        lease = self.task["lease"]
        hears = not self.is_told or (lease is not None and not self.is_deserted)
        readers = [0, self.wakes] if hears else [self.wakes]
        if len(self.waiting) < WAITING:
            readers += self.pipes
        writers = [1] if self.waiting else []
        ready, writable, _ = select.select(readers, writers, [], seconds)
        if self.wakes in ready:
            os.read(self.wakes, 4096)
        if 0 in ready:
            said = os.read(0, 4096)
            self.heard = time.monotonic()
            self.is_deserted = lease is not None and self.is_told and not said
            self.is_told = self.is_told or not said or b"stop" in said
        if lease is not None and time.monotonic() - self.heard > lease:
            self.is_told = True
        for pipe in set(ready).intersection(self.pipes):
            self.forward(pipe)
        if writable:
            self.flush()
        self.reap()

    def reap(self) -> None:
        """Reap every process that has ended; this process is the parent of those that lost their own."""
        try:
            while True:
                which = -1
                if LINUX:
                    # Until it is reaped, the signals that an ended process ignored can still be read.
                    ended = os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)
                    if ended is None:
                        return
                    which = ended.si_pid
                    if which == self.pid:
                        self.uncounted = leaves_children_uncounted(which)
                pid, status, used = os.wait4(which, os.WNOHANG)
                if pid == 0:
                    return
                if pid == self.pid:
                    self.cpu = used.ru_utime + used.ru_stime
                    self.code = -os.WTERMSIG(status) if os.WIFSIGNALED(status) else os.WEXITSTATUS(status)
                else:
                    self.astray += used.ru_utime + used.ru_stime
        except ChildProcessError:
            return

    def forward(self, pipe: int) -> None:
        """Forward the program's output."""
        data = os.read(pipe, 1 << 16)
        if data:
            self.say(**{self.pipes[pipe]: data.decode("latin-1")})
        else:
            del self.pipes[pipe]
            os.close(pipe)

    def say(self, **event: object) -> None:
        """Send an event, as soon as the output takes it."""
        self.waiting += json.dumps(event).encode() + b"\n"
        self.flush()

    def flush(self) -> None:
        """Write what can be written now."""
        try:
            while self.waiting:
                del self.waiting[: os.write(1, self.waiting)]
        except BlockingIOError:
            return
        except OSError:  # nobody reads the output any more
            self.waiting.clear()
            self.is_told = True

    def end_program(self) -> bool:
        """End the program; return whether it ended on its signal.

        Without `stops_group` the program alone gets the signal, so that it can end what it started itself.
        """
        tell(-self.pid if self.task["stops_group"] else self.pid, self.task["stop_signal"])
        self.wait(lambda: self.code is not None or self.is_deserted, self.task["grace"])
        if self.code is not None:
            return True
        for pid in descendants(os.getpid()):
            tell(pid, signal.SIGTERM)
        self.wait(lambda: self.code is not None or self.is_deserted, LAST_GRACE)
        if self.code is None:
            tell(self.pid, signal.SIGKILL)
            self.wait(lambda: self.code is not None, DEATH)
        return False

    def end_rest(self) -> "list[int]":
        """End what the program left behind, whatever session it has; return what could not be ended."""
        for pid in descendants(os.getpid()):
            tell(pid, signal.SIGTERM)
        self.wait(lambda: self.is_deserted or not descendants(os.getpid()), LAST_GRACE)
        if not descendants(os.getpid()):
            return []
        if not LINUX:  # there, orphans are not descendants of this process
            tell(-self.pid, signal.SIGKILL)
        deadline = time.monotonic() + DEATH
        left = descendants(os.getpid())
        while left and time.monotonic() < deadline:
            if not any([tell(pid, signal.SIGKILL) for pid in left]):  # noqa: C419 - each of them gets it
                break
            self.look(LOOK)
            left = descendants(os.getpid())
        return left

    def wait(self, is_enough: "Callable[[], bool]", seconds: float) -> bool:
        """Wait for a condition at most this long, and return whether it holds."""
        deadline = time.monotonic() + seconds
        while not is_enough():
            if time.monotonic() >= deadline:
                return False
            self.look(LOOK)
        return True

    def clean_up(self) -> None:
        """Execute the task's last command."""
        if self.task["last"] is None:
            return
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        paths = [self.task["stdout"] or os.devnull, self.task["stderr"] or os.devnull]
        outputs = [os.open(path, os.O_WRONLY | os.O_APPEND) for path in paths]
        try:
            self.spawn(self.task["last"], outputs).wait(self.task["last_seconds"])
        except (OSError, subprocess.TimeoutExpired) as error:
            self.say(unclean=str(error))
        self.end_rest()

    def leave(self) -> None:
        """Send all remaining events, as long as somebody reads them."""
        deadline = time.monotonic() + DEATH
        while self.waiting and time.monotonic() < deadline:
            select.select([], [1], [], LOOK)
            self.flush()


def read_line() -> bytes:
    """Return the first line of the input, and not a byte more."""
    line = b""
    while not line.endswith(b"\n"):
        byte = os.read(0, 1)
        if not byte:
            raise SystemExit(1)
        line += byte
    return line


def main() -> None:
    """Read the task and supervise its program; a lock on the output shows others that the supervisor is alive."""
    task = json.loads(read_line().decode())
    if task["stdout"] is None:
        os.set_blocking(1, False)
    else:
        fcntl.flock(1, fcntl.LOCK_EX | fcntl.LOCK_NB)
    supervisor = Supervisor(task)
    supervisor.supervise()
    supervisor.leave()


if __name__ == "__main__":
    main()
