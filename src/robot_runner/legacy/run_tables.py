"""Convert the run table of a config of an earlier tool to a design of ours."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

from robot_runner.core.design.columns import reserved_names
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.listed_runs import ListedRun, ListedRunTableModel
from robot_runner.core.design.planned_runs import RunOrder
from robot_runner.core.errors import ConfigError, did_you_mean
from robot_runner.core.storage.table_columns import EARLIER_SPELLING, TableSpelling
from robot_runner.legacy.session import Session
from robot_runner.legacy.stand_ins.machinery import RunProgress
from robot_runner.legacy.stand_ins.models import RunTableModel

#: The headings of a run's id and progress.
PROGRESS = ("__run_id", "__done")


def named_columns(columns: Iterable[Any]) -> Mapping[Any, str]:
    """Return a name for each column that does not clash with our own columns, such as `status`.

    Example:
        >>> dict(named_columns(["Task", "status"]))
        {'Task': 'Task', 'status': 'status_'}
    """
    taken = {name.casefold() for name in reserved_names(1)}
    names: dict[Any, str] = {}
    for column in columns:
        name = str(column).strip()
        while name.casefold() in taken:
            name += "_"
        names[column] = name
        if name != str(column):
            taken.add(name.casefold())
    return MappingProxyType(names)


_ADDRESS = re.compile(r" at 0x[0-9A-Fa-f]+")


@dataclass(frozen=True, slots=True, eq=False)
class ShownTreatment:
    """A treatment with another text in the table, since its own could not be recognised when resuming.

    Example:
        >>> str(ShownTreatment(print, "print"))
        'print'
    """

    value: Any
    text: str

    def __str__(self) -> str:
        return self.text

    def __repr__(self) -> str:
        return self.text


def value_of(treatment: Any) -> Any:
    """Return the value of a treatment for callbacks."""
    return treatment.value if isinstance(treatment, ShownTreatment) else treatment


def shown_treatments(values: Iterable[Any], warn: Callable[[Any, str], None]) -> list[tuple[Any, Any]]:
    """Return each distinct value with its treatment in the design.

    Args:
        values: in order, with repetitions.
        warn: called with a value whose text had to be changed, and its new text.
    """
    shown: list[tuple[Any, Any]] = []
    texts: set[str] = set()
    for value in values:
        if any(_is_same(value, known) for known, _ in shown):
            continue
        text = str(value)
        fit = _fit_text(value, text, texts)
        texts.add(fit)
        if fit == text:
            shown.append((value, value))
        else:
            warn(value, fit)
            shown.append((value, ShownTreatment(value, fit)))
    return shown


def _is_same(one: Any, other: Any) -> bool:
    if one is other:
        return True
    return type(one) is type(other) and not _ADDRESS.search(str(one)) and str(one) == str(other)


def _fit_text(value: Any, text: str, taken: set[str]) -> str:
    if isinstance(value, set | frozenset) and len(value) > 1:
        text = "{" + ", ".join(sorted(map(repr, value))) + "}"  # the order in a set's text differs between processes
    elif _ADDRESS.search(text):
        text = getattr(value, "__qualname__", None) or type(value).__name__
    elif text in taken:
        text = repr(value)
    unique, number = text, 1
    while unique in taken:
        number += 1
        unique = f"{text}_{number}"
    return unique


_WHERE = "run table"
_RUN_ID, _DONE = PROGRESS


#: Robot Runner had no repetitions: configs have a factor that counts them, called so, whose treatments are numbered.
_COUNTER = re.compile(r"(?i)(.*_)?(rep|repeat|repetition|replication|run|iter|iteration|trial|round)s?(_.*)?")


def _counts_runs(column: Any, treatments: Sequence[Any]) -> bool:
    """Return whether a factor counts runs, from 0 or 1 on; `iterations` of 100 and 1000 are what is varied."""
    numbers = sorted(int(found[0]) for each in treatments if (found := re.search(r"(?<![.0-9])[0-9]+$", str(each))))
    is_counted = numbers in (list(range(len(treatments))), list(range(1, len(treatments) + 1)))
    return is_counted and _COUNTER.fullmatch(str(column)) is not None


@dataclass(frozen=True, slots=True)
class EarlierDesign:
    """The run table of a config.

    Attributes:
        model: the design.
        names: our names of its columns.
        factors: the columns of factors, by the config's names.
        data_columns: the columns of measures.
    """

    model: ListedRunTableModel
    names: Mapping[Any, str]
    factors: tuple[Any, ...]
    data_columns: tuple[Any, ...]

    @property
    def counting(self) -> tuple[Any, ...]:
        """The columns of factors that count runs."""
        treatments = {factor.name: factor.treatments for factor in self.model.factors}
        return tuple(column for column in self.factors if _counts_runs(column, treatments[self.names[column]]))

    @property
    def spelling(self) -> TableSpelling:
        """The spelling of the headings in the run table's file."""
        others = {name: str(column) for column, name in self.names.items() if name != str(column)}
        return replace(EARLIER_SPELLING, headings=MappingProxyType({**EARLIER_SPELLING.headings, **others}))


def design_of(session: Session, returned: Any, config: Any, more_columns: Sequence[str] = ()) -> EarlierDesign:
    """Return the design of the value returned by `create_run_table` or `create_run_table_model`.

    That is a model or a list of rows; Experiment Runner's configs may keep the model in an attribute instead. The tool
    itself adds `more_columns` for measures.

    Raises:
        ConfigError: the value is neither, or a row is invalid.
    """
    if returned is None:
        returned = getattr(config, "run_table_model", None)
    if isinstance(returned, RunTableModel):
        returned = returned.generate_experiment_run_table()
    rows = _checked_rows(returned)
    given = set(map(id, rows))
    # Of several models, the last one that made any of these rows; a config that copies them leaves the last one made.
    session.model = next((each for each in reversed(session.models) if given & set(map(id, each.made))), session.model)
    model = session.model
    if model is not None:
        _check_names(model)
    factors, data_columns = _columns_of(rows, model)
    data_columns += [column for column in more_columns if column not in data_columns]
    names = named_columns([*factors, *data_columns])
    seed = session.seed if session.own_seed is None else session.own_seed
    treatments = {column: _treatments(session, column, rows, model) for column in factors}
    design = ListedRunTableModel(
        [Factor(names[column], [shown for _, shown in treatments[column]]) for column in factors],
        _listed_runs(session, rows, treatments, names),
        data_columns=[names[column] for column in data_columns],
        order=RunOrder(
            shuffle=model is not None and model.is_shuffled, seed=seed, seed_is_given=session.own_seed is not None
        ),
    )
    return EarlierDesign(design, names, tuple(factors), tuple(data_columns))


def _check_names(model: RunTableModel) -> None:
    """Refuse a factor or a measure with the name of one of the tool's own columns, which would replace it.

    Raises:
        ConfigError: a name is taken.
    """
    named = [("factor", factor.factor_name) for factor in model.get_factors()]
    named += [("measure", column) for column in model.get_data_columns()]
    for kind, name in named:
        if name in PROGRESS:
            problem = f"a {kind} is named {name!r}, which is the tool's own column: it would be lost"
            raise ConfigError(problem, where=_WHERE, fix=f"Name it {str(name).strip('_')!r}.")


def _checked_rows(returned: Any) -> list[Mapping[Any, Any]]:
    if not isinstance(returned, list | tuple):
        fix = "Return the RunTableModel, or the rows of its get_experiment_run_table()."
        raise ConfigError(f"the config returned {returned!r}, of type {type(returned).__name__}", where=_WHERE, fix=fix)
    if not returned:
        fix = "Call create_experiment_run_table() before get_experiment_run_table()."
        raise ConfigError("the run table has no runs", where=_WHERE, fix=fix)
    for row in returned:
        if not isinstance(row, Mapping):
            raise ConfigError(f"a row is {row!r}", where=_WHERE, fix="Make each row a dict.")
    return list(returned)


def _columns_of(rows: Sequence[Mapping[Any, Any]], model: RunTableModel | None) -> tuple[list[Any], list[Any]]:
    """Return the columns of factors and of measures: by the model of the rows; other columns by their cells."""
    columns = [column for column in dict.fromkeys(name for row in rows for name in row) if column not in PROGRESS]
    measures = set(model.get_data_columns()) if model is not None else set()
    known = {factor.factor_name for factor in model.get_factors()} if model is not None else set()

    def is_measure(column: Any) -> bool:
        if column in measures or column in known:
            return column in measures
        return all(is_blank(row.get(column)) for row in rows)

    factors = [column for column in columns if not is_measure(column)]
    return factors, [column for column in columns if is_measure(column)]


def _treatments(
    session: Session, column: Any, rows: Sequence[Mapping[Any, Any]], model: RunTableModel | None
) -> list[tuple[Any, Any]]:
    factors = model.get_factors() if model is not None else ()
    listed = next((factor.treatments for factor in factors if factor.factor_name == column), ())

    def warn(value: Any, text: str) -> None:
        problem = f"treatment {value!r} could not be recognised when resuming; in the run table it is {text!r}"
        fix = f"Give {type(value).__name__} a __str__ that tells it from the others, or vary a name."
        session.warn(f"factor {column!r}", problem, fix)

    return shown_treatments([*listed, *(row.get(column, "") for row in rows)], warn)


def _listed_runs(
    session: Session,
    rows: Sequence[Mapping[Any, Any]],
    treatments: Mapping[Any, list[tuple[Any, Any]]],
    names: Mapping[Any, str],
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


def is_blank(value: Any) -> bool:
    """Return whether a cell is empty."""
    return value is None or (isinstance(value, str) and not value.strip())
