"""Frequency, temperature and throttling of a computer's processor at one moment, from Linux' /sys."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

_KILO, _MILLI = 1e3, 1e-3
#: Zones with other temperatures, in degC, are asleep or broken; a sleeping GPU shows -256.
_PLAUSIBLE = (-40.0, 150.0)
#: Zones that measure nothing: NVIDIA's Jetsons always show 100 degC there (balena-os/balena-jetson, issue 142).
_DUMMY_ZONES = ("PMIC-Die",)
#: The drivers of AMD's processors, whose temperature is in hwmon and no zone (Linux, Documentation/hwmon/k10temp.rst).
_NO_ZONES = ("k10temp", "zenpower")
#: Cooling devices that throttle the processor, as they are called in newer and older kernels; the others are fans and
#: the like. intel_powerclamp says -1 while it does nothing (drivers/thermal/cpu*_cooling.c, intel/intel_powerclamp.c).
_COOLERS = ("Processor", "cpufreq", "thermal-cpufreq", "idle-", "cpuidle", "thermal-idle", "intel_powerclamp")
#: The firmware of a Raspberry Pi (raspberrypi/linux, pull request 2397), in hexadecimal: bit 0 is under-voltage; bits
#: 1 to 3 are a capped frequency, throttling and the soft temperature limit; 16 bits higher, the same since the start,
#: or within two seconds where the driver of its voltage sensor asks (drivers/hwmon/raspberrypi-hwmon.c), as it does in
#: Raspberry Pi OS. On a Raspberry Pi 5 it is `soc@107c000000` (bcm2712.dtsi).
_FIRMWARE = "/sys/devices/platform/soc*/soc*:firmware/get_throttled"
UNDER_VOLTAGE, HELD_BACK, _EVER = 0b0001, 0b1110, 16
#: How often a Jetson was throttled as it drew too much current, or its voltage fell, since it started. Source: NVIDIA,
#: Jetson Linux Developer Guide, Platform Power and Performance.
_OVER_CURRENTS = "/sys/class/hwmon/hwmon*/oc[0-9]_event_cnt"
_CPU = "/sys/devices/system/cpu"
#: 1 switches turbo off in the first (Intel), and on in the second (the others): Linux, admin-guide/pm.
_NO_TURBO, _BOOST = f"{_CPU}/intel_pstate/no_turbo", f"{_CPU}/cpufreq/boost"


class Files(Protocol):
    """A computer whose files can be read: this one, or another over ssh, of whose files only the first line is read."""

    def list_files(self, pattern: str) -> list[str]:
        """Return the paths that match a pattern of the shell, sorted."""

    def read_files(self, paths: Sequence[str]) -> Sequence[str | None]:
        """Return the content of each file; None for one that cannot be read."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """The conditions of a processor at one moment; None for what the computer does not show.

    Attributes:
        governors: which choose the frequency, without repetitions; empty where they are unknown.
        is_turbo: whether it may exceed its nominal frequency.
        frequency: mean over the cores, Hz.
        core_frequencies: of each core, Hz, in the order of their numbers; None for a core without one.
        limit: the highest frequency that is allowed, mean over the cores, Hz.
        temperature: of the hottest zone, degC.
        silent_zones: how many zones show no temperature.
        throttle_counts: how often each core, and its package, was throttled for heat since the computer started; each
            core has a counter of its package. None where there are no such counters, or one cannot be read.
        over_currents: how often a Jetson was throttled for its current or its voltage since it started; None where that
            is not counted, or a counter cannot be read.
        throttlings: the sum of all counters of throttling; None where there is none, or one cannot be read.
        is_held_back: whether the kernel or the firmware throttles it now.
        is_under_voltage: whether the supply voltage is too low now.
        happened: a Raspberry Pi's flags of what has happened since it started, or within two seconds.
        firmware_flags: its flags of what is happening now or has happened; 0 without such firmware.
    """

    governors: tuple[str, ...] = ()
    is_turbo: bool | None = None
    frequency: float | None = None
    core_frequencies: tuple[float | None, ...] = ()
    limit: float | None = None
    temperature: float | None = None
    silent_zones: int = 0
    throttle_counts: tuple[int, ...] | None = None
    over_currents: int | None = None
    throttlings: int | None = None
    is_held_back: bool | None = None
    is_under_voltage: bool | None = None
    happened: int | None = None
    firmware_flags: int = 0


class ProcessorFiles:
    """The files with the conditions of a processor; found once, read several times.

    Args:
        files: the computer.
        zones: the types of the thermal zones; None for all that measure something.

    Attributes:
        zone_types: the type of each zone, by the file of its temperature.
        temperatures, frequencies: the files of the chosen zones, and of the cores.
        settings: the files of governors, turbo and the limits of the frequency.
    """

    def __init__(self, files: Files, zones: Sequence[str] | None = None) -> None:
        # Of each core, even if several share a clock, like the small and the large ones of many boards.
        clocks = files.list_files(f"{_CPU}/cpu[0-9]*/cpufreq/scaling_*")
        thermal = files.list_files("/sys/class/thermal/*/*")
        types, names = _named(thermal, "type"), files.list_files("/sys/class/hwmon/hwmon*/name")
        told = iter(files.read_files([*types, *names]) if types or names else ())
        kinds = {path.removesuffix("type"): next(told) or "" for path in types}
        chips = {path.removesuffix("name"): next(told) or "" for path in names}
        self.zone_types = {f"{zone}temp": kind for zone, kind in kinds.items() if "thermal_zone" in zone}
        self.zone_types |= {f"{folder}temp1_input": chip for folder, chip in chips.items() if chip in _NO_ZONES}
        self.temperatures = [
            path
            for path, kind in self.zone_types.items()
            if (kind not in _DUMMY_ZONES if zones is None else kind in zones)
        ]
        self.frequencies = sorted(_named(clocks, "scaling_cur_freq"), key=core_number)
        self._counters = files.list_files(f"{_CPU}/cpu[0-9]*/thermal_throttle/*_throttle_count")
        self._over_currents = files.list_files(_OVER_CURRENTS)
        self._coolers = [
            f"{device}cur_state"
            for device, kind in kinds.items()
            if "cooling_device" in device and kind.startswith(_COOLERS)
        ]
        self._firmware = files.list_files(_FIRMWARE)
        self._governors, self._limits = _named(clocks, "scaling_governor"), _named(clocks, "scaling_max_freq")
        self.settings = [_NO_TURBO, _BOOST, *self._governors, *self._limits]

    @property
    def counters(self) -> list[str]:
        """The files that count throttling."""
        return [*self._counters, *self._over_currents]

    @property
    def changing(self) -> list[str]:
        """The files whose contents change by themselves."""
        return [*self.temperatures, *self.frequencies, *self.counters, *self._coolers, *self._firmware]

    @property
    def has_firmware(self) -> bool:
        """Whether there is a Raspberry Pi's firmware, whose flags may be taken back after two seconds."""
        return bool(self._firmware)

    @property
    def tells_of_throttling(self) -> bool:
        """Whether throttling is counted, or shown while it lasts."""
        return bool(self.counters or self._coolers or self._firmware)

    def conditions(self, texts: Mapping[str, str | None]) -> Conditions:
        """Return the conditions from the contents of `changing`, and of `settings` where these were read."""

        def numbers(paths: Iterable[str]) -> list[float | None]:
            return [_number(texts.get(path)) for path in paths]

        celsius = list(map(temperature_of, map(texts.get, self.temperatures)))
        warm = [each for each in celsius if each is not None]
        clocks = [each * _KILO if each else None for each in numbers(self.frequencies)]
        counts, over = _counted(numbers(self._counters)), _counted(numbers(self._over_currents))
        is_counted = bool(self.counters) and None not in numbers(self.counters)
        coolers = [each for each in numbers(self._coolers) if each is not None]
        flags = next((_hexadecimal(texts.get(path)) for path in self._firmware), None)
        tells, now = bool(coolers) or flags is not None, flags or 0
        return Conditions(
            governors=tuple(dict.fromkeys(text for path in self._governors if (text := texts.get(path)))),
            is_turbo=_turbo(*numbers((_NO_TURBO, _BOOST))),
            frequency=_mean(clocks),
            core_frequencies=tuple(clocks),
            limit=_mean([None if each is None else each * _KILO for each in numbers(self._limits)]),
            temperature=max(warm, default=None),
            silent_zones=len(celsius) - len(warm),
            throttle_counts=counts,
            over_currents=None if over is None else sum(over),
            throttlings=sum((*(counts or ()), *(over or ()))) if is_counted else None,
            is_held_back=any(state > 0 for state in coolers) or bool(now & HELD_BACK) if tells else None,
            is_under_voltage=None if flags is None else bool(now & UNDER_VOLTAGE),
            happened=None if flags is None else flags >> _EVER,
            firmware_flags=(now | now >> _EVER) & (UNDER_VOLTAGE | HELD_BACK),
        )


def core_number(path: str) -> int:
    """Return the number of the core that a file is about.

    Example:
        >>> core_number("/sys/devices/system/cpu/cpu12/cpufreq/scaling_cur_freq")
        12
    """
    found = re.search(r"/cpu(\d+)/", path)
    return int(found[1]) if found else -1


def temperature_of(text: str | None) -> float | None:
    """Return the temperature in the content of a zone's file, degC; None if it is asleep, gone or broken."""
    number = _number(text)
    celsius = math.nan if number is None else number * _MILLI
    return celsius if _PLAUSIBLE[0] < celsius < _PLAUSIBLE[1] else None


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


def _counted(numbers: Sequence[float | None]) -> tuple[int, ...] | None:
    known = tuple(int(each) for each in numbers if each is not None)
    return known if known and len(known) == len(numbers) else None


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return math.fsum(known) / len(known) if known else None


def _turbo(no_turbo: float | None, boost: float | None) -> bool | None:
    if no_turbo is not None:
        return no_turbo == 0
    return None if boost is None else boost != 0
