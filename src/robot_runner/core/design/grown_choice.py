"""What a design chooses besides, once its factors have more treatments."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.core.design.design import CombinationDesign
from robot_runner.core.design.factor import Combination, factor_places, treatment_text
from robot_runner.core.errors import DesignError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from robot_runner.core.design.design import Design
    from robot_runner.core.design.factor import Factor


@dataclass(frozen=True, slots=True)
class Choice:
    """What a design has chosen combinations from, and which.

    Attributes:
        design: that chooses combinations, or plans runs.
        factors: as the config has them.
        combinations: of the plan; one may be there several times.
        repetitions: of each.
        allowed_of: tells which combinations of some factors are allowed.
    """

    design: CombinationDesign | Design
    factors: Sequence[Factor]
    combinations: Iterable[Combination]
    repetitions: int
    allowed_of: Callable[[Sequence[Factor]], Callable[[Combination], bool]]


def grown_choice(choice: Choice, factors: Sequence[Factor]) -> list[Combination]:
    """Return the combinations of the plan, each once, with those that the design chooses besides from more treatments.

    It grows where what it chose before is among what it chooses now, as of one factor at a time.

    Raises:
        DesignError: it would choose others, so that the runs that there are would not belong to the design.
    """
    places = factor_places(factor.name for factor in factors)
    found = planned = _by_texts(choice.combinations)
    texts = {factor.name: set(factor.texts) for factor in factors}
    if texts != {factor.name: set(factor.texts) for factor in choice.factors}:
        found = _chosen_anew(choice, factors)
        if not planned.keys() <= found.keys():
            raise _does_not_grow(choice.design)
    return [Combination(places, tuple(each[name] for name in places)) for each in found.values()]


def _chosen_anew(choice: Choice, factors: Sequence[Factor]) -> dict[tuple[str, ...], Combination]:
    """Return what the design chooses from the same factors with more treatments; nothing where it cannot."""
    texts = {factor.name: set(factor.texts) for factor in factors}
    has_more = all(set(factor.texts) <= texts.get(factor.name, set()) for factor in choice.factors)
    if not has_more or len(texts) > len(choice.factors) or any(factor.range is not None for factor in choice.factors):
        return {}
    if not isinstance(choice.design, CombinationDesign) or any(choice.design.findings(factors, choice.repetitions)):
        return {}
    return _by_texts(choice.design.choose(factors, choice.allowed_of(factors)).combinations)


def _by_texts(combinations: Iterable[Combination]) -> dict[tuple[str, ...], Combination]:
    return {tuple(treatment_text(each[name]) for name in sorted(each)): each for each in combinations}


def _does_not_grow(design: CombinationDesign | Design) -> DesignError:
    kind = str(design.as_mapping()["kind"]).replace("_", " ")
    problem = f"the {kind} chose its combinations from the factors as the config has them, and would choose others"
    fix = (
        "Add repetitions, or execute an experiment of its own with the other factors. (A full factorial takes "
        "treatments and factors, one factor at a time takes treatments.)"
    )
    return DesignError(problem, where="design", fix=fix)
