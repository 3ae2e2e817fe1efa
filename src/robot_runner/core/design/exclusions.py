"""Excluded combinations: by named treatments, or by a predicate."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import or_
from typing import Any

from robot_runner.core.design.factor import Combination, Factor
from robot_runner.core.design.full_factorial import identified, impossible_treatments
from robot_runner.core.errors import DesignError, Finding, did_you_mean

#: `{"Task": ["Video", "Network"], "Speed": 0.2}` excludes combinations that match in *all* named factors;
#: a predicate excludes the combinations for which it returns True.
Exclusion = Mapping[Any, Any] | Callable[[Combination], bool]

_WHERE = "exclude_combinations"

#: Returns whether an exclusion matches a combination; raises DesignError where a predicate raises.
_Matches = Callable[[Combination], bool]


@dataclass(frozen=True, slots=True)
class Exclusions:
    """The result of applying exclusions.

    Attributes:
        kept: the combinations that are executed, in order.
        errors: for exclusions with unknown names, or that raised.
        warnings: for exclusions that remove nothing.
        cause: the exception of a predicate, or None.
    """

    kept: list[Combination]
    errors: tuple[Finding, ...] = ()
    warnings: tuple[Finding, ...] = ()
    cause: BaseException | None = None


class Allowed:
    """Decides whether a combination is not excluded, without enumerating combinations.

    Attributes:
        forbidden: treatments that exclude each other, by the conditions of the factors and by each exclusion that is a
            mapping: the indices of the treatments, by factor.
        predicates: the exclusions that need a whole combination.

    Example:
        >>> factors = [Factor("Task", ["Video", "Network"]), Factor("Speed", [0.1, 0.2])]
        >>> is_allowed = Allowed(factors, [{"Task": "Network", "Speed": 0.2}])
        >>> is_allowed.forbidden
        ({'Task': frozenset({1}), 'Speed': frozenset({1})},)
    """

    def __init__(self, factors: Sequence[Factor], exclusions: object) -> None:
        """Check the exclusions.

        Raises:
            DesignError: one has an unknown name; `findings` lists all problems.
        """
        read, findings = _read(factors, exclusions)
        DesignError.refuse(findings)
        named = (each for _, each in read if isinstance(each, Mapping))
        self.forbidden: tuple[Mapping[str, frozenset[int]], ...] = (*impossible_treatments(factors), *named)
        self.predicates = tuple((where, each) for where, each in read if not isinstance(each, Mapping))
        self._matches = [_naming(factors, each) for each in self.forbidden]
        self._matches += [_predicating(where, predicate) for where, predicate in self.predicates]

    def __call__(self, combination: Combination) -> bool:
        """Return whether no exclusion matches; raise a `DesignError` if a predicate raises."""
        return not any(matches(combination) for matches in self._matches)


def apply_exclusions(factors: Sequence[Factor], combinations: Sequence[Combination], exclusions: object) -> Exclusions:
    """Return which combinations are kept, and the findings."""
    left_out = [False] * len(combinations)
    warnings: list[Finding] = []
    cause = None
    read, errors = _read(factors, exclusions)
    for where, each in read:
        matches = _naming(factors, each) if isinstance(each, Mapping) else _predicating(where, each)
        try:
            flags = list(map(matches, combinations))
        except DesignError as error:
            errors += error.findings
            cause = cause or error.__cause__
            continue
        warnings += _idle(where, flags, left_out)
        left_out = list(map(or_, left_out, flags))
    if all(left_out):
        errors.append(Finding.error(_WHERE, "every combination is excluded", "Exclude fewer."))
    kept = [combination for combination, is_out in zip(combinations, left_out, strict=True) if not is_out]
    return Exclusions(kept, tuple(errors), tuple(warnings), cause)


#: A checked exclusion: its place for findings, and the indices of the treatments that it names, or a predicate.
_Read = tuple[str, Mapping[str, frozenset[int]] | Callable[[Combination], object]]


def _read(factors: Sequence[Factor], exclusions: object) -> tuple[list[_Read], list[Finding]]:
    """Return the valid exclusions, and errors for the others."""
    if not isinstance(exclusions, Sequence) or isinstance(exclusions, str | bytes):
        problem = f"{exclusions!r} is of type {type(exclusions).__name__}"
        return [], [Finding.error(_WHERE, problem, "Give a list of exclusions.")]
    read: list[_Read] = []
    findings: list[Finding] = []
    for place, exclusion in enumerate(exclusions):
        where = f"{_WHERE}[{place}]"
        if isinstance(exclusion, Mapping):
            named, errors = _named(where, factors, exclusion)
            findings += errors
            read += [] if errors else [(where, named)]
        elif callable(exclusion):
            read.append((where, exclusion))
        else:
            problem = f"{exclusion!r} is of type {type(exclusion).__name__}"
            fix = "Give a mapping from factors to treatments, or a function of a combination."
            findings.append(Finding.error(where, problem, fix))
    return read, findings


def _naming(factors: Sequence[Factor], named: Mapping[str, frozenset[int]]) -> _Matches:
    # By identity, as combinations hold the factor's own objects: True equals 1, and objects need not be comparable.
    (chosen,) = identified(factors, [named])

    def matches(combination: Combination) -> bool:
        for name, treatments in chosen:  # noqa: SIM110 - a generator takes twice as long, and there may be millions
            if id(combination[name]) not in treatments:
                return False
        return True

    return matches


def _predicating(where: str, predicate: Callable[[Combination], object]) -> _Matches:
    def matches(combination: Combination) -> bool:
        try:
            return bool(predicate(combination))
        except Exception as error:
            raise DesignError.of_findings([_predicate_failed(where, combination, error)]) from error

    return matches


def _named(
    where: str, factors: Sequence[Factor], exclusion: Mapping[Any, Any]
) -> tuple[dict[str, frozenset[int]], list[Finding]]:
    """Return the indices of the treatments that an exclusion names, by factor, and errors for unknown names."""
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
        places = [(value, factor.position_of(value)) for value in factor.named(wanted)]
        errors += [
            Finding.error(where, f"{value!r} is not a treatment of factor {name!r}", _instead(factor, value))
            for value, place in places
            if place is None
        ]
        named[name] = frozenset(place for _, place in places if place is not None)
    return named, errors


def _instead(factor: Factor, value: object) -> str:
    """Return what to write in the place of a value that is no treatment of a factor."""
    if factor.range is None:
        return factor.suggestion(value)
    ends = f"{factor.range.lower} and {factor.range.upper}"
    return (
        f"Of a range, a mapping names the ends, {ends}. For values between them, write a function of the combination."
    )


def _predicate_failed(where: str, combination: Combination, error: Exception) -> Finding:
    name = error.args[0] if isinstance(error, KeyError) and error.args else None
    is_unknown_factor = isinstance(name, str) and name not in combination
    raised = f"KeyError: {name!r}" if is_unknown_factor else f"{type(error).__name__}: {error}"
    problem = f"the predicate raised {raised} for the combination {combination}"
    return Finding.error(where, problem, did_you_mean(str(name), combination) if is_unknown_factor else "Correct it.")


def _idle(where: str, flags: Sequence[bool], left_out: Sequence[bool]) -> Iterator[Finding]:
    if not any(flags):
        yield Finding.warning(where, "the exclusion matches no combination", "Remove it, or correct what it names.")
    elif not any(matches and not is_out for matches, is_out in zip(flags, left_out, strict=True)):
        yield Finding.warning(where, "the exclusion removes nothing: what it matches is excluded already", "Remove it.")
