"""A keyword that a class or a function does not take, where a config's code calls it: the one that was meant."""

from __future__ import annotations

import inspect
import re
import traceback
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import did_you_mean

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["keywords_of", "misspelt_keyword"]

#: How CPython words it, since 3.10 with the class: `Ina219.__init__() got an unexpected keyword argument 'prt'`.
_UNEXPECTED = re.compile(r"(?P<called>[\w.<>]+)\(\) got an unexpected keyword argument '(?P<keyword>\w+)'")


def misspelt_keyword(path: Path, error: BaseException) -> str:
    """Return the fix for a keyword that nothing has, by its nearest name; empty where it was something else.

    Args:
        path: the config file, one of whose lines made the call.
        error: what Python raised.
    """
    found = _UNEXPECTED.search(str(error)) if isinstance(error, TypeError) else None
    if found is None:
        return ""
    name = found["called"].removesuffix(".__init__").rpartition(".")[2]
    for frame, _ in reversed(list(traceback.walk_tb(error.__traceback__))):
        if Path(frame.f_code.co_filename) == path:
            known = keywords_of(_named(name, {**frame.f_globals, **frame.f_locals}))
            return did_you_mean(found["keyword"], known)
    return ""


def keywords_of(called: Any) -> list[str]:
    """Return the names of the parameters of a class or function; none where it does not tell."""
    with suppress(TypeError, ValueError):  # it is no callable, or one of Python's own
        parameters = inspect.signature(called).parameters.values()
        return [each.name for each in parameters if each.kind in {each.POSITIONAL_OR_KEYWORD, each.KEYWORD_ONLY}]
    return []


def _named(name: str, known: Mapping[str, Any]) -> Any:
    """Return what goes by this name where the call was made: under it, under another, or in a module."""
    if name in known:
        return known[name]
    values = list(known.values())
    inside = [getattr(each, name, None) for each in values if inspect.ismodule(each)]
    return next((each for each in [*values, *inside] if getattr(each, "__name__", None) == name), None)
