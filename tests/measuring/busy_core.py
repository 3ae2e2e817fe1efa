"""A core that is known to be busy, for whoever measures it."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

_PROGRAM = """\
import os, sys, time
os.sched_setaffinity(0, {{{core}}})
begun = time.process_time()
while time.process_time() < begun + 0.1:
    pass
print(flush=True)
while True:
    pass
"""

needs_affinity = pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="cores can be chosen on Linux alone")


class Busy(NamedTuple):
    """A process that keeps one core busy."""

    core: int
    pid: int

    @property
    def cpu_seconds(self) -> float:
        """What the kernel says that the process has used."""
        fields = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


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


def wait(seconds: float) -> None:
    """Let real time go by: what is measured here has no clock that could be moved."""
    threading.Event().wait(seconds)
