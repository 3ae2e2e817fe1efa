"""The experiment that a word of the command line names: its folder, a folder that holds it, or its config file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.cli.console import shown_path
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
    path = Path(target).expanduser()
    if path.is_dir():
        if assignments:
            raise UsageError("--set is for config files", where=target, fix="Leave it out, or name the config file.")
        return _in_folder(path, takes_older=takes_older)
    if not path.exists() and path.suffix != ".py":
        names = [each.name for each in path.parent.iterdir()] if path.parent.is_dir() else []
        fix = did_you_mean(path.name, names) if len(names) < _MOST_NAMES else "Name a folder that is there."
        raise StorageError("there is no such file or folder", where=target, fix=fix)
    return _of_config(path, assignments, takes_older=takes_older)


def _in_folder(path: Path, *, takes_older: bool) -> ExperimentFolder:
    folder = ExperimentFolder.found_at(path.resolve())
    if folder.manifest.exists() or (takes_older and _is_of_older_tool(folder)):
        return folder
    if _is_of_older_tool(folder):
        raise _older(folder)
    within = sorted(each.name for each in path.iterdir() if ExperimentFolder(each).manifest.exists())
    if len(within) == 1:  # a folder of results, such as `experiments`
        return ExperimentFolder.found_at(path.resolve() / within[0])
    if within:
        names = listed(shown_path(path / name) for name in within)
        fix = f"Name the experiment's own folder: {names}."
    else:
        fix = "Name the folder that holds run_table.csv and manifest.json, or the config file."
    raise StorageError("there is no experiment here", where=str(path), fix=fix)


def _is_of_older_tool(folder: ExperimentFolder) -> bool:
    """Return whether a folder has a run table with runs that were executed, and nothing of ours.

    Raises:
        StorageError: the run table cannot be read.
    """
    if folder.manifest.exists() or not folder.run_table.exists():
        return False
    rows = read_run_table(folder.run_table, TableLayout((), stamps=()))
    return len(rows) > rows.count(RunStatus.TODO)


def _older(folder: ExperimentFolder) -> StorageError:
    fix = "Go on with its config (robot-runner run), or adopt the results (robot-runner import)."
    return StorageError("another tool executed this experiment", where=shown_path(folder.root), fix=fix)


def _of_config(path: Path, assignments: Sequence[str], *, takes_older: bool) -> ExperimentFolder:
    from robot_runner.cli.planning import configured_folder  # noqa: PLC0415 - a folder needs none of it

    folder = configured_folder(path, assignments)
    if _is_of_older_tool(folder) and not takes_older:
        raise _older(folder)
    if not folder.manifest.exists() and not _is_of_older_tool(folder):
        raise StorageError(
            f"this experiment was never executed: there is nothing in {shown_path(folder.root)}",
            where=str(path),
            fix=f"Execute it: robot-runner {path}",
        )
    return folder
