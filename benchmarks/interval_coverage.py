"""How often the intervals of a report hold the true value."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import stats

from benchmarks.null_designs import DISTRIBUTIONS, NullDesign
from benchmarks.table import Judged
from robot_runner.analysis.statistics.cell_layout import layout_of
from robot_runner.analysis.statistics.cell_means import CellMeans
from robot_runner.analysis.statistics.descriptive import describe, quiet
from robot_runner.analysis.statistics.effect_sizes import (
    cliffs_delta,
    cohens_d,
    f_of_p_value,
    omega_squared,
    paired_rank_biserial,
)
from robot_runner.analysis.statistics.grouped_runs import Group
from robot_runner.analysis.statistics.linear_model import fit_model
from robot_runner.analysis.statistics.tested import Interval, NotComputed

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Kind = Callable[[str, int, np.random.Generator, int], NDArray[np.bool_]]

__all__ = ["COVERED"]

_COVERED = (93.5, 97.0)
#: The same of intervals of 90 %, which belong to tests of one side: of equivalence, and of shares of variance.
_COVERED_90 = (88.0, 93.0)
#: Intervals that are computed one by one are computed of fewer experiments; those by a bootstrap of fewer still.
_ONE_BY_ONE, _DRAWN = 5, 20
_D = 0.8


def _values(name: str, random: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    return DISTRIBUTIONS[name](random, shape)


def _estimated(design: NullDesign, values: Floats) -> CellMeans:
    layout = layout_of(design.data(values[0]))
    if layout is None:
        raise ValueError(f"{design.name} takes a model")
    return CellMeans.of_values(layout, values)


def _covers(
    model: CellMeans, weights: Sequence[tuple[dict[str, str], float]], true: float, level: float
) -> NDArray[np.bool_]:
    found = model.difference(weights)
    return np.asarray(np.abs(found.estimate - true) <= stats.t.ppf((1 + level) / 2, found.freedom) * found.error)


_PAIR = [({"F0": "t0"}, 1.0), ({"F0": "t1"}, -1.0)]


def _mean(name: str, size: int, random: np.random.Generator, count: int) -> NDArray[np.bool_]:
    values = _values(name, random, (count, size))
    covered = np.abs(values.mean(axis=1)) <= stats.t.ppf(0.975, size - 1) * stats.sem(values, axis=1)
    for group, is_covered in zip(values[:20], covered, strict=False):  # the product's interval is that one
        _agree(describe(Group({}, group, tuple(map(str, group)))).mean_interval, 0.0, bool(is_covered))
    return np.asarray(covered)


def _difference(name: str, size: int, random: np.random.Generator, count: int, spread: float = 1) -> NDArray[np.bool_]:
    design = NullDesign((2,), size, (spread, 1), name)
    return _covers(_estimated(design, design.draw(random, count)), _PAIR, 0.0, 0.95)


def _equivalence(name: str, size: int, random: np.random.Generator, count: int) -> NDArray[np.bool_]:
    design = NullDesign((2,), size, (2, 1), name)
    return _covers(_estimated(design, design.draw(random, count)), _PAIR, 0.0, 0.9)


def _contrast(name: str, size: int, random: np.random.Generator, count: int) -> NDArray[np.bool_]:
    design = NullDesign((3,), size, (1, 2, 3), name)
    weights = [({"F0": f"t{place}"}, weight) for place, weight in enumerate((1.0, -0.5, -0.5))]
    return _covers(_estimated(design, design.draw(random, count)), weights, 0.0, 0.95)


def _marginal(name: str, size: int, random: np.random.Generator, count: int) -> NDArray[np.bool_]:
    design = NullDesign((2, 3), size, (1, 1, 1, 1, 1, 4), name)
    return _covers(_estimated(design, design.draw(random, count)), _PAIR, 0.0, 0.95)


def _within_blocks(name: str, size: int, random: np.random.Generator, count: int) -> NDArray[np.bool_]:
    design = NullDesign((3,), 1, (1, 1, 3), name, blocks=size)
    return _covers(_estimated(design, design.draw(random, count)), _PAIR, 0.0, 0.95)


def _of_d(
    name: str, size: int, random: np.random.Generator, count: int, *, blocks: bool = False, spread: float = 1
) -> NDArray[np.bool_]:
    """Return whether the interval of d holds the true one: inverting its distribution is asking for its two tails."""
    spreads = (spread, 1)
    design = NullDesign((2,), 1, spreads, name, blocks=size) if blocks else NullDesign((2,), size, spreads, name)
    shift = _D * math.sqrt((spread**2 + 1) / 2)
    values = design.draw(random, count) + shift * np.array([cell[0] == 0 for _, cell, _ in design.rows()])
    model = _estimated(design, values)
    found = model.difference(_PAIR)
    below = stats.nct.cdf(found.t_value, found.freedom, _D * model.spread / found.error)
    covered = np.asarray((below >= 0.025) & (below <= 0.975))
    for place in range(20):  # the product's interval is that one
        estimate, error, freedom, own = (float(each[place]) for each in (*found, model.spread))
        told = cohens_d(estimate, error, freedom, own)
        _agree(told.interval if told else None, _D, bool(covered[place]))
    return covered


def _of_d_apart(
    name: str, size: int, random: np.random.Generator, count: int, *, design: NullDesign, d: float
) -> NDArray[np.bool_]:
    """Return whether the interval of d holds the true one where runs tell more of the spread than of the difference."""
    own = replace(design, blocks=size) if design.blocks else replace(design, runs=size)
    own = replace(own, distribution=name)
    values = own.draw(random, count // _ONE_BY_ONE) + d * np.array([cell[0] == 0 for _, cell, _ in own.rows()])
    layout, covered = _estimated(own, values).layout, []
    for each in values:
        model = CellMeans.of_values(layout, each)
        estimate, error, freedom = map(float, model.difference(_PAIR))
        told = cohens_d(estimate, error, freedom, float(model.spread), model.spread_parts)
        covered.append(told is not None and told.interval is not None and _holds(told.interval, d))
    return np.array(covered)


def _of_omega(
    name: str, size: int, random: np.random.Generator, count: int, spread: float = 1, blocks: bool = False
) -> NDArray[np.bool_]:
    """Return whether the interval of omega squared holds the true one, of a medium to large effect."""
    design = NullDesign((3,), 1 if blocks else size, (1, 1, spread), name, blocks=size if blocks else 0)
    variance = (2 + spread**2) / 3
    effects = np.array([-1.0, 0.0, 1.0]) * math.sqrt(1.5 * variance * 0.25)
    values = design.draw(random, count // _ONE_BY_ONE) + effects[[cell[0] for _, cell, _ in design.rows()]]
    true, covered = 0.25 / 1.25, []  # a quarter of the spread's square is a fifth of the sum of both
    layout = _estimated(design, values).layout
    for each in values:
        model = CellMeans.of_values(layout, each)
        (effect,) = model.effects()
        freedom = (float(effect.freedom[0]), float(effect.freedom[1]))
        of_runs = (float(effect.variance), float(model.spread), model.spread_parts)
        f_value = f_of_p_value(float(effect.p_value), freedom)
        told = omega_squared(f_value, freedom, *of_runs, alpha=0.05, is_partial=False)
        covered.append(told is not None and told.interval is not None and _holds(told.interval, true))
    return np.array(covered)


def _holds(interval: Interval, true: float) -> bool:
    return interval.low <= true <= interval.high


def _agree(interval: Interval | None, true: float, covered: bool) -> None:
    if interval is None or _holds(interval, true) is not covered:
        raise ValueError(f"the interval is {interval}, and {true} is {'' if covered else 'not '}covered")


def _delta(name: str, size: int, random: np.random.Generator, count: int, shift: float = 0.0) -> NDArray[np.bool_]:
    first, second = _values(name, random, (2, count // _ONE_BY_ONE, size))
    true = 2 * float(stats.norm.cdf(shift / math.sqrt(2))) - 1
    found = [cliffs_delta([pair]) for pair in zip(first + shift, second, strict=True)]
    return np.array([each.interval.low <= true <= each.interval.high for each in found if each and each.interval])


def _rank_biserial(name: str, size: int, random: np.random.Generator, count: int) -> NDArray[np.bool_]:
    first, second = _values(name, random, (2, count // _DRAWN, size))
    found = [paired_rank_biserial(values) for values in first - second]
    return np.array([each.interval.low <= 0 <= each.interval.high for each in found if each and each.interval])


def _pearson(name: str, size: int, random: np.random.Generator, count: int) -> NDArray[np.bool_]:
    first, other = _values(name, random, (2, count // _ONE_BY_ONE, size))
    found = stats.pearsonr(first, 0.5 * first + math.sqrt(0.75) * other, axis=1).confidence_interval(0.95)
    return np.asarray((found.low <= 0.5) & (found.high >= 0.5))


def _mixed(name: str, size: int, random: np.random.Generator, count: int) -> NDArray[np.bool_]:
    """Return whether differences of incomplete blocks are covered; of treatments thrice as many blocks as `size`."""
    design = NullDesign((3,), 1, distribution=name, blocks=3 * size, lacking=1)
    covered = []
    for values in design.draw(random, count // _DRAWN):
        model = fit_model(design.data(values))
        if isinstance(model, NotComputed):
            continue
        found = model.difference(_PAIR)
        covered.append(abs(float(found.estimate)) <= stats.t.ppf(0.975, float(found.freedom)) * float(found.error))
    return np.array(covered)


class _Covered(NamedTuple):
    """An interval, and what its coverage is expected to be.

    Attributes:
        others: the bounds by distribution and number of runs, where theory does not let it hold; and why.
    """

    name: str
    kind: Kind
    bounds: tuple[float, float] = _COVERED
    names: Sequence[str] = ("normal", "uniform", "lognormal")
    sizes: Sequence[int] = (5, 10, 30)
    others: Mapping[tuple[str, int], tuple[float, float]] | None = None
    why: str = ""


def _judged(of: _Covered, name: str, size: int, random: np.random.Generator, count: int) -> Judged:
    with quiet():
        covered = of.kind(name, size, random, count)
    share = 100 * float(np.mean(covered))
    error = 100 * math.sqrt(0.05 * 0.95 / len(covered))
    other = (of.others or {}).get((name, size))
    bounds, why = (of.bounds, "") if other is None else (other, of.why)
    return Judged(f"{of.name}, {name}, n {size}", share, share, bounds, why, slack=2 * error)


_SKEWED = "no interval of so few skewed values"
_SKEWS_CANCEL = "skews alike cancel out"
_NOT_NORMAL = "a distribution of normal values is inverted"
_UNEQUAL = "a distribution of equal spreads is inverted"
_ROUGH = "careful: ranks of so few take few values"


def _skewed(*bounds: tuple[float, float], name: str = "lognormal") -> dict[tuple[str, int], tuple[float, float]]:
    """Return the bounds for 5, 10 and 30 runs, or for the first of these."""
    return {(name, size): each for size, each in zip((5, 10, 30), bounds, strict=False)}


_INTERVALS = (
    _Covered(
        "mean",
        _mean,
        others=_skewed((80, 85), (82, 87), (86, 92)) | _skewed((92.5, 97), name="uniform"),
        why=_SKEWED.replace("skewed", "such"),
    ),
    _Covered("difference of means", _difference, others=_skewed((97, 99), (96, 98.5)), why=_SKEWS_CANCEL),
    _Covered(
        "difference of means, sd 3:1",
        partial(_difference, spread=3),
        others=_skewed((85, 89), (86, 90), (89, 93)) | _skewed((92.5, 97), name="uniform"),
        why=_SKEWED,
    ),
    _Covered("difference within blocks", _within_blocks, others=_skewed((96, 98.5), (95.5, 98)), why=_SKEWS_CANCEL),
    _Covered(
        "difference of marginal means, sd 1 and 4",
        _marginal,
        others=_skewed((88, 92), (90, 94), (92, 95)) | _skewed((92, 97), name="uniform"),
        why=_SKEWED.replace("skewed", "such"),
    ),
    _Covered("contrast of three means, sd 1:2:3", _contrast),
    _Covered(
        "equivalence (90 %), sd 2:1",
        _equivalence,
        _COVERED_90,
        others=_skewed((84, 88), (84.5, 88.5), (86, 91)),
        why=_SKEWED,
    ),
    _Covered("difference, incomplete blocks (thrice n)", _mixed, names=("normal",), sizes=(5, 10)),
    _Covered("Cohen's d of 0.8", _of_d, others=_skewed((86, 91), (81, 87), (76, 83)), why=_NOT_NORMAL),
    _Covered(
        "Cohen's d of 0.8, sd 3:1", partial(_of_d, spread=3), others=_skewed((96, 99), (96, 98.5)), why=_NOT_NORMAL
    ),
    _Covered(
        "Cohen's d of 0.8, in blocks",
        partial(_of_d, blocks=True),
        others=_skewed((88, 93), (82, 88), (78, 84)),
        why=_NOT_NORMAL,
    ),
    *(
        _Covered(
            f"Cohen's d of {d:g}, {words}",
            partial(_of_d_apart, design=design, d=d),
            (93.5, 99.0),
            names=("normal",),
        )
        for design, words in (
            (NullDesign((2,), 4, blocks=5), "in blocks (n) of four runs"),
            (NullDesign((4,), 5), "of four treatments"),
        )
        for d in (_D, 3.0)
    ),
    _Covered(
        "omega squared of 0.2 (90 %)",
        _of_omega,
        _COVERED_90,
        others=_skewed((72, 79), (66, 73), (60, 67)),
        why=_NOT_NORMAL,
    ),
    _Covered(
        "omega squared of 0.2 (90 %), sd 1:1:3",
        partial(_of_omega, spread=3),
        _COVERED_90,
        others=_skewed((82, 87), (80, 85), (80, 85), name="normal")
        | _skewed((84, 89), (82, 87), (81, 86), name="uniform")
        | _skewed((83, 88), (79, 84), (72, 77)),
        why=_UNEQUAL,
    ),
    _Covered(
        "omega squared of 0.2 (90 %), in blocks",
        partial(_of_omega, blocks=True),
        _COVERED_90,
        others=_skewed((79, 84), (74, 80), (66, 73)),
        why=_NOT_NORMAL,
    ),
    _Covered(
        "Cliff's delta of 0, A12 of 0.5",
        _delta,
        others={(name, 5): (97, 100) for name in ("normal", "uniform", "lognormal")}
        | {(name, 10): (96, 99.5) for name in ("normal", "uniform", "lognormal")},
        why=_ROUGH,
    ),
    _Covered(
        "Cliff's delta of 0.52, A12 of 0.76",
        partial(_delta, shift=1.0),
        names=("normal",),
        others=_skewed((97, 100), (96, 99.5), name="normal"),
        why=_ROUGH,
    ),
    _Covered(
        "rank-biserial correlation of 0",
        _rank_biserial,
        others={(name, size): (95, 100) for name in ("normal", "uniform", "lognormal") for size in (5, 10)},
        why=_ROUGH,
    ),
    _Covered("Pearson's r of 0.5", _pearson, others=_skewed((84, 90), (80, 85), (72, 78)), why=_NOT_NORMAL),
)

#: Each returns how often an interval holds the true value, from a source of random numbers and how many to make.
COVERED: Sequence[Callable[[np.random.Generator, int], Judged]] = tuple(
    partial(_judged, each, name, size) for each in _INTERVALS for name in each.names for size in each.sizes
)
