"""The INA219 behind a driver of the Linux kernel: what its files in /sys are called and what they mean.

Sources: the kernel's Documentation/hwmon/ina2xx.rst and Documentation/hwmon/sysfs-interface.rst (mV, mA, µW, µΩ), and
Documentation/ABI/testing/sysfs-bus-iio with drivers/iio/adc/ina2xx-adc.c (raw x scale: mV, mW; the shunt in ohm).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from robot_runner.errors import LinkError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robot_runner.links.host import FileHost

__all__ = ["AUTO", "Reading", "SysfsSensor", "find_sensor"]

#: The name under which the one sensor of a computer is taken, wherever its driver put it.
AUTO = "auto"

#: Where the two drivers put their devices.
_PATTERNS = ("/sys/class/hwmon/hwmon*/name", "/sys/bus/iio/devices/iio:device*/name")
_CHIPS = ("ina219", "ina220", "ina226", "ina230", "ina231")

_HWMON = ("power1_input", "curr1_input", "in1_input")
_HWMON_SHUNT = "shunt_resistor"
_IIO = ("in_voltage0_raw", "in_voltage1_raw")
_IIO_SCALES = ("in_voltage0_scale", "in_voltage1_scale", "in_shunt_resistor")
_SHUNT_VOLT_SCALE, _BUS_VOLT_SCALE, _SHUNT = range(3)


class Reading(NamedTuple):
    """One sample in physical units."""

    current: float
    voltage: float
    power: float


@dataclass(frozen=True, slots=True)
class SysfsSensor:
    """One sensor as its driver shows it.

    Attributes:
        folder: its folder in /sys.
        chip: the sensor's type, such as `ina219`.
        driver: `hwmon` or `iio`.
        names: the files of one sample.
        shunt_ohm: resistance of the shunt that the driver was told of, ohm.
        scales: of an IIO device, mV a step: of the shunt's and of the bus voltage.

    Example:
        >>> sensor = SysfsSensor("/sys/class/hwmon/hwmon3", "ina219", "hwmon", _HWMON, 0.1)
        >>> sensor.read(("7600000", "613", "12400"), shunt_ohm=0.1)
        Reading(current=0.613, voltage=12.4, power=7.6)
    """

    folder: str
    chip: str
    driver: str
    names: tuple[str, ...]
    shunt_ohm: float
    scales: tuple[float, float] = (0.0, 0.0)

    @property
    def paths(self) -> list[str]:
        """The files to read for one sample, in order."""
        return [f"{self.folder}/{name}" for name in self.names]

    def read(self, lines: Sequence[str | None], *, shunt_ohm: float) -> Reading | None:
        """Return what the lines of `paths` say, or None where one is missing or no number."""
        try:
            numbers = [int(line) for line in lines if line is not None]
        except ValueError:
            return None
        if len(numbers) != len(self.names):
            return None
        return self._of_hwmon(numbers, shunt_ohm) if self.driver == "hwmon" else self._of_iio(numbers, shunt_ohm)

    def _of_hwmon(self, numbers: Sequence[int], shunt_ohm: float) -> Reading:
        # The driver reckoned with the shunt that it was told of.
        micro_watt, milli_ampere, milli_volt = numbers
        mended = self.shunt_ohm / shunt_ohm
        return Reading(milli_ampere * 1e-3 * mended, milli_volt * 1e-3, micro_watt * 1e-6 * mended)

    def _of_iio(self, numbers: Sequence[int], shunt_ohm: float) -> Reading:
        shunt_volt, bus_volt = (raw * scale * 1e-3 for raw, scale in zip(numbers, self.scales, strict=True))
        current = shunt_volt / shunt_ohm
        return Reading(current, bus_volt, current * bus_volt)


def find_sensor(host: FileHost, folder: str = AUTO, *, where: str) -> SysfsSensor:
    """Return the sensor in this folder of /sys, or the only one there is.

    Args:
        host: the computer that it is connected to.
        folder: such as `/sys/class/hwmon/hwmon3`, or `auto`.
        where: for errors: whose sensor it is.

    Raises:
        LinkError: there is no such sensor, there are several to choose from, or its driver says too little.
    """
    if folder != AUTO:
        return _open_sensor(host, folder.rstrip("/"), where)
    names = [path for pattern in _PATTERNS for path in host.list_files(pattern)]
    chips = zip(names, host.read_files(names), strict=True)
    folders = [path.removesuffix("/name") for path, chip in chips if chip in _CHIPS]
    if len(folders) == 1:
        return _open_sensor(host, folders[0], where)
    if folders:
        problem, fix = f"there are {len(folders)} sensors", f"Name one: sysfs={' or '.join(map(repr, folders))}."
    else:
        problem = "no driver in /sys shows an INA219"
        fix = "Load the driver ina2xx for it (docs/ina219.md), or name the sensor's folder: sysfs='/sys/...'."
    raise LinkError(problem, where=where, fix=fix)


def _open_sensor(host: FileHost, folder: str, where: str) -> SysfsSensor:
    paths = [f"{folder}/{name}" for name in ("name", *_HWMON, _HWMON_SHUNT, *_IIO, *_IIO_SCALES)]
    lines = dict(zip(paths, host.read_files(paths), strict=True))
    found = {path.rpartition("/")[2]: line for path, line in lines.items() if line is not None}
    chip = found.get("name", "")
    try:
        if found.keys() >= {*_HWMON, _HWMON_SHUNT}:
            return SysfsSensor(folder, chip, "hwmon", _HWMON, int(found[_HWMON_SHUNT]) * 1e-6)
        if found.keys() >= {*_IIO, *_IIO_SCALES}:
            scales = [float(found[name]) for name in _IIO_SCALES]
            pair = scales[_SHUNT_VOLT_SCALE], scales[_BUS_VOLT_SCALE]
            return SysfsSensor(folder, chip, "iio", _IIO, scales[_SHUNT], pair)
    except ValueError as error:
        raise LinkError(f"{folder}: {error}", where=where, fix="Look at the sensor's files there.") from error
    lacking = sorted({*_HWMON, _HWMON_SHUNT} - found.keys())
    problem = f"{folder} shows no INA219: it has no {', '.join(lacking)}" if found else f"there is nothing at {folder}"
    raise LinkError(problem, where=where, fix="Name the sensor's folder, or leave it to sysfs='auto'.")
