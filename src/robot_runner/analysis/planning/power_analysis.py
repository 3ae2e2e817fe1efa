"""The power of a study: from assumptions on its measures to the number of repetitions, in words."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.analysis.planning.assumed_values import (
    AssumedMeasure,
    Scenario,
    assumed_scenario,
    differences_of,
    numbers_of,
    responses_of,
    with_blocks,
)
from robot_runner.analysis.planning.means_table import means_file
from robot_runner.analysis.planning.pilot_values import Pilot, pilot_values
from robot_runner.analysis.planning.power_search import Found, ScenarioPower, Search, search_repetitions
from robot_runner.analysis.wording import sentence, shown_level
from robot_runner.core.design.analysis_plan import Family
from robot_runner.core.errors import AnalysisError
from robot_runner.core.words import counted, enumerated

if TYPE_CHECKING:
    from robot_runner.analysis.planning.planned_study import Study
    from robot_runner.analysis.results import Results
    from robot_runner.core.design.analysis_plan import AnalysisPlan

#: The most measures of a pilot without a plan: each is a separate family, and more would only take time.
_MOST_MEASURES = 6
_FORMAT = 1


@dataclass(frozen=True, slots=True)
class Assumptions:
    """The assumptions, as options state them.

    Attributes:
        pilot: an executed experiment, whose means, standard deviations and blocks are taken.
        means: a CSV file of means.
        measures: the measures; empty for those of the plan.
        spreads, blocks, shares: texts such as `12` or `Energy=12`; shares are of yes, in percent.
        differences, responses: texts such as `Task=5` or `Energy:Task=5`; of responses also those of spreads.
    """

    pilot: Results | None = None
    means: Path | None = None
    measures: Sequence[str] = ()
    spreads: Sequence[str] = ()
    differences: Sequence[str] = ()
    blocks: Sequence[str] = ()
    responses: Sequence[str] = ()
    shares: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class PowerAnalysis:
    """The power of a study.

    Attributes:
        scenarios: one for each set of assumptions.
        notes: the limits of the figures.
    """

    study: Study
    search: Search
    scenarios: tuple[ScenarioPower, ...]
    notes: tuple[str, ...] = field(default=())

    def as_mapping(self) -> dict[str, Any]:
        """Return everything as plain data."""
        plan = self.study.plan
        return {
            "format": _FORMAT,
            "experiment": self.study.name,
            "factors": {name: list(texts) for name, texts in self.study.factors.items()},
            "combinations": len(self.study.cells),
            "columns": {name: list(texts) for name, texts in self.study.columns.items()},
            "blocks": self.study.blocks,
            "analysis": plan.as_mapping() if plan is not None else None,
            "power": self.search.power,
            "repetitions": [self.search.first, self.search.last],
            "first_batch": self.search.first_batch,
            "seed": self.search.seed,
            "scenarios": [_scenario_as_mapping(each) for each in self.scenarios],
            "answers": [answer_in_words(self, each) for each in self.scenarios],
            "notes": list(self.notes),
        }


def _scenario_as_mapping(each: ScenarioPower) -> dict[str, Any]:
    return {
        "title": each.scenario.title,
        "assumed": [_assumed_as_mapping(measure) for measure in each.scenario.measures],
        "sought": [each.claims[place].label for place in each.sought],
        "needed": None if each.needed is None else asdict(each.needed),
        "points": [
            {
                "repetitions": point.repetitions,
                "runs": point.runs,
                "simulations": point.least.simulations,
                "least": _found_as_mapping(point.least),
                "together": _found_as_mapping(point.together),
                "claims": [
                    {"claim": claim.label, "measure": claim.measure, **_found_as_mapping(found)}
                    for claim, found in zip(each.claims, point.claims, strict=True)
                ],
            }
            for point in each.points
        ],
    }


def _assumed_as_mapping(measure: AssumedMeasure) -> dict[str, Any]:
    return {
        "measure": measure.name,
        "is_share": measure.is_share,
        "combinations": [
            {"treatments": list(cell), "mean": measure.means[cell], "sd": measure.spreads[cell]}
            for cell in measure.means
        ],
        "block_sd": measure.block_sd,
        "response_sd": {" x ".join(term): spread for term, spread in measure.responses.items()},
    }


def _found_as_mapping(found: Found) -> dict[str, Any]:
    low, high = found.interval
    return {"power": found.share, "error": found.error, "low": low, "high": high}


def power_analysis(
    study: Study, assumptions: Assumptions, search: Search, progress: Callable[[int, int], None] = lambda _, __: None
) -> PowerAnalysis:
    """Find how many repetitions a study needs, under each set of assumptions.

    Raises:
        AnalysisError: the assumptions are incomplete, or name a factor or measure that the study does not have.
    """
    _refuse_vain(study, assumptions)
    measures, pilot = _measured(study, assumptions)
    scenarios = _varying_scenarios(study, assumptions, measures, pilot)
    found = tuple(search_repetitions(study, each, search, progress) for each in scenarios)
    return PowerAnalysis(study, search, found, tuple(_notes(study, measures, pilot, found)))


def _refuse_vain(study: Study, assumptions: Assumptions) -> None:
    """Refuse what is said of blocks that the study does not have."""
    for option, given in (("--block-sd", assumptions.blocks), ("--response-sd", assumptions.responses)):
        if given and not study.has_units:
            fix = "Leave it out, or say in the config what blocks are: blocks=... with shuffle=True, or a design."
            raise AnalysisError("the study has no blocks, whole plots or subjects", where=option, fix=fix)


def scenarios_of(study: Study, assumptions: Assumptions) -> list[Scenario]:
    """Return the scenarios of a study, including the variance of blocks.

    Raises:
        AnalysisError: the assumptions are incomplete, or name a factor or measure that the study does not have.
    """
    return _varying_scenarios(study, assumptions, *_measured(study, assumptions))


def _varying_scenarios(
    study: Study, assumptions: Assumptions, measures: tuple[str, ...], pilot: Pilot | None
) -> list[Scenario]:
    scenarios = list(_scenarios(study, assumptions, measures, pilot))
    blocks = numbers_of(study, "--block-sd", assumptions.blocks, measures)
    responses = responses_of(study, assumptions.responses, measures)
    found = [with_blocks(each, blocks, responses) for each in scenarios]
    for name in dict.fromkeys(measure.name for each in found for measure in each.measures if measure.is_constant):
        problem = f"runs of one combination are assumed to have the same {name}, so that nothing can be tested"
        plan = "analysis = AnalysisPlan(measures=[...]) in the config"
        fix = f"Say how much they vary: --sd {name}=... Or leave it out, and name the primary measures: {plan}."
        raise AnalysisError(problem, where="power", fix=fix)
    return found


def _measured(study: Study, assumptions: Assumptions) -> tuple[tuple[str, ...], Pilot | None]:
    measures = _measures(study, assumptions)
    return measures, pilot_values(study, assumptions.pilot, measures) if assumptions.pilot is not None else None


def _measures(study: Study, assumptions: Assumptions) -> tuple[str, ...]:
    """Return the measures to simulate: the requested ones, those of the plan, or all with assumptions."""
    asked = tuple(study.measure(name, "--measure") for name in assumptions.measures)
    if study.plan is not None:
        return asked or tuple(study.measure(name, "analysis") for name in study.plan.measures)
    options = (("--sd", assumptions.spreads), ("--share", assumptions.shares))
    named = [(text.rpartition("=")[0].strip(), option) for option, texts in options for text in texts]
    found = asked or tuple(dict.fromkeys(study.measure(name, option) for name, option in named if name))
    if not found and assumptions.pilot is not None:
        found = tuple(name for name in study.units if name in assumptions.pilot.measures)[:_MOST_MEASURES]
    if not found and len(study.units) == 1:
        found = tuple(study.units)
    if not found:
        names = ", ".join(study.units)
        fix = f"Name one with --measure ({names}), or write an AnalysisPlan."
        raise AnalysisError("the config has no analysis plan, and no measure is named", where="power", fix=fix)
    return found


def _scenarios(
    study: Study, assumptions: Assumptions, measures: Sequence[str], pilot: Pilot | None
) -> Iterator[Scenario]:
    spreads = numbers_of(study, "--sd", assumptions.spreads, measures)
    differences = differences_of(study, assumptions.differences, measures)
    shares = _shares(study, assumptions.shares, measures)
    base: Mapping[str, AssumedMeasure] = pilot.measures if pilot is not None else {}
    if assumptions.means is not None:
        if pilot is not None:
            fix = "Give one of them."
            raise AnalysisError("--means and --pilot both say what the means are", where="power", fix=fix)
        base = means_file(study, assumptions.means, spreads, measures)
        _refuse_unknown(measures, base, f"--means {assumptions.means}")
    base = {name: _with_share(each, shares[name]) if name in shares else each for name, each in base.items()}
    answers = {*shares, *(name for name, each in base.items() if each.is_share)}
    for text in assumptions.spreads:
        if answers.issuperset(of := numbers_of(study, "--sd", [text], measures)):
            problem = f"{enumerated(list(of))} is yes or no, whose standard deviation follows from its share"
            raise AnalysisError(problem, where=f"--sd {text}", fix="Leave it out.")
    base = {name: each.with_spread(spreads[name]) if name in spreads else each for name, each in base.items()}
    assumed = {name: AssumedMeasure.of_shares(name, dict.fromkeys(study.cells, each)) for name, each in shares.items()}
    if base:
        title = "the means of the file" if pilot is None else "the pilot's effects"
        yield Scenario(title, tuple(base[name] for name in measures))
    if differences:
        title = "the smallest effects of interest" if base else "the assumed effects"
        yield assumed_scenario(study, measures, differences, spreads, {**assumed, **base}, title)
    elif not base:
        if not (spreads or shares):
            fix = "Give --pilot FOLDER, or --sd (--share of what is yes or no) and --difference, or --means FILE."
            raise AnalysisError("nothing is assumed of the values that will be measured", where="power", fix=fix)
        unit = "in the measure's unit, or 0 where they are to be shown alike within a bound"
        fix = f"Give what treatments differ by: --difference FACTOR=NUMBER, {unit}."
        raise AnalysisError("no difference is assumed that could be found", where="power", fix=fix)


def _shares(study: Study, texts: Sequence[str], measures: Sequence[str]) -> dict[str, float]:
    """Return the share of yes of each measure in percent, from texts such as `85`, `85%` or `Ok=85`."""
    found: dict[str, float] = {}
    for text in map(str.strip, texts):
        each = numbers_of(study, "--share", [text.removesuffix("%")], measures)
        for share in each.values():
            if 0 < share < 1 and not text.endswith("%"):
                fix = f"Give percent: {100 * share:g} (or {share:g}%, if so few say yes)."
                raise AnalysisError(f"{text!r} reads as a fraction", where="--share", fix=fix)
        found |= each
    return found


def _with_share(known: AssumedMeasure, share: float) -> AssumedMeasure:
    """Return the same with this share of yes over all combinations, in percent, and the same differences and blocks."""
    if not known.is_share:
        fix = "Give --sd in its place, or publish True and False (in a file of means: 80%)."
        raise AnalysisError(f"{known.name} is a number, and not yes or no", where="--share", fix=fix)
    added = share - sum(known.means.values()) / len(known.means)
    return AssumedMeasure.of_shares(known.name, {cell: mean + added for cell, mean in known.means.items()}, known)


def _refuse_unknown(measures: Sequence[str], base: Mapping[str, AssumedMeasure], where: str) -> None:
    missing = [name for name in measures if name not in base]
    if missing:
        fix = f"Add {'a column' if len(missing) == 1 else 'columns'} for {enumerated(missing)}."
        raise AnalysisError(f"the file has no means of {enumerated(missing)}", where=where, fix=fix)


def _notes(study: Study, measures: Sequence[str], pilot: Pilot | None, found: Sequence[ScenarioPower]) -> Iterator[str]:
    if pilot is not None:
        yield from pilot.notes
        yield from dict.fromkeys(note for each in found for note in pilot.on_spreads(each.scenario.measures))
    yield from dict.fromkeys(sentence(each.too_few) for each in found if each.too_few)
    if study.plan is None:
        yield "The config has no analysis plan: each measure's effects are a family at 5 %, corrected after Holm."
    yield from note_on_family(study.plan, measures)
    if len(measures) > 1:
        yield "Measures are drawn independently of each other; where theirs go together, so do their verdicts."
    if study.is_repeated:
        yield "`repeat_until` adds repetitions until measures are precise; the power here is that of a fixed number."
    assumed = [each for of in found for each in of.scenario.measures]
    if study.plan is not None and study.plan.covariates and not all(each.is_share for each in assumed):
        yield "Covariates are drawn as if they told nothing of the measures: where they do, fewer repetitions suffice."
    if not all(each.is_share for each in assumed):
        yield "Values are drawn from normal distributions; skewed ones, and runs that fail, take more repetitions."
    for name in dict.fromkeys(each.name for each in assumed if each.is_share):
        alone = "" if study.has_units else ", independent of all others"
        yield f"{name} is drawn as yes or no: one answer of each run{alone}. Runs that fail take more repetitions."
    planned = study.blocks if study.plan is None or study.plan.blocks is None else study.plan.blocks
    # The blocks of a special design are not among the factors of the study.
    runs = study.arranged(study.repetitions) if study.arranged is not None else ()
    blocked = {name: len({run.blocks[name] for run in runs}) for name in study.facts.get("balance", {})}
    blocked |= {planned: len(study.factors[planned])} if planned and planned in study.factors else {}
    for blocks, how_many in blocked.items() if any(each.needed is None for each in found) else ():
        count = counted(how_many, "block")
        told = "how these differ is the chance that effects are compared with"
        yield f"{blocks} makes {count}: {told}, so that more of them help where more repetitions do not."


def note_on_family(plan: AnalysisPlan | None, measures: Collection[str]) -> Iterator[str]:
    """Yield a note on the primary measures that share the family of those that are simulated, and are not."""
    primary = plan.measures if plan is not None and plan.family is not Family.MEASURE else ()
    left_out = [name for name in primary if name not in measures]
    if left_out and set(measures) & set(primary):
        yield (
            f"Errors are controlled together with those of {enumerated(left_out)}, of which nothing is assumed: "
            f"effects on {'it' if len(left_out) == 1 else 'them'} count as never found, so the power is this or more."
        )


# Answers in words.


def share_in_words(found: Found) -> str:
    """Return a power with its Monte Carlo error, as in `80.9 % (80.0 to 81.7)`."""
    low, high = found.interval
    return f"{100 * found.share:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def answer_in_words(analysis: PowerAnalysis, scenario: ScenarioPower) -> str:
    """Return a sentence on how many repetitions suffice, or that none in the range does."""
    search = analysis.search
    what = "what is sought" if len(scenario.sought) == 1 else "each of what is sought"
    needed = scenario.needed
    point = scenario.point(search.last if needed is None else needed.repetitions)
    finds = "finds" if point.repetitions == 1 else "find"
    those = f"{counted(point.repetitions, 'repetition')} ({counted(point.runs, 'run')})"
    told = f"{those} {finds} {what} in {share_in_words(point.least)} of experiments"
    if needed is None:
        return f"{told}: fewer than {shown_level(search.power)}."
    if needed.repetitions == search.first:
        return f"{told}; fewer were not looked at."
    if needed.low == needed.high == needed.repetitions:
        return f"{told}."
    return f"{told}; the simulation leaves {needed.low} to {'more' if needed.high is None else needed.high}."
