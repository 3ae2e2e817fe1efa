"""The class that an experiment's config may derive from."""

from __future__ import annotations

import re
from dataclasses import dataclass, fields
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from robot_runner.core.config.experiment import Author, authors_from_text, is_licence
from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from robot_runner.core.design.run_table import RunTable
    from robot_runner.core.design.run_table_model import RunTableModel
    from robot_runner.core.plugin import Plugin

__all__ = [
    "PARAMETERS",
    "PARAMETERS_BY_NAME",
    "REQUIRED",
    "ExperimentConfig",
    "FailurePolicy",
    "OperationType",
    "Parameter",
    "Parameters",
    "RunProcess",
]


# The choices that static parameters offer.


class OperationType(Enum):
    """Whether the next run starts by itself (AUTO), or once the user says so (SEMI: to swap a battery, say)."""

    AUTO = "auto"
    SEMI = "semi"


class FailurePolicy(Enum):
    """What follows a run whose last attempt failed: go on with the next run, or stop the experiment."""

    CONTINUE = "continue"
    STOP = "stop"


class RunProcess(Enum):
    """Where a run is executed.

    FORK: a fresh process forked from the orchestrator; it sees what `before_experiment` set up.
    SPAWN: a fresh interpreter that loads the config again.
    IN_PROCESS: the orchestrator itself; fast, and a run that dies takes the experiment with it.
    """

    FORK = "fork"
    SPAWN = "spawn"
    IN_PROCESS = "in_process"


# The static parameters of a config: what each may be, its default, and how it is read from the command line.

#: The default of a parameter that has none.
REQUIRED: Any = object()

_NAME = re.compile(r"[A-Za-z0-9](?:[A-Za-z0-9 ._-]{0,126}[A-Za-z0-9_-])?")
_ROS_VERSIONS = (1, 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameters:
    """The static parameters of a config that was found to be well formed. See `PARAMETERS` for their meaning."""

    experiment_name: str
    required_ros_version: int | str | None
    required_ros_distro: str | None
    operation_type: OperationType
    results_output_path: Path
    time_between_runs_in_ms: int
    robot: str | None
    on_failure: FailurePolicy
    attempts: int
    run_deadline_in_s: float | None
    event_deadline_in_s: float | None
    grace_in_s: float
    run_process: RunProcess
    analysis: AnalysisPlan | None
    authors: tuple[Author, ...]
    licence: str | None
    citation: str | None


@dataclass(frozen=True, slots=True)
class Parameter:
    """One static parameter.

    Attributes:
        accepts: says whether a value is well formed.
        expected: completes the sentence "it must be ...".
        normalise: makes the value that `Parameters` holds from one that is accepted.
        from_text: reads a value of the command line; raises ValueError.
    """

    name: str
    type_name: str
    default: Any
    description: str
    accepts: Callable[[Any], bool]
    expected: str
    from_text: Callable[[str], Any]
    normalise: Callable[[Any], Any] = lambda value: value


def _is_integer(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_seconds(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < float("inf")


def _is_any(value: Any) -> bool:
    return value is any or (isinstance(value, str) and value.casefold() == "any")


def _without_any(value: Any) -> Any:
    return "any" if _is_any(value) else value


def _optional(read: Callable[[str], Any]) -> Callable[[str], Any]:
    return lambda text: None if text.casefold() == "none" else read(text)


def _number_or_word(text: str) -> int | str:
    return int(text) if text.lstrip("-").isdigit() else text


def _choice(name: str, choices: type[Enum], default: Enum, description: str) -> Parameter:
    names = ", ".join(f"{choices.__name__}.{choice.name}" for choice in choices)
    return Parameter(
        name,
        choices.__name__,
        default,
        description,
        accepts=lambda value: isinstance(value, choices),
        expected=f"one of {names}",
        from_text=lambda text: choices(text.casefold().rpartition(".")[2]),
    )


def _are_authors(value: Any) -> bool:
    return isinstance(value, list | tuple) and all(
        isinstance(each, Author) or (isinstance(each, str) and each.strip() != "") for each in value
    )


def _as_authors(value: Any) -> tuple[Author, ...]:
    return tuple(each if isinstance(each, Author) else Author(each.strip()) for each in value)


def _not_as_text(text: str) -> Any:
    raise ValueError(f"{text!r} cannot be set from outside")


def _deadline(name: str, description: str) -> Parameter:
    return Parameter(
        name,
        "float | None",
        None,
        description,
        accepts=lambda value: value is None or _is_seconds(value),
        expected="a positive number of seconds, or None",
        from_text=_optional(float),
    )


PARAMETERS = (
    Parameter(
        "experiment_name",
        "str",
        REQUIRED,
        "Names the experiment and its folder.",
        accepts=lambda value: isinstance(value, str) and _NAME.fullmatch(value) is not None,
        expected="a name that can name a folder: letters, digits, blanks, '.', '_' and '-', 128 at most",
        from_text=str,
    ),
    Parameter(
        "results_output_path",
        "Path",
        Path("experiments"),
        "The folder in which the experiment's folder is made; `~` is the home folder, and a relative path begins "
        "where the config file is.",
        accepts=lambda value: isinstance(value, str | Path) and "\0" not in str(value) and str(value) != "",
        expected="a path, such as Path('~/results')",
        from_text=Path,
        normalise=Path,
    ),
    _choice(
        "operation_type",
        OperationType,
        OperationType.AUTO,
        "AUTO starts each run by itself; SEMI waits after each run until the user says to go on.",
    ),
    Parameter(
        "time_between_runs_in_ms",
        "int",
        0,
        "How long the robot rests between two runs, in milliseconds.",
        accepts=lambda value: _is_integer(value) and value >= 0,
        expected="a whole number of milliseconds, 0 or more",
        from_text=int,
    ),
    Parameter(
        "robot",
        "str | None",
        None,
        'How the robot is reached: "simulated" is the embedded TurtleBot3, which is never chosen silently; real ones '
        "by ros1, ros2, dds, rosbridge://host:9090 or auto.",
        accepts=lambda value: value is None or (isinstance(value, str) and value != ""),
        expected='the name of a robot link, such as "simulated", or None',
        from_text=_optional(str),
    ),
    Parameter(
        "required_ros_version",
        "int | None",
        None,
        "The ROS generation that the experiment needs: 1, 2, `any`, or None for none at all.",
        accepts=lambda value: value is None or _is_any(value) or (_is_integer(value) and value in _ROS_VERSIONS),
        expected="1, 2, any or None",
        from_text=_optional(_number_or_word),
        normalise=_without_any,
    ),
    Parameter(
        "required_ros_distro",
        "str | None",
        None,
        'The ROS distribution that the experiment needs, such as "noetic"; `any` or None where it does not matter.',
        accepts=lambda value: value is None or _is_any(value) or (isinstance(value, str) and value.strip() != ""),
        expected='the name of a ROS distribution, such as "noetic", any or None',
        from_text=_optional(str),
        normalise=_without_any,
    ),
    _choice(
        "on_failure",
        FailurePolicy,
        FailurePolicy.CONTINUE,
        "What follows a run that failed: CONTINUE with the next one, or STOP the experiment.",
    ),
    Parameter(
        "attempts",
        "int",
        1,
        "How often a run is tried before it counts as failed.",
        accepts=lambda value: _is_integer(value) and value >= 1,
        expected="a whole number, 1 or more",
        from_text=int,
    ),
    _deadline("run_deadline_in_s", "How long a run may take, in seconds of real time; None for no limit."),
    _deadline(
        "event_deadline_in_s", "How long one event of a run may take, in seconds of real time; None for no limit."
    ),
    Parameter(
        "grace_in_s",
        "float",
        10.0,
        "How long a run that is told to end may take to stop its robot and close its profilers before it is killed, "
        "in seconds.",
        accepts=_is_seconds,
        expected="a positive number of seconds",
        from_text=float,
    ),
    _choice(
        "run_process",
        RunProcess,
        RunProcess.FORK,
        "Where a run is executed: in a process that is forked (FORK), in a fresh interpreter (SPAWN), or in the "
        "orchestrator itself (IN_PROCESS).",
    ),
    Parameter(
        "analysis",
        "AnalysisPlan | None",
        None,
        "What is fixed for the analysis before the experiment: measures, level of significance, hypotheses.",
        accepts=lambda value: value is None or isinstance(value, AnalysisPlan),
        expected="an AnalysisPlan(...) in the config file, or None",
        from_text=_not_as_text,
    ),
    Parameter(
        "authors",
        "Sequence[Author | str]",
        (),
        "Who made the experiment: names, or `Author(name, orcid=..., affiliation=..., affiliation_url=...)`.",
        accepts=_are_authors,
        expected="a list of names or Author(...)",
        from_text=authors_from_text,
        normalise=_as_authors,
    ),
    Parameter(
        "licence",
        "str | None",
        None,
        'Under which terms others may use the results: an SPDX identifier such as "CC-BY-4.0", or a URL.',
        accepts=lambda value: value is None or is_licence(value),
        expected='an SPDX identifier such as "CC-BY-4.0", a URL, or None',
        from_text=_optional(str),
    ),
    Parameter(
        "citation",
        "str | None",
        None,
        "What to cite when the results are used: a DOI, a URL or a sentence.",
        accepts=lambda value: value is None or (isinstance(value, str) and value.strip() != ""),
        expected="a text, or None",
        from_text=_optional(str),
    ),
)

PARAMETERS_BY_NAME = {parameter.name: parameter for parameter in PARAMETERS}

if set(PARAMETERS_BY_NAME) != {field.name for field in fields(Parameters)}:  # pragma: no cover - a slip of ours
    raise AssertionError("PARAMETERS and Parameters differ")


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
