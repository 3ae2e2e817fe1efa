"""Robot Runner: automatically execute measurement-based experiments on robotics software.

The public API for authors of experiments; its names are imported when they are first used.
"""

from __future__ import annotations

from robot_runner.core.doors import open_door

TYPE_CHECKING = False
if TYPE_CHECKING:
    from robot_runner.conditions.bounds import measure_above as measure_above
    from robot_runner.conditions.bounds import measure_below as measure_below
    from robot_runner.conditions.combining import all_of as all_of
    from robot_runner.conditions.combining import any_of as any_of
    from robot_runner.conditions.combining import not_ as not_
    from robot_runner.conditions.computer_state import clock_offset_below as clock_offset_below
    from robot_runner.conditions.computer_state import load_above as load_above
    from robot_runner.conditions.computer_state import load_below as load_below
    from robot_runner.conditions.computer_state import temperature_above as temperature_above
    from robot_runner.conditions.computer_state import temperature_below as temperature_below
    from robot_runner.conditions.computers import host_answers as host_answers
    from robot_runner.conditions.computers import process_running as process_running
    from robot_runner.conditions.computers import throttled as throttled
    from robot_runner.conditions.graph_presence import lifecycle_state as lifecycle_state
    from robot_runner.conditions.graph_presence import node_present as node_present
    from robot_runner.conditions.graph_presence import service_present as service_present
    from robot_runner.conditions.graph_presence import topic_present as topic_present
    from robot_runner.conditions.network_answers import http_answers as http_answers
    from robot_runner.conditions.network_answers import port_open as port_open
    from robot_runner.conditions.outputs import file_complete as file_complete
    from robot_runner.conditions.outputs import text_in as text_in
    from robot_runner.conditions.person import confirmed as confirmed
    from robot_runner.conditions.topic_messages import battery_above as battery_above
    from robot_runner.conditions.topic_messages import battery_below as battery_below
    from robot_runner.conditions.topic_messages import message_on as message_on
    from robot_runner.conditions.topic_messages import topic_above as topic_above
    from robot_runner.conditions.topic_messages import topic_below as topic_below
    from robot_runner.core.config.authors import Author as Author
    from robot_runner.core.config.gate_parameters import Gate as Gate
    from robot_runner.core.config.gate_parameters import GatePolicy as GatePolicy
    from robot_runner.core.config.gate_parameters import Guard as Guard
    from robot_runner.core.config.gate_parameters import GuardAction as GuardAction
    from robot_runner.core.config.notify import Notify as Notify
    from robot_runner.core.config.operator_steps import OperatorStep as OperatorStep
    from robot_runner.core.config.operator_steps import Question as Question
    from robot_runner.core.config.operator_steps import Scale as Scale
    from robot_runner.core.config.parameters import BadValuePolicy as BadValuePolicy
    from robot_runner.core.config.parameters import ExperimentConfig as ExperimentConfig
    from robot_runner.core.config.parameters import FailurePolicy as FailurePolicy
    from robot_runner.core.config.parameters import OperationType as OperationType
    from robot_runner.core.config.parameters import RunProcess as RunProcess
    from robot_runner.core.design.analysis_plan import AnalysisPlan as AnalysisPlan
    from robot_runner.core.design.analysis_plan import Correction as Correction
    from robot_runner.core.design.analysis_plan import Estimand as Estimand
    from robot_runner.core.design.analysis_plan import Family as Family
    from robot_runner.core.design.analysis_plan import Statistic as Statistic
    from robot_runner.core.design.factor import Factor as Factor
    from robot_runner.core.design.hypothesis import Hypothesis as Hypothesis
    from robot_runner.core.design.numeric_range import Range as Range
    from robot_runner.core.design.outliers import Doubtful as Doubtful
    from robot_runner.core.design.outliers import Outliers as Outliers
    from robot_runner.core.design.precision import PreciseOf as PreciseOf
    from robot_runner.core.design.precision import Precision as Precision
    from robot_runner.core.design.run_table_model import RunTableModel as RunTableModel
    from robot_runner.core.design.warm_up import WarmUp as WarmUp
    from robot_runner.core.errors import CommandError as CommandError
    from robot_runner.core.errors import ConditionError as ConditionError
    from robot_runner.core.errors import ConditionTimeout as ConditionTimeout
    from robot_runner.core.errors import ConfigError as ConfigError
    from robot_runner.core.errors import ExecutionError as ExecutionError
    from robot_runner.core.errors import RobotRunnerError as RobotRunnerError
    from robot_runner.core.events.condition import Condition as Condition
    from robot_runner.core.events.condition import Look as Look
    from robot_runner.core.events.context import ExperimentContext as ExperimentContext
    from robot_runner.core.events.context import ExperimentEnd as ExperimentEnd
    from robot_runner.core.events.context import NextRun as NextRun
    from robot_runner.core.events.context import RobotRunnerContext as RobotRunnerContext
    from robot_runner.core.events.manager import EventSubscriptionController as EventSubscriptionController
    from robot_runner.core.events.manager import RobotRunnerEvents as RobotRunnerEvents
    from robot_runner.core.events.measure import Measure as Measure
    from robot_runner.core.events.measure import Origin as Origin
    from robot_runner.core.events.resources import CommandResult as CommandResult
    from robot_runner.core.links.declared_host import Host as Host
    from robot_runner.core.links.declared_host import Reboot as Reboot
    from robot_runner.core.links.robot_name import Robots as Robots
    from robot_runner.core.treatments import treatment as treatment
    from robot_runner.core.words import INACTIVE as INACTIVE
    from robot_runner.notebook.from_python import ExperimentResults as ExperimentResults
    from robot_runner.notebook.from_python import run_experiment as run_experiment
else:
    __getattr__, __dir__ = open_door(__name__)
