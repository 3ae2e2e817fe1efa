"""The processes of this machine that selectors match, through psutil."""

from __future__ import annotations

import time
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from robot_runner.links.counters import ProcessCounters

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["LocalProcesses", "matches"]

#: Seconds between two looks for new processes.
_RESCAN = 1.0
#: Looks during which a process may still turn into another program.
_YOUNG = 5
_INTERPRETERS = ("python", "perl", "ruby", "node", "sh", "bash", "dash")


class LocalProcesses:
    """Finds processes and reads their counters.

    Args:
        psutil: the library, imported by whoever needs it.
        selectors: as `process_selector` makes them.
    """

    def __init__(self, psutil: Any, selectors: Sequence[str]) -> None:
        self._psutil = psutil
        self._selectors = tuple(selectors)
        self._ages: dict[int, int] = {}
        self._matched: dict[int, tuple[Any, tuple[int, ...]]] = {}
        self._next_scan = 0.0

    def counters(self) -> tuple[ProcessCounters, ...]:
        """Return the counters of each process that matches."""
        if time.monotonic() >= self._next_scan:
            self._next_scan = time.monotonic() + _RESCAN
            self._scan()
        return tuple(counters for pid in list(self._matched) for counters in self._of(pid))

    def _of(self, pid: int) -> list[ProcessCounters]:
        process, places = self._matched[pid]
        try:
            with process.oneshot():
                times, memory = process.cpu_times(), process.memory_info().rss
        except self._psutil.Error:  # it has ended
            del self._matched[pid]
            return []
        started = repr(process.create_time())
        return [ProcessCounters(place, pid, started, times.user + times.system, float(memory)) for place in places]

    def _scan(self) -> None:
        self._ages = {pid: self._ages.get(pid, 0) + 1 for pid in self._psutil.pids()}
        for pid, age in self._ages.items():
            if age <= _YOUNG:
                self._matched.pop(pid, None)
                self._look_at(pid)

    def _look_at(self, pid: int) -> None:
        try:
            process = self._psutil.Process(pid)
            name, words = process.name(), process.cmdline()
        except self._psutil.Error:
            return
        places = tuple(place for place, one in enumerate(self._selectors) if matches(one, pid, name, words))
        if places:
            self._matched[pid] = (process, places)


def matches(selector: str, pid: int, name: str, words: Sequence[str]) -> bool:
    """Whether a process is one that a selector means.

    Args:
        selector: as `process_selector` makes it.
        pid: the process's number.
        name: the process's name, as the system knows it.
        words: its command line.

    Example:
        >>> matches("name:talker.py", 4711, "python3", ["/usr/bin/python3", "/opt/talker.py"])
        True
        >>> matches("node:/talker", 4711, "talker", ["/opt/talker", "--ros-args", "-r", "__node:=talker"])
        True
    """
    kind, _, value = selector.partition(":")
    if kind == "pid":
        return pid == int(value)
    if kind == "node":
        bare = value.lstrip("/")
        return f"__name:={bare}" in words or f"__node:={bare}" in words
    names = {name, *(PurePath(word).name for word in words[:1])}
    if len(words) > 1 and PurePath(words[0]).name.startswith(_INTERPRETERS):
        names.add(PurePath(words[1]).name)
    return value in names
