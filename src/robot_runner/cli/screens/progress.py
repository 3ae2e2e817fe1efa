"""How far an experiment is, gathered from the notices: what a screen shows, without the screen."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.core.events.measure import PublishedMeasure, Quality
from robot_runner.core.execution.notices import (
    AttemptFinished,
    AttemptStarted,
    ExperimentFinished,
    ExperimentStarted,
    GatePassed,
    GateWaiting,
    NextDecided,
    Notice,
    Paused,
    RunRecord,
    UserHasContinued,
    WaitingForUser,
)
from robot_runner.core.execution.task import AttemptStatus, RunTask

if TYPE_CHECKING:
    from robot_runner.core.execution.durations import TimeLeft


@dataclass(slots=True)
class CurrentRun:
    """The run that is being executed.

    Attributes:
        started: when its attempt began, on the screen's clock.
        event: what is happening.
        shared: what plugins said last about what they do, such as the phase of a mission.
        failure: what went wrong in it, if anything did; what is open is closed then.
    """

    task: RunTask
    started: float
    event: str = ""
    shared: str = ""
    failure: str = ""


class Progress:
    """What a screen knows of an experiment.

    Args:
        clock: monotonic, in seconds.

    Attributes:
        run_count: all runs of the table; 0 before the experiment has started.
        done, failed: how many runs are done, earlier sessions included, and how many failed in this one.
        in_flight: the runs that are being executed, by id, in the order in which they began.
        run_ids: the runs that were executed in this session.
        origins: where the values of the run table came from, with the measures of each origin.
        bad_values: the runs of this session whose values are not good, by measure and quality.
        is_waiting: whether the user is asked to go on, or the experiment is paused.
        gates: what is awaited before runs, by run: several places may wait at the same time.
        gate_seconds: how long gates were awaited in this session, those that are over, s of their clocks.
        has_begun: whether any run was begun in this session.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._began = clock()
        self._left: TimeLeft | None = None
        self._left_since = self._began
        self._columns: tuple[str, ...] = ()
        self._asked_for: frozenset[str] = frozenset()
        self.run_count = 0
        self.done = 0
        self.failed = 0
        self._failed: set[str] = set()
        self.in_flight: dict[str, CurrentRun] = {}
        self.run_ids: dict[str, None] = {}
        self.origins: dict[str, dict[str, None]] = {}
        self.bad_values: dict[str, dict[str, list[str]]] = {}
        self.is_waiting = False
        self.gates: dict[str, GateWaiting] = {}
        self.gate_seconds = 0.0
        self.has_begun = False

    @property
    def elapsed(self) -> float:
        """How long the experiment has been executed in this session, in seconds."""
        return self._clock() - self._began

    @property
    def current(self) -> CurrentRun | None:
        """The run that is being executed, or that began last of several; None if there is none."""
        return next(reversed(self.in_flight.values()), None)

    def elapsed_in(self, run: CurrentRun) -> float:
        """Return how long the present attempt at a run has taken so far, in seconds."""
        return self._clock() - run.started

    @property
    def seconds_left(self) -> float | None:
        """How long the rest takes, in seconds, as the orchestrator estimated it last; None where that is not known."""
        return self._left.after(self._clock() - self._left_since) if self._left is not None else None

    @property
    def left_in_words(self) -> str:
        """The same in words; nothing where it is not known."""
        return self._left.in_words(self._clock() - self._left_since) if self._left is not None else ""

    def take(self, notice: Notice) -> None:
        """Take a notice into account."""
        match notice:
            case ExperimentStarted():
                self._began = self._clock()
                self._take_left(notice.left)
                self.run_count, self.done = notice.run_count, notice.done_count
                self._columns, self._asked_for = tuple(notice.columns), frozenset(notice.asked_for)
            case AttemptStarted():
                self.is_waiting = False
                self._take_left(notice.left)
                self.has_begun = True
                self.in_flight[notice.task.run_id] = CurrentRun(notice.task, self._clock())
            case RunRecord():
                self._take_record(notice)
            case AttemptFinished():
                self._take_end(notice)
                self._take_left(notice.left)
            case NextDecided():
                self.run_count = notice.run_count
            case WaitingForUser() | Paused() | UserHasContinued():
                self.is_waiting = not isinstance(notice, UserHasContinued)
            case GateWaiting():
                self.gates[notice.run_id] = notice
            case GatePassed():
                self.gates.pop(notice.run_id, None)
                self.gate_seconds += notice.seconds
            case ExperimentFinished():
                self.done, self.failed = notice.done_count, notice.failed_count

    def _take_left(self, left: TimeLeft | None) -> None:
        self._left, self._left_since = left, self._clock()

    def _take_record(self, notice: RunRecord) -> None:
        run, kind, fields = self.in_flight.get(notice.run_id), notice.kind, notice.fields
        if run is None:
            return
        if kind == "event":
            run.event = str(fields["event"])
            run.shared = ""
        elif kind == "shared":
            run.shared = _said(fields["values"])
        elif kind == "waiting":
            run.shared = f"waiting until {fields['condition']}: {fields['seen']}".removesuffix(": ")
        elif kind == "waited":
            run.shared = ""
        elif kind == "failure" and not run.failure:
            run.failure = str(fields["problem"])

    def _take_end(self, notice: AttemptFinished) -> None:
        self.in_flight.pop(notice.task.run_id, None)
        status = notice.outcome.status
        if status is AttemptStatus.INTERRUPTED:
            return
        for name in self._columns:
            measure = notice.outcome.measures.get(name)
            if measure is not None and measure.value is not None:
                self.origins.setdefault(measure.origin.value, {})[name] = None
        if notice.is_last:
            if status is AttemptStatus.DONE:
                self._take_qualities(notice.task.run_id, notice.outcome.measures)
            self.run_ids[notice.task.run_id] = None
            self.done += status is AttemptStatus.DONE
            self._failed.discard(notice.task.run_id)  # another robot may have executed it again
            if status is AttemptStatus.FAILED:
                self._failed.add(notice.task.run_id)
            self.failed = len(self._failed)

    def _take_qualities(self, run_id: str, measures: Mapping[str, PublishedMeasure]) -> None:
        for name in self._columns:
            if name not in measures and name in self._asked_for:
                continue
            quality = measures[name].quality if name in measures else Quality.MISSING
            if quality is not Quality.GOOD:
                self.bad_values.setdefault(name, {}).setdefault(quality.value, []).append(run_id)


def _said(values: object) -> str:
    """Return the phase that a plugin is in, or whatever else it shared last."""
    if not isinstance(values, dict):
        return ""
    if "phase" not in values:
        return ", ".join(f"{name} {value}" for name, value in values.items())
    number, count = values.get("phase_number"), values.get("phase_count")
    place = f" ({number} of {count})" if number is not None and count is not None else ""
    return f"{values['phase']}{place}"
