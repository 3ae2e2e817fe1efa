"""The profiler of the state that the robot publishes of its battery."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import ClassVar

from robot_runner.core.errors import Finding
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import Measure, Origin, Over
from robot_runner.core.events.window import MissionTimes, Window
from robot_runner.core.links.connect import connect_robot, is_simulation, robot_namespace
from robot_runner.core.links.robot import Encoding, Message, Subscription
from robot_runner.core.plugin import Circumstances, Profiler
from robot_runner.measuring.evaluation import NEVER_STARTED, publish_measures
from robot_runner.measuring.parameter_checks import check_numbers, no_robot
from robot_runner.measuring.quality import Column, quality_of, report_quality, sufficient, write_samples
from robot_runner.measuring.series import Series, cut, growth, integrate, mean

_TYPE = "sensor_msgs/BatteryState"
#: A state of charge above this is in percent: boards that compute it from the voltage exceed 1 only slightly.
_FULLEST = 1.5
#: Steps of a state of charge are coarse if larger than this share of the charge used; steps are recognised where each
#: value stays for this many messages on average.
_COARSE, _STAYS = 0.1, 3
#: A state of charge is the voltage if their ratio changes by less than this share of what the voltage does, where that
#: has as many values.
_AS_THE_VOLTAGE, _FEWEST = 0.2, 5
#: MAVROS passes on what MAVLink has for unknown: UINT16_MAX mV, and -1 in steps of 10 mA, with its sign changed, and in
#: those of 1 % (mavros, sys_status.cpp).
_UNKNOWN_VOLTS, _UNKNOWN_AMPERES = 65.535, 0.01
#: How often a TurtleBot3 publishes its battery's state, Hz: its firmware in ROS 1 (turtlebot3_core), a node in ROS 2
#: (turtlebot3_node, turtlebot3.cpp).
_TURTLEBOT3_HZ = {Encoding.ROS1: 30.0, Encoding.CDR: 20.0}
_FIX = "Look at the topic, with `ros2 topic hz` or `rostopic hz`, before you use this run."
_FIX_MESSAGES = "Look at its messages, with `ros2 topic echo` or `rostopic echo`, before you use this run."


@dataclass(slots=True)
class _Heard:
    """The battery's messages, by quantity; NaN for what it does not measure, as in ROS."""

    is_simulated: bool = False
    times: list[float] = field(default_factory=list)
    voltage: list[float] = field(default_factory=list)
    current: list[float] = field(default_factory=list)
    charge: list[float] = field(default_factory=list)

    def take(self, time: float, message: Message) -> None:
        self.times.append(time)
        self.voltage.append(float(message["voltage"]))
        self.current.append(-float(message.get("current", math.nan)))
        share = float(message.get("percentage", math.nan))
        self.charge.append(100.0 * share if share >= 0 else math.nan)

    def over(self, window: Window) -> _Heard:
        """Return the messages of a window, without one at its very start, which came before the subscription."""
        first, last = bisect_right(self.times, window.start), bisect_right(self.times, window.end)
        columns = (self.times, self.voltage, self.current, self.charge)
        return _Heard(self.is_simulated, *(column[first:last] for column in columns))

    def series(self, values: Sequence[float]) -> Series:
        known = [(time, value) for time, value in zip(self.times, values, strict=True) if math.isfinite(value)]
        return Series([time for time, _ in known], [value for _, value in known])

    @property
    def measures_current(self) -> bool:
        """Whether any message has a current: boards that do not measure it publish NaN, 0 or 10 mA throughout."""
        return any(math.isfinite(value) and value and not _is(-value, _UNKNOWN_AMPERES) for value in self.current)

    @property
    def volts(self) -> list[float]:
        """The voltages; NaN for 0, which drivers publish before their first measurement, and for an unknown one."""
        return [math.nan if not value or _is(value, _UNKNOWN_VOLTS) else value for value in self.voltage]

    def power(self) -> Series:
        watts = [volts * amperes for volts, amperes in zip(self.volts, self.current, strict=True)]
        return self.series(watts) if self.measures_current else Series([], [])


class Battery(Profiler):
    """Measures the battery from the robot's own messages: voltage, charge, and energy where it measures current.

    A TurtleBot3's own board (OpenCR) measures the voltage only; use `Ina219` for its energy.

    Args:
        name: distinguishes several instances; None for the class's name.
        topic: the topic, relative to the robot's namespace.
        rate_hz: the expected rate of the messages, Hz; None for that of a TurtleBot3: 30 in ROS 1, 20 in ROS 2.
        namespace: which robot, where there are several.

    Raises:
        PluginError: the rate is not positive.

    Example:
        >>> Battery(rate_hz=10.0).measures[0].name
        'MeanVoltage'
    """

    measures: Sequence[Measure] = (
        Measure("MeanVoltage", "V", "Voltage of the battery, mean over the measured window.", over=Over.MEAN),
        Measure("MinVoltage", "V", "Voltage of the battery, minimum over the measured window.", over=Over.MINIMUM),
        Measure(
            "ChargeUsed",
            "%",
            "State of charge at the beginning of the measured window less that at its end.",
            over=Over.SUM,
        ),
        Measure(
            "Energy",
            "J",
            "Energy drawn from the battery: the integral of its voltage times its current.",
            over=Over.SUM,
        ),
    )
    needs: ClassVar[str] = "A robot that publishes battery_state (sensor_msgs/BatteryState)."
    #: No probe: on some graphs it takes seconds until publisher and subscription have discovered each other.
    probe_s: float | None = None
    bytes_per_run: int = 120_000  # 30 messages a second of 40 bytes for a mission of 95 s

    def __init__(
        self,
        *,
        name: str | None = None,
        topic: str = "battery_state",
        rate_hz: float | None = None,
        namespace: str = "",
    ) -> None:
        super().__init__(name=name)
        if rate_hz is not None:
            check_numbers(self.name, rate_hz=rate_hz)
        self.topic = topic
        self.rate_hz = rate_hz
        self.namespace = namespace
        self._expected_hz = rate_hz or _TURTLEBOT3_HZ[Encoding.ROS1]
        self._heard: _Heard | None = None
        self._subscription: Subscription | None = None
        self._begun_at = 0.0
        self._sampled: Window | None = None

    def claims(self, robot: str | None) -> Iterable[str]:
        """Return what only one run may use at a time: nothing besides the robot, which the experiment claims."""
        del robot
        return ()

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return an error if the experiment has no robot."""
        return [no_robot(self.name, "measures the battery of a robot")] if circumstances.robot is None else []

    def start_run(self, context: RobotRunnerContext) -> None:
        """Discard the messages of the run before."""
        del context
        self._heard = self._subscription = self._sampled = None

    def start_measurement(self, context: RobotRunnerContext) -> None:
        """Subscribe to the topic."""
        link, clock = connect_robot(context, namespace=self.namespace), context.clock
        self._expected_hz = self.rate_hz or _TURTLEBOT3_HZ[link.encoding]
        self._heard = heard = _Heard()

        def take(message: Message) -> None:
            heard.take(clock.now(), message)

        self._subscription = link.subscribe(self.topic, _TYPE, take, is_prompt=True)
        self._begun_at = clock.now()

    def stop_measurement(self, context: RobotRunnerContext) -> None:
        """End the subscription."""
        subscription, self._subscription = self._subscription, None
        if subscription is not None and self._heard is not None:
            subscription.close()
            self._sampled = Window(self._begun_at, context.clock.now())
            link = connect_robot(context, namespace=self.namespace)
            self._heard.is_simulated = is_simulation(link, robot_namespace(context, self.namespace))

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Write the messages: later than `stop_measurement`, so that other profilers need not wait for the disk."""
        if self._heard is None or self._sampled is None:
            return
        columns = (
            Column("time_s", self._heard.times),
            Column("voltage_V", _finite(self._heard.voltage), "%.4f"),
            Column("current_A", _finite(self._heard.current), "%.4f"),
            Column("charge_percent", _finite(self._heard.charge), "%.3f"),
        )
        write_samples(context.raw_data_folder / "samples.csv", columns)

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish the measures; no value where too few messages came, or the battery does not measure it."""
        heard, window = self._heard, context.window
        if heard is None or window is None:
            context.doubt(NEVER_STARTED, fix=_FIX)
            publish_measures(context, self.measures, lambda _: {})
            return
        mission = heard.over(window)
        details = {"is_simulated": heard.is_simulated, "measures_current": mission.measures_current}
        quality = quality_of(heard.times, window, self._expected_hz)
        report_quality(context, quality, window, sampled=self._sampled, fix=_FIX, details=details)
        for problem, names in (*self._doubts(mission, window), *self._charge_doubts(mission, context.times)):
            context.doubt(problem, fix=_FIX_MESSAGES, measures=names)
        publish_measures(
            context,
            self.measures,
            lambda part: self._values(mission, part),
            origin=Origin.SIMULATED if heard.is_simulated else Origin.MEASURED,
            times=heard.times,
        )

    def _doubts(self, heard: _Heard, window: Window) -> Iterator[tuple[str, Sequence[str]]]:
        """Yield doubts about the messages, each with the measures concerned."""
        told = (
            ("voltage", heard.series(heard.volts), ("MeanVoltage", "MinVoltage")),
            ("charge", heard.series(heard.charge), ("ChargeUsed",)),
            ("current", heard.power(), ("Energy",)),
        )
        is_sufficient = quality_of(heard.times, window, self._expected_hz).is_sufficient
        for quantity, series, names in told:
            if is_sufficient and len(series) and not len(sufficient(series, window, self._expected_hz)):
                missing = len(heard.times) - len(series)
                what = "not measured (NaN, 0 or 65.535 V)" if quantity == "voltage" else "NaN"
                some = f"{missing} of {len(heard.times)} messages"
                yield f"the battery's {quantity} was {what} in {some}: no value", names
        fullest = max(heard.series(heard.charge).values, default=0.0) / 100
        if fullest > _FULLEST:
            reported = f"the robot reports percentage = {fullest:.3g}, where {_TYPE} has 0 to 1"
            yield f"{reported}: ChargeUsed may be 100-fold", ("ChargeUsed",)
        if (volts := _full_voltage(heard)) is not None:
            same = f"the state of charge is the voltage / {volts:.3g} V in all messages"
            reckoned = "as a TurtleBot3's board reckons it: ChargeUsed is how far the voltage fell"
            yield f"{same}, {reckoned}", ("ChargeUsed",)
        joules = self._values(heard, window).get("Energy")
        if joules is not None and joules < 0:
            wrong = "the robot reports its current with the wrong sign, or was charged"
            yield f"the energy is {joules:.4g} J: {wrong}", ("Energy",)

    def _charge_doubts(self, heard: _Heard, times: MissionTimes) -> Iterator[tuple[str, Sequence[str]]]:
        """Yield doubts about what is used in the mission, or else in its phases, for which steps may be coarse."""
        step, window = _step(heard.series(heard.charge).values), times.window()
        if window is not None and (problem := _coarse(self._used(heard, [window]), step)):
            yield problem, ("ChargeUsed",)
            return
        for phase in times.requested:
            windows = [each.window for each in times.phases() if each.name == phase]
            if windows and (problem := _coarse(self._used(heard, windows), step)):
                yield f"phase {phase!r}: {problem}", (f"ChargeUsed.{phase}",)

    def _used(self, heard: _Heard, windows: Sequence[Window]) -> float | None:
        used = [self._values(heard, window).get("ChargeUsed") for window in windows]
        known = [each for each in used if each is not None]
        return math.fsum(known) if known else None

    def _values(self, heard: _Heard, window: Window) -> Mapping[str, float | None]:
        """Return the measures over a part of the mission; the nearest messages within it count for its edges."""
        if not quality_of(heard.times, window, self._expected_hz).is_sufficient:
            return {}
        voltage, power = (
            cut(sufficient(series, window, self._expected_hz), window, reach=window.duration)
            for series in (heard.series(heard.volts), heard.power())
        )
        # Before the first and after the last message the mean rate is assumed, so that the charge used then counts.
        charged = growth(sufficient(heard.series(heard.charge), window, self._expected_hz), window)
        return {
            "MeanVoltage": mean(voltage),
            "MinVoltage": min(voltage.values, default=None),
            "ChargeUsed": None if charged is None else 0.0 - charged,
            "Energy": integrate(power),
        }


def _full_voltage(heard: _Heard) -> float | None:
    """Return the voltage, V, by which all messages divide theirs for the charge; None where they do not.

    A battery's charge falls by several times as much as its voltage does, and not at all where that sags under load.
    """
    told = [(volts, share / 100) for volts, share in zip(heard.volts, heard.charge, strict=True) if share > 0]
    known = [volts for volts, _ in told if math.isfinite(volts)]
    ratios = [volts / share for volts, share in told if math.isfinite(volts)]
    if len(set(known)) < _FEWEST:
        return None
    is_same = (max(ratios) - min(ratios)) / min(ratios) < _AS_THE_VOLTAGE * (max(known) - min(known)) / min(known)
    return math.fsum(ratios) / len(ratios) if is_same else None


def _coarse(used: float | None, step: float) -> str:
    """Return the doubt about a charge that was used, % of the full one, if it was reported in steps; empty for none."""
    if used == 0:
        return "the charge stayed as it was: ChargeUsed lacks what is less than a step of it"
    if used is None or step <= _COARSE * abs(used):
        return ""
    return f"the charge is reported in steps of {step:.2g} %: ChargeUsed may be off by {100 * step / abs(used):.0f} %"


def _step(values: Sequence[float]) -> float:
    """Return the smallest step between values that each stay for several messages; 0 where they do not stay."""
    told = sorted({round(value, 6) for value in values})
    stays = len(told) > 1 and len(values) >= _STAYS * len(told)
    return min(later - sooner for sooner, later in pairwise(told)) if stays else 0.0


def _is(value: float, number: float) -> bool:
    return math.isclose(value, number, rel_tol=1e-6)  # messages have floats of 32 bits


def _finite(values: Sequence[float]) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in values]
