"""From the run table that a config of an earlier tool made to a design of ours."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from robot_runner.design.factor import Factor
from robot_runner.design.listed_runs import ListedRun, ListedRunTableModel
from robot_runner.design.order import RunOrder
from robot_runner.dialects.names import PROGRESS, ColumnNames, named_columns
from robot_runner.dialects.stand_ins.models import RunTableModel
from robot_runner.dialects.stand_ins.progress import RunProgress
from robot_runner.dialects.treatments import shown_treatments
from robot_runner.errors import ConfigError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robot_runner.dialects.session import Session

__all__ = ["EarlierDesign", "design_of"]

_WHERE = "run table"
_RUN_ID, _DONE = PROGRESS


@dataclass(frozen=True, slots=True)
class EarlierDesign:
    """The run table of a config.

    Attributes:
        model: as a design of ours.
        names: our names of its columns.
        factors: the columns that are factors, as the config calls them.
        data_columns: those that are measures.
    """

    model: ListedRunTableModel
    names: ColumnNames
    factors: tuple[Any, ...]
    data_columns: tuple[Any, ...]


def design_of(session: Session, returned: Any, config: Any, more_columns: Sequence[str] = ()) -> EarlierDesign:
    """Return the design of what `create_run_table` or `create_run_table_model` returned.

    Args:
        session: takes what is to be said about it.
        returned: a `RunTableModel`, or a list of rows.
        config: the config; Experiment Runner's kept its model in an attribute.
        more_columns: measures that the tool itself adds.

    Raises:
        ConfigError: it is neither, or a row is not as it should be.
    """
    if returned is None:
        returned = getattr(config, "run_table_model", None)
    if isinstance(returned, RunTableModel):
        returned = returned.generate_experiment_run_table()
    rows = _checked_rows(returned)
    model = session.models[-1] if session.models else None
    factors, data_columns = _columns_of(rows, model)
    data_columns += [column for column in more_columns if column not in data_columns]
    names = named_columns([*factors, *data_columns])
    treatments = {column: _treatments(session, column, rows, model) for column in factors}
    design = ListedRunTableModel(
        [Factor(names[column], [shown for _, shown in treatments[column]]) for column in factors],
        _listed_runs(session, rows, treatments, names),
        data_columns=[names[column] for column in data_columns],
        order=RunOrder(shuffle=model is not None and model.is_shuffled, seed=session.seed),
    )
    return EarlierDesign(design, names, tuple(factors), tuple(data_columns))


def _checked_rows(returned: Any) -> list[Mapping[Any, Any]]:
    if not isinstance(returned, list | tuple):
        raise ConfigError(
            f"it returned {returned!r}, of type {type(returned).__name__}",
            where=_WHERE,
            fix="Return the RunTableModel, or the rows of its get_experiment_run_table().",
        )
    if not returned:
        raise ConfigError(
            "it has no runs",
            where=_WHERE,
            fix="Call create_experiment_run_table() before get_experiment_run_table().",
        )
    for row in returned:
        if not isinstance(row, Mapping):
            raise ConfigError(f"a row is {row!r}", where=_WHERE, fix="Make each row a dict.")
    return list(returned)


def _columns_of(rows: Sequence[Mapping[Any, Any]], model: RunTableModel | None) -> tuple[list[Any], list[Any]]:
    """Tell factors and measures apart: by the model that the rows are from; what it does not know, by its cells."""
    columns = [column for column in dict.fromkeys(name for row in rows for name in row) if column not in PROGRESS]
    measures = set(model.get_data_columns()) if model is not None else set()
    known = {factor.factor_name for factor in model.get_factors()} if model is not None else set()

    def is_measure(column: Any) -> bool:
        if column in measures or column in known:
            return column in measures
        return all(_is_blank(row.get(column)) for row in rows)

    factors = [column for column in columns if not is_measure(column)]
    return factors, [column for column in columns if is_measure(column)]


def _treatments(
    session: Session, column: Any, rows: Sequence[Mapping[Any, Any]], model: RunTableModel | None
) -> list[tuple[Any, Any]]:
    listed = next(
        (factor.treatments for factor in (model.get_factors() if model else ()) if factor.factor_name == column), ()
    )

    def warn(value: Any, text: str) -> None:
        session.warn(
            f"factor {column!r}",
            f"treatment {value!r} could not be recognised when resuming; in the run table it is {text!r}",
            f"Give {type(value).__name__} a __str__ that tells it from the others, or vary a name.",
        )

    return shown_treatments([*listed, *(row.get(column, "") for row in rows)], warn)


def _listed_runs(
    session: Session,
    rows: Sequence[Mapping[Any, Any]],
    treatments: Mapping[Any, list[tuple[Any, Any]]],
    names: ColumnNames,
) -> list[ListedRun]:
    runs = []
    seen: dict[tuple[str, ...], int] = {}
    by_identity = {column: {id(value): shown for value, shown in pairs} for column, pairs in treatments.items()}
    by_text = {
        column: {(type(value), str(value)): shown for value, shown in pairs} for column, pairs in treatments.items()
    }
    for place, row in enumerate(rows):
        if _is_done(row):
            session.warn(_WHERE, f"the row {row.get(_RUN_ID)!r} is done already: it is not executed")
            continue
        chosen = {}
        for column in treatments:
            value = row.get(column, "")
            shown = by_identity[column].get(id(value))
            chosen[names[column]] = by_text[column][type(value), str(value)] if shown is None else shown
        combination = tuple(map(str, chosen.values()))
        seen[combination] = seen.get(combination, 0) + 1
        runs.append(ListedRun(_run_id(session, row, place), chosen, seen[combination]))
    return runs


def _run_id(session: Session, row: Mapping[Any, Any], place: int) -> str:
    if _RUN_ID in row:
        return str(row[_RUN_ID])
    hint = did_you_mean(_RUN_ID, [str(name) for name in row])
    session.warn(_WHERE, f"rows have no {_RUN_ID!r}: they are numbered", hint if "mean" in hint else "")
    return f"run_{place}"


def _is_done(row: Mapping[Any, Any]) -> bool:
    done = row.get(_DONE)
    return done is RunProgress.DONE or done == RunProgress.DONE.name


def _is_blank(value: Any) -> bool:
    return value is None or (isinstance(value, str) and not value.strip())
