"""Files that define messages, services and actions: where they are, and to which package each belongs."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from robot_runner.core.errors import LinkError

#: The suffixes of definition files.
SUFFIXES = (".msg", ".srv", ".action")
#: The folders of a package that contain them.
_FOLDERS = tuple(suffix.removeprefix(".") for suffix in SUFFIXES)
_NAME = re.compile(rb"<name[^>]*>\s*([A-Za-z]\w*)\s*</name>")
#: How much of a package.xml is read for the package's name, which is at its beginning, bytes.
_LOOKED_AT = 65536


def definition_files(path: Path) -> list[Path]:
    """Return a definition file, or those below a folder; raise a `LinkError` if there is none."""
    if path.is_file() and path.suffix in SUFFIXES:
        return [path]
    files = sorted(file for suffix in SUFFIXES for file in path.rglob(f"*{suffix}")) if path.is_dir() else []
    if not files:
        problem = "there is no .msg, .srv or .action file" if path.exists() else "there is no such file or folder"
        raise LinkError(problem, where=str(path), fix="Name such a file, or a folder that holds some.")
    return files


def package_of(file: Path) -> str:
    """Return the package of a definition: the name in package.xml; without one, that of its folder.

    A clone or a download may lie in a folder of another name, such as `px4_msgs-main`.

    Raises:
        LinkError: the folder cannot be called like a package.
    """
    folder = _folder_of(file)
    name = _named_by(folder / "package.xml") or folder.name
    if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII):
        fix = "Call the folder like the package, or put its package.xml there."
        raise LinkError(f"{name!r} is not the name of a package", where=str(file), fix=fix)
    return name


def naming_files(path: Path) -> Iterator[Path]:
    """Yield each package.xml by which copies of the definitions at a path still belong to the right package."""
    whole = path.resolve()
    for folder in sorted({_folder_of(each) for each in definition_files(path)}):
        name = _named_by(folder / "package.xml")
        if name and (name != folder.name or not folder.is_relative_to(whole)):
            yield folder / "package.xml"


def _folder_of(file: Path) -> Path:
    beside = file.resolve().parent
    return beside.parent if beside.name in _FOLDERS else beside


def _named_by(manifest: Path) -> str | None:
    try:
        with manifest.open("rb") as file:
            found = _NAME.search(file.read(_LOOKED_AT))
    except OSError:
        return None
    return found[1].decode() if found else None
