"""The search for the number of repetitions, with more simulated experiments where the power is near the target."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from robot_runner.analysis.planning.power_simulation import AT_ONCE, Claim, Simulation
from robot_runner.core.errors import AnalysisError, DesignError, did_you_mean
from robot_runner.core.words import counted

if TYPE_CHECKING:
    from robot_runner.analysis.planning.assumed_values import Scenario
    from robot_runner.analysis.planning.planned_study import Study

#: The first and the largest number of simulated experiments for each number of repetitions. At a power of 80 % the
#: standard error is 1.3 and 0.4 percentage points.
FEWEST, MOST = 1_000, 10_000
#: The same for models that are fitted to one experiment at a time, in 5 ms (outliers) to 50 ms (mixed models) each.
FEWEST_OF_MODELS, MOST_OF_MODELS = 100, 400

#: The fewest numbers of repetitions of the power curve.
_POINTS, _POINTS_OF_MODELS = 9, 5
#: The confidence level of the Monte Carlo intervals.
_LEVEL = 0.95


@dataclass(frozen=True, slots=True)
class Found:
    """The number of simulated experiments in which a claim was found."""

    count: int
    simulations: int

    @property
    def share(self) -> float:
        """The power, 0..1."""
        return self.count / self.simulations

    @property
    def error(self) -> float:
        """The Monte Carlo standard error of the share."""
        return math.sqrt(self.share * (1 - self.share) / self.simulations)

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % confidence interval of the power (Wilson 1927)."""
        found = stats.binomtest(self.count, self.simulations).proportion_ci(_LEVEL, method="wilson")
        return float(found.low), float(found.high)


@dataclass(frozen=True, slots=True)
class PowerPoint:
    """The power for a number of repetitions.

    Attributes:
        runs: of the whole experiment.
        claims: how often each claim is found, in the order of `ScenarioPower.claims`.
        least: of the sought claim that is found least often.
        together: how often all sought claims are found in the same experiment.
    """

    repetitions: int
    runs: int
    claims: tuple[Found, ...]
    least: Found
    together: Found


@dataclass(frozen=True, slots=True)
class Needed:
    """The needed number of repetitions.

    Attributes:
        repetitions: the fewest for which each sought claim has the target power.
        low, high: the range of the answer given the Monte Carlo error; `high` is None if no number in the range surely
            suffices.
    """

    repetitions: int
    low: int
    high: int | None


@dataclass(frozen=True, slots=True)
class ScenarioPower:
    """The power under one set of assumptions.

    Attributes:
        sought: the indices of the claims to detect.
        points: by number of repetitions.
        needed: None if no number in the range suffices.
        too_few: why the first numbers of the range were skipped, as no test or no design is possible for them; else
            empty.
    """

    scenario: Scenario
    claims: tuple[Claim, ...]
    sought: tuple[int, ...]
    points: tuple[PowerPoint, ...]
    needed: Needed | None
    too_few: str = ""

    def point(self, repetitions: int) -> PowerPoint:
        """Return the power for a number of repetitions."""
        return {each.repetitions: each for each in self.points}[repetitions]


@dataclass(frozen=True, slots=True)
class Search:
    """The parameters of the search.

    Attributes:
        power: the target power, 0..1.
        first, last: the range of repetitions.
        effects: labels of the claims to detect; empty for those of the plan and the assumptions.
        simulations: the most experiments for each number of repetitions; None for the default.
        seed: of the simulations.
        first_batch: how many repetitions were executed before the experiment is extended; None if it is not.
    """

    power: float = 0.8
    first: int = 2
    last: int = 50
    effects: tuple[str, ...] = ()
    simulations: int | None = None
    seed: int = 1
    first_batch: int | None = None


def search_repetitions(
    study: Study, scenario: Scenario, search: Search, progress: Callable[[int, int], None] = lambda _, __: None
) -> ScenarioPower:
    """Find the fewest repetitions that suffice, and the power curve.

    Raises:
        AnalysisError: no sought claim is tested, or no test is possible even for the most repetitions.
    """
    curve = _Curve(study, scenario, search, progress)
    for repetitions in _spread(curve.first, search.last, _POINTS_OF_MODELS if curve.is_slow else _POINTS):
        curve.grow(repetitions, curve.fewest)
    target, answer = search.power, None
    needed = curve.first_where(lambda found: found.share >= target)
    if needed is not None:
        low = curve.first_where(lambda found: found.interval[1] >= target)
        high = curve.first_where(lambda found: found.interval[0] >= target)
        answer = Needed(needed, min(needed, low or needed), None if high is None else max(needed, high))
    return ScenarioPower(scenario, curve.claims, curve.sought, curve.points(), answer, curve.too_few)


def _spread(first: int, last: int, count: int) -> list[int]:
    """Return numbers from first to last in about geometric progression."""
    return sorted({round(each) for each in np.geomspace(first, last, count)} | {first, last})


@dataclass(slots=True)
class _Counted:
    """How often each claim was found, and last all sought ones together, in so many experiments and parts of these."""

    counts: list[int]
    experiments: int = 0
    parts: int = 0


class _Curve:
    """The power curve: the counts for each simulated number of repetitions."""

    def __init__(self, study: Study, scenario: Scenario, search: Search, progress: Callable[[int, int], None]) -> None:
        self._study, self._scenario, self._search, self._progress = study, scenario, search, progress
        self._simulations: dict[int, Simulation] = {}
        self._counted: dict[int, _Counted] = {}
        self.too_few = ""

    @cached_property
    def first(self) -> int:
        """The fewest repetitions for which a test is possible: ranks of two treatments need four runs of each."""
        self._simulation(self._search.last)  # raises its own error if no test is possible for the most runs either
        for repetitions in range(self._search.first, self._search.last):
            try:
                self._simulation(repetitions)
            except AnalysisError as error:
                self.too_few = error.problem
            except DesignError as error:
                self.too_few = f"with {counted(repetitions, 'repetition')}: {error.problem}"
            else:
                return repetitions
        return self._search.last

    @cached_property
    def claims(self) -> tuple[Claim, ...]:
        """All tested claims."""
        return self._simulation(self._search.last).claims

    @cached_property
    def sought(self) -> tuple[int, ...]:
        """The indices of the claims to detect."""
        return sought_claims(self._study, self._scenario, self.claims, self._search.effects)

    @property
    def _most(self) -> int:
        if self._search.simulations is not None:
            return self._search.simulations
        return MOST_OF_MODELS if self.is_slow else MOST

    @property
    def is_slow(self) -> bool:
        """Whether models are fitted to one experiment at a time."""
        return self._simulation(self._search.last).is_slow

    @property
    def fewest(self) -> int:
        """The first number of experiments for each number of repetitions."""
        return FEWEST_OF_MODELS if self.is_slow else FEWEST

    def _simulation(self, repetitions: int) -> Simulation:
        if repetitions not in self._simulations:
            seed, batch = (self._search.seed,), self._search.first_batch
            simulation = Simulation(self._study, self._scenario, repetitions, seed=seed, first_batch=batch)
            self._simulations[repetitions] = simulation
        return self._simulations[repetitions]

    def grow(self, repetitions: int, experiments: int) -> None:
        """Simulate until there are this many experiments, up to the limit."""
        wanted = min(experiments, self._most)
        told = self._counted.setdefault(repetitions, _Counted([0] * (len(self.claims) + 1)))
        while told.experiments < wanted:
            some = min(AT_ONCE, wanted - told.experiments)
            self._progress(repetitions, told.experiments + some)
            found = self._simulation(repetitions).found(told.parts, some)  # each part has experiments of its own
            each = [found.get(claim.key, np.zeros(some, dtype=bool)) for claim in self.claims]
            each.append(np.all([each[place] for place in self.sought], axis=0))
            told.counts = [old + int(new.sum()) for old, new in zip(told.counts, each, strict=True)]
            told.experiments, told.parts = told.experiments + some, told.parts + 1

    def least(self, repetitions: int) -> Found:
        """Return the power of the sought claim that is found least often."""
        told = self._counted[repetitions]
        return Found(min(told.counts[place] for place in self.sought), told.experiments)

    def settled(self, repetitions: int) -> Found:
        """Simulate until the power is clearly above or below the target, up to the limit."""
        experiments = self.fewest
        self.grow(repetitions, experiments)
        while self._counted[repetitions].experiments < self._most:
            low, high = self.least(repetitions).interval
            if not low <= self._search.power <= high:
                break
            experiments *= 2
            self.grow(repetitions, experiments)
        return self.least(repetitions)

    def first_where(self, suffices: Callable[[Found], bool]) -> int | None:
        """Return the fewest repetitions that suffice, by bisection; None if the last does not suffice."""
        below, above = self.first - 1, self._search.last
        if not suffices(self.settled(above)):
            return None
        while above - below > 1:
            middle = (below + above) // 2
            if suffices(self.settled(middle)):
                above = middle
            else:
                below = middle
        return above

    def points(self) -> tuple[PowerPoint, ...]:
        """Return the points of the curve, by number of repetitions."""
        return tuple(
            PowerPoint(
                repetitions,
                self._study.runs(repetitions),
                tuple(Found(count, told.experiments) for count in told.counts[:-1]),
                self.least(repetitions),
                Found(told.counts[-1], told.experiments),
            )
            for repetitions, told in sorted(self._counted.items())
        )


def sought_claims(
    study: Study, scenario: Scenario, claims: Sequence[Claim], effects: Collection[str]
) -> tuple[int, ...]:
    """Return the indices of the claims to detect.

    They are the requested ones; else the hypotheses; else the effects with stated differences; else the main effects
    that are there by the assumptions: treatments of a pilot may be exactly alike.

    Raises:
        AnalysisError: a requested effect is not tested, or a claim has no assumed difference.
    """
    if effects:
        chosen = [_place_of(claims, name) for name in effects]
    else:
        kinds = (
            [place for place, claim in enumerate(claims) if claim.is_hypothesis],
            [place for place, claim in enumerate(claims) if claim.key in scenario.given],
            [place for place, claim in enumerate(claims) if _is_there(study, scenario, claim)],
            [place for place, claim in enumerate(claims) if len(claim.key[1]) == 1],
        )
        chosen = next((kind for kind in kinds if kind), [])
    if not chosen:
        raise AnalysisError("nothing is tested", where="power", fix="Give the design a factor with two treatments.")
    for place in chosen:
        _refuse_nothing(study, scenario, claims[place])
    return tuple(dict.fromkeys(chosen))


def _place_of(claims: Sequence[Claim], name: str) -> int:
    """Return the index of a claim, by its label, or by its factors as in `Task x Speed`."""
    for place, claim in enumerate(claims):
        factors = set(name.rpartition(":")[2].split(" x "))
        measure = name.rpartition(":")[0]
        of_factors = not claim.is_hypothesis and claim.key[1] == factors and measure in {"", claim.measure}
        if claim.label == name or of_factors:
            return place
    known = [claim.label for claim in claims]
    raise AnalysisError(f"no test is called {name!r}", where="--effect", fix=did_you_mean(name, known))


def _refuse_nothing(study: Study, scenario: Scenario, claim: Claim) -> None:
    """Refuse to search for an effect that is 0 by the assumptions."""
    factors = claim.key[1] or {
        name
        for each in (study.plan.hypotheses if study.plan is not None else ())
        if each.statement == claim.label and not each.has_bound
        for name in each.factors
    }
    if len(factors) != 1:
        return  # interactions and bounds are not checked
    (factor,) = factors
    if not _differ(study, scenario, claim.measure, factor):
        problem = f"no difference of {factor} is assumed, so that {claim.label!r} cannot be found"
        fix = f"Give --difference {claim.measure}:{factor}=..., or name what is to be found with --effect."
        raise AnalysisError(problem, where="power", fix=fix)


def _is_there(study: Study, scenario: Scenario, claim: Claim) -> bool:
    """Return whether a claim is a main effect with an assumed difference."""
    return len(claim.key[1]) == 1 and _differ(study, scenario, claim.measure, *claim.key[1])


def _differ(study: Study, scenario: Scenario, measure: str, factor: str) -> bool:
    """Return whether the treatments of a factor have different means."""
    place = list(study.factors).index(factor)
    means = next(each.means for each in scenario.measures if each.name == measure)
    each = [np.mean([mean for cell, mean in means.items() if cell[place] == text]) for text in study.factors[factor]]
    return bool(np.ptp(each) > 1e-9 * max(1.0, float(np.max(np.abs(each)))))
