"""Robot Runner: automatically execute measurement-based experiments on robotics software.

The public API for authors of experiments; its names are imported when they are first used.
"""

from __future__ import annotations

from robot_runner.core.doors import open_door

TYPE_CHECKING = False
if TYPE_CHECKING:
    from robot_runner.core.config.authors import Author as Author
    from robot_runner.core.config.parameters import BadValuePolicy as BadValuePolicy
    from robot_runner.core.config.parameters import ExperimentConfig as ExperimentConfig
    from robot_runner.core.config.parameters import FailurePolicy as FailurePolicy
    from robot_runner.core.config.parameters import OperationType as OperationType
    from robot_runner.core.config.parameters import RunProcess as RunProcess
    from robot_runner.core.design.analysis_plan import AnalysisPlan as AnalysisPlan
    from robot_runner.core.design.analysis_plan import Correction as Correction
    from robot_runner.core.design.analysis_plan import Estimand as Estimand
    from robot_runner.core.design.analysis_plan import Family as Family
    from robot_runner.core.design.analysis_plan import Hypothesis as Hypothesis
    from robot_runner.core.design.analysis_plan import Statistic as Statistic
    from robot_runner.core.design.factor import Factor as Factor
    from robot_runner.core.design.run_table_model import RunTableModel as RunTableModel
    from robot_runner.core.errors import RobotRunnerError as RobotRunnerError
    from robot_runner.core.events.context import ExperimentContext as ExperimentContext
    from robot_runner.core.events.context import RobotRunnerContext as RobotRunnerContext
    from robot_runner.core.events.manager import EventSubscriptionController as EventSubscriptionController
    from robot_runner.core.events.manager import RobotRunnerEvents as RobotRunnerEvents
    from robot_runner.core.events.measure import Measure as Measure
    from robot_runner.core.events.measure import Origin as Origin
    from robot_runner.core.treatments import treatment as treatment
else:
    __getattr__, __dir__ = open_door(__name__)
