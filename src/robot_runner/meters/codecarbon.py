"""The profiler that has the CodeCarbon library estimate energy and emissions."""

from __future__ import annotations

import importlib.util
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from importlib import import_module
from typing import Any, ClassVar

from robot_runner.core.errors import Finding, PluginError
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.measure import Measure, Origin
from robot_runner.core.events.window import Window
from robot_runner.core.plugin import Circumstances, Profiler
from robot_runner.measuring.evaluation import note_own_window, publish_measures
from robot_runner.measuring.measured_machine import THIS_MACHINE, clock_details, machine_clock, simulation_findings
from robot_runner.measuring.parameter_checks import check_numbers
from robot_runner.measuring.quality import write_quality

_INSTALL = "Install it: pip install 'robot-runner[codecarbon]'."
_JOULES = 3.6e6  # in a kilowatt hour
#: CodeCarbon's own duration may differ from ours by this many percent without a warning.
_TOLERANCE = 5.0
#: And by this many seconds, for starting and stopping.
_SLACK = 1.0


class CodeCarbon(Profiler):
    """Estimates energy and greenhouse gas emissions of this machine with CodeCarbon, without internet access.

    CodeCarbon reads energy counters where it can (RAPL, NVML); where it cannot, it computes from the processor's load
    and thermal design power, and memory from its size. All its values are labelled as estimated. They are totals
    from its start to its stop, and doubted if that exceeds the mission by more than 1 %.

    Args:
        country: the country whose electricity mix is used, as three letters (ISO 3166-1 alpha-3).
        name: distinguishes several instances; None for the class's name.
        interval_s: time between two of its readings, s.
        options: further arguments of its OfflineEmissionsTracker, such as `{"region": "california"}`.

    Raises:
        PluginError: the country is not written in three letters, or the interval is not positive.

    Example:
        >>> CodeCarbon(country="NLD").measures[1].unit
        'kg'
    """

    measures: Sequence[Measure] = (
        Measure("Energy", "J", "Energy of processor, GPU and memory while its tracker ran, estimated by CodeCarbon."),
        Measure("Emissions", "kg", "Greenhouse gases as CO2 equivalent while its tracker ran, by CodeCarbon."),
        Measure("CPUEnergy", "J", "Energy of the processor while its tracker ran, estimated by CodeCarbon."),
        Measure("MemoryEnergy", "J", "Energy of the memory while its tracker ran, estimated by CodeCarbon."),
    )
    measured_computer = THIS_MACHINE
    needs: ClassVar[str] = "robot-runner[codecarbon]."
    #: No probe: CodeCarbon has totals only, and an estimate for every machine, so that a probe could find no fault.
    probe_s: float | None = None
    bytes_per_run: int = 2_000

    def __init__(
        self,
        *,
        country: str,
        name: str | None = None,
        interval_s: float = 1.0,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(name=name)
        if not (isinstance(country, str) and re.fullmatch(r"[A-Z]{3}", country)):
            fix = "Give three capital letters, such as 'NLD' (ISO 3166-1 alpha-3)."
            raise PluginError(f"country is {country!r}", where=self.name, fix=fix)
        check_numbers(self.name, interval_s=interval_s)
        self.country = country
        self.interval_s = interval_s
        self.options = dict(options or {})
        self._tracker: Any = None
        self._begun_at = 0.0
        self._sampled: Window | None = None
        self._data: Any = None
        self._hardware: list[str] = []

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return an error if the library is not installed."""
        if importlib.util.find_spec("codecarbon") is None:
            return [Finding.error(f"plugin {self.name}", "codecarbon is not installed", _INSTALL)]
        return simulation_findings(self.name, circumstances.robot)

    def start_run(self, context: RobotRunnerContext) -> None:
        """Discard the totals of the run before."""
        del context
        self._tracker = self._sampled = self._data = None

    def start_measurement(self, context: RobotRunnerContext) -> None:
        """Start a tracker; a `PluginError` says that the library is not installed."""
        plain = {"save_to_file": False, "log_level": "error", "allow_multiple_runs": True}
        named = {"country_iso_code": self.country, "measure_power_secs": self.interval_s}
        self._tracker = started_tracker("OfflineEmissionsTracker", **{**named, **plain, **self.options})
        self._begun_at = machine_clock(context).now()

    def stop_measurement(self, context: RobotRunnerContext) -> None:
        """Stop the tracker and take its totals."""
        tracker, self._tracker = self._tracker, None
        if tracker is None:
            return
        self._sampled = Window(self._begun_at, machine_clock(context).now())
        stop_tracker(tracker)
        # The tracker swallows its own exceptions, and then has no totals.
        self._data = getattr(tracker, "final_emissions_data", None)
        self._hardware = list(map(str, getattr(tracker, "_conf", {}).get("hardware", [])))

    def stop_run(self, context: RobotRunnerContext) -> None:
        """Write the totals."""
        if self._sampled is None:
            return
        said = None if self._data is None else asdict(self._data)
        text = json.dumps(said, indent=2, default=str) + "\n"
        (context.raw_data_folder / "emissions.json").write_text(text, encoding="utf-8")
        details = {
            **clock_details(context),
            "hardware": self._hardware,
            "options": {**self.options, "country": self.country},
        }
        mission = context.times.window(machine_clock(context))
        write_quality(context.raw_data_folder / "quality.json", None, mission, details, sampled=self._sampled)

    def populate_run_data(self, context: RobotRunnerContext) -> None:
        """Publish the totals; no values where the tracker has none."""
        for problem in self._doubts():
            context.doubt(problem, fix="Look at the log of the run and at emissions.json.")
        if self._sampled is not None and self._data is not None:
            note_own_window(context, self._sampled, clock=machine_clock(context))
        publish_measures(context, self.measures, lambda _: self._totals(), origin=Origin.ESTIMATED)

    def _totals(self) -> Mapping[str, float | None]:
        data = self._data
        if data is None:
            return {}
        return {
            "Energy": data.energy_consumed * _JOULES,
            "Emissions": data.emissions,
            "CPUEnergy": data.cpu_energy * _JOULES,
            "MemoryEnergy": data.ram_energy * _JOULES,
        }

    def _doubts(self) -> Iterable[str]:
        if self._sampled is None:
            yield "nothing was estimated: the measurement was never started"
            return
        if self._data is None:
            yield "CodeCarbon said nothing"
            return
        difference = abs(self._data.duration - self._sampled.duration)
        if difference > max(_SLACK, self._sampled.duration * _TOLERANCE / 100):
            yield f"CodeCarbon tracked {self._data.duration:.1f} s of the {self._sampled.duration:.1f} s that it ran"
        if not self._data.country_name:
            yield f"CodeCarbon does not know the country {self.country!r} and reckoned with the world's electricity mix"


def started_tracker(kind: str, *arguments: Any, **settings: Any) -> Any:
    """Return a started tracker of the library; a `PluginError` says that it is not installed."""
    try:
        library = import_module("codecarbon")
    except ModuleNotFoundError as error:
        raise PluginError("codecarbon is not installed", where="CodeCarbon", fix=_INSTALL) from error
    tracker = getattr(library, kind)(*arguments, **settings)
    tracker.start()
    return tracker


def stop_tracker(tracker: Any) -> float | None:
    """Stop a tracker; returns the emissions, kg of CO2 equivalent.

    If its `stop` fails, the tracker starts a thread for each reading for as long as the process lives, so its
    schedulers are ended here in any case.
    """
    try:
        emissions: float | None = tracker.stop()
        return emissions
    finally:
        for name in ("_scheduler", "_scheduler_monitor_power"):
            scheduler = getattr(tracker, name, None)
            if scheduler is not None:
                scheduler.stop()
