"""The probe: each profiler is tried for a moment before anything moves, so that a silent meter is found in time."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from typing import Any

from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.parameters import Parameters
from robot_runner.core.errors import ExecutionError, Finding, errors_first
from robot_runner.core.events.context import PROBE
from robot_runner.core.events.manager import RUN_EVENTS, EventManager, RobotRunnerEvents
from robot_runner.core.events.measure import MeasureColumn, PublishedMeasure
from robot_runner.core.execution.interruption import Interruption
from robot_runner.core.execution.places import Watch
from robot_runner.core.execution.poll_loop import PollLoop
from robot_runner.core.execution.task import AttemptStatus, RunFailure, RunOutcome, RunTask, seed_of_run
from robot_runner.core.execution.work_beside_runs import executed_beside_runs
from robot_runner.core.links.connect import is_simulated
from robot_runner.core.plugin import Plugin, Profiler
from robot_runner.core.storage.lock import ExperimentLock
from robot_runner.core.treatments import built_with, factors_of
from robot_runner.core.words import enumerated

#: How long an event may take beyond the window, s: to connect to another computer, or for a board to boot.
_PATIENCE = 30.0
#: A probe calls none of these. A profiler that sets something up in them is not probed, as it could not measure.
_SET_UP = (RobotRunnerEvents.BEFORE_EXPERIMENT, RobotRunnerEvents.BEFORE_RUN)
_PROBED = tuple(event for event in RUN_EVENTS if event is not RobotRunnerEvents.LAUNCH_MISSION)
_WITHOUT = "Or go without the probe: --no-probe, or probe = False in the config."


@dataclass(frozen=True, slots=True)
class Probed:
    """The result of probing one profiler.

    Attributes:
        missing: the names of its measures where none of them has a value, else empty.
        failure: what it raised, or how the process of the probe ended.
        robot: the name of the robot with which it was tried; empty where there is only one.
    """

    plugin: str
    measures: Mapping[str, PublishedMeasure] = field(default_factory=dict)
    doubts: tuple[Finding, ...] = ()
    missing: tuple[str, ...] = ()
    failure: str = ""
    robot: str = ""

    @property
    def label(self) -> str:
        """Its name, with the robot's if several take turns."""
        return f"{self.plugin}, robot {self.robot}" if self.robot else self.plugin

    def findings(self) -> Iterator[Finding]:
        """Yield an error where it did not measure, else a warning for each doubt."""
        where = f"plugin {self.label}"
        if self.failure:
            yield Finding.error(where, f"the probe failed: {self.failure}", f"Look at the device. {_WITHOUT}")
        elif self.missing:
            because = f": {'; '.join(each.problem for each in self.doubts)}" if self.doubts else ""
            fix = " ".join(dict.fromkeys([*(each.fix for each in self.doubts if each.fix), _WITHOUT]))
            yield Finding.error(where, f"the probe got no value of {enumerated(self.missing)}{because}", fix)
        else:
            for each in self.doubts:
                yield Finding.warning(where, f"the probe is doubtful: {each.problem}", each.fix)

    def fields(self) -> dict[str, Any]:
        """Return the same as plain data, for the journal."""
        values = {name: published.value for name, published in self.measures.items()}
        reasons = [each.problem for each in self.doubts]
        return {"measures": values, "reasons": reasons, "failure": self.failure}


@dataclass(frozen=True, slots=True)
class Probe:
    """The results of all profilers that were probed.

    Attributes:
        seconds: real time that it took.
        window: how long they measured, s.
    """

    seconds: float
    window: float
    profilers: tuple[Probed, ...]

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Return an error for each profiler that did not measure, and a warning for each doubt about the others."""
        return tuple(finding for profiler in self.profilers for finding in profiler.findings())

    def refuse_silent(self) -> None:
        """Refuse to go on where a profiler did not measure.

        Raises:
            ExecutionError: one did not; all findings are listed, errors first.
        """
        ordered = errors_first(self.findings)
        if ordered and ordered[0].is_error:
            raise ExecutionError.of_findings(ordered)

    def fields(self) -> dict[str, Any]:
        """Return the same as plain data, for the journal."""
        seen = {profiler.label: profiler.fields() for profiler in self.profilers}
        return {"seconds": round(self.seconds, 3), "window": self.window, "profilers": seen}


def probed_profilers(experiment: Experiment) -> list[Profiler]:
    """Return the profilers that can be probed.

    There are none where the robot is the embedded simulation, whose meters always answer, or where runs go to a
    cluster, whose meters others may be using. A profiler is left out that opts out (`probe_s` is None), has no
    measures, or sets something up in `before_experiment` or `before_run`, which a probe does not call.
    """
    return probed_plugins(experiment.plugins, experiment.events, experiment.parameters)


def probed_plugins(plugins: Sequence[Plugin], events: EventManager, parameters: Parameters) -> list[Profiler]:
    """Return the same as `probed_profilers`, for an experiment of which only these parts are known."""
    if is_simulated(parameters.robot) or parameters.cluster is not None:
        return []
    set_up = {each.owner for each in events.subscribers(*_SET_UP)}
    profilers = [plugin for plugin in plugins if isinstance(plugin, Profiler)]
    return [each for each in profilers if each.name not in set_up and (_can_tell(each) or factors_of(each))]


def probe_window_of(profilers: Sequence[Profiler]) -> float:
    """Return how long these profilers measure in a probe, s: all at the same time, as long as the slowest needs."""
    return max((each.probe_s or 0.0 for each in profilers), default=0.0)


def _can_tell(profiler: Profiler) -> bool:
    return profiler.probe_s is not None and len(profiler.measures) > 0


def probe_experiment(experiment: Experiment) -> Probe:
    """Probe the profilers of an experiment that is not being executed; no file is kept.

    Raises:
        ExecutionError: it is being executed, and its meters are in use.
    """
    run = next(iter(experiment.model.plan()))
    seed = seed_of_run(0, run.run_id)
    task = RunTask(run.run_id, run.number, 1, 1, run.combination, run.repetition, 0, seed)
    with ExitStack() as opened:
        if experiment.folder.lock.exists():
            opened.enter_context(ExperimentLock(experiment.folder.lock))
        return probe_profilers(experiment, task, opened.enter_context(Interruption()))


def probe_profilers(experiment: Experiment, task: RunTask, interruption: Interruption) -> Probe:
    """Try all profilers that can be probed in a run without mission, systems and config.

    A profiler that raises ends that run, and another one follows without it, so that all findings are complete. Where
    several robots take turns, each of them has a probe.
    """
    started = time.monotonic()
    seen: list[Probed] = []
    robots = experiment.parameters.robots
    for name, link in robots.items() or [("", experiment.parameters.robot)]:
        if not interruption.is_requested:
            own = experiment.parameters.but(robot=link)
            beside = _probed_beside(replace(experiment, parameters=own), task, interruption)
            seen += [replace(each, robot=name) for each in beside]
    return Probe(time.monotonic() - started, probe_window_of(probed_profilers(experiment)), tuple(seen))


def _probed_beside(experiment: Experiment, task: RunTask, interruption: Interruption) -> list[Probed]:
    """Try the profilers with the robot of the experiment."""
    # Parameters that are bound to factors have values only in a run.
    built = [built_with(each, task.combination) for each in probed_profilers(experiment)]
    left = list(filter(_can_tell, built))
    seen: list[Probed] = []
    window = probe_window_of(left)
    while left:
        outcome = _tried(experiment, left, window, task, interruption)
        if outcome.status is AttemptStatus.INTERRUPTED:
            break
        failed = _failed(left, outcome)
        ended = failed if failed or outcome.failure is None else left  # it died, and nobody knows whose fault that was
        seen += [_probed(each, experiment, outcome) for each in ended or left]
        left = [each for each in left if each not in ended] if ended else []
    return seen


def without_values(columns: Sequence[MeasureColumn], measures: Mapping[str, PublishedMeasure]) -> tuple[str, ...]:
    """Return the names of these columns of a profiler if none of them has a value, else nothing."""
    names = [column.name for column in columns]
    silent = all(name not in measures or measures[name].value is None for name in names)
    return tuple(names) if silent else ()


def _failures(outcome: RunOutcome) -> list[RunFailure]:
    return [*([outcome.failure] if outcome.failure else []), *outcome.later_failures]


def _failed(profilers: Sequence[Profiler], outcome: RunOutcome) -> list[Profiler]:
    owners = {failure.owner for failure in _failures(outcome)}
    return [each for each in profilers if each.name in owners]


def _probed(profiler: Profiler, experiment: Experiment, outcome: RunOutcome) -> Probed:
    failures = _failures(outcome)
    own = [str(failure) for failure in failures if failure.owner == profiler.name] or [str(each) for each in failures]
    phases = {f"{measure.name}.{phase}" for measure in profiler.measures for phase in experiment.parameters.phases}
    left_out = {*phases, *profiler.not_probed}
    declared = (column for column in experiment.columns.declared if column.owner == profiler.name)
    columns = [column for column in declared if column.measure.name not in left_out]
    measures = {column.name: outcome.measures[column.name] for column in columns if column.name in outcome.measures}
    return Probed(
        profiler.name,
        measures,
        tuple(each for each in outcome.findings if each.where == f"{PROBE}, {profiler.name}"),
        without_values([column for column in columns if column.is_in_table] or columns, measures),
        "; ".join(own),
    )


def _tried(
    experiment: Experiment, profilers: Sequence[Profiler], window: float, task: RunTask, interruption: Interruption
) -> RunOutcome:
    steps = executed_beside_runs(
        experiment,
        replace(task, run_id=PROBE),
        lambda: time.sleep(window),
        Watch(interruption),
        deadline_s=window + _PATIENCE,
        profilers=profilers,
        events=_PROBED,
    )
    return PollLoop(interruption).follow(steps)
