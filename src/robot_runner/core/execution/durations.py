"""How long an experiment takes: from the durations that plugins declare, and from the runs that have ended."""

from __future__ import annotations

import math
import time
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robot_runner.core.config.parameters import OperationType, Parameters
from robot_runner.core.events.manager import EventManager
from robot_runner.core.execution.known_durations import (
    CombinationKey,
    DeclaredDurations,
    ObservedDurations,
    combination_key,
    distinct_combinations,
)
from robot_runner.core.execution.task import AttemptStatus
from robot_runner.core.links.declared_host import Reboot
from robot_runner.core.plugin import Plugin
from robot_runner.core.storage.journal import last_records, seconds_of
from robot_runner.core.words import counted, enumerated, shown_duration

#: The kinds of records from which durations are computed.
_TELLING = ("experiment_started", "attempt_started", "attempt_finished", "clock_set")
#: Longer pauses are ignored, s: nobody was there, for a meal or a night.
_LEFT_ALONE = 3600.0
#: The mean is over so many of the last pauses.
_PAUSES = 200
#: With more combinations than this, all runs are taken to last alike: distinguishing them costs time.
_MOST_COMBINATIONS = 10_000
#: The share of the time that may be spent on estimating: a table may have a million runs.
_SHARE = 1 / 50


@dataclass(frozen=True, slots=True)
class Estimate:
    """How long an experiment takes from here.

    Attributes:
        seconds: all that is known of it; None where nothing is.
        is_least: whether something comes on top whose duration is not known.
        parts: what it is made of, in words.
        unknown: what is not known, in words.
    """

    seconds: float | None
    is_least: bool = False
    parts: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Return the estimate in words, with its parts."""
        unknown = f"not known: {'; '.join(self.unknown)}" if self.unknown else ""
        if self.seconds is None:
            return unknown or "not known"
        made_of = "; ".join([*self.parts, *filter(None, [unknown])])
        lasts = _about(self.seconds, is_least=self.is_least) if self.seconds or self.is_least else "none"
        return f"{lasts}{f' ({made_of})' if made_of else ''}"


@dataclass(frozen=True, slots=True)
class TimeLeft:
    """How long the experiment takes from the moment at which a run began, or ended.

    Attributes:
        run: the run that is being executed, s; 0 where none is.
        others: the rest, with the pauses, s.
        is_least: as in `Estimate`.
    """

    run: float
    others: float
    is_least: bool = False

    def after(self, seconds: float) -> float:
        """Return what is left `seconds` later, s; a run that takes longer does not make the others shorter."""
        return self.others + max(0.0, self.run - seconds)

    @classmethod
    def of_facts(cls, facts: object) -> TimeLeft | None:
        """Return the time that `facts` stand for; None for anything else."""
        try:
            return cls(float(facts["run"]), float(facts["others"]), bool(facts["is_least"]))  # type: ignore[index]
        except (TypeError, ValueError, LookupError):
            return None

    def facts(self) -> dict[str, Any]:
        """Return the same as plain data, for the journal."""
        return {"run": round(self.run, 3), "others": round(self.others, 3), "is_least": self.is_least}

    def in_words(self, seconds: float = 0.0) -> str:
        """Return what is left `seconds` later, in words."""
        return f"{_about(self.after(seconds), is_least=self.is_least)} left"


def _about(seconds: float, *, is_least: bool) -> str:
    return f"{'at least' if is_least else 'about'} {shown_duration(seconds)}"


class Durations:
    """Estimates how long runs and the pauses between them take, from declared durations and runs that have ended.

    A run counts from its beginning to the end of its last attempt, and a pause from there to the beginning of the next
    run: rest, operator, gates and all. Failed runs count only while none is done. What runs took beyond their declared
    duration is expected of other runs, too. Plugins are asked once about each of the `combinations`. What `waits` names
    comes between two runs, and is of unknown duration until the first pause.

    Attributes:
        places: at how many places runs are executed at the same time.

    Example:
        >>> durations = Durations(rest_s=5.0)
        >>> video = {"Task": "Video"}
        >>> durations.begin(video, 0.0)
        >>> durations.end(100.0, "done", is_last=True)
        >>> durations.of_run(video)
        100.0
    """

    def __init__(
        self,
        declared: DeclaredDurations | None = None,
        combinations: Iterable[Mapping[str, Any]] = (),
        *,
        rest_s: float = 0.0,
        waits: Sequence[str] = (),
    ) -> None:
        self.declared = declared or DeclaredDurations()
        self._rest = rest_s
        self._waits = tuple(waits)
        found = distinct_combinations(combinations)
        self._are_alike = len(found) > _MOST_COMBINATIONS
        self._declared_s = {} if self._are_alike else self.declared.of_all(each for each, _ in found)
        self._done, self._failed = ObservedDurations(), ObservedDurations()
        self._pauses: deque[float] = deque(maxlen=_PAUSES)
        self._current: dict[str, tuple[CombinationKey, float, str]] = {}
        self._ended: dict[str, float] = {}
        self._clock_set = 0.0
        self.places = 1
        self._has_begun = False
        self._left: Counter[CombinationKey] = Counter()
        self._to_come = 0
        self._follows = ""
        self._expected: float | None = None
        self._computed = self._cost = 0.0

    def learn_from(self, journal: Path) -> None:
        """Learn from the last runs in a journal; raise a `StorageError` if it cannot be read."""
        for record in last_records(journal, kinds=_TELLING):
            self.take_record(record)
        self.break_off()

    def take_record(self, record: Mapping[str, Any]) -> None:
        """Take a record of the journal into account; other kinds than `_TELLING` are ignored."""
        match record["kind"]:
            case "experiment_started":
                self.break_off()
            case "clock_set":
                self._clock_set += record["seconds"]
            case "attempt_started":
                at = seconds_of(record["at"]) - self._clock_set
                self.begin(record.get("combination") or {}, at, record["run"], record.get("place", ""))
            case "attempt_finished" if not record.get("is_amended"):  # which only adds what was published later
                at = seconds_of(record["at"]) - self._clock_set
                self.end(at, record["status"], is_last=record.get("is_last", True), run=record["run"])

    def plan(self, combinations: Iterable[Mapping[str, Any]], *, follows: str = "") -> None:
        """Set which runs are to come, and in words what may follow them."""
        self._follows = follows
        self._left = Counter()
        if self._are_alike:
            self._left[frozenset()] = sum(1 for _ in combinations)
        for combination, count in () if self._are_alike else distinct_combinations(combinations):
            self._left[self._key(combination)] += count
        self._to_come = self._left.total()
        self._computed = self._cost = 0.0

    def expect_again(self, combinations: Iterable[Mapping[str, Any]]) -> None:
        """Add runs that are to be executed once more."""
        again = Counter(map(self._key, combinations))
        self._left += again
        self._to_come += again.total()
        self._computed = 0.0

    def begin(self, combination: Mapping[str, Any], at: float, run: str = "", place: str = "") -> None:
        """Note that an attempt at a run begins.

        `at` is s on a clock that is the same for all calls until `break_off`; treatments may be given by their texts.
        """
        if run in self._current:  # it is tried again
            return
        ended = self._ended.pop(place, None)
        if ended is not None and 0 <= at - ended <= _LEFT_ALONE:
            self._pauses.append(at - ended)
        key = self._key(combination)
        self._current[run] = (key, at, place)
        if self._left[key] > 0:
            self._left[key] -= 1
            self._to_come -= 1
            if self._expected is not None:
                self._expected = max(0.0, self._expected - (self._of(key) or 0.0))

    def end(self, at: float, status: str, *, is_last: bool, run: str = "") -> None:
        """Note that an attempt has ended with this status; the run goes on unless it was the last attempt."""
        if status == AttemptStatus.INTERRUPTED.value:
            self._current.pop(run, None)
        if not is_last or run not in self._current:
            return
        key, began, place = self._current.pop(run)
        seen = self._done if status == AttemptStatus.DONE.value else self._failed
        seen.take(key, max(0.0, at - began) - self._declared_s.get(key, 0.0))
        self._ended[place], self._has_begun = at, True
        if self._expected is None:  # now it is known
            self._computed = 0.0

    def declared_of(self, combination: Mapping[str, Any]) -> float | None:
        """Return the declared duration of a run of this combination, s; None where there is none."""
        return self._declared_s.get(self._key(combination))

    def learn(self, combination: Mapping[str, Any], seconds: float) -> None:
        """Learn from a run that is done and took so many seconds."""
        key = self._key(combination)
        self._done.take(key, seconds - self._declared_s.get(key, 0.0))
        self._computed = 0.0

    def break_off(self) -> None:
        """Forget runs that have begun and not ended: they were interrupted, or times are of another clock from here."""
        self._current.clear()
        self._ended.clear()

    @property
    def count(self) -> int:
        """How many runs it has learnt from."""
        return self._seen.count

    @property
    def pause(self) -> float:
        """How long it takes from the end of a run to the beginning of the next, s."""
        return math.fsum(self._pauses) / len(self._pauses) if self._pauses else self._rest

    @property
    def _seen(self) -> ObservedDurations:
        return self._done if self._done.count else self._failed

    def of_run(self, combination: Mapping[str, Any]) -> float | None:
        """Return how long a run of this combination takes, s; None where that is not known."""
        return self._of(self._key(combination))

    def _key(self, combination: Mapping[str, Any]) -> CombinationKey:
        return frozenset() if self._are_alike else combination_key(combination)

    def _of(self, key: CombinationKey) -> float | None:
        beyond = self._seen.expected(key)
        if beyond is None:
            return self._declared_s.get(key)
        return max(0.0, self._declared_s.get(key, 0.0) + beyond)

    def left(self) -> TimeLeft | None:
        """Return how long the run that has begun and those to come take; None where that is not known."""
        now = time.monotonic()
        if not self._computed or now - self._computed > self._cost / _SHARE:
            self._expected = self._of_all()
            self._computed = time.monotonic()
            self._cost = self._computed - now
        current = self._of_current(now)
        if self._expected is None or current is None:
            return None
        others = (self._expected + self._to_come * self.pause) / self.places
        return TimeLeft(current, others, is_least=bool(self._unknown()))

    def _of_current(self, now: float) -> float | None:
        """Return how long the runs in flight take from here; None where that is not known."""
        expected = [(self._of(key), began) for key, began, _ in self._current.values()]
        if any(seconds is None for seconds, _ in expected):
            return None
        if len(expected) == 1:  # it has just begun
            return expected[0][0]
        return max((max(0.0, (seconds or 0.0) - (now - began)) for seconds, began in expected), default=0.0)

    def estimate(self, *, probe_s: float = 0.0) -> Estimate:
        """Return how long all that was planned takes, a probe before it included, with its parts in words."""
        runs = self._to_come
        if not runs:
            return Estimate(0.0, parts=("no run is to be executed",))
        of_runs = self._of_all()
        if of_runs is None:
            return Estimate(None, unknown=(self._why_not(), *self._unknown()))
        pauses = runs - (0 if self._has_begun else 1)
        parts = [f"{counted(runs, 'run')} of {shown_duration(of_runs / runs)}, {self._source()}"]
        if pauses and self.pause > 0:
            told = "as they were so far" if self._pauses else "time_between_runs_in_ms"
            parts.append(f"{counted(pauses, 'pause')} of {shown_duration(self.pause)}, {told}")
        if probe_s:
            parts.append(f"the probe of the profilers, {shown_duration(probe_s)}")
        unknown = self._unknown()
        return Estimate(of_runs + pauses * self.pause + probe_s, bool(unknown), tuple(parts), unknown)

    def _of_all(self) -> float | None:
        expected = [(count, self._of(key)) for key, count in self._left.items() if count]
        if any(seconds is None for _, seconds in expected):
            return None
        return math.fsum(count * seconds for count, seconds in expected if seconds is not None)

    def _unknown(self) -> tuple[str, ...]:
        """Return the parts of unknown duration, in words."""
        waits = () if self._pauses else self._waits
        waits = (*waits, self._follows) if self._follows else waits
        if self.count or not self._declared_s:
            return waits
        missions = [f"launch_mission of {name}" for name in self.declared.without]
        return (*missions, "the other events of a run", *waits)

    def _source(self) -> str:
        if self.count:
            return f"as the {counted(self.count, 'run')} that ended" if self.count > 1 else "as the run that ended"
        names = [name for name, _ in self.declared.sources]
        return f"as {enumerated(names)} {'says' if len(names) == 1 else 'say'}"

    def _why_not(self) -> str:
        if self.declared.is_simulated:
            return "how long the simulated robot takes, until a run has ended"
        who = enumerated(self.declared.without) if self.declared.without else "a plugin or of the config"
        return f"how long a run takes, until one has ended (duration_s of {who} would tell)"


def durations_of(
    config: Any,
    plugins: Sequence[Plugin],
    events: EventManager,
    parameters: Parameters,
    combinations: Iterable[Mapping[str, Any]],
    journal: Path,
) -> Durations:
    """Return the durations of an experiment, by its plugins and by its runs so far.

    Raises:
        StorageError: the journal cannot be read.
    """
    durations = Durations(
        DeclaredDurations.of(config, plugins, events, parameters.robot),
        combinations,
        rest_s=parameters.time_between_runs_in_ms / 1000,
        waits=list(_waits(parameters)),
    )
    durations.learn_from(journal)
    return durations


def _waits(parameters: Parameters) -> Iterator[str]:
    """Yield in words what delays the next run besides the rest."""
    if parameters.operation_type is OperationType.SEMI or parameters.operator_steps:
        yield "the operator between two runs"
    if parameters.gates:
        yield "the gates"
    restarted = [name for name, host in parameters.hosts.items() if host.reboot is not Reboot.NEVER]
    if restarted:
        yield f"restarting {enumerated(restarted)}"
