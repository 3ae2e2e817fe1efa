"""The plugins of the earlier tools: their modules, their requirements, and our plugins that measure the same.

To add a plugin, add a line to this table only: it makes the module importable, checked and documented.
"""

from __future__ import annotations

import ctypes.util
import importlib.util
import shutil
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

_HERE = "robot_runner.legacy.profilers"


@dataclass(frozen=True, slots=True)
class Need:
    """A requirement of a plugin.

    Attributes:
        what: a noun, such as `the program ps`.
        is_there: returns whether it is installed, without changing anything.
        fix: a sentence in the imperative that says how to install it.
    """

    what: str
    is_there: Callable[[], bool]
    fix: str


@dataclass(frozen=True, slots=True)
class EarlierPlugin:
    """A plugin of an earlier tool.

    Attributes:
        modules: the modules from which configs import it; the first is the newest.
        names: the imported names, each with its home as `module:name`; empty if it has no stand-in.
        needs: its requirements.
        ours: our plugin that measures or does the same, by its name in `robot-runner plugins`; empty if there is none.
        note: a hint for users: one sentence.
        operates_robot: whether it operates a robot, by default the one that is found.
    """

    modules: tuple[str, ...]
    names: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    needs: tuple[Need, ...] = ()
    ours: str = ""
    note: str = ""
    operates_robot: bool = False

    @property
    def name(self) -> str:
        """Its name: the last part of its newest module."""
        return self.modules[0].rpartition(".")[2]


def _program(name: str, fix: str) -> Need:
    return Need(f"the program {name}", lambda: shutil.which(name) is not None, fix)


def _package(module: str, fix: str) -> Need:
    return Need(f"the Python package {module}", lambda: importlib.util.find_spec(module) is not None, fix)


def _library(name: str, fix: str) -> Need:
    return Need(f"the library {name}", lambda: ctypes.util.find_library(name) is not None, fix)


def _platform(name: str, shown: str) -> Need:
    return Need(f"a machine with {shown}", lambda: sys.platform == name, f"Execute the experiment on {shown}.")


def _names(module: str, *names: str) -> dict[str, str]:
    return {name: f"{_HERE}.{module}:{name}" for name in names}


def _profiler(name: str) -> tuple[str, ...]:
    return (f"Plugins.Profilers.{name}", f"plugins.Profilers.{name}")


_ROS = "Its place is taken by our system plugin BasicTurtlebot3, which speaks to real and simulated robots."

_OF_NVML = (
    "NVML_IDs NVML_Query NVML_Static_Query NVML_Dynamic_Query NVML_Field NVML_Sample NVML_Clock NVML_PowerSource "
    "NVML_Arch NVML_TempThreshold NVML_API_Restriction NVML_Enable_State NVML_Compute_Mode NVML_GPU_Operation_Mode"
)
_OF_CODECARBON = (
    "DataColumns emission_tracker start_emission_tracker stop_emission_tracker add_data_columns populate_data_columns "
    "add_co2_data_column populate_co2_data"
)
_OF_TURTLEBOT3 = (
    "movement.MovementController movement.RotationDirection recording.MetricsRecorder sensors.BatterySensor "
    "sensors.CPUSensor sensors.CameraSensor sensors.OdomSensor sensors.RAMSensor utilties.Utilities"
)

PLUGINS: tuple[EarlierPlugin, ...] = (
    EarlierPlugin(
        (*_profiler("Ps"), *_profiler("PS")),
        _names("command_line", "Ps"),
        (_platform("linux", "Linux"), _program("ps", "Install procps."), _program("awk", "Install an awk.")),
        ours="PsUtil",
        note="%cpu of ps is the time on the processor over the life of a process, not its utilisation at a moment.",
    ),
    EarlierPlugin(
        _profiler("PowerJoular"),
        _names("command_line", "PowerJoular"),
        (_platform("linux", "Linux"), _program("powerjoular", "Install PowerJoular (github.com/joular/powerjoular).")),
        ours="PowerJoular",
    ),
    EarlierPlugin(
        _profiler("EnergiBridge"),
        _names("command_line", "EnergiBridge"),
        (_program("energibridge", "Build EnergiBridge (github.com/tdurieux/EnergiBridge), and put it on the PATH."),),
        ours="EnergiBridge",
    ),
    EarlierPlugin(
        _profiler("PowerMetrics"),
        _names("command_line", "PowerMetrics", "PMFormatTypes", "PMOrderTypes", "PMSampleTypes"),
        (_platform("darwin", "macOS"), _program("powermetrics", "Execute the experiment on macOS.")),
        ours="Powermetrics",
    ),
    EarlierPlugin(
        _profiler("PowerLetrics"),
        _names("command_line", "PowerLetrics", "PLFormatTypes", "PLOrderTypes"),
        (_platform("linux", "Linux"), _program("powerletrics", "Install it: pip install powerletrics.")),
        ours="CommandProfiler",
    ),
    EarlierPlugin(
        _profiler("NvidiaML"),
        _names("nvidia", "NvidiaML", *_OF_NVML.split()),
        (
            _package("pynvml", "Install it: pip install 'robot-runner[nvml]'."),
            _library("nvidia-ml", "Install NVIDIA's driver, and see that `nvidia-smi` works."),
        ),
        ours="Nvml",
    ),
    EarlierPlugin(
        _profiler("WattsUpPro"),
        _names("wall_socket", "WattsUpPro"),
        (_package("serial", "Install it: pip install 'robot-runner[serial]'."),),
        ours="WattsUpPro",
    ),
    EarlierPlugin(
        _profiler("PicoCM3"),
        _names("pico", "PicoCM3", "CM3Channels", "CM3DataTypes", "CM3MainsTypes"),
        (_library("plcm3", "Install Pico Technology's drivers, or put them on LD_LIBRARY_PATH."),),
    ),
    EarlierPlugin(
        (*_profiler("CodecarbonWrapper"), "Plugins.CodecarbonWrapper"),
        _names("emissions", *_OF_CODECARBON.split()),
        (_package("codecarbon", "Install it: pip install 'robot-runner[codecarbon]'."),),
        ours="CodeCarbon",
    ),
    EarlierPlugin(
        _profiler("DataSource"),
        _names("data_source", "DataSource", "CLISource", "DeviceSource", "ParameterDict", "ValueRef"),
        ours="CommandProfiler",
    ),
    EarlierPlugin(
        _profiler("INA219Profiler"),
        _names("robot_plugins", "INA219Profiler"),
        ours="Ina219",
        note="It takes the file of a memory card; Ina219 reads the sensor itself, and computes the energy.",
    ),
    EarlierPlugin(
        _profiler("NetworkProfiler"),
        _names("robot_plugins", "NetworkProfiler"),
        (_program("tshark", "Install tshark."),),
        ours="Network",
    ),
    EarlierPlugin(
        ("Plugins.Systems.TopicSubscriber", "plugins.Systems.TopicSubscriber"),
        _names("robot_plugins", "TopicSubscriber"),
        operates_robot=True,
    ),
    EarlierPlugin(
        (
            "Plugins.Systems.TurtleBot3.BasicTurtleBot3",
            "plugins.Systems.TurtleBot3.BasicTurtleBot3",
            "Plugins.Systems.BasicTurtleBot3",
        ),
        _names("robot_plugins", "BasicTurtleBot3"),
        ours="BasicTurtlebot3",
        operates_robot=True,
    ),
    EarlierPlugin(
        ("Plugins.Systems.TurtleBot3.BasicTurtleBot3Ros2",),
        _names("robot_plugins", "BasicTurtleBot3Ros2"),
        ours="BasicTurtlebot3",
        operates_robot=True,
    ),
    # Modules without a stand-in.
    *(
        EarlierPlugin((f"Plugins.Systems.TurtleBot3.modules.{module}",), ours="BasicTurtlebot3", note=_ROS)
        for module in _OF_TURTLEBOT3.split()
    ),
    EarlierPlugin(("Plugins.Profilers.picosdk",), note="PicoCM3 calls the library of its maker without these modules."),
    EarlierPlugin(
        ("Plugins.Recording",), note="Robot Runner had it for some weeks, and nothing in it worked by itself."
    ),
)

#: The names of each module with a stand-in, each with its home as `module:name`.
PLUGIN_MODULES: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {module: plugin.names for plugin in PLUGINS if plugin.names for module in plugin.modules}
)

_BY_MODULE = {module: plugin for plugin in PLUGINS for module in plugin.modules}


def plugin_of(module: str) -> EarlierPlugin | None:
    """Return the plugin that a module belongs to, or None.

    Example:
        >>> plugin_of("Plugins.CodecarbonWrapper").ours
        'CodeCarbon'
    """
    while module:
        if module in _BY_MODULE:
            return _BY_MODULE[module]
        module = module.rpartition(".")[0]
    return None
