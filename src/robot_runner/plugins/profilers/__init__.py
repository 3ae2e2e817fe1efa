"""The built-in plugins that measure, and what a `CommandProfiler` and a `PowerModel` are told."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robot_runner.meters.battery import Battery
    from robot_runner.meters.codecarbon import CodeCarbon
    from robot_runner.meters.command import CommandProfiler
    from robot_runner.meters.command_meters import EnergiBridge, PowerJoular, Powermetrics
    from robot_runner.meters.command_output import Aggregate, CommandColumn, TimeColumn, TimeKind, parse_csv
    from robot_runner.meters.ina219.card import CardRecording, read_card
    from robot_runner.meters.ina219.profiler import Ina219
    from robot_runner.meters.linux_thermal import LinuxThermal
    from robot_runner.meters.network import Network
    from robot_runner.meters.nvml import Nvml
    from robot_runner.meters.perf_stat import PerfStat
    from robot_runner.meters.power_model.power_model import PowerModel
    from robot_runner.meters.power_model.states import RobotState
    from robot_runner.meters.psutil import PsUtil
    from robot_runner.meters.rapl import Rapl
    from robot_runner.meters.watts_up_pro import WattsUpPro
    from robot_runner.ros.ros_bag import RosBag
    from robot_runner.ros.ros_graph import RosGraph
    from robot_runner.ros.ros_topics import RosTopics

__all__ = [
    "Aggregate",
    "Battery",
    "CardRecording",
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
    "read_card",
]

_HOMES = {
    "Aggregate": "robot_runner.meters.command_output",
    "Battery": "robot_runner.meters.battery",
    "CardRecording": "robot_runner.meters.ina219.card",
    "CodeCarbon": "robot_runner.meters.codecarbon",
    "CommandColumn": "robot_runner.meters.command_output",
    "CommandProfiler": "robot_runner.meters.command",
    "EnergiBridge": "robot_runner.meters.command_meters",
    "Ina219": "robot_runner.meters.ina219.profiler",
    "LinuxThermal": "robot_runner.meters.linux_thermal",
    "Network": "robot_runner.meters.network",
    "Nvml": "robot_runner.meters.nvml",
    "PerfStat": "robot_runner.meters.perf_stat",
    "PowerJoular": "robot_runner.meters.command_meters",
    "PowerModel": "robot_runner.meters.power_model.power_model",
    "Powermetrics": "robot_runner.meters.command_meters",
    "PsUtil": "robot_runner.meters.psutil",
    "Rapl": "robot_runner.meters.rapl",
    "RobotState": "robot_runner.meters.power_model.states",
    "RosBag": "robot_runner.ros.ros_bag",
    "RosGraph": "robot_runner.ros.ros_graph",
    "RosTopics": "robot_runner.ros.ros_topics",
    "TimeColumn": "robot_runner.meters.command_output",
    "TimeKind": "robot_runner.meters.command_output",
    "WattsUpPro": "robot_runner.meters.watts_up_pro",
    "parse_csv": "robot_runner.meters.command_output",
    "read_card": "robot_runner.meters.ina219.card",
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
