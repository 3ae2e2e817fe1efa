"""Describe the execution for the crate: the config as a workflow with its parameters, and one action for each run.

https://www.researchobject.org/workflow-run-crate/profiles/workflow_run_crate/ (0.5).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.run_table_rows import RunTableRows
from robot_runner.core.storage.table_columns import ColumnDescription, ColumnRole
from robot_runner.replication.contents import TABLE

_FORMAL_PARAMETER = "https://bioschemas.org/profiles/FormalParameter/1.0-RELEASE"


@dataclass(frozen=True, slots=True)
class ExecutedRun:
    """A run that is done or failed.

    Attributes:
        has_failed: whether its last attempt failed.
        started_at, ended_at: its first and its last time stamp in the table (UTC), if any.
        treatments: the treatment of each factor, by name.
        excluded: why it is excluded from the analysis; None if it is not.
    """

    run_id: str
    has_failed: bool
    started_at: str | None
    ended_at: str | None
    treatments: Mapping[str, Any] = field(default_factory=dict)
    excluded: str | None = None


def executed_runs(rows: RunTableRows, columns: Sequence[ColumnDescription]) -> tuple[ExecutedRun, ...]:
    """Return the runs of a run table that are done or failed, in their order."""
    stamps = [each.name for each in columns if each.role is ColumnRole.TIMESTAMP]
    factors = [each.name for each in columns if each.role is ColumnRole.FACTOR]
    found = []
    for place, row in enumerate(rows):
        if rows.status(place) not in {RunStatus.DONE, RunStatus.FAILED}:
            continue
        times = sorted(str(row[name]) for name in stamps if row.get(name))
        found.append(
            ExecutedRun(
                rows.run_id(place),
                rows.status(place) is RunStatus.FAILED,
                times[0] if times else None,
                times[-1] if times else None,
                {name: row[name] for name in factors if row.get(name) is not None},
                rows.excluded(place),
            )
        )
    return tuple(found)


def iso_stamp(stamp: str | None) -> str | None:
    """Return a time stamp in a form that every parser of ISO 8601 reads: `+00:00` instead of `Z`."""
    return stamp.replace("Z", "+00:00") if stamp else None


def action_outcome(error: str | None) -> dict[str, str | None]:
    """Return the properties for the outcome of an action; `error` is None if it was completed."""
    status = "FailedActionStatus" if error else "CompletedActionStatus"
    return {"actionStatus": f"http://schema.org/{status}", "error": error}


class RunActions:
    """The actions of the runs, and the parameters of the workflow that they executed.

    Args:
        entity: adds an entity with an identifier, a type and properties to the crate.
        workflow: the main workflow: the config.
        table: the run table, or None if the package does not have it.
        earlier: the config that executed a run, by the run's id, where it was another version than the main workflow.
    """

    def __init__(self, entity: Callable[..., Any], workflow: Any, table: Any, earlier: Mapping[str, Any]) -> None:
        self._entity = entity
        self._workflow = workflow
        self._table = table
        self._earlier = earlier
        self._treatments: dict[tuple[str, str], Any] = {}

    def describe(self, runs: Sequence[ExecutedRun], folders: Mapping[str, Any], authors: Sequence[Any]) -> list[Any]:
        """Add the actions and the parameters to the crate, and return the actions.

        Args:
            runs: the executed runs.
            folders: the run folders in the package, by the run's id.
            authors: the agents of the actions.
        """
        for run in runs:
            for name, value in run.treatments.items():
                key = name, str(value)
                if key not in self._treatments:
                    identifier = f"#treatment-{len(self._treatments) + 1}"
                    self._treatments[key] = self._entity(identifier, "PropertyValue", name=name, value=_plain(value))
        self._workflow["input"] = list(self._inputs(runs))
        if self._table is not None:
            output = self._parameter("#output-run-table", TABLE, "File", [self._table], "All runs with their measures.")
            self._workflow["output"] = output
        return [self._action(run, folders.get(run.run_id), authors) for run in runs]

    def _inputs(self, runs: Sequence[ExecutedRun]) -> Iterator[Any]:
        names = dict.fromkeys(name for run in runs for name in run.treatments)
        for number, name in enumerate(names, start=1):
            values = [run.treatments[name] for run in runs if name in run.treatments]
            examples = [each for (factor, _), each in self._treatments.items() if factor == name]
            yield self._parameter(f"#factor-{number}", name, _data_type(values), examples, "A factor.")

    def _parameter(self, identifier: str, name: str, kind: str, examples: list[Any], description: str) -> Any:
        parameter = self._entity(
            identifier,
            "FormalParameter",
            name=name,
            description=description,
            additionalType=kind,
            workExample=examples,
            conformsTo={"@id": _FORMAL_PARAMETER},
        )
        for each in examples:
            each["exampleOfWork"] = parameter
        return parameter

    def _action(self, run: ExecutedRun, folder: Any, authors: Sequence[Any]) -> Any:
        note = f" It is left out of the analysis: {run.excluded}" if run.excluded else ""
        treatments = ", ".join(f"{name} = {value}" for name, value in run.treatments.items())
        return self._entity(
            f"#run-{run.run_id}",
            "CreateAction",
            name=f"Run {run.run_id}",
            description=f"One run of the experiment{f' with {treatments}' if treatments else ''}.{note}",
            startTime=iso_stamp(run.started_at),
            endTime=iso_stamp(run.ended_at),
            agent=list(authors),
            instrument=self._earlier.get(run.run_id, self._workflow),
            object=[self._treatments[name, str(value)] for name, value in run.treatments.items()],
            result=[each for each in (self._table, folder) if each is not None],
            **action_outcome("The run failed; journal.jsonl tells why." if run.has_failed else None),
        )


def _plain(value: Any) -> Any:
    return value if isinstance(value, bool | int | float) else str(value)


def _data_type(values: Sequence[Any]) -> str:
    """Return the common data type (schema.org) of a factor's treatments."""
    kinds = {type(each) for each in values}
    for kind, name in ((bool, "Boolean"), (int, "Integer"), (float, "Float")):
        if kinds == {kind}:
            return name
    return "Float" if kinds == {int, float} else "Text"
