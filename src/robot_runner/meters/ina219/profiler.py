"""The profiler of power and energy with an INA219 sensor."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from robot_runner.core.errors import Finding, LinkError, PluginError
from robot_runner.core.events.context import RobotRunnerContext, SystemClock
from robot_runner.core.events.measure import Measure, Origin, Over
from robot_runner.core.events.window import Window
from robot_runner.core.links.connect import SIMULATED, is_simulated
from robot_runner.core.links.declared_host import LOCAL
from robot_runner.core.links.ssh_command import ssh_findings
from robot_runner.core.plugin import Circumstances, Profiler, probe_window
from robot_runner.measuring.devices import connect_host, open_serial_line
from robot_runner.measuring.evaluation import NEVER_STARTED, publish_measures
from robot_runner.measuring.host import FileHost
from robot_runner.measuring.live_samples import LiveSamples
from robot_runner.measuring.parameter_checks import check_numbers
from robot_runner.measuring.periodic import PeriodicSampler
from robot_runner.measuring.quality import Column
from robot_runner.measuring.serial_line import found_ports, port_problem
from robot_runner.meters.ina219.card import CardMeter
from robot_runner.meters.ina219.frames import FIRST_SENSOR
from robot_runner.meters.ina219.line_meter import LineMeter, Meter, PromptMeter, SharedLine
from robot_runner.meters.ina219.registers import DEFAULT_RATE, Evaluation
from robot_runner.meters.ina219.sysfs import DEFAULT_SYSFS_RATE, SysfsMeter, find_sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Way:
    """The connection of a profiler to its sensor: the one of the three that is not None, else the simulated robot's.

    Attributes:
        port: the serial port of a meter.
        card: the file copied from a meter's card.
        sysfs: the folder of a kernel driver, or `auto`.
        host: the computer with the driver.
        ssh_config: a file that replaces the user's ssh config.
        address: of the sensor on the meter's bus, if the meter has several.
        namespace: of the robot with the simulated meter.

    Example:
        >>> Way(port="/dev/ttyUSB0").clashes_with(Way(port="/dev/ttyUSB0", namespace="/alice"))
        True
    """

    port: str | None = None
    card: str | None = None
    sysfs: str | None = None
    host: str = LOCAL
    ssh_config: Path | None = None
    address: int | None = None
    namespace: str = ""

    @property
    def claims(self) -> tuple[str, ...]:
        """The claims of a run that reads the sensor over this connection."""
        if self.port is not None:
            return (f"serial:{self.port}",)
        if self.card is not None:
            return (f"device:{self.card}",)
        return (f"host:{self.host}",) if self.sysfs is not None else ()

    @property
    def given(self) -> dict[str, str]:
        """The parameters that name a real sensor."""
        named = {"port": self.port, "card": self.card, "sysfs": self.sysfs}
        return {name: value for name, value in named.items() if value is not None}

    def clashes_with(self, other: Way) -> bool:
        """Whether both would read the same sensor from one line or one file."""
        return self.sysfs is None and self._source == other._source

    @property
    def _source(self) -> tuple[str, str, int | None]:
        if self.port is not None:
            # Several links, such as those of /dev/serial/by-id, may lead to one device.
            return "port", os.path.realpath(self.port), self.address
        if self.card is not None:
            return "card", os.path.realpath(self.card), self.address
        if self.sysfs is not None:
            return f"sysfs {self.host}", self.sysfs, None
        return "the meter of the simulated robot", self.namespace.strip("/"), None


def way_findings(where: str, way: Way, robot: str | None) -> Iterator[Finding]:
    """Yield findings on why this sensor cannot be read, without opening anything.

    Args:
        where: the plugin.
        way: to the sensor.
        robot: how the robot is reached, or None.
    """
    if is_simulated(robot):
        for name, value in way.given.items():
            problem = f"{name} is {value!r}, and a simulated robot has a power meter of its own"
            yield Finding.error(where, problem, f"Leave {name} out, or execute it on a real robot.")
        if way.address is not None:
            problem = f"address is {way.address:#x}, and the power meter of a simulated robot has one sensor"
            yield Finding.error(where, problem, "Leave address out, or execute it on a real robot.")
    elif not way.given:
        port = (found_ports() or ["/dev/ttyUSB0"])[-1]
        fix = f"Name its serial port, as in Ina219(port={port!r}). Or: --set robot={SIMULATED}."
        yield Finding.error(where, "nothing says where the power meter is", fix)
    elif way.port is not None:
        yield from _found(where, port_problem(way.port))
    elif way.card is not None:
        if (card := Path(way.card).expanduser()).is_dir():
            yield Finding.error(where, f"card is {str(card)!r}, a folder", "Name the file, such as INA219.BIN in it.")
    elif way.sysfs is not None and way.host != LOCAL:
        yield from ssh_findings(where, way.host, config=way.ssh_config)
    elif way.sysfs is not None:
        yield from _sysfs_findings(where, way.sysfs)


def _found(where: str, problem: LinkError | None) -> list[Finding]:
    return [] if problem is None else [replace(problem.as_finding(), where=where)]


def _sysfs_findings(where: str, folder: str) -> list[Finding]:
    from robot_runner.measuring.local_host import LocalHost  # noqa: PLC0415  # only where it is asked for

    host = LocalHost(SystemClock())
    try:
        find_sensor(host, folder, where=where)
    except LinkError as error:
        return [error.as_finding()]
    finally:
        host.close()
    return []


def _check_address(way: Way, where: str) -> None:
    if way.address is None:
        return
    if not (isinstance(way.address, int) and _FIRST_ADDRESS <= way.address <= _LAST_ADDRESS):
        fix = "An INA219 has one from 0x40 to 0x4f, by its solder bridges: address=0x40."
        raise PluginError(f"address is {way.address!r}", where=where, fix=fix)
    if way.sysfs is not None:
        fix = "Name the sensor's folder with sysfs, and leave address out."
        raise PluginError("both address and sysfs are named", where=where, fix=fix)


#: SBOS448G, table 1.
_FIRST_ADDRESS, _LAST_ADDRESS = 0x40, 0x4F


def _limits(limits: Sequence[float] | None, where: str) -> tuple[float, float] | None:
    if limits is None:
        return None
    if isinstance(limits, Sequence) and len(limits) == 2 and all(isinstance(each, int | float) for each in limits):  # noqa: PLR2004
        low, high = limits
        if low < high:
            return low, high
    fix = "Give the lower and the upper one in W, as in plausible_w=(2, 30)."
    raise PluginError(f"plausible_w is {limits!r}", where=where, fix=fix)


_REMEDY = "Look at the sensor, its cable and samples.csv before you use this run."
#: The size of a row of samples.csv, and the assumed duration of a mission: the paper's, s.
_BYTES_PER_ROW, _USUAL_SECONDS = 55, 95
#: How often live displays get the power, Hz.
_SHOWN_HZ = 2.0


_ENERGY = "Energy drawn over the measured window: the integral of power by the trapezoid rule."
_ENERGY_PT = "The paper's E = P x t: the mean of the power samples times the window's duration."
_MEAN_POWER = "Mean power over the measured window: Energy divided by its duration."


class Ina219(Profiler):
    """Measures the power that the robot draws from its battery, and the energy over the measured window.

    A microcontroller on board reads a Texas Instruments INA219 and sends its registers over a serial line, as described
    in `docs/ina219-protocol.md`. Nothing is computed during the mission: the line keeps the bytes. The microcontroller
    may record on an SD card instead, or the sensor may be connected to the bus of a Linux computer.

    Args:
        name: distinguishes several meters; None for the class's name.
        port: the serial port of a meter, or a URL of pyserial's such as `rfc2217://robot.local:4000`.
        card: the file to which the recording is copied from a meter's card after each mission.
        card_patience_s: how long to wait for that file at the end of a run, s.
        sysfs: the folder of a kernel driver, such as `/sys/class/hwmon/hwmon3`, or `auto` for the only sensor.
        host: the computer with that driver: `localhost`, or as ssh takes it (`pi@robot`).
        ssh_config: a file that replaces your ssh config.
        address: of the sensor on the meter's bus (0x40 to 0x4f), for a meter with several; None takes its first one.
            Each sensor has its own profiler, on the same port or card.
        shunt_ohm: resistance of the shunt, ohm; None takes the one that the meter sends (0.1 ohm if it sends none).
        rate_hz: nominal sampling rate, Hz; None takes the one that the meter sends (200 Hz if it sends none; 50 Hz
            with a driver).
        plausible_w: the limits of plausible power, W, such as `(2, 30)`; samples outside make the values doubtful.
        namespace: of the robot with the meter, if there are several simulated robots.

    Raises:
        PluginError: the limits are not two numbers in order, the address is invalid, the shunt or the rate is not
            positive, or two connections to the sensor are named.

    Example:
        >>> Ina219(port="/dev/ttyUSB0", shunt_ohm=0.05).measures[0].unit
        'J'
    """

    measures: Sequence[Measure] = (
        Measure("Energy", "J", _ENERGY, over=Over.SUM),
        Measure("EnergyPt", "J", _ENERGY_PT, over=Over.SUM),
        Measure("MeanPower", "W", _MEAN_POWER, over=Over.MEAN),
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
        address: int | None = None,
        shunt_ohm: float | None = None,
        rate_hz: float | None = None,
        plausible_w: tuple[float, float] | None = None,
        namespace: str = "",
    ) -> None:
        super().__init__(name=name)
        given: dict[str, Any] = {"shunt_ohm": shunt_ohm, "rate_hz": rate_hz, "card_patience_s": card_patience_s or None}
        check_numbers(self.name, **{parameter: value for parameter, value in given.items() if value is not None})
        config = None if ssh_config is None else Path(ssh_config).expanduser()
        self.way = Way(
            port=port, card=card, sysfs=sysfs, host=host, ssh_config=config, address=address, namespace=namespace
        )
        _check_address(self.way, self.name)
        if len(self.way.given) > 1:
            named = " and ".join(self.way.given)
            raise PluginError(f"both {named} are named", where=self.name, fix="Name one way to the sensor.")
        self.card_patience_s = card_patience_s
        self.shunt_ohm = shunt_ohm
        self.rate_hz = rate_hz
        self.plausible_w = _limits(plausible_w, self.name)
        rate = rate_hz or (DEFAULT_RATE if sysfs is None else DEFAULT_SYSFS_RATE)
        self.probe_s = None if card is not None else probe_window(rate)  # the file of a card comes after the mission
        self.bytes_per_run = round(rate * _USUAL_SECONDS * _BYTES_PER_ROW)
        self._meter: Meter | None = None
        self._evaluation: Evaluation | None = None
        self._watcher: PeriodicSampler[None] | None = None
        self._live: LiveSamples | None = None

    def claims(self, robot: str | None) -> Iterable[str]:
        """Return a claim of the meter; a simulated one belongs to the run anyway."""
        del robot
        return self.way.claims

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return errors: no meter, a port that cannot be opened, or two profilers on one line."""
        yield from way_findings(self._where, self.way, circumstances.robot)
        yield from self._clashes(circumstances)

    def start_measurement(self, context: RobotRunnerContext) -> None:
        """Connect to the sensor and start taking samples; a `LinkError` says that it cannot be reached."""
        self._meter = self._evaluation = None
        meter = self._open_meter(context)
        meter.begin()
        self._meter = meter
        self._show_live(meter, context)

    def stop_measurement(self, context: RobotRunnerContext) -> None:
        """Take the samples that the line has kept; then raise the `LinkError` of a lost line."""
        del context
        watcher, self._watcher = self._watcher, None
        if watcher is not None:
            watcher.stop()
        if self._meter is not None:
            self._meter.end()

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Write the raw samples: later than `stop_measurement`, so that other profilers need not wait for the disk."""
        if self._meter is not None and self._meter.has_samples_at_once:
            self._evaluate(self._meter, context)
        if self._live is not None:
            self._live.close()

    def _show_live(self, meter: Meter, context: RobotRunnerContext) -> None:
        """Show the power from time to time on live displays; the samples themselves wait on the line until the end."""
        if not isinstance(meter, PromptMeter):
            return  # a card has no samples before the end
        clock, latest_power = context.clock, meter.latest_power
        live = self._live = LiveSamples(context.raw_data_folder / "samples.csv")

        def show() -> None:
            # Decoded only if a display is due: a simulated mission passes many of these moments a second.
            live.show(lambda: [Column("time_s", [clock.now()]), Column("power_W", [latest_power()])])

        self._watcher = PeriodicSampler(show, rate=_SHOWN_HZ, clock=clock)
        self._watcher.start()

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish energy and mean power; no value if samples cover too little.

        Raises:
            LinkError: the file from the meter's card did not come, or is not as expected.
        """
        if self._meter is None:
            context.doubt(NEVER_STARTED, fix=_REMEDY)
            publish_measures(context, self.measures, lambda _: {})
            return
        meter, mission = self._meter, context.window
        evaluation = self._evaluate(meter, context)
        for problem in evaluation.warnings():
            context.doubt(problem, fix=_REMEDY)

        def evaluated(window: Window) -> Mapping[str, float | None]:
            return (evaluation if window == mission else meter.evaluate(mission, window)).values()

        origin = Origin.SIMULATED if evaluation.is_simulated else Origin.MEASURED
        times = evaluation.power.times if meter.has_samples_at_once else ()  # those of a card are on its own clock
        publish_measures(context, self.measures, evaluated, origin=origin, times=times)

    @property
    def _where(self) -> str:
        return f"plugin {self.name}"

    def _evaluate(self, meter: Meter, context: RobotRunnerContext) -> Evaluation:
        if self._evaluation is None:
            self._evaluation = replace(meter.evaluate(context.window), limits=self.plausible_w)
            self._evaluation.write(context.raw_data_folder)
            if (host_clock := self._evaluation.details.get("host_clock")) is not None:
                context.note_clock(host_clock)
        return self._evaluation

    def _open_meter(self, context: RobotRunnerContext) -> Meter:
        way, clock, shunt, rate = self.way, context.clock, self.shunt_ohm, self.rate_hz
        address = FIRST_SENSOR if way.address is None else way.address
        if way.card is not None:
            patience = self.card_patience_s
            return CardMeter(way.card, clock, address=address, patience=patience, shunt_ohm=shunt, rate_hz=rate)
        if way.sysfs is not None:
            host = connect_host(context, way.host, ssh_config=way.ssh_config)
            if not isinstance(host, FileHost):
                fix = f"Leave host out, or name another one than {way.host!r}."
                raise LinkError("files of this computer cannot be read", where=self._where, fix=fix)
            return SysfsMeter(host, clock, folder=way.sysfs, shunt_ohm=shunt, rate_hz=rate, where=self._where)
        line = open_serial_line(context, way.port, namespace=way.namespace)
        shared = context.resources.open(f"samples of {way.port} {way.namespace}", lambda: SharedLine(line))
        return LineMeter(shared, clock, address=address, shunt_ohm=shunt, rate_hz=rate)

    def _clashes(self, circumstances: Circumstances) -> Iterator[Finding]:
        """Yield errors for earlier profilers that read the same line or file: each would get some of the samples."""
        for other in circumstances.plugins:
            if other is self:
                return
            if isinstance(other, Ina219) and self.way.clashes_with(other.way):
                problem = f"plugin {other.name} has the same serial line, and each would get some of the samples"
                fix = "Give each a port of its own (or the address of a sensor of its own), or leave one of them out."
                yield Finding.error(self._where, problem, fix)
