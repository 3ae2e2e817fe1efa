"""What differs between an experiment as it was executed before and as it is to go on."""

from __future__ import annotations

import ast
import difflib
from typing import TYPE_CHECKING, Any

from robot_runner.design.columns import REPETITION
from robot_runner.errors import Finding
from robot_runner.storage.manifest import read_manifest

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from robot_runner.config.experiment import Experiment
    from robot_runner.design.run_table import PlannedRun, RunTable
    from robot_runner.storage.run_table_rows import RunTableRows

__all__ = ["ACCEPT", "config_changes", "config_files", "table_differences"]

#: The option of `robot-runner run` that goes on all the same.
ACCEPT = "--accept-changes"

_CONFIG_FIX = f"Undo the change, accept it ({ACCEPT}), or choose another experiment_name."
_TABLE_FIX = f"Undo the change, let the table count ({ACCEPT}), or choose another experiment_name."


def config_files(experiment: Experiment) -> dict[Path, Path]:
    """Return the config file and the local modules that it imported, each with its place in the experiment's folder."""
    root = experiment.config_path.parent
    sources = (experiment.config_path, *experiment.local_modules)
    return {source: experiment.folder.config / source.relative_to(root) for source in sources}


def config_changes(experiment: Experiment) -> list[Finding]:
    """Return how the config differs from what was executed before, line by line; nothing where it is new or the same.

    Comments and blank lines are no difference.

    Raises:
        StorageError: the experiment's manifest cannot be read.
    """
    folder = experiment.folder
    if not folder.manifest.exists():
        return []
    manifest = read_manifest(folder.manifest)
    findings = [
        finding
        for source, kept in config_files(experiment).items()
        if kept.exists()
        for finding in _changed_lines(source, kept.read_text("utf-8"), source.read_text("utf-8"))
    ]
    return [*findings, *_changed_settings(_last_settings(manifest), experiment.overrides)]


def table_differences(path: Path, plan: RunTable, rows: RunTableRows) -> Iterator[Finding]:
    """Yield each cell in which the run table on disk differs from the plan, and each run that only one of them has."""
    planned = {run.run_id: run for run in plan}
    for place in range(len(rows)):
        run_id = rows.run_id(place)
        run = planned.pop(run_id, None)
        if run is None:
            yield Finding.error(f"{path}, run {run_id}", "the plan has no such run", _TABLE_FIX)
        else:
            yield from _different_cells(path, run, rows, place)
    for run_id in planned:
        yield Finding.error(f"{path}, run {run_id}", "the table lacks this run of the plan", _TABLE_FIX)


def _different_cells(path: Path, run: PlannedRun, rows: RunTableRows, place: int) -> Iterator[Finding]:
    expected: dict[str, Any] = dict(run.combination)
    if rows.layout.has_repetition:
        expected[REPETITION] = run.repetition
    for name, value in expected.items():
        found = rows.factors[name].value(place)
        if found is not value and str(found) != str(value):
            where = f"{path}, run {run.run_id}, column {name!r}"
            yield Finding.error(where, f"the table has {found!r}, the plan {value!r}", _TABLE_FIX)


def _changed_lines(source: Path, before: str, now: str) -> Iterator[Finding]:
    if before == now or _means_the_same(before, now):
        return
    old, new = before.splitlines(), now.splitlines()
    for tag, old_start, old_end, new_start, new_end in difflib.SequenceMatcher(None, old, new).get_opcodes():
        if tag != "equal":
            was = " / ".join(line.strip() for line in old[old_start:old_end])
            is_now = " / ".join(line.strip() for line in new[new_start:new_end])
            yield Finding.error(f"{source}:{new_start + 1}", f"it was {was!r} and is {is_now!r}", _CONFIG_FIX)


def _means_the_same(before: str, now: str) -> bool:
    try:
        return ast.dump(ast.parse(before)) == ast.dump(ast.parse(now))
    except SyntaxError:  # a local module may be of any kind
        return False


def _last_settings(manifest: Mapping[str, Any]) -> Mapping[str, str]:
    executions = manifest.get("executions") or [manifest]
    return {str(name): str(text) for name, text in executions[-1].get("deviations", {}).items()}


def _changed_settings(before: Mapping[str, str], now: Mapping[str, str]) -> Iterator[Finding]:
    for name in sorted({*before, *now} - {"results_output_path"}):  # by which we have found this folder
        was, is_now = before.get(name), now.get(name)
        if was != is_now:
            problem = f"it was {_setting(name, was)} and is {_setting(name, is_now)}"
            yield Finding.error(f"--set {name}", problem, _CONFIG_FIX)


def _setting(name: str, value: str | None) -> str:
    return "not set" if value is None else f"set by --set {name}={value}"
