"""Which combinations an experiment leaves out: by named treatments, or by a predicate."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import and_, or_
from typing import TYPE_CHECKING, Any

from robot_runner.core.design.factor import Combination, Factor
from robot_runner.core.design.factor_conditions import identified, impossible_treatments
from robot_runner.core.errors import DesignError, Finding, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Iterator


#: `{"Task": ["Video", "Network"], "Speed": 0.2}` leaves out what matches in *all* named factors;
#: a predicate leaves out the combinations for which it returns True.
Exclusion = Mapping[Any, Any] | Callable[[Combination], bool]

_WHERE = "exclude_combinations"

#: For each combination of a design, in order, whether something holds for it.
_Flags = list[bool]


@dataclass(frozen=True, slots=True)
class Exclusions:
    """What the exclusions of a design come to.

    Attributes:
        kept: the combinations that are executed, in order.
        errors: exclusions that name what there is not, or that raised.
        warnings: exclusions that remove nothing.
        cause: what a predicate raised.
    """

    kept: list[Combination]
    errors: tuple[Finding, ...] = ()
    warnings: tuple[Finding, ...] = ()
    cause: Exception | None = None


@dataclass(frozen=True, slots=True)
class _Matching:
    """For each combination, whether one exclusion matches; or what is wrong with that exclusion."""

    flags: _Flags
    errors: tuple[Finding, ...] = ()
    cause: Exception | None = None


class Allowed:
    """Whether the exclusions of a design leave a combination; nothing is enumerated.

    Attributes:
        forbidden: treatments that exclude each other, by the conditions of the factors and by each exclusion that is a
            mapping: the places of the treatments, by factor.
        predicates: the exclusions that only a whole combination answers.

    Example:
        >>> factors = [Factor("Task", ["Video", "Network"]), Factor("Speed", [0.1, 0.2])]
        >>> is_allowed = Allowed(factors, [{"Task": "Network", "Speed": 0.2}])
        >>> is_allowed.forbidden
        ({'Task': frozenset({1}), 'Speed': frozenset({1})},)
    """

    def __init__(self, factors: Sequence[Factor], exclusions: object) -> None:
        """Check the exclusions.

        Raises:
            DesignError: one names what there is not; `findings` lists everything that was found.
        """
        findings: list[Finding] = []
        forbidden: list[Mapping[str, frozenset[int]]] = []
        predicates: list[tuple[str, Callable[[Combination], object]]] = []
        for place, exclusion in enumerate(_checked(exclusions, findings)):
            where = f"{_WHERE}[{place}]"
            if isinstance(exclusion, Mapping):
                named, errors = _named(where, factors, exclusion)
                findings += errors
                forbidden.append(named)
            elif callable(exclusion):
                predicates.append((where, exclusion))
            else:
                findings.append(_no_exclusion(where, exclusion))
        if findings:
            raise DesignError.of_findings(findings)
        self.forbidden = (*impossible_treatments(factors), *forbidden)
        self.predicates = tuple(predicates)
        self._forbidden = identified(factors, self.forbidden)

    def __call__(self, combination: Combination) -> bool:
        """Return whether no exclusion matches.

        Raises:
            DesignError: a predicate raised.
        """
        for each in self._forbidden:
            if all(id(combination[name]) in treatments for name, treatments in each):
                return False
        for where, predicate in self.predicates:
            matching = _matching_predicate(where, [combination], predicate)
            if matching.errors:
                raise DesignError.of_findings(matching.errors) from matching.cause
            if matching.flags[0]:
                return False
        return True


def apply_exclusions(factors: Sequence[Factor], combinations: Sequence[Combination], exclusions: object) -> Exclusions:
    """Find out which combinations are left out."""
    left_out = [False] * len(combinations)
    errors: list[Finding] = []
    warnings: list[Finding] = []
    cause = None
    for place, exclusion in enumerate(_checked(exclusions, errors)):
        where = f"{_WHERE}[{place}]"
        matching = _matching(where, factors, combinations, exclusion)
        if matching.errors:
            errors += matching.errors
            cause = cause or matching.cause
            continue
        warnings += _idle(where, matching.flags, left_out)
        left_out = list(map(or_, left_out, matching.flags))
    if all(left_out):
        errors.append(Finding.error(_WHERE, "every combination is excluded", "Exclude fewer."))
    kept = [combination for combination, is_out in zip(combinations, left_out, strict=True) if not is_out]
    return Exclusions(kept, tuple(errors), tuple(warnings), cause)


def _checked(exclusions: object, findings: list[Finding]) -> Sequence[object]:
    if isinstance(exclusions, Sequence) and not isinstance(exclusions, str | bytes):
        return exclusions
    problem = f"{exclusions!r} is of type {type(exclusions).__name__}"
    findings.append(Finding.error(_WHERE, problem, "Give a list of exclusions."))
    return ()


def _no_exclusion(where: str, exclusion: object) -> Finding:
    problem = f"{exclusion!r} is of type {type(exclusion).__name__}"
    return Finding.error(where, problem, "Give a mapping from factors to treatments, or a function of a combination.")


def _matching(
    where: str, factors: Sequence[Factor], combinations: Sequence[Combination], exclusion: object
) -> _Matching:
    if isinstance(exclusion, Mapping):
        return _matching_treatments(where, factors, combinations, exclusion)
    if callable(exclusion):
        return _matching_predicate(where, combinations, exclusion)
    return _Matching([], (_no_exclusion(where, exclusion),))


def _matching_treatments(
    where: str, factors: Sequence[Factor], combinations: Sequence[Combination], exclusion: Mapping[Any, Any]
) -> _Matching:
    named, errors = _named(where, factors, exclusion)
    flags = [True] * len(combinations)
    by_name = {factor.name: factor for factor in factors}
    for name, places in named.items():
        # By identity, as combinations hold the factor's own objects: True equals 1, and some objects have no equality.
        chosen = {id(by_name[name].treatments[place]) for place in places}
        flags = list(map(and_, flags, [id(combination[name]) in chosen for combination in combinations]))
    return _Matching(flags, tuple(errors))


def _named(
    where: str, factors: Sequence[Factor], exclusion: Mapping[Any, Any]
) -> tuple[dict[str, frozenset[int]], list[Finding]]:
    """Return the places of the treatments that an exclusion names, by factor, and what is no factor or treatment."""
    if not exclusion:
        fix = "Name a factor and its treatments, or remove it."
        return {}, [Finding.error(where, "the exclusion names no factor", fix)]
    by_name = {factor.name: factor for factor in factors}
    named: dict[str, frozenset[int]] = {}
    errors: list[Finding] = []
    for key, wanted in exclusion.items():
        name = key.name if isinstance(key, Factor) else key
        if name not in by_name:
            errors.append(Finding.error(where, f"there is no factor {name!r}", did_you_mean(str(name), by_name)))
            continue
        factor = by_name[name]
        places = [(value, factor.position_of(value)) for value in _values(factor, wanted)]
        errors += [
            Finding.error(where, f"{value!r} is no treatment of factor {name!r}", factor.suggestion(value))
            for value, place in places
            if place is None
        ]
        named[name] = frozenset(place for _, place in places if place is not None)
    return named, errors


def _values(factor: Factor, wanted: Any) -> Sequence[Any]:
    if factor.position_of(wanted) is not None:
        return (wanted,)  # a treatment may itself be a tuple
    if isinstance(wanted, list | tuple | range):
        return wanted
    if isinstance(wanted, set | frozenset):
        return sorted(wanted, key=repr)
    return (wanted,)


def _matching_predicate(
    where: str, combinations: Sequence[Combination], predicate: Callable[[Combination], object]
) -> _Matching:
    flags = []
    for combination in combinations:
        try:
            flags.append(bool(predicate(combination)))
        except Exception as error:  # noqa: BLE001 - a user's predicate may raise anything
            return _Matching([], (_predicate_failed(where, combination, error),), error)
    return _Matching(flags)


def _predicate_failed(where: str, combination: Combination, error: Exception) -> Finding:
    name = error.args[0] if isinstance(error, KeyError) and error.args else None
    is_unknown_factor = isinstance(name, str) and name not in combination
    problem = f"the predicate raised {type(error).__name__}: {error} for the combination {combination}"
    return Finding.error(where, problem, did_you_mean(str(name), combination) if is_unknown_factor else "Mend it.")


def _idle(where: str, flags: _Flags, left_out: _Flags) -> Iterator[Finding]:
    if not any(flags):
        yield Finding.warning(where, "the exclusion matches no combination", "Remove it, or mend what it names.")
    elif not any(matches and not is_out for matches, is_out in zip(flags, left_out, strict=True)):
        yield Finding.warning(where, "the exclusion removes nothing: what it matches is excluded already", "Remove it.")
