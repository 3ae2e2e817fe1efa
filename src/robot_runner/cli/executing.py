"""An experiment executed before the eyes of a user."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.cli.console import is_live_terminal, output
from robot_runner.cli.findings import show_findings
from robot_runner.cli.guard import INTERRUPTED, SOME_FAILED
from robot_runner.cli.harmless_stream import DroppedOutput, let_go_of
from robot_runner.cli.screens.live import LiveScreen
from robot_runner.cli.screens.plain import PlainScreen
from robot_runner.core.errors import Finding, RobotRunnerError
from robot_runner.core.execution.orchestrator import execute_experiment

if TYPE_CHECKING:
    from robot_runner.cli.screens.progress import Progress
    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.execution.notices import ExperimentFinished
    from robot_runner.core.execution.recovery import Resumption


@dataclass(frozen=True, slots=True)
class Execution:
    """How an experiment was executed.

    Attributes:
        finished: how it ended; None where it could not go on.
        progress: what the screen saw of it.
        was_shown_live: whether the table of its runs stands on the terminal.
    """

    finished: ExperimentFinished | None
    progress: Progress
    was_shown_live: bool

    @property
    def exit_code(self) -> int:
        """0: all that was asked for is done; 1: a run failed; 130: the user ended it."""
        if self.finished is None:
            return SOME_FAILED
        if self.finished.interrupted:
            return INTERRUPTED
        return SOME_FAILED if self.finished.failed_count or self.finished.stopped_by_policy else 0


def execute_on_screen(
    experiment: Experiment,
    findings: Sequence[Finding] = (),
    *,
    plain: bool,
    resumption: Resumption | None = None,
    waits_for_claims: bool = False,
) -> Execution:
    """Execute an experiment and show it meanwhile; where another one has claimed the same, it may wait.

    Raises:
        RobotRunnerError: it cannot start.
    """
    with DroppedOutput():
        kind = LiveScreen if is_live_terminal(sys.stdout) and not plain else PlainScreen
        screen = kind(output(), experiment, time.monotonic)
        finished = None
        try:
            with screen:
                finished = execute_experiment(
                    experiment, screen, findings=findings, resumption=resumption, waits_for_claims=waits_for_claims
                )
        except RobotRunnerError as error:
            if not screen.progress.has_begun:
                raise
            show_findings(error.findings)  # it was not refused: it could not go on
        return Execution(finished, screen.progress, was_shown_live=isinstance(screen, LiveScreen))


@contextmanager
def read_or_not() -> Iterator[None]:
    """While the end is told: that nobody reads it changes nothing of how the experiment went."""
    try:
        yield
        sys.stdout.flush()
    except OSError:  # a closed pipe, or a terminal that is gone
        let_go_of(sys.stdout)
