"""The events that the orchestrating process emits itself, and the state that its parts share."""

from __future__ import annotations

import os
import select
import signal
import time
import traceback
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import Any, Self

from robot_runner.core.config.experiment import Experiment
from robot_runner.core.design.watched_combination import WatchedCombination
from robot_runner.core.errors import ExecutionError, Finding, RobotRunnerError, StorageError
from robot_runner.core.events.context import ExperimentContext, ExperimentEnd, NextRun, RobotRunnerContext, SystemClock
from robot_runner.core.events.early_end import RunInterrupted, undivided
from robot_runner.core.events.manager import CallbackFailure, Emission, RobotRunnerEvents, Subscriber
from robot_runner.core.events.resources import Resources
from robot_runner.core.execution.clock_jumps import NotedSettings
from robot_runner.core.execution.inherited_state import note_fresh_files, seed_random_numbers
from robot_runner.core.execution.interruption import InterruptGate
from robot_runner.core.execution.notices import FindingsNoticed, Notice, Observer
from robot_runner.core.execution.poll_loop import PollLoop
from robot_runner.core.execution.processes import forked
from robot_runner.core.execution.progress_manager import ProgressManager
from robot_runner.core.execution.run_events import run_contexts
from robot_runner.core.execution.run_records import failure_fields
from robot_runner.core.execution.task import OutcomeBuilder, PendingRun, Report, RunTask, seed_of_run
from robot_runner.core.secret_names import sentences_without_secrets
from robot_runner.core.storage.journal import utc_now
from robot_runner.core.treatments import CONFIG_MODULE, bind

#: How many times over `grace_in_s` a callback may take to end once its deadline has passed.
_PATIENCE = 3
#: After how long it is looked again whether a callback is executed whose deadline has passed, s.
_SOON = 0.01
#: The longest timeout that is given to the system, s: thirty years.
_LONGEST = 1e9
#: Shows the cursor of a terminal, which the live screen hides.
_SHOW_CURSOR = "\x1b[?25h"


class DeadlinePassed(BaseException):
    """Raised in a callback that takes too long. A BaseException, so that callbacks do not swallow it."""


class EventDeadline:
    """Raises `DeadlinePassed` in a callback of an event that is emitted in its `with` block, once that takes too long.

    A timer signal ends the callback. Python handles signals between two of its own instructions: a signal interrupts
    sleeping, waiting and I/O, but not code in C that computes, or that waits again after each signal. Nothing in this
    process can end that, so a watcher, a process of its own, kills the orchestrator then: the experiment stops instead
    of hanging, and can be resumed.

    Where callbacks swallow the exception, it is raised again each `grace` seconds. Use it in the main thread.
    """

    def __init__(self, what: str, seconds: float, grace: float) -> None:
        self._what = what
        self._seconds = seconds
        self._grace = grace
        self._is_armed = False
        self._watcher = (0, -1)

    def __str__(self) -> str:
        return f"the event took longer than event_deadline_in_s = {self._seconds:g} s"

    def __enter__(self) -> Self:
        self._watcher = self._watch()
        self._earlier = signal.signal(signal.SIGALRM, self._take_signal)
        self._is_armed = True
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGALRM})  # a parent process may have blocked it
        signal.setitimer(signal.ITIMER_REAL, min(_LONGEST, self._seconds), min(_LONGEST, self._grace))
        return self

    def __exit__(self, *raised: object) -> None:
        self._is_armed = False
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, self._earlier)
        self._dismiss_watcher()

    def _take_signal(self, number: int, frame: FrameType | None) -> None:
        del number
        if not self._is_armed:
            return
        if _is_of_callback(frame) and not undivided.is_entered:
            raise DeadlinePassed(str(self))
        # Between callbacks it would leave a part of this deadline behind.
        signal.setitimer(signal.ITIMER_REAL, _SOON, min(_LONGEST, self._grace))

    def _watch(self) -> tuple[int, int]:
        """Start the watcher; return its process id, and a descriptor to write to once the event has ended."""
        reader, writer = os.pipe()
        watcher = forked()
        if watcher == 0:
            try:
                os.close(writer)
                self._end_orchestrator_unless_told(reader)
            finally:  # whatever goes wrong, the watcher must not go on as a second orchestrator
                os._exit(0)
        os.close(reader)
        return watcher, writer

    def _dismiss_watcher(self) -> None:
        watcher, line = self._watcher
        with suppress(BrokenPipeError):  # somebody killed it
            os.write(line, b".")  # closing is not enough: a callback may have left a process that holds the line open
        os.close(line)
        with suppress(ChildProcessError):  # a callback waited for all children
            os.waitpid(watcher, 0)

    def _end_orchestrator_unless_told(self, reader: int) -> None:
        orchestrator = os.getppid()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)  # the orchestrator decides
        told, _, _ = select.select([reader], [], [], min(_LONGEST, self._seconds + _PATIENCE * self._grace))
        if not told and os.getppid() == orchestrator:
            with suppress(OSError):  # nobody reads it
                os.write(2, self._last_words().encode())
            os.kill(orchestrator, signal.SIGKILL)

    def _last_words(self) -> str:
        cursor = _SHOW_CURSOR if os.isatty(2) else ""
        return (
            f"{cursor}\nerror: {self._what}: {self}, and code that is not Python's keeps it from being ended: the "
            "experiment is killed\n  fix: Correct this callback and start the experiment again: it resumes.\n"
        )


def _is_of_callback(frame: FrameType | None) -> bool:
    while frame is not None and frame.f_code is not Subscriber.call.__code__:
        frame = frame.f_back
    return frame is not None


#: How often the run table is brought up to date while a callback of this process sleeps, s.
_LOOK = 1.0


class _AttentiveClock(SystemClock):
    """The clock of callbacks of this process: the screen is kept up to date while they sleep on it."""

    def __init__(self, poll_loop: PollLoop) -> None:
        self._poll_loop = poll_loop

    def sleep(self, seconds: float) -> None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            time.sleep(min(left, self._poll_loop.refresh_interval or _LOOK))
            self._poll_loop.refresh_screen()


class OrchestratorEvents:
    """Emits `before_experiment`, `before_run`, `continue` and `after_experiment`, within `event_deadline_in_s`."""

    def __init__(self, experiment: Experiment, progress: ProgressManager, poll_loop: PollLoop) -> None:
        self._experiment = experiment
        self._progress = progress
        self._poll_loop = poll_loop
        self._interruption = poll_loop.interruption

    def emit_to_run(
        self,
        event: RobotRunnerEvents,
        task: RunTask,
        report: Report,
        experiment: Experiment,
        adapt: Callable[[RobotRunnerContext], RobotRunnerContext] = lambda context: context,
    ) -> list[object]:
        """Emit `before_run` or `continue` in this process; an exception is a failure of the run.

        The experiment is as the place of the run has it; `adapt` changes the context of each owner. Return what each
        callback returned.
        """

        def told(kind: str, fields: dict[str, Any]) -> None:
            with undivided:
                report(kind, sentences_without_secrets(fields))  # as on the way from the process of a run
            self._poll_loop.refresh_screen()

        told("event", {"event": event.value, "at": utc_now(), "clock": time.monotonic()})
        if not self._experiment.events.subscribers(event):
            return []
        if event is RobotRunnerEvents.BEFORE_RUN:  # random numbers that depend on the run alone, not on the order
            seed_random_numbers(seed_of_run(task.run_seed, event.value))
        resources = Resources()
        clock = _AttentiveClock(self._poll_loop)
        context_for = run_contexts(experiment, task, clock=clock, resources=resources, report=told)
        try:
            emission = self._emit(event, lambda owner: adapt(context_for(owner)))
            if event is RobotRunnerEvents.BEFORE_RUN:
                note_fresh_files()
            for failure in emission.failures:
                told("failure", {"event": event.value, "owner": failure.owner, **_fields(failure)})
            return [returned for _, returned in emission.returned]
        finally:
            resources.close()

    def emit_to_experiment(self, event: RobotRunnerEvents, ended: ExperimentEnd | None = None) -> list[object]:
        """Emit an event of the whole experiment; return what each callback returned.

        `after_experiment` is emitted also where the folder cannot be written any more: what was opened is closed.

        Raises:
            ExecutionError: a callback raised, or took too long.
            StorageError: the event cannot be recorded.
        """
        context = ExperimentContext(
            experiment_name=self._experiment.parameters.experiment_name,
            experiment_folder=self._experiment.folder.root,
            robot=self._experiment.parameters.robot,
            seed=self._progress.seed,
            ended=ended,
        )
        untold: StorageError | None = None
        try:
            self._progress.note("event", event=event.value)
        except StorageError as error:
            if event is not RobotRunnerEvents.AFTER_EXPERIMENT:
                raise
            untold = error
        emission = self._emit(event, lambda _: context)
        if untold is not None:
            raise untold
        for failure in emission.failures:
            if isinstance(failure.error, RunInterrupted):
                break
            fields = _fields(failure)
            self._progress.note("failure", event=event.value, owner=failure.owner, problem=fields["problem"])
            raise ExecutionError(
                fields["problem"],
                where=f"{failure.event.value} of {failure.owner}" if failure.owner else failure.event.value,
                fix="Correct this callback and start the experiment again: it resumes.",
            ) from failure.error
        return [returned for _, returned in emission.returned]

    def user_has_continued(
        self,
        finished: PendingRun,
        following: PendingRun,
        read: Callable[[str, str], None],
        place: str,
        experiment: Experiment,
    ) -> bool:
        """Emit `continue`; return whether a callback has returned True, as it has asked the user itself.

        What is published is a measure of the run that has finished. `read` is called with a factor and an owner when
        the owner reads its treatment in the run that comes next. `place`, which has this experiment, is where both are
        executed; empty where there is one place only.

        Raises:
            ExecutionError: a callback raised, or took too long.
        """
        task = self._progress.task_of(finished, place)
        published = OutcomeBuilder(task.run_id, self._experiment.columns)
        before = self._progress.last_outcome(place)
        published.go_on_from(before)
        task.measures.update(before.fields()["measures"])

        def report(kind: str, fields: dict[str, Any]) -> None:
            published.take(kind, fields)
            self._progress.record(task, kind, fields)

        def adapt(context: RobotRunnerContext) -> RobotRunnerContext:
            return replace(context, next_run=self._next_run(following, lambda factor: read(factor, context.owner)))

        if place:  # a run at another place has begun since, whose treatments plugins have by now
            self._bind_again(task)
        returned = self.emit_to_run(RobotRunnerEvents.CONTINUE, task, report, experiment, adapt)
        outcome = published.outcome()
        self._progress.amend_outcome(task, before, outcome)
        if outcome.failure is not None and not self._interruption.is_requested:
            where = " of ".join(filter(None, (outcome.failure.event, outcome.failure.owner)))
            raise ExecutionError(outcome.failure.problem, where=where, fix="Correct this callback, and resume.")
        return any(value is True for value in returned)

    def _bind_again(self, task: RunTask) -> None:
        for plugin in self._experiment.plugins:
            try:
                bind(plugin, task.combination)
            except Exception as error:
                problem = failure_fields(error)["problem"]
                raise ExecutionError(problem, where=plugin.name, fix="Correct this plugin, and resume.") from error

    def _next_run(self, run: PendingRun, read: Callable[[str], None]) -> NextRun:
        task = self._progress.task_of(run)
        return NextRun(run.run_id, run.number, WatchedCombination(task.combination, read), task.repetition)

    def _emit(self, event: RobotRunnerEvents, context_for: Callable[[str], object]) -> Emission:
        """Emit an event in this process; Ctrl-C, and the deadline, end the callback that is being executed."""
        gate = InterruptGate()
        subscribers = self._experiment.events.subscribers(event)
        limit = self._experiment.parameters.event_deadline_in_s
        with ExitStack() as guarded:
            if limit is not None and subscribers:  # outside of the gate, so that nothing of it is left half done
                owners = ", ".join(dict.fromkeys(each.owner for each in subscribers))
                what = f"{event.value} of {owners}"
                guarded.enter_context(EventDeadline(what, limit, self._experiment.parameters.grace_in_s))
            try:
                with self._interruption.passed_on(gate):
                    if event is not RobotRunnerEvents.AFTER_EXPERIMENT:
                        gate.arm()
                    return self._experiment.events.emit(event, context_for)
            except RunInterrupted as error:  # between two callbacks
                return Emission((), (), (CallbackFailure(event, "", error),))


@dataclass(slots=True)
class OngoingExperiment:
    """An experiment that is being executed: the state that the parts of the orchestrator share.

    Attributes:
        observer: the screen, and its keyboard.
        notify: gives a notice to the observer and to notifications.
        poll_loop: how the orchestrator waits.
        clock: records by how much the clock of time stamps was set.
        has_one_place: whether no two runs are ever in flight together.
        stopped_by: why no more runs begin, `on_failure`, `a gate`, `a guard` or `a robot that may be moving`; those in
            flight come to their end. Empty while it goes on.
    """

    experiment: Experiment
    progress: ProgressManager
    events: OrchestratorEvents
    observer: Observer
    notify: Callable[[Notice], None]
    poll_loop: PollLoop
    clock: NotedSettings
    has_one_place: bool
    stopped_by: str = ""

    @property
    def is_interrupted(self) -> bool:
        """Whether the user has interrupted."""
        return self.poll_loop.interruption.is_requested

    @property
    def is_ending(self) -> bool:
        """Whether nothing is to begin any more."""
        return self.is_interrupted or bool(self.stopped_by)

    def find(self, finding: Finding) -> None:
        """Show a finding now, and keep it for the end."""
        self.progress.find(finding)
        self.notify(FindingsNoticed((finding,)))


def _is_of_config(frame: FrameType) -> bool:
    return bool(frame.f_globals.get("__name__") == CONFIG_MODULE)  # `eval` may have globals without a name


def _fields(failure: CallbackFailure) -> dict[str, str]:
    """Return the fields of a failure; its problem names the line of the config, as no log has this traceback."""
    fields, error = failure_fields(failure.error), failure.error
    if isinstance(error, DeadlinePassed):
        return {**fields, "problem": str(error)}
    if isinstance(error, RobotRunnerError | RunInterrupted):  # its text says all
        return fields
    frames = [each for each in traceback.walk_tb(error.__traceback__) if _is_of_config(each[0])]
    for frame, line in frames[-1:]:
        fields["problem"] += f" ({Path(frame.f_code.co_filename).name}:{line})"
    return fields
