"""The journal's records of one run: attempts, waits, and corrections by people."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from robot_runner.core.events.measure import Origin
from robot_runner.core.storage.executed_runs import EXCLUSION_KINDS, ExcludedRuns, change_in_words
from robot_runner.core.storage.journal import read_journal
from robot_runner.core.storage.manifest import host_in_words
from robot_runner.core.words import shown_commit, shown_duration

#: The record of an execution, which applies to the runs after it.
_OF_EXECUTION = "experiment_started"
#: The record of the machine of a worker of a cluster.
_OF_PLACE = "machine"


@dataclass(slots=True)
class RunHistory:
    """The journal's records of one run.

    Attributes:
        attempt: the number of the last attempt; 0 if there was none.
        started_at, finished_at: of the last attempt (UTC).
        place: where the last attempt was executed; empty if there was only one place.
        is_elsewhere: whether that place is a worker of a cluster.
        machine: in words, what the machine of that worker is; empty where that is not known.
        measures: its published measures: a mapping with `value`, `owner`, `origin` for each.
        clocks: the times of its events, s on the run's clock.
        doubts: findings of the owners of measures about their samples, by owner.
        hosts: other computers that were measured, with the offsets of their clocks.
        failures: how and why attempts ended that failed or were interrupted, by number.
        bound: plugin, parameter, factor and value of each parameter that was bound to a factor.
        readers: the readers of each factor's treatment.
        stopped: who stopped the mission, and why; empty if it was not stopped.
        excluded: whether, when and why the run was excluded.
        corrections: each exclusion and inclusion of the run.
        waits: conditions that were awaited before and in the last attempt, and guards that fired in it.
        waited: the total duration of these waits, s.
        gate_of: the attempt before which a gate was awaited last.
        commit: of the config's repository.
        subjects: software under test, with its command and the file of its output.
        steps: what a person did before and after the run, and noted about it.
        asked: when a person was asked for measures, `before` or `after` the run, by their names.
        programs: the called programs, by caller.
    """

    attempt: int = 0
    started_at: str | None = None
    finished_at: str | None = None
    place: str = ""
    is_elsewhere: bool = False
    machine: str = ""
    measures: dict[str, dict[str, Any]] = field(default_factory=dict)
    clocks: dict[str, float] = field(default_factory=dict)
    doubts: dict[str, list[str]] = field(default_factory=dict)
    hosts: list[str] = field(default_factory=list)
    failures: dict[int, str] = field(default_factory=dict)
    bound: list[tuple[str, str, str, Any]] = field(default_factory=list)
    readers: dict[str, list[str]] | None = None
    stopped: str = ""
    excluded: ExcludedRuns = field(default_factory=ExcludedRuns)
    corrections: list[str] = field(default_factory=list)
    waits: list[tuple[str, str]] = field(default_factory=list)
    waited: float = 0.0
    gate_of: int = 0
    commit: str = ""
    subjects: list[str] = field(default_factory=list)
    steps: list[tuple[str, str]] = field(default_factory=list)
    asked: dict[str, str] = field(default_factory=dict)
    programs: list[tuple[str, str]] = field(default_factory=list)

    @classmethod
    def read(cls, journal: Path, run_id: str) -> Self:
        """Read the records of a run; a missing journal has none.

        Raises:
            StorageError: the journal cannot be read.
        """
        history = cls()
        commit, machines = "", dict[str, str]()
        for record in read_journal(journal, kinds={*_TAKEN_BY, _OF_EXECUTION, _OF_PLACE}):
            if record["kind"] == _OF_EXECUTION:
                commit = shown_commit(record.get("repository"))
            elif record["kind"] == _OF_PLACE:  # told with the first run there
                machines[record["place"]] = host_in_words(record["host"])
            elif record.get("run") == run_id:
                _TAKEN_BY[record["kind"]](history, record)
                history.commit = commit
            # Later records of the run, such as of its exclusion, may come after another machine has joined there.
            if record.get("run") == run_id and record["kind"] in {"attempt_started", _OF_PLACE}:
                history.machine = machines.get(history.place, "") if history.is_elsewhere else ""
        return history

    def _begin(self, record: dict[str, Any]) -> None:
        if self.gate_of != record["attempt"]:  # else the gates before it belong to this attempt
            self.waits, self.waited = [], 0.0
        self.attempt, self.started_at, self.finished_at = int(record["attempt"]), record["at"], None
        self.place, self.is_elsewhere = str(record.get("place") or ""), record.get("slot") == 0
        self.measures, self.clocks, self.doubts, self.hosts = {}, {}, {}, []
        self.bound, self.readers, self.stopped, self.subjects, self.programs = [], None, "", [], []

    def _end(self, record: dict[str, Any]) -> None:
        self.finished_at = self.finished_at or record["at"]  # a later record only adds measures
        self.measures = record["measures"]
        self.readers = record.get("readers")
        if record.get("failure"):
            self.failures[self.attempt] = f"{record['status']}: {record['failure']}"

    def doubts_about(self, owner: str, column: str) -> Sequence[str]:
        """Return what an owner found about the samples of a measure; nothing of a value that a person has entered."""
        is_entered = self.measures.get(column, {}).get("origin") == Origin.ENTERED.value
        return () if is_entered else self.doubts.get(owner, ())

    @property
    def attempts(self) -> list[tuple[str, str]]:
        """The last attempt, and how each failed or was interrupted: a heading and a text each."""
        last = f"{self.attempt}, {self.started_at} to {self.finished_at or 'no end'}"
        failed = [(f"Attempt {number}", failure) for number, failure in self.failures.items()]
        return [("Attempt", last), *failed] if self.attempt else failed

    def _take_event(self, record: dict[str, Any]) -> None:
        if isinstance(record.get("clock"), int | float):
            self.clocks[str(record["event"])] = float(record["clock"])

    def _take_finding(self, record: dict[str, Any]) -> None:
        self.doubts.setdefault(str(record.get("owner")), []).append(str(record["problem"]))

    def _take_stop(self, record: dict[str, Any]) -> None:
        self.stopped = f"stopped by {record.get('owner')}: {record.get('reason')}"

    def _take_step(self, record: dict[str, Any]) -> None:
        notes = "; ".join(f"{name}: {said}" for name, said in record["notes"].items() if said is not None)
        when = "after" if record.get("is_after") else "before"
        self.steps.append((f"Done {when}", f"{record['step']}{f' ({notes})' if notes else ''}"))
        self.asked |= dict.fromkeys(record["answers"], when)

    def _take_subject(self, record: dict[str, Any]) -> None:
        if "command" in record:
            command = " ".join(map(str, record["command"]))
            on = f" on {record['host']}" if record.get("host") else ""
            self.subjects.append(f"{record.get('owner')}{on}: {command} (output in {record.get('output')})")

    def _take_program(self, record: dict[str, Any]) -> None:
        self.programs.append((str(record.get("path")), str(record.get("owner") or "")))

    def _take_bound(self, record: dict[str, Any]) -> None:
        each = record["parameters"].items()
        self.bound += [(record["owner"], name, bound["factor"], bound["value"]) for name, bound in each]

    def _take_clock(self, record: dict[str, Any]) -> None:
        offset = (record.get("before") or record.get("after") or {}).get("wall_offset")
        told = f", its clock {offset:+.6f} s to ours" if isinstance(offset, int | float) else ""
        self.hosts.append(f"{record.get('host')} (measured by {record.get('owner')}{told})")

    def _take_correction(self, record: dict[str, Any]) -> None:
        self.excluded.take(record)
        if record["kind"] == "deviation":
            told = change_in_words(record)
        else:
            told = f"{record['kind']}{f': {reason}' if (reason := record.get('reason')) else ''}"
        self.corrections.append(f"{record['at']}, {told}")

    def _take_wait(self, record: dict[str, Any]) -> None:
        if record["kind"] == "guard":
            self.waits.append(("Guard", f"{record['action']}: {record['problem']}"))
            return
        state = record.get("state") or ("open" if record["holds"] else "timed out")
        if record["kind"] == "gate" and self.gate_of != record["attempt"]:
            self.gate_of, self.waits, self.waited = record["attempt"], [], 0.0
        if state == "waiting":
            return
        self.waited += float(record["seconds"])
        seen = f": {record['seen']}" if record["seen"] else ""
        who = "gate" if record["kind"] == "gate" else f"{record['owner']}"
        how = "" if state == "open" else f", {state}"
        lasted = shown_duration(float(record["seconds"]))
        self.waits.append(("Waited", f"{who}, {lasted} until {record['condition']}{how}{seen}"))


# ruff: noqa: SLF001 - the methods of the class above
_TAKEN_BY: dict[str, Callable[[RunHistory, dict[str, Any]], None]] = {
    "attempt_started": RunHistory._begin,
    "attempt_finished": RunHistory._end,
    "operator_step": RunHistory._take_step,
    "event": RunHistory._take_event,
    **dict.fromkeys(EXCLUSION_KINDS, RunHistory._take_correction),
    "finding": RunHistory._take_finding,
    "mission_stopped": RunHistory._take_stop,
    **dict.fromkeys(("gate", "waited", "guard"), RunHistory._take_wait),
    "subject": RunHistory._take_subject,
    "program": RunHistory._take_program,
    "bound": RunHistory._take_bound,
    "clock": RunHistory._take_clock,
}
