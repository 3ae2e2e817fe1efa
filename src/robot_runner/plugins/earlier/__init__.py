"""Profilers of Experiment Runner that need nothing of the tool around them, for configs that were converted.

They keep their own calls (`start`, `stop`, `parse_log`). Ours of the same names start, stop and publish by themselves:
`robot_runner.plugins.profilers`.
"""

from __future__ import annotations

from robot_runner.core.doors import open_door

TYPE_CHECKING = False
if TYPE_CHECKING:
    from robot_runner.legacy.profilers.command_line import EnergiBridge as EnergiBridge
    from robot_runner.legacy.profilers.command_line import PLFormatTypes as PLFormatTypes
    from robot_runner.legacy.profilers.command_line import PLOrderTypes as PLOrderTypes
    from robot_runner.legacy.profilers.command_line import PMFormatTypes as PMFormatTypes
    from robot_runner.legacy.profilers.command_line import PMOrderTypes as PMOrderTypes
    from robot_runner.legacy.profilers.command_line import PMSampleTypes as PMSampleTypes
    from robot_runner.legacy.profilers.command_line import PowerJoular as PowerJoular
    from robot_runner.legacy.profilers.command_line import PowerLetrics as PowerLetrics
    from robot_runner.legacy.profilers.command_line import PowerMetrics as PowerMetrics
    from robot_runner.legacy.profilers.command_line import Ps as Ps
    from robot_runner.legacy.profilers.data_source import CLISource as CLISource
    from robot_runner.legacy.profilers.data_source import DataSource as DataSource
    from robot_runner.legacy.profilers.data_source import DeviceSource as DeviceSource
    from robot_runner.legacy.profilers.data_source import ParameterDict as ParameterDict
    from robot_runner.legacy.profilers.data_source import ValueRef as ValueRef
    from robot_runner.legacy.profilers.nvidia import NvidiaML as NvidiaML
    from robot_runner.legacy.profilers.nvidia import NVML_API_Restriction as NVML_API_Restriction
    from robot_runner.legacy.profilers.nvidia import NVML_Arch as NVML_Arch
    from robot_runner.legacy.profilers.nvidia import NVML_Clock as NVML_Clock
    from robot_runner.legacy.profilers.nvidia import NVML_Compute_Mode as NVML_Compute_Mode
    from robot_runner.legacy.profilers.nvidia import NVML_Dynamic_Query as NVML_Dynamic_Query
    from robot_runner.legacy.profilers.nvidia import NVML_Enable_State as NVML_Enable_State
    from robot_runner.legacy.profilers.nvidia import NVML_Field as NVML_Field
    from robot_runner.legacy.profilers.nvidia import NVML_GPU_Operation_Mode as NVML_GPU_Operation_Mode
    from robot_runner.legacy.profilers.nvidia import NVML_IDs as NVML_IDs
    from robot_runner.legacy.profilers.nvidia import NVML_PowerSource as NVML_PowerSource
    from robot_runner.legacy.profilers.nvidia import NVML_Query as NVML_Query
    from robot_runner.legacy.profilers.nvidia import NVML_Sample as NVML_Sample
    from robot_runner.legacy.profilers.nvidia import NVML_Static_Query as NVML_Static_Query
    from robot_runner.legacy.profilers.nvidia import NVML_TempThreshold as NVML_TempThreshold
    from robot_runner.legacy.profilers.pico import CM3Channels as CM3Channels
    from robot_runner.legacy.profilers.pico import CM3DataTypes as CM3DataTypes
    from robot_runner.legacy.profilers.pico import CM3MainsTypes as CM3MainsTypes
    from robot_runner.legacy.profilers.pico import PicoCM3 as PicoCM3
else:
    __getattr__, __dir__ = open_door(__name__)
