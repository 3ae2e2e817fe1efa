"""A fault of our own: one line for the user, the traceback for whoever mends it."""

from __future__ import annotations

import platform
import sys
import tempfile
import traceback
from importlib.metadata import version

from robot_runner.cli.findings import show_findings
from robot_runner.errors import Finding

__all__ = ["show_fault"]


def show_fault(error: Exception, *, show_traceback: bool) -> None:
    """Say that this is our fault; the traceback goes to the terminal, or to a file that is named."""
    text = "".join(traceback.format_exception(error))
    if show_traceback:
        sys.stderr.write(text)
        fix = "Report it with this traceback."
    else:
        fix = f"Report it with the file {_kept(text)}, or repeat the command with --debug."
    problem = f"this is a fault of Robot Runner, not yours: {type(error).__name__}: {error}"
    show_findings([Finding.error("", problem, fix)])


def _kept(text: str) -> str:
    head = f"robot-runner {version('robot-runner')}, Python {platform.python_version()}, {platform.platform()}\n"
    command = " ".join(sys.argv)
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="robot-runner-fault-", suffix=".txt", delete=False, encoding="utf-8", errors="backslashreplace"
        ) as file:
            file.write(f"{head}{command}\n\n{text}")
    except OSError as error:
        return f"that could not be written ({error.strerror})"
    return file.name
