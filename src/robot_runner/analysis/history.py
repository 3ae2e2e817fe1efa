"""What the journal tells of an experiment, as data frames: attempts, events, published measures, doubts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import pandas as pd

from robot_runner.events.event import ORCHESTRATED_EVENTS, RobotRunnerEvents
from robot_runner.storage.journal import read_journal

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

__all__ = ["EVENTS", "START", "History", "read_history"]

#: The events of a run, in their order (paper, Fig. 2).
EVENTS = tuple(event.value for event in RobotRunnerEvents if event.belongs_to_run)

#: The event from which times of a run are counted.
START = RobotRunnerEvents.START_MEASUREMENT.value

#: These are heard in the orchestrating process, whose clock is another than the run's.
_OF_ANOTHER_CLOCK = frozenset(event.value for event in ORCHESTRATED_EVENTS)


@dataclass(frozen=True, slots=True)
class History:
    """The journal, sorted by what its records are about.

    Attributes:
        attempts: `run_id`, `attempt`, `status` (done, failed, unfinished), `started_at`, `seconds`, `failure`.
        events: `run_id`, `event`, `at`, `clock_s`, `since_start_s`; of the last attempt at each run.
        published: `run_id`, `measure`, `value`, `owner`, `origin`; of the last attempt at each run.
        odd: `run_id`, `attempt`, `owner`, `problem`, `fix`.
        starts: when each run's measurement began, s on the run's clock.
    """

    attempts: pd.DataFrame
    events: pd.DataFrame
    published: pd.DataFrame
    odd: pd.DataFrame
    starts: Mapping[str, float]


def read_history(journal: Path) -> History:
    """Read the journal of an experiment; one that does not exist tells nothing.

    Raises:
        StorageError: it cannot be read.
    """
    kinds = ("attempt_started", "attempt_finished", "event", "finding")
    records: dict[str, list[dict[str, Any]]] = {kind: [] for kind in kinds}
    for record in read_journal(journal, kinds=kinds):
        records[record["kind"]].append(record)
    attempts = _attempts(records["attempt_started"], records["attempt_finished"])
    last = dict(zip(attempts["run_id"], attempts["attempt"], strict=True))
    of_last = [each for each in records["event"] if "run" in each and each["attempt"] == last.get(each["run"])]
    starts = {each["run"]: float(each["clock"]) for each in of_last if each["event"] == START and "clock" in each}
    return History(
        attempts,
        _events(of_last, starts),
        _published([each for each in records["attempt_finished"] if each["attempt"] == last.get(each["run"])]),
        _odd(records["finding"]),
        starts,
    )


def _attempts(started: Sequence[Mapping[str, Any]], finished: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    # Where the table was edited, attempts may be counted anew: the later record of a number counts.
    ends = {(each["run"], each["attempt"]): each for each in finished}
    begun = {(each["run"], each["attempt"]): each["at"] for each in started}
    rows = [
        {
            "run_id": run,
            "attempt": attempt,
            "status": end["status"] if (end := ends.get((run, attempt))) else "unfinished",
            # Of runs that were imported without any times, only the record has one.
            "started_at": at if end is None or end["seconds"] is not None else None,
            "seconds": end["seconds"] if end else None,
            "failure": end["failure"] if end else None,
        }
        for (run, attempt), at in begun.items()
    ]
    columns = ["run_id", "attempt", "status", "started_at", "seconds", "failure"]
    frame = pd.DataFrame(rows, columns=columns).astype({"run_id": "str", "attempt": "int64", "seconds": "float64"})
    frame["started_at"] = pd.to_datetime(frame["started_at"], utc=True, format="ISO8601")
    frame["status"] = pd.Categorical(frame["status"], ["done", "failed", "unfinished"])
    return frame


def _events(records: Sequence[Mapping[str, Any]], starts: Mapping[str, float]) -> pd.DataFrame:
    rows = [(each["run"], each["event"], each["at"], _clock(each)) for each in records]
    frame = pd.DataFrame(rows, columns=["run_id", "event", "at", "clock_s"])
    frame = frame.astype({"run_id": "str", "clock_s": "float64"})
    frame["event"] = pd.Categorical(frame["event"], EVENTS, ordered=True)
    frame["at"] = pd.to_datetime(frame["at"], utc=True, format="ISO8601")
    frame["since_start_s"] = frame["clock_s"] - frame["run_id"].map(starts).astype("float64")
    return frame


def _clock(record: Mapping[str, Any]) -> float | None:
    return None if record["event"] in _OF_ANOTHER_CLOCK else record.get("clock")


def _published(finished: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    rows = [
        (each["run"], name, measure["value"], measure["owner"], measure["origin"])
        for each in finished
        for name, measure in each["measures"].items()
    ]
    frame = pd.DataFrame(rows, columns=["run_id", "measure", "value", "owner", "origin"])
    return frame.astype({"run_id": "str", "value": "object"})


def _odd(findings: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    columns = ["run_id", "attempt", "owner", "problem", "fix"]
    rows = [
        (each.get("run"), each.get("attempt"), each.get("owner"), each["problem"], each.get("fix")) for each in findings
    ]
    return pd.DataFrame(rows, columns=columns)
