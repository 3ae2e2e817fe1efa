"""The experiment that a word of the command line names: its folder, a folder that holds it, or its config file."""

from __future__ import annotations

import os
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.cli.console import command_line, shown_path
from robot_runner.cli.parser import UsageError
from robot_runner.core.errors import StorageError, did_you_mean
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.words import listed

if TYPE_CHECKING:
    from collections.abc import Sequence

#: Of more names in a folder, none is proposed.
_MOST_NAMES = 20


def folder_of_target(target: str, assignments: Sequence[str], *, takes_older: bool = False) -> ExperimentFolder:
    """Return the folder of the experiment that is meant.

    Args:
        target: a folder or a config file.
        assignments: static parameters to set, as `name=value`.
        takes_older: whether a folder will do that another tool has filled, with a run table and no manifest.

    Raises:
        UsageError: parameters are set for a folder, which takes none.
        ConfigError: the config file cannot be loaded, or does not say where its results are.
        StorageError: there is no such file or folder, or no experiment in it.
    """
    path = Path(os.path.expanduser(target))  # noqa: PTH111 - as it is where there is no such user
    if os.path.isdir(path):  # noqa: PTH112 - false of what cannot be looked at, too
        if assignments:
            raise UsageError("--set is for config files", where=target, fix="Leave it out, or name the config file.")
        return _in_folder(path, takes_older=takes_older)
    if not os.path.exists(path) and path.suffix != ".py":  # noqa: PTH110 - as above
        names = _names_in(path.parent) if os.path.isdir(path.parent) else []  # noqa: PTH112 - as above
        fix = did_you_mean(path.name, names) if len(names) < _MOST_NAMES else "Name a folder that is there."
        raise StorageError("there is no such file or folder", where=target, fix=fix)
    if path.suffix.casefold() == ".zip":
        words = shlex.join(["unzip", "-q", target, "-d", path.stem])
        fix = f"Unpack it, and name the folder: {words}"
        raise StorageError("this is a package, and an experiment's folder is needed", where=target, fix=fix)
    return _of_config(path, assignments, takes_older=takes_older)


def _in_folder(path: Path, *, takes_older: bool) -> ExperimentFolder:
    names = _names_in(path)
    folder = ExperimentFolder.found_at(path.resolve())
    if _is_begun(folder, takes_older=takes_older):
        return folder
    within = sorted(name for name in names if holds_experiment(path / name))
    if len(within) == 1:  # a folder of results, such as `experiments`
        return ExperimentFolder.found_at(path.resolve() / within[0])
    if within:
        several = listed(shown_path(path / name) for name in within)
        fix = f"Name the experiment's own folder: {several}."
    else:
        fix = "Name the folder that holds run_table.csv and manifest.json, or the config file."
    raise StorageError("there is no experiment here", where=str(path), fix=fix)


def _names_in(folder: Path) -> list[str]:
    try:
        return [each.name for each in folder.iterdir()]
    except OSError as error:
        problem = f"the folder cannot be read: {error.strerror}"
        raise StorageError(problem, where=str(folder), fix="Mend its permissions, or name another one.") from error


def holds_experiment(folder: Path) -> bool:
    """Return whether a folder is that of an experiment; one that cannot be looked into is none."""
    return os.path.isfile(ExperimentFolder(folder).manifest)  # noqa: PTH113 - false of what cannot be looked at, too


def _is_begun(folder: ExperimentFolder, *, takes_older: bool) -> bool:
    """Return whether a folder has an experiment that was executed: by us, or else by another tool.

    Raises:
        StorageError: another tool did, and that will not do; the manifest is lost, or the run table cannot be read.
    """
    if folder.manifest.exists():
        return True
    where = shown_path(folder.root)
    if folder.journal.exists():
        fix = "Execute the experiment once more with its config (robot-runner run): it is made anew."
        raise StorageError("manifest.json is missing, and the journal is there", where=where, fix=fix)
    rows = read_run_table(folder.run_table, TableLayout((), stamps=())) if folder.run_table.exists() else None
    is_of_older_tool = rows is not None and len(rows) > rows.count(RunStatus.TODO)
    if is_of_older_tool and not takes_older:
        fix = "Go on with its config (robot-runner run), or adopt the results (robot-runner import)."
        raise StorageError("another tool executed this experiment", where=where, fix=fix)
    return is_of_older_tool


def _of_config(path: Path, assignments: Sequence[str], *, takes_older: bool) -> ExperimentFolder:
    from robot_runner.cli.planning import configured_folder  # noqa: PLC0415 - a folder needs none of it

    folder = configured_folder(path, assignments)
    if _is_begun(folder, takes_older=takes_older):
        return folder
    problem = f"this experiment was never executed: there is nothing in {shown_path(folder.root)}"
    raise StorageError(problem, where=str(path), fix=f"Execute it: {command_line(str(path))}")
