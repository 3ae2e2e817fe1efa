"""The profiler that measures with a Joulescope on USB, through its maker's driver."""

from __future__ import annotations

import importlib.util
from collections import deque
from collections.abc import Iterable, Mapping
from contextlib import suppress
from importlib import import_module
from statistics import fmean
from typing import Any, ClassVar

from robot_runner.core.errors import Finding, PluginError, did_you_mean
from robot_runner.core.events.context import Clock, RobotRunnerContext, SystemClock
from robot_runner.core.plugin import Circumstances
from robot_runner.measuring.measured_machine import machine_clock, simulation_findings
from robot_runner.meters.electrical import ElectricalProfiler
from robot_runner.meters.electrical_readings import ElectricalReading
from robot_runner.meters.polled import trial_findings

_INSTALL = "Install it: pip install 'robot-runner[joulescope]'."
_CONNECT = "Connect it by USB; on Linux its rules for udev must be installed (joulescope.com, user's guide)."
#: Sample rates, Hz: the period of statistics is requested in samples. Source: the driver's own program `statistics`.
_JS110_RATE, _LATER_RATE = 2_000_000, 1_000_000
#: How many statistics are sent for each reading, so that the last one is always recent.
_STATISTICS_PER_READING = 2
#: Hz; the driver's callbacks take their time from the run's process.
_FASTEST = 100
#: The time between two checks for the first statistics, s.
_POLL = 0.02
#: After how many readings without a new one the instrument counts as silent.
_SILENT_READINGS = 5


class _Instrument:
    """An opened Joulescope that sends statistics; a reading is made of those since the last one."""

    def __init__(self, plugin: Joulescope, clock: Clock) -> None:
        self._plugin = plugin
        self._clock = clock
        self._patience = max(_SILENT_READINGS / plugin.rate_hz, 1.0)
        self._last: ElectricalReading | None = None
        self._new: deque[tuple[float, float, float]] = deque()  # power, voltage and current of each of the statistics
        self._means: tuple[float, ...] = ()
        try:
            self._driver: Any = import_module("pyjoulescope_driver").Driver()
        except ImportError as error:
            problem = f"the Joulescope's driver cannot be imported: {error}"
            raise PluginError(problem, where=plugin.name, fix=_INSTALL) from error
        try:
            # Such as `u/js220/000415`; later drivers list other instruments, too.
            paths = [path for path in self._driver.device_paths() if "/js" in path]
            self.path = self._chosen(paths)
            self._driver.open(self.path)
            self._begin()
        except PluginError:
            self.close()
            raise
        except Exception as error:  # the driver raises various errors, among them RuntimeError and TimeoutError
            self.close()
            raise PluginError(f"the Joulescope cannot be opened: {error}", where=plugin.name, fix=_CONNECT) from error

    def await_statistics(self) -> None:
        """Wait for the first statistics; a `PluginError` says that none come."""
        deadline = self._clock.now() + self._patience
        while self._last is None:
            if self._clock.now() >= deadline:
                fix = "Unplug it and connect it again, and see that no other program has it open."
                raise PluginError(f"{self.path} sends no statistics", where=self._plugin.name, fix=fix)
            self._clock.sleep(_POLL)

    def read(self) -> tuple[ElectricalReading, ...]:
        last = self._last
        silent = self._clock.now() - (last.time if last and last.time else 0.0)
        if last is None or silent > self._patience:
            raise TimeoutError(f"the Joulescope has reported nothing for {silent:.1f} s")
        new = [self._new.popleft() for _ in range(len(self._new))]
        if new:
            self._means = tuple(map(fmean, zip(*new, strict=True)))
        power, voltage, current = self._means
        return (ElectricalReading(power, voltage, current, last.joules, last.time),)

    def close(self) -> None:
        with suppress(Exception):  # the instrument may be unplugged; `finalize` releases the rest
            self._driver.close(self.path)
        self._driver.finalize()

    def _chosen(self, paths: list[str]) -> str:
        wanted, where = self._plugin.device, self._plugin.name
        if not paths:
            raise PluginError("no Joulescope is connected", where=where, fix=_CONNECT)
        found = [path for path in paths if wanted is None or path == wanted or path.endswith(f"/{wanted}")]
        if not found:
            fix = f"{did_you_mean(wanted or '', paths)} There are: {', '.join(paths)}.".strip()
            raise PluginError(f"there is no Joulescope {wanted!r}", where=where, fix=fix)
        if len(found) > 1:
            fix = f"Name one: device={found[0]!r}. There are: {', '.join(found)}."
            raise PluginError(f"there are {len(found)} Joulescopes", where=where, fix=fix)
        return found[0]

    def _begin(self) -> None:
        """Request statistics, as the maker's own programs do."""
        is_first = "js110" in self.path
        settings: Mapping[str, object] = (
            {"s/i/range/select": "auto", "s/i/ctrl": "on", "s/v/ctrl": "on", "s/p/ctrl": "on"}
            if is_first
            else {"s/i/range/mode": "auto"}
        )
        rate = _JS110_RATE if is_first else _LATER_RATE
        count = round(rate / (_STATISTICS_PER_READING * self._plugin.rate_hz))
        for topic, value in {**settings, "s/stats/scnt": count, "s/stats/ctrl": "on" if is_first else 1}.items():
            self._driver.publish(f"{self.path}/{topic}", value)
        self._driver.subscribe(f"{self.path}/s/stats/value", "pub", self._receive)

    def _receive(self, topic: str, value: Mapping[str, Any]) -> None:
        """Take new statistics; called in a thread of the driver."""
        del topic
        signals = value["signals"]
        power, voltage, current = (float(signals[name]["avg"]["value"]) for name in ("power", "voltage", "current"))
        joules = float(value["accumulators"]["energy"]["value"])
        self._new.append((power, voltage, current))
        self._last = ElectricalReading(joules=joules, time=self._clock.now())


class Joulescope(ElectricalProfiler):
    """Measures with a Joulescope (JS220, JS320, JS110) on USB, which integrates power at a million samples a second.

    Args:
        name: distinguishes several instances; None for the class's name.
        device: its path such as `u/js220/000415`, or its serial number; None takes the only one.
        rate_hz: readings a second, Hz; the instrument integrates between them, whatever the load does.

    Raises:
        PluginError: the rate is not between 0 and 100 Hz.

    Example:
        >>> Joulescope(device="000415").measures[0].unit
        'J'
    """

    needs: ClassVar[str] = "A Joulescope on USB, and robot-runner[joulescope]."
    bytes_per_run: int = 70_000  # 10 readings a second of 70 bytes for a mission of 95 s

    def __init__(self, *, name: str | None = None, device: str | None = None, rate_hz: float = 10.0) -> None:
        super().__init__(name=name, rate_hz=rate_hz)
        if rate_hz > _FASTEST:
            fix = f"Give rate_hz {_FASTEST} at most: the energy between two readings is counted by the instrument."
            raise PluginError(f"rate_hz is {rate_hz!r}", where=self.name, fix=fix)
        self.device = device
        self.averaged = 1.0 / rate_hz
        self._path = ""

    def claims(self, robot: str | None) -> Iterable[str]:
        """Return a claim of the instrument."""
        del robot
        return (f"device:joulescope {self.device or ''}".rstrip(),)

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return errors: no driver, no instrument, or several without a name."""
        if importlib.util.find_spec("pyjoulescope_driver") is None:
            return [Finding.error(f"plugin {self.name}", "pyjoulescope_driver is not installed", _INSTALL)]
        findings = trial_findings(self, lambda: _Instrument(self, SystemClock()))
        return findings or simulation_findings(self.name, circumstances.robot)

    def open(self, context: RobotRunnerContext) -> _Instrument:
        """Return the instrument once it sends statistics; a `PluginError` says what is missing."""
        instrument = _Instrument(self, machine_clock(context))
        try:
            instrument.await_statistics()
        except PluginError:
            instrument.close()
            raise
        self._path = instrument.path
        return instrument

    def details(self) -> Mapping[str, Any]:
        """Return the details of an electrical meter, and the instrument's path."""
        return {**super().details(), "device": self._path}
