"""The texts of both screens, and the screen of plain lines: for logs, pipes and users who prefer it."""

from __future__ import annotations

import shlex
import sys
import termios
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Self

from robot_runner.cli.console import UserConsole, command_line, folded, shown_path
from robot_runner.cli.findings import print_findings
from robot_runner.cli.harmless_stream import let_go_of
from robot_runner.cli.screens.progress import Progress, shown_measure, treatments_in_words
from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.operator_steps import Question
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.execution import notices
from robot_runner.core.execution.task import AttemptStatus, RunOutcome, RunTask
from robot_runner.core.secret_names import shown_settings
from robot_runner.core.words import counted, enumerated, one_line, shown_duration

#: A shorter expected duration is not printed, s.
_WORTH_TELLING = 60.0
#: How often a line is printed while a gate is awaited, s.
_GATE_EVERY = 60.0
#: For a gate that opens sooner no line is printed, s: most hold at the second look.
_GATE_AFTER = 1.0


def terminal_input() -> int | None:
    """Return the descriptor on which a user can press ENTER, or None where there is no terminal."""
    with suppress(AttributeError, OSError, ValueError):
        if sys.stdin.isatty():
            return sys.stdin.fileno()
    return None


def forget_typed(descriptor: int | None) -> None:
    """Discard input typed before the question: an ENTER during a run must not start the next one."""
    if descriptor is not None:
        with suppress(termios.error):
            termios.tcflush(descriptor, termios.TCIFLUSH)


def opening(started: notices.ExperimentStarted) -> list[str]:
    """Return the lines that are printed when an experiment starts."""
    before = f", {started.done_count:,} of them done before" if started.done_count else ""
    runs = f"{counted(started.run_count, 'run')}{before}, seed {started.seed}"
    lines = [f"{started.experiment_name}: {runs}, results in {shown_path(started.folder)}"]
    if started.left is not None and started.left.others >= _WORTH_TELLING:
        lines.append(started.left.in_words())
    if started.overrides:
        parts = ", ".join(f"{name}={value}" for name, value in shown_settings(started.overrides).items())
        lines.append(f"set by hand, and recorded as a deviation from the config: {parts}")
    return lines


def announced(notice: notices.PreparationStarted | notices.ProbeStarted | notices.HostRestarts) -> str:
    """Return the line for something that takes a while and prints nothing meanwhile."""
    if isinstance(notice, notices.PreparationStarted):
        return f"{notice.what} ..."
    if isinstance(notice, notices.ProbeStarted):
        return f"Trying {enumerated(notice.plugins)} for a moment, before anything moves ..."
    return f"Restarting {notice.host} before {notice.next_run}, and waiting until it is ready ..."


def closing(run_id: str) -> str:
    """Return the line that is printed once the user has interrupted."""
    return f"Interrupted: closing {run_id} (its robot is stopped, its profilers too). Ctrl-C again kills it at once."


def request(waiting: notices.WaitingForUser, *, by_key: bool) -> str:
    """Return the request to the user before a run, or after it, in words."""
    command = continue_command(waiting.folder, waiting.questions)
    run = f"run {waiting.next_run_number} of {waiting.run_count}"
    if not by_key:
        return f"Waiting {'after' if waiting.is_after else 'before'} {run}. To go on: {command}"
    if waiting.questions:
        return f"Answer when it is done, or in another terminal: {command}"
    wanted = "when it is done" if waiting.step else f"to start {run}"
    return f"Press ENTER {wanted}, or in another terminal: {command}"


def continue_command(folder: Path, questions: Sequence[Question] = ()) -> str:
    """Return the command that lets an experiment go on, with a place for each answer that it needs."""
    answers = [f"--answer {shlex.quote(question.name)}=..." for question in questions if not question.optional]
    return " ".join([command_line("continue", shown_path(folder)), *answers])


def run_to_come(waiting: notices.WaitingForUser, model: RunTableModel) -> list[str]:
    """Return the lines about the next run, before the user continues: its treatments, the time left, the steps."""
    if not waiting.run_id:
        return []
    treatments = treatments_in_words(waiting, model)
    place = f", {waiting.place}" if waiting.place else ""
    run = f"{waiting.run_id}, run {waiting.next_run_number} of {waiting.run_count}{place}"
    which = "This is about" if waiting.is_after else "Next is"
    lines = [f"{which} {run}{f': {treatments}' if treatments else ''}"]
    if waiting.runs_left is not None:
        about = f", {waiting.left.in_words()}" if waiting.left is not None else " left"
        lines.append(f"{counted(waiting.runs_left, 'run')}{about}")
    if waiting.step:
        lines.append(f"To do: {waiting.step}")
    return lines


def question_asked(question: Question) -> str:
    """Return the prompt of a question."""
    return f"  {question.asked}: "


def refusals(refused: notices.AnswersRefused) -> list[str]:
    """Return why answers were refused, a line each."""
    return [one_line(f"  {found.where}: {found.problem}. {found.fix}".rstrip()) for found in refused.findings]


def pausing(paused: notices.Paused, *, by_key: bool) -> str:
    """Return the line that is printed while the experiment is paused."""
    key = "press ENTER, or in another terminal: " if by_key else ""
    run = f"run {paused.next_run_number} of {paused.run_count}"
    return f"Paused before {run}. To go on: {key}{continue_command(paused.folder)}"


def waiting_at_gate(waiting: notices.GateWaiting) -> str:
    """Return the text once a run has to wait for a gate."""
    return (
        f"run {waiting.run_number} of {waiting.run_count} ({waiting.run_id}) waits until {one_line(waiting.condition)}"
    )


def waited_so_far(waiting: notices.GateWaiting) -> str:
    """Return the last look at a gate that is awaited, and for how long it has been."""
    most = f" of {shown_duration(waiting.timeout_s)}" if waiting.timeout_s is not None else ""
    seen = f"{one_line(waiting.seen)}   " if waiting.seen else ""
    return f"{seen}{shown_duration(waiting.seconds)}{most}"


def gate_passed(passed: notices.GatePassed) -> str:
    """Return the text once the wait for a gate is over."""
    waited = f"{passed.run_id} waited {shown_duration(passed.seconds)} until {one_line(passed.condition)}"
    if passed.state == "open":
        return f"{waited}: {one_line(passed.seen)}" if passed.seen else waited
    return f"{waited}, in vain: {one_line(passed.problem)}"


class PlainScreen:
    """An observer that prints a line when a run starts and when it ends.

    `progress` is what it knows, by a monotonic clock in s.
    """

    refresh_interval: float | None = None

    def __init__(self, console: UserConsole, experiment: Experiment, clock: Callable[[], float]) -> None:
        self.progress = Progress(clock)
        self.user_input = terminal_input()
        self._console = console
        self._model = experiment.model
        self._units: Mapping[str, str] = {}
        self._gates_told: dict[str, float] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        """Leave the printed lines."""

    def notice(self, notice: notices.Notice) -> None:
        """Print a line for each notice worth one; after a broken pipe (`| head`) the experiment goes on unseen."""
        self.progress.take(notice)
        try:
            self._show(notice)
        except BrokenPipeError:
            let_go_of(sys.stdout)

    def _show(self, notice: notices.Notice) -> None:
        match notice:
            case notices.PreparationStarted() | notices.ProbeStarted() | notices.HostRestarts():
                self._print(announced(notice))
            case notices.ExperimentStarted():
                self._units = notice.columns
                self._print(*opening(notice))
                print_findings(self._console, notice.findings)
            case notices.AttemptStarted(task):
                treatments = treatments_in_words(task, self._model)
                self._print(f"{_named(task)} starts{f': {treatments}' if treatments else ''}")
            case notices.AttemptFinished(task, outcome, is_last):
                self._print(f"{_named(task)} {self._ended(outcome, is_last=is_last)}")
            case notices.NextDecided():
                self._print(notice.told)
            case notices.FindingsNoticed(findings):
                print_findings(self._console, findings)
            case notices.InterruptionNoticed(run_id):
                self._print(closing(run_id))
            case _:
                self._take_part(notice)

    def _take_part(self, notice: notices.Notice) -> None:
        match notice:
            case notices.WaitingForUser():
                forget_typed(self.user_input)
                self._print(*run_to_come(notice, self._model), request(notice, by_key=self.user_input is not None))
            case notices.Paused():
                forget_typed(self.user_input)
                self._print(pausing(notice, by_key=self.user_input is not None))
            case notices.QuestionAsked(question):
                self._console.lines.write(question_asked(question))
                self._console.lines.flush()
            case notices.AnswersRefused():
                self._print(*refusals(notice))
            case notices.RunRecord(run_id, "asked", fields):
                self._print(f"{run_id} waits until a person says that {fields['step']}: {fields['command']}")
            case notices.GateWaiting() | notices.GatePassed():
                self._tell_of_gate(notice)

    def _tell_of_gate(self, notice: notices.GateWaiting | notices.GatePassed) -> None:
        if isinstance(notice, notices.GatePassed):
            if self._gates_told.pop(notice.run_id, None) is not None or notice.problem:
                self._print(gate_passed(notice))
            return
        told = self._gates_told.get(notice.run_id)
        if told is None and notice.seconds < _GATE_AFTER:
            return
        if told is None or notice.seconds - told >= _GATE_EVERY:
            self._gates_told[notice.run_id] = notice.seconds
            if told is None or len(self._gates_told) > 1:  # of several it has to be said which one is meant
                self._print(waiting_at_gate(notice))
            self._print(f"  {waited_so_far(notice)}")

    def refresh(self) -> None:
        """Do nothing: a line that was printed stays as it is."""

    def _print(self, *lines: str) -> None:
        if self._console.is_terminal:
            lines = tuple(part for line in lines for part in folded(line, self._console.width))
        self._console.lines.write("".join(f"{line}\n" for line in lines))
        self._console.lines.flush()

    def _ended(self, outcome: RunOutcome, *, is_last: bool) -> str:
        after = f"after {shown_duration(outcome.seconds)}"
        if outcome.status is AttemptStatus.DONE:
            measures = ", ".join(self._measures(outcome))
            return f"is done {after}: {measures}" if measures else f"is done {after}"
        if outcome.status is AttemptStatus.INTERRUPTED:
            return f"was interrupted {after}; it is still to do"
        reason = one_line(str(outcome.failure))
        return f"failed {after}: {reason}" if is_last else f"failed {after}: {reason.rstrip('.')}; it is tried again"

    def _measures(self, outcome: RunOutcome) -> list[str]:
        told = ((f"{name} {shown_measure(outcome.measures.get(name))}", unit) for name, unit in self._units.items())
        return [text if unit in {"", "1"} else f"{text} {unit}" for text, unit in told]


def _named(task: RunTask) -> str:
    attempt = f", attempt {task.attempt}" if task.attempt > 1 else ""
    place = f", {task.place}" if task.place else ""
    return f"run {task.run_number} of {task.run_count} ({task.run_id}{attempt}{place})"
