"""Plain lines: for a log, a pipe, and whoever prefers them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.cli.findings import print_findings
from robot_runner.cli.screens.progress import Progress
from robot_runner.cli.screens.prompts import closing, forget_typed, opening, request, terminal_input
from robot_runner.cli.screens.rows import treatments_in_words
from robot_runner.cli.wording import one_line, shown_duration, shown_value
from robot_runner.execution.notices import (
    AttemptFinished,
    AttemptStarted,
    ExperimentStarted,
    InterruptionNoticed,
    Notice,
    WaitingForUser,
)
from robot_runner.execution.task import AttemptStatus

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from typing import Self

    from robot_runner.cli.console import UserConsole
    from robot_runner.config.experiment import Experiment
    from robot_runner.execution.task import RunOutcome, RunTask

__all__ = ["PlainScreen"]


class PlainScreen:
    """An observer that prints a line when a run starts and when it ends.

    Args:
        console: where to.
        experiment: what is executed.
        clock: monotonic, in seconds.

    Attributes:
        progress: what it knows.
    """

    refresh_interval: float | None = None

    def __init__(self, console: UserConsole, experiment: Experiment, clock: Callable[[], float]) -> None:
        self.progress = Progress(clock)
        self.user_input = terminal_input()
        self._console = console
        self._model = experiment.model
        self._units: Mapping[str, str] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        """Leave what was printed."""

    def notice(self, notice: Notice) -> None:
        """Print what is worth a line."""
        self.progress.take(notice)
        match notice:
            case ExperimentStarted():
                self._units = notice.columns
                self._print(*opening(notice))
                print_findings(self._console, notice.findings)
            case AttemptStarted(task):
                treatments = treatments_in_words(task, self._model)
                self._print(f"{_named(task)} starts{f': {treatments}' if treatments else ''}")
            case AttemptFinished(task, outcome, is_last):
                self._print(f"{_named(task)} {self._ended(outcome, is_last=is_last)}")
            case InterruptionNoticed(run_id):
                self._print(closing(run_id))
            case WaitingForUser():
                forget_typed(self.user_input)
                self._print(request(notice, by_key=self.user_input is not None))

    def refresh(self) -> None:
        """Do nothing: a line that was printed stays as it is."""

    def _print(self, *lines: str) -> None:
        self._console.file.write("".join(f"{line}\n" for line in lines))
        self._console.file.flush()

    def _ended(self, outcome: RunOutcome, *, is_last: bool) -> str:
        after = f"after {shown_duration(outcome.seconds)}"
        if outcome.status is AttemptStatus.DONE:
            measures = ", ".join(self._measures(outcome))
            return f"is done {after}: {measures}" if measures else f"is done {after}"
        if outcome.status is AttemptStatus.INTERRUPTED:
            return f"was interrupted {after}; it is still to do"
        again = "" if is_last else "; it is tried again"
        return f"failed {after}: {one_line(str(outcome.failure))}{again}"

    def _measures(self, outcome: RunOutcome) -> list[str]:
        shown = []
        for name, unit in self._units.items():
            published = outcome.measures.get(name)
            value = shown_value(published.value if published else None)
            shown.append(f"{name} {value} {unit}" if unit not in {"", "1"} else f"{name} {value}")
        return shown


def _named(task: RunTask) -> str:
    attempt = f", attempt {task.attempt}" if task.attempt > 1 else ""
    return f"run {task.run_number} of {task.run_count} ({task.run_id}{attempt})"
