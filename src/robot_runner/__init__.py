"""Robot Runner: automatically execute measurement-based experiments on robotics software.

This is the door for who writes an experiment; its names are imported when they are first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from robot_runner.config.authors import Author
    from robot_runner.config.choices import FailurePolicy, OperationType, RunProcess
    from robot_runner.config.experiment_config import ExperimentConfig
    from robot_runner.design.analysis_plan import AnalysisPlan, Correction, Hypothesis
    from robot_runner.design.factor import Factor
    from robot_runner.design.run_table_model import RunTableModel
    from robot_runner.errors import RobotRunnerError
    from robot_runner.events.context import ExperimentContext, RobotRunnerContext
    from robot_runner.events.event import RobotRunnerEvents
    from robot_runner.events.measure import Measure, Origin
    from robot_runner.events.subscription import EventSubscriptionController

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
    "AnalysisPlan": "robot_runner.design.analysis_plan",
    "Author": "robot_runner.config.authors",
    "Correction": "robot_runner.design.analysis_plan",
    "Hypothesis": "robot_runner.design.analysis_plan",
    "EventSubscriptionController": "robot_runner.events.subscription",
    "ExperimentConfig": "robot_runner.config.experiment_config",
    "ExperimentContext": "robot_runner.events.context",
    "Factor": "robot_runner.design.factor",
    "FailurePolicy": "robot_runner.config.choices",
    "Measure": "robot_runner.events.measure",
    "OperationType": "robot_runner.config.choices",
    "Origin": "robot_runner.events.measure",
    "RobotRunnerContext": "robot_runner.events.context",
    "RobotRunnerError": "robot_runner.errors",
    "RobotRunnerEvents": "robot_runner.events.event",
    "RunProcess": "robot_runner.config.choices",
    "RunTableModel": "robot_runner.design.run_table_model",
}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
