"""An experiment as it is named on the command line: by its folder, or by its config file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.cli.console import quiet_loading, shown_path
from robot_runner.cli.parser import UsageError
from robot_runner.cli.planning import folder_of
from robot_runner.cli.wording import listed
from robot_runner.config.checks.parameters import read_parameters
from robot_runner.config.overrides import parse_assignments
from robot_runner.dialects.loading import load_config
from robot_runner.errors import ConfigError, StorageError, did_you_mean
from robot_runner.storage.layout import ExperimentFolder

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["folder_of_target"]


def folder_of_target(target: str, assignments: Sequence[str]) -> ExperimentFolder:
    """Return the folder of the experiment that is meant.

    Raises:
        UsageError: parameters are set for a folder, which takes none.
        ConfigError: the config file cannot be loaded, or does not say where its results are.
        StorageError: there is no such file or folder, or no experiment in it.
    """
    path = Path(target).expanduser()
    if path.is_dir():
        if assignments:
            raise UsageError("--set is for config files", where=target, fix="Leave it out, or name the config file.")
        return _in_folder(path)
    if not path.exists() and path.suffix != ".py":
        names = [each.name for each in path.parent.iterdir()] if path.parent.is_dir() else []
        fix = did_you_mean(path.name, names) if len(names) < _MOST_NAMES else "Name a folder that is there."
        raise StorageError("there is no such file or folder", where=target, fix=fix)
    return _of_config(path, assignments)


_MOST_NAMES = 20


def _in_folder(path: Path) -> ExperimentFolder:
    folder = ExperimentFolder.found_at(path.resolve())
    if folder.manifest.exists():
        return folder
    within = sorted(each.name for each in path.iterdir() if ExperimentFolder(each).manifest.exists())
    if within:
        names = listed(shown_path(path / name) for name in within)
        fix = f"Name the experiment's own folder: {names}."
    else:
        fix = "Name the folder that holds run_table.csv and manifest.json, or the config file."
    raise StorageError("there is no experiment here", where=str(path), fix=fix)


def _of_config(path: Path, assignments: Sequence[str]) -> ExperimentFolder:
    with quiet_loading():
        loaded = load_config(path, parse_assignments(assignments))
        folder = folder_of(loaded)
    if folder is None:
        raise ConfigError.of_findings(read_parameters(loaded)[1])
    if not folder.manifest.exists():
        raise StorageError(
            f"this experiment was never executed: there is nothing in {shown_path(folder.root)}",
            where=str(path),
            fix=f"Execute it: robot-runner {path}",
        )
    return folder
