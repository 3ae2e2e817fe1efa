"""The meter behind a driver of the Linux kernel, on this machine or on the robot's computer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import Clock
from robot_runner.measuring.periodic import HostSampler
from robot_runner.measuring.quality import Column
from robot_runner.meters.ina219.doubts import stuck_doubts, voltage_doubts
from robot_runner.meters.ina219.registers import Evaluation

if TYPE_CHECKING:
    from robot_runner.core.events.window import Window
    from robot_runner.measuring.host import FileHost, SamplingReport

#: Stands for the folder of a computer's only sensor.
AUTO = "auto"

#: The devices of the two drivers.
_PATTERNS = ("/sys/class/hwmon/hwmon*/name", "/sys/bus/iio/devices/iio:device*/name")
#: The largest voltage at the shunt, V, by the chips' data sheets; the drivers leave the INA219's gain at 1/8. For the
#: others it is the register's last step, 32767 x 2.5 uV (SBOS547A, shunt voltage register).
SHUNT_RANGES = {"ina219": 0.32, "ina220": 0.32, "ina226": 0.0819175, "ina230": 0.0819175, "ina231": 0.0819175}
_CHIPS = tuple(SHUNT_RANGES)
_OTHERS = "For another sensor, such as an INA3221 or INA238, use the profiler PowerRails."

_HWMON = ("power1_input", "curr1_input", "in1_input")
_HWMON_SHUNT = "shunt_resistor"
_IIO = ("in_voltage0_raw", "in_voltage1_raw")
_IIO_SCALES = ("in_voltage0_scale", "in_voltage1_scale", "in_shunt_resistor")


class Reading(NamedTuple):
    """One sample in physical units."""

    current: float
    voltage: float
    power: float


@dataclass(frozen=True, slots=True)
class SysfsSensor:
    """One sensor and the files of its driver.

    Attributes:
        folder: its folder in /sys.
        chip: the sensor's type, such as `ina219`.
        driver: `hwmon` or `iio`.
        names: the files of one sample.
        shunt_ohm: resistance of the shunt in the driver's settings, ohm.
        scales: of an IIO device, mV a step, for the voltages of shunt and bus.

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
        """Return a reading from the lines of `paths`, or None if one is missing or no number."""
        try:
            numbers = [int(line) for line in lines if line is not None]
        except ValueError:
            return None
        if len(numbers) != len(self.names):
            return None
        return self._of_hwmon(numbers, shunt_ohm) if self.driver == "hwmon" else self._of_iio(numbers, shunt_ohm)

    def _of_hwmon(self, numbers: Sequence[int], shunt_ohm: float) -> Reading:
        # The driver computes with the shunt in its settings.
        micro_watt, milli_ampere, milli_volt = numbers
        mended = self.shunt_ohm / shunt_ohm
        current, voltage = milli_ampere * 1e-3 * mended, milli_volt * 1e-3
        # The chip's power register has no sign, its current register has one (Linux, drivers/hwmon/ina2xx.c).
        return Reading(current, voltage, current * voltage if current < 0 else micro_watt * 1e-6 * mended)

    def _of_iio(self, numbers: Sequence[int], shunt_ohm: float) -> Reading:
        shunt_volt, bus_volt = (raw * scale * 1e-3 for raw, scale in zip(numbers, self.scales, strict=True))
        current = shunt_volt / shunt_ohm
        return Reading(current, bus_volt, current * bus_volt)


def find_sensor(host: FileHost, folder: str = AUTO, *, where: str) -> SysfsSensor:
    """Return the sensor in this folder of /sys, or the only one.

    Args:
        host: the computer that it is connected to.
        folder: such as `/sys/class/hwmon/hwmon3`, or `auto`.
        where: for errors: whose sensor it is.

    Raises:
        LinkError: there is no such sensor, there are several to choose from, or its driver lacks a file.
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
        fix = f"Load the driver ina2xx for it (docs/ina219.md), or name its folder: sysfs='/sys/...'. {_OTHERS}"
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
            shunt_scale, bus_scale, shunt_ohm = (float(found[name]) for name in _IIO_SCALES)
            return SysfsSensor(folder, chip, "iio", _IIO, shunt_ohm, (shunt_scale, bus_scale))
    except ValueError as error:
        raise LinkError(f"{folder}: {error}", where=where, fix="Look at the sensor's files there.") from error
    lacking = sorted({*_HWMON, _HWMON_SHUNT} - found.keys())
    problem = f"{folder} shows no INA219: it has no {', '.join(lacking)}" if found else f"there is nothing at {folder}"
    fix = f"Name the sensor's folder, or leave it to sysfs='auto'. {_OTHERS}"
    raise LinkError(problem, where=where, fix=fix)


#: Hz; each sample is two or three transfers on the sensor's bus, made by the kernel while the reader waits.
DEFAULT_SYSFS_RATE = 50.0

_SETTLE = "tell the driver of the shunt (docs/ina219.md)"


class SysfsMeter:
    """Reads the driver's files periodically.

    Args:
        host: the computer that the sensor is connected to.
        clock: the run's.
        folder: the sensor's in /sys, or `auto`.
        shunt_ohm: resistance of the shunt, ohm; None takes the driver's.
        rate_hz: Hz; None for 50.
        where: for errors: whose sensor it is.

    Raises:
        LinkError: there is no such sensor.
    """

    has_samples_at_once = True

    def __init__(
        self, host: FileHost, clock: Clock, *, folder: str, shunt_ohm: float | None, rate_hz: float | None, where: str
    ) -> None:
        self._rate = rate_hz or DEFAULT_SYSFS_RATE
        self._sensor = find_sensor(host, folder, where=where)
        self._shunt_ohm = shunt_ohm or self._sensor.shunt_ohm
        self._sampler = HostSampler(host, self._sensor.paths, self._read, rate=self._rate, clock=clock)

    def begin(self) -> None:
        """Start sampling."""
        self._sampler.start()

    def latest_power(self) -> float | None:
        """Return the power of the last sample, W; None if there is none: another computer sends them at the end."""
        reading = self._sampler.latest()
        return None if reading is None else reading.power

    def end(self) -> None:
        """End sampling; a second call does nothing."""
        self._sampler.stop()

    def evaluate(self, window: Window | None, part: Window | None = None) -> Evaluation:
        """Return the evaluated samples of a window; those that could not be read are left out and counted."""
        sampled = self._sampler.stop()
        measured = sampled.over(part or window or sampled.window)
        seen, report = measured.within().readings, self._sampler.report()
        return Evaluation(
            window=measured.window,
            power=measured.series(lambda reading: reading.power),
            quality=measured.quality(
                saturated=sum(self._is_clipped(reading) for reading in seen),
                clock_uncertainty=report.clock.uncertainty if report.clock else None,
            ),
            columns=(
                Column("current_A", [reading.current for reading in sampled.readings]),
                Column("voltage_V", [reading.voltage for reading in sampled.readings], "%.3f"),
            ),
            details={
                "shunt_ohm": self._shunt_ohm,
                "rate_hz": report.rate,
                "sensor": {name: getattr(self._sensor, name) for name in ("folder", "chip", "driver", "shunt_ohm")},
                "form": report.form,
                "host_clock": report.clock_facts,
            },
            doubts=(
                *self._doubts(report),
                *voltage_doubts([reading.voltage for reading in seen]),
                *stuck_doubts(seen, measured.window.duration, len(seen)),
            ),
            sampled=sampled.window,
        )

    def _read(self, lines: Sequence[str | None]) -> Reading:
        reading = self._sensor.read(lines, shunt_ohm=self._shunt_ohm)
        if reading is None:
            raise ValueError("a file of the driver could not be read")
        return reading

    def _is_clipped(self, reading: Reading) -> bool:
        """Whether a reading is at the end of the shunt's range, up to half a step of hwmon (1 mA)."""
        largest = SHUNT_RANGES.get(self._sensor.chip)
        return largest is not None and (abs(reading.current) + 0.0005) * self._shunt_ohm >= largest

    def _doubts(self, report: SamplingReport) -> tuple[str, ...]:
        told, used = self._sensor.shunt_ohm, self._shunt_ohm
        contradiction = f"the driver was told of a shunt of {told:g} ohm, not {used:g} ohm: {_SETTLE}"
        doubts = [contradiction] if abs(told - used) > 0.001 * used else []
        return (*doubts, *report.problems)
