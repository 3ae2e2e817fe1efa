"""The class that an experiment's config may derive from."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.config.choices import FailurePolicy, OperationType, RunProcess
from robot_runner.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robot_runner.config.authors import Author
    from robot_runner.design.analysis_plan import AnalysisPlan
    from robot_runner.design.run_table import RunTable
    from robot_runner.design.run_table_model import RunTableModel
    from robot_runner.plugins.api.plugin import Plugin

__all__ = ["ExperimentConfig"]


class ExperimentConfig:
    """An experiment: its static parameters, its run table, its plugins, and what happens at its events.

    A method that is named like an event hears it: `before_experiment`, `before_run`, `start_run`,
    `start_measurement`, `launch_mission`, `stop_measurement`, `stop_run`, `populate_run_data`,
    `continue_experiment`, `after_experiment`. Deriving from this class gives the parameters their types and
    defaults; a class named `RobotRunnerConfig` that derives from nothing works as well.

    Example:
        >>> from robot_runner import ExperimentConfig, Factor, RunTableModel
        >>> class RobotRunnerConfig(ExperimentConfig):
        ...     experiment_name = "two_speeds"
        ...
        ...     def create_run_table(self) -> RunTableModel:
        ...         return RunTableModel([Factor("Speed", [0.1, 0.2])], repetitions=3, data_columns=["Duration"])
        >>> len(RobotRunnerConfig().create_run_table().plan())
        6
    """

    experiment_name: str
    results_output_path: Path | str = Path("experiments")
    operation_type: OperationType = OperationType.AUTO
    time_between_runs_in_ms: int = 0
    robot: str | None = None
    required_ros_version: Any = None
    required_ros_distro: Any = None
    on_failure: FailurePolicy = FailurePolicy.CONTINUE
    attempts: int = 1
    run_deadline_in_s: float | None = None
    event_deadline_in_s: float | None = None
    grace_in_s: float = 10.0
    run_process: RunProcess = RunProcess.FORK
    analysis: AnalysisPlan | None = None
    authors: Sequence[Author | str] = ()
    licence: str | None = None
    citation: str | None = None
    plugins: ClassVar[Sequence[Plugin]] = ()

    def create_run_table(self) -> RunTableModel | RunTable:
        """Return the run-table model: factors, exclusions, repetitions, order, and the measures' columns.

        Raises:
            ConfigError: the config does not define it.
        """
        raise ConfigError(
            "it does not say which runs to execute",
            where=f"{type(self).__name__}.create_run_table",
            fix="Define create_run_table(self) and return a RunTableModel.",
        )
