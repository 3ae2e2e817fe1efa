"""The state of a Linux computer at one moment: CPU time of processes, memory, frequency, temperature, throttling.

Everything comes from /proc and /sys. What a computer does not show is None: a container shows less, but nothing
wrong.
"""

from __future__ import annotations

import os
import re
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from robot_runner.meters.machine.processor_state import Conditions, Files, ProcessorFiles

#: Ticks a second in /proc: USER_HZ, which is 100 on all computers of robots and their users.
_TICKS = 100.0
_MICRO = 1e-6
_MOST = 1 << 16
_PF_KTHREAD = 0x00200000  # linux/sched.h


class SystemFiles:
    """The files of this machine.

    Args:
        root: the folder that stands for `of`; tests have a copy elsewhere.
        of: a folder of the machine.

    Example:
        >>> SystemFiles().read_files(["/dev/null", "/no/such/file"])
        ['', None]
    """

    def __init__(self, root: Path = Path("/"), *, of: str = "/") -> None:
        self._root = root
        self._of, self._prefix = of.rstrip("/"), str(root).rstrip("/")

    def list_files(self, pattern: str) -> list[str]:
        """Return the paths that match a pattern of the shell, sorted."""
        found = self._root.glob(pattern.removeprefix(self._of).lstrip("/"))
        return sorted(self._of + str(path).removeprefix(self._prefix) for path in found)

    def read_files(self, paths: Sequence[str]) -> list[str | None]:
        """Return the content of each file, 64 KiB at most; None for one that cannot be read."""
        return [_content(self._prefix + path.removeprefix(self._of)) for path in paths]


def _content(path: str) -> str | None:
    # Faster than `open`, which takes three times as long, as there may be thousands of processes.
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        try:
            return os.read(descriptor, _MOST).decode("utf-8", "replace").rstrip("\n")
        finally:
            os.close(descriptor)
    except OSError:
        return None


def text_in(path: Path) -> str:
    """Return the content of a small file of the kernel; an empty text if it cannot be read."""
    with suppress(OSError):
        return path.read_text(encoding="ascii", errors="replace").strip()
    return ""


@dataclass(frozen=True, slots=True)
class ProcessTimes:
    """The CPU time of one process.

    Attributes:
        pid: of the process.
        parent: the process that started it, or that adopted it.
        name: in the kernel.
        started: in ticks since the computer started: distinguishes it from an earlier process with the same pid.
        is_kernel: whether it is a thread of the kernel.
        own: CPU time that it has used, s.
        children: CPU time of its children that have ended and were reaped, s.
    """

    pid: int
    parent: int
    name: str
    started: str
    is_kernel: bool
    own: float
    children: float

    @classmethod
    def of_stat(cls, text: str) -> ProcessTimes:
        """Read /proc/PID/stat (proc_pid_stat(5)); a name may hold blanks and parentheses.

        Raises:
            ValueError: the text is no such line.

        Example:
            >>> stat = "42 (a b) S 1 42 42 0 -1 0 0 0 0 0 150 50 7 3 20 0 1 0 999 0 0"
            >>> process = ProcessTimes.of_stat(stat)
            >>> process.name, process.parent, process.own, process.children, process.started
            ('a b', 1, 2.0, 0.1, '999')
        """
        head, _, tail = text.rpartition(")")
        pid, _, name = head.partition("(")
        fields = tail.split()
        if len(fields) <= 19:  # noqa: PLR2004 - up to the time at which it was started
            raise ValueError(text)
        utime, stime, cutime, cstime = (int(field) / _TICKS for field in fields[11:15])
        is_kernel = bool(int(fields[6]) & _PF_KTHREAD)
        return cls(int(pid), int(fields[1]), name, fields[19], is_kernel, utime + stime, cutime + cstime)


@dataclass(frozen=True, slots=True)
class MachineState:
    """The state of a computer at one moment.

    Attributes:
        at: the time, s on a steady clock.
        busy: CPU time that processes used on all cores since the computer started, s; None if unknown.
        stolen: CPU time that a hypervisor gave to others, s.
        processes: by pid; those that the reader can see.
        reader: the pid of the process that read the files there.
        swapped: pages moved to and from swap since the computer started.
        stalled: how long some process had to wait for memory since the computer started, s.
        conditions: of its processor.
    """

    at: float
    busy: float | None
    stolen: float | None
    processes: Mapping[int, ProcessTimes]
    reader: int | None
    swapped: int | None
    stalled: float | None
    conditions: Conditions


class MachineFiles:
    """The files with the state of a computer; found once, read several times.

    Args:
        files: the computer.

    Attributes:
        processor: the files of its processor.
    """

    def __init__(self, files: Files) -> None:
        self._files = files
        self.processor = ProcessorFiles(files)
        self._cheap = [*self.processor.settings, *self.processor.changing]

    def conditions(self) -> Conditions:
        """Read the conditions of the processor: a few files for each core."""
        return self.processor.conditions(dict(zip(self._cheap, self._files.read_files(self._cheap), strict=True)))

    def state(self) -> MachineState:
        """Read everything, also each process."""
        listed = self._files.list_files("/proc/[0-9]*/stat")
        general = ["/proc/stat", "/proc/self/stat", "/proc/vmstat", "/proc/pressure/memory"]
        texts = self._files.read_files([*general, *self._cheap, *listed])
        times, reader, memory, pressure = texts[: len(general)]
        cheap = texts[len(general) : len(general) + len(self._cheap)]
        processes = _processes(texts[len(general) + len(self._cheap) :])
        busy, stolen = _cpu_times(times)
        return MachineState(
            at=time.monotonic(),
            busy=busy,
            stolen=stolen,
            processes=processes,
            reader=next(iter(_processes([reader])), None),
            swapped=_swapped(memory),
            stalled=_stalled(pressure),
            conditions=self.processor.conditions(dict(zip(self._cheap, cheap, strict=True))),
        )

    def command_lines(self, pids: Sequence[int]) -> dict[int, list[str]]:
        """Return the command lines of processes, as words; empty for one that has ended."""
        texts = self._files.read_files([f"/proc/{pid}/cmdline" for pid in pids])
        return {pid: [word for word in (text or "").split("\0") if word] for pid, text in zip(pids, texts, strict=True)}


def _cpu_times(text: str | None) -> tuple[float | None, float | None]:
    """Return busy and stolen time of the first line of /proc/stat (proc_stat(5)).

    User time includes that of guests. Time in interrupts is left out, as it is not in the CPU time of any process.
    """
    words = (text or "").partition("\n")[0].split()
    if len(words) < 9 or words[0] != "cpu" or not all(word.isdigit() for word in words[1:]):  # noqa: PLR2004 - to `steal`
        return None, None
    user, nice, system, _idle, _iowait, _irq, _softirq, steal = (int(word) / _TICKS for word in words[1:9])
    return user + nice + system, steal


def _processes(texts: Iterable[str | None]) -> dict[int, ProcessTimes]:
    found = {}
    for text in texts:
        try:
            process = ProcessTimes.of_stat(text or "")
        except ValueError:  # the process has ended meanwhile
            continue
        found[process.pid] = process
    return found


def _swapped(text: str | None) -> int | None:
    pages = re.findall(r"^pswp(?:in|out) (\d+)$", text or "", re.MULTILINE)
    return sum(map(int, pages)) if pages else None


def _stalled(text: str | None) -> float | None:
    found = re.search(r"^some .*total=(\d+)", text or "")
    return int(found[1]) * _MICRO if found else None
