"""Which combinations an experiment leaves out: by named treatments, or by a predicate."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import and_, or_
from typing import TYPE_CHECKING, Any

from robot_runner.core.design.factor import Combination, Factor, combinations_of
from robot_runner.core.errors import Finding, did_you_mean

if TYPE_CHECKING:
    from array import array
    from collections.abc import Iterator

__all__ = ["Exclusion", "Exclusions", "apply_exclusions"]

#: `{"Task": ["Video", "Network"], "Speed": 0.2}` leaves out what matches in *all* named factors;
#: a predicate leaves out the combinations for which it returns True.
Exclusion = Mapping[Any, Any] | Callable[[Combination], bool]

_WHERE = "exclude_combinations"
_OPPOSITE = bytes([1, 0]) + bytes(254)


@dataclass(frozen=True, slots=True)
class Exclusions:
    """What the exclusions of a design come to.

    Attributes:
        keep: for each combination of the full factorial, 1 where it is executed and 0 where it is left out.
        errors: exclusions that name what there is not, or that raised.
        warnings: exclusions that remove nothing.
        cause: what a predicate raised.
    """

    keep: bytes
    errors: tuple[Finding, ...] = ()
    warnings: tuple[Finding, ...] = ()
    cause: Exception | None = None


@dataclass(frozen=True, slots=True)
class _Matching:
    """For each combination, 1 where one exclusion matches; or what is wrong with that exclusion."""

    flags: bytes = b""
    errors: tuple[Finding, ...] = ()
    cause: Exception | None = None


def apply_exclusions(factors: Sequence[Factor], columns: Sequence[array[int]], exclusions: object) -> Exclusions:
    """Find out which combinations of the full factorial are left out.

    Args:
        factors: the factors of the design.
        columns: for each factor, the place of its treatment in each combination.
        exclusions: mappings and predicates, see `Exclusion`.
    """
    left_out = bytes(len(columns[0]))
    if not isinstance(exclusions, Sequence) or isinstance(exclusions, str | bytes):
        problem = f"it is {exclusions!r}, which is of type {type(exclusions).__name__}"
        return Exclusions(left_out, (Finding.error(_WHERE, problem, "Give a list of exclusions."),))
    errors: list[Finding] = []
    warnings: list[Finding] = []
    cause = None
    for place, exclusion in enumerate(exclusions):
        where = f"{_WHERE}[{place}]"
        matching = _matching(where, factors, columns, exclusion)
        if matching.errors:
            errors += matching.errors
            cause = cause or matching.cause
            continue
        warnings += _idle(where, matching.flags, left_out)
        left_out = bytes(map(or_, left_out, matching.flags))
    if 0 not in left_out:
        errors.append(Finding.error(_WHERE, "every combination is excluded", "Exclude fewer."))
    return Exclusions(left_out.translate(_OPPOSITE), tuple(errors), tuple(warnings), cause)


def _matching(where: str, factors: Sequence[Factor], columns: Sequence[array[int]], exclusion: object) -> _Matching:
    if isinstance(exclusion, Mapping):
        return _matching_treatments(where, factors, columns, exclusion)
    if callable(exclusion):
        return _matching_predicate(where, factors, columns, exclusion)
    problem = f"it is {exclusion!r}, which is of type {type(exclusion).__name__}"
    fix = "Give a mapping from factors to treatments, or a function of a combination."
    return _Matching(errors=(Finding.error(where, problem, fix),))


def _matching_treatments(
    where: str, factors: Sequence[Factor], columns: Sequence[array[int]], exclusion: Mapping[Any, Any]
) -> _Matching:
    if not exclusion:
        fix = "Name a factor and its treatments, or remove it."
        return _Matching(errors=(Finding.error(where, "it names no factor", fix),))
    by_name = {factor.name: (factor, column) for factor, column in zip(factors, columns, strict=True)}
    errors: list[Finding] = []
    matching = bytes([1]) * len(columns[0])
    for key, wanted in exclusion.items():
        name = key.name if isinstance(key, Factor) else key
        if name not in by_name:
            errors.append(Finding.error(where, f"there is no factor {name!r}", did_you_mean(str(name), by_name)))
            continue
        factor, column = by_name[name]
        flags, unknown = _flags(factor, wanted)
        errors += [
            Finding.error(where, f"{value!r} is no treatment of factor {name!r}", factor.suggestion(value))
            for value in unknown
        ]
        matching = bytes(map(and_, matching, map(flags.__getitem__, column)))
    return _Matching(matching, tuple(errors))


def _flags(factor: Factor, wanted: Any) -> tuple[bytearray, list[Any]]:
    """Mark the treatments of `factor` that are wanted, and return what is no treatment of it."""
    flags = bytearray(len(factor.treatments))
    unknown = []
    for value in _values(factor, wanted):
        place = factor.position_of(value)
        if place is None:
            unknown.append(value)
        else:
            flags[place] = 1
    return flags, unknown


def _values(factor: Factor, wanted: Any) -> Sequence[Any]:
    if factor.position_of(wanted) is not None:
        return (wanted,)  # a treatment may itself be a tuple
    if isinstance(wanted, list | tuple | range):
        return wanted
    if isinstance(wanted, set | frozenset):
        return sorted(wanted, key=repr)
    return (wanted,)


def _matching_predicate(
    where: str, factors: Sequence[Factor], columns: Sequence[array[int]], predicate: Callable[[Combination], object]
) -> _Matching:
    flags = bytearray()
    for combination in combinations_of(factors, columns):
        try:
            flags.append(bool(predicate(combination)))
        except Exception as error:  # noqa: BLE001 - a user's predicate may raise anything
            return _Matching(errors=(_predicate_failed(where, combination, error),), cause=error)
    return _Matching(bytes(flags))


def _predicate_failed(where: str, combination: Combination, error: Exception) -> Finding:
    name = error.args[0] if isinstance(error, KeyError) and error.args else None
    is_unknown_factor = isinstance(name, str) and name not in combination
    problem = f"the predicate raised {type(error).__name__}: {error} for the combination {combination}"
    return Finding.error(where, problem, did_you_mean(str(name), combination) if is_unknown_factor else "Mend it.")


def _idle(where: str, matching: bytes, left_out: bytes) -> Iterator[Finding]:
    matched = matching.count(1)
    if not matched:
        yield Finding.warning(where, "it matches no combination", "Remove it, or mend what it names.")
    elif bytes(map(and_, matching, left_out)).count(1) == matched:
        yield Finding.warning(where, "it removes nothing: what it matches is excluded already", "Remove it.")
