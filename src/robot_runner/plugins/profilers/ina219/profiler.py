"""The profiler that measures power and energy with an INA219 sensor."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from robot_runner.errors import Finding, LinkError, PluginError
from robot_runner.events.measure import Measure, Origin
from robot_runner.links.connect import connect_host, open_serial_line
from robot_runner.links.host import LOCAL, FileHost
from robot_runner.plugins.api.plugin import Profiler
from robot_runner.plugins.profilers.ina219.card_meter import CardMeter
from robot_runner.plugins.profilers.ina219.checks import Way, way_findings
from robot_runner.plugins.profilers.ina219.line_meter import LineMeter
from robot_runner.plugins.profilers.ina219.registers import DEFAULT_RATE
from robot_runner.plugins.profilers.ina219.sysfs_meter import DEFAULT_SYSFS_RATE, SysfsMeter

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from robot_runner.events.context import RobotRunnerContext
    from robot_runner.plugins.api.plugin import Circumstances
    from robot_runner.plugins.profilers.ina219.evaluation import Evaluation
    from robot_runner.plugins.profilers.ina219.meter import Meter

__all__ = ["Ina219"]

_REMEDY = "Look at the sensor, its cable and samples.csv before you use this run."
#: What one row of samples.csv takes, and how long a mission is taken to be where nobody knows: the paper's, s.
_BYTES_PER_ROW, _USUAL_SECONDS = 55, 95


class Ina219(Profiler):
    """Measures the power that the robot draws from its battery, and the energy over the measured window.

    A microcontroller on board reads a Texas Instruments INA219 and sends its registers up a serial line, as
    `docs/ina219-protocol.md` says. Nothing is computed while the mission goes on: the line keeps what arrives. The same
    microcontroller may record on an SD card instead, and the sensor may be connected to a Linux computer's own bus.

    Args:
        name: tells several meters apart; the class's name if left out.
        port: the serial port of a meter, or a URL of pyserial's such as `rfc2217://robot.local:4000`.
        card: the file that is copied from a meter's card after each mission.
        card_patience_s: how long to wait for that file at the end of a run, s.
        sysfs: the folder of a kernel driver, such as `/sys/class/hwmon/hwmon3`, or `auto` for the only sensor there is.
        host: the computer whose driver that is: `localhost`, or as ssh takes it (`pi@robot`).
        ssh_config: a file to take the place of your ssh config.
        shunt_ohm: resistance of the shunt, ohm; None takes what the meter says (0.1 ohm if it says nothing).
        rate_hz: nominal rate of sampling, Hz; None takes what the meter says (200 Hz if it says nothing; a driver: 50).
        namespace: whose meter it is, on several simulated robots.

    Raises:
        PluginError: the shunt or the rate is not positive, or two ways to the sensor are named.

    Example:
        >>> Ina219(port="/dev/ttyUSB0", shunt_ohm=0.05).measures[0].unit
        'J'
    """

    measures: Sequence[Measure] = (
        Measure("Energy", "J", "Energy drawn over the measured window: the integral of power by the trapezoid rule."),
        Measure("EnergyPt", "J", "The paper's E = P x t: the mean of the power samples times the window's duration."),
        Measure("MeanPower", "W", "Mean power over the measured window: Energy divided by its duration."),
    )
    needs: ClassVar[str] = "An INA219 on a serial line, a card or a kernel driver, or robot='simulated'."

    def __init__(  # noqa: PLR0913 - three ways to one sensor
        self,
        *,
        name: str | None = None,
        port: str | None = None,
        card: str | None = None,
        card_patience_s: float = 0.0,
        sysfs: str | None = None,
        host: str = LOCAL,
        ssh_config: str | Path | None = None,
        shunt_ohm: float | None = None,
        rate_hz: float | None = None,
        namespace: str = "",
    ) -> None:
        super().__init__(name=name)
        for parameter, value in (("shunt_ohm", shunt_ohm), ("rate_hz", rate_hz)):
            if value is not None and not value > 0:
                raise PluginError(
                    f"{parameter} is {value!r}",
                    where=self.name,
                    fix=f"Give {parameter} a number above 0, or leave it out.",
                )
        config = None if ssh_config is None else Path(ssh_config).expanduser()
        self.way = Way(port=port, card=card, sysfs=sysfs, host=host, ssh_config=config, namespace=namespace)
        if len(self.way.given) > 1:
            named = " and ".join(self.way.given)
            raise PluginError(f"both {named} are named", where=self.name, fix="Name one way to the sensor.")
        self.card_patience_s = card_patience_s
        self.shunt_ohm = shunt_ohm
        self.rate_hz = rate_hz
        rate = rate_hz or (DEFAULT_RATE if sysfs is None else DEFAULT_SYSFS_RATE)
        self.bytes_per_run = round(rate * _USUAL_SECONDS * _BYTES_PER_ROW)
        self._meter: Meter | None = None
        self._evaluation: Evaluation | None = None

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return what stands in the way: no meter, a port that cannot be opened, or two profilers on one line."""
        yield from way_findings(self._where, self.way, circumstances.robot)
        yield from self._clashes(circumstances)

    def start_measurement(self, context: RobotRunnerContext) -> None:
        """Open the way to the sensor and begin the measured window.

        Raises:
            LinkError: the sensor cannot be reached.
        """
        self._meter = self._evaluation = None
        meter = self._open_meter(context)
        meter.begin()
        self._meter = meter

    def stop_measurement(self, context: RobotRunnerContext) -> None:
        """End the measured window and take what the line has kept.

        Raises:
            LinkError: the sensor was lost meanwhile; the samples until then are kept all the same.
        """
        del context
        if self._meter is not None:
            self._meter.end()

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Write the raw samples: later than `stop_measurement`, so that other profilers need not wait for the disk."""
        if self._meter is not None and self._meter.has_samples_at_once:
            self._evaluate(self._meter, context)

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish energy and mean power; no value where too little was seen.

        Raises:
            LinkError: the file from the meter's card did not come, or is not what was expected.
        """
        if self._meter is None:
            context.warn("nothing was measured: the measurement was never started", fix=_REMEDY)
            for measure in self.measures:
                context.publish(measure.name, None)
            return
        evaluation = self._evaluate(self._meter, context)
        for problem in evaluation.warnings():
            context.warn(problem, fix=_REMEDY)
        origin = Origin.SIMULATED if evaluation.is_simulated else Origin.MEASURED
        for name, value in evaluation.values().items():
            context.publish(name, value, origin=origin)

    @property
    def _where(self) -> str:
        return f"plugin {self.name}"

    def _evaluate(self, meter: Meter, context: RobotRunnerContext) -> Evaluation:
        if self._evaluation is None:
            self._evaluation = meter.evaluate()
            self._evaluation.write(context.raw_data_folder)
        return self._evaluation

    def _open_meter(self, context: RobotRunnerContext) -> Meter:
        way, clock, shunt, rate = self.way, context.clock, self.shunt_ohm, self.rate_hz
        if way.card is not None:
            return CardMeter(way.card, clock, patience=self.card_patience_s, shunt_ohm=shunt, rate_hz=rate)
        if way.sysfs is not None:
            host = connect_host(context, way.host, ssh_config=way.ssh_config)
            if not isinstance(host, FileHost):
                fix = f"Leave host out, or name another one than {way.host!r}."
                raise LinkError("files of this computer cannot be read", where=self._where, fix=fix)
            return SysfsMeter(host, clock, folder=way.sysfs, shunt_ohm=shunt, rate_hz=rate, where=self._where)
        line = open_serial_line(context, way.port, namespace=way.namespace)
        return LineMeter(line, clock, shunt_ohm=shunt, rate_hz=rate)

    def _clashes(self, circumstances: Circumstances) -> Iterator[Finding]:
        """Yield those that come before this one and would take the samples away from it, or it from them."""
        for other in circumstances.plugins:
            if other is self:
                return
            if isinstance(other, Ina219) and self.way.clashes_with(other.way):
                problem = f"it would share one line with plugin {other.name}, and each would get some of the samples"
                yield Finding.error(self._where, problem, "Give each a port of its own, or leave one of them out.")
