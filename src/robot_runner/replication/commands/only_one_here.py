"""What is meant where a command is told no experiment or package: the only one that is here."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.cli.console import shown_path
from robot_runner.cli.parser import UsageError
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.words import listed, one_line
from robot_runner.replication.contents import SUMS

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["only_experiment", "only_package"]

#: The results of a config are in a folder of its results folder, so that this many folders lie between.
_DEEPEST = 2


def only_experiment() -> str:
    """Return the folder of the only experiment here: in this folder, or at most two below it.

    What lies in the folder of a replication is not meant.

    Raises:
        UsageError: there is none, or more than one.
    """
    return _only("EXPERIMENT", "experiment", sorted(_experiments(Path.cwd(), _DEEPEST)))


def only_package() -> str:
    """Return the only zip file in this folder; whether it is a package is found by whoever opens it.

    Raises:
        UsageError: there is none, or more than one.
    """
    return _only("PACKAGE", "package", sorted(path for path in Path.cwd().glob("*.zip") if path.is_file()))


def _experiments(folder: Path, depth: int) -> Iterator[Path]:
    if (ExperimentFolder(folder)).manifest.is_file():
        yield folder
    elif depth and not (folder / "package" / SUMS).exists():
        below = (each for each in folder.iterdir() if not each.name.startswith("."))
        for each in below:
            if each.is_dir() and not each.is_symlink():
                yield from _experiments(each, depth - 1)


def _only(argument: str, what: str, found: list[Path]) -> str:
    if len(found) == 1:
        return shown_path(found[0])
    names = listed(one_line(shown_path(each)) for each in found)
    problem = f"there is more than one {what} here: {names}" if found else f"there is no {what} here"
    fix = f"Say which one is meant: {argument}."
    raise UsageError(problem, where=argument, fix=fix)
