"""The progress of an experiment, gathered from its journal record by record, and from its run table."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from types import MappingProxyType
from typing import Any

from robot_runner.core.config.treatment_makers import PREPARED
from robot_runner.core.design.batch import CONFIRMATION
from robot_runner.core.design.batches import EXTENDED
from robot_runner.core.errors import Finding
from robot_runner.core.events.measure import OPERATOR_OWNER, Quality, quality_of_value
from robot_runner.core.execution.durations import TimeLeft
from robot_runner.core.execution.places import InFlight
from robot_runner.core.execution.step_history import StepHistory
from robot_runner.core.storage.cells import ENDS, RunStatus
from robot_runner.core.storage.executed_runs import EXCLUSION_KINDS, ExcludedRuns, change_in_words
from robot_runner.core.storage.journal import read_journal, seconds_of
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.run_table_reading import read_described_table
from robot_runner.core.storage.run_table_rows import RunTableRows

#: Kinds of records that are written between sessions: they do not extend the session before them.
_BETWEEN_SESSIONS = EXCLUSION_KINDS | {EXTENDED, PREPARED}
#: Events of the orchestrator whose callbacks end the session where they raise.
_ENDING_SESSIONS = frozenset({"before_experiment", "continue", "after_experiment"})


def _is_by_hand(record: Mapping[str, Any]) -> bool:
    """Return whether a record ends an attempt once more as its measures were changed by hand, before a session."""
    return bool(record.get("is_amended")) and "left" not in record


@dataclass(frozen=True, slots=True)
class Session:
    """One execution of the experiment, from its start to its end.

    Attributes:
        started_at: UTC.
        ended_at: when it ended, or, where it was killed or goes on, when something was last recorded of it (UTC).
        is_whole: whether it came to its end.
        clock_set: by how much the clock was set meanwhile, s.
    """

    started_at: str
    ended_at: str
    is_whole: bool = False
    selection: Mapping[str, Sequence[str]] = field(default_factory=lambda: MappingProxyType({}))
    clock_set: float = 0.0

    @property
    def seconds(self) -> float:
        """How long it took, in seconds."""
        return max(0.0, (_moment(self.ended_at) - _moment(self.started_at)).total_seconds() - self.clock_set)


def _moment(stamp: str) -> datetime:
    return datetime.fromisoformat(stamp).astimezone(UTC)


class ExperimentHistory:
    """The progress by the journal and the run table: read at once (`read`), or followed while the experiment goes on.

    To follow it, give each record to `take`, call `read_table` once the journal was read, and `settle` after each later
    record. `experiment_status.status_of` makes an `ExperimentStatus` of it.
    """

    def __init__(self) -> None:
        self.statuses: dict[str, RunStatus] = {}
        self.failures: dict[str, str] = {}
        self.findings: list[Finding] = []
        #: What is asked of a person: before a run (None), and in runs by run and step, as several may ask at once.
        self._waits: dict[tuple[str, str] | None, dict[str, Any]] = {}
        self.warm_ups: set[str] = set()
        self.precision: tuple[str, ...] = ()
        self.decided = ""
        #: Whether results decided last that no runs follow.
        self.is_decided = False
        self.is_paused = False
        self.sessions: list[Session] = []
        self._begun: dict[str, None] = {}
        #: Also of runs that the table does not have.
        self.exclusions = ExcludedRuns()
        #: The gates that are awaited, by run: several places may wait at the same time.
        self.gates: dict[str, dict[str, Any]] = {}
        self.gate_seconds = 0.0
        self._in_flight: dict[str, InFlight] = {}
        #: Of the last session alone.
        self._of_session: list[Finding] = []
        self._steps = StepHistory()
        #: The process of the last session; None where its record is of an older version, or there is none.
        self.pid: int | None = None
        self.started_at: str | None = None
        self.finished_at: str | None = None
        self.combinations: dict[str, Mapping[str, Any]] = {}
        self.left: TimeLeft | None = None
        self._left_at = ""
        self._set_since_left = 0.0
        self._since_table: dict[str, RunStatus] = {}
        self._ends: dict[str, RunStatus] = {}
        self._planned = 0
        #: How many runs were never begun and are listed nowhere, as the run table is missing.
        self.unlisted = 0
        #: Whether neither a table nor the journal tells which runs are planned.
        self.lacks_plan = False
        self._measures: Collection[str] = ()
        #: Those that a person is asked for, which have values in some runs only.
        self._asked_for: Collection[str] = ()
        self._qualities: dict[str, dict[str, Quality]] = {}
        #: What was published in each run; runs that published the same share one tuple, as there may be a million.
        self._published: dict[str, tuple[str, ...]] = {}
        self._publications: dict[tuple[str, ...], tuple[str, ...]] = {}

    def read(self, files: ExperimentFolder) -> None:
        """Read all that is on disk; raise a `StorageError` if it cannot be read."""
        # The journal comes first: a table written meanwhile is newer than what the journal adds to it, never older.
        for record in read_journal(files.journal):
            self.take(record)
        self.read_table(files)

    def take(self, record: Mapping[str, Any]) -> None:
        """Take a record of the journal into account, the oldest first."""
        is_between = record["kind"] in _BETWEEN_SESSIONS or _is_by_hand(record)
        if self.sessions and not self.sessions[-1].is_whole and not is_between:
            self.sessions[-1] = replace(self.sessions[-1], ended_at=record.get("at", self.sessions[-1].ended_at))
        self.exclusions.take(record)
        take = getattr(self, f"_take_{record['kind']}", None)
        if take is not None:
            take(record)

    def settle(self) -> None:
        """Update the statuses by the journal's records since the run table was written."""
        self.statuses |= self._since_table

    def read_table(self, files: ExperimentFolder) -> None:
        """Read the run table, and add the journal's records since it was written.

        Raises:
            StorageError: it cannot be read.
        """
        if files.run_table.exists() and files.schema.exists():
            self.take_rows(read_described_table(files))
            return
        known = self._ends | self._since_table
        self.statuses = {run: known[run] for run in (*self._begun, *known) if run in known}
        self.unlisted = max(0, self._planned - len(self.statuses))
        self.lacks_plan = not self.sessions
        if self._ends:
            missing = files.schema if files.run_table.exists() else files.run_table
            what = "schema of the run table" if files.run_table.exists() else "run table"
            problem = f"the {what} is missing; the journal has what was executed"
            fix = "The next execution of the experiment makes it again."
            self.findings.append(Finding.warning(str(missing), problem, fix))

    def take_rows(self, rows: RunTableRows) -> None:
        """Take the rows of the run table into account, and the journal's records since it was written."""
        layout = rows.layout
        self._measures = layout.measures
        self._asked_for = {name for name, owner in layout.owners.items() if owner == OPERATOR_OWNER}
        self.statuses = {rows.run_id(place): rows.status(place) for place in range(len(rows))}
        self.warm_ups |= {run.run_id for run in rows.planned if run.is_warm_up}
        self.combinations = {run.run_id: run.combination for run in rows.planned}
        if not layout.spelling.tells_apart(RunStatus.TODO, RunStatus.FAILED):
            todo = {run for run, status in self.statuses.items() if status is RunStatus.TODO}
            failed = {run for run, end in self._ends.items() if end is RunStatus.FAILED}
            self.statuses |= dict.fromkeys(todo & failed, RunStatus.FAILED)
        self.settle()

    @property
    def waiting_for(self) -> dict[str, Any] | None:
        """The oldest question to a person; None where there is none."""
        return next(iter(self._waits.values()), None)

    @property
    def since_left(self) -> float:
        """How long ago the time left was estimated, s."""
        return max(0.0, time.time() - seconds_of(self._left_at) - self._set_since_left)

    @property
    def in_flight(self) -> tuple[InFlight, ...]:
        """The runs that are being executed, in the order in which they began."""
        return tuple(self._in_flight.values())

    @property
    def executed(self) -> list[str]:
        """The runs that have begun, in the order in which they did."""
        return list(self._begun)

    @property
    def ended(self) -> set[str]:
        """The runs whose last attempt came to an end by the journal, well or not."""
        return {run for run, end in self._ends.items() if end is not RunStatus.TODO}

    @property
    def left_after(self) -> list[Finding]:
        """The operator's steps that are still to be done after runs that have ended."""
        return [each for each in self._steps.left_after if each.where not in self.exclusions.present]

    @property
    def excluded(self) -> dict[str, str]:
        """Why runs of the table are left out, by id."""
        return {run: each.reason for run, each in self.exclusions.present.items() if run in self.statuses}

    @property
    def settled(self) -> set[str]:
        """The runs that are not executed any more: they are done, or left out."""
        done = {run for run, status in self.statuses.items() if status is RunStatus.DONE}
        return done | self.exclusions.present.keys()

    @property
    def bad_values(self) -> dict[str, dict[str, list[str]]]:
        """The runs that are done whose values are not good, by measure and quality."""
        bad: dict[str, dict[str, list[str]]] = {}
        wanted = [name for name in self._measures if name not in self._asked_for]
        unpublished = {
            names: {name: Quality.MISSING for name in wanted if name not in names} for names in self._publications
        }
        for run, qualities in self._qualities.items():
            if self.statuses.get(run) is not RunStatus.DONE:
                continue
            for name, quality in (qualities | unpublished[self._published[run]]).items():
                if name in self._measures:
                    bad.setdefault(name, {}).setdefault(quality.value, []).append(run)
        return bad

    def _take_experiment_started(self, record: Mapping[str, Any]) -> None:
        self.pid = record.get("pid")
        self.started_at = record["at"]
        self.finished_at = None
        self._planned = int(record.get("runs", 0))
        self._steps.after = frozenset(record.get("steps_after", ()))
        self._waits.clear()
        self.gates.clear()
        self.is_paused = False
        self._in_flight.clear()
        self.findings = [each for each in self.findings if each not in self._of_session]
        self._of_session.clear()
        self.sessions.append(Session(record["at"], record["at"], selection=record.get("selection", {})))

    def _take_clock_set(self, record: Mapping[str, Any]) -> None:
        self._set_since_left += record["seconds"]
        if self.sessions:
            clock_set = self.sessions[-1].clock_set + record["seconds"]
            self.sessions[-1] = replace(self.sessions[-1], clock_set=clock_set)

    def _take_experiment_finished(self, record: Mapping[str, Any]) -> None:
        self.finished_at = record["at"]
        if self.sessions:  # else the beginning of the journal was cut off
            self.sessions[-1] = replace(self.sessions[-1], is_whole=True)

    def _take_repeated(self, record: Mapping[str, Any]) -> None:
        self._take_added(record)
        self._take_judged(record)

    _take_decided = _take_repeated

    def _take_added(self, record: Mapping[str, Any]) -> None:
        self._planned += len(record["runs"])
        self._since_table |= {added["run"]: RunStatus.TODO for added in record["runs"]}
        self.warm_ups |= {added["run"] for added in record["runs"] if added["repetition"] == 0}

    def _take_judged(self, record: Mapping[str, Any]) -> None:
        self.precision = tuple(str(each["in_words"]) for each in record.get("precision", ()))
        self.decided = str(record.get("why", ""))
        self.is_decided = not record.get("runs") or record.get("role") == CONFIRMATION

    def _take_extended(self, record: Mapping[str, Any]) -> None:
        self._take_added(record)
        if record.get("role") == CONFIRMATION:
            self._take_judged(record)
        else:
            self.is_decided = False  # it is looked at again once these are done

    def _take_attempt_started(self, record: Mapping[str, Any]) -> None:
        self._in_flight[record["run"]] = InFlight(record["run"], record.get("place", ""))
        self._steps.begin(record["run"])
        self._since_table[record["run"]] = RunStatus.RUNNING  # to do again where it comes to no end, whatever it was
        self._take_left(record)
        if record.get("repetition") != 0:  # a warm-up run comes before each session, whatever the table's order
            self._begun.pop(record["run"], None)
            self._begun[record["run"]] = None

    def _take_event(self, record: Mapping[str, Any]) -> None:
        run = self._in_flight.get(record.get("run", ""))
        if run is not None:
            self._in_flight[run.run] = replace(run, event=record["event"])

    def _take_attempt_finished(self, record: Mapping[str, Any]) -> None:
        # Others are waited for elsewhere.
        self._waits = {by: each for by, each in self._waits.items() if each["next_run"] != record["run"]}
        self._ends[record["run"]] = self._since_table[record["run"]] = ENDS.get(record["status"], RunStatus.TODO)
        self.failures[record["run"]] = record["failure"] or ""
        told = {
            name: quality_of_value(each["value"], each.get("doubts", ())) for name, each in record["measures"].items()
        }
        self._qualities[record["run"]] = {name: each for name, each in told.items() if each is not Quality.GOOD}
        self._published[record["run"]] = self._publications.setdefault(names := tuple(told), names)
        self._in_flight.pop(record["run"], None)
        self._steps.expect_after(record)
        if not _is_by_hand(record):
            self._take_left(record)

    def _take_operator_step(self, record: Mapping[str, Any]) -> None:
        if record.get("is_after"):
            self._steps.end_step(record["run"], record["step"])

    def _take_left(self, record: Mapping[str, Any]) -> None:
        if record.get("status") != "interrupted":  # then the run is to do again, and what was left at its beginning is
            self.left = TimeLeft.of_facts(record.get("left"))
            self._left_at, self._set_since_left = record["at"], 0.0

    def _take_table_written(self, _record: Mapping[str, Any]) -> None:
        self._since_table.clear()

    def _take_deviation(self, record: Mapping[str, Any]) -> None:
        if record["run"]:
            self.findings.append(Finding.warning(record["run"], change_in_words(record)))
        else:
            self.findings.append(Finding.warning("run_table.csv", "the rows were put into another order by hand"))

    def _take_set_aside(self, record: Mapping[str, Any]) -> None:
        self._find_in_session(f"robot {record['place']}", record["problem"])  # in the next one it takes part again

    def _take_failure(self, record: Mapping[str, Any]) -> None:
        if record.get("event") in _ENDING_SESSIONS:  # those of a run are told with it
            self._find_in_session(f"{record['event']} of {record.get('owner')}", str(record.get("problem")))

    def _find_in_session(self, where: str, problem: str) -> None:
        self._of_session.append(Finding.warning(where, problem))
        self.findings.append(self._of_session[-1])

    def _take_finding(self, record: Mapping[str, Any]) -> None:
        where = ", ".join(filter(None, [record.get("run"), record["owner"]]))
        self.findings.append(Finding.warning(where, record["problem"], record["fix"]))

    def _take_gate(self, record: Mapping[str, Any]) -> None:
        if record["state"] == "waiting":
            self.gates[record["run"]] = {name: record[name] for name in ("run", "condition", "seen", "seconds", "at")}
        else:
            self.gates.pop(record["run"], None)
            self.gate_seconds += record["seconds"]

    def _take_waiting(self, record: Mapping[str, Any]) -> None:
        if "next_run" in record:
            self._waits[None] = {
                "next_run": record["next_run"],
                "place": record.get("place", ""),
                "step": record.get("step", ""),
                "is_after": record.get("is_after", False),
                "questions": record.get("questions", ()),
            }

    def _take_asked(self, record: Mapping[str, Any]) -> None:
        run, step = record["run"], record["step"]
        place = self._in_flight[run].place if run in self._in_flight else ""
        self._waits[run, step] = {"next_run": run, "place": place, "step": step, "is_after": False, "questions": ()}

    def _take_answered(self, record: Mapping[str, Any]) -> None:
        self._waits.pop((record["run"], record["step"]), None)

    def _take_continued(self, record: Mapping[str, Any]) -> None:
        if record.get("after") == "pause":
            self.is_paused = False
        else:
            self._waits.pop(None, None)

    def _take_paused(self, _record: Mapping[str, Any]) -> None:
        self.is_paused = True
