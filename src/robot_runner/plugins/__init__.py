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
    from robot_runner.errors import Finding, LinkError, PluginError
    from robot_runner.events.context import RobotRunnerContext
    from robot_runner.events.measure import Measure, Origin
    from robot_runner.links.connect import connect_host, connect_robot, open_serial_line
    from robot_runner.plugins.api.plugin import Circumstances, Plugin, Profiler, System
    from robot_runner.plugins.sampling.device_clock import ClockMap, fit_clock
    from robot_runner.plugins.sampling.integration import (
        energy,
        energy_from_mean_power,
        integrate,
        mean,
        mean_of_intervals,
    )
    from robot_runner.plugins.sampling.periodic import PeriodicSampler, Sampling
    from robot_runner.plugins.sampling.quality import Jitter, SampleQuality, quality_of
    from robot_runner.plugins.sampling.raw_files import Column, write_quality, write_samples
    from robot_runner.plugins.sampling.reporting import report_quality
    from robot_runner.plugins.sampling.series import Series
    from robot_runner.plugins.sampling.window import Window, cut

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
    "Circumstances": "robot_runner.plugins.api.plugin",
    "ClockMap": "robot_runner.plugins.sampling.device_clock",
    "Column": "robot_runner.plugins.sampling.raw_files",
    "Finding": "robot_runner.errors",
    "Jitter": "robot_runner.plugins.sampling.quality",
    "LinkError": "robot_runner.errors",
    "Measure": "robot_runner.events.measure",
    "Origin": "robot_runner.events.measure",
    "PeriodicSampler": "robot_runner.plugins.sampling.periodic",
    "Plugin": "robot_runner.plugins.api.plugin",
    "PluginError": "robot_runner.errors",
    "Profiler": "robot_runner.plugins.api.plugin",
    "RobotRunnerContext": "robot_runner.events.context",
    "SampleQuality": "robot_runner.plugins.sampling.quality",
    "Sampling": "robot_runner.plugins.sampling.periodic",
    "Series": "robot_runner.plugins.sampling.series",
    "System": "robot_runner.plugins.api.plugin",
    "Window": "robot_runner.plugins.sampling.window",
    "connect_host": "robot_runner.links.connect",
    "connect_robot": "robot_runner.links.connect",
    "cut": "robot_runner.plugins.sampling.window",
    "energy": "robot_runner.plugins.sampling.integration",
    "energy_from_mean_power": "robot_runner.plugins.sampling.integration",
    "fit_clock": "robot_runner.plugins.sampling.device_clock",
    "integrate": "robot_runner.plugins.sampling.integration",
    "mean": "robot_runner.plugins.sampling.integration",
    "mean_of_intervals": "robot_runner.plugins.sampling.integration",
    "open_serial_line": "robot_runner.links.connect",
    "quality_of": "robot_runner.plugins.sampling.quality",
    "report_quality": "robot_runner.plugins.sampling.reporting",
    "write_quality": "robot_runner.plugins.sampling.raw_files",
    "write_samples": "robot_runner.plugins.sampling.raw_files",
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
