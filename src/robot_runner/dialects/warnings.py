"""A word about the run that is being executed, from a stand-in that has no context of its own."""

from __future__ import annotations

import logging

from robot_runner.dialects.session import active_context

__all__ = ["warn_of_run"]

_log = logging.getLogger(__name__)


def warn_of_run(problem: str, *, fix: str = "") -> None:
    """Have something doubtful said at the end of the experiment; outside a run it is logged."""
    context = active_context()
    if context is None:
        _log.warning("%s %s", problem, fix)
    else:
        context.warn(problem, fix=fix)
