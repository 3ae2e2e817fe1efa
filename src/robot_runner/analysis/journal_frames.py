"""The journal of an experiment as typed data frames."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd

from robot_runner.core.events.manager import ORCHESTRATED_EVENTS, RobotRunnerEvents
from robot_runner.core.storage.journal import read_journal, seconds_of
from robot_runner.core.storage.manifest import host_in_words

#: The events of a run, in their order (paper, Fig. 2).
EVENTS = tuple(event.value for event in RobotRunnerEvents if event.belongs_to_run)

#: The event from which times of a run are counted.
START = RobotRunnerEvents.START_MEASUREMENT.value

#: Events whose callbacks the orchestrator executes, by another clock than the run's.
_OF_ANOTHER_CLOCK = frozenset(event.value for event in ORCHESTRATED_EVENTS)


#: An attempt: the run's id, and the number of the attempt.
Attempt = tuple[str, int]


@dataclass(frozen=True, slots=True)
class History:
    """The journal's records, sorted by subject.

    Attributes:
        attempts: `run_id`, `attempt`, `status` (done, failed, unfinished), `started_at`, `seconds`, `failure`, in the
            order of their beginnings; `attrs["clock_was_set"]` says whether the clock was set, or differs from that of
            another machine, so that times may not tell this order; `attrs["clock_set_by"]` has by how many seconds, in
            all, before each attempt, by number, by run, and `attrs["clock_set_in"]` by how many in it;
            `attrs["workers"]` names the worker of a cluster, another machine, that executed each run last, by run;
            `attrs["machines"]` says in words what its machine is, as far as that is known.
        events: `run_id`, `event`, `at`, `clock_s`, `since_start_s`; of the last attempt at each run.
        published: `run_id`, `measure`, `value`, `owner`, `origin`; of the last attempt at each run.
        doubts: reasons why values are doubtful or missing, by measure, by run; of the last ended attempt at each run.
            Measures without any are left out.
        odd: `run_id`, `attempt`, `owner`, `problem`, `fix`.
        windows: beginning and end of each run's measured window (its mission), s on the run's clock.
        starts: the beginning of that window or, where it is not known, of the run's measurement.
        uncertainties: how far the times of a plugin's samples may be off because another computer stamped them, s; by
            plugin, by run, of the last attempt at each.
        readers: the plugins that read each factor's treatment in runs that were done; None where it was not recorded.
    """

    attempts: pd.DataFrame
    events: pd.DataFrame
    published: pd.DataFrame
    odd: pd.DataFrame
    windows: Mapping[str, tuple[float, float]]
    starts: Mapping[str, float]
    doubts: Mapping[str, Mapping[str, tuple[str, ...]]]
    uncertainties: Mapping[str, Mapping[str, float]]
    readers: Mapping[str, tuple[str, ...]] | None = None

    def without(self, runs: Collection[str]) -> History:
        """Return the history without these runs."""
        if not runs:
            return self
        frames = {
            name: frame[~frame["run_id"].isin(runs)].reset_index(drop=True)
            for name in ("attempts", "events", "published", "odd")
            for frame in [getattr(self, name)]
        }
        by_run = {name: self.attempts.attrs[name].items() for name in ("workers", "machines")}
        kept = {name: {run: each for run, each in told if run not in runs} for name, told in by_run.items()}
        frames["attempts"].attrs = {**self.attempts.attrs, **kept}
        return replace(self, **frames)


def moments(stamps: Sequence[str | None] | pd.Series) -> pd.Series:
    """Return time stamps as moments in UTC, to the microsecond also where there is none; NaT for what is no stamp."""
    parsed = pd.to_datetime(pd.Series(stamps, dtype="object"), utc=True, errors="coerce", format="ISO8601")
    return parsed.dt.as_unit("us")


def read_history(journal: Path) -> History:
    """Read the journal of an experiment; the history is empty where there is none.

    Raises:
        StorageError: the journal cannot be read.
    """
    reader = _JournalReader()
    takers: dict[str, Callable[[Mapping[str, Any]], None]] = {
        "attempt_started": reader.take_start,
        "attempt_finished": reader.take_end,
        "clock": reader.take_clock,
        "clock_set": reader.take_clock_set,
        "event": reader.take_event,
        "finding": reader.odd.append,
        "imported": reader.take_import,
        "machine": reader.take_machine,
        "window": reader.take_window,
    }
    for record in read_journal(journal, kinds=takers):
        takers[record["kind"]](record)
    return reader.history()


def journal_phases(journal: Path) -> dict[str, list[tuple[str, float, float]]]:
    """Return the phases of the last attempt at each run: name, beginning and end, s on the run's clock.

    They are read separately: a long journal has many of them, and few callers need them.

    Raises:
        StorageError: the journal cannot be read.
    """
    phases: dict[str, list[tuple[str, float, float]]] = {}
    for record in read_journal(journal, kinds=("attempt_started", "phase")):
        if record["kind"] == "attempt_started":
            phases[record["run"]] = []
        else:
            told = record["name"], float(record["start"]), float(record["end"])
            phases.setdefault(record["run"], []).append(told)
    return phases


#: Smaller steps of the clock, s, such as an NTP daemon's, hardly change the times between runs.
_STEP = 1.0
_CENTURY = 100 * 365.25 * 86_400.0  # s


def _is_after(stamp: str, other: str) -> bool:
    """Return whether a stamp is later than another by more than `_STEP`; they have one format, as texts compare."""
    return stamp > other and seconds_of(stamp) - seconds_of(other) > _STEP


def _by_run(seconds: Mapping[Attempt, float]) -> dict[str, dict[int, float]]:
    found: dict[str, dict[int, float]] = defaultdict(dict)
    for (run, attempt), each in seconds.items():
        if each:
            found[run][attempt] = each
    return dict(found)


class _JournalReader:
    """The records read so far; only the needed parts of each, or a long journal would fill the memory."""

    def __init__(self) -> None:
        # After the table was edited, attempts may be numbered from 1 again: the later record of a number counts.
        self.begun: dict[Attempt, str] = {}
        self.ends: dict[Attempt, tuple[str, float | None, str | None]] = {}
        self.measures: dict[Attempt, list[tuple[str, Any, str, str]]] = {}
        self.doubts: dict[Attempt, dict[str, tuple[str, ...]]] = {}
        self.events: dict[Attempt, list[tuple[str, str, float | None]]] = defaultdict(list)
        self.windows: dict[Attempt, tuple[float, float]] = {}
        self.uncertainties: dict[Attempt, dict[str, float]] = defaultdict(dict)
        self.workers: dict[str, str] = {}
        self.machines: dict[str, str] = {}
        self._machine_at: dict[str, str] = {}
        self.readers: dict[str, dict[str, None]] | None = {}
        self.is_any_done = False
        self.odd: list[Mapping[str, Any]] = []
        self.is_imported = False
        #: Attempts of which no time is known: the stamps of their records are those of the import.
        self.untimed: set[Attempt] = set()
        self.was_set = False
        self.set_by = 0.0
        self.begun_after: dict[Attempt, float] = {}
        self.set_in: dict[Attempt, float] = {}
        self._latest_events: dict[Attempt, str] = {}
        self._latest = ""
        self._known: dict[Any, Any] = {}

    def _interned(self, text: Any) -> Any:
        """Return the first equal text, so that names, which are in every record, are in memory once."""
        return self._known.setdefault(text, text)

    def _attempt(self, record: Mapping[str, Any]) -> Attempt:
        return self._interned(record["run"]), record["attempt"]

    def take_import(self, _record: Mapping[str, Any]) -> None:
        self.is_imported = True

    def take_start(self, record: Mapping[str, Any]) -> None:
        attempt = self._attempt(record)
        self.begun.pop(attempt, None)
        self.begun[attempt] = record["at"]
        self.begun_after[attempt] = self.set_by
        self.workers.pop(attempt[0], None)
        self.machines.pop(attempt[0], None)
        if record.get("slot") == 0:
            place = self.workers[attempt[0]] = self._interned(str(record.get("place")))
            if place in self._machine_at:
                self.machines[attempt[0]] = self._machine_at[place]
        self._look_at_clock(record["at"])

    def take_machine(self, record: Mapping[str, Any]) -> None:
        """Take the machine of a place, which is told with the first run there."""
        self._machine_at[record["place"]] = self.machines[record["run"]] = self._interned(host_in_words(record["host"]))

    def take_end(self, record: Mapping[str, Any]) -> None:
        attempt, measures = self._attempt(record), record["measures"]
        self.ends[attempt] = self._interned(record["status"]), record["seconds"], record["failure"]
        if self.is_imported and not record.get("stamps"):
            self.untimed.add(attempt)
        self._look_at_clock(record["at"])
        self.set_in.setdefault(attempt, self.set_by - self.begun_after.get(attempt, self.set_by))
        self.was_set |= _is_after(self._latest_events.pop(attempt, ""), record["at"])
        # Where an attempt has two ends, the later one has what was published after the run.
        self.measures[attempt] = [
            (self._interned(name), each["value"], self._interned(each["owner"]), self._interned(each["origin"]))
            for name, each in measures.items()
        ]
        self.doubts[attempt] = {
            self._interned(name): tuple(doubts) for name, each in measures.items() if (doubts := each.get("doubts"))
        }
        if record["status"] == "done":
            self._take_readers(record.get("readers"))

    def _look_at_clock(self, at: str) -> None:
        """Note whether the orchestrator's stamps go backwards; they have one format, so texts compare like times."""
        self.was_set |= at < self._latest
        self._latest = at

    def take_clock_set(self, record: Mapping[str, Any]) -> None:
        if abs(record["seconds"]) < _CENTURY:  # more is a damaged record, and beyond what pandas can hold
            self.set_by += record["seconds"]
        self.was_set |= abs(record["seconds"]) > _STEP

    def _take_readers(self, told: object) -> None:
        self.is_any_done = True
        if not isinstance(told, dict) or self.readers is None:
            self.readers = None
            return
        for factor, owners in told.items():
            self.readers.setdefault(factor, {}).update(dict.fromkeys(owners))

    def take_event(self, record: Mapping[str, Any]) -> None:
        if "run" in record:
            # The orchestrator stamps these by another clock than the run's.
            clock = None if record["event"] in _OF_ANOTHER_CLOCK else record.get("clock")
            attempt, at = self._attempt(record), record["at"]
            self.events[attempt].append((self._interned(record["event"]), at, clock))
            self._latest_events[attempt] = at
            # Of an event another machine's clock may tell, of its attempt this one's.
            self.was_set |= _is_after(self.begun.get(attempt, ""), at)

    def take_window(self, record: Mapping[str, Any]) -> None:
        self.windows[self._attempt(record)] = float(record["start"]), float(record["end"])

    def take_clock(self, record: Mapping[str, Any]) -> None:
        if isinstance(record.get("uncertainty"), int | float):
            self.uncertainties[self._attempt(record)][self._interned(record["owner"])] = float(record["uncertainty"])

    def history(self) -> History:
        last = {run: (run, attempt) for run, attempt in self.begun}
        windows = {run: self.windows[each] for run, each in last.items() if each in self.windows}
        starts = {**self._measured(last.values()), **{run: start for run, (start, _) in windows.items()}}
        ended = {run: each for run, each in last.items() if each in self.ends}
        readers = {factor: tuple(owners) for factor, owners in (self.readers or {}).items()}
        return History(
            self._attempts(),
            self._events(last.values(), starts),
            _published((run, *each) for run, attempt in ended.items() for each in self.measures[attempt]),
            _odd(self.odd),
            windows,
            starts,
            {run: self.doubts[attempt] for run, attempt in ended.items()},
            {run: self.uncertainties[each] for run, each in last.items() if each in self.uncertainties},
            readers if self.is_any_done and self.readers is not None else None,
        )

    def _measured(self, attempts: Iterable[Attempt]) -> dict[str, float]:
        """Return when the measurement of each run began, s on the run's clock."""
        return {
            attempt[0]: float(clock)
            for attempt in attempts
            for event, _, clock in self.events.get(attempt, ())
            if event == START and clock is not None
        }

    def _attempts(self) -> pd.DataFrame:
        rows = []
        for (run, attempt), at in self.begun.items():
            status, seconds, failure = self.ends.get((run, attempt), ("unfinished", None, None))
            rows.append((run, attempt, status, None if (run, attempt) in self.untimed else at, seconds, failure))
        columns = ["run_id", "attempt", "status", "started_at", "seconds", "failure"]
        types = {"run_id": "str", "attempt": "int64", "seconds": "float64", "failure": "str"}
        frame = pd.DataFrame(rows, columns=columns).astype(types)
        frame["started_at"] = moments(frame["started_at"])
        statuses = frame["status"].replace("interrupted", "unfinished")
        frame["status"] = pd.Categorical(statuses, ["done", "failed", "unfinished"])
        frame.attrs["clock_was_set"] = self.was_set
        frame.attrs["clock_set_by"] = _by_run(self.begun_after)
        frame.attrs["clock_set_in"] = _by_run(self.set_in)
        frame.attrs["workers"], frame.attrs["machines"] = self.workers, self.machines
        return frame

    def _events(self, attempts: Iterable[Attempt], starts: Mapping[str, float]) -> pd.DataFrame:
        rows = [
            (attempt[0], event, None if attempt in self.untimed else at, clock)
            for attempt in attempts
            for event, at, clock in self.events.get(attempt, ())
        ]
        frame = pd.DataFrame(rows, columns=["run_id", "event", "at", "clock_s"])
        frame = frame.astype({"run_id": "str", "clock_s": "float64"})
        frame["event"] = pd.Categorical(frame["event"], EVENTS, ordered=True)
        frame["at"] = moments(frame["at"])
        frame["since_start_s"] = frame["clock_s"] - frame["run_id"].map(starts).astype("float64")
        return frame


def _published(rows: Iterable[tuple[str, str, Any, str, str]]) -> pd.DataFrame:
    frame = pd.DataFrame(list(rows), columns=["run_id", "measure", "value", "owner", "origin"])
    return frame.astype({"run_id": "str", "value": "object"})


def _odd(findings: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    columns = ["run_id", "attempt", "owner", "problem", "fix"]
    rows = [
        (each.get("run"), each.get("attempt"), each.get("owner"), each["problem"], each.get("fix")) for each in findings
    ]
    return pd.DataFrame(rows, columns=columns).astype(dict.fromkeys(columns, "str") | {"attempt": "Int64"})
