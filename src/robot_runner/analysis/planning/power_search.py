"""How many repetitions suffice: a search over simulated experiments, of which there are more where it is close."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
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
    from robot_runner.analysis.statistics.families import Key

#: Simulated experiments of each number of repetitions: at first, and at most. At 80 % the standard error is 1.3 and 0.4
#: points.
FEWEST, MOST = 1_000, 10_000
#: What is fitted one experiment at a time takes some 5 (outliers) to 50 ms (mixed models) each.
FEWEST_OF_MODELS, MOST_OF_MODELS = 100, 400

#: Numbers of repetitions that the curve has at least.
_POINTS, _POINTS_OF_MODELS = 9, 5
#: Of intervals of shares, which tell the Monte Carlo error.
_LEVEL = 0.95


@dataclass(frozen=True, slots=True)
class Found:
    """How often something was found among simulated experiments."""

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
        """Where the power lies with 95 % confidence (Wilson 1927)."""
        found = stats.binomtest(self.count, self.simulations).proportion_ci(_LEVEL, method="wilson")
        return float(found.low), float(found.high)


@dataclass(frozen=True, slots=True)
class PowerPoint:
    """What so many repetitions find.

    Attributes:
        runs: of the whole experiment.
        claims: how often each claim is found, in the order of `ScenarioPower.claims`.
        least: that claim among those that are sought that is found least often.
        together: how often all that are sought are found in one experiment.
    """

    repetitions: int
    runs: int
    claims: tuple[Found, ...]
    least: Found
    together: Found


@dataclass(frozen=True, slots=True)
class Needed:
    """The answer.

    Attributes:
        repetitions: the fewest with which each claim that is sought is found as often as was asked for.
        low, high: between these the answer lies, as far as the simulation tells; `high` is None where no number that
            was looked at surely suffices.
    """

    repetitions: int
    low: int
    high: int | None


@dataclass(frozen=True, slots=True)
class ScenarioPower:
    """The power under one set of assumptions.

    Attributes:
        claims: everything that is tested.
        sought: which of them are to be found, by their places.
        points: by number of repetitions.
        needed: None where no number in the range suffices.
        too_few: why the first numbers of the range were passed over: of so few runs there is no test or no design; else
            empty.
    """

    scenario: Scenario
    claims: tuple[Claim, ...]
    sought: tuple[int, ...]
    points: tuple[PowerPoint, ...]
    needed: Needed | None
    too_few: str = ""

    def point(self, repetitions: int) -> PowerPoint:
        """Return what so many repetitions find."""
        return {each.repetitions: each for each in self.points}[repetitions]


@dataclass(frozen=True, slots=True)
class Search:
    """What is looked for.

    Attributes:
        power: how often it is to be found, 0..1.
        first, last: the numbers of repetitions among which it is looked for.
        effects: labels of the claims that are sought; empty for those that the plan and the assumptions name.
        simulations: experiments of each number of repetitions, at most; None for as many as are fast.
        seed: what everything is drawn from.
        first_batch: how many repetitions were executed before the experiment is extended.
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
    """Find the fewest repetitions that suffice, and the power of others around them.

    Raises:
        AnalysisError: nothing that is sought is tested, or no test can be made of as many runs as there may be.
    """
    curve = _Curve(study, scenario, search, progress)
    for repetitions in _spread(curve.first, search.last, _POINTS_OF_MODELS if curve.is_slow else _POINTS):
        curve.grow(repetitions, curve.fewest)
    target = search.power
    needed = curve.first_where(lambda found: found.share >= target)
    if needed is not None:
        low = curve.first_where(lambda found: found.interval[1] >= target)
        high = curve.first_where(lambda found: found.interval[0] >= target)
        answer = Needed(needed, min(needed, low or needed), None if high is None else max(needed, high))
    points, answered = curve.points(), None if needed is None else answer
    return ScenarioPower(scenario, curve.claims, curve.sought, points, answered, curve.too_few)


def _spread(first: int, last: int, count: int) -> list[int]:
    """Return numbers from first to last that grow by about the same factor."""
    return sorted({round(each) for each in np.geomspace(first, last, count)} | {first, last})


class _Curve:
    """The counts of all numbers of repetitions that were simulated so far."""

    def __init__(self, study: Study, scenario: Scenario, search: Search, progress: Callable[[int, int], None]) -> None:
        self._study, self._scenario, self._search, self._progress = study, scenario, search, progress
        self._simulations: dict[int, Simulation] = {}
        self._counts: dict[int, tuple[int, ...]] = {}
        self._done: dict[int, int] = {}
        self.too_few = ""

    @cached_property
    def first(self) -> int:
        """The fewest repetitions of which a test can be made: of ranks it takes four runs of each of two treatments."""
        self._simulation(self._search.last)  # where there is no test of most runs either, that is what is told
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
        """Everything that is tested."""
        return self._simulation(self._search.last).claims

    @cached_property
    def sought(self) -> tuple[int, ...]:
        """The places of the claims that are to be found."""
        return sought_claims(self._study, self._scenario, self.claims, self._search.effects)

    @property
    def _most(self) -> int:
        if self._search.simulations is not None:
            return self._search.simulations
        return MOST_OF_MODELS if self.is_slow else MOST

    @property
    def is_slow(self) -> bool:
        """Whether experiments are computed one at a time."""
        return self._simulation(self._search.last).is_slow

    @property
    def fewest(self) -> int:
        """How many experiments each number of repetitions has at first."""
        return FEWEST_OF_MODELS if self.is_slow else FEWEST

    def _simulation(self, repetitions: int) -> Simulation:
        if repetitions not in self._simulations:
            self._simulations[repetitions] = Simulation(
                self._study,
                self._scenario,
                repetitions,
                seed=(self._search.seed,),
                first_batch=self._search.first_batch,
            )
        return self._simulations[repetitions]

    def grow(self, repetitions: int, experiments: int) -> None:
        """Simulate until there are so many experiments, or as many as there may be."""
        wanted = min(experiments, self._most)
        while self._done.get(repetitions, 0) < wanted:
            done = self._done.get(repetitions, 0)
            some = min(AT_ONCE, wanted - done)
            self._progress(repetitions, done + some)
            found = self._simulation(repetitions).found(done // AT_ONCE, some)
            self._take(repetitions, found, some)
            self._done[repetitions] = done + some

    def _take(self, repetitions: int, found: Mapping[Key, np.ndarray], some: int) -> None:
        nothing = np.zeros(some, dtype=bool)
        each = [found.get(claim.key, nothing) for claim in self.claims]
        together = np.all([each[place] for place in self.sought], axis=0)
        before = self._counts.get(repetitions, (0,) * (len(each) + 1))
        added = (*(int(one.sum()) for one in each), int(together.sum()))
        self._counts[repetitions] = tuple(old + new for old, new in zip(before, added, strict=True))

    def least(self, repetitions: int) -> Found:
        """Return how often that claim is found that is found least often."""
        counts = self._counts[repetitions]
        return Found(min(counts[place] for place in self.sought), self._done[repetitions])

    def settled(self, repetitions: int) -> Found:
        """Simulate until it is plain on which side of the target the power lies, or as often as may be."""
        experiments = self.fewest
        self.grow(repetitions, experiments)
        while self._done[repetitions] < self._most:
            low, high = self.least(repetitions).interval
            if not low <= self._search.power <= high:
                break
            experiments *= 2
            self.grow(repetitions, experiments)
        return self.least(repetitions)

    def first_where(self, suffices: Callable[[Found], bool]) -> int | None:
        """Return the fewest repetitions that suffice, by bisection; None where not even the last does."""
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
        """Return everything that was simulated, by number of repetitions."""
        return tuple(
            PowerPoint(
                repetitions,
                self._study.runs(repetitions),
                tuple(Found(count, self._done[repetitions]) for count in self._counts[repetitions][:-1]),
                self.least(repetitions),
                Found(self._counts[repetitions][-1], self._done[repetitions]),
            )
            for repetitions in sorted(self._counts)
        )


def sought_claims(
    study: Study, scenario: Scenario, claims: Sequence[Claim], effects: Collection[str]
) -> tuple[int, ...]:
    """Return which claims are to be found.

    They are those asked for; else the hypotheses; else the effects that differences are stated for; else main effects.

    Raises:
        AnalysisError: an effect is asked for that is not tested, or one of which nothing is assumed.
    """
    if effects:
        chosen = [_place_of(claims, name) for name in effects]
    else:
        kinds = (
            [place for place, claim in enumerate(claims) if claim.is_hypothesis],
            [place for place, claim in enumerate(claims) if claim.key in scenario.given],
            [place for place, claim in enumerate(claims) if len(claim.key[1]) == 1],
        )
        chosen = next((kind for kind in kinds if kind), [])
    if not chosen:
        raise AnalysisError("nothing is tested", where="power", fix="Give the design a factor with two treatments.")
    for place in chosen:
        _refuse_nothing(study, scenario, claims[place])
    return tuple(dict.fromkeys(chosen))


def _place_of(claims: Sequence[Claim], name: str) -> int:
    """Return the claim that is meant: by its words, or by its factors as in `Task x Speed`."""
    for place, claim in enumerate(claims):
        factors = set(name.rpartition(":")[2].split(" x "))
        measure = name.rpartition(":")[0]
        of_factors = not claim.is_hypothesis and claim.key[1] == factors and measure in {"", claim.measure}
        if claim.label == name or of_factors:
            return place
    known = [claim.label for claim in claims]
    raise AnalysisError(f"no test is called {name!r}", where="--effect", fix=did_you_mean(name, known))


def _refuse_nothing(study: Study, scenario: Scenario, claim: Claim) -> None:
    """Refuse to look for what the assumptions say is not there.

    Raises:
        AnalysisError: all treatments have the same mean.
    """
    factors = claim.key[1] or {
        name
        for each in (study.plan.hypotheses if study.plan is not None else ())
        if each.statement == claim.label and each.within is None
        for name in each.factors
    }
    if len(factors) != 1:
        return  # of interactions, and of what is to be equivalent
    (factor,) = factors
    place = list(study.factors).index(factor)
    means = next(each.means for each in scenario.measures if each.name == claim.measure)
    each = [np.mean([mean for cell, mean in means.items() if cell[place] == text]) for text in study.factors[factor]]
    if np.ptp(each) <= 1e-9 * max(1.0, float(np.max(np.abs(each)))):
        problem = f"no difference of {factor} is assumed, so that {claim.label!r} cannot be found"
        raise AnalysisError(problem, where="power", fix=f"Give --difference {claim.measure}:{factor}=...")
