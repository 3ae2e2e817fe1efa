"""The lines that the on-board loop sends, understood; `on_board/loop.py` describes them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.links.counters import CoreCounters, CounterSample, ProcessCounters
from robot_runner.links.host import FileSample

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robot_runner.plugins.sampling.device_clock import ClockMap

__all__ = ["counter_sample", "file_line", "file_sample"]

_KILOBYTE = 1024.0


def counter_sample(fields: Sequence[str]) -> CounterSample | None:
    """Return the counters of an `s` line, or None if it is damaged.

    Example:
        >>> sample = counter_sample("5.25|:200:150,0:100:90,1:100:60|8000:6000|0:42:77:1.5:4096".split("|"))
        >>> sample.whole, len(sample.cores), sample.processes[0].cpu
        (CoreCounters(total=200.0, idle=150.0), 2, 1.5)
    """
    try:
        time, cores, memory, processes = fields
        counters = dict(map(_core, cores.split(",")))
        total, available = map(float, memory.split(":"))
        return CounterSample(
            time=float(time),
            whole=counters[-1],
            # A core that is switched off has no line of its own.
            cores=tuple(counters.get(place, CoreCounters(0.0, 0.0)) for place in range(max(counters) + 1)),
            memory_total=total * _KILOBYTE,
            memory_available=available * _KILOBYTE,
            processes=tuple(map(_process, filter(None, processes.split(",")))),
        )
    except (ValueError, KeyError):
        return None


def _core(text: str) -> tuple[int, CoreCounters]:
    """Return the number of a core, -1 for all of them together, and its counters."""
    number, total, idle = text.split(":")
    return int(number or -1), CoreCounters(float(total), float(idle))


def _process(text: str) -> ProcessCounters:
    selector, pid, started, cpu, memory = text.split(":")
    return ProcessCounters(int(selector), int(pid), started, float(cpu), float(memory))


def file_line(field: str) -> str | None:
    """Return the line of a file as it was sent, or None where it could not be read."""
    return field[1:] if field.startswith("=") else None


def file_sample(fields: Sequence[str], to_run: ClockMap, *, files: int) -> FileSample | None:
    """Return the lines of an `f` line, or None if it is damaged."""
    try:
        time = to_run.to_run(float(fields[0]))
    except (ValueError, IndexError):
        return None
    lines = tuple(map(file_line, fields[1:]))
    return FileSample(time, lines) if len(lines) == files else None
