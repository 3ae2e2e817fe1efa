"""The names that configs take from Experiment Runner's NvidiaML: queries, and the constants of NVIDIA's library."""
# ruff: noqa: N801 - the names are those that configs import

from __future__ import annotations

import re
from enum import Enum
from importlib import import_module
from typing import Any

from robot_runner.errors import PluginError

__all__ = [
    "NVML_API_Restriction",
    "NVML_Arch",
    "NVML_Clock",
    "NVML_Compute_Mode",
    "NVML_Dynamic_Query",
    "NVML_Enable_State",
    "NVML_Field",
    "NVML_GPU_Operation_Mode",
    "NVML_IDs",
    "NVML_PowerSource",
    "NVML_Query",
    "NVML_Sample",
    "NVML_Static_Query",
    "NVML_TempThreshold",
    "library",
]

_STATIC = (
    "Name UUID Serial Index Architecture NumGpuCores VbiosVersion Brand NumFans MemoryInfo BusType BoardId Attributes "
    "BoardPartNumber MinMaxFanSpeed ComputeMode PersistenceMode PowerManagementMode EnforcedPowerLimit "
    "PowerManagementLimit PowerManagementDefaultLimit PowerManagementLimitConstraints MaxCustomerBoostClock "
    "PowerSource TargetFanSpeed TemperatureThreshold SupportedPerformanceStates MaxClockInfo MinMaxClockOfPState"
)
_DYNAMIC = "PowerUsage TotalEnergyConsumption Temperature FanSpeed_v2 UtilizationRates PerformanceState ClockInfo"
_WORD = re.compile(r"[A-Z](?:[a-z]+|[A-Z]*(?=[A-Z]|$))")


def library() -> Any:
    """Return NVIDIA's library.

    Raises:
        PluginError: its package is not installed.
    """
    try:
        return import_module("pynvml")
    except ModuleNotFoundError as error:
        raise PluginError(
            "NvidiaML needs nvidia-ml-py", where="NvidiaML", fix="Install it: pip install 'robot-runner[nvml]'."
        ) from error


class NVML_Query(Enum):
    """What both kinds of queries are."""


class NVML_IDs(Enum):
    """How a GPU is named."""

    NVML_ID_INDEX = 0
    NVML_ID_SERIAL = 1
    NVML_ID_UUID = 2


def _queries(name: str, functions: str) -> type[Enum]:
    """Return an enumeration of queries: `PowerUsage` is NVML_POWER_USAGE."""
    members = [
        ("NVML_" + "_".join(word.upper() for word in _WORD.findall(function.partition("_")[0])), function)
        for function in functions.split()
    ]
    kind: Any = NVML_Query
    made: type[Enum] = kind(name, members)
    return made


NVML_Static_Query: Any = _queries("NVML_Static_Query", _STATIC)
NVML_Dynamic_Query: Any = _queries("NVML_Dynamic_Query", _DYNAMIC)


class _Constant:
    """A constant of NVIDIA's library; what it is called in a log is its name without prefix, in lower case."""

    def __init__(self, name: str, prefix: str, value: Any) -> None:
        self.name = name.removeprefix(prefix).lower()
        self.value = value

    def __repr__(self) -> str:
        return self.name


class _Constants:
    """The constants of NVIDIA's library that begin with a prefix; looked up when they are used."""

    def __init__(self, prefix: str) -> None:
        self._prefix = prefix
        self._known: dict[str, _Constant] = {}

    def __getattr__(self, name: str) -> _Constant:
        if name.startswith("__"):
            raise AttributeError(name)
        if name not in self._known:
            self._known[name] = _Constant(name, self._prefix, getattr(library(), name))
        return self._known[name]


NVML_Field = _Constants("NVML_FI_DEV_")
NVML_Sample = _Constants("NVML_")
NVML_Clock = _Constants("NVML_CLOCK_")
NVML_PowerSource = _Constants("NVML_POWER_SOURCE_")
NVML_Arch = _Constants("NVML_DEVICE_ARCH_")
NVML_TempThreshold = _Constants("NVML_TEMPERATURE_THRESHOLD_")
NVML_API_Restriction = _Constants("NVML_RESTRICTED_API_SET_")
NVML_Enable_State = _Constants("NVML_FEATURE_")
NVML_Compute_Mode = _Constants("NVML_COMPUTEMODE_")
NVML_GPU_Operation_Mode = _Constants("NVML_GOM_")
