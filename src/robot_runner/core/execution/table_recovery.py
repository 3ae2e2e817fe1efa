"""Reading the run table of a resumed experiment: the journal is the truth, and the file is compared with it.

The journal is flushed at the end of each run; the file is written now and then, and people, spreadsheets and sync
clients change it. A file that has the SHA-256 of the last writing, by the journal, is read, and runs that ended since
are added. Any other file is compared with the journal, run by run.
"""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from robot_runner.core.config.experiment import Experiment
from robot_runner.core.design.columns import EXCLUDED, STATUS
from robot_runner.core.design.factor import texts_of
from robot_runner.core.design.run_table_model import RunTable
from robot_runner.core.errors import Finding, Severity, StorageError
from robot_runner.core.execution.recovered_table import (
    ATTEMPT_FINISHED,
    IS_AMENDED,
    Deviation,
    RecoveredTable,
    TableHistory,
    lacks_runs,
    run_of,
    schema_of,
    with_later_batches,
)
from robot_runner.core.execution.resumption import (
    Resumption,
    TableChoice,
    TableDisagreementError,
    plan_digest,
    refuse_differences,
    table_differences,
)
from robot_runner.core.execution.table_deviations import (
    ORDER,
    amended_ends,
    cell_deviations,
    changed_exclusions,
    deviation_findings,
    is_reordered,
    planned_otherwise,
    treatment_deviations,
    unfit_values,
    with_changes,
)
from robot_runner.core.storage.cells import RunStatus, measure_text
from robot_runner.core.storage.executed_runs import ACCEPTED_PLAN, ROW, unrecorded_in_words, unrecorded_runs
from robot_runner.core.storage.guarded_files import (
    MissingFileError,
    open_to_read,
    open_to_write,
    read_blocks,
    sha256_of,
)
from robot_runner.core.storage.journal import journal_lines, parsed_record, read_journal
from robot_runner.core.storage.layout import next_in
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.run_table_rows import RunTableRows
from robot_runner.core.storage.table_columns import TableLayout, former_measures
from robot_runner.core.words import counted

_CHOOSE = (
    "Let what was executed count (--table journal), or let the file count (--table file): each change is recorded."
)
_REBUILD = "Restore it from a backup, or rebuild it from the plan and the journal: --table journal."
_BEGINS_ANEW = "the journal and the run table are missing: all runs are executed again"
_KEPT_ATTEMPTS = "Restore both from a backup to go on instead. What runs had left is put into earlier_attempts/."
_SETTLE_JOURNAL = (
    "Restore journal.jsonl from a backup, or have it synchronised. Or go on without: let the rows count as they are "
    "(--table file), which is recorded, or have these runs executed again (--table journal)."
)


def recover_table(experiment: Experiment, manifest: Mapping[str, Any], resumption: Resumption) -> RecoveredTable:
    """Return the run table: newly planned, or as it is on disk, corrected by the journal.

    Raises:
        StorageError: the table or the journal cannot be read; all problems are listed.
        ExecutionError: the file differs from the plan, or from the journal; the cells are listed.
    """
    return _Recovery(experiment, manifest, resumption).recovered()


class _Recovery:
    def __init__(self, experiment: Experiment, manifest: Mapping[str, Any], resumption: Resumption) -> None:
        folder = experiment.folder
        self._experiment = experiment
        self._choice = resumption.chosen_table
        self._accepts_changes = resumption.accept_changes
        self._is_by_hand = manifest["design"]["source"] != "config"
        self._path = folder.run_table
        self._journal = folder.journal
        self._manifest = manifest
        self._is_first = len(manifest["executions"]) == 1 and "restored_at" not in manifest
        self._plan: RunTable = experiment.model.plan(manifest["seed"])
        self._schema, self._schema_findings = schema_of(folder.schema)
        self._history = TableHistory.of(folder.journal)
        layout: TableLayout = experiment.table_layout(
            {each.name: each.type for each in self._schema} or None, warms_up=bool(manifest["design"].get("warm_up"))
        )
        self._former = former_measures(self._schema, layout)
        counts = not self._is_by_hand and manifest["design"]["repetitions"] > 1  # the config may repeat nothing by now
        names = tuple(column.name for column in self._former)
        layout = replace(layout, has_repetition=layout.has_repetition or counts, former_measures=names)
        self._layout = replace(layout, has_exclusions=self._history.excluded.were_any)
        self._is_known_to_be_reordered = bool(manifest["design"].get("is_reordered"))

    def recovered(self) -> RecoveredTable:
        history, is_empty = self._history, not self._path.exists() or is_blank(self._path)
        if is_empty and history.has_ends:
            table = self._rebuilt(f"the run table is {'empty' if self._path.exists() else 'missing'}")
        elif is_empty:
            table = RecoveredTable(self._experiment, RunTableRows.of_plan(self._plan, self._layout))
            self._leave_out(table)
            if not self._is_first and not self._journal.exists():
                table.findings = (Finding.warning(str(self._journal), _BEGINS_ANEW, _KEPT_ATTEMPTS),)
        else:
            table = self._read()
        table.former = self._former
        attempted = set(history.attempted)
        for column in self._schema:
            table.take_column(column, attempted)
        table.doubt_implausible(self._manifest, attempted)
        for line in history.doubtful.values():
            table.take_circumstances(parsed_record(self._journal, line))
        for owner, doubts in history.doubts.items():
            table.doubts[owner] |= doubts
        if not self._schema and history.has_ends:
            self._take_what_the_schema_had(table)
        table.findings = (*self._schema_findings, *table.findings)
        self._add_newer(table)
        self._settle(table)
        for end in table.amended:
            table.take_circumstances(end)
        refuse_differences(table.changed_units(self._schema, self._experiment.folder.schema))
        return table

    def _read(self) -> RecoveredTable:
        try:
            rows = read_run_table(self._path, self._layout, self._plan)
        except StorageError as error:
            if not self._history.has_ends or self._choice is TableChoice.FILE:
                raise
            if self._choice is TableChoice.JOURNAL:
                return self._rebuilt("the run table could not be read")
            findings = [*error.findings, Finding.error(str(self._path), "runs of the table were executed", _REBUILD)]
            raise TableDisagreementError.of_findings(findings) from error
        rows, added = with_later_batches(self._path, self._plan, rows)
        unrecorded = self._unrecorded(rows)  # first: an older journal lacks later batches, and so does the plan
        if not self._is_by_hand and self._choice is TableChoice.JOURNAL and (why := self._unlike_plan(rows)):
            return self._rebuilt(f"the run table {why}")
        is_on_disk = rows.has_file and bool(self._schema) and not added
        table = RecoveredTable(self._experiment, rows, findings=(*rows.warnings, *added), is_on_disk=is_on_disk)
        by_hand: tuple[Deviation, ...] = ()
        if not self._is_by_hand and self._choice is not TableChoice.JOURNAL:
            table.accepted_plan, by_hand = self._accepted(rows)
        if self._history.has_ends and sha256_of(self._path) != self._history.written:
            self._reconcile(table)
        else:
            self._leave_out(table)
        table.deviations += by_hand
        table.done_before = rows.done_runs if self._is_first else None
        if unrecorded:
            self._settle_unrecorded(table, unrecorded)
        return self._with_order(table)

    def _accepted(self, rows: RunTableRows) -> tuple[str, tuple[Deviation, ...]]:
        """Return what the user accepts now: the digest of a plan from which the table differs, and edited cells.

        Raises:
            ExecutionError: the table differs from the plan, and that is not accepted.
        """
        if next(table_differences(self._path, self._plan, rows), None) is None:  # as nearly always
            return "", ()
        plan, is_ours = plan_digest(self._plan), self._history.written == sha256_of(self._path)
        if self._accepts_changes or (self._choice is TableChoice.FILE and not is_ours):
            return plan, () if is_ours else tuple(planned_otherwise(self._plan, rows, *self._last_ends()))
        if not is_ours or plan != self._manifest["design"].get(ACCEPTED_PLAN):
            done, changes = {*rows.done_runs}, read_journal(self._journal, kinds={"deviation"})  # see `_reconcile`
            accepted = {(each["run"], each["column"], each["is"]) for each in changes if each["run"] in done}
            accepted |= {(*cell, is_now) for cell, is_now in self._last_ends()[1].items()}
            refuse_differences(table_differences(self._path, self._plan, rows, accepted, is_as_written=is_ours))
        return "", ()

    def _unlike_plan(self, rows: RunTableRows) -> str:
        """Return in words how runs of the file differ from the plan and nobody has accepted it; empty where none do."""
        if lacks_runs(self._plan, rows):
            return "lacked runs that are planned"
        if self._history.written == sha256_of(self._path):
            return ""
        return "had other runs than are planned" * any(planned_otherwise(self._plan, rows, *self._last_ends()))

    def _unrecorded(self, rows: RunTableRows) -> list[str]:
        """Return the runs that are done by the table and have no end in the journal, which is older, or missing.

        Raises:
            ExecutionError: there are some, and the user has not chosen what counts.
        """
        found = [] if self._is_first else unrecorded_runs(rows.done_runs, self._history.ended, self._manifest)
        if found and self._choice is None:
            told = unrecorded_in_words(found, self._journal)
            raise TableDisagreementError(told, where=str(self._journal), fix=_SETTLE_JOURNAL)
        return found

    def _settle_unrecorded(self, table: RecoveredTable, found: list[str]) -> None:
        told = unrecorded_in_words(found, self._journal)
        if self._choice is TableChoice.FILE:
            table.deviations += tuple(Deviation(run, STATUS, "", RunStatus.DONE.value) for run in found)
            table.findings += (Finding.warning(str(self._journal), told),)
            return
        self._put_aside()
        for run_id in found:
            if table.rows.place_of(run_id) is not None:  # a table that was made anew may lack it
                table.rows.clear(run_id)
        table.is_on_disk = False
        again = f"{told}; {'it is' if len(found) == 1 else 'they are'} to do again"
        table.findings += (Finding.warning(str(self._journal), again, self._kept_fix()),)

    def _reconcile(self, table: RecoveredTable) -> None:
        """Compare each executed run with its row, and correct table or record as was chosen.

        Raises:
            ExecutionError: they differ, and the user has not chosen what counts.
        """
        ends, earlier = self._last_ends()
        newer = self._history.begun.union(run_of(self._journal, line) for line in self._history.newer)
        found: list[Deviation] = []
        for run_id, line in ends.items():
            if run_id in newer and not table.rows.has_ended(run_id):
                continue  # it ended after the file was written, or is to be done again: `_add_newer`, `_settle`
            found += cell_deviations(table.rows, parsed_record(self._journal, line), earlier)
        treatments = list(self._changed_treatments(table.rows, earlier))
        found += [*treatments, *changed_exclusions(table.rows, self._history.excluded)]
        table.is_on_disk = False  # it is written again, so that the next execution need not compare it
        if not found:
            return
        if self._choice is None:
            refuse_differences(deviation_findings(self._path, found, Severity.ERROR, _CHOOSE), TableDisagreementError)
        if self._choice is TableChoice.FILE:
            refuse_differences(unfit_values(self._path, table.rows, found))
            runs = dict.fromkeys(each.run for each in found)
            last = [parsed_record(self._journal, ends[run_id]) for run_id in runs if run_id in ends]
            table.amended, followed = amended_ends(table.rows, self._experiment.columns, last, found)
            table.deviations = (*found, *followed)
            table.findings = (*table.findings, *deviation_findings(self._path, found, Severity.WARNING))
        elif treatments or any(each.column == ROW for each in found):
            had = "had other treatments than" if treatments else "lacked runs that"
            rebuilt = self._rebuilt(f"the run table {had} were executed")
            table.rows, table.findings = rebuilt.rows, rebuilt.findings
        else:
            self._put_aside()
            for run_id in {each.run: None for each in found if each.column != EXCLUDED}:
                table.take_record(parsed_record(self._journal, ends[run_id]))
            self._leave_out(table)
            cells = f"{counted(len(found), 'cell')} of the run table"
            problem = f"{cells} {'was' if len(found) == 1 else 'were'} put back to what the journal has"
            table.findings = (*table.findings, Finding.warning(str(self._path), problem, self._kept_fix()))

    def _changed_treatments(self, rows: RunTableRows, changed: Mapping[tuple[str, str], str]) -> Iterator[Deviation]:
        begun = journal_lines(self._journal, kinds={"attempt_started"})
        last = {run_of(self._journal, line): line for line in begun}
        for line in last.values():
            record = parsed_record(self._journal, line)
            yield from treatment_deviations(rows, record, self._experiment.model.defaults, changed)

    def _rebuilt(self, reason: str) -> RecoveredTable:
        """Return the table made anew from the plan and the journal.

        Raises:
            ExecutionError: the plan is not what was executed, as the table was written or changed by hand.
        """
        if self._path.exists():
            self._put_aside()
        ends, changed = self._last_ends()
        rows = RunTableRows.of_plan(self._plan, self._layout)
        table = RecoveredTable(self._experiment, rows)
        refuse_differences(self._unplanned(rows))
        for line in (line for run_id, line in ends.items() if run_id not in self._history.begun):
            table.take_record(parsed_record(self._journal, line))
        by_hand = ""
        if self._choice is not TableChoice.JOURNAL:
            kept = {cell: text for cell, text in changed.items() if cell[0] not in self._history.begun}
            table.rows, by_hand = with_changes(self._path, rows, self._plan, kept)
        self._leave_out(table)
        done = table.rows.count(RunStatus.DONE)
        problem = f"{reason}: rebuilt from the plan and the journal, with {counted(done, 'run')} done{by_hand}"
        table.findings = (Finding.warning(str(self._path), problem, self._kept_fix()),)
        return table

    def _leave_out(self, table: RecoveredTable) -> None:
        """Exclude the runs that are excluded by the journal, and no others."""
        for each in tuple(changed_exclusions(table.rows, self._history.excluded)):
            table.rows.exclude(each.run, each.was or None)
            table.is_on_disk = False

    def _unplanned(self, rows: RunTableRows) -> Iterator[Finding]:
        """Yield an error for each run that was executed with other treatments than the plan has for it."""
        fix = "Restore the run table from a backup: it was written or changed by hand, and the plan does not have that."
        for line in journal_lines(self._journal, kinds={"attempt_started"}):
            record = parsed_record(self._journal, line)
            place = rows.place_of(record["run"])
            where = f"{self._path}, run {record['run']}"
            executed = record.get("combination")
            if executed is not None and self._experiment.model.defaults:  # it may be older than a factor
                executed = {**texts_of(self._experiment.model.defaults), **executed}
            if place is None:
                yield Finding.error(where, "the run was executed, and the plan has no such run", fix)
            elif executed is not None and executed != texts_of(rows.combination(place)):
                problem = f"the run was executed with {executed}, the plan has {texts_of(rows.combination(place))}"
                yield Finding.error(where, problem, fix)
            elif executed is None and self._is_by_hand:
                yield Finding.error(where, "the run was executed from a table that was written by hand", fix)

    def _last_ends(self) -> tuple[dict[str, bytes], dict[tuple[str, str], str]]:
        """Return the journal line of each run's last end, and each later change by hand: text by run and column."""
        ends: dict[str, bytes] = {}
        changed: dict[tuple[str, str], str] = {}
        for line in journal_lines(self._journal, kinds={"attempt_finished", "deviation"}):
            if line.startswith(ATTEMPT_FINISHED):
                run_id = run_of(self._journal, line)
                ends[run_id] = line
                cells = [cell for cell in changed if cell[0] == run_id] if changed else ()
                later = parsed_record(self._journal, line)["measures"] if cells and IS_AMENDED in line else None
                for cell in cells:  # of an amended end those that were published anew
                    if later is None or (cell[1] in later and measure_text(later[cell[1]]["value"]) != changed[cell]):
                        del changed[cell]
            else:
                record = parsed_record(self._journal, line)
                changed[record["run"], record["column"]] = record["is"]
        return ends, changed

    def _take_what_the_schema_had(self, table: RecoveredTable) -> None:
        ends, _ = self._last_ends()
        for line in ends.values():
            table.take_circumstances(parsed_record(self._journal, line))
        table.is_on_disk = False

    def _add_newer(self, table: RecoveredTable) -> None:
        last_ends = {run_of(self._journal, line): line for line in self._history.newer}
        for run_id, line in last_ends.items():
            is_there = table.rows.place_of(run_id) is not None
            if is_there and not (table.deviations and table.rows.has_ended(run_id)):
                table.take_record(parsed_record(self._journal, line))
        table.is_on_disk &= not last_ends and not table.rows.count(RunStatus.RUNNING)

    def _settle(self, table: RecoveredTable) -> None:
        """Clear the rows of runs whose end was not recorded, and list failed ones with their reason."""
        history, rows = self._history, table.rows
        for run_id in history.begun.difference(each.run for each in table.deviations):
            place = rows.place_of(run_id)
            if place is not None and rows.status(place) is not RunStatus.TODO:
                rows.clear(run_id)
                table.is_on_disk = False
        table.attempts = Counter(history.attempted)
        table.unfinished = {
            run_id: int(parsed_record(self._journal, line).get("slot", 1)) for run_id, line in history.open.items()
        }
        reasons = {
            run_of(self._journal, line): parsed_record(self._journal, line)["failure"] or "" for line in history.failed
        }
        for place in range(len(rows)) if rows.count(RunStatus.RUNNING) or rows.count(RunStatus.FAILED) else ():
            run_id = rows.run_id(place)
            if rows.status(place) is RunStatus.RUNNING:
                rows.clear(run_id)
            elif rows.status(place) is RunStatus.FAILED:
                table.failed[run_id] = reasons.get(run_id, "")

    def _with_order(self, table: RecoveredTable) -> RecoveredTable:
        """Note where the rows of a planned table were put into another order."""
        if self._is_by_hand or self._is_known_to_be_reordered or not is_reordered(self._plan, table.rows):
            return table
        table.deviations = (*table.deviations, Deviation("", ORDER, "as planned", "changed by hand"))
        problem = "the rows of the run table were put into another order: runs are executed and reported in that order"
        table.findings = (*table.findings, Finding.warning(str(self._path), problem))
        return table

    def _put_aside(self) -> None:
        root = self._experiment.folder.root
        self._aside = next_in(self._experiment.folder.earlier_tables, root).with_suffix(".csv")
        with open_to_read(self._path) as table, open_to_write(self._aside, root) as kept:
            shutil.copyfileobj(table, kept)

    def _kept_fix(self) -> str:
        aside = getattr(self, "_aside", None)
        return f"What the file held is kept as {aside.parent.name}/{aside.name}." if aside is not None else ""


def is_blank(path: Path) -> bool:
    """Return whether a file exists and has nothing but white space."""
    try:
        return not any(block.strip() for block in read_blocks(path))
    except MissingFileError:
        return False
