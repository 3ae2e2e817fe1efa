"""How an experiment resumes: which runs are executed, and what has changed since the last execution."""

from __future__ import annotations

import ast
import difflib
import hashlib
import sys
from collections.abc import Collection, Container, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from importlib.util import decode_source
from itertools import repeat
from operator import is_
from pathlib import Path
from typing import Any

from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.source import DESIGN_METHODS, parsed
from robot_runner.core.design.columns import BATCH, EXCLUDED, REPETITION, STATUS, WARM_UP
from robot_runner.core.design.factor import texts_of
from robot_runner.core.design.planned_runs import PlannedRun
from robot_runner.core.design.run_table_model import RunTable
from robot_runner.core.design.selection import Chosen, RunChooser
from robot_runner.core.design.warm_up import WarmUp, with_warm_ups_again
from robot_runner.core.errors import ExecutionError, Finding, StorageError
from robot_runner.core.execution.given_values import changed_values, is_part_of, is_reordered
from robot_runner.core.secret_names import is_same_setting, shown_settings
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.guarded_files import read_bytes
from robot_runner.core.storage.input_files import input_changes
from robot_runner.core.storage.layout import last_config
from robot_runner.core.storage.manifest import is_damaged, read_manifest
from robot_runner.core.storage.run_table_rows import RunTableRows
from robot_runner.core.words import listed


class TableDisagreementError(ExecutionError):
    """The run table on disk and the journal disagree about executed runs, and the user has not chosen one."""


class TableChoice(Enum):
    """The choice between the run table on disk and the journal where they disagree about executed runs.

    JOURNAL: what was executed; the file is put aside.
    FILE: what the file says; each difference is recorded as a deviation.
    """

    JOURNAL = "journal"
    FILE = "file"


@dataclass(frozen=True, slots=True, kw_only=True)
class Resumption:
    """The user's options for starting or resuming an experiment.

    Attributes:
        accept_changes: go on though the config, its settings, or the run table differ from before.
        table: what counts where the run table and the journal disagree; None refuses to go on, unless changes are
            accepted: then the file counts.
        redo: runs to execute again though they are done or excluded; their files are kept.
        only: the only runs to execute; nothing means all.
        skip: runs that are not executed this time.
        first: runs that are executed before all others this time, in this order.
        probe: whether profilers are probed before the first run, where the config does not forbid it.

    Runs are chosen by ids or by treatments, see `RunChooser`.
    """

    accept_changes: bool = False
    table: TableChoice | None = None
    redo: tuple[str, ...] = ()
    only: tuple[str, ...] = ()
    skip: tuple[str, ...] = ()
    first: tuple[str, ...] = ()
    probe: bool = True

    @property
    def chosen_table(self) -> TableChoice | None:
        """The choice where the run table and the journal disagree; None where the user has made none."""
        return self.table or (TableChoice.FILE if self.accept_changes else None)

    @property
    def selection(self) -> dict[str, list[str]]:
        """The chosen runs, by option, for the journal and the manifest."""
        asked = {"only": self.only, "skip": self.skip, "first": self.first, "redo": self.redo}
        return {name: list(given) for name, given in asked.items() if given}


def selected_places(rows: RunTableRows, resumption: Resumption, warm_up: WarmUp | None = None) -> list[int]:
    """Return the places of the runs that are to be executed, in the order in which they are.

    Raises:
        ExecutionError: what was named is not in the table, or cannot be executed; everything is listed.
    """
    left = _left(rows)
    if not resumption.selection:
        return with_session_warm_ups(rows, left, warm_up)
    chooser = RunChooser(rows.planned, has_repetition=rows.layout.has_repetition)
    redo, only, skip, first = (
        chooser.choose(f"--{option}", getattr(resumption, option)) for option in ("redo", "only", "skip", "first")
    )
    again, skipped = set(redo.places), set(skip.places)
    chooser.findings += _contradictions(rows, again, skipped, {"--only": only, "--first": first, "--redo": redo})
    chooser.refuse()
    wanted = {*left, *again} - skipped
    if resumption.only:
        wanted &= {*only.places, *again}
    ahead = [place for place in first.places if place in wanted]
    chosen = [*ahead, *sorted(wanted.difference(ahead))]
    if warm_up is None:
        return chosen
    # What is executed first, or alone, is not to be measured cold: its warm-up runs come with it, and before it.
    planned = list(rows.planned)
    warmed = {warm_up.group(planned[place]) for place in chosen if not planned[place].is_warm_up}
    late = {place for place in left if planned[place].is_warm_up and warm_up.group(planned[place]) in warmed}
    late -= skipped.union(ahead)
    return with_session_warm_ups(rows, [place for place in chosen if place not in late], warm_up, skipped, late)


def with_session_warm_ups(
    rows: RunTableRows,
    selected: list[int],
    warm_up: WarmUp | None,
    skipped: Collection[int] = (),
    late: Collection[int] = (),
) -> list[int]:
    """Return these places with those of the warm-up runs that come before them.

    Each session warms up again where `warm_up` says so; the `skipped` warm-up runs are not executed again, and the
    `late` ones are still to do.
    """
    if warm_up is None or not (warm_up.each_session or late):
        return selected
    places = range(len(rows)) if warm_up.each_session else ()
    known = (place for place in places if rows.excluded(place) is None and place not in skipped)
    again = [place for place in known if rows.status(place) is RunStatus.DONE]
    return with_warm_ups_again(list(rows.planned), selected, [*again, *late], warm_up)


def _left(rows: RunTableRows) -> list[int]:
    """Return the places of the runs that are neither done nor left out."""
    reasons = rows.values(EXCLUDED) if rows.layout.has_exclusions else repeat(None)
    states = zip(rows.values(STATUS), reasons, strict=False)
    return [place for place, (status, reason) in enumerate(states) if status is not RunStatus.DONE and reason is None]


def _contradictions(
    rows: RunTableRows, again: set[int], skipped: set[int], chosen: Mapping[str, Chosen]
) -> Iterator[Finding]:
    """Yield an error for each run that was chosen by its id and cannot be executed."""
    for option, runs in chosen.items():
        for place in sorted(runs.named):
            where, reason = f"{option} {rows.run_id(place)}", rows.excluded(place)
            if place in skipped:
                yield Finding.error(where, "the run is also chosen by --skip", "Leave it out of one of them.")
            elif reason is not None and place not in again:
                fix = "Take it in again with `robot-runner include`, or execute it again with --redo."
                yield Finding.error(where, f"the run is excluded: {reason}", fix)


# What has changed since the last execution.

#: The option of `robot-runner run` that accepts changes.
ACCEPT = "--accept-changes"

_CONFIG_FIX = f"Undo the change, accept it ({ACCEPT}), or choose another experiment_name."
_FROM_OUTSIDE = ", and comes from outside the file, such as from an environment variable, or from hash()"
_TABLE_FIX = (
    f"Undo the change (--table journal does), let the table count (--table file, or {ACCEPT}), or choose another "
    "experiment_name."
)
_PLAN_FIX = (
    "Nobody changed the table: create_run_table was changed, or it may plan otherwise in each process, as from random "
    f"numbers, or from the order of a set, which sorted() settles. Correct it, or let the table count ({ACCEPT})."
)


def config_files(experiment: Experiment, kept: Path) -> dict[Path, Path]:
    """Return the config file and the local modules that it imported, each with the place of its copy in a folder."""
    places = {experiment.config_path: Path(experiment.config_path.name), **experiment.local_modules}
    return {source: kept / place for source, place in places.items()}


def config_changes(experiment: Experiment, *, of_design: bool = True, of_settings: bool = True) -> list[Finding]:
    """Return how the config differs from the one executed before, line by line; nothing where it is new or equal.

    Comments and blank lines are not a difference.

    Raises:
        StorageError: the experiment's manifest cannot be read.
    """
    folder = experiment.folder
    if not folder.manifest.exists() or is_damaged(folder.manifest):
        return []
    manifest = read_manifest(folder.manifest)
    ignored = frozenset() if of_design else DESIGN_METHODS
    kept = last_config(folder)
    files = config_files(experiment, kept)
    if (earlier := _earlier_name(experiment, manifest, kept)) is not None:
        files[experiment.config_path] = kept / earlier
    findings = [*_changed_files(files, folder.root, ignored)]
    if of_settings:
        findings += input_changes(experiment.inputs, kept)
        last = (manifest.get("executions") or [manifest])[-1]
        settings = {str(name): str(text) for name, text in last.get("deviations", {}).items()}
        findings += _changed_settings(settings, experiment.overrides)
        told = "" if findings else _FROM_OUTSIDE
        findings += _changed_values(experiment, manifest, {*settings, *experiment.overrides}, told)
    return findings


def edited_meanwhile(experiment: Experiment) -> Iterator[Finding]:
    """Yield a warning for each file that runs read, or import late, and that was changed since this execution began."""
    kept = last_config(experiment.folder)
    loaded = {str(getattr(each, "__file__", "")) for each in list(sys.modules.values())}
    late = {source: copy for source, copy in config_files(experiment, kept).items() if str(source) not in loaded}
    with suppress(StorageError, OSError):  # a disk that is gone: there is nothing to be compared
        for each in (*input_changes(experiment.inputs, kept), *_changed_files(late, experiment.folder.root)):
            problem = f"changed while the experiment was executed: {each.problem}"
            fix = (
                "Find out from when on, and execute these runs again (--redo). What the config writes for each run "
                "itself is no input: leave it out, or bind what it tells to factors (treatment)."
            )
            yield Finding.warning(each.where, problem, fix)


def _changed_files(files: Mapping[Path, Path], root: Path, ignored: frozenset[str] = frozenset()) -> Iterator[Finding]:
    for source, copy in files.items():
        if copy.exists():
            yield from _changed_lines(source, _text(read_bytes(copy, root)), _text(source.read_bytes()), ignored)


def _earlier_name(experiment: Experiment, manifest: Mapping[str, Any], kept: Path) -> str | None:
    """Return the earlier name of the config file, where it has another name now."""
    name = str((manifest.get("config") or {}).get("file"))
    has_other = name not in {experiment.config_path.name, "", ".", ".."} and Path(name).name == name
    return name if has_other and not (kept / experiment.config_path.name).exists() else None


def table_differences(
    path: Path,
    plan: RunTable,
    rows: RunTableRows,
    accepted: Container[tuple[str, str, str]] = (),
    *,
    is_as_written: bool = False,
) -> Iterator[Finding]:
    """Yield an error for each cell in which the run table on disk differs from the plan, and each run of only one.

    Where many differ in the same way, as with one cause, there is one error for all of them. `accepted` are cells that
    are left out: run, column and text. With `is_as_written` the file is as we wrote it: the plan must have changed.
    """
    fix = _PLAN_FIX if is_as_written else _TABLE_FIX
    if len(plan) == len(rows) and all(map(is_, plan, rows.planned)):  # as nearly always, and many times faster
        return
    planned = {run.run_id: run for run in plan}
    alike: dict[tuple[str, str], list[str]] = {}
    for found in rows.planned:
        if (run := planned.pop(found.run_id, None)) is None:
            alike.setdefault(("", "the plan has no such run"), []).append(found.run_id)
            continue
        for name, is_now, value in _different_cells(run, found, has_repetition=rows.layout.has_repetition):
            if (run.run_id, name, str(is_now)) not in accepted:
                difference = f", column {name!r}", f"the table has {is_now!r}, the plan {value!r}"
                alike.setdefault(difference, []).append(run.run_id)
    if planned:
        alike["", "the table lacks this run of the plan"] = list(planned)
    for (column, problem), runs in alike.items():
        if len(runs) > _MOST_ALIKE:
            where, named = f"{path}, each of {len(runs):,} runs{column}", listed(runs, _SHOWN_ALIKE)
            yield Finding.error(where, f"{problem} ({named})", fix)
        else:
            yield from (Finding.error(f"{path}, run {run_id}{column}", problem, fix) for run_id in runs)


#: More equal differences are one finding, which names the first runs.
_MOST_ALIKE, _SHOWN_ALIKE = 5, 20


def plan_digest(plan: RunTable) -> str:
    """Return the SHA-256 of a plan, in hexadecimal digits: it identifies the plan that a user has accepted."""
    digest = hashlib.sha256()
    for run in plan:
        digest.update(repr((run.run_id, texts_of(run.combination), run.repetition, run.batch, run.is_warm_up)).encode())
    return digest.hexdigest()


def _different_cells(run: PlannedRun, found: PlannedRun, *, has_repetition: bool) -> Iterator[tuple[str, Any, Any]]:
    """Yield the column of each cell in which a run differs from the plan, its value, and that of the plan."""
    pairs = [(name, found.combination[name], value) for name, value in run.combination.items()]
    if has_repetition:
        pairs.append((REPETITION, found.repetition, run.repetition))
    pairs += [(BATCH, found.batch, run.batch), (WARM_UP, found.is_warm_up, run.is_warm_up)]
    for name, is_now, value in pairs:
        if is_now is not value and str(is_now) != str(value):
            yield name, is_now, value


def _text(program: bytes) -> str:
    """Decode a Python file by its declared encoding, without a byte order mark."""
    try:
        return decode_source(program)
    except (SyntaxError, UnicodeDecodeError):  # a local module need not be Python source
        return program.decode("utf-8", "backslashreplace")


def _changed_lines(source: Path, before: str, now: str, ignored: frozenset[str]) -> Iterator[Finding]:
    if before == now or _means_the_same(before, now, ignored):
        return
    old, new = before.splitlines(), now.splitlines()
    for tag, old_start, old_end, new_start, new_end in difflib.SequenceMatcher(None, old, new).get_opcodes():
        if tag != "equal":
            was = " / ".join(line.strip() for line in old[old_start:old_end])
            is_now = " / ".join(line.strip() for line in new[new_start:new_end])
            yield Finding.error(f"{source}:{new_start + 1}", f"the line was {was!r} and is {is_now!r}", _CONFIG_FIX)


def _means_the_same(before: str, now: str, ignored: frozenset[str]) -> bool:
    """Return whether two versions of a file have the same syntax tree, the bodies of `ignored` functions left out."""
    try:
        trees = parsed(before), parsed(now)
    except (SyntaxError, ValueError):  # ValueError: a binary file has null bytes
        return False
    for function in (each for tree in trees for each in ast.walk(tree) if isinstance(each, ast.FunctionDef)):
        if function.name in ignored:
            function.body = []
    return ast.dump(trees[0]) == ast.dump(trees[1])


#: Settings that may change: the first two have led to this folder, the third changes no value.
_OF_NO_CONSEQUENCE = {"results_output_path", "experiment_name", "workers"}


def _changed_settings(before: Mapping[str, str], now: Mapping[str, str]) -> Iterator[Finding]:
    for name in sorted({*before, *now} - _OF_NO_CONSEQUENCE):
        was, is_now = before.get(name), now.get(name)
        is_another_scheduler = name == "cluster" and bool(was and is_now)  # the same runs, ordered from another one
        if not (is_another_scheduler or is_same_setting(was, is_now)):
            problem = f"the parameter was {_setting(name, was)} and is {_setting(name, is_now)}"
            yield Finding.error(f"--set {name}", problem, _CONFIG_FIX)


def _changed_values(
    experiment: Experiment, manifest: Mapping[str, Any], settings: Collection[str], why: str
) -> Iterator[Finding]:
    """Yield an error for each value that has changed; those set with `--set` are compared as settings.

    A list that was made of a set has another order in each process: that is a warning elsewhere (`change_findings`).
    """
    for name, pair in changed_values(experiment, manifest).items():
        if not is_part_of(name, settings) and not is_reordered(pair):
            was, is_now = (repr(pair[each]) if each in pair else "not given" for each in ("was", "is"))
            where = f"{experiment.config_path}, {name}"
            yield Finding.error(where, f"the value was {was} and is {is_now}{why}", _CONFIG_FIX)


def _setting(name: str, value: str | None) -> str:
    return "not set" if value is None else f"set by --set {name}={shown_settings({name: value})[name]}"


#: Further differences are counted, not listed.
_MOST_DIFFERENCES = 20


def refuse_differences(differences: Iterable[Finding], kind: type[ExecutionError] = ExecutionError) -> None:
    """Raise an error that lists these differences, the first ones of many; nothing where there are none.

    Raises:
        ExecutionError: there are some.
    """
    found = list(differences)
    more = len(found) - _MOST_DIFFERENCES
    if more > 0:
        rest = Finding.error(found[0].where, f"there are {more:,} more differences", found[0].fix)
        found[_MOST_DIFFERENCES:] = [rest]
    kind.refuse(found)
