"""The slots of this machine, and how a run begins at one: in a process of its own, supervised, or in this one."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, redirect_stderr, redirect_stdout
from dataclasses import replace
from functools import partial
from typing import Any

from robot_runner.core.config.claims import Claims, worker_count
from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.parameters import Parameters, RunProcess
from robot_runner.core.entry_points import named_entry_point
from robot_runner.core.errors import PluginError, RobotRunnerError
from robot_runner.core.events.early_end import RunInterrupted
from robot_runner.core.execution.inherited_state import write_inherited
from robot_runner.core.execution.interruption import InterruptGate
from robot_runner.core.execution.keeper import KEEPING, Keeper, reap_keepers
from robot_runner.core.execution.places import Place, Places, RunInFlight, Watch
from robot_runner.core.execution.processes import await_end
from robot_runner.core.execution.run_events import execute_run, systems_of_standby
from robot_runner.core.execution.run_records import FINISHED, RecordReader
from robot_runner.core.execution.standby import Standby
from robot_runner.core.execution.task import OutcomeBuilder, RunOutcome, RunTask
from robot_runner.core.execution.worker import be_run, become_interpreter
from robot_runner.core.links.connect import is_simulated, preload_before_forks
from robot_runner.core.secret_names import sentences_without_secrets
from robot_runner.core.storage.layout import LazyLog

#: How long after the grace a keeper that should have ended its run is waited for, s.
_KEEPER_MARGIN = 10.0
#: When a keeper whose run is dead is looked at first, and then how often, s: one that is stopped does not report that.
_SOON, _OFTEN = 0.1, 0.5


class LocalPlace:
    """A slot of this machine, with a log and marks of its own for the run that it executes; it may have its own robot.

    Slots are numbered from 1. `robot` is the name of its robot, of those that take turns, and how it is reached.
    """

    def __init__(self, experiment: Experiment, slot: int, robot: tuple[str, str] | None = None) -> None:
        self.name = f"slot {slot}" if robot is None else robot[0]
        self.slot = slot
        self.is_unavailable = False
        own = experiment.parameters if robot is None else experiment.parameters.but(robot=robot[1])
        self._own = frozenset() if robot is None or is_simulated(robot[1]) else frozenset((f"robot:{robot[1]}",))
        self.experiment = replace(experiment, folder=experiment.folder.at_slot(slot), parameters=own)
        load_before_forks(self.experiment)

    def claimed(self, claims: Collection[str], combination: Mapping[str, object]) -> frozenset[str] | None:
        """Return the claims: they are about this machine and what is connected to it; its own robot is one of them."""
        del combination
        return self._own.union(claims)

    def begin(self, task: RunTask, builder: OutcomeBuilder, watch: Watch) -> RunInFlight:
        """Begin an attempt in a process of its own, or execute it in this one (`IN_PROCESS`)."""
        return begin_run(self.experiment, task, builder, watch)


class LocalPlaces:
    """The slots of this machine."""

    descriptors: Collection[int] = ()
    due: float | None = None

    def __init__(self, places: Iterable[Place]) -> None:
        self.all: Sequence[Place] = tuple(places)

    def advance(self, *, is_idle: bool = False) -> Sequence[str]:
        """Say nothing: slots neither come nor go."""
        del is_idle
        return ()

    def close(self) -> None:
        """Wait until the last keepers are gone."""
        reap_keepers()


def places_of(experiment: Experiment, claims: Claims, combinations: Iterable[Mapping[str, Any]]) -> Places:
    """Return the places of an experiment: its robots, or slots; one slot where all runs claim the same.

    Those of a cluster come from the room `cluster`, by the entry point group `robot_runner.places`.

    Raises:
        PluginError: no installed package has places of a cluster.
        ExecutionError: the experiment cannot be executed there.
    """
    if (address := experiment.parameters.cluster) is not None:
        point = named_entry_point("places", "cluster")
        if point is None:
            fix = "Install Robot Runner again: pip install 'robot-runner[cluster]'."
            raise PluginError("no installed package executes runs on a cluster", where=f"cluster {address}", fix=fix)
        places: Places = point.load()(experiment, address)
        return places
    if experiment.parameters.robots:
        robots = experiment.parameters.robots.items()
        return LocalPlaces(LocalPlace(experiment, slot, robot) for slot, robot in enumerate(robots, 1))
    count = worker_count(experiment.parameters)
    count = 1 if count > 1 and claims.common(combinations) else count
    return LocalPlaces(LocalPlace(experiment, slot) for slot in range(1, count + 1))


def load_before_forks(experiment: Experiment) -> None:
    """Import the links to robots into this process, so that no run or standby that is forked from it has to."""
    if experiment.parameters.run_process is RunProcess.FORK:
        preload_before_forks(experiment.parameters.robot)


def begin_run(
    experiment: Experiment, task: RunTask, builder: OutcomeBuilder, watch: Watch, *, may_command: bool = True
) -> RunInFlight:
    """Begin one attempt at a run on this machine, in the way that the config's `run_process` asks for.

    The experiment has the files of the slot that executes it. `builder` holds what the orchestrator has recorded of the
    attempt. Where it `may_command` a robot, a standby is needed.
    """
    if experiment.parameters.run_process is RunProcess.IN_PROCESS:
        return _executed_here(experiment, task, builder, watch)
    start = be_run if experiment.parameters.run_process is RunProcess.FORK else become_interpreter
    standby = Standby(systems_of_standby(experiment), experiment, task) if may_command else None
    write_inherited()
    with ExitStack() as opened:
        state = None if standby is None else opened.enter_context(closing(standby.state))
        run = partial(start, experiment, task, state)
        keeper = opened.enter_context(Keeper(run, experiment.parameters.grace_in_s, experiment.folder, standby))
        return _Supervision(keeper, builder, experiment.parameters, watch, standby, opened.pop_all())


def _executed_here(experiment: Experiment, task: RunTask, builder: OutcomeBuilder, watch: Watch) -> RunInFlight:
    gate, refused, is_over = InterruptGate(), list[RobotRunnerError](), False

    def report(kind: str, fields: dict[str, Any]) -> None:
        fields = sentences_without_secrets(fields)  # as on the way from another process
        builder.take(kind, fields)
        try:
            watch.report(kind, fields)
            watch.refresh()
        except RobotRunnerError as error:  # a full disk: before it ends the experiment, the run is closed and made safe
            if is_over:  # for the thread of the run that publishes too late
                raise
            refused.append(error)
            gate.end_run(RunInterrupted(f"the records of the run cannot be kept: {error.problem}"))

    log, passed_on = LazyLog(experiment.folder), watch.interruption.passed_on(gate)
    with log, redirect_stdout(log), redirect_stderr(log), passed_on:
        execute_run(experiment, task, report, gate)
    report(FINISHED, {})
    is_over = True
    if refused:
        raise refused[0]
    return EndedRun(builder.outcome(interrupted=watch.interruption.is_requested))


class EndedRun:
    """A run that is over when it is returned."""

    descriptors: Collection[int] = ()
    due: float | None = 0.0

    def __init__(self, outcome: RunOutcome) -> None:
        self._outcome = outcome

    def advance(self) -> bool:
        """Say that it is over."""
        return True

    def stop(self, because: str, *, is_interruption: bool = False) -> None:
        """Do nothing: it has ended."""

    def kill(self) -> None:
        """Do nothing: it has ended."""

    def outcome(self) -> RunOutcome:
        """Return how it went."""
        return self._outcome

    def close(self) -> None:
        """Do nothing: there is nothing left of it."""


class _Supervision:
    """Watches over the process of a run: its records, its deadlines, its end.

    A deadline that passes and an interruption have the same consequence: the keeper asks the run to stop, and kills
    it with everything that it started when it has not ended after the grace period.
    """

    def __init__(
        self,
        keeper: Keeper,
        builder: OutcomeBuilder,
        parameters: Parameters,
        watch: Watch,
        standby: Standby | None,
        opened: ExitStack,
    ) -> None:
        self._keeper = keeper
        self._standby = standby
        self._builder = builder
        self._builder.event = ""  # that of the orchestrator is over
        self._parameters = parameters
        self._grace = parameters.grace_in_s
        self._watch = watch
        self._opened = opened
        self._reader = RecordReader(keeper.records)
        self._started = self._event_started = time.monotonic()
        self._give_up_at: float | None = None
        self._leave_by: tuple[float, str] | None = None
        self._is_interrupted = False
        self._is_killed = False
        self._because = ""
        self._awaits_records = True
        self._end: Iterator[float] | None = None
        self._look_at = 0.0
        self._outcome: RunOutcome | None = None

    @property
    def descriptors(self) -> Collection[int]:
        """The pipes with its records, and from its keeper unless that was killed."""
        records = (self._keeper.records,) if self._awaits_records else ()
        return (*records, self._keeper.told) if self._end is None else records

    @property
    def due(self) -> float | None:
        """The next deadline, or the next look at the processes of a dead keeper."""
        if self._end is not None:
            return self._look_at
        leave_by = None if self._leave_by is None or self._because else self._leave_by[0]
        look_at = None if self._awaits_records else self._look_at
        deadlines = (self._give_up_at, leave_by, look_at, *self._deadlines())
        return min((deadline for deadline in deadlines if deadline is not None), default=None)

    def advance(self) -> bool:
        if self._awaits_records:
            self._take_records()
        if self._end is None:
            if not self._keeper.look():  # a run that has ended meanwhile took no longer than it did
                self._enforce()
                return False
            self._end = self._ending()
        wait = next(self._end, None)
        if wait is None:
            return True
        self._look_at = time.monotonic() + wait
        return False

    def outcome(self) -> RunOutcome:
        if self._outcome is None:
            raise AssertionError("the run is not over")
        return self._outcome

    def close(self) -> None:
        self._opened.close()

    def stop(self, because: str, *, is_interruption: bool = False) -> None:
        if self._because or self._end is not None:
            return
        if is_interruption:
            self._is_interrupted = True
            self._watch.noticed_interruption()
        self._because = because
        self._give_up_at = time.monotonic() + self._grace + _KEEPER_MARGIN
        self._keeper.stop()

    def kill(self) -> None:
        if not self._is_killed:
            self._is_killed = self._is_interrupted = True
            self._keeper.kill()

    def _ending(self) -> Iterator[float]:
        """Finish the attempt once the keeper has reported, or was killed; yield how long to wait each time, s."""
        if self._keeper.was_killed:
            yield from self._keeper.abandoned_run_ended(self._grace)
        self._take_records()  # the last ones before it ended
        if self._standby is not None and self._keeper.run is not None:
            yield from self._standby.looked_after(self._keeper.run)
            if (finding := self._standby.finding()) is not None:
                self._take("finding", finding)
        self._outcome = self._builder.outcome(ended_because=self._reason(), interrupted=self._is_interrupted)

    def _take_records(self) -> None:
        records, self._awaits_records = self._reader.read()
        if not self._awaits_records:  # the keeper nearly always reports in a moment
            self._look_at = time.monotonic() + _SOON
        for kind, fields in records:
            if kind == "event":
                self._event_started = time.monotonic()
                self._leave_by = None
                if not self._builder.event:  # the first one: a fresh interpreter has loaded the config by now
                    self._started = self._event_started
            elif kind == "mission_stopped" or fields.get("ends_event"):
                reason = fields["reason" if kind == "mission_stopped" else "problem"]
                self._leave_by = self._leave_by or (time.monotonic() + self._grace, reason)
            self._take(kind, fields)

    def _take(self, kind: str, fields: dict[str, Any]) -> None:
        self._builder.take(kind, fields)
        self._watch.report(kind, fields)

    def _deadlines(self) -> tuple[float | None, float | None]:
        """Return the moments at which the run, and its present event, have taken too long."""
        if self._because:  # it was asked to stop
            return None, None
        run, event = self._parameters.run_deadline_in_s, self._parameters.event_deadline_in_s
        return (None if run is None else self._started + run, None if event is None else self._event_started + event)

    def _enforce(self) -> None:
        now = time.monotonic()
        run_deadline, event_deadline = self._deadlines()
        if run_deadline is not None and now >= run_deadline:
            self.stop(f"the run took longer than run_deadline_in_s = {self._parameters.run_deadline_in_s:g} s")
        elif event_deadline is not None and now >= event_deadline:
            limit = f"longer than event_deadline_in_s = {self._parameters.event_deadline_in_s:g} s"
            self.stop(
                f"the event took {limit}"
                if self._builder.event
                else f"the run's process took {limit} to begin its first event"
            )
        elif self._leave_by is not None and now >= self._leave_by[0] and not self._because:
            self.stop(f"{self._leave_by[1]}; {self._builder.event} had not ended grace_in_s = {self._grace:g} s later")
        if not self._awaits_records and now >= self._look_at:
            self._look_at = now + _OFTEN
            if (run := self._keeper.run) is None or await_end(run, 0.0):  # else it has closed the pipe itself
                self._keeper.wake()
                self._give_up_at = self._give_up_at or now + KEEPING
        if self._give_up_at is not None and now >= self._give_up_at:
            self._give_up_at = None
            self._keeper.give_up()

    def _reason(self) -> str:
        """Return why the run ended where it did not end by itself."""
        if self._because:
            return self._because
        if self._keeper.has_failed and self._builder.has_failed:
            return ""  # it has said itself why it could not go on
        if self._keeper.was_killed or not self._builder.is_finished:
            return self._keeper.death() or "the run's process exited with code 0 before the run had ended"
        return ""
