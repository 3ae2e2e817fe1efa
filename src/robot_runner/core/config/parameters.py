"""The class that an experiment's config may derive from, and its static parameters, each declared once.

A declaration in `StaticParameters` is the class attribute that editors and type checkers see, and says how the value is
checked, normalised, read from the command line and documented.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, NoReturn

from robot_runner.core.config import parameter_kinds as kinds
from robot_runner.core.config.authors import Author
from robot_runner.core.config.executed_as_script import tell_at_exit
from robot_runner.core.config.gate_parameters import Gate, Guard
from robot_runner.core.config.notify import Notify
from robot_runner.core.config.operator_steps import OperatorStep
from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.design.precision import Precision
from robot_runner.core.design.run_table_model import RunTable, RunTableModel
from robot_runner.core.errors import ConfigError
from robot_runner.core.links.declared_host import Host
from robot_runner.core.links.robot_name import Robots
from robot_runner.core.plugin import Plugin


class OperationType(Enum):
    """Whether a run starts automatically (AUTO), or once the user continues (SEMI: after swapping a battery, say)."""

    AUTO = "auto"
    SEMI = "semi"


class FailurePolicy(Enum):
    """The consequence of a run whose last attempt failed: go on with the next run, or stop the experiment."""

    CONTINUE = "continue"
    STOP = "stop"


class BadValuePolicy(Enum):
    """The consequence of a value of the run table that is missing or not plausible.

    KEEP: the run counts, and the value is kept with the reason.
    TRY_AGAIN: the attempt counts as failed while `attempts` leaves another one; the last attempt's values are kept.
    FAIL: the attempt counts as failed.
    """

    KEEP = "keep"
    TRY_AGAIN = "try_again"
    FAIL = "fail"


class RunProcess(Enum):
    """Where a run is executed.

    FORK: a fresh process forked from the orchestrator; it sees what `before_experiment` set up.
    SPAWN: a fresh interpreter that loads the config again.
    IN_PROCESS: the orchestrator itself; fast, and a run that dies takes the experiment with it.
    """

    FORK = "fork"
    SPAWN = "spawn"
    IN_PROCESS = "in_process"


#: The default of a parameter that has none.
REQUIRED: Any = object()


@dataclass(frozen=True, slots=True)
class Parameter:
    """One static parameter, as it is declared in `StaticParameters`."""

    name: str
    type_name: str
    default: Any
    description: str
    kind: kinds.Kind


#: All static parameters by name, in the order of their declarations.
PARAMETERS: dict[str, Parameter] = {}


def _declare(description: str, kind: kinds.Kind, default: Any = REQUIRED) -> Any:
    return Parameter("", kind.type_name, default, description, kind)


def _declared(cls: type[StaticParameters]) -> type[StaticParameters]:
    """Register the declarations of a class, and replace them by their defaults."""
    for name, annotation in cls.__annotations__.items():
        declared: Parameter = vars(cls)[name]
        PARAMETERS[name] = replace(declared, name=name, type_name=declared.type_name or annotation)
        if declared.default is REQUIRED:
            delattr(cls, name)
        else:
            setattr(cls, name, declared.default)
    return cls


@_declared
class StaticParameters:
    """The static parameters of a config, with their defaults."""

    experiment_name: str = _declare("Names the experiment and its folder.", kinds.NAME)
    results_output_path: Path | str = _declare(
        "The folder in which the experiment's folder is made; `~` is the home folder, and a relative path begins "
        "where the config file is.",
        kinds.PATH,
        Path("experiments"),
    )
    operation_type: OperationType = _declare(
        "AUTO starts each run by itself; SEMI waits before each run, the first one of a session included, until the "
        "user says to go on.",
        kinds.choice(OperationType),
        OperationType.AUTO,
    )
    operator_steps: Sequence[OperatorStep] = _declare(
        "What a person does before or after a run, and what they are asked: `OperatorStep(...)`.",
        kinds.OPERATOR_STEPS,
        (),
    )
    time_between_runs_in_ms: int = _declare(
        "How long the robot rests between two runs, in milliseconds.", kinds.whole(0, " of milliseconds"), 0
    )
    robot: str | Robots | None = _declare(
        'How the robot is reached: "simulated" is the embedded TurtleBot3, which is never chosen silently; real ones '
        'by ros1, ros2, dds, rosbridge://host:9090 or auto, one of a graph by its namespace: "ros2://alice". '
        "`Robots(...)` names several, of which each run takes a free one.",
        kinds.LINK.or_none(),
        None,
    )
    hosts: Mapping[str, Host | str] = _declare(
        "The computers that take part, by name: an address as for ssh, `local` for this machine, or "
        "`Host(address=..., fetch=[...], reboot=...)`; `context.host(name)` executes commands there.",
        kinds.HOSTS,
        {},
    )
    required_ros_version: Any = _declare(
        "The ROS generation that the experiment needs: 1, 2, `any`, or None for none at all.",
        replace(kinds.ROS_GENERATION, type_name="int | None"),
        None,
    )
    required_ros_distro: Any = _declare(
        'The ROS distribution that the experiment needs, such as "noetic"; `any` or None where it does not matter.',
        replace(kinds.ROS_DISTRIBUTION, type_name="str | None"),
        None,
    )
    phases: Sequence[str] = _declare(
        "The phases of the mission for which measures are published, too, each as `<measure>.<phase>`.",
        kinds.PHASES,
        (),
    )
    on_failure: FailurePolicy = _declare(
        "What follows a run that failed: CONTINUE with the next one, or STOP the experiment.",
        kinds.choice(FailurePolicy),
        FailurePolicy.CONTINUE,
    )
    attempts: int = _declare("How often a run is tried before it counts as failed.", kinds.whole(1, ""), 1)
    on_bad_value: BadValuePolicy = _declare(
        "What follows a value of the run table that is missing, or beyond its measure's `low` or `high`: KEEP it with "
        "the reason, TRY_AGAIN while there are attempts left, or FAIL the attempt.",
        kinds.choice(BadValuePolicy),
        BadValuePolicy.KEEP,
    )
    quality_columns: bool = _declare(
        "Whether each measure has a column `<measure>.quality` in the run table: good, doubtful or missing, and why.",
        kinds.FLAG,
        default=False,
    )
    probe: bool = _declare(
        "Whether each profiler is tried for a moment before the first run, so that one that is silent is found before "
        "the robot moves.",
        kinds.FLAG,
        default=True,
    )
    run_deadline_in_s: float | None = _declare(
        "How long a run may take from its first event on, in seconds of real time; None for no limit.",
        kinds.SECONDS.or_none(),
        None,
    )
    event_deadline_in_s: float | None = _declare(
        "How long one event may take, in seconds of real time; None for no limit. It holds for the events of the "
        "orchestrator, too.",
        kinds.SECONDS.or_none(),
        None,
    )
    grace_in_s: float = _declare(
        "How long a run that is told to end may take to stop its robot and close its profilers before it is killed, "
        "in seconds.",
        kinds.SECONDS,
        10.0,
    )
    run_process: RunProcess = _declare(
        "Where a run is executed: in a process that is forked (FORK), in a fresh interpreter (SPAWN), or in the "
        "orchestrator itself (IN_PROCESS).",
        kinds.choice(RunProcess),
        RunProcess.FORK,
    )
    workers: int | str = _declare(
        'How many runs this machine executes at the same time: a number, or "auto" for as many as it has cores. Runs '
        "that claim the same thing never overlap.",
        kinds.WORKERS,
        1,
    )
    claims: Sequence[str] | None = _declare(
        "What the config's own callbacks need for themselves in a run, such as `serial:/dev/ttyUSB0`; an empty list "
        "where runs may go on side by side. None is this whole machine (`host:localhost`), and nothing where the robot "
        "is simulated.",
        kinds.CLAIMS.or_none(),
        None,
    )
    cluster: str | None = _declare(
        "The scheduler of the Dask cluster whose workers execute the runs, such as tcp://scheduler:8786; None executes "
        "them on this machine.",
        kinds.CLUSTER.or_none(),
        None,
    )
    attempts_if_lost: int = _declare(
        "How often a run is tried again, beside `attempts`, as the machine that executed it was lost, which is not the "
        "run's fault; beyond that, or with 0, such an attempt is one of `attempts`.",
        kinds.whole(0, ""),
        3,
    )
    gates: Sequence[Gate] = _declare(
        "What must hold before each attempt at a run: conditions that are awaited, one after another.",
        kinds.instances(Gate, "a list of Gate(...), such as [Gate(temperature_below(50), timeout_s=600)]"),
        (),
    )
    guards: Sequence[Guard] = _declare(
        "What must not come true while a run is measured: conditions that are watched.",
        kinds.instances(Guard, "a list of Guard(...), such as [Guard(battery_below(15), GuardAction.STOP)]"),
        (),
    )
    smoke: Mapping[str, Any] = _declare(
        "What `robot-runner smoke` sets to be quick: static parameters and attributes of the config by name, and "
        "parameters of a plugin as `<plugin>.<parameter>`.",
        kinds.SMOKE,
        {},
    )
    watch_machines: bool = _declare(
        "Whether the computers that profilers measure are watched for what else goes on there: load by others, swap, "
        "throttling.",
        kinds.FLAG,
        default=True,
    )
    notify: Notify | None = _declare(
        "Who is told how the experiment goes on, and of what: `Notify(...)`.", kinds.NOTIFY.or_none(), None
    )
    analysis: AnalysisPlan | None = _declare(
        "What is fixed for the analysis before the experiment: measures, level of significance, hypotheses.",
        kinds.PLAN.or_none(),
        None,
    )
    registration: Path | str | None = _declare(
        "The file that `robot-runner preregister` writes, and that the report cites; a relative path begins where the "
        "config file is. None is `<config>.registration.json` beside it, where there is one.",
        kinds.PATH.or_none(),
        None,
    )
    repeat_until: Precision | Sequence[Precision] = _declare(
        "How precisely measures are to be known: all combinations are executed once more until they are, `repetitions` "
        "times at least: `Precision(...)`, or a list of them.",
        kinds.REPEAT_UNTIL,
        (),
    )
    authors: Sequence[Author | str] = _declare(
        "Who made the experiment: names, or `Author(name, orcid=..., affiliation=..., affiliation_url=...)`.",
        kinds.AUTHORS,
        (),
    )
    licence: str | None = _declare(
        'Under which terms others may use the results: an SPDX identifier such as "CC-BY-4.0", or a URL.',
        kinds.LICENCE.or_none(),
        None,
    )
    citation: str | None = _declare(
        "What to cite when the results are used: a DOI, a URL or a sentence.", kinds.TEXT.or_none(), None
    )


class Parameters(StaticParameters):
    """The static parameters of a valid config, normalised and read-only.

    Example:
        >>> Parameters(experiment_name="two_speeds", attempts=2).attempts
        2
    """

    results_output_path: Path
    robot: str | None
    #: How each robot that takes turns is reached, by its name: `robot` is the first of them, or a run's own.
    robots: Mapping[str, str] = MappingProxyType({})
    hosts: Mapping[str, Host]
    required_ros_version: int | str | None
    required_ros_distro: str | None
    authors: tuple[Author, ...]
    phases: tuple[str, ...]
    operator_steps: tuple[OperatorStep, ...]
    gates: tuple[Gate, ...]
    guards: tuple[Guard, ...]
    repeat_until: tuple[Precision, ...]

    def __init__(self, **values: Any) -> None:
        vars(self).update(values)

    @property
    def links(self) -> tuple[str, ...]:
        """How the robots are reached: all that take turns, or the only one, or none."""
        return tuple(self.robots.values()) or ((self.robot,) if self.robot is not None else ())

    def but(self, **changed: Any) -> Parameters:
        """Return a copy with some parameters changed."""
        return Parameters(**{**vars(self), **changed})

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(f"{name} is fixed, and cannot become {value!r}")


class ExperimentConfig(StaticParameters):
    """An experiment: its static parameters, its run table, its plugins, and its callbacks.

    A method that is named like an event is called at it: `before_experiment`, `before_run`, `start_run`,
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

    plugins: ClassVar[Sequence[Plugin]] = ()

    def __init_subclass__(cls, **options: Any) -> None:
        """Have `python study.py`, which only defines a class, say how it is executed; imports see nothing of this."""
        super().__init_subclass__(**options)
        if cls.__module__ == "__main__":
            tell_at_exit()

    def create_run_table(self) -> RunTableModel | RunTable:
        """Return the run-table model: factors, exclusions, repetitions, order, and the measures' columns.

        Raises:
            ConfigError: the config does not define it.
        """
        problem = "the config does not say which runs to execute"
        fix = "Define create_run_table(self) and return a RunTableModel."
        raise ConfigError(problem, where=f"{type(self).__name__}.create_run_table", fix=fix)
