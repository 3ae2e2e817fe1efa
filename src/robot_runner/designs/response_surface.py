"""Designs for a response surface of numeric factors: central composite and Box-Behnken."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import Any, ClassVar

from robot_runner.core.design.design import ChosenCombinations, IsAllowed
from robot_runner.core.design.design_findings import MAX_RUNS
from robot_runner.core.design.factor import Factor
from robot_runner.core.errors import Finding
from robot_runner.designs.choosing import Described, curve_findings, left_out_warning, number_findings, with_values
from robot_runner.designs.fractional import fraction_rows, fraction_words

_INSCRIBED, _FACED = "inscribed", "faced"


@dataclass(frozen=True, slots=True, kw_only=True)
class CentralComposite(Described):
    """Corners, axial points and the centre, for a quadratic response surface (Box & Wilson, 1951).

    All runs are inside the ranges. With many factors, the corners are a fraction of resolution 5.

    Attributes:
        centre: how often the centre is executed, to estimate the variance of repeated runs.
        axial: `inscribed` puts the axial points at the ends of the ranges and the corners inside, so that predictions
            are equally precise in all directions (rotatable: the axial distance is the fourth root of the number of
            corners); `faced` puts both at the ends, with three values for each factor.

    Example:
        >>> from robot_runner import Factor, Range
        >>> factors = [Factor("Speed", Range(0.0, 1.0)), Factor("Load", Range(0.0, 1.0))]
        >>> len(CentralComposite(centre=3).choose(factors, lambda combination: True).combinations)
        11
    """

    kind: ClassVar[str] = "central_composite"
    centre: int = 4
    axial: str = _INSCRIBED

    def findings(self, factors: Sequence[Factor]) -> Iterator[Finding]:
        """Yield findings on the parameters and the factors."""
        yield from number_findings("centre", self.centre, 1, MAX_RUNS)
        if self.axial not in (_INSCRIBED, _FACED):
            problem = f"axial={self.axial!r} is neither {_INSCRIBED!r} nor {_FACED!r}"
            yield Finding.error("design", problem, "Give one of these.")
        yield from _numeric_findings(factors, 2)
        if len(factors) > 1 and fraction_words(len(factors), 5) is None:
            problem = f"{len(factors)} factors take too many corners"
            yield Finding.error("design", problem, "Screen them first with FractionalFactorial, or choose Sobol.")

    def choose(self, factors: Sequence[Factor], is_allowed: IsAllowed) -> ChosenCombinations:
        """Return corners, axial points and centre points."""
        words = fraction_words(len(factors), 5) or []
        corners = [[2 * place - 1 for place in row] for row in fraction_rows(words)]
        distance = 1.0 if self.axial == _FACED else len(corners) ** 0.25
        points = [[sign / distance for sign in row] for row in corners]
        places = range(len(factors))
        points += [[float(sign * (each == place)) for each in places] for place in places for sign in (-1, 1)]
        return _surface(self, factors, points, is_allowed, {"axial_distance": round(distance, 6)})


@dataclass(frozen=True, slots=True, kw_only=True)
class BoxBehnken(Described):
    """Midpoints of edges and the centre, for a quadratic response surface without runs at the corners of the ranges.

    Use it if all factors at their ends at once would be too much for the robot. Each factor has three values. Blocks of
    factors as in Box & Behnken (1960), Technometrics 2(4), table 4: pairs for 3 to 5 factors, triples for 6 and 7.

    Attributes:
        centre: how often the centre is executed.

    Example:
        >>> from robot_runner import Factor, Range
        >>> factors = [Factor(name, Range(0.0, 1.0)) for name in ("Speed", "Load", "Rate")]
        >>> len(BoxBehnken(centre=3).choose(factors, lambda combination: True).combinations)
        15
    """

    kind: ClassVar[str] = "box_behnken"
    centre: int = 3

    def findings(self, factors: Sequence[Factor]) -> Iterator[Finding]:
        """Yield findings on the parameters and the factors."""
        yield from number_findings("centre", self.centre, 1, MAX_RUNS)
        yield from _numeric_findings(factors, 3)
        if len(factors) > max(_BLOCKS):
            problem = f"there are {len(factors)} factors, and BoxBehnken is known for 3 to {max(_BLOCKS)}"
            yield Finding.error("design", problem, "Choose CentralComposite, or fewer factors.")

    def choose(self, factors: Sequence[Factor], is_allowed: IsAllowed) -> ChosenCombinations:
        """Return the midpoints and centre points."""
        corners = [
            dict(zip(block, signs, strict=True))
            for block in _BLOCKS[len(factors)]
            for signs in product((-1.0, 1.0), repeat=len(block))
        ]
        points = [[corner.get(place, 0.0) for place in range(len(factors))] for corner in corners]
        return _surface(self, factors, points, is_allowed, {})


#: The groups of factors that are at their ends together, by the number of factors.
_BLOCKS: dict[int, list[tuple[int, ...]]] = {
    **{factors: list(combinations(range(factors), 2)) for factors in (3, 4, 5)},
    6: [(0, 1, 3), (1, 2, 4), (2, 3, 5), (0, 3, 4), (1, 4, 5), (0, 2, 5)],
    7: [(3, 4, 5), (0, 5, 6), (1, 4, 6), (0, 1, 3), (2, 3, 6), (0, 2, 4), (1, 2, 5)],
}


def _surface(
    design: CentralComposite | BoxBehnken,
    factors: Sequence[Factor],
    points: Iterable[Sequence[float]],
    is_allowed: IsAllowed,
    facts: Mapping[str, Any],
) -> ChosenCombinations:
    """Return points with coordinates from -1 to 1 as combinations, followed by the centre points."""
    every = [*points, *([0.0] * len(factors) for _ in range(design.centre))]
    rows = [
        [factor.range.at((each + 1) / 2) for factor, each in zip(factors, point, strict=True) if factor.range]
        for point in every
    ]
    used, kept = with_values(factors, rows, is_allowed)
    told = {
        "kind": design.kind,
        "numeric_factors": [factor.name for factor in factors],
        "ranges": {factor.name: [factor.range.lower, factor.range.upper] for factor in factors if factor.range},
        "centre_points": design.centre,
        "model": "quadratic",
        **facts,
    }
    warnings = left_out_warning(len(every), len(kept), "the surface may not be estimable")
    warnings += tuple(_coarse_warnings(factors, {each for point in every for each in point}))
    return ChosenCombinations(kept, told, used, warnings)


def _coarse_warnings(factors: Sequence[Factor], wanted: Collection[float]) -> Iterator[Finding]:
    """Yield a warning for each factor whose steps are so wide that several coordinates are the same value."""
    for factor in factors:
        values = {factor.range.at((each + 1) / 2) for each in wanted} if factor.range else ()
        if len(values) < len(wanted):
            problem = f"its steps leave {len(values)} of the {len(wanted)} values of the design: points fall together"
            fix = f"Give it finer steps, or take axial={_FACED!r}, which has three values."
            yield Finding.warning(f"factor {factor.name!r}", problem, fix)


def _numeric_findings(factors: Sequence[Factor], least: int) -> Iterator[Finding]:
    for factor in factors:
        if factor.range is None or factor.when:
            what = "applies under a condition" if factor.when else "has listed treatments"
            fix = "Give it a range and no condition, as in Range(0.05, 0.22), or choose DOptimal."
            yield Finding.error(f"factor {factor.name!r}", f"the factor {what}: a surface takes numbers", fix)
        else:
            yield from curve_findings(factor)
    if len(factors) < least:
        problem = f"there {'is 1 factor' if len(factors) == 1 else f'are {len(factors)} factors'}"
        yield Finding.error("design", f"{problem}, and the design takes {least}", "Add one, or choose another design.")
