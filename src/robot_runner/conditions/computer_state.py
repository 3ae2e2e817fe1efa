"""Conditions of a quantity of a computer above or below a limit: temperature, battery, load, clock offset."""

from __future__ import annotations

import re
from abc import abstractmethod
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.conditions.bounds import Bound, Quantity, Reading
from robot_runner.conditions.computers import ComputerName
from robot_runner.core.errors import ConditionError, Finding
from robot_runner.core.events.condition import Condition
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.links.declared_host import LOCAL

if TYPE_CHECKING:
    from robot_runner.measuring.local_host import LocalHost
    from robot_runner.measuring.ssh_host import SshHost

_PERCENT = 100.0
#: Linux has temperatures in thousandths of a degree.
_MILLI = 1e-3
#: Plausible values of a sensor, °C; beyond them it is broken or asleep.
_COLDEST, _HOTTEST = -55.0, 150.0


def temperature_below(
    limit: float, *, host: str = LOCAL, sensor: str | None = None, ssh_config: str | Path | None = None
) -> Condition:
    """Return the condition that a temperature of a computer is below a limit.

    Args:
        limit: in °C.
        host: the computer, as ssh takes it; left out, this machine.
        sensor: the type of a thermal zone, such as `cpu-thermal`, or a file that holds thousandths of a degree, such as
            that of a 1-wire thermometer; left out, the warmest of the computer's thermal zones.
        ssh_config: a file to take the place of the user's ssh config.

    Raises:
        ConditionError: the limit is not a finite number.
        LinkError: the host cannot be named so.

    Example:
        >>> print(temperature_below(50).held_for(30))
        the temperature of this machine is below 50 °C for 30 s
    """
    return Bound(_Temperature(ComputerName.named(host, ssh_config), sensor), limit, is_below=True)


def temperature_above(
    limit: float, *, host: str = LOCAL, sensor: str | None = None, ssh_config: str | Path | None = None
) -> Condition:
    """Return the condition that a temperature of a computer is above a limit; as `temperature_below`."""
    return Bound(_Temperature(ComputerName.named(host, ssh_config), sensor), limit, is_below=False)


def load_below(limit: float, *, host: str = LOCAL, ssh_config: str | Path | None = None) -> Condition:
    """Return the condition that the processor of a computer is less busy than this.

    Args:
        limit: the share of all cores that is busy between two looks, 0..100 %.
        host: the computer, as ssh takes it; left out, this machine.
        ssh_config: a file to take the place of the user's ssh config.

    Raises:
        ConditionError: the limit is not a finite number.
        LinkError: the host cannot be named so.

    Example:
        >>> print(load_below(10, host="pi@robot"))
        the load of pi@robot is below 10 %
    """
    return Bound(_Load(ComputerName.named(host, ssh_config)), limit, is_below=True)


def load_above(limit: float, *, host: str = LOCAL, ssh_config: str | Path | None = None) -> Condition:
    """Return the condition that the processor of a computer is busier than this; as `load_below`."""
    return Bound(_Load(ComputerName.named(host, ssh_config)), limit, is_below=False)


def clock_offset_below(limit: float, *, host: str, ssh_config: str | Path | None = None) -> Condition:
    """Return the condition that the clock of another computer shows the same time as this machine's.

    Args:
        limit: how far it may be ahead or behind, s; half of the shortest round trip is added to the measured offset.
        host: the computer, as ssh takes it.
        ssh_config: a file to take the place of the user's ssh config.

    Raises:
        ConditionError: the limit is not a finite number, or the computer is this machine.
        LinkError: the host cannot be named so.

    Example:
        >>> print(clock_offset_below(0.05, host="pi@robot"))
        the clock offset of pi@robot is below 0.05 s
    """
    if host == LOCAL:
        fix = "Name another computer."
        raise ConditionError("the clock of this machine is compared with itself", where="clock_offset_below", fix=fix)
    return Bound(_ClockOffset(ComputerName.named(host, ssh_config)), limit, is_below=True)


@dataclass(frozen=True)
class _OfComputer(Quantity):
    """A quantity of one computer."""

    computer: ComputerName

    is_outside = True
    what = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "every_s", self.computer.every_s)

    def __str__(self) -> str:
        return f"the {self.what} of {self.computer}"

    def check(self, robot: str | None) -> Iterable[Finding]:
        del robot
        yield from self.computer.check(str(self))

    def watch(self, context: RobotRunnerContext, opened: ExitStack) -> Callable[[], Reading]:
        del context
        return self.reader(self.computer.open(opened))

    @abstractmethod
    def reader(self, link: LocalHost | SshHost) -> Callable[[], Reading]:
        """Return what reads it; it may raise a LinkError."""


class _OfAMoment(_OfComputer):
    """A quantity of which no reading depends on the one before."""

    def reader(self, link: LocalHost | SshHost) -> Callable[[], Reading]:
        return partial(self.read, link)

    @abstractmethod
    def read(self, link: LocalHost | SshHost) -> Reading:
        """Return a reading; it may raise a LinkError."""


@dataclass(frozen=True)
class _Temperature(_OfAMoment):
    sensor: str | None = None

    what = "temperature"
    unit = "°C"
    low, high = _COLDEST, _HOTTEST

    def __str__(self) -> str:
        return super().__str__() if self.sensor is None else f"the temperature at {self.sensor} of {self.computer}"

    def read(self, link: LocalHost | SshHost) -> Reading:
        paths, kinds = self._sensors(link)
        texts = link.read_files(paths) if paths else []
        values = [int(text) * _MILLI for text in texts if text and re.fullmatch(r"-?\d+", text.strip())]
        plausible = [value for value in values if _COLDEST < value < _HOTTEST]
        there = f"; it has {', '.join(kinds)}" if kinds and self.sensor is not None else ""
        silent = f"{self.computer} does not report {'its temperature' if self.sensor is None else self.sensor}{there}"
        return max(plausible, default=silent)

    def _sensors(self, link: LocalHost | SshHost) -> tuple[list[str], list[str]]:
        """Return the files with the temperature, and the types of all zones."""
        if self.sensor is not None and "/" in self.sensor:
            return [self.sensor], []
        zones = link.list_files("/sys/class/thermal/thermal_zone*/temp")
        kinds = link.read_files([f"{path.removesuffix('temp')}type" for path in zones]) if zones else []
        if self.sensor is not None:
            zones = [path for path, kind in zip(zones, kinds, strict=True) if kind == self.sensor]
        elif not zones:  # many x86 computers have only hwmon
            zones = link.list_files("/sys/class/hwmon/hwmon*/temp*_input")
        return zones, sorted({kind for kind in kinds if kind})


@dataclass(frozen=True)
class _Load(_OfComputer):
    what = "load"
    unit = "%"
    low, high = 0.0, _PERCENT

    def reader(self, link: LocalHost | SshHost) -> Callable[[], Reading]:
        before: tuple[float, float] | None = None

        def read() -> Reading:
            nonlocal before
            now = _cpu_times(link.read_files(["/proc/stat"])[0])
            if now is None and self.computer.host == LOCAL:
                now = _psutil_times()
            if now is None:
                return f"{self.computer} does not report its load"
            then, before = before, now
            if then is None or now[0] <= then[0]:
                return "the second look tells"
            return _PERCENT * min(1.0, max(0.0, (now[1] - then[1]) / (now[0] - then[0])))

        return read


def _cpu_times(text: str | None) -> tuple[float, float] | None:
    """Return all and the busy time of the first line of /proc/stat, in ticks (proc_stat(5)); guests' is user time."""
    words = (text or "").split()
    if words[:1] != ["cpu"] or len(words) < 6 or not all(word.isdigit() for word in words[1:]):  # noqa: PLR2004 - to iowait
        return None
    times = [float(word) for word in words[1:9]]
    return sum(times), sum(times) - times[3] - times[4]


def _psutil_times() -> tuple[float, float] | None:
    if find_spec("psutil") is None:
        return None
    times = import_module("psutil").cpu_times()
    return sum(times), sum(times) - times.idle - getattr(times, "iowait", 0.0)


@dataclass(frozen=True)
class _ClockOffset(_OfAMoment):
    what = "clock offset"
    unit = "s"
    low = 0.0

    def read(self, link: LocalHost | SshHost) -> Reading:
        from robot_runner.measuring.ssh_host import SshHost  # noqa: PLC0415  # as its module is loaded late

        if not isinstance(link, SshHost):
            return "the clock of this machine is the one that is compared with"
        offset = link.clock_offset()
        return abs(offset.wall_offset) + offset.uncertainty


@dataclass(frozen=True)
class ComputerBattery(_OfAMoment):
    """The charge of the battery of a computer; of several, the lowest."""

    what = "battery"
    unit = "%"
    low, high = 0.0, _PERCENT
    _supplies: str = field(default="/sys/class/power_supply/*/capacity", repr=False)

    def read(self, link: LocalHost | SshHost) -> Reading:
        """Return the charge."""
        folders = [path.removesuffix("capacity") for path in link.list_files(self._supplies)]
        wanted = [f"{folder}{name}" for folder in folders for name in ("capacity", "scope")]
        texts = link.read_files(wanted) if wanted else []
        # The battery of a mouse has the scope "Device".
        charges = [
            float(charge)
            for charge, scope in zip(texts[::2], texts[1::2], strict=True)
            if charge and charge.isdigit() and scope != "Device"
        ]
        if not charges and self.computer.host == LOCAL:
            charges = _psutil_charge()
        return min(charges, default=f"{self.computer} reports no battery")


def _psutil_charge() -> list[float]:
    if find_spec("psutil") is None:
        return []
    battery = getattr(import_module("psutil"), "sensors_battery", lambda: None)()
    return [] if battery is None else [float(battery.percent)]
