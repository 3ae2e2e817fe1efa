"""The profiler of a Watts up? PRO between the wall socket and a load."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

from robot_runner.core.errors import Finding, LinkError, PluginError
from robot_runner.core.events.context import Clock, RobotRunnerContext
from robot_runner.core.events.early_end import undivided
from robot_runner.core.events.measure import Measure, Origin, Over
from robot_runner.core.events.window import Window
from robot_runner.core.links.connect import is_simulated
from robot_runner.core.plugin import Circumstances, Profiler
from robot_runner.measuring.devices import open_serial_line
from robot_runner.measuring.evaluation import NEVER_STARTED, publish_measures
from robot_runner.measuring.periodic import Sampling
from robot_runner.measuring.quality import Column, SampleQuality, quality_of, report_quality, write_samples
from robot_runner.measuring.serial_line import SerialLine, port_problem
from robot_runner.measuring.series import Series, mean_of_intervals
from robot_runner.meters.electrical_readings import ElectricalReading, Readings, doubts_about_readings

#: Source of commands and answers: Electronic Educational Devices, Watts up? PRO communications protocol (2009):
#: `#L,W,3,E,<reserved>,<interval in s>;` begins to log to the line, `#L,R,0;` ends it. A record is
#: `#d,-,18,<W x 10>,<V x 10>,<A x 1000>,<Wh x 10>,...;`, once an interval, with the number of its fields.
_BEGIN = b"#L,W,3,E,1,1;"
_END = b"#L,R,0;"
_RECORD = "#d"
_RATE = 1.0
#: How long to wait for the first record, s: the meter takes some time to change its mode.
_PATIENCE = 4.0
#: How long to wait for the record that covers the window's end, s.
_AFTERMATH = 1.5
_POLL = 0.02
_FIX = "Look at the meter, its cable and samples.csv before you use this run."


@dataclass(frozen=True, slots=True)
class WattsUpSample:
    """One record of the meter: means of about a second.

    Attributes:
        time: of its arrival, s on the run's clock.
        watts: active power, W.
        volts: effective voltage, V.
        amperes: effective current, A.
    """

    time: float
    watts: float
    volts: float
    amperes: float


def parse_record(record: str, time: float) -> WattsUpSample | None:
    """Return the sample of a record without its `;`; None if it is not a data record.

    Example:
        >>> parse_record("#d,-,7,1053,2301,502,0,0,0,0", time=1.0)
        WattsUpSample(time=1.0, watts=105.3, volts=230.1, amperes=0.502)

    Raises:
        ValueError: the data record is damaged.
    """
    fields = record.strip().split(",")
    if fields[0] != _RECORD:
        return None
    watts, volts, milliamperes = (int(field) for field in fields[3:6])
    if len(fields) - 3 != int(fields[2]):
        raise ValueError(f"the record has {len(fields) - 3} fields of {fields[2]}")
    return WattsUpSample(time, watts / 10, volts / 10, milliamperes / 1000)


class Recording:
    """The records that have arrived on a line so far."""

    def __init__(self, line: SerialLine) -> None:
        self.line = line
        self.samples: list[WattsUpSample] = []
        self.corrupt_at: list[float] = []
        self._rest = ""

    @undivided
    def take(self) -> None:
        """Read the bytes that have arrived; a `LinkError` says that the line was lost."""
        for chunk in self.line.drain():
            *records, self._rest = (self._rest + chunk.data.decode("ascii", errors="replace")).split(";")
            for record in records:
                try:
                    sample = parse_record(record, chunk.received_at)
                except ValueError:
                    self.corrupt_at.append(chunk.received_at)
                else:
                    self.samples += [] if sample is None else [sample]

    def wait(self, is_enough: Callable[[], bool], clock: Clock, seconds: float) -> None:
        """Read until `is_enough()`, at most for this many seconds; a `LinkError` says that the line was lost."""
        deadline = clock.now() + seconds
        self.take()
        while not is_enough() and clock.now() < deadline:
            clock.sleep(_POLL)
            self.take()

    def series(self, quantity: str) -> Series:
        """Return one quantity of the samples over time."""
        return Series([each.time for each in self.samples], [getattr(each, quantity) for each in self.samples])

    def sampling(self, window: Window) -> Sampling[Readings]:
        """Return the samples as readings of one channel, to be evaluated over a window."""
        readings = [(ElectricalReading(each.watts, each.volts, each.amperes),) for each in self.samples]
        return Sampling([each.time for each in self.samples], readings, window, _RATE)

    def quality(self, window: Window) -> SampleQuality:
        """Return the quality of the samples in a window."""
        corrupt = sum(window.start <= time <= window.end for time in self.corrupt_at)
        return quality_of(self.series("watts").times, window, _RATE, corrupt=corrupt)


class WattsUpPro(Profiler):
    """Measures power at the wall socket with a Watts up? PRO on a serial line, once a second.

    It is for the charger of a robot, a base station or a workstation; the meter's power is that of the second before.

    Args:
        port: its serial port, such as `/dev/ttyUSB0`.
        name: distinguishes several meters; None for the class's name.

    Raises:
        PluginError: no port is given.

    Example:
        >>> WattsUpPro(port="/dev/ttyUSB0").measures[0].unit
        'J'
    """

    measures: Sequence[Measure] = (
        Measure(
            "Energy",
            "J",
            "Energy drawn from the wall over the measured window: mean power times its duration.",
            over=Over.SUM,
        ),
        Measure("MeanPower", "W", "Active power drawn from the wall, mean over the measured window.", over=Over.MEAN),
    )
    needs: ClassVar[str] = "A Watts up? PRO on a serial port, and robot-runner[serial]."
    #: A record comes each second, and is about the second before.
    probe_s: float | None = 2.0
    bytes_per_run: int = 5_000  # a row a second of 40 bytes for a mission of 95 s

    def __init__(self, *, port: str, name: str | None = None) -> None:
        super().__init__(name=name)
        if not port:
            raise PluginError(f"port is {port!r}", where=self.name, fix="Give its serial port: port='/dev/ttyUSB0'.")
        self.port = port
        self._recording: Recording | None = None
        self._begun_at: float | None = None
        self._sampled: Window | None = None
        self._is_over = False

    def claims(self, robot: str | None) -> Iterable[str]:
        """Return a claim of the serial port."""
        del robot
        return (f"serial:{self.port}",)

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return errors: no such port, no right to open it, no pyserial, or a simulated robot."""
        where = f"plugin {self.name}"
        if is_simulated(circumstances.robot):
            problem = "the robot is simulated, and draws nothing from a wall"
            return [Finding.error(where, problem, "Use Ina219, which measures the simulated robot.")]
        fault = port_problem(self.port)
        return [] if fault is None else [Finding.error(where, fault.problem, fault.fix)]

    def start_run(self, context: RobotRunnerContext) -> None:
        """Discard the samples of the run before."""
        del context
        self._recording = self._begun_at = self._sampled = None
        self._is_over = False

    def start_measurement(self, context: RobotRunnerContext) -> None:
        """Make the meter log to the line, and wait for a first record."""
        recording, begun_at = Recording(open_serial_line(context, self.port)), context.clock.now()
        recording.line.write(_BEGIN)
        recording.wait(lambda: bool(recording.samples), context.clock, _PATIENCE)
        self._recording, self._begun_at = recording, begun_at

    def stop_measurement(self, context: RobotRunnerContext) -> None:
        """Note the time; the meter runs until `stop_run`, so that no other profiler waits for it."""
        if self._begun_at is not None and self._sampled is None:
            self._sampled = Window(self._begun_at, context.clock.now())

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Wait for the record of the last second, stop the meter, and write the samples."""
        recording, sampled = self._recording, self._sampled
        if recording is None or sampled is None or self._is_over:
            return
        self._is_over = True
        end = (context.window or sampled).end
        try:
            recording.wait(lambda: any(each.time >= end for each in recording.samples[-1:]), context.clock, _AFTERMATH)
            recording.line.write(_END)
        except LinkError as error:
            context.doubt(f"the line to the power meter was lost: {error.problem}", fix=error.fix)
        columns = [
            Column("time_s", recording.series("watts").times),
            Column("power_W", recording.series("watts").values, "%.1f"),
            Column("voltage_V", recording.series("volts").values, "%.1f"),
            Column("current_A", recording.series("amperes").values, "%.3f"),
        ]
        write_samples(context.raw_data_folder / "samples.csv", columns)

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish energy and mean power; no value if too few records came."""
        recording, window = self._recording, context.window
        if recording is None or window is None:
            context.doubt(NEVER_STARTED, fix=_FIX)
        else:
            report_quality(context, recording.quality(window), window, sampled=self._sampled, fix=_FIX)
            for problem in doubts_about_readings(recording.sampling(window)):
                context.doubt(problem.format(of=""), fix=_FIX)
        is_simulated = recording is not None and recording.line.is_simulated
        origin = Origin.SIMULATED if is_simulated else Origin.MEASURED
        times = () if recording is None else recording.series("watts").times
        publish_measures(context, self.measures, self._evaluated, origin=origin, times=times)

    def _evaluated(self, window: Window) -> Mapping[str, float | None]:
        if self._recording is None or not self._recording.quality(window).is_sufficient:
            return {}
        power = mean_of_intervals(self._recording.series("watts"), window)
        return {"Energy": None if power is None else power * window.duration, "MeanPower": power}
