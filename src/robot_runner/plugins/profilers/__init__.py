"""The built-in plugins that measure, and what a `CommandProfiler` and a `PowerModel` are told."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robot_runner.plugins.profilers.battery import Battery
    from robot_runner.plugins.profilers.codecarbon import CodeCarbon
    from robot_runner.plugins.profilers.command import CommandProfiler
    from robot_runner.plugins.profilers.command_output import Aggregate, CommandColumn, TimeColumn, TimeKind, parse_csv
    from robot_runner.plugins.profilers.energibridge import EnergiBridge
    from robot_runner.plugins.profilers.ina219.profiler import Ina219
    from robot_runner.plugins.profilers.linux_thermal import LinuxThermal
    from robot_runner.plugins.profilers.network import Network
    from robot_runner.plugins.profilers.nvml import Nvml
    from robot_runner.plugins.profilers.perf_stat import PerfStat
    from robot_runner.plugins.profilers.power_model.profiler import PowerModel
    from robot_runner.plugins.profilers.power_model.states import RobotState
    from robot_runner.plugins.profilers.powerjoular import PowerJoular
    from robot_runner.plugins.profilers.powermetrics import Powermetrics
    from robot_runner.plugins.profilers.psutil import PsUtil
    from robot_runner.plugins.profilers.rapl import Rapl
    from robot_runner.plugins.profilers.ros_bag.profiler import RosBag
    from robot_runner.plugins.profilers.ros_graph import RosGraph
    from robot_runner.plugins.profilers.ros_topics import RosTopics
    from robot_runner.plugins.profilers.watts_up_pro import WattsUpPro

__all__ = [
    "Aggregate",
    "Battery",
    "CodeCarbon",
    "CommandColumn",
    "CommandProfiler",
    "EnergiBridge",
    "Ina219",
    "LinuxThermal",
    "Network",
    "Nvml",
    "PerfStat",
    "PowerJoular",
    "PowerModel",
    "Powermetrics",
    "PsUtil",
    "Rapl",
    "RobotState",
    "RosBag",
    "RosGraph",
    "RosTopics",
    "TimeColumn",
    "TimeKind",
    "WattsUpPro",
    "parse_csv",
]

_HOMES = {
    "Aggregate": "robot_runner.plugins.profilers.command_output",
    "Battery": "robot_runner.plugins.profilers.battery",
    "CodeCarbon": "robot_runner.plugins.profilers.codecarbon",
    "CommandColumn": "robot_runner.plugins.profilers.command_output",
    "CommandProfiler": "robot_runner.plugins.profilers.command",
    "EnergiBridge": "robot_runner.plugins.profilers.energibridge",
    "Ina219": "robot_runner.plugins.profilers.ina219.profiler",
    "LinuxThermal": "robot_runner.plugins.profilers.linux_thermal",
    "Network": "robot_runner.plugins.profilers.network",
    "Nvml": "robot_runner.plugins.profilers.nvml",
    "PerfStat": "robot_runner.plugins.profilers.perf_stat",
    "PowerJoular": "robot_runner.plugins.profilers.powerjoular",
    "PowerModel": "robot_runner.plugins.profilers.power_model.profiler",
    "Powermetrics": "robot_runner.plugins.profilers.powermetrics",
    "PsUtil": "robot_runner.plugins.profilers.psutil",
    "Rapl": "robot_runner.plugins.profilers.rapl",
    "RobotState": "robot_runner.plugins.profilers.power_model.states",
    "RosBag": "robot_runner.plugins.profilers.ros_bag.profiler",
    "RosGraph": "robot_runner.plugins.profilers.ros_graph",
    "RosTopics": "robot_runner.plugins.profilers.ros_topics",
    "TimeColumn": "robot_runner.plugins.profilers.command_output",
    "TimeKind": "robot_runner.plugins.profilers.command_output",
    "WattsUpPro": "robot_runner.plugins.profilers.watts_up_pro",
    "parse_csv": "robot_runner.plugins.profilers.command_output",
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
