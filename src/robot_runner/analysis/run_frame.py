"""The run table of an experiment as a typed data frame."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from robot_runner.analysis.journal_frames import moments
from robot_runner.analysis.wording import labelled
from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.design.batch import CONFIRMATION
from robot_runner.core.design.columns import EXCLUDED, REPETITION, RUN_ID, STATUS
from robot_runner.core.design.factor import Factor
from robot_runner.core.errors import AnalysisError, Finding
from robot_runner.core.events.measure import QUALITY_SUFFIX, Quality, quality_of_value
from robot_runner.core.storage.cells import RunStatus, treatment_position, typed_value, typed_values
from robot_runner.core.storage.executed_runs import ExcludedRuns, edited_findings, recorded_rows, unrecorded_findings
from robot_runner.core.storage.lock import holder_of
from robot_runner.core.storage.table_columns import MARKS, ColumnDescription, ColumnRole
from robot_runner.core.storage.table_schema import type_of_values

if TYPE_CHECKING:
    from enum import Enum

    from robot_runner.core.storage.layout import ExperimentFolder
    from robot_runner.core.storage.run_table_rows import RunTableRows


def several(names: str | Sequence[str]) -> Sequence[str]:
    """Return names as a sequence; a single one may be given as a plain text.

    Example:
        >>> several("Energy"), several(["Energy", "CPU"])
        (('Energy',), ['Energy', 'CPU'])
    """
    return (names,) if isinstance(names, str) else names


def require_choice(given: object, kind: type[Enum], what: str, where: str) -> None:
    """Check that a value is a member of an enumeration; a text never equals a member.

    Raises:
        AnalysisError: the value is not a member.
    """
    if not isinstance(given, kind):
        names = ", ".join(f"{kind.__name__}.{each.name}" for each in kind)
        raise AnalysisError(f"{what} is {given!r}", where=where, fix=f"Give one of {names}.")


def fact_of(manifest: Mapping[str, Any], *keys: str, default: Any = None) -> Any:
    """Return the manifest's entry at these nested keys."""
    found: Any = manifest
    for key in keys:
        if not isinstance(found, Mapping) or key not in found:
            return default
        found = found[key]
    return default if found is None else found


@dataclass(frozen=True)
class ExperimentFacts:
    """An experiment without its runs; `Results` says what its attributes are."""

    folder: Path
    manifest: Mapping[str, Any] = field(repr=False)
    columns: Mapping[str, ColumnDescription] = field(repr=False)

    @property
    def name(self) -> str:
        """The experiment's name."""
        return str(self.manifest.get("experiment_name", self.folder.name))

    @property
    def factors(self) -> tuple[str, ...]:
        """The factors, except one that only counts repetitions (as in the paper's Listing 1)."""
        return tuple(name for name in self._named(ColumnRole.FACTOR) if name != self.repetition)

    @property
    def repetition(self) -> str | None:
        """The column that counts the repetitions of a combination (ours, or a factor of that name), if there is one."""
        counted = self._named(ColumnRole.REPETITION)
        named = [name for name in self._named(ColumnRole.FACTOR) if name.casefold() == REPETITION.casefold()]
        return next(iter((*counted, *named)), None)

    @property
    def block(self) -> str | None:
        """The column of the blocks within which the order was randomised (a factor, or the repetition), if any."""
        blocks = fact_of(self.manifest, "design", "blocks")
        return blocks if blocks in self.columns else None

    @property
    def batch(self) -> str | None:
        """The column of the batch (a stratum) in which a run was planned, where the experiment was extended."""
        return next(iter(self._named(ColumnRole.BATCH)), None)

    @property
    def is_adaptive(self) -> bool:
        """Whether the design chose runs by results: the runs of its search are exploratory."""
        return bool(fact_of(self.manifest, "design", "facts", "decides"))

    @property
    def confirming_batches(self) -> tuple[int, ...]:
        """The batches that confirm the findings of an adaptive design."""
        batches = fact_of(self.manifest, "design", "batches", default=())
        return tuple(each["batch"] for each in batches if each.get("role") == CONFIRMATION)

    @property
    def measures(self) -> tuple[str, ...]:
        """The measures with a column in the run table, in its order, without columns of qualities."""
        named = self._named(ColumnRole.MEASURE)
        telling = {name + QUALITY_SUFFIX for name in named}
        return tuple(name for name in named if name not in telling)

    @property
    def plan(self) -> AnalysisPlan | None:
        """The analysis plan that was fixed before the experiment, or None."""
        return AnalysisPlan.of_mapping(plain) if (plain := self.manifest.get("analysis")) else None

    @property
    def seed(self) -> int | None:
        """The seed of the order of the runs; None where it is not known."""
        return None if (seed := self.manifest.get("seed")) is None else int(seed)

    def unit(self, name: str) -> str:
        """Return the unit of a column (SI symbol, `%`, `1`); empty where there is none or it is not known."""
        return self.columns[name].unit if name in self.columns else ""

    def label(self, name: str) -> str:
        """Return a heading for an axis or a table: the name with its unit in brackets, as in `Energy (J)`."""
        return labelled(name, self.unit(name))

    def _named(self, role: ColumnRole) -> tuple[str, ...]:
        return tuple(column.name for column in self.columns.values() if column.role is role)


_TYPED_TREATMENTS = frozenset({"integer", "number", "boolean"})
_LARGEST = 2**63 - 1  # of an Int64 column
_DTYPES = {"integer": "Int64", "boolean": "boolean", "string": "str"}


@dataclass(frozen=True, slots=True)
class RunFrame:
    """The run table.

    Attributes:
        frame: one row a run, in the order of the file.
        findings: anomalies of the file.
        warm_ups: the ids of the warm-up runs.
    """

    frame: pd.DataFrame
    findings: tuple[Finding, ...]
    warm_ups: tuple[str, ...] = ()

    def without_warm_ups(self) -> RunFrame:
        """Return the table without the rows of warm-up runs."""
        return self._with(~self.frame[RUN_ID].isin(self.warm_ups)) if self.warm_ups else self

    def of_batches(self, batch: str, numbers: Sequence[int]) -> RunFrame:
        """Return the table with only the runs of these batches."""
        return self._with(self.frame[batch].isin(numbers))

    def _with(self, rows: pd.Series) -> RunFrame:
        kept = self.frame[rows].reset_index(drop=True)
        kept.attrs = self.frame.attrs
        return replace(self, frame=kept)


def read_run_frame(
    folder: ExperimentFolder, columns: Sequence[ColumnDescription], manifest: Mapping[str, Any]
) -> RunFrame:
    """Read the run table, and add runs from the journal that ended since the file was last written.

    Raises:
        StorageError: there is no run table, or it cannot be read.
    """
    rows, ended = recorded_rows(folder, columns)
    warm_ups = tuple(run.run_id for run in rows.planned if run.is_warm_up)
    # While the experiment is executed, a run may have ended since the journal was read.
    done = rows.done_runs if holder_of(folder.lock) is None else ()
    lost = unrecorded_findings(folder.journal, done, ended, manifest)
    edited = edited_findings(folder.journal, folder.run_table, rows)
    return RunFrame(_frame(rows, columns, manifest), (*rows.warnings, *lost, *edited), warm_ups)


def excluded_frame(frame: pd.DataFrame, known: ExcludedRuns) -> pd.DataFrame:
    """Return the excluded rows of a run table, with the time of exclusion as `excluded_at` (UTC)."""
    chosen = frame[frame[EXCLUDED].notna()] if EXCLUDED in frame else frame.iloc[:0].assign(**{EXCLUDED: None})
    at = [known.present[run_id].at if run_id in known.present else None for run_id in chosen[RUN_ID]]
    return chosen.reset_index(drop=True).astype({EXCLUDED: "str"}).assign(excluded_at=moments(at))


def quality_frame(
    done: pd.DataFrame, measures: Sequence[str], reasons_of: Callable[[str, str], Sequence[str]]
) -> pd.DataFrame:
    """Return the quality of each value of runs that are done, one row a value."""
    rows = [
        (run_id, name, quality_of_value(None if pd.isna(value) else value, reasons).value, "; ".join(reasons))
        for name in measures
        if name in done
        for run_id, value in zip(done[RUN_ID], done[name], strict=True)
        for reasons in [reasons_of(run_id, name)]
    ]
    frame = pd.DataFrame(rows, columns=["run_id", "measure", "quality", "reasons"])
    frame["quality"] = pd.Categorical(frame["quality"], [each.value for each in Quality], ordered=True)
    return frame


def treatment_texts(values: pd.Series) -> pd.Series:
    """Return a factor's column as texts, as in the run table."""
    return values.cat.rename_categories([str(each) for each in values.cat.categories])


def _frame(rows: RunTableRows, columns: Sequence[ColumnDescription], manifest: Mapping[str, Any]) -> pd.DataFrame:
    types = {column.name: column.type for column in columns}
    declared = manifest.get("design", {}).get("factors", {})
    words = [status.value for status in RunStatus]
    data: dict[str, Any] = {
        RUN_ID: pd.array(list(rows.values(RUN_ID)), dtype="str"),
        STATUS: pd.Categorical([status.value for status in rows.values(STATUS)], words, ordered=True),
    }
    for name in rows.layout.exclusion:
        data[name] = pd.array(list(rows.values(name)), dtype="str")
    for name in rows.layout.stamps:
        data[name] = moments(list(rows.values(name)))
    for name in rows.layout.factor_names:
        data[name] = _factor(name, list(rows.values(name)), types.get(name, "any"), declared.get(name, ()))
    for name in rows.layout.repetition:
        data[name] = pd.array(list(rows.values(name)), dtype="Int64")
    for name in rows.layout.marks:
        data[name] = pd.array(list(rows.values(name)), dtype=_DTYPES[MARKS[name].type])
    for name in rows.layout.measures:
        data[name] = _values(list(rows.values(name)), types.get(name, "any"))
    for name in rows.layout.extras:
        data[name] = _values(typed_values([text or "" for text in rows.values(name)], None), "string")
    frame = pd.DataFrame(data)
    frame.attrs["units"] = {column.name: column.unit for column in columns if column.unit and column.name in frame}
    return frame


def _factor(name: str, values: Sequence[Any], kind: str, declared: Sequence[str]) -> pd.Categorical:
    """Return an ordered categorical: first the treatments in the config's order, then others as they occur."""
    texts = _as_declared(name, list(map(_text, values)), declared)
    found = dict(zip(texts, values, strict=True))
    order = list(dict.fromkeys([*declared, *(found if declared else _in_order(found.values()))]))
    categories: list[Any] = order
    if kind in _TYPED_TREATMENTS:
        typed = [typed_value(text, kind) for text in order]
        # `1` and `1.0`, or `01`, are the same number: different treatments stay texts.
        if len(set(typed)) == len(order) and type_of_values(typed) == kind:
            categories = typed
    # Without this, pandas turns a treatment 1 beside 0.5 into 1.0, a name that neither table nor hypotheses use.
    kept = object if len(set(map(type, categories))) > 1 else None
    return pd.Categorical(texts, order, ordered=True).rename_categories(pd.Index(categories, dtype=kept))


#: More pairs of treatments would take more than seconds to compare, and are no groups of runs any more.
_MOST_COMPARED = 1_000_000


def _as_declared(name: str, texts: Sequence[str], declared: Sequence[str]) -> list[str]:
    """Return the texts of treatments, with those that a spreadsheet wrote in another way as they are in the config."""
    odd = set(texts).difference(declared) if declared else set()
    if not 0 < len(odd) * len(declared) <= _MOST_COMPARED:
        return list(texts)
    factor = Factor(name, list(dict.fromkeys(declared)))
    # Spreadsheets and pandas leave None empty.
    known = {"": str(None) if str(None) in declared else ""}
    for text in odd.difference(known):
        place = treatment_position(factor, text, decimal_comma=True)
        known[text] = text if place is None else factor.texts[place]
    return [known.get(text, text) for text in texts]


def _text(value: Any) -> str:
    return "" if value is None else str(value)


def _in_order(values: Iterable[Any]) -> list[str]:
    """Return the texts of treatments without a declared order: numbers ascending, others as they occur."""
    listed = list(values)
    if type_of_values(listed) in {"integer", "number"} and None not in listed:
        listed.sort()
    return list(map(_text, listed))


def _values(values: Sequence[Any], kind: str) -> Any:
    """Return a measure's values as an array of their common type; None becomes a missing value."""
    is_missing = all(value is None for value in values)
    found = type_of_values(values)
    if found == "any" and is_missing:
        found = kind
    if found == "integer" and any(abs(value) > _LARGEST for value in values if value is not None):
        found = "number"
    if found in _DTYPES:
        return pd.array(values, dtype=_DTYPES[found])
    return np.array(values, dtype=np.float64 if found == "number" or is_missing else object)
