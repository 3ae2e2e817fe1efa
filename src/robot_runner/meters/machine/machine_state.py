"""The state of a Linux computer at one moment: CPU time of processes, memory, frequency, temperature, throttling.

Everything comes from /proc and /sys. What a computer does not show is None: a container shows less, but nothing
wrong.
"""

from __future__ import annotations

import math
import os
import re
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

#: Ticks a second in /proc: USER_HZ, which is 100 on all computers of robots and their users.
_TICKS = 100.0
_KILO, _MILLI, _MICRO = 1e3, 1e-3, 1e-6
_MOST = 1 << 16
_PF_KTHREAD = 0x00200000  # linux/sched.h
#: Zones with other temperatures, in degC, are asleep or broken; a sleeping GPU shows -256.
_PLAUSIBLE = (-40.0, 150.0)
#: Zones that measure nothing: NVIDIA's Jetsons always show 100 degC there (balena-os/balena-jetson, issue 142).
_DUMMY_ZONES = ("PMIC-Die",)
#: Cooling devices that throttle the processor, as they are called in newer and older kernels; the others are fans and
#: the like. intel_powerclamp says -1 while it does nothing (drivers/thermal/cpu*_cooling.c, intel/intel_powerclamp.c).
PROCESSOR_COOLERS = ("Processor", "cpufreq", "thermal-cpufreq", "idle-", "cpuidle", "thermal-idle", "intel_powerclamp")
#: The firmware of a Raspberry Pi (raspberrypi/linux, pull request 2397), in hexadecimal: bit 0 is under-voltage; bits
#: 1 to 3 are a capped frequency, throttling and the soft temperature limit; 16 bits higher, the same since the start,
#: or within two seconds where the driver of its voltage sensor asks (drivers/hwmon/raspberrypi-hwmon.c), as it does in
#: Raspberry Pi OS. On a Raspberry Pi 5 it is `soc@107c000000` (bcm2712.dtsi).
FIRMWARE = "/sys/devices/platform/soc*/soc*:firmware/get_throttled"
UNDER_VOLTAGE, HELD_BACK, EVER = 0b0001, 0b1110, 16
#: How often a Jetson was throttled as it drew too much current, or its voltage fell, since it started. Source: NVIDIA,
#: Jetson Linux Developer Guide, Platform Power and Performance.
OVER_CURRENTS = "/sys/class/hwmon/hwmon*/oc[0-9]_event_cnt"
_CPU = "/sys/devices/system/cpu"
#: 1 switches turbo off in the first (Intel), and on in the second (the others): Linux, admin-guide/pm.
_NO_TURBO, _BOOST = f"{_CPU}/intel_pstate/no_turbo", f"{_CPU}/cpufreq/boost"


class Files(Protocol):
    """A computer whose files can be read: this one, or another over ssh, of whose files only the first line is read."""

    def list_files(self, pattern: str) -> list[str]:
        """Return the paths that match a pattern of the shell, sorted."""

    def read_files(self, paths: Sequence[str]) -> Sequence[str | None]:
        """Return the content of each file; None for one that cannot be read."""


class SystemFiles:
    """The files of this machine.

    Args:
        root: the folder with `proc` and `sys`; tests have a copy elsewhere.

    Example:
        >>> SystemFiles().read_files(["/dev/null", "/no/such/file"])
        ['', None]
    """

    def __init__(self, root: Path = Path("/")) -> None:
        self.root = root
        self._prefix = str(root).rstrip("/")

    def list_files(self, pattern: str) -> list[str]:
        """Return the paths that match a pattern of the shell, sorted."""
        found = self.root.glob(pattern.lstrip("/"))
        return sorted(str(path).removeprefix(self._prefix) for path in found)

    def read_files(self, paths: Sequence[str]) -> list[str | None]:
        """Return the content of each file, 64 KiB at most; None for one that cannot be read."""
        return [_content(self._prefix + path) for path in paths]


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
class Conditions:
    """The conditions of a processor at one moment.

    Attributes:
        governors: which choose the frequency, without repetitions; empty where they are unknown.
        is_turbo: whether it may exceed its nominal frequency.
        frequency: mean over the cores, Hz.
        limit: the highest frequency that is allowed, mean over the cores, Hz.
        temperature: of the hottest zone, degC.
        throttle_counts: how often each core, and its package, was throttled for heat since the computer started; each
            core has a counter of its package. None where there are no such counters, or one cannot be read.
        is_held_back: whether the kernel or the firmware throttles it now.
        is_under_voltage: whether the supply voltage is too low now.
        over_currents: how often a Jetson was throttled for its current or its voltage since it started; None where that
            is not counted, or a counter cannot be read.
        firmware_flags: a Raspberry Pi's flags of what is happening now or has happened before: since the computer
            started, or within two seconds.
    """

    governors: tuple[str, ...] = ()
    is_turbo: bool | None = None
    frequency: float | None = None
    limit: float | None = None
    temperature: float | None = None
    throttle_counts: tuple[int, ...] | None = None
    is_held_back: bool | None = None
    is_under_voltage: bool | None = None
    over_currents: int | None = None
    firmware_flags: int = 0


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
    """

    def __init__(self, files: Files) -> None:
        self._files = files
        # Of each core, even if several share a clock, like the small and the large ones of many boards.
        clocks = files.list_files(f"{_CPU}/cpu[0-9]*/cpufreq/scaling_*")
        thermal = files.list_files("/sys/class/thermal/*/*")
        self._governors = _named(clocks, "scaling_governor")
        self._frequencies = _named(clocks, "scaling_cur_freq")
        self._limits = _named(clocks, "scaling_max_freq")
        self._counters = files.list_files(f"{_CPU}/cpu[0-9]*/thermal_throttle/*_throttle_count")
        types = _named(thermal, "type")
        kinds = dict(zip(types, files.read_files(types) if types else (), strict=True))
        self._temperatures = [
            path
            for path in _named(thermal, "temp")
            if "thermal_zone" in path and is_measured(kinds.get(f"{path.removesuffix('temp')}type"))
        ]
        self._coolers = [
            f"{path.removesuffix('type')}cur_state"
            for path, kind in kinds.items()
            if "cooling_device" in path and (kind or "").startswith(PROCESSOR_COOLERS)
        ]
        self._firmware, self._over_currents = files.list_files(FIRMWARE), files.list_files(OVER_CURRENTS)
        self._cheap = [
            *(_NO_TURBO, _BOOST),
            *self._firmware,
            *self._governors,
            *self._frequencies,
            *self._limits,
            *self._temperatures,
            *self._counters,
            *self._over_currents,
            *self._coolers,
        ]

    @property
    def tells_of_conditions(self) -> bool:
        """Whether there are files of conditions of the processor that change by themselves."""
        return bool(self._frequencies or self._temperatures or self._coolers or self._firmware)

    @property
    def has_firmware(self) -> bool:
        """Whether there is a Raspberry Pi's firmware, whose flags may be taken back after two seconds."""
        return bool(self._firmware)

    def conditions(self) -> Conditions:
        """Read the conditions of the processor: a few files for each core."""
        return self._understood(dict(zip(self._cheap, self._files.read_files(self._cheap), strict=True)))

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
            conditions=self._understood(dict(zip(self._cheap, cheap, strict=True))),
        )

    def command_lines(self, pids: Sequence[int]) -> dict[int, list[str]]:
        """Return the command lines of processes, as words; empty for one that has ended."""
        texts = self._files.read_files([f"/proc/{pid}/cmdline" for pid in pids])
        return {pid: [word for word in (text or "").split("\0") if word] for pid, text in zip(pids, texts, strict=True)}

    def _understood(self, texts: Mapping[str, str | None]) -> Conditions:
        def numbers(paths: Iterable[str]) -> list[float]:
            return [number for path in paths if (number := _number(texts[path])) is not None]

        temperatures = [each * _MILLI for each in numbers(self._temperatures)]
        counts, coolers = numbers(self._counters), numbers(self._coolers)
        over = numbers(self._over_currents)
        flags = next((_hexadecimal(texts[path]) for path in self._firmware), None)
        tells = bool(coolers) or flags is not None
        now = flags or 0
        return Conditions(
            governors=tuple(dict.fromkeys(text for path in self._governors if (text := texts[path]))),
            is_turbo=_turbo(_number(texts[_NO_TURBO]), _number(texts[_BOOST])),
            frequency=_mean(numbers(self._frequencies), _KILO),
            limit=_mean(numbers(self._limits), _KILO),
            temperature=max(filter(is_plausible, temperatures), default=None),
            throttle_counts=tuple(map(int, counts)) if counts and len(counts) == len(self._counters) else None,
            is_held_back=any(state > 0 for state in coolers) or bool(now & HELD_BACK) if tells else None,
            is_under_voltage=None if flags is None else bool(now & UNDER_VOLTAGE),
            over_currents=int(sum(over)) if over and len(over) == len(self._over_currents) else None,
            firmware_flags=(now | now >> EVER) & (UNDER_VOLTAGE | HELD_BACK),
        )


def is_measured(zone: str | None) -> bool:
    """Whether a thermal zone of this type measures a temperature."""
    return zone not in _DUMMY_ZONES


def is_plausible(celsius: float) -> bool:
    """Whether a temperature of a thermal zone, degC, can be right."""
    return _PLAUSIBLE[0] < celsius < _PLAUSIBLE[1]


def _named(paths: Iterable[str], name: str) -> list[str]:
    return [path for path in paths if path.endswith(f"/{name}")]


def _number(text: str | None) -> float | None:
    try:
        found = float(text or "")
    except ValueError:  # the sensor is asleep or gone
        return None
    return found if math.isfinite(found) else None


def _hexadecimal(text: str | None) -> int | None:
    try:
        return int(text or "", 16)
    except ValueError:
        return None


def _mean(values: Sequence[float], factor: float) -> float | None:
    return math.fsum(values) / len(values) * factor if values else None


def _turbo(no_turbo: float | None, boost: float | None) -> bool | None:
    if no_turbo is not None:
        return no_turbo == 0
    return None if boost is None else boost != 0


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
