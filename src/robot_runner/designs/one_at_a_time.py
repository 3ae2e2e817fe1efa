"""One factor at a time: a base combination, and each other treatment of each factor by itself."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from robot_runner.core.design.design import ChosenCombinations, IsAllowed
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.numeric_range import is_number
from robot_runner.core.errors import Finding, did_you_mean
from robot_runner.core.words import INACTIVE, listed
from robot_runner.designs.choosing import active_treatments, distinct, left_out_warning, with_conditions, with_values


@dataclass(frozen=True, slots=True)
class OneFactorAtATime:
    """A base combination, and for each factor its other treatments, with all other factors as in the base.

    It shows the effect of each factor around the base, and no interactions. A factor with a range has its two ends as
    treatments.

    Attributes:
        base: a treatment for each factor, by name; for a numeric factor a number of its range and steps. Factors that
            are left out have their first treatment, or the middle of their range.

    Example:
        >>> from robot_runner import Factor
        >>> factors = [Factor("Task", ["Video", "Network"]), Factor("Speed", [0.1, 0.2, 0.3])]
        >>> chosen = OneFactorAtATime(base={"Speed": 0.2}).choose(factors, lambda combination: True)
        >>> [str(combination) for combination in chosen.combinations][1]
        "Task='Network', Speed=0.2"
    """

    base: Mapping[str, Any] = field(default_factory=dict)

    def as_mapping(self) -> Mapping[str, Any]:
        """Return its kind, and the base as text."""
        return {"kind": "one_factor_at_a_time", "base": {str(name): str(each) for name, each in self.base.items()}}

    def findings(self, factors: Sequence[Factor]) -> Iterator[Finding]:
        """Yield findings on the base."""
        if not isinstance(self.base, Mapping):
            problem = f"base={self.base!r} is of type {type(self.base).__name__}"
            yield Finding.error("design", problem, 'Give a treatment for each factor: base={"Speed": 0.2}.')
            return
        by_name = {factor.name: factor for factor in factors}
        for name, value in self.base.items():
            where = f"base[{name!r}]"
            if name not in by_name:
                yield Finding.error(where, f"there is no factor {name!r}", did_you_mean(str(name), by_name))
            elif not _is_treatment(by_name[name], value):
                problem = f"{value!r} is not a treatment of factor {name!r}"
                yield Finding.error(where, problem, _fix(by_name[name], value))

    def choose(self, factors: Sequence[Factor], is_allowed: IsAllowed) -> ChosenCombinations:
        """Return the base and the combinations that differ from it in one factor."""
        base = {factor.name: _base_value(factor, self.base) for factor in factors}
        first = with_conditions(factors, base)
        idle = [factor.name for factor, present in zip(factors, first, strict=True) if present is INACTIVE]
        others = (
            with_conditions(factors, {**base, factor.name: each})
            for factor in factors
            if factor.name not in idle
            for each in active_treatments(factor)
        )
        rows = distinct(factors, (first, *others))
        used, kept = with_values(factors, rows, is_allowed)
        shown = {factor.name: str(value) for factor, value in zip(factors, first, strict=True)}
        facts = {"kind": "one_factor_at_a_time", "base": shown, "model": "main"}
        _, has_base = with_values(factors, rows[:1], is_allowed)
        lost = "these treatments" if has_base else "the base is one of them, so that all treatments"
        warnings = left_out_warning(len(rows), len(kept), f"{lost} are compared with nothing")
        if idle:
            problem = f"{listed(idle)} cannot be varied, as they do not apply under the base"
            warnings += (Finding.warning("design", problem, "Choose a base under which they apply."),)
        return ChosenCombinations(kept, facts, used, warnings)


def _base_value(factor: Factor, base: Mapping[str, Any]) -> Any:
    """Return the factor's own object for its treatment in the base."""
    if factor.name not in base:
        return factor.range.at(0.5) if factor.range is not None else factor.treatments[0]
    value = base[factor.name]
    place = factor.position_of(value)
    return value if place is None else factor.treatments[place]


def _is_treatment(factor: Factor, value: Any) -> bool:
    span = factor.range
    if span is None:
        return factor.position_of(value) is not None and value is not INACTIVE
    if not is_number(value) or not span.lower <= value <= span.upper:
        return False
    is_free = span.step is None and not span.is_whole
    return is_free or value == span.upper or math.isclose(value, span.at(span.share_of(value)), abs_tol=1e-12)


def _fix(factor: Factor, value: Any) -> str:
    span = factor.range
    if span is None:
        return factor.suggestion(value)
    is_between = is_number(value) and span.lower <= value <= span.upper
    steps = f" in steps of {span.step or 1}, such as {span.at(span.share_of(value))}" if is_between else ""
    return f"Give a number from {span.lower} to {span.upper}{steps}."
