"""What is meant where a command is told no experiment or package: the only one that is here."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from robot_runner.cli.console import command_line, shown_path
from robot_runner.cli.parser import UsageError
from robot_runner.cli.target import folder_of_target, holds_experiment

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from robot_runner.core.storage.layout import ExperimentFolder

#: The results of a config are in a folder of its results folder, so that this many folders lie between.
_DEEPEST = 2
#: What lies beside a package that was unpacked to be replicated: the list of its checksums, in this folder.
_UNPACKED = Path("package", "SHA256SUMS")
#: How many commands are offered where several could be meant.
_MOST_OFFERED = 3


class _Chosen(NamedTuple):
    """Runs of an experiment."""

    folder: ExperimentFolder
    runs: Sequence[str]


def only_experiment(command: str, *after: str) -> str:
    """Return the folder of the only experiment here: in this folder, or at most two below it.

    What lies in the folder of a replication is not meant.

    Args:
        command: that is told no experiment, for the remedy.
        after: the words that follow the experiment.

    Raises:
        UsageError: there is none, or more than one.
    """
    return _only(command, "experiment", sorted(_experiments(Path.cwd(), _DEEPEST)), after)


def target_and_runs(command: str, target: str | None, runs: Sequence[str], assignments: Sequence[str]) -> _Chosen:
    """Return the folder of the experiment that is meant, and the runs; the first word may be one of them.

    Args:
        command: whose words they are.
        target: the first word, where there are more than one.
        runs: the other words.
        assignments: static parameters to set, as `name=value`.

    Raises:
        RobotRunnerError: none is named, and not exactly one is here; or there is none where one is named.
    """
    is_run = target is not None and not (os.path.lexists(target) or os.sep in target or target.endswith(".py"))
    if target is None or (is_run and any(_experiments(Path.cwd(), _DEEPEST))):
        runs = [*([target] if target is not None else ()), *runs]
        target = only_experiment(command, *runs)
    return _Chosen(folder_of_target(target, assignments), runs)


def only_package(command: str) -> str:
    """Return the only zip file in this folder; whether it is a package shows when it is opened.

    Args:
        command: that is told no package, for the remedy.

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
            names = [
                each.name for each in below if each.is_dir(follow_symlinks=False) and not each.name.startswith(".")
            ]
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
