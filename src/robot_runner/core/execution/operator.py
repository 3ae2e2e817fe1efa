"""The operator's steps and questions before and after runs, answered at this terminal or from another one.

What the operator did and answered is recorded in the journal, so that a later session knows which steps are due
(`StepHistory`). Which steps come after a run is in the record of its end, so that the next session asks for those that
were not done.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from robot_runner.core.config.operator_steps import OperatorStep, Question, read_answers
from robot_runner.core.design.watched_combination import WatchedCombination
from robot_runner.core.errors import ExecutionError, MeasureError
from robot_runner.core.events.measure import OPERATOR_OWNER, MeasureValue, Origin
from robot_runner.core.execution.notices import (
    AnswersRefused,
    OutcomeAmended,
    QuestionAsked,
    UserHasContinued,
    WaitingForUser,
)
from robot_runner.core.execution.orchestrator_events import OngoingExperiment
from robot_runner.core.execution.poll_loop import Pause, Steps
from robot_runner.core.execution.step_history import StepHistory, still_to_do
from robot_runner.core.execution.task import OutcomeBuilder, PendingRun, Report, RunOutcome, RunTask
from robot_runner.core.storage.lock import Asked, take_request

#: How often it is checked whether a second terminal has answered, s.
_LISTEN = 0.2
#: How much of the input is kept that has no line end yet.
_MOST_BYTES = 64 * 1024


class Operator:
    """Asks the operator for steps and answers, and records both.

    Attributes:
        is_asking: whether a question is open at this moment, also whether a pause is over.
    """

    def __init__(self, ongoing: OngoingExperiment) -> None:
        self._ongoing = ongoing
        self._experiment = ongoing.experiment
        steps = ongoing.experiment.parameters.operator_steps
        self._steps = [step for step in steps if not step.is_after]
        self._steps_after = [step for step in steps if step.is_after]
        self._progress = ongoing.progress
        self._keyboard = _Keyboard(ongoing.observer.user_input)
        self.is_asking = False
        self._in_line: set[int] = set()
        self._being_done: dict[tuple[str, str], None] = {}
        self._has_begun: dict[str, bool] = {}
        self._notify = ongoing.notify
        self._history: StepHistory | None = None
        self._reads: dict[str, dict[tuple[str, str], None]] = {}

    def prepare(self, run: PendingRun, place: str, *, is_retry: bool = False) -> Steps[bool]:
        """Ask for the steps that are due before a run, or before another attempt; return whether any was.

        Which ones are due is decided before anything is awaited: so several places have the steps that one place would
        have, by the order of runs. `place` is empty where there is no other; with `is_retry` the run has been tried
        already.

        Raises:
            ExecutionError: a function of the config that says when a step is due raised.
        """
        if not self._steps or self._ongoing.is_ending:
            return False
        steps = [step for step in self._steps if step.is_for_each_attempt or not is_retry]
        due = [step for step in steps if self._is_due(step, run)]
        before, ahead = list(self._being_done), self._yet_to_begin()
        for step in due:
            self._known().expect(step.name, _treatments(step, self._progress.task_of(run).combination), ahead)
            self._being_done[step.name, run.run_id] = None
        if run.run_id not in self._has_begun:  # else it is another attempt at it
            self._known().begin(run.run_id)
            self._has_begun[run.run_id] = False
        has_asked = False
        for step in steps:
            if step in due and not self._ongoing.is_ending:
                yield from self._have_done(step, run, place)
                has_asked = True
            elif not step.is_for_each_attempt:
                yield from self._await_done([each for each in before if each[0] == step.name])
        return has_asked

    def due_after(self, run: PendingRun) -> list[str]:
        """Return the steps that are due once a run is done; call it before the run, as a function may raise.

        Raises:
            ExecutionError: a function of the config that says so raised.
        """
        return [step.name for step in self._steps_after if self._suits(step, run)[1]]

    def ask_after(self, run: PendingRun, place: str, outcome: RunOutcome, names: Collection[str]) -> Steps[None]:
        """Ask for these steps after a run that is done; the answers become measures of it."""
        for step in self._steps_after:
            if step.name not in names:
                continue
            answers = yield from self._ask(run, place, step)
            if answers is None:
                left = [each.name for each in self._steps_after if each.name in names]
                self._progress.find(still_to_do(run.run_id, left[left.index(step.name) :]))
                return
            measures, notes = self._sorted(step, answers)
            builder = OutcomeBuilder(run.run_id, self._experiment.columns)
            builder.go_on_from(outcome)
            for name, value in measures.items():
                builder.take("measure", _as_measure(name, value))
            # The answers are recorded before the step: one that is recorded as done is not asked for again.
            outcome = self._progress.amend_outcome(self._progress.task_of(run, place), outcome, builder.outcome())
            self._notify(OutcomeAmended(run.run_id, outcome))
            facts = {"run": run.run_id, "step": step.name, "treatments": {}, "answers": measures, "notes": notes}
            self._progress.note("operator_step", flush=True, **facts, is_after=True)
            self._known().end_step(run.run_id, step.name)

    def ask_about_earlier(self) -> Steps[None]:
        """Ask for the steps that are due after runs of earlier sessions, unless these are executed again."""
        if not self._steps_after:
            return
        rows, again = self._progress.rows, {run.run_id for run in self._progress.pending()}
        for run_id, end in [*self._known().ends.items()]:
            place = rows.place_of(run_id)
            if place is not None and run_id not in again and rows.excluded(place) is None:
                yield from self.ask_after(PendingRun(run_id, place), "", RunOutcome.of_fields(end), end["to_ask"])

    def _await_done(self, awaited: Sequence[tuple[str, str]]) -> Steps[None]:
        """Wait until steps are done that are being done before earlier runs."""
        while not self._ongoing.is_ending and any(each in self._being_done for each in awaited):
            yield Pause(_LISTEN)

    def ask_to_start(self, run: PendingRun, place: str) -> Steps[None]:
        """Wait until the operator lets a run start (SEMI), or until an interruption."""
        yield from self._ask(run, place)

    def note_read(self, run_id: str, factor: str, owner: str) -> None:
        """Remember that `owner` read the treatment of a factor before the run began."""
        self._reads.setdefault(run_id, {})[factor, owner] = None

    def hand_over(self, task: RunTask, report: Report) -> None:
        """Report to an attempt the answers as its measures, and the earlier readers of its treatments."""
        for factor, owner in self._reads.get(task.run_id, ()):
            report("read", {"factor": factor, "owner": owner})
        if not self._steps:
            return
        self._has_begun[task.run_id] = True
        for name, value in self._known().answers.get(task.run_id, {}).items():
            task.measures[name] = _as_measure(name, value)
            report("measure", task.measures[name])

    def _yet_to_begin(self) -> list[str]:
        """Return the runs that were prepared, and have not begun."""
        return [run_id for run_id, has_begun in self._has_begun.items() if not has_begun]

    def _known(self) -> StepHistory:
        if self._history is None:
            self._history = StepHistory.of(self._experiment.folder.journal)
        return self._history

    def _is_due(self, step: OperatorStep, run: PendingRun) -> bool:
        combination, suits = self._suits(step, run)
        return self._known().is_due(step, _treatments(step, combination)) and suits

    def _suits(self, step: OperatorStep, run: PendingRun) -> tuple[WatchedCombination, bool]:
        """Return the treatments of a run, and whether the config wants the step for these."""
        combination = WatchedCombination(
            self._progress.task_of(run).combination, lambda factor: self.note_read(run.run_id, factor, OPERATOR_OWNER)
        )
        try:
            return combination, step.suits(combination)
        except Exception as error:
            problem = f"{'after' if step.is_after else 'before'} raised {type(error).__name__}: {error}"
            fix = "Correct the function, and start the experiment again: it resumes."
            raise ExecutionError(problem, where=f"operator step {step.name!r}, {run.run_id}", fix=fix) from error

    def _have_done(self, step: OperatorStep, run: PendingRun, place: str) -> Steps[None]:
        answers = yield from self._ask(run, place, step)
        if answers is None:
            return
        measures, notes = self._sorted(step, answers)
        treatments = _treatments(step, self._progress.task_of(run).combination)
        self._known().take(run.run_id, measures)
        facts = {"run": run.run_id, "step": step.name, "treatments": treatments, "answers": measures, "notes": notes}
        if ahead := self._known().ahead_of(step.name, self._yet_to_begin()):
            facts["ahead"] = ahead
        self._progress.note("operator_step", flush=True, **facts)
        self._being_done.pop((step.name, run.run_id), None)

    def _sorted(
        self, step: OperatorStep, answers: Mapping[str, MeasureValue]
    ) -> tuple[dict[str, MeasureValue], dict[str, MeasureValue]]:
        """Return the answers that are measures and the scores that they make, by column, and the notes."""
        columns = self._experiment.columns
        notes = {question.name: answers[question.name] for question in step.questions if question.note}
        measures = {name: value for name, value in answers.items() if name not in notes}
        measures |= {scale.name: scale.score(answers) for scale in step.scales}
        return {columns.column_for(OPERATOR_OWNER, name).name: value for name, value in measures.items()}, notes

    def _ask(
        self, run: PendingRun, place: str, step: OperatorStep | None = None
    ) -> Steps[dict[str, MeasureValue] | None]:
        """Wait until the operator confirms a step, or lets a run start; None where the wait ends before.

        The operator is asked about one run at a time, in the order of the runs.
        """
        self._in_line.add(run.number)
        try:
            while self.is_asking or run.number > min(self._in_line):
                yield Pause(_LISTEN)
        finally:
            self._in_line.discard(run.number)
        self.is_asking = True
        try:
            return (yield from self._asked(run, place, step))
        finally:
            self.is_asking = False

    def _asked(self, run: PendingRun, place: str, step: OperatorStep | None) -> Steps[dict[str, MeasureValue] | None]:
        if self._has_ended(step):
            return None
        name, questions = (step.name, step.questions) if step else ("", ())
        asked = [question.as_mapping() for question in questions]
        facts: dict[str, Any] = {"next_run": run.run_id, "step": name, "questions": asked}
        if place:
            facts["place"] = place
        if step is not None and step.is_after:
            facts["is_after"] = True
        take_request(self._experiment.folder.control, (run.run_id, name))  # one that was left before this question
        self._progress.note("waiting", **facts)
        self._notify(self._waiting(run, place, step))
        answers = yield from self._answered((run.run_id, name), questions, lambda: self._has_ended(step))
        self._progress.note("continued")
        self._notify(UserHasContinued())
        return answers

    def _waiting(self, run: PendingRun, place: str, step: OperatorStep | None) -> WaitingForUser:
        task, is_after = self._progress.task_of(run), step is not None and step.is_after
        return WaitingForUser(
            folder=self._experiment.folder.root,
            next_run_number=run.number,
            run_count=self._progress.run_count,
            run_id=run.run_id,
            combination=task.combination,
            repetition=task.repetition,
            place=place,
            step=step.name if step else "",
            questions=step.questions if step else (),
            is_after=is_after,
            runs_left=None if is_after else self._progress.runs_left(run),
            left=self._progress.time_left,
        )

    def _has_ended(self, step: OperatorStep | None) -> bool:
        """Return whether a step is not asked for any more; steps after runs are, also where no more runs begin."""
        is_after = step is not None and step.is_after
        return self._ongoing.is_interrupted if is_after else self._ongoing.is_ending

    def _answered(
        self, asked: Asked, questions: Sequence[Question], has_ended: Callable[[], bool]
    ) -> Steps[dict[str, MeasureValue] | None]:
        control = self._experiment.folder.control
        given: dict[str, MeasureValue] = {}
        left = deque(questions)
        self._put_question(left)
        while not has_ended():
            line = yield from self._keyboard.line()
            if line is not None:
                if left:
                    self._take_line(line, left, given)
                if not left:
                    return given
            self._progress.look_after_lock()  # who has taken the folder over meanwhile may be meant by the request
            request = take_request(control, asked)
            if request is not None:
                answers, findings = read_answers(questions, request.answers, given)
                if not findings:
                    return answers
                self._notify(AnswersRefused(findings))
                self._put_question(left)
        return None

    def _take_line(self, line: str, left: deque[Question], given: dict[str, MeasureValue]) -> None:
        try:
            given[left[0].name] = left[0].read(line)
            left.popleft()
        except MeasureError as error:
            self._notify(AnswersRefused((error.as_finding(),)))
        self._put_question(left)

    def _put_question(self, left: deque[Question]) -> None:
        if left and self._keyboard.is_there:
            self._notify(QuestionAsked(left[0]))


def _as_measure(column: str, value: MeasureValue) -> dict[str, Any]:
    """Return an answer as a run would report it."""
    return {"name": column, "value": value, "owner": OPERATOR_OWNER, "origin": Origin.ENTERED.value}


def _treatments(step: OperatorStep, combination: Mapping[str, Any]) -> dict[str, str]:
    return {factor: str(combination[factor]) for factor in step.factors}


class _Keyboard:
    def __init__(self, descriptor: int | None) -> None:
        self._descriptor = descriptor
        self._pending = b""

    @property
    def is_there(self) -> bool:
        """Whether somebody may type."""
        return self._descriptor is not None

    def line(self) -> Steps[str | None]:
        """Return the next line; None where none was completed within `_LISTEN`."""
        if b"\n" not in self._pending:
            pause = Pause(_LISTEN, self._descriptor)
            yield pause
            if pause.typed == b"":  # the end of the input
                self._descriptor = None
            self._pending = (self._pending + (pause.typed or b""))[-_MOST_BYTES:]
        if b"\n" not in self._pending:
            return None
        line, _, self._pending = self._pending.partition(b"\n")
        return line.decode("utf-8", "replace")
