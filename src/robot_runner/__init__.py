"""Robot Runner: automatically execute measurement-based experiments on robotics software.

This is the door for who writes an experiment; its names are imported when they are first used.
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False  # `typing` takes long to import, and `robot-runner --help` is to be quick
if TYPE_CHECKING:
    from robot_runner.core.config.experiment import Author
    from robot_runner.core.config.parameters import ExperimentConfig, FailurePolicy, OperationType, RunProcess
    from robot_runner.core.design.analysis_plan import AnalysisPlan, Correction, Hypothesis
    from robot_runner.core.design.factor import Factor
    from robot_runner.core.design.run_table_model import RunTableModel
    from robot_runner.core.errors import RobotRunnerError
    from robot_runner.core.events.context import ExperimentContext, RobotRunnerContext
    from robot_runner.core.events.manager import EventSubscriptionController, RobotRunnerEvents
    from robot_runner.core.events.measure import Measure, Origin

__all__ = [
    "AnalysisPlan",
    "Author",
    "Correction",
    "EventSubscriptionController",
    "ExperimentConfig",
    "ExperimentContext",
    "Factor",
    "FailurePolicy",
    "Hypothesis",
    "Measure",
    "OperationType",
    "Origin",
    "RobotRunnerContext",
    "RobotRunnerError",
    "RobotRunnerEvents",
    "RunProcess",
    "RunTableModel",
]

_HOMES = {
    "AnalysisPlan": "robot_runner.core.design.analysis_plan",
    "Author": "robot_runner.core.config.experiment",
    "Correction": "robot_runner.core.design.analysis_plan",
    "Hypothesis": "robot_runner.core.design.analysis_plan",
    "EventSubscriptionController": "robot_runner.core.events.manager",
    "ExperimentConfig": "robot_runner.core.config.parameters",
    "ExperimentContext": "robot_runner.core.events.context",
    "Factor": "robot_runner.core.design.factor",
    "FailurePolicy": "robot_runner.core.config.parameters",
    "Measure": "robot_runner.core.events.measure",
    "OperationType": "robot_runner.core.config.parameters",
    "Origin": "robot_runner.core.events.measure",
    "RobotRunnerContext": "robot_runner.core.events.context",
    "RobotRunnerError": "robot_runner.core.errors",
    "RobotRunnerEvents": "robot_runner.core.events.manager",
    "RunProcess": "robot_runner.core.config.parameters",
    "RunTableModel": "robot_runner.core.design.run_table_model",
}


def __getattr__(name: str) -> object:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
