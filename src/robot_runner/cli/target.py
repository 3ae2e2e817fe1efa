"""The experiment that a word of the command line names: its folder, a folder that holds it, or its config file."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from robot_runner.cli.console import command_line, shown_path
from robot_runner.cli.parser import UsageError
from robot_runner.core.errors import StorageError, did_you_mean
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.lock import holder_of
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.words import listed

#: Of more names in a folder, none is proposed.
_MOST_NAMES = 20


def folder_of_target(target: str, assignments: Sequence[str], *, takes_older: bool = False) -> ExperimentFolder:
    """Return the folder of the experiment that is meant, or of the config that is, with parameters set by `name=value`.

    With `takes_older`, a folder will do that another tool has filled, with a run table and no manifest.

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
        names = sorted(_named_experiments(path.parent)) if os.path.isdir(path.parent) else []  # noqa: PTH112 - as above
        otherwise = None if 0 < len(names) < _MOST_NAMES else "Name the folder of an experiment, or its config file."
        fix = did_you_mean(path.name, names, otherwise)
        raise StorageError("there is no such file or folder", where=target, fix=fix)
    if path.suffix.casefold() == ".zip":
        fix = f"Unpack it, and name the folder: {shlex.join(['unzip', '-q', target, '-d', path.stem])}"
        raise StorageError("this is a package, and an experiment's folder is needed", where=target, fix=fix)
    if path.suffix.casefold() != ".py" and holds_experiment(path.parent):
        problem = "this is a file of an experiment, and its folder is needed"
        raise StorageError(problem, where=target, fix=f"Name it: {shown_path(path.parent)}")
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
        raise StorageError(problem, where=str(folder), fix="Correct its permissions, or name another one.") from error


def _named_experiments(folder: Path) -> Iterator[str]:
    """Yield names of experiments in a folder: their folders, folders that hold some, files that may be configs."""
    for name in _names_in(folder):
        if next(_experiments(folder / name, 1), None) or (name.endswith(".py") and os.path.isfile(folder / name)):  # noqa: PTH113 - as above
            yield name


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
        if (holder := holder_of(folder.lock)) is not None:  # it writes its manifest in a moment
            problem = f"the experiment is being begun by process {holder.pid} on {holder.host}"
            raise StorageError(problem, where=where, fix="Wait a moment, and repeat the command.")
        fix = "Execute the experiment once more with its config (robot-runner run): it is rebuilt."
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
    others = sorted(_experiments(folder.root.parent, 1), key=_changed)  # the config may make its name from the time
    beside = f", or name the folder of another one: {shown_path(others[-1])}" if others else ""
    raise StorageError(problem, where=str(path), fix=f"Execute it: {command_line(str(path))}{beside}")


#: The results of a config are in a folder of its results folder, so that this many folders lie between.
_DEEPEST = 2
#: What lies beside a package that was unpacked to be replicated: the list of its checksums, in this folder.
_UNPACKED = Path("package", "SHA256SUMS")
#: How many commands are offered where several could be meant.
_MOST_OFFERED = 3


def only_experiment(command: str, *after: str) -> str:
    """Return the folder of the only experiment here, at most two folders below; the words are for the remedy.

    What lies in the folder of a replication is not meant.

    Raises:
        UsageError: there is none, or more than one.
    """
    return _only(command, "experiment", sorted(_experiments(Path.cwd(), _DEEPEST)), after)


def target_or_only(
    command: str, target: str | None, assignments: Sequence[str], *, takes_older: bool = False
) -> ExperimentFolder:
    """Return the folder of the experiment that is meant: the one that is named, or else the only one here.

    Raises:
        RobotRunnerError: none is named, and not exactly one is here; or there is none where one is named.
    """
    return folder_of_target(target or only_experiment(command), assignments, takes_older=takes_older)


def target_and_runs(
    command: str, target: str | None, runs: Sequence[str], assignments: Sequence[str]
) -> tuple[ExperimentFolder, Sequence[str]]:
    """Return the folder of the experiment that is meant, and the runs; the first word may be one of them.

    Raises:
        RobotRunnerError: none is named, and not exactly one is here; or there is none where one is named.
    """
    is_run = target is not None and not (os.path.lexists(target) or os.sep in target or target.endswith(".py"))
    if target is None or (is_run and any(_experiments(Path.cwd(), _DEEPEST))):
        runs = [*([target] if target is not None else ()), *runs]
        target = only_experiment(command, *runs)
    return folder_of_target(target, assignments), runs


def refuse_unwritable(folder: Path, option: str) -> None:
    """Refuse to write into a folder within an experiment's, before anything is computed, where that cannot be done.

    Raises:
        StorageError: it cannot be written; with the option of the command that writes elsewhere.
    """
    existing = next(each for each in (folder, *folder.parents) if os.path.isdir(each))  # noqa: PTH112 - as above
    if not os.access(existing, os.W_OK | os.X_OK):
        where = shown_path(existing)
        raise StorageError("the folder cannot be written", where=where, fix=f"Write elsewhere: {option} FOLDER.")


def only_package(command: str) -> str:
    """Return the only zip file in this folder; whether it is a package shows when it is opened.

    Raises:
        UsageError: there is none, or more than one.
    """
    return _only(command, "package", sorted(path for path in Path.cwd().glob("*.zip") if path.is_file()))


def _experiments(folder: Path, depth: int) -> Iterator[Path]:
    if holds_experiment(folder):
        yield folder
    elif depth and not os.path.exists(folder / _UNPACKED):  # noqa: PTH110 - false of what cannot be looked at, too
        names: list[str] = []
        with suppress(OSError), os.scandir(folder) as below:
            folders = (each for each in below if each.is_dir(follow_symlinks=False))
            names = [each.name for each in folders if not each.name.startswith(".")]
        for name in names:
            yield from _experiments(folder / name, depth - 1)


def _only(command: str, what: str, found: list[Path], after: Sequence[str] = ()) -> str:
    if len(found) == 1:
        return shown_path(found[0])
    where = f"robot-runner {command}"
    if not found:
        name = what.upper()
        fix = f"Go to its folder, or name it: {' '.join([where, name, *after])}."
        raise UsageError(f"there is no {what} here, and none is named", where=where, fix=fix)
    newest = sorted(found, key=_changed, reverse=True)[:_MOST_OFFERED]
    offered = " or ".join(command_line(command, shown_path(each), *after) for each in newest)
    problem = f"there are {len(found)} {what}s here, and none is named"
    raise UsageError(problem, where=where, fix=f"Say which one is meant: {offered}.")


def _changed(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:
        return 0.0
