"""The factors and run tables of the earlier tools, with the arguments of all their versions."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from robot_runner.core.design.planned_runs import RunOrder, arranged
from robot_runner.core.errors import ConfigError, Finding, did_you_mean
from robot_runner.legacy.earlier_exclusions import kept_combinations
from robot_runner.legacy.recognition import Dialect
from robot_runner.legacy.run_ids import Numbering, numbering_of
from robot_runner.legacy.session import Session, current_session
from robot_runner.legacy.stand_ins.machinery import RunProgress

#: The earlier tools' value of an empty cell.
MISSING = " "

_FACTORS = ("factors", "treatments")
_EXCLUSIONS = ("exclude_combinations", "exclude_variations")
_REPETITIONS = ("repetitions", "num_repetitions", "num_of_repetitions", "iterations")
_SHUFFLE = ("shuffle", "randomize_order")
_KNOWN = (*_FACTORS, *_EXCLUSIONS, *_REPETITIONS, "data_columns", *_SHUFFLE)


class FactorModel:
    """A factor and its treatments.

    Example:
        >>> FactorModel("Task", ["Video", "Network"]).treatments
        ['Video', 'Network']
    """

    def __init__(self, factor_name: str, treatments: Iterable[Any]) -> None:
        if isinstance(treatments, str | bytes | Mapping) or not isinstance(treatments, Iterable):
            problem = f"the treatments are {treatments!r}, of type {type(treatments).__name__}"
            raise ConfigError(problem, where=f"FactorModel {factor_name!r}", fix="Give a list.")
        self.factor_name = factor_name
        # The list itself, not a copy: a config may change it later.
        self.treatments: Sequence[Any] = (
            treatments if isinstance(treatments, list | tuple | range) else list(treatments)
        )

    def get_factor_name(self) -> str:
        """Return the name."""
        return self.factor_name

    def get_treatments(self) -> Sequence[Any]:
        """Return the treatments."""
        return self.treatments


class RunTableModel:
    """The plan of all runs, as in any public version of the earlier tools and their common forks.

    Positional arguments may be in the order of any version: their types (list, number, bool) identify them.

    Attributes:
        exclusions: the given exclusions.
        is_shuffled: whether the order is random.
        made: the rows that it has made so far.
    """

    def __init__(self, *arguments: Any, **named: Any) -> None:
        """Take factors, exclusions, repetitions, data columns and order, under the names of any version.

        Raises:
            ConfigError: an argument is unknown or has an invalid value.
        """
        ConfigError.refuse(
            Finding.error("RunTableModel", f"RunTableModel has no argument {name!r}", did_you_mean(name, _KNOWN))
            for name in sorted(set(named) - set(_KNOWN))
        )
        given = _by_position(arguments) | named
        self._arguments = {*named, *({"repetitions"} & set(given))}
        self._factors = _factors(_first(given, _FACTORS, ()))
        self.exclusions = _first(given, _EXCLUSIONS, ())
        self._repetitions = _repetitions(_first(given, _REPETITIONS, 1))
        self._data_columns = _data_columns(given.get("data_columns"))
        self.is_shuffled = bool(_first(given, _SHUFFLE, default=False))
        self._rows: list[dict[str, Any]] = []
        self.made: list[dict[str, Any]] = []
        session = current_session()
        session.models.append(self)
        session.model = self

    def get_factors(self) -> list[FactorModel]:
        """Return the factors."""
        return self._factors

    def get_data_columns(self) -> list[str]:
        """Return the list of the measures' columns, to which a config may append."""
        return self._data_columns

    def create_experiment_run_table(self) -> None:
        """Make the rows, for `get_experiment_run_table`."""
        self._rows[:] = self.generate_experiment_run_table()

    def get_experiment_run_table(self) -> list[dict[str, Any]]:
        """Return the rows that were made."""
        return self._rows

    def generate_experiment_run_table(self) -> list[dict[str, Any]]:
        """Make and return the rows: `__run_id`, `__done`, treatments, measures.

        Raises:
            ConfigError: an exclusion names something unknown.
        """
        session = current_session()
        for name in (factor.factor_name for factor in self._factors):
            if name in self._data_columns:
                session.warn(
                    "RunTableModel",
                    f"{name!r} is a factor and a data column: as in the earlier tool, callbacks do not get its "
                    "treatment, and its column has what populate_run_data returns",
                    "Take it out of data_columns, and apply context.execute_run[...].",
                )
        combinations = kept_combinations(session, self._factors, self.exclusions)
        numbering = numbering_of(session.recognised, self._arguments, self._repetitions)
        rows = (
            self._repeated_in_place(combinations, session)
            if numbering is Numbering.COUNTED_FROM_1
            else self._repeated_as_a_whole(combinations, session, numbering)
        )
        blanks = dict.fromkeys(self._data_columns, MISSING)
        made = [{"__run_id": run_id, "__done": RunProgress.TODO, **treatments, **blanks} for run_id, treatments in rows]
        self.made += made
        return made

    def _repeated_as_a_whole(
        self, combinations: Sequence[Sequence[Any]], session: Session, numbering: Numbering
    ) -> list[tuple[str, dict[str, Any]]]:
        rows = [
            (numbering.run_id(place, repetition), self._treatments(combination))
            for repetition in range(self._repetitions)
            for place, combination in enumerate(combinations)
        ]
        return [rows[place] for place in self._order(len(rows), session)]

    def _repeated_in_place(
        self, combinations: Sequence[Sequence[Any]], session: Session
    ) -> list[tuple[str, dict[str, Any]]]:
        """Make the rows as a public fork did: ids in the order of execution, and a column `repetition`."""
        runs = [place for place in range(len(combinations)) for _ in range(self._repetitions)]
        ordered = [runs[place] for place in self._order(len(runs), session, is_of_fork=True)]
        counts = dict.fromkeys(range(len(combinations)), 0)
        rows = []
        for number, place in enumerate(ordered):
            counts[place] += 1
            treatments = self._treatments(combinations[place])
            if self._repetitions > 1:
                treatments["repetition"] = counts[place]
            rows.append((Numbering.COUNTED_FROM_1.run_id(number, 0), treatments))
        return rows

    def _order(self, count: int, session: Session, *, is_of_fork: bool = False) -> Sequence[int]:
        if self.is_shuffled and session.own_seed is not None:
            # As the earlier tools did, so that the config's own seed yields the same order.
            places = list(range(count))
            if is_of_fork and self._repetitions == 1:
                return random.sample(places, count)
            random.shuffle(places)
            return places
        return arranged(count, None, RunOrder(shuffle=self.is_shuffled, seed=session.seed))

    def _treatments(self, combination: Sequence[Any]) -> dict[str, Any]:
        return {factor.factor_name: value for factor, value in zip(self._factors, combination, strict=True)}


def _by_position(arguments: Sequence[Any]) -> dict[str, Any]:
    """Name positional arguments by their types: only the first two have the same position in all versions."""
    given = dict(zip(("factors", "exclude_variations"), arguments, strict=False))
    for value in arguments[2:]:
        if isinstance(value, bool):
            given["shuffle"] = value
        elif isinstance(value, int):
            given["repetitions"] = value
        else:
            given["data_columns"] = value
    return given


def _first(given: Mapping[str, Any], names: Sequence[str], default: Any) -> Any:
    return next((given[name] for name in names if name in given), default)


def _factors(factors: Any) -> list[FactorModel]:
    listed = list(factors) if isinstance(factors, Iterable) and not isinstance(factors, str) else [factors]
    for factor in listed:
        if not isinstance(factor, FactorModel):
            fix = "Give a list such as [FactorModel('Task', ['Video', 'Network'])]."
            raise ConfigError(f"{factor!r} is not a factor", where="RunTableModel, factors", fix=fix)
    _check_equal_names("factor", [factor.factor_name for factor in listed])
    if current_session().recognised.dialect is Dialect.EXPERIMENT_RUNNER:
        _check_equal_treatments(listed)
    return listed


def _check_equal_names(kind: str, names: Sequence[Any]) -> None:
    ConfigError.refuse(
        Finding.error("RunTableModel", f"two {kind}s are called {name!r}", "Give each a name of its own.")
        for name, count in Counter(map(str, names)).items()
        if count > 1
    )


def _check_equal_treatments(factors: Sequence[FactorModel]) -> None:
    # Robot Runner made two runs of a treatment that is given twice; Experiment Runner refused it.
    for factor in factors:
        texts = [(type(value), str(value)) for value in factor.treatments]
        for place, text in enumerate(texts):
            if texts.index(text) < place:
                problem = f"treatment {factor.treatments[place]!r} is given twice"
                fix = "Remove one; `repetitions` executes each combination several times."
                raise ConfigError(problem, where=f"FactorModel {factor.factor_name!r}", fix=fix)


def _repetitions(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        fix = "Give a whole number, 1 or more."
        raise ConfigError(f"the number of repetitions is {value!r}", where="RunTableModel", fix=fix)
    return value


def _data_columns(value: Any) -> list[str]:
    if value is None:
        return []
    if isinstance(value, str) or not isinstance(value, Iterable):
        fix = "Give a list of names."
        raise ConfigError(f"data_columns is {value!r}, of type {type(value).__name__}", where="RunTableModel", fix=fix)
    columns = value if isinstance(value, list) else list(value)
    _check_equal_names("data column", columns)
    return columns
