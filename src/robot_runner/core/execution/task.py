"""A run's task, and the outcome that its records add up to: plain data."""

from __future__ import annotations

import hashlib
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any

from robot_runner.core.config.parameters import BadValuePolicy
from robot_runner.core.errors import Finding
from robot_runner.core.events.measure import OPERATOR_OWNER, MeasureColumns, Origin, PublishedMeasure, quality_text
from robot_runner.core.execution.run_records import FINISHED, POPULATE

#: Takes a record of a run: its kind and its plain fields.
Report = Callable[[str, dict[str, Any]], None]


class AttemptStatus(Enum):
    """How one attempt ended."""

    DONE = "done"
    FAILED = "failed"
    INTERRUPTED = "interrupted"


@dataclass(frozen=True, slots=True)
class RunTask:
    """One attempt at executing one run.

    Attributes:
        run_number: its place in the order of execution, from 1.
        combination: the treatment of each factor, by name.
        experiment_seed: the seed from which the run's own is derived.
        repetition: which repetition of its combination it is, from 1; 0 for a warm-up run.
        run_seed: a seed for this run alone, the same each time that it is executed.
        attempts_left: how often it is tried again where this attempt fails.
        measures: the measures published so far, by column: the fields of their records.
        shared: the key-value pairs shared so far, by plugin. Both are filled in place, so that the process of the run
            begins with the operator's answers, and with what `before_run` published and shared.
        place: where it is executed; empty where there is only one place.
        slot: the number of the slot of this machine that has its files meanwhile; 0 on another machine.
    """

    run_id: str
    run_number: int
    run_count: int
    attempt: int
    combination: Mapping[str, Any]
    repetition: int
    experiment_seed: int
    run_seed: int
    attempts_left: int = 0
    measures: dict[str, dict[str, Any]] = field(default_factory=dict)
    shared: dict[str, dict[str, object]] = field(default_factory=dict)
    place: str = ""
    slot: int = 1

    @property
    def whereabouts(self) -> dict[str, Any]:
        """The fields `place` and `slot` of its records in the journal, without defaults."""
        named: dict[str, Any] = {"place": self.place} if self.place else {}
        return named if self.slot == 1 else {**named, "slot": self.slot}

    @property
    def is_warm_up(self) -> bool:
        """Whether it only warms up, so that it is not analysed."""
        return self.repetition == 0


def seed_of_run(experiment_seed: int, run_id: str) -> int:
    """Return a seed of 32 bits that depends on the experiment's seed and the run, and on nothing else."""
    return int.from_bytes(hashlib.blake2b(f"{experiment_seed}/{run_id}".encode(), digest_size=4).digest(), "big")


@dataclass(frozen=True, slots=True)
class PendingRun:
    """A run that is still to be executed: its place in the run table, from 0."""

    run_id: str
    place: int

    @property
    def number(self) -> int:
        """The place in the order of execution, from 1."""
        return self.place + 1


@dataclass(frozen=True, slots=True)
class RunFailure:
    """Why an attempt failed.

    Attributes:
        event: the event during which it failed, or empty where that is not known.
        owner: whose callback failed: a plugin's name, `config`, or empty.
        problem: what happened, in one line.
    """

    problem: str
    event: str = ""
    owner: str = ""
    traceback: str = ""

    def __str__(self) -> str:
        place = " of ".join(part for part in (self.event, self.owner) if part)
        # An error that a plugin raises mostly names the plugin.
        return f"{place}: {self.problem.removeprefix(f'{self.owner}: ')}" if place else self.problem


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """How one attempt went.

    Attributes:
        stamps: UTC time of each event's emission, by the event's name.
        doubts: what is doubtful about columns that were not published, by column: for what comes after the run.
        failure: the first thing that went wrong, if any did.
        later_failures: what went wrong after that, during closing.
        readers: the owners that read the treatment of a factor, or have a parameter bound to it, by factor.
        seconds: real time that the attempt took.
        is_lost: whether it failed because the machine that executed it was lost.
    """

    status: AttemptStatus
    stamps: Mapping[str, str] = field(default_factory=dict)
    measures: Mapping[str, PublishedMeasure] = field(default_factory=dict)
    doubts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    failure: RunFailure | None = None
    later_failures: tuple[RunFailure, ...] = ()
    readers: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    seconds: float = 0.0
    is_lost: bool = False

    def fields(self) -> dict[str, Any]:
        """Return the same as plain data, for the journal."""
        measures = {
            name: {
                "value": measure.value,
                "owner": measure.owner,
                "origin": measure.origin.value,
                **({"doubts": list(measure.doubts)} if measure.doubts else {}),
            }
            for name, measure in self.measures.items()
        }
        return {
            "status": self.status.value,
            "seconds": round(self.seconds, 6),
            "stamps": dict(self.stamps),
            "measures": measures,
            **({"doubts": {name: list(doubts) for name, doubts in self.doubts.items()}} if self.doubts else {}),
            "failure": str(self.failure) if self.failure else None,
            **({"is_lost": True} if self.is_lost else {}),
            "readers": dict(self.readers),
        }

    @classmethod
    def of_fields(cls, fields: Mapping[str, Any]) -> RunOutcome:
        """Return the outcome of a run that is done from its record in the journal, without units and findings."""
        measures = {
            name: PublishedMeasure(
                name, each["value"], each["owner"], origin=Origin(each["origin"]), doubts=tuple(each.get("doubts", ()))
            )
            for name, each in fields["measures"].items()
        }
        readers = {factor: tuple(owners) for factor, owners in (fields.get("readers") or {}).items()}
        doubts = {name: tuple(each) for name, each in (fields.get("doubts") or {}).items()}
        status, seconds = AttemptStatus(fields["status"]), fields["seconds"] or 0.0
        return cls(status, dict(fields["stamps"]), measures, doubts, readers=readers, seconds=seconds)


class OutcomeBuilder:
    """Gathers the records of one attempt into its outcome."""

    def __init__(
        self,
        run_id: str,
        columns: MeasureColumns,
        *,
        on_bad_value: BadValuePolicy = BadValuePolicy.KEEP,
        has_attempts_left: bool = False,
    ) -> None:
        self._run_id = run_id
        self._columns = columns
        self._refuses_bad_values = on_bad_value is BadValuePolicy.FAIL or (
            on_bad_value is BadValuePolicy.TRY_AGAIN and has_attempts_left
        )
        self._doubts: defaultdict[str, list[str]] = defaultdict(list)
        self._units = {column.name: column.measure.unit for column in columns.declared}
        self._stamps: dict[str, str] = {}
        self._measures: dict[str, PublishedMeasure] = {}
        self._findings: list[Finding] = []
        self._failures: list[RunFailure] = []
        self._readers: dict[str, tuple[str, ...]] = {}
        self._started = time.monotonic()
        self.is_finished = False
        self.event = ""

    @property
    def has_failed(self) -> bool:
        """Whether a failure was recorded."""
        return bool(self._failures)

    def take(self, kind: str, fields: dict[str, Any]) -> None:
        """Take one record; kinds that do not matter to the outcome are ignored."""
        if kind == "event":
            self.event = fields["event"]
            self._stamps.setdefault(self.event, fields["at"])
        elif kind == "measure":
            name = fields["name"]
            self._measures[name] = PublishedMeasure(
                name, fields["value"], fields["owner"], self._units.get(name, ""), Origin(fields["origin"])
            )
        elif kind == "finding":
            where = f"{self._run_id}, {fields['owner']}"
            # A file name in it may have surrogates, which cannot be written as UTF-8.
            problem, fix = (fields[each].encode("utf-8", "backslashreplace").decode() for each in ("problem", "fix"))
            self._findings.append(Finding.warning(where, problem, fix))
            for name in fields.get("measures", ()):
                self._doubts[name].append(problem)
        elif kind == "failure":
            self._failures.append(RunFailure(fields["problem"], fields["event"], fields["owner"], fields["traceback"]))
        elif kind == "read":
            self._add_reader(fields["factor"], fields["owner"])
        elif kind == "bound":
            for each in fields["parameters"].values():
                self._add_reader(each["factor"], fields["owner"])
        elif kind == FINISHED:
            self.is_finished = True

    def go_on_from(self, outcome: RunOutcome) -> None:
        """Begin with the stamps, measures and findings of an attempt that has ended, without its failures."""
        self._stamps.update(outcome.stamps)
        self._measures.update(outcome.measures)
        self._findings += outcome.findings
        published = ((name, each.doubts) for name, each in outcome.measures.items())
        for name, doubts in (*outcome.doubts.items(), *published):
            self._doubts[name] += doubts

    def outcome(self, *, ended_because: str = "", interrupted: bool = False) -> RunOutcome:
        """Return how the attempt went.

        `ended_because` is why the run was ended or how its process died, where it did not end by itself.
        """
        failures = list(self._failures)
        if ended_because:
            failures[:1] = [self._ended(ended_because, failures)]
        measures = self._qualified_measures()
        if not (failures or interrupted) and self._refuses_bad_values:
            failures = list(self._bad_values(measures))
        status = AttemptStatus.INTERRUPTED if interrupted else AttemptStatus.FAILED if failures else AttemptStatus.DONE
        return RunOutcome(
            status=status,
            stamps=self._stamps,
            measures=measures,
            doubts={
                name: tuple(dict.fromkeys(each)) for name, each in self._doubts.items() if each and name not in measures
            },
            findings=tuple(self._findings),
            failure=failures[0] if failures else None,
            later_failures=tuple(failures[1:]),
            readers=self._readers,
            seconds=time.monotonic() - self._started,
        )

    def _qualified_measures(self) -> dict[str, PublishedMeasure]:
        """Return the published measures with their doubts, and the values of the quality columns."""
        measures = dict(self._measures)
        for column in self._columns.declared:
            published = measures.get(column.name)
            if published is not None:
                implausible = column.measure.implausible(published.value)
                doubts = tuple(dict.fromkeys(filter(None, (*self._doubts[column.name], implausible))))
                measures[column.name] = replace(published, doubts=doubts) if doubts else published
        for column in self._columns.in_table:
            told, doubts = measures.get(column.tells_of), tuple(dict.fromkeys(self._doubts[column.tells_of]))
            if column.owner == OPERATOR_OWNER:  # nobody was asked, whatever else is doubtful about the run
                doubts = ()
            # Where nothing is published in `continue` either, the earlier reasons stay.
            if column.tells_of and (told is not None or doubts or column.name not in measures):
                text = quality_text(None, doubts) if told is None else quality_text(told.value, told.doubts)
                measures[column.name] = PublishedMeasure(column.name, text, column.owner)
        return measures

    def _bad_values(self, measures: Mapping[str, PublishedMeasure]) -> Iterator[RunFailure]:
        """Yield a failure for each measure of the run table whose value is missing or implausible."""
        for column in self._columns.in_table:
            published = measures.get(column.name)
            if column.tells_of or column.owner == OPERATOR_OWNER:
                continue
            if published is None or published.value is None:
                doubts = published.doubts if published is not None else dict.fromkeys(self._doubts[column.name])
                because = f": {'; '.join(doubts)}" if doubts else ""
                yield RunFailure(f"{column.name} has no value{because}", POPULATE, column.owner)
            elif implausible := column.measure.implausible(published.value):
                yield RunFailure(f"{column.name}: {implausible}", POPULATE, column.owner)

    def _add_reader(self, factor: str, owner: str) -> None:
        known = self._readers.get(factor, ())
        self._readers[factor] = known if owner in known else (*known, owner)

    def _ended(self, because: str, failures: list[RunFailure]) -> RunFailure:
        # The run's own record of the stop request has the callback; the orchestrator has the reason.
        first = failures[0] if failures else RunFailure("", self.event)
        return RunFailure(because, first.event or self.event, first.owner, first.traceback)
