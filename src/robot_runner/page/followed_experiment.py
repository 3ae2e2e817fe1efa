"""One experiment, followed from its folder: the content of its page as plain data, updated at each look."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from robot_runner.core.config.operator_steps import Question
from robot_runner.core.entry_points import named_entry_point
from robot_runner.core.errors import RobotRunnerError, StorageError
from robot_runner.core.execution.experiment_history import ExperimentHistory
from robot_runner.core.execution.experiment_status import ExperimentStatus, read_status, status_of
from robot_runner.core.secret_names import without_environment_secrets
from robot_runner.core.storage.guarded_files import open_to_read
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.lock import holder_of, is_requested
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.words import harmless
from robot_runner.page.followed_table import FollowedTable, JournalTail, MeansSoFar
from robot_runner.page.sampled_curves import RunCurves

_log = logging.getLogger(__name__)

#: Up to so many changed rows are sent; where more change at once, pages fetch those that they show.
_MOST_ROWS = 50
_MOST_FINDINGS, _LONGEST_TEXT = 200, 1000
#: How much of the end of a run's log is shown, bytes.
_LOG_BYTES = 16_000
#: Logs and samples are sent of so many runs in flight; a page shows those of one, which its viewer chooses.
_MOST_FOLLOWED = 8
#: Kinds of records after which the run table is read again.
_NEW_TABLES = frozenset({"experiment_started", "extended", "repeated", "decided", "deviation"})


class FollowedExperiment:
    """The state of an experiment, updated by `look`; thread-safe.

    Args:
        folder: the experiment's; it need not exist yet.

    Attributes:
        table: its run table.
        robot: how the robot is reached, if pictures of it can be made; None otherwise.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._lock = threading.Lock()
        self._begin_anew()

    def _begin_anew(self) -> None:
        self._files = ExperimentFolder.found_at(self.folder)
        self._tail = JournalTail(self._files.journal)
        self._history = ExperimentHistory()
        self.table = FollowedTable()
        self._means = MeansSoFar(self.table)
        self._status: ExperimentStatus | None = None
        self._error: RobotRunnerError | None = None
        self._doing: dict[str, dict[str, Any]] = {}
        #: The slot of each run in flight, where its log is.
        self._slots: dict[str, int] = {}
        self._curves: dict[str, RunCurves] = {}
        self._signs: tuple[Any, ...] = ()
        self._table_is_due, self._has_caught_up = True, False
        self._refused_table = (0, 0)
        self._since_table: dict[str, Mapping[str, Any]] = {}
        self.robot: str | None = None
        self._left_out: set[int] = set()

    @property
    def is_behind(self) -> bool:
        """Whether there is more to read at once."""
        return self._tail.is_behind

    def look(self) -> dict[str, Any]:
        """Read what is new on disk; return the parts of the page that may have changed, by name."""
        with self._lock:
            try:
                return self._look()
            except RobotRunnerError as error:
                self._error = error
            except Exception:  # noqa: BLE001 - whatever a folder does to us, those who look are told, and others are served
                _log.exception("%s cannot be followed.", self.folder)
                self._error = StorageError("this experiment cannot be shown", fix="Ask robot-runner status.")
            return {"state": self._state()}

    def rows(self, start: int, count: int, *, status: str = "", text: str = "") -> dict[str, Any]:
        """Return some rows of the table, of all or of those that match `status` and `text`, and how many match."""
        with self._lock:
            if status or text:
                found = list(self.table.found(status, text))
                places = found[start : start + count]
                total = len(found)
            else:
                total = len(self.table)
                places = list(range(max(0, start), min(total, start + count)))
            return {"start": start, "total": total, "rows": [self.table.row(place) for place in places]}

    def status(self) -> ExperimentStatus | None:
        """Return its status at the last look; None before the first one."""
        return self._status

    def _look(self) -> dict[str, Any]:
        records = self._tail.read()
        if self._tail.has_begun_anew:
            self._begin_anew()
            records = self._tail.read()
        if self._status is not None and not self.folder.exists():
            self._signs = ()  # so that its return is noticed
            raise StorageError("the experiment's folder is no longer there", fix="Was it moved, renamed or removed?")
        parts: dict[str, Any] = {}
        if self._table_is_due:
            parts |= self._read_table()
        for record in records:
            self._take(record)
        if self._table_is_due:
            parts |= self._read_table()
        signs = (holder_of(self._files.lock), is_requested(self._files.pause), self._tail.damaged)
        if not self._tail.is_behind and not self._has_caught_up:
            self._history.read_table(self._files)
            self._has_caught_up = True
            self._signs = ()
            if self._since_table or "table" not in parts:  # the file was older than the end of the journal
                parts |= self._read_table()
        if (records and not self._tail.is_behind) or signs != self._signs or parts:
            self._signs = signs
            self._tell(parts)
        if self._tail.is_behind and not self._has_caught_up:
            parts["state"] = self._state()
        parts |= self._of_runs_in_flight()
        return parts

    def _read_table(self) -> dict[str, Any]:
        """Read the run table, once it is there."""
        self._files = ExperimentFolder.found_at(self.folder)
        sign = self._files.run_table.stat() if self._files.run_table.is_file() else None
        if sign is None or (sign.st_size, sign.st_mtime_ns) == self._refused_table:
            return {}
        self._refused_table = (sign.st_size, sign.st_mtime_ns)  # an unreadable table is read again only if it changes
        rows = self.table.read(self._files)
        if rows is None:
            return {"table": self._columns()}
        self._table_is_due, self._refused_table = False, (0, 0)
        for record in self._since_table.values():
            self.table.end(record)
        if self._has_caught_up:
            self._history.take_rows(rows)
        self._means.begin_anew(self._files)
        self._left_out = set()
        return {"table": self._columns()}

    def _take(self, record: Mapping[str, Any]) -> None:
        self._history.take(record)
        kind = record["kind"]
        self._take_doing(kind, record)
        if kind == "attempt_finished":
            self._since_table[record["run"]] = record
            self.table.doubt(record)
        elif kind == "table_written":
            self._since_table.clear()
        if not self._has_caught_up:
            return
        self._history.settle()
        if kind == "attempt_started":
            self.table.begin(record["run"])
        elif kind == "attempt_finished":
            self.table.end(record)
        self._table_is_due |= kind in _NEW_TABLES

    def _take_doing(self, kind: str, record: Mapping[str, Any]) -> None:
        """Keep what a run in flight is doing, which the status does not have."""
        run = record.get("run")
        if kind == "experiment_started":
            self._doing.clear()
        elif kind == "attempt_started":
            left = record.get("left")
            expected = left.get("run") if isinstance(left, dict) else None
            self._doing[record["run"]] = {"since": record["at"], "attempt": record["attempt"], "expected": expected}
            if (earlier := self._curves.get(record["run"])) is not None:  # its files are written anew
                self._curves[record["run"]] = RunCurves(self._files, record["run"], earlier.version + 1)
            self._slots[record["run"]] = record.get("slot", 1)
        elif kind == "clock_set":  # a run has gone on for as long all the same
            for each in self._doing.values():
                each["since"] = _shifted(each["since"], record["seconds"])
        elif kind == "attempt_finished":
            self._doing.pop(record["run"], None)
            self._slots.pop(record["run"], None)
        elif kind == "shared" and run in self._doing and isinstance(values := record.get("values"), dict):
            told = {name: values[name] for name in ("phase", "phase_number", "phase_count") if name in values}
            self._doing[run] |= {name: each for name, each in told.items() if isinstance(each, str | int)}

    def _tell(self, parts: dict[str, Any]) -> None:
        """Add the parts that depend on the journal."""
        self._error = None
        if self._has_caught_up and self._files.manifest.exists():
            self._status = status_of(self._files, self._history)
            self.robot = self.robot or _pictured(read_manifest(self._files.manifest).get("robot"))
        elif self._has_caught_up and self._files.run_table.exists():
            self._status = read_status(self.folder)
        self._mark_in_flight()
        parts["state"] = self._state()
        parts["findings"] = self._findings()
        changed, self.table.changed = self.table.changed, set()
        before, self._left_out = self._left_out, self._excluded()
        self._means.forget(changed | (before ^ self._left_out))
        if changed and "table" not in parts:
            told = sorted(changed)[:_MOST_ROWS]
            parts["rows"] = {"rows": [self.table.row(place) for place in told], "is_all": len(changed) <= _MOST_ROWS}
        if changed or "table" in parts or before != self._left_out:
            parts["means"] = self._means.told(self._left_out)

    def _mark_in_flight(self) -> None:
        """Update the rows of runs in flight; without a process that executes them, they are to do again."""
        if self._status is None:
            return
        for each in self._status.in_flight:
            self.table.begin(each.run)
        if self._status.holder is None:
            for run in self._doing:
                self.table.leave(run)
            self._doing.clear()

    def _excluded(self) -> set[int]:
        out = self._status.excluded if self._status else ()
        return {place for run in out if (place := self.table.place(run)) is not None}

    def _columns(self) -> dict[str, Any]:
        measures = [{"name": name, "unit": self.table.units.get(name, "")} for name in self.table.measures]
        is_too_large = self.table.is_too_large(self._files)
        note = "The run table is too large for this page: see run_table.csv." if is_too_large else ""
        return {"total": len(self.table), "factors": list(self.table.factors), "measures": measures, "note": note}

    def snapshot(self) -> dict[str, Any]:
        """Return all parts of the page, for a new viewer."""
        with self._lock:
            parts: dict[str, Any] = {"state": self._state(), "table": self._columns(), "findings": self._findings()}
            # A viewer who comes again may have seen a run in flight that has ended meanwhile.
            parts |= {"means": self._means.told(self._excluded()), "samples": {"runs": {}}}
            return parts | self._of_runs_in_flight()

    def _state(self) -> dict[str, Any]:
        status = self._status
        if self._error is not None or status is None:
            return {
                "name": self.folder.name,
                "word": "unreadable" if self._error else self._word(),
                "problem": self._problem(),
                "read": None if self._has_caught_up else round(self._tail.share, 2),
            }
        waiting = status.waiting_for
        return {
            "name": status.experiment_name[:_LONGEST_TEXT],
            "word": self._word(),
            "counts": {name: getattr(status, name) for name in ("run_count", "done", "failed", "todo", "warm_ups")},
            "excluded": len(status.excluded),
            "left": self.seconds_left,
            "left_of_others": left.others if (left := self._history.left) is not None else None,
            "left_is_least": status.left_is_least,
            "told_at": time.time(),
            "in_flight": [self._flying(each) for each in status.in_flight],
            "waiting": self._waiting(waiting) if waiting is not None and status.holder else None,
            "gates": [{name: each[name] for name in ("run", "condition", "seen")} for each in status.gates],
            "pause_is_requested": status.pause_is_requested,
            "host": status.holder.host if status.holder else None,
            "started_at": status.started_at,
            "finished_at": status.finished_at,
            "precision": [*status.precision, *filter(None, [status.decided])],
            "order": status.order,
            "damaged": self._tail.damaged,
            "has_pictures": self.robot is not None,
            "has_report": (self._files.report / "report.html").is_file(),
            "problem": None,
        }

    @property
    def seconds_left(self) -> float | None:
        """How long it takes from now, s; that of the status is of the time of the last record."""
        if self._status is None:
            return None
        left = self._history.left if self._status.holder is not None else None
        return self._status.seconds_left if left is None else left.after(self._history.since_left)

    def _problem(self) -> dict[str, str] | None:
        if self._error is None:
            return None
        first = self._error.findings[0]
        return {"problem": first.problem, "fix": first.fix}

    def _word(self) -> str:
        """Return the state of the experiment in one word."""
        status = self._status
        if status is None:
            return "reading" if self._tail.is_behind or self._files.journal.exists() else "not begun"
        if status.is_imported or status.is_of_older_tool:
            return "imported" if status.is_imported else "of another tool"
        if status.holder is not None:
            if status.is_waiting_for_user:
                return "waiting"
            return "paused" if status.is_paused else "running"
        if status.todo:
            return "stopped"
        return "failed" if status.failed else "done"

    def _flying(self, each: Any) -> dict[str, Any]:
        return {
            "run": each.run,
            "place": each.place,
            "event": each.event,
            "treatments": self.table.combination(each.run),
            **self._doing.get(each.run, {}),
        }

    def _waiting(self, waiting: Mapping[str, Any]) -> dict[str, Any]:
        questions = [Question.from_mapping(facts) for facts in waiting["questions"]]
        return {
            "run": waiting["next_run"],
            "place": waiting["place"],
            "step": waiting["step"],
            "is_after": waiting["is_after"],
            "treatments": self.table.combination(waiting["next_run"]),
            "questions": [each.as_mapping() | {"hint": each.hint} for each in questions],
        }

    def _findings(self) -> dict[str, Any]:
        if self._status is None:
            return {"total": 0, "last": [], "failures": []}
        told = [
            {name: harmless(getattr(each, name)[:_LONGEST_TEXT]) for name in ("where", "problem", "fix")}
            for each in [*self._status.findings][-_MOST_FINDINGS:]
        ]
        failures = [harmless(each[:_LONGEST_TEXT]) for each in self._status.failures[-_MOST_FINDINGS:]]
        return {"total": len(self._status.findings), "last": told, "failures": failures}

    def _of_runs_in_flight(self) -> dict[str, Any]:
        """Return the ends of the logs of the runs in flight, and the version of each one's samples."""
        runs = [each.run for each in self._status.in_flight][:_MOST_FOLLOWED] if self._status else []
        was_followed = bool(self._curves)
        self._curves = {run: self._curves.get(run) or RunCurves(self._files, run) for run in runs}
        for curves in self._curves.values():
            curves.look()
        if not runs:  # the samples of the last one are complete now
            return {"samples": {"runs": {}}} if was_followed else {}
        return {
            "samples": {"runs": {run: each.version for run, each in self._curves.items()}},
            "log": {"runs": {run: self._log(run) for run in runs}},
        }

    def curves(self, run_id: str) -> list[dict[str, Any]]:
        """Return the curves of a run; those of a run that is not in flight are read now."""
        with self._lock:
            if run_id in self._curves:
                return self._curves[run_id].told()
        if self.table.place(run_id) is None:
            return []
        curves = RunCurves(self._files, run_id)
        while curves.look():
            pass
        return curves.told()

    def pose(self, run_id: str) -> tuple[float, float, float] | None:
        """Return the last known pose of the robot in a run (m, m, rad), or None."""
        poses = (each.get("pose") for each in self.curves(run_id))
        return next((pose for pose in poses if pose is not None), None)

    def _log(self, run_id: str) -> str:
        try:
            with open_to_read(self._files.at_slot(self._slots.get(run_id, 1)).current_log) as file:
                size = file.seek(0, 2)
                file.seek(max(0, size - _LOG_BYTES))
                text = file.read(_LOG_BYTES).decode("utf-8", "replace")
        except (StorageError, OSError):
            return ""
        lines = text.splitlines()[1 if size > _LOG_BYTES else 0 :]
        # The output of programs is masked only when the run has ended.
        return harmless(without_environment_secrets("\n".join(lines)))


def _pictured(robot: object) -> str | None:
    """Return how the robot is reached, if pictures of it can be made."""
    return robot if isinstance(robot, str) and named_entry_point("pictures", robot) is not None else None


def _shifted(stamp: str, seconds: float) -> str:
    """Return a time stamp as it would be if the clock had been set before; as it is, beyond what a stamp can show."""
    with suppress(OverflowError):
        moment = datetime.fromisoformat(stamp) + timedelta(seconds=seconds)
        return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")
    return stamp
