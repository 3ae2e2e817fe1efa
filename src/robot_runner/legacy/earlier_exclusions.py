"""The excluded combinations of a config of an earlier tool, as intended, with warnings of the tool's errors.

Robot Runner's exclusions were sets of values without factors: `{"on", 3}` excluded each combination with both values
in any factors. Experiment Runner's are mappings from factors to lists of treatments; if two of them matched the same
combination, the tool also excluded a neighbour.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any, Protocol

from robot_runner.core.design.factor import treatments_are_equal
from robot_runner.core.errors import ConfigError, did_you_mean
from robot_runner.legacy.session import Session
from robot_runner.legacy.syntax import nodes

_WHERE = "exclusions"
_SHOWN = 3


class EarlierFactor(Protocol):
    """The attributes of a factor that are used here."""

    factor_name: str
    treatments: Sequence[Any]


@dataclass(frozen=True, slots=True)
class NamedExclusion:
    """One exclusion with its factors.

    Attributes:
        treatments: the treatments that are excluded together, by the factor's index; None if the assignment of values
            to factors is not evident.
        values: the values of a set without factors; empty for a mapping.
        has_unknown: whether it has a value that is not a treatment of its factor.
    """

    treatments: Mapping[int, Sequence[Any]] | None
    values: tuple[Any, ...] = ()
    has_unknown: bool = False

    @property
    def names_nothing(self) -> bool:
        """Whether it has no treatments for one of its factors, so that it matches no combination."""
        return self.treatments is not None and not all(self.treatments.values())

    def matches(self, combination: Sequence[Any]) -> bool:
        """Return whether a combination is excluded."""
        if self.treatments is not None:
            return all(_is_among(combination[place], wanted) for place, wanted in self.treatments.items())
        return all(any(treatment == value for treatment in combination) for value in self.values)


def kept_combinations(session: Session, factors: Sequence[EarlierFactor], exclusions: Any) -> list[tuple[Any, ...]]:
    """Return the combinations that are executed; the last factor changes fastest.

    Raises:
        ConfigError: a factor has no treatments, an exclusion names something unknown, or everything is excluded.
    """
    for factor in factors:
        if not len(factor.treatments):
            raise ConfigError("there are no treatments", where=f"FactorModel {factor.factor_name!r}", fix="Give some.")
    combinations = list(product(*(factor.treatments for factor in factors)))
    named = named_exclusions(session, factors, exclusions)
    kept = [combination for combination in combinations if not any(each.matches(combination) for each in named)]
    _warn_of_idle(session, named, combinations)
    _warn_of_overlap(session, named, combinations)
    if not kept:
        raise ConfigError("every combination is excluded", where=_WHERE, fix="Exclude fewer.")
    return kept


def named_exclusions(session: Session, factors: Sequence[EarlierFactor], exclusions: Any) -> list[NamedExclusion]:
    """Return the exclusions with their factors.

    Raises:
        ConfigError: an exclusion is neither a set nor a mapping, or names something unknown.
    """
    if isinstance(exclusions, Mapping) and not exclusions:
        return []
    if isinstance(exclusions, str | Mapping) or not isinstance(exclusions, Iterable | None):
        raise ConfigError(f"the exclusions are {exclusions!r}", where=_WHERE, fix="Give a list of them.")
    return [_named(session, factors, exclusion) for exclusion in exclusions or ()]


def _named(session: Session, factors: Sequence[EarlierFactor], exclusion: Any) -> NamedExclusion:
    if isinstance(exclusion, Mapping):
        treatments = dict(_named_by_user(session, factors, exclusion))
        given = sum(len(_listed(wanted)) for wanted in exclusion.values())
        return NamedExclusion(treatments, has_unknown=given > sum(map(len, treatments.values())))
    if isinstance(exclusion, set | frozenset | list | tuple):
        return _SetOfValues(session, factors, exclusion).named()
    fix = "Give a mapping from factors to lists of treatments, or a set of treatments."
    raise ConfigError(f"an exclusion is {exclusion!r}, of type {type(exclusion).__name__}", where=_WHERE, fix=fix)


def _named_by_user(
    session: Session, factors: Sequence[EarlierFactor], exclusion: Mapping[Any, Any]
) -> Iterator[tuple[int, Sequence[Any]]]:
    names = [factor.factor_name for factor in factors]
    for key, wanted in exclusion.items():
        name = getattr(key, "factor_name", key)
        if name not in names:
            fix = did_you_mean(str(name), names)
            raise ConfigError(f"there is no factor {name!r} in the run table", where=_WHERE, fix=fix)
        place = names.index(name)
        treatments = _listed(wanted)
        for value in treatments:
            if not _resolved(value, factors[place].treatments):
                fix = did_you_mean(str(value), map(str, factors[place].treatments))
                session.warn(_WHERE, f"{value!r} is not a treatment of factor {name!r}, so it excludes nothing", fix)
        yield place, [each for value in treatments for each in _resolved(value, factors[place].treatments)]


def _listed(wanted: Any) -> Sequence[Any]:
    if isinstance(wanted, str | bytes) or not isinstance(wanted, Iterable):
        return (wanted,)
    return tuple(wanted)


class _SetOfValues:
    """A set of values, each of which may be a treatment of several factors."""

    def __init__(self, session: Session, factors: Sequence[EarlierFactor], values: Iterable[Any]) -> None:
        self._session = session
        self._factors = factors
        self._is_ordered = isinstance(values, list | tuple)
        self._values = tuple(values) if self._is_ordered else self._as_written(frozenset(values))
        self._candidates = [self._places_of(value) for value in self._values]

    def named(self) -> NamedExclusion:
        """Return the exclusion with its factors, as far as they are evident."""
        if not all(self._candidates):
            return NamedExclusion(None, self._values)  # an unknown value: it matches nothing
        assignments = list(self._assignments())
        if all(len(places) == 1 for places in self._candidates):
            self._warn_of_equals(assignments)
            return NamedExclusion(assignments[0] if assignments else None, self._values)
        if len(self._values) > 1 and self._is_ordered and len(assignments) == 1:
            self._warn_of_choice(assignments[0])
            return NamedExclusion(assignments[0], self._values)
        self._warn_of_doubt()
        return NamedExclusion(None, self._values)

    def _as_written(self, values: frozenset[Any]) -> tuple[Any, ...]:
        """Return the values in the order of the first such set literal in the file; sorted if there is none."""
        for node in nodes(self._session.recognised.tree, ast.Set):
            try:
                written = tuple(ast.literal_eval(element) for element in node.elts)
            except ValueError:
                continue
            if len(written) == len(values) and set(written) == values and len(set(written)) == len(written):
                self._is_ordered = True
                return written
        return tuple(sorted(values, key=repr))

    def _places_of(self, value: Any) -> list[int]:
        """Return the indices of the factors with this treatment: True and 1 differ if both are treatments."""
        places = [
            (place, type(treatment) is type(value))
            for place, factor in enumerate(self._factors)
            for treatment in factor.treatments
            if treatment == value
        ]
        exact = [place for place, same_type in places if same_type]
        return list(dict.fromkeys(exact or [place for place, _ in places]))

    def _assignments(self) -> Iterator[Mapping[int, Sequence[Any]]]:
        """Yield the assignments of values to different factors; the values are in the order of the factors."""
        is_fixed = all(len(places) == 1 for places in self._candidates)
        for places in product(*self._candidates):
            if len(set(places)) == len(places) and (is_fixed or all(one < other for one, other in pairwise(places))):
                yield {
                    place: _resolved(value, self._factors[place].treatments)
                    for place, value in zip(places, self._values, strict=True)
                }

    def _warn_of_equals(self, assignments: Sequence[Mapping[int, Sequence[Any]]]) -> None:
        if not assignments:
            return
        hit = [
            (values[0], factor.factor_name, place)
            for place, values in assignments[0].items()
            for other, factor in enumerate(self._factors)
            if other != place and any(treatment == values[0] for treatment in factor.treatments)
        ]
        for value, name, place in hit:
            self._session.warn(
                _WHERE,
                f"{self._shown} names {value!r} of factor {self._factors[place].factor_name!r}; the earlier tool also "
                f"left out runs with the equal value of factor {name!r}, which are executed now",
                f"Write {{{self._factors[place].factor_name!r}: {value!r}}} in our own spelling.",
            )

    def _warn_of_choice(self, assignment: Mapping[int, Sequence[Any]]) -> None:
        meant = ", ".join(f"{self._factors[place].factor_name}={values[0]!r}" for place, values in assignment.items())
        self._session.warn(
            _WHERE,
            f"{self._shown} is taken for {meant}, in the order of the factors; the earlier tool also left out every "
            "other combination of these values, which are executed now",
            "Name the factors, as in {factor: [treatment]}, if something else was meant.",
        )

    def _warn_of_doubt(self) -> None:
        several = next(
            (value, places) for value, places in zip(self._values, self._candidates, strict=True) if len(places) > 1
        )
        names = " and ".join(repr(self._factors[place].factor_name) for place in several[1])
        problem = (
            f"{self._shown} does not say whether {several[0]!r} of {names} is meant: as in the earlier tool, runs that "
            "have it in any of them are left out"
        )
        self._session.warn(_WHERE, problem, "Name the factor, as in {factor: [treatment]}.")

    @property
    def _shown(self) -> str:
        return "{" + ", ".join(map(repr, self._values)) + "}"


def _resolved(value: Any, treatments: Sequence[Any]) -> list[Any]:
    """Return the treatments that a value denotes: those of its type, else equal ones."""
    exact = [treatment for treatment in treatments if _is_same(treatment, value)]
    return exact or [each for each in treatments if treatments_are_equal(_as_number(each), _as_number(value))]


def _as_number(value: Any) -> Any:
    """Return a bool as a number, for comparisons as in the earlier tools."""
    return int(value) if isinstance(value, bool) else value


def _is_same(one: Any, other: Any) -> bool:
    return one is other or (type(one) is type(other) and treatments_are_equal(one, other))


def _is_among(value: Any, treatments: Iterable[Any]) -> bool:
    return any(_is_same(treatment, value) for treatment in treatments)


def _warn_of_idle(session: Session, named: Sequence[NamedExclusion], combinations: Sequence[Sequence[Any]]) -> None:
    for place, exclusion in enumerate(named):
        if not any(exclusion.matches(combination) for combination in combinations):
            problem = f"exclusion {place + 1} matches no combination"
            session.warn(_WHERE, problem, "Remove it, or correct what it names.")


def _warn_of_overlap(session: Session, named: Sequence[NamedExclusion], combinations: Sequence[Sequence[Any]]) -> None:
    """Warn if Experiment Runner, which deleted by index, also deleted a neighbour."""
    if not all(exclusion.values == () for exclusion in named):
        return
    hits = [place for place, each in enumerate(combinations) for named_one in named if named_one.matches(each)]
    left = list(range(len(combinations)))
    for place in sorted(hits, reverse=True):
        del left[place : place + 1]
    lost = [combinations[place] for place in set(range(len(combinations))) - set(hits) - set(left)]
    if lost:
        shown = ", ".join(map(repr, lost[:_SHOWN]))
        more = f" and {len(lost) - _SHOWN} more" if len(lost) > _SHOWN else ""
        problem = (
            f"two exclusions match one combination; the earlier tool then also left out {shown}{more}, which no "
            "exclusion names: they are executed now"
        )
        session.warn(_WHERE, problem, "Make the exclusions disjoint, to have the same run table everywhere.")
