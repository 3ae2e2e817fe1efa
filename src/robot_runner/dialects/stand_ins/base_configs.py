"""The config classes of the earlier tools, for configs that derive from them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from robot_runner.config.choices import OperationType
from robot_runner.dialects.session import current_session
from robot_runner.dialects.stand_ins.events import EventSubscriptionController, RobotRunnerEvents, RunnerEvents

__all__ = ["RobotRunnerConfig", "RunnerConfig"]


class _BesideConfig:
    """The folder of the config file, or one in it: where Experiment Runner kept results if nothing else was said."""

    def __init__(self, name: str = "") -> None:
        self._name = name

    def __get__(self, config: object, owner: type) -> Path:
        return current_session().path.parent / self._name


class _Callbacks:
    """The callbacks that a derived config may leave out."""

    run_table_model: Any = None
    experiment_path: Path | None = None

    def before_experiment(self) -> None:
        """Do nothing."""

    def before_run(self) -> None:
        """Do nothing."""

    def start_run(self, context: Any) -> None:
        """Do nothing."""

    def start_measurement(self, context: Any) -> None:
        """Do nothing."""

    def stop_measurement(self, context: Any) -> None:
        """Do nothing."""

    def stop_run(self, context: Any) -> None:
        """Do nothing."""

    def populate_run_data(self, context: Any) -> Any:
        """Return nothing."""

    def after_experiment(self) -> None:
        """Do nothing."""


class RobotRunnerConfig(_Callbacks):
    """The config class of Robot Runner: it subscribes every callback under its own name."""

    name: str = "new_robot_runner_experiment"
    required_ros_version: Any = 2
    required_ros_distro: Any = "foxy"
    operation_type: OperationType = OperationType.AUTO
    time_between_runs_in_ms: int = 1000
    results_output_path: Path = Path("~/Documents/experiments")

    def __init__(self) -> None:
        _subscribe(self, RobotRunnerEvents)

    def launch_mission(self, context: Any) -> None:
        """Do nothing."""


class RunnerConfig(_Callbacks):
    """The config class of Experiment Runner: it subscribes every callback under its own name."""

    ROOT_DIR = _BesideConfig()
    name: str = "new_runner_experiment"
    results_output_path: Any = _BesideConfig("experiments")
    operation_type: OperationType = OperationType.AUTO
    time_between_runs_in_ms: int = 1000

    def __init__(self) -> None:
        _subscribe(self, RunnerEvents)

    def interact(self, context: Any) -> None:
        """Do nothing."""


def _subscribe(config: object, events: Any) -> None:
    EventSubscriptionController.subscribe_to_multiple_events(
        [
            (event, getattr(config, event.name.lower()))
            for event in events
            if hasattr(config, event.name.lower()) and "CONTINUE" not in event.name
        ]
    )
