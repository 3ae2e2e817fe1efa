"""The ids of runs, which analysis scripts look for, as each version of the earlier tools wrote them."""

from __future__ import annotations

import ast
from enum import Enum
from typing import TYPE_CHECKING

from robot_runner.dialects.recognition import Dialect
from robot_runner.dialects.syntax import imports_of

if TYPE_CHECKING:
    from collections.abc import Collection

    from robot_runner.dialects.recognition import Recognised

__all__ = ["Numbering", "numbering_of"]


class Numbering(Enum):
    """How runs are numbered; the value is the pattern of an id."""

    COUNTED_FROM_0 = "run_{place}"
    COUNTED_FROM_1 = "run_{number}"
    WITH_ITERATION = "run_{place}_iteration_{repetition}"
    WITH_REPETITION = "run_{place}_repetition_{repetition}"

    def run_id(self, place: int, repetition: int) -> str:
        """Return the id of a run.

        Args:
            place: the place of its combination, from 0.
            repetition: which repetition of the combination it is, from 0.

        Example:
            >>> Numbering.WITH_REPETITION.run_id(2, 0)
            'run_2_repetition_0'
        """
        return self.value.format(place=place, number=place + 1, repetition=repetition)


#: Arguments of `RunTableModel`, and which version they came with.
_BY_ARGUMENT = {
    "num_of_repetitions": Numbering.COUNTED_FROM_1,
    "randomize_order": Numbering.COUNTED_FROM_1,
    "iterations": Numbering.WITH_ITERATION,
    "repetitions": Numbering.WITH_REPETITION,
    "num_repetitions": Numbering.WITH_REPETITION,
    "exclude_combinations": Numbering.WITH_REPETITION,
}
#: What only versions of Experiment Runner had whose ids tell the repetition, and what only those before had.
_LATER_NAMES = frozenset({"execute_run", "self_measure"})
_EARLIER_NAMES = frozenset({"exclude_variations", "run_variation", "create_run_table", "get_factor_name"})
_EARLIER_MODULES = frozenset({"Plugins.CodecarbonWrapper"})


def numbering_of(recognised: Recognised, arguments: Collection[str]) -> Numbering:
    """Return how the version numbered its runs that a config was written for.

    Args:
        recognised: the config.
        arguments: the named arguments that it gives to `RunTableModel`.
    """
    for name, numbering in _BY_ARGUMENT.items():
        if name in arguments:
            return numbering
    if recognised.dialect is Dialect.ROBOT_RUNNER:
        return Numbering.COUNTED_FROM_0
    names = _names_in(recognised.tree) | set(arguments)
    modules = {each.module for each in imports_of(recognised.tree)}
    if not names & _LATER_NAMES and (names & _EARLIER_NAMES or modules & _EARLIER_MODULES):
        return Numbering.COUNTED_FROM_0
    return Numbering.WITH_REPETITION


def _names_in(tree: ast.Module) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(tree):
        match node:
            case ast.Attribute(attr=name) | ast.FunctionDef(name=name) | ast.Name(id=name):
                names.add(name)
            case _:
                pass
    return names
