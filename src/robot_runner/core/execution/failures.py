"""What is told of an error that a callback has raised."""

from __future__ import annotations

import traceback
from contextlib import suppress

from robot_runner.core.errors import RobotRunnerError, nearest
from robot_runner.core.events.context import OTHER_NAMES, ExperimentContext
from robot_runner.core.events.early_end import RunInterrupted
from robot_runner.core.secret_names import without_environment_secrets


def failure_fields(error: BaseException) -> dict[str, str]:
    """Return the problem in one line, and the traceback, without what the environment keeps secret."""
    text = text_of(error)
    problem = text if isinstance(error, RobotRunnerError | RunInterrupted) else f"{type(error).__name__}: {text}"
    problem += _name_meant(error)
    if isinstance(error, EOFError) and "reading a line" in text:
        problem += " (nobody can type into a run: have a person asked before it, by `operator_steps`)"
    trace = "".join(traceback.format_exception(error))
    return {"problem": without_environment_secrets(problem), "traceback": without_environment_secrets(trace)}


def _name_meant(error: BaseException) -> str:
    """Return, in brackets, the name that may be meant where an object has no attribute of a name; else nothing."""
    if not isinstance(error, AttributeError) or not error.name or error.obj is None:
        return ""
    near = OTHER_NAMES.get(error.name) if isinstance(error.obj, ExperimentContext) else None
    with suppress(Exception):  # what `dir` calls is a stranger's code
        near = near or nearest(error.name, dir(error.obj))
    return f" (did you mean {near!r}?)" if near else ""


def text_of(error: BaseException) -> str:
    """Return what an error says; some have a `__str__` that raises."""
    try:
        return str(error)
    except BaseException as later:  # noqa: BLE001 - a stranger's code
        return f"(its text could not be made: {type(later).__name__})"
