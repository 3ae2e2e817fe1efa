"""Designs that spread runs over the ranges of numeric factors: Latin hypercubes and Sobol' sequences."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

from robot_runner.core.design.design import ChosenCombinations, IsAllowed
from robot_runner.core.design.design_findings import MAX_RUNS
from robot_runner.core.design.factor import Factor
from robot_runner.core.errors import DesignError, Finding
from robot_runner.designs.choosing import (
    Described,
    distinct,
    library_findings,
    number_findings,
    share_value,
    with_conditions,
    with_values,
)

#: The most points that are drawn to make up for exclusions, as a multiple of the runs.
_MOST_DRAWN = 64


@dataclass(frozen=True, slots=True)
class _SpaceFilling(Described):
    """The common base of space-filling designs: `runs` points that are drawn from a seed."""

    runs: int
    seed: int = 0

    def findings(self, factors: Sequence[Factor]) -> Iterator[Finding]:
        """Yield findings on the parameters, libraries and factors."""
        yield from number_findings("runs", self.runs, 2, MAX_RUNS)
        yield from number_findings("seed", self.seed, 0)
        yield from library_findings("scipy")
        if all(factor.range is None for factor in factors):
            problem = "no factor is numeric: there is no space to fill"
            fix = 'Give a factor a range, as in Factor("Speed", Range(0.05, 0.22)), or choose CoveringArray.'
            yield Finding.error("design", problem, fix)

    def _filled(
        self,
        factors: Sequence[Factor],
        is_allowed: IsAllowed,
        draw: Callable[[int], Sequence[Sequence[float]]],
        said: tuple[Finding, ...] = (),
    ) -> ChosenCombinations:
        """Return the first `runs` allowed combinations; more points are drawn if some are excluded."""
        names = [factor.name for factor in factors]
        drawn = self.runs
        while drawn <= self.runs * _MOST_DRAWN:
            shares = (map(float, point) for point in draw(drawn))
            rows = (
                with_conditions(factors, dict(zip(names, map(share_value, factors, point), strict=True)))
                for point in shares
            )
            _, kept = with_values(factors, distinct(factors, rows), is_allowed)  # coarse steps may give one twice
            if len(kept) >= self.runs:
                used, chosen = with_values(factors, [each.treatments for each in kept[: self.runs]], is_allowed)
                facts = {
                    "kind": self.kind,
                    "numeric_factors": [factor.name for factor in factors if factor.range is not None],
                    "drawn": drawn,
                    "model": "quadratic",
                }
                return ChosenCombinations(chosen, facts, used, said)
            drawn += max(1, drawn // 4)
        problem = f"fewer than {self.runs} combinations are allowed among {self.runs * _MOST_DRAWN} points"
        raise DesignError(problem, where="design", fix="Exclude less, give finer steps, or fewer runs.")


@dataclass(frozen=True, slots=True)
class LatinHypercube(_SpaceFilling):
    """Runs spread so that each run is in a separate slice of the range of each numeric factor.

    McKay, Beckman & Conover (1979), Technometrics 21(2), by `scipy.stats.qmc.LatinHypercube`. Listed treatments of a
    factor occur as equally often as possible. If points are excluded, a denser hypercube is drawn.

    Attributes:
        runs: the number of combinations.
        seed: of the random points.

    Example:
        >>> from robot_runner import Factor, Range
        >>> factors = [Factor("Speed", Range(0.0, 9.0)), Factor("Load", Range(0.0, 9.0))]
        >>> chosen = LatinHypercube(runs=5).choose(factors, lambda combination: True)
        >>> len({combination["Speed"] for combination in chosen.combinations})
        5
    """

    kind: ClassVar[str] = "latin_hypercube"

    def choose(self, factors: Sequence[Factor], is_allowed: IsAllowed) -> ChosenCombinations:
        """Return the allowed points."""
        from scipy.stats import qmc  # noqa: PLC0415 - an extra

        return self._filled(
            factors, is_allowed, lambda drawn: qmc.LatinHypercube(len(factors), rng=self.seed).random(drawn)
        )


@dataclass(frozen=True, slots=True)
class Sobol(_SpaceFilling):
    """The first points of a scrambled Sobol' sequence: even coverage of all ranges together, for models and maps.

    Sobol' (1967) with Owen's scrambling, by `scipy.stats.qmc.Sobol`. Even coverage needs a power of two. Excluded
    points are skipped: the sequence continues until there are enough points.

    Attributes:
        runs: the number of combinations.
        seed: of the scrambling.

    Example:
        >>> from robot_runner import Factor, Range
        >>> factors = [Factor("Speed", Range(0.0, 1.0)), Factor("Load", Range(0.0, 1.0))]
        >>> chosen = Sobol(runs=8).choose(factors, lambda combination: True)
        >>> sum(combination["Speed"] < 0.5 for combination in chosen.combinations)
        4
    """

    kind: ClassVar[str] = "sobol"

    def choose(self, factors: Sequence[Factor], is_allowed: IsAllowed) -> ChosenCombinations:
        """Return the first allowed points."""
        from scipy.stats import qmc  # noqa: PLC0415 - an extra

        odd = self.runs & (self.runs - 1)
        below = 1 << (self.runs.bit_length() - 1)
        problem = f"runs={self.runs} is not a power of two, and the points are spread less evenly"
        uneven = Finding.warning("design", problem, f"Give {below} or {2 * below}.")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # not a power of two: reported by the finding
            return self._filled(
                factors,
                is_allowed,
                lambda drawn: qmc.Sobol(len(factors), rng=self.seed).random(drawn),
                (uneven,) if odd else (),
            )
