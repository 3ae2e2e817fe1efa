"""Comparison of designs within a time budget: aliases, runs and power."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import comb
from typing import TYPE_CHECKING, Any

import numpy as np

from robot_runner.analysis.planning.candidate_designs import Candidate, RunTimes, most_repetitions
from robot_runner.analysis.planning.planned_study import Study
from robot_runner.analysis.planning.power_analysis import Assumptions, note_on_family, scenarios_of
from robot_runner.analysis.planning.power_search import sought_claims
from robot_runner.analysis.planning.power_simulation import AT_ONCE, Simulation
from robot_runner.analysis.statistics.analysed_design import design_of
from robot_runner.analysis.statistics.cell_layout import MOST_FACTORS
from robot_runner.analysis.wording import shown_level
from robot_runner.core.errors import AnalysisError, DesignError
from robot_runner.core.words import counted, listed, shown_duration

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.known_design import KnownDesign
    from robot_runner.core.design.analysis_plan import AnalysisPlan
    from robot_runner.core.design.run_table_model import RunTableModel

#: The number of simulated experiments per design: the standard error of a power of 80 % is 1.3 percentage points.
_EXPERIMENTS = 2 * AT_ONCE
#: Powers that differ by less, three standard errors of the simulation, count as equal.
_ALIKE = 0.04
_SEED = 20210525
_BEYOND_SQUARES = "what goes beyond squares and interactions of two factors, which is taken to be none"
_WITH_BLOCKS = "effects in part with interactions of blocks, which are taken to be none"


@dataclass(frozen=True, slots=True)
class Asked:
    """The request for a comparison of designs.

    Attributes:
        units: the measures of the run table, with their units.
        assumptions: on the values; if there are none, effects of one standard deviation are assumed.
        effects: the effects to detect; empty for the hypotheses, or all main effects.
        budget: the time budget, in s.
        power: the target power, 0..1.
    """

    name: str
    plan: AnalysisPlan | None
    units: dict[str, str]
    assumptions: Assumptions
    effects: tuple[str, ...]
    budget: float
    power: float = 0.8
    seed: int = 1


@dataclass(frozen=True, slots=True)
class ComparedDesign:
    """The result of one design within the budget.

    Attributes:
        repetitions: the number that fits into the budget; 0 if none does.
        seconds: the duration of all runs, in s.
        aliased: the aliases, in words.
        tells: 3 if all interactions can be estimated, 2 for two-factor interactions, 1 for main effects that are not
            aliased with these, else 0.
        power: the least of the sought claims; None if it is unknown.
        powers: of each sought claim.
        problem: why the design is impossible, or has no power; empty if it has one.
    """

    name: str
    repetitions: int = 0
    runs: int = 0
    seconds: float = 0.0
    combinations: int = 0
    aliased: str = ""
    tells: int = 0
    power: float | None = None
    powers: tuple[tuple[str, float], ...] = ()
    problem: str = ""

    def as_mapping(self) -> dict[str, Any]:
        """Return everything as plain data."""
        return {
            "design": self.name,
            "repetitions": self.repetitions,
            "runs": self.runs,
            "seconds": round(self.seconds, 3),
            "combinations": self.combinations,
            "aliased": self.aliased,
            "power": self.power,
            "powers": [{"claim": claim, "power": power} for claim, power in self.powers],
            "problem": self.problem,
        }


@dataclass(frozen=True, slots=True)
class DesignComparison:
    """The compared designs and the recommended one.

    Attributes:
        designs: in the order of the candidates.
        recommended: the name of a design; empty if none fits.
        reasons: sentences on why it is recommended.
        notes: the limits of the figures.
    """

    asked: Asked
    designs: tuple[ComparedDesign, ...]
    recommended: str
    reasons: tuple[str, ...]
    notes: tuple[str, ...]

    def as_mapping(self) -> dict[str, Any]:
        """Return everything as plain data."""
        return {
            "format": 1,
            "experiment": self.asked.name,
            "budget_s": self.asked.budget,
            "power": self.asked.power,
            "designs": [each.as_mapping() for each in self.designs],
            "recommended": self.recommended or None,
            "reasons": list(self.reasons),
            "notes": list(self.notes),
        }


def compare_designs(
    candidates: Iterable[Candidate], times: RunTimes, asked: Asked, progress: Callable[[str], None] = lambda _: None
) -> DesignComparison:
    """Compare designs.

    Raises:
        AnalysisError: the assumptions are invalid for the study.
    """
    found, candidates = [], list(candidates)
    able = next((each for each in candidates if not each.problem()), None)
    if able is not None:  # invalid assumptions are invalid for all designs
        study = Study.of_model(asked.name, able.made(1), asked.plan, asked.units)
        scenarios_of(study, _assumed(study, asked.assumptions))
    for candidate in candidates:
        progress(candidate.name)
        found.append(_compared(candidate, times, asked))
    best = _best(found, asked.power)
    return DesignComparison(
        asked, tuple(found), best.name if best else "", tuple(_reasons(best, found, asked)), tuple(_notes(asked))
    )


def _compared(candidate: Candidate, times: RunTimes, asked: Asked) -> ComparedDesign:
    found = ComparedDesign(candidate.name)
    problem = candidate.problem()
    if problem:
        return replace(found, problem=problem)
    try:
        repetitions = most_repetitions(candidate, times, asked.budget)
        model = candidate.made(max(1, repetitions))
        study = Study.of_model(asked.name, model, asked.plan, asked.units)
    except DesignError as error:
        return replace(found, problem=error.problem)
    known, tells = _structure(study, model.repetitions)
    found = replace(
        found,
        repetitions=repetitions,
        runs=len(model.plan()),
        seconds=times.seconds(model),
        combinations=len(study.cells),
        aliased=_aliased(known, tells, len(study.varied)),
        tells=tells,
    )
    if not repetitions:
        return replace(found, problem=f"it takes {shown_duration(found.seconds)}, more than the budget")
    return _with_power(found, study, model, asked)


def _structure(study: Study, repetitions: int) -> tuple[KnownDesign, int]:
    """Return the known design, and its `tells` value."""
    zeros = dict.fromkeys(study.units, np.zeros(study.runs(repetitions)))
    design = design_of(study.results(repetitions, zeros))
    known, count = design.known, len(design.factors)
    if known.is_plain:
        return known, 3
    if known.is_surface:
        return known, 2
    if _adds_blocks(known):
        return known, 0
    pairs = count * (count - 1) // 2
    clear = [term for term in known.terms if not any(len(alias) <= len(term) for alias in known.aliases.get(term, ()))]
    if sum(len(term) == 2 for term in clear) == pairs:  # noqa: PLR2004 - interactions of two factors
        every = sum(comb(count, size) for size in range(1, MOST_FACTORS + 1))
        return known, 3 if len(known.terms) == every else 2
    is_clear = not any(len(a) == 2 for t in known.terms if len(t) == 1 for a in known.aliases.get(t, ()))  # noqa: PLR2004
    return known, int(is_clear and known.has_interactions)


def _adds_blocks(known: KnownDesign) -> bool:
    """Return whether a design (a square, a crossover, incomplete blocks) assumes additive blocks and treatments."""
    return bool(known.blocks) and not known.whole_plot


def _aliased(known: KnownDesign, tells: int, factors: int) -> str:
    if known.is_surface or _adds_blocks(known):
        return _BEYOND_SQUARES if known.is_surface else _WITH_BLOCKS
    if known.is_plain or factors == 1:
        return "nothing"
    if known.is_one_at_a_time:
        return "no interaction is seen"
    if not known.has_interactions:
        return "main effects in part with interactions, which are taken to be none"
    named = [
        (" x ".join(term), [" x ".join(each) for each in known.aliases[term]])
        for term in known.terms
        if term in known.aliases
    ]
    if tells == 3 or not named:  # noqa: PLR2004 - everything
        return "nothing" if tells else "interactions"
    return listed([f"{term} = {' = '.join(others)}" for term, others in named], 3)


def _with_power(found: ComparedDesign, study: Study, model: RunTableModel, asked: Asked) -> ComparedDesign:
    try:
        scenario = scenarios_of(study, _assumed(study, asked.assumptions))[-1]
        simulation = Simulation(study, scenario, model.repetitions, seed=(asked.seed, _SEED))
        places = sought_claims(study, scenario, simulation.claims, asked.effects)
    except AnalysisError as error:
        if found.repetitions > 1 or asked.effects:
            return replace(found, problem=error.problem)
        return replace(found, problem=f"nothing can be tested: {error.problem}")
    claims = [simulation.claims[place] for place in places]
    experiments = _EXPERIMENTS if not simulation.is_slow else _EXPERIMENTS // 10
    parts = [simulation.found(part, min(AT_ONCE, experiments)) for part in range(max(1, experiments // AT_ONCE))]
    if untested := [claim.label for claim in claims if not any(claim.key in each for each in parts)]:
        return replace(found, problem=f"it does not test {listed(untested)}")
    counts = [sum(int(np.sum(each.get(claim.key, False))) for each in parts) for claim in claims]
    powers = tuple((claim.label, float(count / experiments)) for claim, count in zip(claims, counts, strict=True))
    return replace(found, power=min(power for _, power in powers), powers=powers)


def _assumed(study: Study, assumptions: Assumptions) -> Assumptions:
    """Return the assumptions; by default, the ends of each factor differ by one standard deviation."""
    if assumptions.pilot is not None or assumptions.means is not None or assumptions.spreads:
        return assumptions
    named = assumptions.differences or [f"{name}=1" for name in study.varied]
    return replace(assumptions, spreads=["1"], differences=named)


def _best(found: Sequence[ComparedDesign], target: float) -> ComparedDesign | None:
    """Return the design with the fewest aliases among those with the target power, or else with the most power."""
    able = [each for each in found if each.power is not None and each.repetitions]
    enough = [each for each in able if (each.power or 0.0) >= target]
    if not able:
        return None
    if enough:
        return max(enough, key=lambda each: (each.tells, round((each.power or 0.0) / _ALIKE), -each.seconds))
    most = max(each.power or 0.0 for each in able)
    return max(
        (each for each in able if (each.power or 0.0) >= most - _ALIKE), key=lambda each: (each.tells, -each.seconds)
    )


def _reasons(best: ComparedDesign | None, found: Sequence[ComparedDesign], asked: Asked) -> Iterator[str]:
    if best is None or best.power is None:
        yield "No design fits the budget and can be tested: allow more time, or leave out factors or treatments."
        return
    yield (
        f"Within {shown_duration(asked.budget)} it has {counted(best.runs, 'run')} "
        f"({counted(best.repetitions, 'repetition')}, {shown_duration(best.seconds)})."
    )
    least = min(best.powers, key=lambda each: each[1])
    if best.power >= asked.power:
        yield (
            f"It finds the {least[0]}, the least certain of what is sought, in {least[1]:.0%} of experiments: "
            f"{shown_level(asked.power)} are asked for."
        )
        yield {
            3: "It tells all effects apart, interactions included.",
            2: "It tells interactions of two factors apart; only those of more factors are mixed with others.",
            1: "Main effects are not mixed with interactions of two factors, which are mixed with each other.",
            0: "Of designs that tell more, none reaches that power in the time: interactions are taken to be none.",
        }[best.tells]
    else:
        yield (
            f"No design reaches {shown_level(asked.power)}: this one finds the {least[0]} in {least[1]:.1%} of "
            "experiments, and no other finds clearly more. Allow more time, leave out treatments, or look for a larger "
            "effect."
        )
    richer = [each for each in found if each.tells > best.tells and each.repetitions and each.power is not None]
    for each in sorted(richer, key=lambda each: -(each.power or 0.0))[:1]:
        yield f"{each.name[:1].upper()}{each.name[1:]} would tell more, and find the least certain in {each.power:.0%}."


def _notes(asked: Asked) -> Iterator[str]:
    assumed = asked.assumptions
    yield from note_on_family(asked.plan, assumed.measures)
    if assumed.pilot is None and assumed.means is None and not assumed.spreads:
        yield (
            "Nothing is assumed of the values (--sd and --difference, or --pilot): the power is that for ends of a "
            "factor that differ by one standard deviation."
        )
    if not assumed.blocks:
        yield (
            "Blocks and whole plots are taken not to vary as a whole: where they do, a split plot finds less of what "
            "is hard to change. Say how with --block-sd."
        )
    yield (
        "Fractions, covering arrays and D-optimal designs gain by leaving out interactions: where these are large, "
        "effects are wrong."
    )
