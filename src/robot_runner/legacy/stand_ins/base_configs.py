"""The config classes of the earlier tools, for configs that derive from them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.core.config.parameters import OperationType
from robot_runner.core.errors import nearest
from robot_runner.legacy.session import current_session
from robot_runner.legacy.stand_ins.events import EventSubscriptionController, RobotRunnerEvents, RunnerEvents

if TYPE_CHECKING:
    from collections.abc import MutableMapping

__all__ = ["CONTEXT_ATTRIBUTES", "EarlierContext", "RobotRunnerConfig", "RunnerConfig"]


# What the earlier tools told a callback about its run.

#: `execute_run` is the later name of `run_variation`.
CONTEXT_ATTRIBUTES = ("run_variation", "execute_run", "run_nr", "run_dir")


class EarlierContext:
    """The context of a run, the same object for all of its callbacks.

    Attributes:
        run_variation: the row of the run table, with `__run_id`, `__done`, treatments and measures; callbacks may
            write into it. `execute_run` is the same.
        run_nr: the place of the run in the table, from 1.
        run_dir: the run's folder.

    Example:
        >>> EarlierContext({"Task": "Video"}, 1, Path("run_0")).execute_run["Task"]
        'Video'
    """

    def __init__(self, run_variation: MutableMapping[str, Any], run_nr: int, run_dir: Path) -> None:
        self.run_variation = run_variation
        self.run_nr = run_nr
        self.run_dir = Path(run_dir)

    @property
    def execute_run(self) -> MutableMapping[str, Any]:
        """The row of the run table."""
        return self.run_variation

    @execute_run.setter
    def execute_run(self, row: MutableMapping[str, Any]) -> None:
        self.run_variation = row

    def __getattr__(self, name: str) -> Any:
        near = nearest(name, CONTEXT_ATTRIBUTES)
        hint = f"Did you mean {near!r}?" if near else f"It has {', '.join(CONTEXT_ATTRIBUTES)}."
        raise AttributeError(f"the context has no {name!r}. {hint}", name=name, obj=self)


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
