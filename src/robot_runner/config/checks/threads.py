"""Threads that a config starts while it is loaded: a process that has them cannot be forked safely."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.config.choices import RunProcess
from robot_runner.errors import Finding

if TYPE_CHECKING:
    from robot_runner.config.loader import LoadedConfig
    from robot_runner.config.parameters import Parameters

__all__ = ["check_threads"]


def check_threads(loaded: LoadedConfig, parameters: Parameters) -> list[Finding]:
    """Return a warning where runs would be forked from a process in which the config has started threads."""
    if not loaded.threads or parameters.run_process is not RunProcess.FORK:
        return []
    names = ", ".join(loaded.threads)
    return [
        Finding.warning(
            loaded.where,
            f"loading it started threads that go on ({names}); a run that is forked meanwhile may hang",
            "Start them in start_run, or choose run_process = RunProcess.SPAWN.",
        )
    ]
