"""Config files that come with Robot Runner, written to where a user can change them."""

from __future__ import annotations

from pathlib import Path

from robot_runner.core.errors import StorageError

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
            file.write(text)
    except FileExistsError as error:
        raise StorageError("there is a file of this name already", where=str(path), fix=instead) from error
    except OSError as error:
        fix = "Name a file in a folder that exists and can be written."
        raise StorageError(f"the file cannot be written: {error.strerror}", where=str(path), fix=fix) from error
