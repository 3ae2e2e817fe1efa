"""Runs by the journal: which were executed, in which order, excluded and why, or changed by hand since."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from robot_runner.core.design.columns import EXCLUDED, REPETITION, RUN_ID, STATUS
from robot_runner.core.errors import Finding
from robot_runner.core.storage.cells import RunStatus, is_same_number, measure_text, number_of
from robot_runner.core.storage.guarded_files import sha256_of
from robot_runner.core.storage.journal import read_journal
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.run_table_rows import RunTableRows
from robot_runner.core.storage.table_columns import ColumnDescription, TableLayout
from robot_runner.core.words import counted, listed


def done_runs(journal: Path) -> set[str]:
    """Return the ids of the runs whose last attempt was done; raise a `StorageError` if the journal cannot be read."""
    return {run_id for run_id, status in _last_ends(journal).items() if status == "done"}


def ended_runs(journal: Path) -> set[str]:
    """Return the ids of the runs whose last attempt came to an end, well or not; none where there is no journal.

    Raises:
        StorageError: the journal cannot be read.
    """
    return {run_id for run_id, status in _last_ends(journal).items() if status != "interrupted"}


def _last_ends(journal: Path) -> dict[str, str]:
    return {record["run"]: record["status"] for record in read_journal(journal, kinds={"attempt_finished"})}


#: In the manifest's design: the runs that were done before the first execution, in a table of the user's own.
DONE_BEFORE = "done_before"
#: The digest of a plan from which the run table differs, as the user has accepted.
ACCEPTED_PLAN = "accepted_plan"
#: The fix for a reader of results, who does not execute the experiment.
_RESTORE_JOURNAL = "Restore journal.jsonl from a backup, or have it synchronised; the rows stay as they are."
_MOST_NAMED = 8


def unrecorded_runs(done: Iterable[str], ended: Container[str], manifest: Mapping[str, Any]) -> list[str]:
    """Return the runs that are done by the run table and have no end in the journal, which is older, or missing.

    Runs that a user's own table had as done, which the manifest lists, are left out.
    """
    design = manifest.get("design") or {}
    if design.get("source") != "config" and DONE_BEFORE not in design:
        return []  # a user's own table, of an earlier version that did not list them
    declared = {each["run"] for each in manifest.get("table_deviations") or () if each["column"] == STATUS}
    known = declared.union(design.get(DONE_BEFORE) or ())
    return [run_id for run_id in done if run_id not in ended and run_id not in known]


def done_before(manifest: Mapping[str, Any], executed: Iterable[str]) -> set[str]:
    """Return the runs that a table had as done before the first execution, less those that were executed since."""
    return set((manifest.get("design") or {}).get(DONE_BEFORE) or ()).difference(executed)


def unrecorded_in_words(runs: Sequence[str], journal: Path) -> str:
    """Return a problem: the journal lacks the end of runs that are done, and what is lost with it."""
    is_are, them, their = ("is", "it", "its") if len(runs) == 1 else ("are", "them", "their")
    older = f"it is older than the table, or {their} status was written by hand"
    return (
        f"{counted(len(runs), 'run')} {is_are} done in the run table, and the journal has no end of {them} "
        f"({listed(runs, _MOST_NAMED)}): {older if journal.exists() else 'it is missing'}; origin and doubts of "
        f"{their} values, attempts, events and findings are lost with it"
    )


def unrecorded_findings(
    journal: Path, done: Iterable[str], ended: Container[str], manifest: Mapping[str, Any]
) -> Iterator[Finding]:
    """Yield a warning if there are `unrecorded_runs`."""
    if found := unrecorded_runs(done, ended, manifest):
        yield Finding.warning(str(journal), unrecorded_in_words(found, journal), _RESTORE_JOURNAL)


def executed_order(journal: Path) -> list[str]:
    """Return the ids of the runs that were begun, in the order of their last attempts.

    Warm-up runs are left out: they come before each session, whatever the table's order.

    Raises:
        StorageError: the journal cannot be read.
    """
    last: dict[str, None] = {}
    for record in read_journal(journal, kinds={"attempt_started"}):
        if record.get("repetition") != 0:
            last.pop(record["run"], None)
            last[record["run"]] = None
    return list(last)


def moved_runs(table: Sequence[str], executed: Sequence[str]) -> tuple[str, ...]:
    """Return the smallest set of runs that were moved to turn the order of the table into the executed one.

    Example:
        >>> moved_runs(["r_1", "r_2", "r_3", "r_4"], ["r_3", "r_1", "r_2"])
        ('r_3',)
    """
    place_of = {run_id: place for place, run_id in enumerate(table)}
    places = [place_of[run_id] for run_id in executed if run_id in place_of]
    # All but a longest increasing subsequence (patience sorting: Aldous and Diaconis 1999, section 2).
    tops: list[int] = []
    depth: list[int] = []
    for place in places:
        pile = bisect_left(tops, place)
        tops[pile : pile + 1] = [place]
        depth.append(pile)
    stayed: set[int] = set()
    wanted = len(tops) - 1
    for place, pile in zip(reversed(places), reversed(depth), strict=True):
        if pile == wanted:
            stayed.add(place)
            wanted -= 1
    return tuple(table[place] for place in places if place not in stayed)


def moved_in_words(moved: Sequence[str], executed: Sequence[str]) -> str:
    """Return in words how many runs were executed out of the table's order; empty where none was.

    Example:
        >>> moved_in_words(["r_3"], ["r_3", "r_1", "r_2"])
        '1 of the 3 runs that were executed came out of this order: r_3'
    """
    if not moved:
        return ""
    runs = counted(len(executed), "run")
    return f"{len(moved):,} of the {runs} that were executed came out of this order: {listed(moved)}"


#: The kinds of records that `ExcludedRuns.take` uses.
EXCLUSION_KINDS = frozenset({"excluded", "included", "deviation"})


@dataclass(frozen=True, slots=True)
class ExcludedRun:
    """A run that is excluded, since `at` (UTC)."""

    run_id: str
    reason: str
    at: str


@dataclass(slots=True)
class ExcludedRuns:
    """The excluded runs by the journal.

    Attributes:
        present: those that are excluded now, by id.
        were_any: whether any run was ever excluded: then the run table has a column for it.

    Example:
        >>> runs = ExcludedRuns()
        >>> runs.take({"kind": "excluded", "at": "2026-01-31T12:00:00.250Z", "run": "r_7", "reason": "door was open"})
        >>> runs.present["r_7"].reason, runs.were_any
        ('door was open', True)
    """

    present: dict[str, ExcludedRun] = field(default_factory=dict)
    were_any: bool = False

    @classmethod
    def read(cls, journal: Path) -> ExcludedRuns:
        """Read a journal, which need not exist; raise a `StorageError` if it cannot be read."""
        runs = cls()
        for record in read_journal(journal, kinds=EXCLUSION_KINDS):
            runs.take(record)
        return runs

    def take(self, record: Mapping[str, Any]) -> None:
        """Take a record of the journal into account, the oldest first; kinds not in `EXCLUSION_KINDS` are ignored."""
        match record["kind"]:
            case "excluded":
                self._set(record["run"], str(record["reason"]), record["at"])
            case "included":
                self.present.pop(record["run"], None)
            case "deviation" if record["column"] == EXCLUDED:  # by hand, and the file was chosen to count
                self._set(record["run"], str(record["is"]), record["at"])

    def reason(self, run_id: str) -> str | None:
        """Return why a run is excluded; None where it is not."""
        found = self.present.get(run_id)
        return found.reason if found else None

    def _set(self, run_id: str, reason: str, at: str) -> None:
        self.were_any = True
        if reason:
            self.present[run_id] = ExcludedRun(run_id, reason, at)
        else:
            self.present.pop(run_id, None)


_SETTLE = "Execute the config again: nothing is executed that is done, and each change is settled, on record."


def edited_findings(journal: Path, table: Path, rows: RunTableRows) -> Iterator[Finding]:
    """Yield a warning where treatments or measures of done runs differ from the journal and its recorded changes.

    Raises:
        StorageError: the journal cannot be read.
    """
    written = ""
    for record in read_journal(journal, kinds={"table_written"}):
        written = record.get("sha256", "")
    if sha256_of(table) == written:
        return  # nearly always, without reading more of the journal
    known: dict[str, dict[str, str]] = {}
    for record in read_journal(journal, kinds={"attempt_started", "attempt_finished", "deviation"}):
        match record["kind"]:
            case "attempt_started":
                known[record["run"]] = dict(record.get("combination") or {})
                if "repetition" in record:
                    known[record["run"]][REPETITION] = str(record["repetition"])
            case "attempt_finished":
                values = {name: each["value"] for name, each in record["measures"].items()}
                told = {name: measure_text(values.get(name)) for name in rows.layout.measures}
                known.setdefault(record["run"], {}).update(told)
            case _:
                known.setdefault(record["run"], {})[record["column"]] = record["is"]
    names = rows.layout.factor_names
    executed = {name: {cells[name] for cells in known.values() if name in cells} for name in names}
    numbers = {name: Counter(map(number_of, texts)) for name, texts in executed.items()}
    found = [cell for place in range(len(rows)) for cell in _edited(rows, place, known, numbers)]
    if found:
        problem = f"cells of runs that were executed were changed by hand: {listed(found, _MOST_NAMED)}"
        yield Finding.warning(str(table), problem, _SETTLE)


#: The `column` of a deviation that is a removed row, of which nothing is there now, or an added one, of which nothing
#: was there and a status is now, unlike with a factor of that name.
ROW = "row"
_STATUSES = {status.value for status in RunStatus}


def change_in_words(deviation: Mapping[str, Any]) -> str:
    """Return what was changed by hand in the row of a run, by a record of the journal or of the manifest.

    Example:
        >>> change_in_words({"run": "r_1", "column": "Energy", "was": "11", "is": "12"})
        "Energy was changed by hand from '11' to '12'"
    """
    if (happened := _happened_to_row(deviation)) is not None:
        return f"its row was {happened} by hand"
    return f"{deviation['column']} was changed by hand from {deviation['was']!r} to {deviation['is']!r}"


def changes_in_words(manifest: Mapping[str, Any], shown: int = _MOST_NAMED) -> str:
    """Return the cells of runs that were changed by hand and accepted, with old and new values; empty without any."""
    cells = [
        f"the row of {each['run']}, which was {happened}"
        if (happened := _happened_to_row(each)) is not None
        else f"{each['column']} of {each['run']} from {each['was']!r} to {each['is']!r}"
        for each in manifest.get("table_deviations") or ()
        if each["run"]
    ]
    return f"cells were changed by hand in run_table.csv: {listed(cells, shown)}" if cells else ""


def _happened_to_row(deviation: Mapping[str, Any]) -> str | None:
    if deviation["column"] != ROW or (deviation["is"] and (deviation["was"] or deviation["is"] not in _STATUSES)):
        return None
    return "added" if deviation["is"] else "removed"


def _edited(
    rows: RunTableRows, place: int, known: Mapping[str, Mapping[str, str]], numbers: Mapping[str, Counter[Any]]
) -> Iterator[str]:
    run_id = rows.run_id(place)
    if rows.status(place) is not RunStatus.DONE or run_id not in known:
        return
    row = rows.row(place)
    for name in (*numbers, REPETITION, *rows.layout.measures):
        if name not in known[run_id] or name not in row:
            continue
        text, cell = known[run_id][name], row[name]
        if text in {measure_text(cell), str(cell)}:
            continue
        if name in numbers:  # it may have other digits (`10.0` for 10), unless another treatment is the same number
            number = number_of(str(cell), decimal_comma=True)
            is_alike = number is not None and number == number_of(text) and numbers[name][number] == 1
        else:
            is_alike = is_same_number(number_of(text), cell)
        if not is_alike:
            is_measure = name in rows.layout.measures  # of which an empty cell is no value; a treatment may be None
            is_now = "empty" if is_measure and cell is None else repr(str(cell))
            was = "empty" if is_measure and not text else repr(text)
            yield f"{name} of {run_id} is {is_now}, and was {was}"


# The run table, with what the journal has beyond its file.


def recorded_rows(folder: ExperimentFolder, columns: Sequence[ColumnDescription]) -> tuple[RunTableRows, set[str]]:
    """Read the run table, with the runs that have ended since the file was written; a kill leaves it so.

    `columns` are of its schema. Return the rows, and the runs whose last attempt came to an end by the journal.

    Raises:
        StorageError: there is no run table, or it or the journal cannot be read.
    """
    # Read the journal first: a table that is written meanwhile is newer than its records, never older.
    ended: set[str] = set()
    newer: dict[str, dict[str, Any]] = {}
    excluded = ExcludedRuns()
    for record in read_journal(folder.journal, kinds={"attempt_finished", "table_written", *EXCLUSION_KINDS}):
        excluded.take(record)
        if record["kind"] == "table_written":
            newer.clear()
        elif record["kind"] == "attempt_finished":
            newer[record["run"]] = record
            (ended.discard if record["status"] == "interrupted" else ended.add)(record["run"])
    layout = TableLayout.of_schema(columns)
    if excluded.were_any:
        layout = replace(layout, has_exclusions=True)
    rows = read_run_table(folder.run_table, layout)
    for record in newer.values():
        if rows.place_of(record["run"]) is not None:
            rows.take_end(record)
    if folder.journal.exists():  # it decides; the next session settles a cell that was edited by hand
        for run_id in rows.values(RUN_ID) if rows.layout.has_exclusions else ():
            rows.exclude(run_id, excluded.reason(run_id))
    return rows, ended
