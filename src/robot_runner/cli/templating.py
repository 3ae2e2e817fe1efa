"""Config files that come with Robot Runner, written to where a user can change them."""

from __future__ import annotations

from pathlib import Path
from typing import TextIO

from robot_runner.core.errors import StorageError
from robot_runner.core.storage.system_refusals import storage_error

_TEMPLATES = Path(__file__).parent / "templates"


def template(name: str) -> str:
    """Return the text of a template, by the name of its file, such as `demo_config.py`."""
    return (_TEMPLATES / name).read_text(encoding="utf-8")


def write_new_file(path: Path, text: str, *, instead: str) -> None:
    """Write a file that is not there yet.

    Args:
        path: the file.
        text: what it is to hold.
        instead: what to do where there is one already: one imperative.

    Raises:
        StorageError: it is there, or cannot be written.
    """
    try:
        with path.open("x", encoding="utf-8") as file:
            _fill(file, text, path)
    except FileExistsError as error:
        raise StorageError("there is a file of this name already", where=str(path), fix=instead) from error
    except OSError as error:
        raise storage_error(path, "written", error) from error


def _fill(file: TextIO, text: str, path: Path) -> None:
    """Write to a new file; where that fails, nothing is left of it."""
    try:
        file.write(text)
        file.flush()
    except OSError:
        path.unlink(missing_ok=True)
        raise
