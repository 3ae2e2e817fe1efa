"""Shared parts of the designs: combinations from indices and values, and findings on factors and parameters."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields
from importlib.util import find_spec
from typing import Any, ClassVar

from robot_runner.core.design.design import IsAllowed
from robot_runner.core.design.factor import Combination, Factor, factor_name, factor_places
from robot_runner.core.design.full_factorial import full_size
from robot_runner.core.design.numeric_range import is_whole
from robot_runner.core.errors import Finding
from robot_runner.core.words import INACTIVE


class Described:
    """A design that is stored as its kind and its parameters; subclasses must be dataclasses."""

    __slots__ = ()
    kind: ClassVar[str]

    def as_mapping(self) -> dict[str, Any]:
        """Return its kind and its parameters, factors by their names."""
        parameters: Any = fields(self)  # type: ignore[arg-type]
        return {"kind": self.kind, **{each.name: factor_name(getattr(self, each.name)) for each in parameters}}


def at_places(factors: Sequence[Factor], rows: Iterable[Sequence[int]]) -> list[Combination]:
    """Return the combinations of rows of treatment indices, one index for each factor."""
    places = factor_places(factor.name for factor in factors)
    listed = [factor.treatments for factor in factors]
    return [
        Combination(places, tuple(treatments[place] for treatments, place in zip(listed, row, strict=True)))
        for row in rows
    ]


def distinct(factors: Sequence[Factor], rows: Iterable[tuple[Any, ...]]) -> list[tuple[Any, ...]]:
    """Return rows of treatments and of numbers within ranges, without duplicates.

    Treatments are compared by identity, as True equals 1, and a list has no hash.
    """
    are_numbers = [factor.range is not None for factor in factors]
    found: dict[tuple[Any, ...], tuple[Any, ...]] = {}
    for row in rows:
        key = tuple(each if is_one else id(each) for is_one, each in zip(are_numbers, row, strict=True))
        found.setdefault(key, row)
    return list(found.values())


def with_values(
    factors: Sequence[Factor], rows: Iterable[Sequence[Any]], is_allowed: IsAllowed
) -> tuple[tuple[Factor, ...], list[Combination]]:
    """Return the allowed combinations of values, and the factors with the values that occur.

    The values of a factor with a range become its treatments, in ascending order; other factors keep theirs.

    Args:
        factors: of the config.
        rows: a value for each factor: a treatment, or a number within the range.
        is_allowed: returns whether a combination is not excluded.
    """
    places = factor_places(factor.name for factor in factors)
    # Combinations are compared by the factor's own objects; equal numbers become one object.
    own: list[dict[Any, Any]] = [
        {each: each for each in factor.treatments} if factor.range is not None else {} for factor in factors
    ]
    combinations = []
    for row in rows:
        values = (
            known.setdefault(value, value) if factor.range else value
            for factor, known, value in zip(factors, own, row, strict=True)
        )
        combination = Combination(places, tuple(values))
        if is_allowed(combination):
            combinations.append(combination)
    used = [_occurring(factor, combinations) if factor.range else factor for factor in factors]
    return tuple(used), combinations


def _occurring(factor: Factor, combinations: Sequence[Combination]) -> Factor:
    values = {combination[factor.name] for combination in combinations} - {INACTIVE}
    return factor.with_treatments(sorted(values)) if values else factor


def active_treatments(factor: Factor) -> tuple[Any, ...]:
    """Return the treatments without `INACTIVE`, which stands for runs to which the factor does not apply."""
    return tuple(each for each in factor.treatments if each is not INACTIVE)


def with_conditions(factors: Sequence[Factor], values: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return a value for each factor, with `INACTIVE` for those whose conditions do not hold."""
    by_name = {factor.name: factor for factor in factors}
    resolved: dict[str, Any] = {}

    def resolve(name: str) -> Any:
        if name not in resolved:
            holds = all(
                any(resolve(other) is each for each in _own(by_name[other], wanted))
                for other, wanted in by_name[name].when.items()
            )
            resolved[name] = values[name] if holds else INACTIVE
        return resolved[name]

    return tuple(map(resolve, by_name))


def _own(factor: Factor, wanted: Iterable[Any]) -> list[Any]:
    return [factor.treatments[place] for place in map(factor.position_of, wanted) if place is not None]


def share_value(factor: Factor, share: float) -> Any:
    """Return the value of a factor at a share from 0 to 1, of its range or of its ordered treatments.

    All steps of a range have equal parts: with rounding to the nearest step, the ends would have half a part.
    """
    span = factor.range
    if span is None:
        treatments = active_treatments(factor)
        return treatments[_part(share, len(treatments))]
    step = 1 if span.step is None and span.is_whole else span.step
    if step is None:
        return span.at(share)
    width = span.upper - span.lower
    return span.at(step * _part(share, 1 + int(round(width / step, 6))) / width)


def _part(share: float, count: int) -> int:
    return min(int(share * count), count - 1)


# Findings on factors and parameters.


def library_findings(*modules: str) -> Iterator[Finding]:
    """Yield a finding for each library that is not installed."""
    for module in modules:
        if find_spec(module) is None:
            yield Finding.error("design", f"the design needs {module}, which is not installed", _INSTALL)


_INSTALL = "Install it: pip install 'robot-runner[designs]'."


def number_findings(name: str, value: object, least: int, most: int | None = None) -> Iterator[Finding]:
    """Yield a finding if a parameter of a design is not a whole number from `least` to `most`."""
    fix = f"Give a whole number from {least}."
    if not is_whole(value):
        yield Finding.error("design", f"{name}={value!r} is of type {type(value).__name__}", fix)
    elif value < least:
        yield Finding.error("design", f"{name}={value} is less than {least}", fix)
    elif most is not None and value > most:
        yield Finding.error("design", f"{name}={value:,} is more than {most:,}", f"Give {most:,} or less.")


def curve_findings(factor: Factor) -> Iterator[Finding]:
    """Yield a finding if the steps of a range allow fewer than the three values that a curve needs."""
    if factor.range is not None and len({factor.range.at(share) for share in (0, 0.5, 1)}) < 3:  # noqa: PLR2004
        problem = "its steps leave two values: a surface takes three"
        fix = "Give it finer steps or a wider range, or choose FractionalFactorial."
        yield Finding.error(f"factor {factor.name!r}", problem, fix)


def left_out_warning(chosen: int, left: int, consequence: str) -> tuple[Finding, ...]:
    """Return a warning if exclusions remove combinations from a design that ignores exclusions."""
    if left == chosen:
        return ()
    problem = f"the exclusions take {chosen - left} of the {chosen} combinations out of the design: {consequence}"
    return (Finding.warning("exclude_combinations", problem, "DOptimal(runs=...) chooses around exclusions."),)


def more_than_all(factors: Sequence[Factor], runs: int) -> Iterator[Finding]:
    """Yield a finding if there are more runs than combinations."""
    if all(factor.range is None for factor in factors) and runs > (every := full_size(factors)):
        problem = f"runs={runs:,}, and the full factorial has {every:,}"
        yield Finding.error("design", problem, f"Give {every:,} or fewer, or leave the design out.")
