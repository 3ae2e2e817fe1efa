"""The run table of a resumed experiment: its rows by the journal, their doubts, and its file on disk."""

from __future__ import annotations

import re
import time
from collections import Counter, defaultdict
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import Any

from robot_runner.core.config.experiment import Experiment
from robot_runner.core.design.run_table_model import RunTable
from robot_runner.core.errors import Finding, StorageError
from robot_runner.core.events.measure import Origin
from robot_runner.core.execution.task import RunOutcome
from robot_runner.core.storage.executed_runs import (
    ACCEPTED_PLAN,
    DONE_BEFORE,
    EXCLUSION_KINDS,
    ExcludedRuns,
    done_before,
)
from robot_runner.core.storage.journal import Journal, journal_lines, parsed_record, utc_now
from robot_runner.core.storage.layout import put_attempt_back, runs_put_away
from robot_runner.core.storage.run_table_rows import RunTableRows, write_run_table
from robot_runner.core.storage.table_columns import ColumnDescription, ColumnRole
from robot_runner.core.storage.table_schema import describe_columns, read_schema, write_schema
from robot_runner.core.words import counted, enumerated

# As `Journal.append` writes them: run and status are read from the line, as parsing takes twenty times as long.
_RUN = re.compile(rb'\{"kind":"[^"]*","at":"[^"\\]*","run":"([^"\\]*)"')
_SESSION = b'{"kind":"experiment_started"'
_STARTED = b'{"kind":"attempt_started"'
#: How the record of an attempt's end begins.
ATTEMPT_FINISHED = b'{"kind":"attempt_finished"'
_TABLE_WRITTEN = b'{"kind":"table_written"'
_EXCLUSION = tuple(f'{{"kind":"{kind}"'.encode() for kind in EXCLUSION_KINDS)
_FINDING = b'{"kind":"finding"'
_KINDS = EXCLUSION_KINDS | {"experiment_started", "attempt_started", "attempt_finished", "table_written", "finding"}
# Quotes inside a text are escaped: these stand nowhere else.
_IS_DONE, _IS_INTERRUPTED, _HAS_DOUBTS = b'"status":"done"', b'"status":"interrupted"', b'"doubts":['
IS_AMENDED = b'"is_amended":true'
_ENTERED = Origin.ENTERED.value


@dataclass(slots=True)
class TableHistory:
    """The records of the journal on runs and on the file of the run table.

    Attributes:
        attempted: the run of each attempt.
        open: the records of attempts of the last session that began and have no recorded end, by run.
        begun: the runs whose last attempt, of whatever session, has no recorded end.
        newer: the ends of attempts since the table was written last.
        failed: the ends of attempts that were not done.
        written: the digest of the table as it was written last; empty where that is not known.
        has_ends: whether any attempt has ended.
        ended: the runs whose last attempt came to an end, well or not.
        excluded: the runs that are left out.
        doubtful: the last end of each run with doubtful values: after a kill, the schema may lack them.
        doubts: the findings in runs, by owner, as `RecoveredTable` has them.
    """

    attempted: list[str] = field(default_factory=list)
    open: dict[str, bytes] = field(default_factory=dict)
    begun: set[str] = field(default_factory=set)
    newer: list[bytes] = field(default_factory=list)
    failed: list[bytes] = field(default_factory=list)
    written: str = ""
    has_ends: bool = False
    ended: set[str] = field(default_factory=set)
    excluded: ExcludedRuns = field(default_factory=ExcludedRuns)
    doubtful: dict[str, bytes] = field(default_factory=dict)
    doubts: defaultdict[str, set[str]] = field(default_factory=lambda: defaultdict(set))

    @classmethod
    def of(cls, journal: Path) -> TableHistory:
        """Read a journal, which need not exist.

        Raises:
            StorageError: it cannot be read, or a line is not a record.
        """
        history = cls()
        for line in journal_lines(journal, kinds=_KINDS):
            history.take(journal, line)
        return history

    def take(self, journal: Path, line: bytes) -> None:
        """Take a line of the journal into account, the oldest first."""
        if line.startswith(_STARTED):
            run_id = run_of(journal, line)
            self.attempted.append(run_id)
            self.open[run_id] = line
            self.begun.add(run_id)
        elif line.startswith(_SESSION):
            self.open.clear()  # their logs were kept when that session began
        elif line.startswith(_TABLE_WRITTEN):
            # Parsed, unlike others: a damaged line must not make earlier records be skipped.
            self.written = str(parsed_record(journal, line).get("sha256", ""))
            self.newer.clear()
        elif line.startswith(_EXCLUSION):
            record = parsed_record(journal, line)
            self.excluded.take(record)
            if record["kind"] == "deviation":  # from here on, the row as changed by hand counts
                self.begun.discard(record["run"])
        elif line.startswith(_FINDING):
            found = parsed_record(journal, line)
            self.doubts[found["owner"]].add(f"{found.get('run')}: {found['problem']}")
        else:
            run_id = run_of(journal, line)
            self.open.pop(run_id, None)
            self.begun.discard(run_id)
            self.doubtful.pop(run_id, None)
            if _HAS_DOUBTS in line:
                self.doubtful[run_id] = line
            self.has_ends = True
            self.newer.append(line)
            (self.ended.discard if _IS_INTERRUPTED in line else self.ended.add)(run_id)
            if _IS_DONE not in line:
                self.failed.append(line)


def run_of(journal: Path, line: bytes) -> str:
    """Return the run that a line of the journal is about."""
    found = _RUN.match(line)
    return found[1].decode() if found else str(parsed_record(journal, line)["run"])


@dataclass(frozen=True, slots=True)
class Deviation:
    """A change by hand to a run that was executed.

    Attributes:
        run: its id.
        column: of the run table; `row` where the whole row was removed, `order` where rows changed places.
        was: the text of the cell by the journal.
        is_now: the text of the cell in the file.
    """

    run: str
    column: str
    was: str
    is_now: str


def with_later_batches(path: Path, plan: RunTable, rows: RunTableRows) -> tuple[RunTableRows, tuple[Finding, ...]]:
    """Add the batches and repetitions to rows of which an older file has no run; return the rows, and a finding."""
    added = dict(_added(plan))
    there = {run.run_id for run in rows.planned} if added else set()
    names = [name for name, ids in added.items() if not there.intersection(ids)]
    if not names:
        return rows, ()
    lacking = set(chain.from_iterable(added[name] for name in names))
    missing = [run for run in plan if run.run_id in lacking]
    older = f"the run table is older than {enumerated(names)}"
    problem = f"{older}: {counted(len(missing), 'run')} taken from the journal"
    grown = rows.with_plan([*rows.planned, *missing], rows.layout)
    return grown, (Finding.warning(str(path), problem),)


def _added(plan: RunTable) -> Iterator[tuple[str, set[str]]]:
    """Yield the name and the run ids of each batch, and of each later addition to it."""
    for batch in plan.model.batches:
        later = set(chain.from_iterable(ids for _, ids in batch.added))
        yield f"batch {batch.number}", {run.run_id for run in batch.runs} - later
        yield from ((name, set(ids)) for name, ids in batch.added)


def schema_of(path: Path) -> tuple[tuple[ColumnDescription, ...], tuple[Finding, ...]]:
    """Return the columns of the schema; none where it is missing, or damaged, which is a finding."""
    if not path.exists():
        return (), ()
    try:
        return read_schema(path), ()
    except StorageError as error:
        return (), (Finding.warning(str(path), f"{error.problem}: it is rebuilt from the journal"),)


def lacks_runs(plan: RunTable, rows: RunTableRows) -> bool:
    """Return whether a table lacks runs of a plan."""
    return any(rows.place_of(run.run_id) is None for run in plan)


@dataclass(slots=True)
class RecoveredTable:
    """The run table of an experiment, as far as it has come.

    Attributes:
        rows: the table, kept up to date.
        attempts: how often each run was tried.
        failed: why each failed run failed.
        unfinished: the runs whose attempts have no recorded end, each with the slot that has its files.
        findings: what looked odd in the file.
        is_on_disk: whether the file holds all this, and has a schema, so that neither need be written.
        deviations: what was changed by hand since the last execution.
        amended: the ends of the attempts whose measures were changed, as they count from now on.
        accepted_plan: the digest of a plan from which the table differs, as the user has accepted now; else empty.
        done_before: the runs that were done before the first execution; None where this is not the first one.
        former: the columns of the file that hold a measure of earlier executions, for which there is none any more.
    """

    experiment: Experiment
    rows: RunTableRows
    attempts: Counter[str] = field(default_factory=Counter)
    failed: dict[str, str] = field(default_factory=dict)
    unfinished: dict[str, int] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    is_on_disk: bool = False
    deviations: tuple[Deviation, ...] = ()
    amended: Sequence[Mapping[str, Any]] = ()
    accepted_plan: str = ""
    done_before: list[str] | None = None
    former: tuple[ColumnDescription, ...] = ()
    origins: defaultdict[str, set[str]] = field(default_factory=lambda: defaultdict(set))
    _kinds: set[tuple[str, Any]] = field(default_factory=set)
    doubts: defaultdict[str, set[str]] = field(default_factory=lambda: defaultdict(set))
    reasons: defaultdict[str, dict[str, tuple[str, ...]]] = field(default_factory=lambda: defaultdict(dict))

    def take_column(self, column: ColumnDescription, attempted: Container[str]) -> None:
        """Take the schema's facts on the values of a column, except for runs that were attempted since."""
        self.origins[column.name].update(column.origin.split(", ") if column.origin else ())
        self.reasons[column.name].update((run, why) for run, why in column.doubts.items() if run not in attempted)
        self.doubts[column.owner].update(column.findings)

    def take_outcome(self, run_id: str, outcome: RunOutcome) -> bool:
        """Update the row of a run after its attempt; return whether a type or origin is new, which the schema lacks."""
        self.take_record({"run": run_id, **outcome.fields()})
        for finding in outcome.findings:
            self.doubts[finding.where.partition(", ")[2]].add(f"{run_id}: {finding.problem}")
        measures = outcome.measures.values()
        kinds: set[tuple[str, Any]] = {(each.name, type(each.value)) for each in measures if each.value is not None}
        kinds |= {(each.name, each.origin) for each in measures}
        has_new = not kinds <= self._kinds
        self._kinds |= kinds
        return has_new

    def take_record(self, record: Mapping[str, Any]) -> None:
        """Update the row of a run by the journal's record of an attempt's end."""
        self.take_circumstances(record)
        self.rows.take_end(record)

    def take_circumstances(self, record: Mapping[str, Any]) -> None:
        """Remember the sources of an attempt's measures, and the doubts about them, by the journal."""
        for name, measure in record["measures"].items():
            self.origins[name].add(measure["origin"])
        for by_run in self.reasons.values():
            by_run.pop(record["run"], None)  # of an earlier attempt
        for name, measure in record["measures"].items():
            if doubts := measure.get("doubts"):
                self.reasons[name][record["run"]] = tuple(doubts)

    def doubt_implausible(self, manifest: Mapping[str, Any], attempted: Iterable[str]) -> None:
        """Remember which values are not plausible of the runs that a user's own table had as done."""
        runs = done_before(manifest, attempted).union(self.done_before or ())
        rows = [(run_id, self.rows.row(place)) for run_id in runs if (place := self.rows.place_of(run_id)) is not None]
        for column in self.experiment.columns.in_table:
            told = ((run_id, column.measure.implausible(row[column.name])) for run_id, row in rows)
            self.reasons[column.name].update({run_id: (why,) for run_id, why in told if why})

    def changed_units(self, schema: Iterable[ColumnDescription], path: Path) -> Iterator[Finding]:
        """Yield an error for each column whose unit differs from that in which its values were taken."""
        now = {column.name: column.measure.unit for column in self.experiment.columns.in_table}
        now |= {factor.name: factor.unit for factor in self.experiment.model.factors}
        for column in schema:
            unit = now.get(column.name, column.unit)
            if column.unit in {"", unit} or all(value is None for value in self.rows.values(column.name)):
                continue
            problem = f"{column.name} is in {column.unit} in the run table, and in {unit or 'no unit'} by the config"
            fix = (
                "Put the unit back, give what is in the other unit another name, or choose another experiment_name. If "
                "only the word was wrong, correct it in this file, too."
            )
            yield Finding.error(str(path), problem, fix)

    def put_back_attempts(self) -> Iterator[str]:
        """Put the files of attempts back that were moved for a next attempt which a kill kept from beginning.

        Yield the runs that have their files again.
        """
        folder = self.experiment.folder
        for run_id in runs_put_away(folder):
            if self.rows.has_ended(run_id) and put_attempt_back(folder, run_id, self.attempts[run_id]):
                yield run_id

    def keep_deviations(self, journal: Journal, manifest: dict[str, Any]) -> None:
        """Record changes by hand, and the ends of attempts as they are then: in the journal, and in the manifest."""
        if self.done_before:
            manifest["design"][DONE_BEFORE] = self.done_before
        if self.accepted_plan:
            manifest["design"][ACCEPTED_PLAN] = self.accepted_plan
        for each in self.deviations:
            fields = {"run": each.run, "column": each.column, "was": each.was, "is": each.is_now}
            journal.append("deviation", flush=True, **fields)
            manifest.setdefault("table_deviations", []).append({"at": utc_now(), **fields})
            if not each.run:
                manifest["design"]["is_reordered"] = True
        for end in self.amended:
            journal.append("attempt_finished", flush=True, **end)

    def write_schema(self, path: Path) -> None:
        """Write the run table's schema as far as it is known."""
        write_schema(path, describe_columns(self.rows, self._known()))

    def _known(self) -> dict[str, ColumnDescription]:
        return {
            column.name: ColumnDescription(
                name=column.name,
                role=ColumnRole.MEASURE,
                description=column.measure.description,
                unit=column.measure.unit,
                owner=column.owner,
                # A few cells that were corrected by hand are told as such: the others were not entered by a person.
                origin=", ".join(sorted(self.origins[column.name] - {_ENTERED} or self.origins[column.name])) or None,
                findings=tuple(sorted(self.doubts[column.owner])),
                doubts=MappingProxyType(dict(self.reasons[column.name])),
            )
            for column in self.experiment.columns.in_table
        } | {column.name: column for column in self.former}


#: The largest share of the time that is spent on writing the table, so that the cost of recording a run does not grow
#: with the number of runs. The journal has every run at once.
_SHARE = 1 / 50
#: While a run or a wait lasts, the table is written at most once in this time, s.
_INTERVAL = 1.0
#: A table that takes more CPU time than this, s (a hundred thousand rows), is not written while a run is executed: that
#: would disturb what is measured on this machine.
_MOST_WORK_IN_RUN = 0.25


class TableOnDisk:
    """The file of the run table, and whether it is behind the rows in memory.

    Writing takes `cost` s at most, until it was measured.
    """

    def __init__(self, path: Path, table: RecoveredTable, journal: Journal, cost: float) -> None:
        self._path = path
        self._table = table
        self._journal = journal
        self._cost = self._work = cost
        self._written = time.monotonic()
        self._is_stale = False

    def refresh(self) -> None:
        """Note that the rows have changed, and write the file unless that was done a moment ago."""
        self._is_stale = True
        if time.monotonic() - self._written > self._cost / _SHARE:
            self.write()

    def tend(self) -> float | None:
        """Write the file if it is stale and due; return in how many seconds it is due, None if there is no need."""
        if not self._is_stale or self._work > _MOST_WORK_IN_RUN:
            return None
        # Only CPU time counts: nothing else waits for the disk meanwhile.
        due = self._written + max(_INTERVAL, self._work / _SHARE) - time.monotonic()
        if due > 0:
            return due
        with suppress(StorageError):  # raised when the run has ended: it must not fail for this
            self.write()
        return None

    def bring_up_to_date(self) -> None:
        """Write the file if it is stale."""
        if self._is_stale:
            self.write()

    def write(self) -> None:
        """Write the file; raise a `StorageError` if it cannot be written."""
        self._journal.stay_in_place()
        started, worked = time.monotonic(), time.process_time()
        digest = write_run_table(self._path, self._table.rows)
        # After the rename: a kill in between only makes the next execution read these runs from the journal again.
        self._journal.append("table_written", sha256=digest)
        self._written = time.monotonic()
        self._cost, self._work = self._written - started, time.process_time() - worked
        self._is_stale = False
