"""The run table in memory: made from the plan, or read from the folder and brought up to date from the journal."""

from __future__ import annotations

import ast
import difflib
import re
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from operator import is_
from typing import TYPE_CHECKING, Any

from robot_runner.core.design.columns import REPETITION, RUN_ID, STATUS
from robot_runner.core.errors import ExecutionError, Finding, did_you_mean
from robot_runner.core.execution.task import AttemptStatus, RunOutcome
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.journal import journal_lines, parsed_record
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.run_table_rows import RunTableRows
from robot_runner.core.storage.table_columns import ColumnRole
from robot_runner.core.storage.table_schema import ColumnDescription, describe_columns, read_schema, write_schema

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.design.planned_runs import PlannedRun
    from robot_runner.core.design.run_table_model import RunTable

__all__ = [
    "ACCEPT",
    "RecoveredTable",
    "Resumption",
    "config_changes",
    "config_files",
    "recover_table",
    "selected_places",
    "table_differences",
]


# How an experiment is to go on: what is executed again, and what may differ from before.


@dataclass(frozen=True, slots=True, kw_only=True)
class Resumption:
    """What the user asks for when an experiment is started or goes on.

    Attributes:
        accept_changes: go on though the config, what was set, or the run table differs from before.
        redo: runs to execute again though they are done; what they left is kept.
        only: the only runs to execute; nothing means all.
    """

    accept_changes: bool = False
    redo: tuple[str, ...] = ()
    only: tuple[str, ...] = ()


def selected_places(rows: RunTableRows, resumption: Resumption) -> list[int]:
    """Return the places of the runs that are to be executed, in order.

    Raises:
        ExecutionError: a run that was named is not in the table; all of them are listed.
    """
    _refuse_unknown(rows, "--redo", resumption.redo)
    _refuse_unknown(rows, "--only", resumption.only)
    redo, only = set(resumption.redo), set(resumption.only)
    return [
        place
        for place, (run_id, status) in enumerate(zip(rows.values(RUN_ID), rows.values(STATUS), strict=True))
        if (status is not RunStatus.DONE or run_id in redo) and (not only or run_id in only or run_id in redo)
    ]


def _refuse_unknown(rows: RunTableRows, option: str, run_ids: Iterable[str]) -> None:
    unknown = [run_id for run_id in run_ids if rows.place_of(run_id) is None]
    if unknown:
        known = [rows.run_id(place) for place in range(min(len(rows), 1000))]
        raise ExecutionError.of_findings(
            [
                Finding.error(f"{option} {run_id}", "the run table has no such run", did_you_mean(run_id, known))
                for run_id in unknown
            ]
        )


# What differs between an experiment as it was executed before and as it is to go on.

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
    if len(plan) == len(rows) and all(map(is_, plan, rows.planned)):  # as nearly always, and many times faster
        return
    planned = {run.run_id: run for run in plan}
    for found in rows.planned:
        run = planned.pop(found.run_id, None)
        if run is None:
            yield Finding.error(f"{path}, run {found.run_id}", "the plan has no such run", _TABLE_FIX)
        else:
            yield from _different_cells(path, run, found, has_repetition=rows.layout.has_repetition)
    for run_id in planned:
        yield Finding.error(f"{path}, run {run_id}", "the table lacks this run of the plan", _TABLE_FIX)


def _different_cells(path: Path, run: PlannedRun, found: PlannedRun, *, has_repetition: bool) -> Iterator[Finding]:
    pairs = [(name, found.combination[name], value) for name, value in run.combination.items()]
    if has_repetition:
        pairs.append((REPETITION, found.repetition, run.repetition))
    for name, is_now, value in pairs:
        if is_now is not value and str(is_now) != str(value):
            where = f"{path}, run {run.run_id}, column {name!r}"
            yield Finding.error(where, f"the table has {is_now!r}, the plan {value!r}", _TABLE_FIX)


def _changed_lines(source: Path, before: str, now: str) -> Iterator[Finding]:
    if before == now or _means_the_same(before, now):
        return
    old, new = before.splitlines(), now.splitlines()
    for tag, old_start, old_end, new_start, new_end in difflib.SequenceMatcher(None, old, new).get_opcodes():
        if tag != "equal":
            was = " / ".join(line.strip() for line in old[old_start:old_end])
            is_now = " / ".join(line.strip() for line in new[new_start:new_end])
            yield Finding.error(f"{source}:{new_start + 1}", f"the line was {was!r} and is {is_now!r}", _CONFIG_FIX)


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
            problem = f"the parameter was {_setting(name, was)} and is {_setting(name, is_now)}"
            yield Finding.error(f"--set {name}", problem, _CONFIG_FIX)


def _setting(name: str, value: str | None) -> str:
    return "not set" if value is None else f"set by --set {name}={value}"


_MOST_DIFFERENCES = 20
_ENDS = {AttemptStatus.DONE.value: RunStatus.DONE, AttemptStatus.FAILED.value: RunStatus.FAILED}


@dataclass(slots=True)
class RecoveredTable:
    """The run table of an experiment, as far as it has come.

    Attributes:
        rows: the table, kept up to date.
        attempts: how often each run was tried.
        failed: why each failed run failed.
        unfinished: the run whose attempt did not come to a recorded end, or None.
        findings: what looked odd in the file.
        is_on_disk: whether the file holds all this, and has a schema, so that neither need be written.
    """

    experiment: Experiment
    rows: RunTableRows
    attempts: Counter[str] = field(default_factory=Counter)
    failed: dict[str, str] = field(default_factory=dict)
    unfinished: str | None = None
    findings: tuple[Finding, ...] = ()
    is_on_disk: bool = False
    origins: defaultdict[str, set[str]] = field(default_factory=lambda: defaultdict(set))
    _kinds: set[tuple[str, Any]] = field(default_factory=set)
    doubts: defaultdict[str, set[str]] = field(default_factory=lambda: defaultdict(set))

    def take_outcome(self, run_id: str, outcome: RunOutcome) -> bool:
        """Bring the row of a run up to date with how its attempt ended; returns whether a type or origin is new."""
        for measure in outcome.measures.values():
            self.origins[measure.name].add(measure.origin.value)
        for finding in outcome.findings:
            self.doubts[finding.where.partition(", ")[2]].add(f"{run_id}: {finding.problem}")
        values = {name: measure.value for name, measure in outcome.measures.items()}
        self._record(run_id, outcome.status.value, outcome.stamps, values)
        kinds: set[tuple[str, Any]] = {(name, type(value)) for name, value in values.items() if value is not None}
        kinds |= {(measure.name, measure.origin) for measure in outcome.measures.values()}
        has_new = not kinds <= self._kinds
        self._kinds |= kinds
        return has_new

    def take_record(self, record: Mapping[str, Any]) -> None:
        """Bring the row of a run up to date with how the journal says that its attempt ended."""
        self.take_origins(record)
        values = {name: measure["value"] for name, measure in record["measures"].items()}
        self._record(record["run"], record["status"], record["stamps"], values)

    def take_origins(self, record: Mapping[str, Any]) -> None:
        """Remember where the measures of an attempt came from, as the journal says."""
        for name, measure in record["measures"].items():
            self.origins[name].add(measure["origin"])

    def write_schema(self, path: Path) -> None:
        """Write the run table's schema as far as it is known."""
        write_schema(path, describe_columns(self.rows, self._known()))

    def _record(self, run_id: str, status: str, stamps: Mapping[str, str], measures: Mapping[str, Any]) -> None:
        if status == AttemptStatus.INTERRUPTED.value:
            self.rows.clear(run_id)
            return
        self.rows.record(
            run_id,
            status=_ENDS[status],
            stamps={
                name: stamp for event, stamp in stamps.items() if (name := f"{event}_at") in self.rows.layout.stamps
            },
            measures={name: value for name, value in measures.items() if name in self.rows.layout.measures},
        )

    def _known(self) -> dict[str, ColumnDescription]:
        return {
            column.name: ColumnDescription(
                name=column.name,
                role=ColumnRole.MEASURE,
                description=column.measure.description,
                unit=column.measure.unit,
                owner=column.owner,
                origin=", ".join(sorted(self.origins[column.name])) or None,
                findings=tuple(sorted(self.doubts[column.owner])),
            )
            for column in self.experiment.columns.in_table
        }


def recover_table(
    experiment: Experiment, manifest: Mapping[str, Any], *, accept_changes: bool = False
) -> RecoveredTable:
    """Return the run table: planned anew, or as it stands in the folder with what the journal knows better.

    The journal is flushed at the end of each run, the file is only brought up to date now and then: runs that ended
    after the file was written last are taken from the journal. What a user changed in the file counts.

    Args:
        experiment: what is to be executed.
        manifest: as written when the experiment was first executed.
        accept_changes: let the table on disk count where it differs from the plan.

    Raises:
        StorageError: the table cannot be read; every problem is named.
        ExecutionError: it differs from the plan; every cell is named.
    """
    folder = experiment.folder
    plan = experiment.model.plan(manifest["seed"])
    schema = read_schema(folder.schema) if folder.schema.exists() else ()
    layout = experiment.table_layout({column.name: column.type for column in schema} or None)
    if not folder.run_table.exists():
        recovered = RecoveredTable(experiment, RunTableRows.of_plan(plan, layout))
    else:
        rows = read_run_table(folder.run_table, layout, plan)
        if manifest["design"]["source"] == "config" and not accept_changes:
            _refuse(table_differences(folder.run_table, plan, rows))
        recovered = RecoveredTable(experiment, rows, findings=rows.warnings, is_on_disk=rows.has_file and bool(schema))
    for column in schema:
        recovered.origins[column.name].update(column.origin.split(", ") if column.origin else ())
    _replay(recovered, folder.journal, has_origins=bool(schema))
    return recovered


# As `Journal.append` writes them: run and status are read from the line, as parsing takes twenty times as long.
_RUN = re.compile(rb'\{"kind":"[^"]*","at":"[^"\\]*","run":"([^"\\]*)"')
_STARTED = b'{"kind":"attempt_started"'
_TABLE_WRITTEN = b'{"kind":"table_written"'
_IS_DONE = b'"status":"done"'  # quotes inside a text are escaped: these stand nowhere else


def _replay(recovered: RecoveredTable, journal: Path, *, has_origins: bool) -> None:
    """Take from the journal what the file does not have; measures' origins as well, where no schema tells them."""
    since_table_written: list[bytes] = []
    failed: list[bytes] = []
    attempted: list[str] = []
    is_open = False
    for line in journal_lines(journal, kinds={"attempt_started", "attempt_finished", "table_written"}):
        if line.startswith(_STARTED):
            attempted.append(_run_of(journal, line))
            is_open = True
        elif line.startswith(_TABLE_WRITTEN):
            parsed_record(journal, line)  # what comes before is left out from here on: a damaged line must not do that
            since_table_written.clear()
        else:
            is_open = False
            since_table_written.append(line)
            if _IS_DONE not in line:
                failed.append(line)
            if not has_origins:
                recovered.take_origins(parsed_record(journal, line))
    recovered.attempts.update(attempted)
    recovered.unfinished = attempted[-1] if is_open else None
    last_ends = {_run_of(journal, line): line for line in since_table_written}
    for line in last_ends.values():
        recovered.take_record(parsed_record(journal, line))
    recovered.is_on_disk &= not last_ends and not recovered.rows.count(RunStatus.RUNNING)
    _settle(recovered, {_run_of(journal, line): parsed_record(journal, line)["failure"] or "" for line in failed})


def _run_of(journal: Path, line: bytes) -> str:
    found = _RUN.match(line)
    return found[1].decode() if found else str(parsed_record(journal, line)["run"])


def _settle(recovered: RecoveredTable, reasons: Mapping[str, str]) -> None:
    """Runs whose end nobody saw are to do again; failed ones are listed with their reason."""
    rows = recovered.rows
    for place in range(len(rows)) if rows.count(RunStatus.RUNNING) or rows.count(RunStatus.FAILED) else ():
        run_id = rows.run_id(place)
        if rows.status(place) is RunStatus.RUNNING:
            rows.clear(run_id)
        elif rows.status(place) is RunStatus.FAILED:
            recovered.failed[run_id] = reasons.get(run_id, "")


def _refuse(differences: Iterable[Finding]) -> None:
    listed = list(differences)
    more = len(listed) - _MOST_DIFFERENCES
    if more > 0:
        listed[_MOST_DIFFERENCES:] = [
            Finding.error(listed[0].where, f"there are {more:,} more differences", listed[0].fix)
        ]
    if listed:
        raise ExecutionError.of_findings(listed)
