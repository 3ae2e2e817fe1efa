"""The notices that the orchestrator gives to its observer: the terminal, a test, a page."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from robot_runner.core.config.operator_steps import Question
from robot_runner.core.errors import Finding
from robot_runner.core.execution.durations import TimeLeft
from robot_runner.core.execution.task import RunOutcome, RunTask


@dataclass(frozen=True, slots=True)
class PreparationStarted:
    """Something that the runs need is being made, before anything else happens; it may take long."""

    what: str


@dataclass(frozen=True, slots=True)
class ProbeStarted:
    """Profilers are tried for a moment, before anything else happens."""

    plugins: Sequence[str]


@dataclass(frozen=True, slots=True)
class ExperimentStarted:
    """The first run is about to be executed.

    Attributes:
        run_count: all runs of the table; `done_count` of them were done before.
        columns: the measure columns with their units, without those of the quality of others.
        asked_for: those of them that a person is asked for, which have values in some runs only.
        left: how long it takes from here; None where that is not known.
    """

    experiment_name: str
    folder: Path
    run_count: int
    done_count: int
    seed: int
    columns: Mapping[str, str]
    overrides: Mapping[str, str]
    findings: Sequence[Finding] = ()
    asked_for: Collection[str] = ()
    left: TimeLeft | None = None


@dataclass(frozen=True, slots=True)
class AttemptStarted:
    """An attempt at a run begins; `left` says how long it and the others take, where that is known."""

    task: RunTask
    left: TimeLeft | None = None


@dataclass(frozen=True, slots=True)
class RunRecord:
    """Something happened in the run: an event, a measure, key-value pairs, a finding, a failure."""

    run_id: str
    kind: str
    fields: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class AttemptFinished:
    """An attempt at a run has ended; `is_last` unless the run is tried again, and `left` as in `AttemptStarted`."""

    task: RunTask
    outcome: RunOutcome
    is_last: bool
    left: TimeLeft | None = None


@dataclass(frozen=True, slots=True)
class OutcomeAmended:
    """A run that has ended got more measures: by answers of the operator, or published during `continue`.

    Attributes:
        outcome: the whole of its last attempt, with them.
    """

    run_id: str
    outcome: RunOutcome


@dataclass(frozen=True, slots=True)
class FindingsNoticed:
    """A run that was just recorded has findings about all that follow; they are repeated at the end."""

    findings: Sequence[Finding]


@dataclass(frozen=True, slots=True)
class NextDecided:
    """All planned runs are done, and the next ones were decided from their results.

    Attributes:
        told: what was decided and why, for people.
        run_count: all runs of the table, with those that were added.
        added: how many runs were added; 0 where it ends.
    """

    told: str
    run_count: int
    added: int = 0


@dataclass(frozen=True, slots=True)
class WaitingForUser:
    """The next run starts once the user continues (SEMI), or confirms a step.

    Attributes:
        run_id, combination, repetition: of the next run, or of the one that is over where `is_after`.
        place: the robot or worker that executes it; empty where there is no other.
        step: what the user is to do; empty where they are only asked whether the run may start.
        questions: what they are asked then.
        is_after: whether the step comes after the run.
        runs_left: how many runs are to come in this session, the next one included; None where that is not known.
        left: how long these will take; None where that is not known.
    """

    folder: Path
    next_run_number: int
    run_count: int
    run_id: str = ""
    combination: Mapping[str, Any] = field(default_factory=dict)
    repetition: int = 1
    place: str = ""
    step: str = ""
    questions: Sequence[Question] = ()
    is_after: bool = False
    runs_left: int | None = None
    left: TimeLeft | None = None


@dataclass(frozen=True, slots=True)
class QuestionAsked:
    """The next question to the person at the keyboard."""

    question: Question


@dataclass(frozen=True, slots=True)
class AnswersRefused:
    """An answer was refused; the question is asked again."""

    findings: Sequence[Finding]


@dataclass(frozen=True, slots=True)
class UserHasContinued:
    """The user has continued, or has interrupted."""


@dataclass(frozen=True, slots=True)
class HostRestarts:
    """A host is rebooted before the next run, and awaited."""

    host: str
    next_run: str


@dataclass(frozen=True, slots=True)
class Paused:
    """A pause was requested: the next run starts once it is ended."""

    folder: Path
    next_run_number: int
    run_count: int


@dataclass(frozen=True, slots=True)
class GateWaiting:
    """The condition of a gate does not hold yet; sent about twice a second.

    Attributes:
        run_id, run_number: the run that waits.
        condition: what is awaited, so that it completes the sentence "waiting until ...".
        seen: what was seen last, in words.
        seconds: how long it has been awaited, s.
        timeout_s: how long it is to be awaited, s; None for as long as it takes.
    """

    run_id: str
    run_number: int
    run_count: int
    condition: str
    seen: str
    seconds: float
    timeout_s: float | None


@dataclass(frozen=True, slots=True)
class GatePassed:
    """The wait for a gate is over.

    Attributes:
        state: `open` where its condition holds, else `timed out`, `failed` or `interrupted`.
        problem: why it was not passed; empty where it was.
    """

    run_id: str
    condition: str
    seen: str
    seconds: float
    state: str
    problem: str = ""


@dataclass(frozen=True, slots=True)
class InterruptionNoticed:
    """The user has interrupted: the run is being closed; after a second interruption it is killed."""

    run_id: str


@dataclass(frozen=True, slots=True)
class ExperimentFinished:
    """The experiment has ended.

    Attributes:
        done_count, failed_count, todo_count: the state of the run table; runs that are excluded are neither failed nor
            to do.
        failed: the ids of the runs that failed.
        interrupted: whether the user asked for the end.
        stopped_by: by what it was ended before its last run: `on_failure`, `a gate`, `a guard`, or `a robot that may be
            moving`; empty where it was not.
        findings: what looked odd.
        seconds: real time.
        excluded: the ids of the runs that are left out.
    """

    folder: Path
    run_table: Path
    done_count: int
    failed_count: int
    todo_count: int
    failed: Sequence[str]
    interrupted: bool
    failures: Sequence[str] = ()
    findings: Sequence[Finding] = field(default_factory=tuple)
    seconds: float = 0.0
    excluded: Sequence[str] = ()
    stopped_by: str = ""


Notice = (
    PreparationStarted
    | ProbeStarted
    | ExperimentStarted
    | AttemptStarted
    | RunRecord
    | AttemptFinished
    | OutcomeAmended
    | FindingsNoticed
    | NextDecided
    | WaitingForUser
    | HostRestarts
    | Paused
    | QuestionAsked
    | AnswersRefused
    | UserHasContinued
    | GateWaiting
    | GatePassed
    | InterruptionNoticed
    | ExperimentFinished
)


class Observer(Protocol):
    """Watches an experiment. What it raises ends nothing: a screen may fail, the experiment goes on."""

    @property
    def refresh_interval(self) -> float | None:
        """How often `refresh` wants to be called, in seconds; None for never."""

    @property
    def user_input(self) -> int | None:
        """The descriptor from which lines of the user are read: answers, or ENTER; None where there is no terminal."""

    def notice(self, notice: Notice) -> None:
        """Take a notice."""

    def refresh(self) -> None:
        """Bring a live screen up to date."""


class SilentObserver:
    """Shows nothing."""

    refresh_interval: float | None = None
    user_input: int | None = None

    def notice(self, notice: Notice) -> None:
        """Ignore a notice."""

    def refresh(self) -> None:
        """Do nothing: there is no screen."""
