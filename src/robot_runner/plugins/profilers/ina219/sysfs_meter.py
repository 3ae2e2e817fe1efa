"""The meter behind a driver of the Linux kernel, on this machine or on the robot's computer."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING, Any

from robot_runner.links.host import ReportingSampler
from robot_runner.plugins.profilers.ina219.evaluation import Evaluation
from robot_runner.plugins.profilers.ina219.sysfs import find_sensor
from robot_runner.plugins.sampling.quality import quality_of
from robot_runner.plugins.sampling.raw_files import Column
from robot_runner.plugins.sampling.series import Series
from robot_runner.plugins.sampling.window import Window

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robot_runner.events.clock import Clock
    from robot_runner.links.host import FileHost, FileSampler, SamplingReport
    from robot_runner.plugins.profilers.ina219.sysfs import SysfsSensor

__all__ = ["DEFAULT_SYSFS_RATE", "SysfsMeter"]

#: Hz; each sample is two or three transfers on the sensor's bus, made by the kernel while the reader waits.
DEFAULT_SYSFS_RATE = 50.0

_SETTLE = "tell the driver of the shunt (docs/ina219.md)"


class SysfsMeter:
    """Reads the driver's files at a rate.

    Args:
        host: the computer that the sensor is connected to.
        clock: the run's.
        folder: the sensor's in /sys, or `auto`.
        shunt_ohm: resistance of the shunt, ohm; None takes what the driver says.
        rate_hz: Hz; None for 50.
        where: for errors: whose sensor it is.

    Raises:
        LinkError: there is no such sensor.
    """

    has_samples_at_once = True

    def __init__(
        self,
        host: FileHost,
        clock: Clock,
        *,
        folder: str,
        shunt_ohm: float | None,
        rate_hz: float | None,
        where: str,
    ) -> None:
        self._host = host
        self._clock = clock
        self._rate = rate_hz or DEFAULT_SYSFS_RATE
        self._sensor = find_sensor(host, folder, where=where)
        self._shunt_ohm = shunt_ohm or self._sensor.shunt_ohm
        self._sampler: FileSampler | None = None
        self._start = clock.now()
        self._window: Window | None = None

    def begin(self) -> None:
        """Begin to sample."""
        self._sampler = self._host.sample_files(self._rate, self._sensor.paths)
        self._start = self._clock.now()

    def end(self) -> None:
        """End sampling; a second call does nothing."""
        if self._window is None:
            self._window = Window(self._start, self._clock.now())
            if self._sampler is not None:
                self._sampler.stop()

    def evaluate(self) -> Evaluation:
        """Return what was measured; samples that could not be read are left out and counted."""
        samples = self._sampler.stop() if self._sampler is not None else ()
        readings = [(each.time, self._sensor.read(each.lines, shunt_ohm=self._shunt_ohm)) for each in samples]
        good = [(time, reading) for time, reading in readings if reading is not None]
        times = array("d", [time for time, _ in good])
        window = self._window or Window(self._start, self._clock.now())
        failed = len(readings) - len(good)
        report = self._report()
        return Evaluation(
            window=window,
            power=Series(times, array("d", [reading.power for _, reading in good])),
            quality=quality_of(
                times,
                window,
                report.rate if report else self._rate,
                failed=failed,
                first_failure="a file of the driver could not be read" if failed else "",
                cpu_seconds=report.cpu_seconds if report else None,
                clock_uncertainty=report.clock.uncertainty if report and report.clock else None,
            ),
            columns=_columns([reading.current for _, reading in good], [reading.voltage for _, reading in good]),
            details=self._details(report),
            doubts=self._doubts(report),
        )

    def _report(self) -> SamplingReport | None:
        return self._sampler.report() if isinstance(self._sampler, ReportingSampler) else None

    def _details(self, report: SamplingReport | None) -> dict[str, Any]:
        return {
            "shunt_ohm": self._shunt_ohm,
            "rate_hz": report.rate if report else self._rate,
            "sensor": _facts(self._sensor),
            "form": report.form if report else "",
        }

    def _doubts(self, report: SamplingReport | None) -> tuple[str, ...]:
        told, used = self._sensor.shunt_ohm, self._shunt_ohm
        contradiction = f"the driver was told of a shunt of {told:g} ohm, not {used:g} ohm: {_SETTLE}"
        doubts = [contradiction] if abs(told - used) > 0.001 * used else []
        return (*doubts, *(report.problems if report else ()))


def _columns(current: Sequence[float], voltage: Sequence[float]) -> tuple[Column, ...]:
    return Column("current_A", current), Column("voltage_V", voltage, "%.3f")


def _facts(sensor: SysfsSensor) -> dict[str, Any]:
    return {"folder": sensor.folder, "chip": sensor.chip, "driver": sensor.driver, "shunt_ohm": sensor.shunt_ohm}
