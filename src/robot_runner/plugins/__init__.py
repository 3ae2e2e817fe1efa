"""The door for who writes or picks a plugin.

Built-in plugins are in `robot_runner.plugins.systems` and `robot_runner.plugins.profilers`; how to test a plugin is in
`robot_runner.testing`.

Example:
    >>> from robot_runner.plugins import Measure, Profiler
    >>> class Thermometer(Profiler):
    ...     measures = (Measure("Temperature", "K", "Temperature of the battery at the end of the mission."),)
    ...     def populate_run_data(self, context):
    ...         context.publish("Temperature", 301.5)
    >>> Thermometer(name="battery").name
    'battery'
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robot_runner.core.errors import Finding, LinkError, PluginError
    from robot_runner.core.events.context import RobotRunnerContext
    from robot_runner.core.events.measure import Measure, Origin
    from robot_runner.core.links.connect import connect_host, connect_robot, open_serial_line
    from robot_runner.core.plugin import Circumstances, Plugin, Profiler, System
    from robot_runner.core.sampling.device_clock import ClockMap, fit_clock
    from robot_runner.core.sampling.periodic import PeriodicSampler, Sampling
    from robot_runner.core.sampling.quality import (
        Column,
        Jitter,
        SampleQuality,
        quality_of,
        report_quality,
        write_quality,
        write_samples,
    )
    from robot_runner.core.sampling.series import (
        Series,
        Window,
        cut,
        energy,
        energy_from_mean_power,
        integrate,
        mean,
        mean_of_intervals,
    )

__all__ = [
    "Circumstances",
    "ClockMap",
    "Column",
    "Finding",
    "Jitter",
    "LinkError",
    "Measure",
    "Origin",
    "PeriodicSampler",
    "Plugin",
    "PluginError",
    "Profiler",
    "RobotRunnerContext",
    "SampleQuality",
    "Sampling",
    "Series",
    "System",
    "Window",
    "connect_host",
    "connect_robot",
    "cut",
    "energy",
    "energy_from_mean_power",
    "fit_clock",
    "integrate",
    "mean",
    "mean_of_intervals",
    "open_serial_line",
    "quality_of",
    "report_quality",
    "write_quality",
    "write_samples",
]

_HOMES = {
    "Circumstances": "robot_runner.core.plugin",
    "ClockMap": "robot_runner.core.sampling.device_clock",
    "Column": "robot_runner.core.sampling.quality",
    "Finding": "robot_runner.core.errors",
    "Jitter": "robot_runner.core.sampling.quality",
    "LinkError": "robot_runner.core.errors",
    "Measure": "robot_runner.core.events.measure",
    "Origin": "robot_runner.core.events.measure",
    "PeriodicSampler": "robot_runner.core.sampling.periodic",
    "Plugin": "robot_runner.core.plugin",
    "PluginError": "robot_runner.core.errors",
    "Profiler": "robot_runner.core.plugin",
    "RobotRunnerContext": "robot_runner.core.events.context",
    "SampleQuality": "robot_runner.core.sampling.quality",
    "Sampling": "robot_runner.core.sampling.periodic",
    "Series": "robot_runner.core.sampling.series",
    "System": "robot_runner.core.plugin",
    "Window": "robot_runner.core.sampling.series",
    "connect_host": "robot_runner.core.links.connect",
    "connect_robot": "robot_runner.core.links.connect",
    "cut": "robot_runner.core.sampling.series",
    "energy": "robot_runner.core.sampling.series",
    "energy_from_mean_power": "robot_runner.core.sampling.series",
    "fit_clock": "robot_runner.core.sampling.device_clock",
    "integrate": "robot_runner.core.sampling.series",
    "mean": "robot_runner.core.sampling.series",
    "mean_of_intervals": "robot_runner.core.sampling.series",
    "open_serial_line": "robot_runner.core.links.connect",
    "quality_of": "robot_runner.core.sampling.quality",
    "report_quality": "robot_runner.core.sampling.quality",
    "write_quality": "robot_runner.core.sampling.quality",
    "write_samples": "robot_runner.core.sampling.quality",
}


def __getattr__(name: str) -> object:
    """Import a name when it is first asked for, so that importing one of the submodules stays cheap."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(import_module(_HOMES[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return __all__
