"""What a screen says beside its rows: how an experiment begins, and what SEMI asks of the user."""

from __future__ import annotations

import shlex
import sys
import termios
from contextlib import suppress
from typing import TYPE_CHECKING

from robot_runner.cli.console import shown_path
from robot_runner.cli.wording import counted

if TYPE_CHECKING:
    from robot_runner.execution.notices import ExperimentStarted, WaitingForUser

__all__ = ["closing", "forget_typed", "opening", "request", "terminal_input"]


def terminal_input() -> int | None:
    """Return the descriptor on which somebody can press ENTER, or None where nobody sits."""
    with suppress(AttributeError, OSError, ValueError):
        if sys.stdin.isatty():
            return sys.stdin.fileno()
    return None


def forget_typed(descriptor: int | None) -> None:
    """Forget what was typed before it was asked for: an ENTER during a run must not start the next one."""
    if descriptor is not None:
        with suppress(termios.error):
            termios.tcflush(descriptor, termios.TCIFLUSH)


def opening(started: ExperimentStarted) -> list[str]:
    """Return what is said when an experiment starts."""
    before = f", {started.done_count:,} of them done before" if started.done_count else ""
    runs = f"{counted(started.run_count, 'run')}{before}, seed {started.seed}"
    lines = [f"{started.experiment_name}: {runs}, results in {shown_path(started.folder)}"]
    if started.overrides:
        parts = ", ".join(f"{name}={value}" for name, value in started.overrides.items())
        lines.append(f"set by hand, and recorded as a deviation from the config: {parts}")
    return lines


def closing(run_id: str) -> str:
    """Return what is said once the user has interrupted."""
    return f"Interrupted: closing {run_id} (its robot is stopped, its profilers too). Ctrl-C again kills it at once."


def request(waiting: WaitingForUser, *, by_key: bool) -> str:
    """Return what the user is asked for between two runs."""
    command = f"robot-runner continue {shlex.quote(shown_path(waiting.folder))}"
    run = f"run {waiting.next_run_number} of {waiting.run_count}"
    if by_key:
        return f"Press ENTER to start {run}, or in another terminal: {command}"
    return f"Waiting before {run}. To go on: {command}"
