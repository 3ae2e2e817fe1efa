"""Config files that come with Robot Runner, written to where a user can change them."""

from __future__ import annotations

import os
from pathlib import Path

from robot_runner.core.errors import StorageError
from robot_runner.core.storage.guarded_files import open_to_write

_TEMPLATES = Path(__file__).parent / "templates"


def template(name: str) -> str:
    """Return the text of a template, by the name of its file, such as `demo_config.py`."""
    return (_TEMPLATES / name).read_text(encoding="utf-8")


def write_new_file(path: Path, text: str, *, instead: str) -> None:
    """Write a file that is not there yet.

    `instead` says what to do where there is one already: one imperative.

    Raises:
        StorageError: it is there, or cannot be written.
    """
    if os.path.lexists(path):
        raise StorageError("there is a file of this name already", where=str(path), fix=instead)
    # Beside it first: where this is interrupted or fails, there is no part of a file that a second try would respect.
    with open_to_write(path, mode=0o666) as file:
        file.write(text.encode())
