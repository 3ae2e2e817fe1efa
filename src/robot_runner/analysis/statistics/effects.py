"""The line of a table of tests, with its conclusion in plain words."""

from __future__ import annotations

import math
from importlib.metadata import version
from typing import TYPE_CHECKING

from robot_runner.analysis.statistics.tested import Effect
from robot_runner.analysis.wording import listed, p_in_words

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.tested import EffectSize

__all__ = ["library", "make_effect"]


def library(name: str) -> str:
    """Return a library with its version, as in `scipy 1.17.1`."""
    return f"{name} {version(name)}"


def make_effect(
    measure: str,
    factors: tuple[str, ...],
    statistic: tuple[str, float],
    freedom: tuple[float, ...],
    p_value: float,
    alpha: float,
    sizes: tuple[EffectSize, ...],
) -> Effect:
    """Return a tested effect; a p-value that is no number is none."""
    name, value = statistic
    if not all(map(math.isfinite, (p_value, value, *freedom))):
        return Effect(factors, name, None, (), None, None, (), f"The effect of {_named(factors)} was not computed.")
    is_significant = p_value < alpha
    in_brackets = ", ".join(map(_number, freedom))
    figures = f"{name}{f'({in_brackets})' if freedom else ''} = {value:.3g}, {p_in_words(p_value)}"
    return Effect(
        factors,
        name,
        value,
        freedom,
        p_value,
        is_significant,
        sizes,
        _conclusion(measure, factors, figures, sizes, is_significant),
    )


def _conclusion(
    measure: str, factors: tuple[str, ...], figures: str, sizes: tuple[EffectSize, ...], is_significant: bool
) -> str:
    if not is_significant:
        what = f"an interaction of {listed(factors)}" if len(factors) > 1 else f"an effect of {factors[0]}"
        return f"The data do not show {what} on {measure} ({figures}); that is no proof that there is none."
    size = f"; the effect is {sizes[0].magnitude.value}, {sizes[0].name} = {sizes[0].value:.2f}" if sizes else ""
    if len(factors) > 1:
        others = listed(factors[1:])
        return f"The effect of {factors[0]} on {measure} depends on {others} ({figures}{size})."
    return f"{factors[0]} has an effect on {measure} ({figures}{size})."


def _named(factors: tuple[str, ...]) -> str:
    return listed(factors)


def _number(value: float) -> str:
    return f"{value:g}" if float(value).is_integer() else f"{value:.2f}"
