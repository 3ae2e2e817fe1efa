"""Which function of a script tests an effect; the functions have the same names in R and in Python."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from robot_runner.analysis.recomputing.literals import Code

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.analysis.recomputing.study_facts import Compared

__all__ = ["procedures"]

_OF_BLOCKS = {"welch": "single", "greenhouse_geisser": "greenhouse_geisser", "huynh_feldt": "huynh_feldt"}
_OWN = {
    "welch": "welch_t({})",
    "welch_james": "welch_anova({})",
    "combined": "combined(groups, contrasts, welch_anova({}))",
}


def procedures(nothing: str, function: str) -> dict[str, Callable[..., Code]]:
    """Return what templates call to print the function that tests an effect, and that of the check beside it.

    Args:
        nothing: how the language writes that there is none.
        function: how it writes a function of `groups` and `contrasts`.
    """
    of = partial(_called, nothing, function)
    return {
        "x_of": lambda it: Code("ranks" if it.estimand == "rank" else "x"),
        "beside_of": lambda it: Code("x" if it.estimand == "rank" else "ranks"),
        "procedure": lambda it, effect, values: of(it, effect.test, values, is_drawn=effect.drawn is not None),
        "check_procedure": lambda it, effect, values: of(it, effect.check, values, is_drawn=effect.check_is_drawn),
    }


def _called(nothing: str, function: str, it: Compared, name: str, values: str, *, is_drawn: bool) -> Code:
    if not name:
        return Code(nothing)
    whole = f"bootstrap({name})" if is_drawn else name
    if it.kind == "blocks":
        return Code(_OF_BLOCKS.get(name, f"of_groups({whole})"))
    if it.is_plain and not is_drawn and name in _OWN:  # by functions of R and of scipy
        return Code(function.format(_OWN[name].format(values)))
    return Code(whole)
