"""How an experiment grows that has a design of its own: by what the same design plans for more."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Any

from robot_runner.core.design.design import Design
from robot_runner.core.errors import DesignError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robot_runner.core.design.factor import Combination
    from robot_runner.core.design.growing import Begun, GrownDesign
    from robot_runner.core.design.planned_runs import RunOrder
    from robot_runner.core.design.run_table_model import RunTableModel

__all__ = ["runs_of_grown_design"]


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
