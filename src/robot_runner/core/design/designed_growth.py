"""How an experiment grows that has a design of its own: by what the same design plans, or chooses, for more."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Any

from robot_runner.core.design.design import CombinationDesign, Design
from robot_runner.core.design.factor import Combination, factor_places, treatment_text
from robot_runner.core.errors import DesignError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from robot_runner.core.design.factor import Factor
    from robot_runner.core.design.growing import Begun, GrownDesign
    from robot_runner.core.design.planned_runs import RunOrder
    from robot_runner.core.design.run_table_model import RunTableModel

__all__ = ["combinations_of_choice", "runs_of_grown_design"]


def combinations_of_choice(model: RunTableModel, factors: Sequence[Factor]) -> list[Combination]:
    """Return the combinations of the plan, each once, with those that the design chooses besides from more treatments.

    It grows where what it chose before is among what it chooses now, as of one factor at a time.

    Args:
        model: whose design chooses combinations, or plans runs.
        factors: the model's, perhaps in another order and with more treatments.

    Raises:
        DesignError: it would choose others, so that the runs that there are would not belong to the design.
    """
    places = factor_places(factor.name for factor in factors)
    found = planned = _by_texts(run.combination for run in model.plan())
    texts = {factor.name: set(factor.texts) for factor in factors}
    if texts != {factor.name: set(factor.texts) for factor in model.factors}:
        found = _chosen_anew(model, factors)
        if not planned.keys() <= found.keys():
            raise _does_not_grow(model)
    return [Combination(places, tuple(each[name] for name in places)) for each in found.values()]


def _chosen_anew(model: RunTableModel, factors: Sequence[Factor]) -> dict[tuple[str, ...], Combination]:
    """Return what the design chooses from the same factors with more treatments; nothing where it cannot."""
    texts = {factor.name: set(factor.texts) for factor in factors}
    has_more = all(set(factor.texts) <= texts.get(factor.name, set()) for factor in model.factors)
    if not has_more or len(texts) > len(model.factors) or any(factor.range is not None for factor in model.factors):
        return {}
    if not isinstance(model.design, CombinationDesign) or any(model.design.findings(factors, model.repetitions)):
        return {}
    return _by_texts(model.design.choose(factors, model.allowed_of(factors)).combinations)


def _by_texts(combinations: Iterable[Combination]) -> dict[tuple[str, ...], Combination]:
    return {tuple(treatment_text(each[name]) for name in sorted(each)): each for each in combinations}


def _does_not_grow(model: RunTableModel) -> DesignError:
    kind = str(model.design.as_mapping()["kind"]).replace("_", " ")
    problem = f"the {kind} chose its combinations from the factors as the config has them, and would choose others"
    fix = (
        "Add repetitions, or execute an experiment of its own with the other factors. (A full factorial takes "
        "treatments and factors, one factor at a time takes treatments.)"
    )
    return DesignError(problem, where="design", fix=fix)


def runs_of_grown_design(
    begun: Begun, config: RunTableModel, design: GrownDesign, order: RunOrder
) -> list[tuple[Combination, int]]:
    """Return the runs that the design plans beyond those that there are, in its order.

    Args:
        begun: as the run table has it.
        config: the design as the config has it.
        design: the factors and repetitions that there are to be.
        order: the seed of the first plan, and whether it was randomised: the same, so that what there is stays.

    Raises:
        DesignError: it cannot be made for so many, or it would have planned other runs than there are.
    """
    if not isinstance(config.design, Design):
        return []
    allowed = config.allowed_of(design.factors)
    planned = config.design.runs(design.factors, allowed, design.repetitions, order.seed, order.shuffle)
    wanted: defaultdict[tuple[str, ...], set[int]] = defaultdict(set)
    for run in planned.runs:
        wanted[_texts(run.combination, design)].add(run.repetition)
    there: defaultdict[tuple[str, ...], set[int]] = defaultdict(set)
    for run in begun.counted_runs:
        if not run.is_warm_up:
            there[_texts({**design.defaults, **run.combination}, design)].add(run.repetition)
    fits = all(numbers <= wanted[texts] for texts, numbers in there.items())
    in_place = planned.facts.get("repetitions_in_place") and design.repetitions > begun.repetitions
    if in_place or not fits:
        grows = planned.facts.get("grows_by", "repetitions")
        problem = "the runs that there are would not be part of the design with what is to be added"
        raise DesignError(problem, where="design", fix=f"Add {grows}, or begin another experiment.")
    return [
        (run.combination, run.repetition)
        for run in planned.runs
        if run.repetition not in there[_texts(run.combination, design)]
    ]


def _texts(combination: Mapping[str, Any], design: GrownDesign) -> tuple[str, ...]:
    return tuple(str(combination[factor.name]) for factor in design.factors)
