"""An experiment and the notices of its execution, without executing anything."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.cli.console import UserConsole
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.events.measure import Origin, PublishedMeasure
from robot_runner.core.execution.notices import AttemptFinished, AttemptStarted, ExperimentFinished, ExperimentStarted
from robot_runner.core.execution.task import AttemptStatus, RunFailure, RunOutcome, RunTask

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.execution.durations import TimeLeft


@pytest.fixture
def experiment(write_config: Callable[..., Path]) -> Experiment:
    """Four runs: two tasks, two repetitions, one measure."""
    return prepare_or_refuse(write_config())


class Clock:
    """A clock that is moved by hand."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


class Notices:
    """Makes notices with as few words as a test needs."""

    @staticmethod
    def started(**changes: Any) -> ExperimentStarted:
        facts: dict[str, Any] = {
            "experiment_name": "trial",
            "folder": Path.cwd() / "results" / "trial",
            "run_count": 4,
            "done_count": 0,
            "seed": 1,
            "columns": {"Energy": "J"},
            "overrides": {},
        }
        return ExperimentStarted(**facts | changes)

    @staticmethod
    def task(number: int = 1, *, attempt: int = 1, treatment: object = "Video") -> RunTask:
        return RunTask(f"r_{number}", number, 4, attempt, {"Task": treatment}, 1, 1, 1)

    def begun(self, number: int = 1, *, left: TimeLeft | None = None, **changes: Any) -> AttemptStarted:
        return AttemptStarted(self.task(number, **changes), left)

    def done(
        self,
        number: int = 1,
        *,
        value: object = 877.1234,
        seconds: float = 10.0,
        origin: Origin = Origin.MEASURED,
        left: TimeLeft | None = None,
        doubts: tuple[str, ...] = (),
    ) -> AttemptFinished:
        measure = PublishedMeasure("Energy", value, "Ina219", "J", origin, doubts)
        outcome = RunOutcome(AttemptStatus.DONE, measures={"Energy": measure}, seconds=seconds)
        return AttemptFinished(self.task(number), outcome, is_last=True, left=left)

    def failed(self, number: int = 1, *, is_last: bool = True, attempt: int = 1) -> AttemptFinished:
        failure = RunFailure("no [bold]odometry[/bold]\nat all", "start_run", "BasicTurtlebot3")
        outcome = RunOutcome(AttemptStatus.FAILED, failure=failure, seconds=2.0)
        return AttemptFinished(self.task(number, attempt=attempt), outcome, is_last=is_last)

    def interrupted(self, number: int = 1) -> AttemptFinished:
        return AttemptFinished(self.task(number), RunOutcome(AttemptStatus.INTERRUPTED, seconds=1.0), is_last=True)

    @staticmethod
    def finished(**changes: Any) -> ExperimentFinished:
        folder = Path.cwd() / "results" / "trial"
        facts: dict[str, Any] = {
            "folder": folder,
            "run_table": folder / "run_table.csv",
            "done_count": 4,
            "failed_count": 0,
            "todo_count": 0,
            "failed": (),
            "interrupted": False,
            "seconds": 61.0,
        }
        return ExperimentFinished(**facts | changes)


@pytest.fixture
def notices() -> Notices:
    return Notices()


class Screenful:
    """A console that writes into memory: a file, or a terminal of this width."""

    def __init__(self, columns: int | None = None) -> None:
        stream = io.StringIO()
        if columns is not None:
            stream.isatty = lambda: True  # type: ignore[method-assign]
        self.stream = stream
        self.console = UserConsole(stream)
        if columns is not None:
            self.console._force_terminal = True
            self.console.size = self.console.size._replace(width=columns, height=30)
            self.console._environ = {"TERM": "xterm-256color"}

    @property
    def text(self) -> str:
        return self.stream.getvalue()


@pytest.fixture
def screenful() -> type[Screenful]:
    return Screenful
