"""Assumptions on the values of a study: the mean and the standard deviation of each combination, and of blocks.

They come from options (`--sd`, `--difference`), a file of means (`means_table`) or a pilot (`pilot_values`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.statistics.effect_coding import Term
from robot_runner.analysis.statistics.families import Key, effect_key
from robot_runner.core.errors import AnalysisError
from robot_runner.core.words import combination_label, enumerated

if TYPE_CHECKING:
    from robot_runner.analysis.planning.planned_study import Cell, Study

AND = " x "
_ROUNDING = 1e-12
_PERCENT = 100.0


@dataclass(frozen=True, slots=True)
class AssumedMeasure:
    """The assumed distribution of a measure: normal, around the mean of each combination, or yes and no.

    Attributes:
        means, spreads: the mean and the standard deviation of each combination, in the measure's unit; of what is yes
            or no the share of yes in percent, and the deviation of 0 and 100.
        block_sd: the standard deviation of block effects, the same for all values of a block.
        responses: the standard deviation of how blocks respond to the treatments of each factor, or to the combinations
            of several: what a block adds to all of its runs of one.
        is_share: whether it is yes or no; what blocks add is then in percentage points.
    """

    name: str
    means: Mapping[Cell, float]
    spreads: Mapping[Cell, float]
    block_sd: float = 0.0
    responses: Mapping[Term, float] = field(default_factory=dict)
    is_share: bool = False

    @classmethod
    def of_shares(cls, name: str, shares: Mapping[Cell, float], like: AssumedMeasure | None = None) -> AssumedMeasure:
        """Return the assumption on a measure that is yes or no, whose blocks vary like those of another.

        The shares of yes of each combination are in percent. With `like` of None there are no blocks.

        Raises:
            AnalysisError: a share is not one of a hundred.
        """
        for cell, share in shares.items():
            if not 0 <= share <= _PERCENT:
                problem = f"{share:g} % of the runs of {combination_label(cell)} would say yes to {name}"
                fix = f"Give shares from 0 to 100 %: a difference lies half above --share {name}=... and half below."
                raise AnalysisError(problem, where="power", fix=fix)
        spreads = {cell: math.sqrt(share * (_PERCENT - share)) for cell, share in shares.items()}
        of_blocks = (0.0, {}) if like is None else (like.block_sd, like.responses)
        return cls(name, shares, spreads, *of_blocks, is_share=True)

    @property
    def is_constant(self) -> bool:
        """Whether runs of a combination within a block are equal, except for rounding; those that say yes may be."""
        return not self.is_share and max(*self.spreads.values(), *self.responses.values()) <= _ROUNDING * max(
            map(abs, self.means.values())
        )

    def with_spread(self, spread: float) -> AssumedMeasure:
        """Return the same with a common standard deviation for all combinations; a share has its own."""
        return self if self.is_share else replace(self, spreads=dict.fromkeys(self.spreads, spread))

    def draw(
        self,
        random: np.random.Generator,
        experiments: int,
        factors: Sequence[str],
        cells: Sequence[Cell],
        blocks: Sequence[str],
    ) -> Floats:
        """Return the values of many experiments, (experiments, runs); 100 for yes and 0 for no."""
        means = np.array([self.means[cell] for cell in cells])
        spreads = np.array([self.spreads[cell] for cell in cells])
        values = np.tile(means, (experiments, 1))
        if not self.is_share:
            values += spreads * random.normal(size=values.shape)
        _, block = np.unique(blocks, return_inverse=True)
        if self.block_sd:
            values += self.block_sd * random.normal(size=(experiments, block.max() + 1))[:, block]
        for term, spread in self.responses.items():
            held = [tuple(text for name, text in zip(factors, cell, strict=True) if name in term) for cell in cells]
            numbers = {each: place for place, each in enumerate(dict.fromkeys(held))}
            treatment = np.array([numbers[each] for each in held])
            if not spread or len(set(zip(block, treatment, strict=True))) == block.max() + 1:
                continue  # what differs between blocks only is in `block_sd`
            drawn = random.normal(size=(experiments, block.max() + 1, len(numbers)))
            values += spread * drawn[:, block, treatment]
        if self.is_share:
            return np.where(_PERCENT * random.random(values.shape) < values, _PERCENT, 0.0)
        return values


@dataclass(frozen=True, slots=True)
class Scenario:
    """One set of assumptions.

    Attributes:
        title: the origin of the effects, as in `the pilot's effects`.
        given: the effects with a stated difference.
    """

    title: str
    measures: tuple[AssumedMeasure, ...]
    given: frozenset[Key] = frozenset()


@dataclass(frozen=True, slots=True)
class Difference:
    """An assumed difference: the last treatment of a factor minus the first, with the others in the middle.

    For several factors it is their interaction: the change of the first factor's difference from the first to the last
    treatment of the second.
    """

    measure: str
    factors: tuple[str, ...]
    size: float

    def at(self, study: Study, cell: Cell) -> float:
        """Return its contribution to the mean of a combination."""
        share = 1.0
        for name, text in zip(study.factors, cell, strict=True):
            if name in self.factors:
                texts = study.treatments(name)
                share *= {texts[0]: -0.5, texts[-1]: 0.5}.get(text, 0.0)
        return self.size * share


def numbers_of(study: Study, option: str, texts: Sequence[str], measures: Sequence[str]) -> dict[str, float]:
    """Return a number for each measure, from texts such as `12` (for all measures) or `Energy=12`.

    Raises:
        AnalysisError: a text cannot be read, names a measure that is not simulated, or the number is below 0.
    """
    found: dict[str, float] = {}
    for text in texts:
        name, has_name, number = text.rpartition("=")
        names = [study.measure(name.strip(), option, measures)] if has_name else measures
        size = finite_number(number, option, text)
        if size < 0:
            raise _below_zero(text, option)
        found |= dict.fromkeys(names, size)
    return found


def responses_of(study: Study, texts: Sequence[str], measures: Sequence[str]) -> dict[str, dict[Term, float]]:
    """Return how blocks respond, for each measure, from texts such as `5`, `Energy=5` or `Energy:Task=5`.

    Without a factor, blocks respond to each factor by so much.

    Raises:
        AnalysisError: a text cannot be read, or names a factor or measure that cannot be used.
    """
    option, found = "--response-sd", dict[str, dict[Term, float]]()
    told: list[tuple[str, Term, float]]
    for text in texts:
        what = text.rpartition("=")[0].strip()
        if not what or what in study.units:
            each_factor = numbers_of(study, option, [text], measures)
            told = [(measure, (name,), size) for measure, size in each_factor.items() for name in study.varied]
        else:
            told = [(each.measure, each.factors, each.size) for each in differences_of(study, [text], measures, option)]
        for measure, factors, size in told:
            if size < 0:
                raise _below_zero(text, option)
            found.setdefault(measure, {})[factors] = size
    return found


def _below_zero(text: str, option: str) -> AnalysisError:
    what = "share of yes, in percent" if option == "--share" else "standard deviation"
    return AnalysisError(f"{text!r} is below 0", where=option, fix=f"Give a {what}.")


def differences_of(
    study: Study, texts: Sequence[str], measures: Sequence[str], option: str = "--difference"
) -> list[Difference]:
    """Return the differences in texts such as `Task=5`, `Energy:Task=5` or `Task x Speed=3`.

    Raises:
        AnalysisError: a text cannot be read, or names a factor or measure that cannot be used.
    """
    found = []
    for text in texts:
        what, _, number = text.rpartition("=")
        measure, has_measure, names = what.rpartition(":")
        if not what:
            fix = "Write FACTOR=NUMBER, as in --difference Task=5."
            raise AnalysisError(f"{text!r} is not a difference", where=option, fix=fix)
        factors = tuple(each.strip() for each in names.split(AND))
        for name in factors:
            study.factor(name, option)
            if len(study.treatments(name)) < 2:  # noqa: PLR2004 - a difference takes two
                fix = f"Name a factor with two treatments: {', '.join(study.varied)}."
                raise AnalysisError(f"{name} has a single treatment", where=option, fix=fix)
            if name not in study.varied:
                fix = f"Name a factor whose effect is tested: {', '.join(study.varied)}."
                raise AnalysisError(f"{name} makes the blocks, and has no effect to test", where=option, fix=fix)
        if len(set(factors)) < len(factors):
            raise AnalysisError(f"{text!r} names a factor twice", where=option, fix="Name each factor once.")
        apart = study.apart(factors)
        if apart:
            fix = f"Name {' x '.join(each for each in factors if each != apart[1])}, or {apart[1]} by itself."
            raise AnalysisError(f"{apart[0]} has one treatment where {apart[1]} applies", where=option, fix=fix)
        of = [study.measure(measure.strip(), option, measures)] if has_measure else measures
        found += [Difference(each, factors, finite_number(number, option, text)) for each in of]
    return found


def finite_number(text: str, where: str, shown: str) -> float:
    """Return the number that a text is; raise an `AnalysisError` on what is `shown` if it is none, or infinite."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise AnalysisError(f"{shown!r} has no number", where=where, fix="Give a number in the measure's unit.")
    return number


def assumed_scenario(
    study: Study,
    measures: Sequence[str],
    differences: Sequence[Difference],
    spreads: Mapping[str, float],
    base: Mapping[str, AssumedMeasure],
    title: str,
) -> Scenario:
    """Return a scenario with stated differences.

    All effects without a stated difference are 0. Of the known values in `base`, such as a pilot's, or shares, only the
    grand mean of the means is used; `spreads` has the standard deviation of each measure that it lacks.

    Raises:
        AnalysisError: the standard deviation of a measure is unknown.
    """
    missing = [name for name in measures if name not in spreads and name not in base]
    if missing:
        fix = "Give " + " ".join(f"--sd {name}=..." for name in missing) + " (--share of what is yes or no)"
        fix += ", or a pilot: --pilot FOLDER."
        fix += "" if len(measures) == len(missing) else " Or name the others with --measure."
        raise AnalysisError(f"nothing is assumed of {enumerated(missing)}", where="power", fix=fix)
    _refuse_bounds(study, [name for name in measures if name not in base])
    made = []
    for name in measures:
        known = base.get(name)
        centre = float(np.mean(list(known.means.values()))) if known is not None else 0.0
        mine = [each for each in differences if each.measure == name]
        means = {cell: centre + sum(each.at(study, cell) for each in mine) for cell in study.cells}
        if known is None:
            made.append(AssumedMeasure(name, means, dict.fromkeys(study.cells, spreads[name])))
        elif known.is_share:
            made.append(AssumedMeasure.of_shares(name, means, known))
        else:
            made.append(replace(known, means=means))
    return Scenario(title, tuple(made), frozenset(effect_key(each.measure, each.factors) for each in differences))


def _refuse_bounds(study: Study, measures: Sequence[str]) -> None:
    """Refuse differences without means for measures whose values the plan leaves out beyond bounds."""
    rule = study.plan.outliers if study.plan is not None else None
    bound = [name for name in measures if rule is not None and name in rule.bounds]
    if bound:
        problem = (
            f"the plan leaves out values of {enumerated(bound)} beyond bounds, and nothing says how large they are"
        )
        raise AnalysisError(problem, where="power", fix="Give their means: --pilot FOLDER, or (of power) --means FILE.")


def with_blocks(
    scenario: Scenario, blocks: Mapping[str, float], responses: Mapping[str, Mapping[Term, float]]
) -> Scenario:
    """Return the same with these standard deviations of blocks and of their responses, by measure."""
    return replace(
        scenario,
        measures=tuple(
            replace(
                each, block_sd=blocks.get(each.name, each.block_sd), responses=responses.get(each.name, each.responses)
            )
            for each in scenario.measures
        ),
    )
