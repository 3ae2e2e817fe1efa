"""One run: its six events. A closing event follows what an opening event reached, whatever fails in between."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import closing, contextmanager
from functools import partial
from typing import Any

from robot_runner.core.config.experiment import Experiment
from robot_runner.core.design.watched_combination import WatchedCombination
from robot_runner.core.errors import MeasureError, did_you_mean
from robot_runner.core.events.context import Clock, RobotRunnerContext
from robot_runner.core.events.early_end import Ending, EndingInPlace, MissionStopped, RunInterrupted
from robot_runner.core.events.manager import CLOSED_BY, CallbackFailure, Emission, RobotRunnerEvents, check_executed
from robot_runner.core.events.measure import CONFIG_OWNER, Origin
from robot_runner.core.events.measure_broker import MeasureBroker
from robot_runner.core.events.resources import Resources, closing_left_open
from robot_runner.core.events.window import MissionTimes
from robot_runner.core.execution.callback_claims import claims_of_run
from robot_runner.core.execution.clock_jumps import CLOCKS, ClockJumps, told_setting
from robot_runner.core.execution.inherited_state import seed_random_numbers
from robot_runner.core.execution.interruption import InterruptGate
from robot_runner.core.execution.run_ending import RunEnding
from robot_runner.core.execution.systems_state import Care, SystemsState
from robot_runner.core.execution.task import Report, RunTask
from robot_runner.core.links.commanded_topics import hear_commanded
from robot_runner.core.links.connect import is_simulated, open_clock
from robot_runner.core.links.host_commands import opened_host
from robot_runner.core.plugin import System, usual_origin
from robot_runner.core.storage.journal import utc_now


def execute_run(
    experiment: Experiment, task: RunTask, report: Report, gate: InterruptGate, systems: SystemsState | None = None
) -> None:
    """Execute one run and report what happens as it happens.

    Nothing is raised: a failure is a record like any other. What was opened is closed, systems are made safe.
    """
    with claims_of_run(experiment, task, report):
        _Run(experiment, task, report, gate, systems).execute()


def has_standby(experiment: Experiment) -> bool:
    """Return whether a run has something to be made safe from its beginning on."""
    robot = experiment.parameters.robot
    return bool(systems_of_standby(experiment)) or (robot is not None and not is_simulated(robot))


def systems_of_standby(experiment: Experiment) -> list[System]:
    """Return the systems that are made safe where a run dies; none of the embedded robot, which dies with its run."""
    return [] if is_simulated(experiment.parameters.robot) else made_safe_of_their_own(experiment)


def made_safe_of_their_own(experiment: Experiment) -> list[System]:
    """Return the systems that have a `make_safe` of their own."""
    return [each for each in experiment.systems if type(each).make_safe is not System.make_safe]


def run_contexts(
    experiment: Experiment,
    task: RunTask,
    *,
    clock: Clock,
    resources: Resources,
    report: Report,
    ending: Ending | None = None,
) -> Callable[[str], RobotRunnerContext]:
    """Return a function that makes the context of a run for an owner; all of them share one broker.

    `ending` ends the run from any thread; None in the orchestrator, where `context.fail` ends the callback itself.
    """
    broker = MeasureBroker(task.run_id, experiment.columns, report, task.measures, task.shared)
    times = MissionTimes(clock, report, experiment.parameters.phases)
    run_path = experiment.folder.run(task.run_id)
    hosts = partial(opened_host, experiment.parameters.hosts)
    plugins = {plugin.name: plugin for plugin in experiment.plugins}
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
                attempts_left=task.attempts_left,
                combination=WatchedCombination(
                    task.combination, lambda factor: report("read", {"owner": owner, "factor": factor})
                ),
                repetition=task.repetition,
                run_seed=task.run_seed,
                run_path=run_path,
                clock=clock,
                resources=resources,
                owner=owner,
                times=times,
                broker=broker,
                ending=ending or EndingInPlace(),
                hosts=hosts,
                usual_origin=usual_origin(plugins.get(owner), is_simulated=is_simulated(experiment.parameters.robot)),
            )
        return made[owner]

    return context_for


class _Run:
    """One run in its own process."""

    def __init__(
        self, experiment: Experiment, task: RunTask, report: Report, gate: InterruptGate, systems: SystemsState | None
    ) -> None:
        self._experiment = experiment
        self._task = task
        self._report = report
        self._gate = gate
        self._resources = Resources()
        self._ending = RunEnding(report, gate)
        self._is_stopped = self._is_closed = False
        self._systems = systems
        self._has_moved = False
        self._made_safe: set[str] = set()

    def execute(self) -> None:
        closed_last = RobotRunnerEvents.STOP_RUN.value  # the event during which a link fails to close
        with self._ending.from_any_thread(), self._recorded(closed_last, "link"):
            with closing_left_open(), closing(self._resources), self._recorded("", "link"):
                self._open()
                self._emit_events()
                self._ending.callback = (closed_last, "link")
            self._is_closed = True
        if self._systems is not None and self._is_safe:
            self._systems.set(Care.SAFE)

    @property
    def _is_safe(self) -> bool:
        """Whether no standby is needed: the run ended in order, its robot had not moved, or all systems were made safe.

        In the last case links have to be closed, too: closing one stops what it commanded.
        """
        has_moved = self._has_moved or (self._systems is not None and bool(self._systems.commanded))
        was_left = self._ending.has_failed and has_moved
        return not was_left or (self._is_closed and len(self._made_safe) == len(self._experiment.systems))

    def _open(self) -> None:
        task, resources = self._task, self._resources
        self._clock = open_clock(self._experiment.parameters.robot, resources, seed=task.run_seed)
        seed_random_numbers(task.run_seed)  # after the clock: the simulator has imported NumPy by now
        self._context_for = run_contexts(
            self._experiment, task, clock=self._clock, resources=resources, report=self._report, ending=self._ending
        )

    def _emit_events(self) -> None:
        if self._systems is not None:
            hear_commanded(self._systems.add_commanded)
            if has_standby(self._experiment):
                self._systems.set(Care.RUN)  # from here on, the standby makes them safe if this process dies
        jumps = ClockJumps()
        with self._between(RobotRunnerEvents.START_RUN):
            if not self._ending.has_failed:
                with self._between(RobotRunnerEvents.START_MEASUREMENT):
                    if not self._ending.has_failed:
                        self._execute_mission()
        if self._is_stopped:
            self._make_safe()
        if not self._ending.has_failed:
            self._populate()
        if self._ending.has_failed:
            self._make_safe()
        self._look_at_stamps(jumps)

    def _execute_mission(self) -> None:
        times = self._context_for(CONFIG_OWNER).times
        times.begin()
        jumps = ClockJumps()
        self._has_moved = True
        try:
            self._emit(RobotRunnerEvents.LAUNCH_MISSION)
        finally:
            times.end(has_failed=self._ending.has_failed)
        self._look_at_window(jumps)

    def _look_at_window(self, jumps: ClockJumps) -> None:
        """Make the values of the run doubtful where this machine was suspended in the mission, its robot not."""
        if (seconds := jumps.suspended) and not is_simulated(self._experiment.parameters.robot):
            problem = f"this machine was suspended for {seconds:,.1f} s in the mission: window and samples lack that"
            fix = "Keep it awake (systemd-inhibit), and execute the run again."
            self._context_for(CONFIG_OWNER).broker.doubt_run(CLOCKS, problem, fix)

    def _look_at_stamps(self, jumps: ClockJumps) -> None:
        if seconds := jumps.was_set:
            self._context_for(CONFIG_OWNER).broker.warn(CLOCKS, *told_setting(seconds))

    @contextmanager
    def _between(self, opening: RobotRunnerEvents) -> Iterator[None]:
        """Emit an opening event, and afterwards its closing event, whatever fails in between."""
        emission = self._emit(opening)
        try:
            yield
        finally:
            # The closing event is not for those whose opening callback was not reached. It is for owners without an
            # opening callback, who may have opened something in another event.
            subscribers = {subscriber.owner for subscriber in self._experiment.events.subscribers(opening)}
            self._emit(CLOSED_BY[opening], but_not=subscribers.difference(emission.reached))

    def _make_safe(self) -> None:
        for system in reversed(self._experiment.systems):
            with self._recorded("make_safe", system.name):
                self._ending.callback = ("make_safe", system.name)
                made_safe(system, self._context_for(system.name))
                self._made_safe.add(system.name)

    def _populate(self) -> None:
        self._miss_phases()
        event = RobotRunnerEvents.POPULATE_RUN_DATA
        for owner, returned in self._emit(event).returned:
            with self._recorded(event.value, owner):
                publish_returned(self._context_for(owner), returned)

    def _miss_phases(self) -> None:
        """Warn of phases that the mission did not have, and whose measures the config requests."""
        context = self._context_for(CONFIG_OWNER)
        there = dict.fromkeys(phase.name for phase in context.phases)
        for name in context.times.requested:
            if name not in there:
                context.warn(f"the mission had no phase {name!r}", fix=did_you_mean(name, list(there)))

    def _emit(self, event: RobotRunnerEvents, but_not: Collection[str] = ()) -> Emission:
        self._ending.event = event
        self._report("event", {"event": event.value, "at": utc_now(), "clock": self._clock.now()})
        try:
            emission = self._call(event, but_not)
        except RunInterrupted as error:  # between two callbacks: any of them may have opened something
            owners = (*(plugin.name for plugin in self._experiment.plugins), CONFIG_OWNER)
            emission = Emission((), owners, (CallbackFailure(event, "", error),))
        self._ending.callback = ("", "")
        for failure in emission.failures:
            self._is_stopped = self._is_stopped or isinstance(failure.error, MissionStopped)
            self._ending.record(event.value, failure.owner, failure.error)
        return emission

    def _call(self, event: RobotRunnerEvents, but_not: Collection[str]) -> Emission:
        events, gate = self._experiment.events, self._gate

        def context_for(owner: str) -> RobotRunnerContext:
            self._ending.callback = (event.value, owner)
            return self._context_for(owner)

        if event.is_closing:
            return events.emit(event, context_for, but_not=but_not)
        try:
            gate.arm(is_mission=event is RobotRunnerEvents.LAUNCH_MISSION)
            return events.emit(event, context_for, but_not=but_not)
        finally:
            gate.disarm()

    @contextmanager
    def _recorded(self, event: str, owner: str) -> Iterator[None]:
        """Record any exception as a failure of the run, and go on."""
        try:
            yield
        except BaseException as error:  # noqa: BLE001 - also sys.exit, and a request to stop
            self._ending.record(event, owner, error)


def made_safe(system: System, context: RobotRunnerContext) -> None:
    """Call `make_safe` of a system.

    Raises:
        ConfigError: the call has executed nothing, as it is a generator or a coroutine.
    """
    make_safe: Callable[[RobotRunnerContext], object] = system.make_safe
    check_executed(make_safe(context), "make_safe", make_safe, system.name)


def publish_returned(context: RobotRunnerContext, returned: object) -> None:
    """Publish the measures that a `populate_run_data` callback returned; they may replace those published before.

    Raises:
        MeasureError: it is not a mapping, or one of its entries is refused; all of them are named.
    """
    if returned is None:
        return
    if not isinstance(returned, Mapping):
        problem = f"populate_run_data returned {returned!r}, of type {type(returned).__name__}"
        raise MeasureError(problem, where=context.owner, fix="Return a mapping from measure to value, or nothing.")
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
    """Return the origin of a returned value: one that was computed from simulated samples is simulated, too."""
    published = context.broker.measures
    if isinstance(name, str) and name in published and published[name].origin is not Origin.ENTERED:
        return published[name].origin
    if is_simulated(context.robot) or context.broker.has_simulated:
        return Origin.SIMULATED
    origins = {measure.origin for measure in published.values()} - {Origin.ENTERED}
    return origins.pop() if len(origins) == 1 else Origin.MEASURED
