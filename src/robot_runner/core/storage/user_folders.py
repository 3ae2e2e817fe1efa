"""Where a user's own programs keep what is not part of any experiment: the folders of state and of caches."""

from __future__ import annotations

import os
from pathlib import Path

from robot_runner.core.errors import StorageError

#: As the XDG Base Directory Specification (0.8) has them.
_FOLDERS = {"XDG_STATE_HOME": "~/.local/state", "XDG_CACHE_HOME": "~/.cache"}


def home_folder() -> Path | None:
    """Return the user's home folder; None where there is none, as for a user without a name in some containers."""
    try:
        return Path.home()
    except RuntimeError:
        return None


def user_folder(variable: str) -> Path:
    """Return our folder in the user's for state (`XDG_STATE_HOME`) or for caches (`XDG_CACHE_HOME`).

    A relative path in the variable is passed over, as its specification has it: it would be another folder in each
    place from which somebody starts us, and none would know of the others.

    Raises:
        StorageError: the user has no home folder, as in some containers.
    """
    try:
        given = Path(os.environ.get(variable, "")).expanduser()
        return (given if given.is_absolute() else Path(_FOLDERS[variable]).expanduser()) / "robot-runner"
    except RuntimeError as error:
        fix = f"Set {variable} to a folder of your own."
        raise StorageError("the user has no home folder", where=_FOLDERS[variable], fix=fix) from error
