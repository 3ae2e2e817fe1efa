"""The public API for authors and users of plugins.

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

from robot_runner.core.doors import open_door

TYPE_CHECKING = False
if TYPE_CHECKING:
    from robot_runner.core.errors import Finding as Finding
    from robot_runner.core.errors import GoalRejectedError as GoalRejectedError
    from robot_runner.core.errors import LinkError as LinkError
    from robot_runner.core.errors import PluginError as PluginError
    from robot_runner.core.events.context import RobotRunnerContext as RobotRunnerContext
    from robot_runner.core.events.measure import Measure as Measure
    from robot_runner.core.events.measure import Origin as Origin
    from robot_runner.core.events.measure import Over as Over
    from robot_runner.core.events.window import Phase as Phase
    from robot_runner.core.events.window import Window as Window
    from robot_runner.core.links.connect import connect_robot as connect_robot
    from robot_runner.core.links.connect import graph_variables as graph_variables
    from robot_runner.core.links.connect import open_robot as open_robot
    from robot_runner.core.links.goals import ActionAborted as ActionAborted
    from robot_runner.core.links.goals import ActionCanceled as ActionCanceled
    from robot_runner.core.links.goals import GoalStatus as GoalStatus
    from robot_runner.core.links.graph_names import GraphNeed as GraphNeed
    from robot_runner.core.plugin import Circumstances as Circumstances
    from robot_runner.core.plugin import Plugin as Plugin
    from robot_runner.core.plugin import Profiler as Profiler
    from robot_runner.core.plugin import System as System
    from robot_runner.core.storage.input_files import InputFile as InputFile
    from robot_runner.core.storage.input_files import input_file as input_file
    from robot_runner.core.treatments import treatment as treatment
    from robot_runner.measuring.device_clock import ClockMap as ClockMap
    from robot_runner.measuring.device_clock import fit_clock as fit_clock
    from robot_runner.measuring.devices import connect_host as connect_host
    from robot_runner.measuring.devices import open_serial_line as open_serial_line
    from robot_runner.measuring.evaluation import note_own_window as note_own_window
    from robot_runner.measuring.evaluation import publish_measures as publish_measures
    from robot_runner.measuring.measured_machine import Computer as Computer
    from robot_runner.measuring.periodic import PeriodicSampler as PeriodicSampler
    from robot_runner.measuring.periodic import Sampling as Sampling
    from robot_runner.measuring.quality import Column as Column
    from robot_runner.measuring.quality import Jitter as Jitter
    from robot_runner.measuring.quality import SampleQuality as SampleQuality
    from robot_runner.measuring.quality import quality_of as quality_of
    from robot_runner.measuring.quality import report_quality as report_quality
    from robot_runner.measuring.quality import write_quality as write_quality
    from robot_runner.measuring.quality import write_samples as write_samples
    from robot_runner.measuring.series import Series as Series
    from robot_runner.measuring.series import cut as cut
    from robot_runner.measuring.series import energy as energy
    from robot_runner.measuring.series import energy_from_mean_power as energy_from_mean_power
    from robot_runner.measuring.series import growth as growth
    from robot_runner.measuring.series import integrate as integrate
    from robot_runner.measuring.series import mean as mean
    from robot_runner.measuring.series import mean_of_intervals as mean_of_intervals
    from robot_runner.meters.electrical import ElectricalProfiler as ElectricalProfiler
    from robot_runner.meters.electrical_readings import ElectricalReading as ElectricalReading
    from robot_runner.meters.polled import Meter as Meter
    from robot_runner.meters.polled import PolledProfiler as PolledProfiler
    from robot_runner.ros.lifecycle import LifecycleState as LifecycleState
    from robot_runner.ros.lifecycle import bring_to as bring_to
    from robot_runner.ros.lifecycle import change_state as change_state
    from robot_runner.ros.lifecycle import state_of as state_of
    from robot_runner.ros.parameter_access import ParameterAccess as ParameterAccess
    from robot_runner.ros.parameter_access import parameters_of as parameters_of
    from robot_runner.ros.transform_buffer import TransformBuffer as TransformBuffer
    from robot_runner.ros.transforms import Transform as Transform
else:
    __getattr__, __dir__ = open_door(__name__)
