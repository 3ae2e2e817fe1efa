"""The one gate for measures, findings and shared values of a run."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from robot_runner.core.errors import Finding, MeasureError, did_you_mean
from robot_runner.core.events import measure
from robot_runner.core.events.early_end import undivided
from robot_runner.core.secret_names import without_environment_secrets

#: Takes a record of a run: its kind and its plain fields.
ReportRecord = Callable[[str, dict[str, Any]], None]

#: How many characters of a refused text a message shows.
_LONGEST_TOLD = 40


class MeasureBroker:
    """Checks the measures published in one run against the declared ones, and reports each at once. Thread-safe.

    `report` takes the records. `told` has what was published before: the fields of each measure's record, by column.
    `shared` has what was shared before, by plugin. Both are filled in place.
    """

    def __init__(
        self,
        run_id: str,
        columns: measure.MeasureColumns,
        report: ReportRecord,
        told: dict[str, dict[str, Any]] | None = None,
        shared: dict[str, dict[str, object]] | None = None,
    ) -> None:
        self._run_id = run_id
        self._columns = columns
        self._report = report
        self._lock = threading.RLock()  # re-entrant: a signal handler may publish, too
        self._told = {} if told is None else told
        self._measures = {
            name: measure.PublishedMeasure(name, each["value"], each["owner"], origin=measure.Origin(each["origin"]))
            for name, each in self._told.items()
        }
        self._shared = {} if shared is None else shared
        self._findings: list[Finding] = []
        self._derived: list[tuple[str, str, frozenset[str]]] = []

    @property
    def measures(self) -> Mapping[str, measure.PublishedMeasure]:
        """The measures published so far, by column of the run table."""
        return self._measures

    @property
    def has_simulated(self) -> bool:
        """Whether any of them comes from a simulated robot."""
        return any(each.origin is measure.Origin.SIMULATED for each in self._measures.values())

    @property
    def shared(self) -> Mapping[str, Mapping[str, object]]:
        """The key-value pairs shared so far, by plugin."""
        return self._shared

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The warnings recorded so far."""
        return tuple(self._findings)

    def publish(self, owner: str, name: str, value: object, origin: measure.Origin) -> None:
        """Take one measure; a later value of the same measure replaces the earlier.

        Raises:
            MeasureError: the name was not declared, the type is wrong, the number is not finite, or it is a text and
                the measure has a unit. What was refused is reported, too, so that it is kept with the run.
        """
        if not isinstance(origin, measure.Origin):
            fix = did_you_mean(str(origin), map(str, measure.Origin))
            raise MeasureError(f"{origin!r} is not an origin", where=owner, fix=fix)
        try:
            column = self._columns.column_for(owner, name)
            plain = measure.as_measure_value(column.name, value, where=owner)
            _refuse_text_with_unit(column, plain, where=owner)
        except MeasureError:
            refused = without_environment_secrets(measure.shown(value))
            self._report("refused", {"owner": owner, "name": str(name), "value": refused})
            raise
        published = measure.PublishedMeasure(column.name, plain, owner, column.measure.unit, origin)
        with undivided, self._lock:  # both or neither, where the mission ends now
            self._measures[column.name] = published
            fields = {"name": column.name, "value": plain, "owner": owner, "origin": origin.value}
            self._told[column.name] = fields
            self._report("measure", fields)

    def share(self, owner: str, values: Mapping[str, object]) -> None:
        """Pass key-value pairs on to the subscribers of the following events."""
        with undivided, self._lock:
            self._shared.setdefault(owner, {}).update(values)
            self._report("shared", {"owner": owner, "values": dict(values)})

    def warn(self, owner: str, problem: str, fix: str) -> None:
        """Record a warning finding about this run."""
        self._record_finding(owner, problem, fix, {})

    def doubt(self, owner: str, problem: str, fix: str, measures: Sequence[str] = ()) -> None:
        """Record a warning finding that makes values of this run doubtful; a measure's, also those of its phases.

        Raises:
            MeasureError: the owner declared no such measure.
        """
        named = (measures,) if isinstance(measures, str) else measures
        asked = [self._columns.column_for(owner, name) for name in named]
        columns = [each for one in asked for each in (one, *self._phases_of(one))] or self._columns_of(owner)
        names = {column.measure.name for column in columns}
        names |= {name.rpartition(".")[0] for name in names}
        phases = {_phase_of(column) for column in columns}
        for derived, source, read in self._derived:
            if source == owner and (not read or read & names):
                columns += [each for each in self._columns_of(derived) if {"", _phase_of(each)} & phases]
        self._record_finding(owner, problem, fix, {"measures": list(dict.fromkeys(each.name for each in columns))})

    def derive(self, owner: str, source: str, names: Iterable[str] = ()) -> None:
        """Have later doubts about the measures of `source` count for all measures of `owner`, which has them computed.

        `names` are the measures of `source` whose doubts count; empty for all.
        """
        self._derived.append((owner, source, frozenset(names)))

    def _columns_of(self, owner: str) -> list[measure.MeasureColumn]:
        return [column for column in self._columns.declared if column.owner == owner]

    def _phases_of(self, column: measure.MeasureColumn) -> list[measure.MeasureColumn]:
        """Return the columns of a measure's values per phase, `<measure>.<phase>`: they come from the same samples."""
        name = column.measure.name
        return [each for each in self._columns_of(column.owner) if each.measure.name.rpartition(".")[0] == name]

    def doubt_run(self, owner: str, problem: str, fix: str) -> None:
        """Record a warning finding that makes all values of this run doubtful, whoever publishes them."""
        self._record_finding(owner, problem, fix, {"measures": self._columns.doubtful_with_run})

    def _record_finding(self, owner: str, problem: str, fix: str, more: dict[str, Any]) -> None:
        problem, fix = str(problem), str(fix or "")  # an exception that a callback passes on is a text in the journal
        with undivided, self._lock:
            self._findings.append(Finding.warning(f"{self._run_id}, {owner}", problem, fix))
            self._report("finding", {"owner": owner, "problem": problem, "fix": fix, **more})

    def note(self, owner: str, kind: str, facts: Mapping[str, object]) -> None:
        """Report something else that happened in this run, as a record of this kind."""
        with undivided, self._lock:
            self._report(kind, {"owner": owner, **facts})


def _phase_of(column: measure.MeasureColumn) -> str:
    """Return the phase that a column is about; empty for the whole mission."""
    name, _, phase = column.measure.name.rpartition(".")
    return phase if name else ""


def _refuse_text_with_unit(column: measure.MeasureColumn, value: measure.MeasureValue, *, where: str) -> None:
    """Refuse a text for a measure with a unit: statistics and plausible limits would ignore it silently.

    Raises:
        MeasureError: the value is such a text, as the "12.5" of an API that writes numbers as texts.
    """
    if isinstance(value, str) and column.measure.unit:
        said = value if len(value) <= _LONGEST_TOLD else value[:_LONGEST_TOLD] + "…"
        problem = f"measure {column.name!r} got the text {said!r}, and its unit is {column.measure.unit}"
        fix = "Give a number, or None where there is no value; a measure that is a text has no unit."
        raise MeasureError(problem, where=where, fix=fix)
