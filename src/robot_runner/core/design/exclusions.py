"""Which combinations an experiment leaves out: by named treatments, or by a predicate."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import and_, or_
from typing import TYPE_CHECKING, Any

from robot_runner.core.design.factor import Combination, Factor
from robot_runner.core.errors import Finding, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["Exclusion", "Exclusions", "apply_exclusions"]

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


def apply_exclusions(factors: Sequence[Factor], combinations: Sequence[Combination], exclusions: object) -> Exclusions:
    """Find out which combinations are left out.

    Args:
        factors: the factors of the design.
        combinations: every combination of the factors' treatments.
        exclusions: mappings and predicates, see `Exclusion`.
    """
    if not isinstance(exclusions, Sequence) or isinstance(exclusions, str | bytes):
        problem = f"{exclusions!r} is of type {type(exclusions).__name__}"
        return Exclusions([], (Finding.error(_WHERE, problem, "Give a list of exclusions."),))
    left_out = [False] * len(combinations)
    errors: list[Finding] = []
    warnings: list[Finding] = []
    cause = None
    for place, exclusion in enumerate(exclusions):
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


def _matching(
    where: str, factors: Sequence[Factor], combinations: Sequence[Combination], exclusion: object
) -> _Matching:
    if isinstance(exclusion, Mapping):
        return _matching_treatments(where, factors, combinations, exclusion)
    if callable(exclusion):
        return _matching_predicate(where, combinations, exclusion)
    problem = f"{exclusion!r} is of type {type(exclusion).__name__}"
    fix = "Give a mapping from factors to treatments, or a function of a combination."
    return _Matching([], (Finding.error(where, problem, fix),))


def _matching_treatments(
    where: str, factors: Sequence[Factor], combinations: Sequence[Combination], exclusion: Mapping[Any, Any]
) -> _Matching:
    if not exclusion:
        fix = "Name a factor and its treatments, or remove it."
        return _Matching([], (Finding.error(where, "the exclusion names no factor", fix),))
    by_name = {factor.name: factor for factor in factors}
    errors: list[Finding] = []
    flags = [True] * len(combinations)
    for key, wanted in exclusion.items():
        name = key.name if isinstance(key, Factor) else key
        if name not in by_name:
            errors.append(Finding.error(where, f"there is no factor {name!r}", did_you_mean(str(name), by_name)))
            continue
        chosen, unknown = _chosen(by_name[name], wanted)
        errors += [
            Finding.error(where, f"{value!r} is no treatment of factor {name!r}", by_name[name].suggestion(value))
            for value in unknown
        ]
        flags = list(map(and_, flags, [id(combination[name]) in chosen for combination in combinations]))
    return _Matching(flags, tuple(errors))


def _chosen(factor: Factor, wanted: Any) -> tuple[set[int], list[Any]]:
    """Return the identities of the treatments of `factor` that are wanted, and what is no treatment of it.

    By identity, as combinations hold the factor's own objects: True equals 1, and some objects have no equality.
    """
    chosen: set[int] = set()
    unknown = []
    for value in _values(factor, wanted):
        place = factor.position_of(value)
        if place is None:
            unknown.append(value)
        else:
            chosen.add(id(factor.treatments[place]))
    return chosen, unknown


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
