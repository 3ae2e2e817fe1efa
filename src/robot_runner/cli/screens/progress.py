"""How far an experiment is, gathered from the notices, and its finished runs as rows of a growing table."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from rich.text import Text

from robot_runner.cli.console import Column, aligned, fitting, shortened, width_of
from robot_runner.cli.design_words import heading_of, run_cells, run_columns
from robot_runner.core.config.experiment import Experiment
from robot_runner.core.design.columns import REPETITION, numbered_run_id
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.events.measure import PublishedMeasure, Quality
from robot_runner.core.execution import notices
from robot_runner.core.execution.durations import TimeLeft
from robot_runner.core.execution.task import AttemptStatus, RunOutcome, RunTask
from robot_runner.core.words import enumerated, one_line, shown_duration, shown_treatment, shown_value


@dataclass(slots=True)
class CurrentRun:
    """The run that is being executed.

    Attributes:
        started: when its attempt began, on the screen's clock.
        event: the event that is being handled.
        shared: what plugins reported last about what they do, such as the phase of a mission.
        failure: what went wrong in it, if anything did; then the run is being closed.
    """

    task: RunTask
    started: float
    event: str = ""
    shared: str = ""
    failure: str = ""


class Progress:
    """The progress of an experiment, for a screen, by a monotonic clock in s.

    Attributes:
        run_count: all runs of the table; 0 before the experiment has started.
        done, failed: how many runs are done, earlier sessions included, and how many failed in this one.
        in_flight: the runs that are being executed, by id, in the order in which they began.
        run_ids: the runs that were executed in this session.
        origins: where the values of the run table came from, with the measures of each origin.
        is_waiting: whether the user is asked to go on, or the experiment is paused.
        gates: what is awaited before runs, by run: several places may wait at the same time.
        gate_seconds: how long gates that are over were awaited in this session, s of their clocks.
        has_begun: whether any run was begun in this session.
        finished: how the experiment ended; None before.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._began = clock()
        self._left: TimeLeft | None = None
        self._left_since = self._began
        self._columns: tuple[str, ...] = ()
        self._asked_for: tuple[str, ...] = ()
        self.run_count = 0
        self.done = 0
        self.failed = 0
        self._failed: set[str] = set()
        self.in_flight: dict[str, CurrentRun] = {}
        self.run_ids: dict[str, None] = {}
        self.origins: dict[str, dict[str, None]] = {}
        self._bad: dict[str, dict[str, Quality]] = {}
        self.is_waiting = False
        self.gates: dict[str, notices.GateWaiting] = {}
        self.gate_seconds = 0.0
        self.has_begun = False
        self.finished: notices.ExperimentFinished | None = None

    @property
    def bad_values(self) -> dict[str, dict[str, list[str]]]:
        """The runs of this session whose values are not good, by measure and quality."""
        bad: dict[str, dict[str, list[str]]] = {}
        for run_id, qualities in self._bad.items():
            for name, quality in qualities.items():
                bad.setdefault(name, {}).setdefault(quality.value, []).append(run_id)
        return bad

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
        """How long the rest takes, in words; empty where it is not known."""
        return self._left.in_words(self._clock() - self._left_since) if self._left is not None else ""

    def take(self, notice: notices.Notice) -> None:
        """Take a notice into account."""
        match notice:
            case notices.ExperimentStarted():
                self._began = self._clock()
                self._take_left(notice.left)
                self.run_count, self.done = notice.run_count, notice.done_count
                self._columns, self._asked_for = tuple(notice.columns), tuple(notice.asked_for)
            case notices.AttemptStarted():
                self.is_waiting = False
                self._take_left(notice.left)
                self.has_begun = True
                self.in_flight[notice.task.run_id] = CurrentRun(notice.task, self._clock())
            case notices.RunRecord():
                self._take_record(notice)
            case notices.AttemptFinished():
                self._take_end(notice)
                self._take_left(notice.left)
            case notices.OutcomeAmended():
                self._take_amended(notice.run_id, notice.outcome)
            case notices.NextDecided():
                self.run_count = notice.run_count
            case notices.WaitingForUser() | notices.Paused() | notices.UserHasContinued():
                self.is_waiting = not isinstance(notice, notices.UserHasContinued)
            case notices.GateWaiting() | notices.GatePassed():
                self._take_gate(notice)
            case notices.ExperimentFinished():
                self.done, self.failed = notice.done_count, notice.failed_count
                self.finished = notice

    def _take_gate(self, notice: notices.GateWaiting | notices.GatePassed) -> None:
        if isinstance(notice, notices.GateWaiting):
            self.gates[notice.run_id] = notice
        else:
            self.gates.pop(notice.run_id, None)
            self.gate_seconds += notice.seconds

    def _take_left(self, left: TimeLeft | None) -> None:
        self._left, self._left_since = left, self._clock()

    def _take_record(self, notice: notices.RunRecord) -> None:
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

    def _take_end(self, notice: notices.AttemptFinished) -> None:
        self.in_flight.pop(notice.task.run_id, None)
        status = notice.outcome.status
        if status is AttemptStatus.INTERRUPTED:
            return
        self._take_origins(self._columns, notice.outcome.measures)
        if notice.is_last:
            if status is AttemptStatus.DONE:
                self._take_qualities(notice.task.run_id, notice.outcome.measures)
            self.run_ids[notice.task.run_id] = None
            self.done += status is AttemptStatus.DONE
            self._failed.discard(notice.task.run_id)  # another robot may have executed it again
            if status is AttemptStatus.FAILED:
                self._failed.add(notice.task.run_id)
            self.failed = len(self._failed)

    def _take_amended(self, run_id: str, outcome: RunOutcome) -> None:
        self._take_origins((*self._columns, *self._asked_for), outcome.measures)
        if outcome.status is AttemptStatus.DONE:
            self._take_qualities(run_id, outcome.measures)

    def _take_origins(self, columns: Iterable[str], measures: Mapping[str, PublishedMeasure]) -> None:
        for name in columns:
            measure = measures.get(name)
            if measure is not None and measure.value is not None:
                self.origins.setdefault(measure.origin.value, {})[name] = None

    def _take_qualities(self, run_id: str, measures: Mapping[str, PublishedMeasure]) -> None:
        wanted = [name for name in self._columns if name in measures or name not in self._asked_for]
        found = {name: measures[name].quality if name in measures else Quality.MISSING for name in wanted}
        self._bad[run_id] = {name: quality for name, quality in found.items() if quality is not Quality.GOOD}


def _said(values: object) -> str:
    """Return the phase of a plugin, or the value that it shared last."""
    if not isinstance(values, dict):
        return ""
    if "phase" not in values:
        return ", ".join(f"{name} {value}" for name, value in values.items())
    number, count = values.get("phase_number"), values.get("phase_count")
    place = f" ({number} of {count})" if number is not None and count is not None else ""
    return f"{values['phase']}{place}"


#: A measure in four significant digits needs as much, with exponent and question mark.
_MEASURE = 10
_TOOK = 11
_INDENT = "  "


def shown_measure(published: PublishedMeasure | None) -> str:
    """Return a value in four significant digits, with a question mark where it is doubtful; a missing one as a dash."""
    if published is None:
        return shown_value(None)
    return shortened(shown_value(published.value)) + ("?" if published.quality is Quality.DOUBTFUL else "")


def treatments_in_words(task: RunTask | notices.WaitingForUser, model: RunTableModel) -> str:
    """Return the treatments of a run, as `Task=Video, Repetition=3`."""
    parts = [f"{name}={shortened(shown_treatment(treatment))}" for name, treatment in task.combination.items()]
    if task.repetition == 0:
        parts.append("warm-up")
    elif model.repetitions > 1:
        parts.append(f"{REPETITION}={task.repetition}")
    return ", ".join(parts)


class RunRows:
    """Makes the rows for the runs of one experiment.

    `measures` are the units of the measure columns, by name; `run_count` is for the width of the runs' ids.
    """

    def __init__(self, experiment: Experiment, measures: Mapping[str, str], run_count: int) -> None:
        self._model = experiment.model
        self._measures = tuple(measures)
        self._what = run_columns(experiment.model, numbered_run_id(run_count))
        headings = [heading_of(name, unit) for name, unit in measures.items()]
        self._yields = [Column(heading, max(_MEASURE, width_of([heading])), is_number=True) for heading in headings]
        self._yields.append(Column("took", _TOOK, is_number=True))

    def header(self, width: int) -> Text:
        """Return the headings."""
        columns = self._fitting(width)
        return Text(_INDENT + aligned(columns, [column.heading for column in columns]), style="bold")

    def left_out(self, width: int) -> str:
        """Return which columns do not fit, in words; empty where all do."""
        hidden = [column.heading for column in [*self._what, *self._yields][len(self._fitting(width)) :]]
        return f"too narrow for {enumerated(hidden)}; run_table.csv has all measures" if hidden else ""

    def row(self, finished: notices.AttemptFinished, width: int) -> Text:
        """Return the row of an attempt that has ended."""
        columns = self._fitting(width)
        task, outcome = finished.task, finished.outcome
        what = run_cells(self._model, task.run_id, task.combination, task.repetition)
        if outcome.status is AttemptStatus.DONE:
            values = [shown_measure(outcome.measures.get(name)) for name in self._measures]
            return Text(_INDENT + aligned(columns, [*what, *values, shown_duration(outcome.seconds)]))
        reason = one_line(str(outcome.failure)) if outcome.status is AttemptStatus.FAILED else "interrupted"
        again = "" if finished.is_last else f"attempt {task.attempt}, tried again: "
        head = aligned(columns[: len(what)], what)
        style = "red" if finished.is_last else "yellow"
        return Text(f"{_INDENT}{head}  ✗ {again}{reason}", style=style)

    def _fitting(self, width: int) -> list[Column]:
        columns = [*self._what, *self._yields]
        return columns[: fitting(columns, width - len(_INDENT))]
