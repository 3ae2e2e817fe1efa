"""What sampling at 10 Hz costs the computer that is sampled, and how true it is for a core that is known to be busy."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.table import Row, print_table
from robot_runner.core.events.context import SystemClock
from robot_runner.measuring.local_host import LocalHost
from robot_runner.measuring.on_board.loop import YOUNG
from robot_runner.measuring.on_board_session import FORMS, REMOTE_COMMAND
from robot_runner.measuring.ssh_host import SshHost

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from robot_runner.measuring.host import HostLink, UtilisationSample

_RATE = 10.0
_SECONDS = 20.0
_BOUND = "1 %"
#: What no process is called, so that each is looked at and none is sampled; and beside how many.
_NOBODY, _MANY = ("name:nobody",), 400
_SPIN = "import os, sys; os.sched_setaffinity(0, {int(sys.argv[1])}); print(flush=True)\nwhile True: pass"


def main() -> None:
    """Print the figures; the loops are those that are sent over ssh, executed here without it."""
    costs = [*map(_cost, FORMS), _cost_here()]
    print_table(f"What sampling at {_RATE:g} Hz costs, over {_SECONDS:g} s", costs)
    with _many_processes() as count:
        costs = [_cost(form, _NOBODY) for form in FORMS] + [_cost_here(_NOBODY)]
    print_table(f"The same, where a program is looked for among {count} processes", costs)
    print_table("CPU utilisation of a core that is kept busy, 5 s at 10 Hz", _truths())


def _cost(form: str, processes: Sequence[str] = ()) -> Row:
    before = _children()
    link = _on_board(form)
    sampler = link.sample_processes(_RATE, processes)
    time.sleep(_SECONDS)
    count = len(sampler.stop())
    report = sampler.report()
    link.close()
    sampling = report.cpu_seconds or 0.0
    starting = _children() - before - sampling
    return Row(
        f"on board, {form}, {count} samples at {report.rate:g} Hz",
        f"{100 * sampling / _SECONDS:.2f} % of a core",
        f"and {starting * 1e3:.0f} ms once, to start",
        bound=_BOUND if form == "python3" and not processes else "",
    )


def _cost_here(processes: Sequence[str] = ()) -> Row:
    link = LocalHost(SystemClock())
    sampler = link.sample_processes(_RATE, processes)
    time.sleep(_SECONDS)
    count = len(sampler.stop())
    seconds = sampler.report().cpu_seconds or 0.0
    return Row(f"psutil here, {count} samples at {_RATE:g} Hz", f"{100 * seconds / _SECONDS:.2f} % of a core")


def _truths() -> list[Row]:
    rows = []
    with _busy_core() as core:
        hosts: dict[str, HostLink] = {"psutil, here": LocalHost(SystemClock())}
        # ps tells of no single cores.
        hosts |= {form: _on_board(form) for form in FORMS if form != "ps"}
        for name, link in hosts.items():
            sampler = link.sample_utilisation(_RATE)
            time.sleep(5.0)
            value = _mean(sampler.stop(), core)
            link.close()
            rows.append(Row(name, f"{value:.2f} %", "100 %", f"{abs(value - 100):.2f} points off", "2 points"))
    return rows


def _mean(samples: Sequence[UtilisationSample], core: int) -> float:
    spans = [(late.time - soon.time, late.cores[core]) for soon, late in pairwise(samples)]
    told = [(seconds, value) for seconds, value in spans if value is not None]
    return sum(seconds * value for seconds, value in told) / sum(seconds for seconds, _ in told)


def _on_board(form: str) -> SshHost:
    return SshHost("here", SystemClock(), form=form, command=["sh", "-c", REMOTE_COMMAND])


def _children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@contextmanager
def _many_processes() -> Iterator[int]:
    """Have as many processes as a desktop, each older than what may still turn into another program."""
    running = [subprocess.Popen(["/bin/sleep", "600"]) for _ in range(_MANY)]
    try:
        time.sleep(YOUNG)
        yield sum(each.name.isdigit() for each in Path("/proc").iterdir())
    finally:
        for process in running:
            process.kill()
            process.wait()


@contextmanager
def _busy_core() -> Iterator[int]:
    core = max(os.sched_getaffinity(0))
    command = [sys.executable, "-I", "-S", "-c", _SPIN, str(core)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        try:
            if process.stdout is not None:
                process.stdout.readline()
            yield core
        finally:
            process.kill()


if __name__ == "__main__":
    main()
