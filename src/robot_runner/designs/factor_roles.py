"""The roles of factors in a design: some are blocks (a day, a robot, a period), the others are studied."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from random import Random
from typing import Any

from robot_runner.core.design.design import IsAllowed
from robot_runner.core.design.factor import Combination, Factor, factor_places
from robot_runner.core.design.full_factorial import full_factorial
from robot_runner.core.design.planned_runs import shuffle_in_place
from robot_runner.core.errors import DesignError, Finding, did_you_mean


def role_findings(design: str, roles: Sequence[tuple[str, Any]], factors: Sequence[Factor]) -> Iterator[Finding]:
    """Yield findings on unknown factors, factors with two roles, conditional factors, and if no factor is studied.

    `design` is the name of the design, such as `LatinSquare`; `roles` are its parameters with the factors that they
    name.
    """
    known = [factor.name for factor in factors]
    taken: dict[str, str] = {}
    for role, name in roles:
        where = f"design: {design}({role}=...)"
        if name not in known:
            yield Finding.error(where, f"there is no factor {name!r}", did_you_mean(str(name), known))
        elif name in taken:
            problem = f"factor {name!r} is {taken[name]} already"
            yield Finding.error(where, problem, "Name another factor, or add one.")
        else:
            taken[name] = role
    for factor in factors:
        if factor.when and (factor.name in taken or set(factor.when) & set(taken)):
            concerned = " and ".join(map(repr, taken))
            problem = f"factor {factor.name!r} applies in some runs only, and its condition concerns {concerned}"
            yield Finding.error(f"design: {design}", problem, "Make it a factor that applies always.")
    if len(taken) == len(known):
        yield Finding.error(f"design: {design}", "no factor is left to be studied", "Add one beside these.")


def refused(design: str, problem: str, fix: str) -> DesignError:
    """Return an error that refuses a design."""
    return DesignError(problem, where=f"design: {design}", fix=fix)


@dataclass(frozen=True, slots=True)
class Roles:
    """The factors of a model, divided into blocks and studied factors.

    Attributes:
        factors: all factors, in the order of the columns.
        blocks: the factors that are blocks, in the order of their roles.
    """

    factors: Sequence[Factor]
    blocks: Sequence[Factor]

    @classmethod
    def of(cls, factors: Sequence[Factor], names: Sequence[str]) -> Roles:
        """Return the roles of factors, given the names of those that are blocks."""
        by_name = {factor.name: factor for factor in factors}
        return cls(factors, [by_name[name] for name in names])

    @property
    def studied(self) -> list[Factor]:
        """The factors that are studied."""
        blocks = {factor.name for factor in self.blocks}
        return [factor for factor in self.factors if factor.name not in blocks]

    def combined(self, *parts: Combination | tuple[Factor, Any]) -> Combination:
        """Return a combination of all factors, from combinations of some and from single treatments."""
        treatments: dict[str, Any] = {}
        for part in parts:
            treatments |= part if isinstance(part, Combination) else {part[0].name: part[1]}
        places = factor_places(factor.name for factor in self.factors)
        return Combination(places, tuple(treatments[name] for name in places))

    def allowed_treatments(self, design: str, is_allowed: IsAllowed) -> list[Combination]:
        """Return the combinations of the studied factors that are allowed in every block.

        Raises:
            DesignError: a combination is excluded in some blocks only, or all are excluded.
        """
        cells = list(product(*(factor.treatments for factor in self.blocks)))
        left = []
        for treatment in full_factorial(self.studied):
            allowed = [is_allowed(self.combined(treatment, *zip(self.blocks, cell, strict=True))) for cell in cells]
            if any(allowed) and not all(allowed):
                cell = cells[allowed.index(False)]
                place = ", ".join(f"{factor.name}={each!r}" for factor, each in zip(self.blocks, cell, strict=True))
                problem = f"{treatment} is excluded where {place}, and not everywhere: the design would not be balanced"
                studied = " and ".join(repr(factor.name) for factor in self.studied)
                raise refused(design, problem, f"Exclude by {studied} alone.")
            if all(allowed):
                left.append(treatment)
        if not left:
            raise DesignError("every combination is excluded", where="exclude_combinations", fix="Exclude fewer.")
        return left


def shuffled(items: Iterable[Any], seed: int | None, *purpose: object) -> list[Any]:
    """Return items in a random order that depends on the seed and the purpose alone.

    So the order for one purpose does not change when more is drawn for others, and a design that grows keeps its
    first part.

    Args:
        items: to be shuffled.
        seed: None keeps the order.
        purpose: names the items, such as the rows of the second square.
    """
    order = list(items)
    if seed is not None:
        stream = "/".join(map(str, (seed, *purpose)))
        shuffle_in_place(order, Random(stream).random)  # noqa: S311 - reproducible, not secret
    return order


def texts_of_combination(combination: Combination) -> str:
    """Return a combination as text for facts: its treatments, separated by commas."""
    return ", ".join(map(str, combination.treatments))
