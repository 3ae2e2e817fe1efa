"""How much power the statistics lack to the best test of each design."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from benchmarks.null_designs import NullDesign
from benchmarks.table import Judged
from robot_runner.analysis.statistics.cell_layout import layout_of
from robot_runner.analysis.statistics.cell_means import CellMeans
from robot_runner.analysis.statistics.descriptive import quiet
from robot_runner.core.design.analysis_plan import Statistic

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

__all__ = ["COMPARED"]

_ALPHA = 0.05
_DRAWS = 199
#: What may be lacked to the best test, in percent.
_LACKED = 3.0


def _linear(design: NullDesign) -> Floats:
    """Return effects of the first factor that the analysis of variance finds in about four of five experiments."""
    levels, units = design.levels[0], len(design.rows()) / np.prod(design.levels)
    each = np.linspace(-0.5, 0.5, levels)
    size = math.sqrt((8 + 1.4 * (levels - 2)) / np.sum(each**2) / (units * np.prod(design.levels[1:])))
    return np.asarray(size * (1 + 1 / units) * each)


def _first_two(design: NullDesign) -> Floats:
    """Return effects on the first two treatments alone, which the t-test of these finds in about four of five."""
    units = len(design.rows()) / np.prod(design.levels)
    effects = np.zeros(design.levels[0])
    effects[:2] = np.array([-0.5, 0.5]) * math.sqrt(16 / units) * (1 + 1 / units)
    return effects


def _compared(
    design: NullDesign, effects_of: Callable[[NullDesign], Floats], random: np.random.Generator, count: int
) -> Judged:
    """Compare the power for the first factor with that of other tests of it.

    Beside equal spreads that is the analysis of variance, which takes them to be equal.
    """
    values = design.draw(random, count) + effects_of(design)[[cell[0] for _, cell, _ in design.rows()]]
    layout = layout_of(design.data(values[0]))
    if layout is None:
        raise ValueError(f"{design.name} takes a model")

    def power(statistic: Statistic) -> tuple[str, float]:
        with quiet():
            test = next(CellMeans.of_values(layout, values, statistic=statistic, draws=_DRAWS).effects())
        return test.test, 100 * float(np.mean(test.p_value <= _ALPHA))

    name, ours = power(Statistic.COMBINED)
    others = {"F": 100 * float(np.mean(_classical(design, values) <= _ALPHA))} if design.spread == 1 else {}
    if " and " in name:
        others |= dict(map(power, (Statistic.WELCH_JAMES, Statistic.ANOVA_TYPE)))
    best = max(others.values())
    beside = ", ".join(f"{other} {value:.1f} %" for other, value in others.items())
    error = 2 * 100 * math.sqrt(0.1 / count)  # of a difference between tests that mostly agree
    slack = error if count < 10_000 else 0.0
    return Judged(f"{design.name}: {name}", best - ours, best - ours, design.bounds, design.why, beside, slack)


def _classical(design: NullDesign, values: Floats) -> Floats:
    """Return p-values of the first factor by the analysis of variance with one variance."""
    rows = design.rows()
    factor = np.array([cell[0] for _, cell, _ in rows])
    units = np.array([block if design.blocks else place for block, _, place in rows])
    if design.blocks:  # what blocks have in common, beside how they differ in it
        cells = [(block, level) for block in range(design.blocks) for level in range(design.levels[0])]
        values = np.stack(
            [values[:, (units == block) & (factor == level)].mean(axis=1) for block, level in cells], axis=1
        )
        units, factor = (np.array([cell[place] for cell in cells]) for place in (0, 1))
    model = np.stack([units == each for each in sorted(set(units.tolist()))], axis=1).astype(float)
    if design.blocks:
        model = np.column_stack([model, *[factor == level for level in range(1, design.levels[0])]])
    residuals = values - values @ (model @ np.linalg.pinv(model))
    runs = values.shape[1]
    freedom = (design.levels[0] - 1, runs - np.linalg.matrix_rank(model))
    means = np.stack([values[:, factor == level].mean(axis=1) for level in range(design.levels[0])], axis=1)
    between = runs / design.levels[0] * np.sum((means - means.mean(axis=1, keepdims=True)) ** 2, axis=1)
    f_value = between / freedom[0] / (np.sum(residuals**2, axis=1) / freedom[1])
    return np.asarray(stats.f.sf(f_value, *freedom))


_FEW_BLOCKS = "Huynh-Feldt is careful of few blocks"
_BOOTSTRAP = "many groups of few runs: the bootstrap is careful"
_WEIGHED = "Welch-James alone finds more, and less where spreads are equal"


def _equal_spreads() -> Iterator[NullDesign]:
    for runs in (5, 7, 10, 30):
        yield from (NullDesign(levels, runs) for levels in ((2,), (3,), (5,), (2, 2), (3, 2), (3, 3)))
    yield NullDesign((8,), 5, bounds=(-1.0, 7.0), why=_BOOTSTRAP)
    yield NullDesign((8,), 10)
    yield from (NullDesign((2,), 1, blocks=blocks) for blocks in (5, 10, 30))
    yield NullDesign((3,), 1, blocks=5, bounds=(-1.0, 6.0), why=_FEW_BLOCKS)
    yield from (NullDesign((3,), 1, blocks=blocks) for blocks in (8, 10, 30))
    yield from (NullDesign((4,), 1, blocks=blocks) for blocks in (8, 15))
    yield NullDesign((3, 2), 1, blocks=10)
    for levels in (5, 6):  # of 500,000 experiments they lack 3.13 and 3.05 points
        yield NullDesign((levels,), 1, blocks=8, bounds=(-1.0, 4.0), why="exact p-values of 128 patterns of signs")
    yield NullDesign((6,), 1, blocks=10)
    yield NullDesign((4,), 1, blocks=6, bounds=(-1.0, 4.0), why=_FEW_BLOCKS)
    yield NullDesign((3,), 1, blocks=4, bounds=(-1.0, 9.0), why=_FEW_BLOCKS)
    yield NullDesign(
        (5,), 1, blocks=7, bounds=(-1.0, 15.0), why=_FEW_BLOCKS.replace("Huynh-Feldt", "Greenhouse-Geisser")
    )


def _unequal_spreads() -> Iterator[NullDesign]:
    for runs in (5, 10, 30):
        yield NullDesign((3,), runs, (1, 1, 10), bounds=(0.0, 28.0), why=_WEIGHED)
        yield NullDesign((3,), runs, (1, 1, 4), bounds=(0.0, 22.0), why=_WEIGHED)
        yield NullDesign((3,), runs, (1, 1, 2), bounds=(-1.0, 12.0), why=_WEIGHED)


def _bounded(design: NullDesign) -> NullDesign:
    return design if design.why else replace(design, bounds=(-5.0, _LACKED))


#: Each returns by how many points its power lacks, from a source of random numbers and how many experiments to make.
COMPARED: Sequence[Callable[[np.random.Generator, int], Judged]] = (
    *(partial(_compared, _bounded(design), _linear) for design in _equal_spreads()),
    *(partial(_compared, design, _first_two) for design in _unequal_spreads()),
)
