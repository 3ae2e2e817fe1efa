"""A core that is known to be busy, for whoever measures it."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
from tests.waiting import wait_until

from robot_runner.measuring.host import SUBJECT_VARIABLE

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from robot_runner.measuring.host import UtilisationSample
    from robot_runner.measuring.on_board_sampler import OnBoardSampler

#: The name of the subject that `busy_family` keeps busy: all processes of the machine are looked through, among which
#: may be those of tests that another process executes at the same time.
FAMILY = f"Family{os.getpid()}"

_PROGRAM = """\
import os, time
os.sched_setaffinity(0, {{{core}}})
begun = time.process_time()
while time.process_time() < begun + 0.1:
    pass
print(flush=True)
while True:
    pass
"""

#: Children come and go faster than anybody looks for new processes.
_FAMILY = """\
import os, time
while True:
    if not os.fork():
        while time.process_time() < 0.08:
            pass
        os._exit(0)
    os.wait()
    print(flush=True)
"""

needs_affinity = pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="cores can be chosen on Linux alone")


class Busy(NamedTuple):
    """A process that keeps one core busy."""

    core: int
    pid: int

    @property
    def cpu_seconds(self) -> float:
        """What the kernel says that the process has used, with its children that have ended."""
        fields = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()
        return sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")

    def wait_for_children(self, seconds: float) -> None:
        """Wait until children that ended have used so much: a counter of the kernel may lag by four of its ticks."""
        while self.cpu_seconds < seconds - 4 / os.sysconf("SC_CLK_TCK"):
            wait(0.05)


@contextmanager
def busy_core() -> Iterator[Busy]:
    """Keep the last core busy that this process may use."""
    core = max(os.sched_getaffinity(0))
    command = [sys.executable, "-I", "-S", "-c", _PROGRAM.format(core=core)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()
            yield Busy(core, process.pid)
        finally:
            process.kill()


#: The child is there for a while after it has ended, until it is awaited.
ZOMBIE = """\
import os, time
print(flush=True)
time.sleep(0.2)
if not os.fork():
    begun = time.process_time()
    while time.process_time() - begun < 0.3:
        pass
    os._exit(0)
os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOWAIT)
time.sleep(1.3)
os.wait()
time.sleep(100)
"""


@contextmanager
def busy_family(*around: str, program: str = _FAMILY) -> Iterator[Busy]:
    """Keep a subject of the name `FAMILY` busy whose work is done by children, most of which live for a moment each.

    Args:
        around: a command that executes the one that follows it.
        program: what it executes.
    """
    command = [*around, sys.executable, "-I", "-S", "-c", program]
    marked = {**os.environ, SUBJECT_VARIABLE: FAMILY}
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=marked, start_new_session=True) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()
            yield Busy(-1, process.pid)
        finally:
            os.killpg(process.pid, signal.SIGKILL)


@contextmanager
def late_program(folder: Path) -> Iterator[tuple[str, int, Callable[[], None]]]:
    """Start a script that turns into a program once it is told to; yield its name, the process, and what tells it."""
    program = folder / f"late{os.getpid()}"
    shutil.copy(shutil.which("sleep") or "/bin/sleep", program)
    with subprocess.Popen(["sh", "-c", 'read go; exec "$0" 1000', program], stdin=subprocess.PIPE) as process:
        command = Path(f"/proc/{process.pid}/comm")

        def turn() -> None:
            assert process.stdin is not None
            process.stdin.write(b"go\n")
            process.stdin.flush()
            while command.read_text().strip() != program.name:
                wait(0.01)

        try:
            yield program.name, process.pid, turn
        finally:
            process.kill()


def counted_seconds(samples: Sequence[UtilisationSample], place: int = 0) -> float:
    """Return the CPU time, s, that samples tell of the processes of one selector."""
    shares = [(late.time - soon.time) * (late.processes[place].cpu or 0.0) for soon, late in pairwise(samples)]
    return sum(shares) / 100 * (os.cpu_count() or 1)


def samples_so_far(sampler: OnBoardSampler[Any]) -> int:
    """Return how many samples have arrived, or are kept on board where that is this machine."""
    if sampler._path is None:
        return len(sampler._session.samples)
    return Path(sampler._path).read_text(encoding="utf-8").count("\n") - 1  # the first line tells whose they are


def wait_for_samples(count: int, sampler: OnBoardSampler[Any]) -> int:
    """Wait for so many samples, however long a busy machine takes for them, and return how many there are."""
    wait_until(lambda: samples_so_far(sampler) >= count)
    return samples_so_far(sampler)


def wait(seconds: float) -> None:
    """Let real time go by: what is measured here has no clock that could be moved."""
    threading.Event().wait(seconds)
