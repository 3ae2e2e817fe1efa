"""One run: its six events, what they open, and the closing of it, whatever fails in between."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from robot_runner.errors import MeasureError, RobotRunnerError
from robot_runner.events.broker import MeasureBroker
from robot_runner.events.columns import CONFIG_OWNER
from robot_runner.events.context import RobotRunnerContext
from robot_runner.events.event import CLOSED_BY, RobotRunnerEvents
from robot_runner.events.manager import CallbackFailure, Emission
from robot_runner.events.measure import Origin
from robot_runner.events.resources import Resources
from robot_runner.execution.interruption import InterruptGate, RunInterrupted
from robot_runner.links.connect import is_simulated, open_clock
from robot_runner.storage.journal import utc_now

if TYPE_CHECKING:
    from robot_runner.config.experiment import Experiment
    from robot_runner.events.clock import Clock
    from robot_runner.execution.task import Report, RunTask

__all__ = ["execute_run", "failure_fields", "publish_returned", "run_contexts"]


def execute_run(experiment: Experiment, task: RunTask, report: Report, gate: InterruptGate | None = None) -> None:
    """Execute one run and report what happens as it happens.

    Nothing is raised: a failure is a record like any other. What was opened is closed, systems are made safe.
    """
    resources = Resources()
    run = _Run(experiment, task, report, gate or InterruptGate())
    try:
        with run.recorded("", "link"):
            run.enter(open_clock(experiment.parameters.robot, resources, seed=task.run_seed), resources)
            run.emit_events()
    finally:
        with run.recorded(RobotRunnerEvents.STOP_RUN.value, "link"):
            resources.close()


def run_contexts(
    experiment: Experiment, task: RunTask, *, clock: Clock, resources: Resources, report: Report
) -> Callable[[str], RobotRunnerContext]:
    """Return what makes the context of a run for each owner; all share one broker."""
    broker = MeasureBroker(task.run_id, experiment.columns, report)
    made: dict[str, RobotRunnerContext] = {}

    def context_for(owner: str) -> RobotRunnerContext:
        if owner not in made:
            made[owner] = RobotRunnerContext(
                experiment_name=experiment.parameters.experiment_name,
                experiment_folder=experiment.folder.root,
                robot=experiment.parameters.robot,
                seed=task.experiment_seed,
                run_id=task.run_id,
                run_number=task.run_number,
                run_count=task.run_count,
                attempt=task.attempt,
                combination=task.combination,
                repetition=task.repetition,
                run_seed=task.run_seed,
                run_path=experiment.folder.run(task.run_id),
                clock=clock,
                resources=resources,
                owner=owner,
                broker=broker,
            )
        return made[owner]

    return context_for


class _Run:
    """The life of one run in its own process."""

    def __init__(self, experiment: Experiment, task: RunTask, report: Report, gate: InterruptGate) -> None:
        self._experiment = experiment
        self._task = task
        self._report = report
        self._gate = gate
        self._failed = False

    def enter(self, clock: Clock, resources: Resources) -> None:
        self._clock = clock
        self._context_for = run_contexts(
            self._experiment, self._task, clock=clock, resources=resources, report=self._report
        )

    def emit_events(self) -> None:
        """Emit the six events; what an opening event reached is closed again, and then made safe if anything failed."""
        with self._opened(RobotRunnerEvents.START_RUN):
            if not self._failed:
                with self._opened(RobotRunnerEvents.START_MEASUREMENT):
                    if not self._failed:
                        self._emit(RobotRunnerEvents.LAUNCH_MISSION)
        if self._failed:
            self._make_safe()
        else:
            emission = self._emit(RobotRunnerEvents.POPULATE_RUN_DATA)
            for owner, returned in emission.returned:
                with self.recorded(RobotRunnerEvents.POPULATE_RUN_DATA.value, owner):
                    publish_returned(self._context_for(owner), returned)

    @contextmanager
    def recorded(self, event: str, owner: str) -> Iterator[None]:
        """Record what is raised as a failure of the run."""
        try:
            yield
        except BaseException as error:  # noqa: BLE001 - whatever it is, the run is closed and says why it failed
            self._record(event, owner, error)

    @contextmanager
    def _opened(self, event: RobotRunnerEvents) -> Iterator[None]:
        emission = self._emit(event)
        try:
            yield
        finally:
            self._close(CLOSED_BY[event], event, emission)

    def _close(self, closing: RobotRunnerEvents, opening: RobotRunnerEvents, emission: Emission | None) -> None:
        # Who has no callback for the opening event may have opened something elsewhere, and hears the closing too.
        openers = {subscriber.owner for subscriber in self._experiment.events.subscribers(opening)}
        unreached = openers - set(emission.reached) if emission else set()
        everybody = {subscriber.owner for subscriber in self._experiment.events.subscribers(closing)}
        self._emit(closing, among=everybody - unreached)

    def _emit(self, event: RobotRunnerEvents, among: set[str] | None = None) -> Emission:
        self._report("event", {"event": event.value, "at": utc_now(), "clock": self._clock.now()})
        try:
            with self._gate.armed(not event.is_closing):
                emission = self._experiment.events.emit(event, self._context_for, among=among)
        except RunInterrupted as error:  # between two callbacks: nobody knows who was reached, so all are closed
            emission = Emission((), self._owners(), (CallbackFailure(event, "", error),))
        for failure in emission.failures:
            self._record(event.value, failure.owner, failure.error)
        return emission

    def _owners(self) -> tuple[str, ...]:
        return (*(plugin.name for plugin in self._experiment.plugins), CONFIG_OWNER)

    def _make_safe(self) -> None:
        for system in reversed(self._experiment.systems):
            with self.recorded("make_safe", system.name):
                system.make_safe(self._context_for(system.name))

    def _record(self, event: str, owner: str, error: BaseException) -> None:
        self._failed = True
        fields = failure_fields(error)
        sys.stderr.write(f"{event} of {owner} failed\n{fields['traceback']}")  # into the run's log
        self._report("failure", {"event": event, "owner": owner, **fields})


def failure_fields(error: BaseException) -> dict[str, str]:
    """Return the problem in one line, and the traceback."""
    text = str(error)
    problem = text if isinstance(error, RobotRunnerError | RunInterrupted) else f"{type(error).__name__}: {text}"
    return {"problem": problem, "traceback": "".join(traceback.format_exception(error))}


def publish_returned(context: RobotRunnerContext, returned: object) -> None:
    """Publish what a `populate_run_data` callback returned; it adds to and overrides what was published.

    Raises:
        MeasureError: it is no mapping, or one of its entries is refused; all of them are named.
    """
    if returned is None:
        return
    if not isinstance(returned, Mapping):
        raise MeasureError(
            f"populate_run_data returned {returned!r}, of type {type(returned).__name__}",
            where=context.owner,
            fix="Return a mapping from measure to value, or nothing.",
        )
    refused = [error for name, value in returned.items() if (error := _refused(context, name, value))]
    if refused:
        fixes = " ".join(dict.fromkeys(error.fix for error in refused))
        raise MeasureError("; ".join(error.problem for error in refused), where=context.owner, fix=fixes)


def _refused(context: RobotRunnerContext, name: Any, value: object) -> MeasureError | None:
    try:
        context.publish(name, value, origin=_origin_of_returned(context, name))
    except MeasureError as error:
        return error
    return None


def _origin_of_returned(context: RobotRunnerContext, name: object) -> Origin:
    """Return where a returned value comes from: what was computed from simulated samples does not pass for measured."""
    published = context.broker.measures
    if isinstance(name, str) and name in published:
        return published[name].origin
    if is_simulated(context.robot):
        return Origin.SIMULATED
    origins = {measure.origin for measure in published.values()}
    return origins.pop() if len(origins) == 1 else Origin.MEASURED
