"""What a second terminal (or the dashboard) tells the orchestrator: one word in one file."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING

from robot_runner.storage.safe_write import write_beside_and_rename

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["Command", "forget_command", "send_command", "take_command"]


class Command(Enum):
    """What can be said."""

    CONTINUE = "continue"


def send_command(control: Path, command: Command) -> None:
    """Leave a command for the orchestrator.

    Raises:
        StorageError: the experiment's folder cannot be written.
    """
    write_beside_and_rename(control, lambda file: file.write(command.value))


def take_command(control: Path) -> Command | None:
    """Return the command that was left, and remove it; None where there is none, or none that is known."""
    try:
        word = control.read_text(encoding="utf-8")
    except OSError:
        return None
    forget_command(control)
    return Command(word) if word in {known.value for known in Command} else None


def forget_command(control: Path) -> None:
    """Remove a command that was left before anybody waited for it."""
    control.unlink(missing_ok=True)
