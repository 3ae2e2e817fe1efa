"""Telling who executes a config by `python study.py` that this only defines a class, and how it is executed."""

from __future__ import annotations

import ast
import atexit
import logging
import shlex
import sys
from pathlib import Path

from robot_runner.core.config.source import tree_of

_log = logging.getLogger(__name__)

#: Modules of a script or notebook that does more than to define a config.
_AT_WORK = frozenset({"robot_runner.cli.main", "robot_runner.testing", "IPython", "unittest"})


def tell_at_exit() -> None:
    """Have Python tell how to execute the experiment when it ends, where a class is defined by the script itself."""
    file = getattr(sys.modules["__main__"], "__file__", None)
    if file is not None and Path(file).is_file():  # what is piped into Python has the name <stdin>
        tell_nothing()  # once for all classes of the file
        atexit.register(_tell, (sys.argv or [file])[0], Path(file))


def tell_nothing() -> None:
    """Have Python tell nothing, as the script itself executes the experiment."""
    atexit.unregister(_tell)


def _tell(path: str, file: Path) -> None:
    """Log it, unless the script has ended by an exception, or is at work in another way."""
    if hasattr(sys, "last_value") or hasattr(sys, "ps1") or not _AT_WORK.isdisjoint(sys.modules):
        return
    # What a block does that only `python study.py` executes cannot be known.
    if not any(isinstance(each, ast.If) and "__name__" in ast.dump(each.test) for each in tree_of(file).body):
        word = shlex.quote(path)
        _log.warning("python has only defined the experiment in %s; `robot-runner %s` executes it", word, word)
