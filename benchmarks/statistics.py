"""How often the statistics err: false positives, coverage of intervals and power of the product's own procedure.

`python -m benchmarks.statistics --experiments 20000` takes longer and is surer of the last digit.
"""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from benchmarks.null_designs import DISTRIBUTIONS, NULL_DESIGNS, NullDesign
from benchmarks.precise_stopping import precise_stopping
from benchmarks.table import Row, print_table
from robot_runner.analysis.statistics.cell_layout import layout_of
from robot_runner.analysis.statistics.cell_means import CellMeans
from robot_runner.analysis.statistics.descriptive import describe, quiet
from robot_runner.analysis.statistics.design import Group
from robot_runner.analysis.statistics.effect_sizes import cliffs_delta, cohens_d
from robot_runner.analysis.statistics.post_hoc import adjusted
from robot_runner.analysis.statistics.tested import EffectTest, NotComputed
from robot_runner.analysis.statistics.tests import model_of
from robot_runner.core.design.analysis_plan import Correction, Estimand, Statistic

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

_SEED = 2021
_ALPHA = 0.05
_EXPERIMENTS = 10_000
#: Models are fitted one by one, intervals inverted one by one.
_SHARE_OF_MODELS, _SHARE_OF_INTERVALS, _INVERTED = 10, 5, 20
#: Draws of the bootstrap, as so many experiments are made of each design.
_DRAWS = 199
#: The bounds that are to hold, in percent.
_LEAST, _MOST, _FAMILY = 3.5, 6.5, 6.5
_COVERED = (93.5, 97.0)
_POWER = 3.0


def main(arguments: list[str] | None = None) -> None:
    """Print false positives, coverage and power, each with what is expected of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--experiments", type=int, default=_EXPERIMENTS, help="simulated experiments a design")
    count = parser.parse_args(arguments if arguments is not None else []).experiments
    random = np.random.default_rng(_SEED)
    rows = [_false_positives(design, random, count) for design in NULL_DESIGNS]
    held = sum(row.ratio == "holds" for row in rows)
    bounded = sum(not design.expectation for design in NULL_DESIGNS)
    title = f"False positives at 5 % ({count:,} experiments a design): {held} of {bounded} designs within the bounds"
    print_table(title, rows)
    print_table("Coverage of 95 % intervals", list(_coverage(random, count // _SHARE_OF_INTERVALS)))
    print_table(
        "Power under normality with equal spreads, beside the test that knows of it", list(_power(random, count))
    )
    print_table("Repeated until precise, 30 times at most: the worst of six widths", precise_stopping(random, count))


def _estimated(design: NullDesign, values: Floats, statistic: Statistic = Statistic.WELCH_JAMES) -> CellMeans:
    """Return what the product estimates, of many experiments at once."""
    layout = layout_of(design.data(values[0]))
    if layout is None:
        raise ValueError(f"{design.name} takes a model, one experiment at a time")
    return CellMeans.of_values(layout, values, statistic=statistic, draws=_DRAWS)


# False positives.


def _p_values(design: NullDesign, values: Floats) -> dict[tuple[str, ...], Floats]:
    """Return the p-values of each effect, one an experiment, as the product computes them."""
    if layout_of(design.data(values[0])) is not None:
        with quiet():
            return {each.factors: np.asarray(each.p_value) for each in _estimated(design, values).effects()}
    found: dict[tuple[str, ...], list[float]] = {}
    for experiment in values[: len(values) // _SHARE_OF_MODELS]:
        for each in _modelled(design, experiment):
            found.setdefault(each.factors, []).append(float(each.p_value))
    return {factors: np.array(several) for factors, several in found.items()}


def _modelled(design: NullDesign, values: Floats) -> Iterator[EffectTest]:
    model = model_of(design.data(values), Estimand.MEAN)
    if not isinstance(model, NotComputed):
        yield from model.effects()


def _false_positives(design: NullDesign, random: np.random.Generator, count: int) -> Row:
    found = _p_values(design, design.draw(random, count))
    shifted = (f"F{len(design.levels) - 1}",) if design.shift else ()
    p_values = np.stack([each for factors, each in found.items() if factors != shifted])
    rates = 100 * np.mean(p_values <= _ALPHA, axis=1)
    family = 100 * np.mean([min(adjusted(each, Correction.HOLM)) <= _ALPHA for each in p_values.T])
    shown = f"{rates.min():.1f}" if len(rates) == 1 else f"{rates.min():.1f} to {rates.max():.1f}"
    # Of fewer experiments the last digit is not sure: two standard errors are granted.
    error = 2 * 100 * math.sqrt(_ALPHA * (1 - _ALPHA) / p_values.shape[1])
    slack = error if p_values.shape[1] < _EXPERIMENTS else 0.0
    holds = rates.min() >= _LEAST - slack and rates.max() <= _MOST + slack and family <= _FAMILY + slack
    verdict = "" if design.expectation else "holds" if holds else "DOES NOT HOLD"
    bound = design.expectation or f"{_LEAST} to {_MOST} %, family {_FAMILY} %"
    return Row(design.name, f"{shown} %", f"family {family:.1f} %" if len(rates) > 1 else "", verdict, bound)


# Coverage.


def _coverage(random: np.random.Generator, count: int) -> Iterator[Row]:
    skewed = {"lognormal": "less: of a skewed mean no interval of so few covers"}
    for name in ("normal", "uniform", "lognormal"):
        for size in (5, 10, 30):
            first, second = DISTRIBUTIONS[name](random, (2, count, size))
            means = [describe(Group({}, values, tuple(map(str, values)))).mean_interval for values in first]
            covered = [each.low <= 0 <= each.high for each in means if each is not None]
            yield _row(f"mean, {name}, n {size}", covered, skewed.get(name, ""))
            differences = _differences(first, second)
            covered = list(np.abs(differences[0]) <= stats.t.ppf(0.975, differences[2]) * differences[1])
            careful = "more: skews alike cancel out" if name in skewed else ""
            yield _row(f"difference of means, {name}, n {size}", covered, careful)
            yield _row(f"Cohen's d of 0.8, {name}, n {size}", _covers_d(first, second), skewed.get(name, ""))
            deltas = [cliffs_delta([pair]) for pair in zip(first, second, strict=True)]
            covered = [each.interval.low <= 0 <= each.interval.high for each in deltas if each and each.interval]
            yield _row(f"Cliff's delta, {name}, n {size}", covered, "")
    for size in (5, 10, 30):
        first, second = (DISTRIBUTIONS["normal"](random, (count, size)) * spread for spread in (3, 1))
        estimate, error, freedom, _ = _differences(first, second)
        covered = list(np.abs(estimate) <= stats.t.ppf(0.975, freedom) * error)
        yield _row(f"difference of means, normal, sd 3:1, n {size}", covered, "")


def _differences(first: Floats, second: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return difference, error, degrees of freedom and spread of each experiment, as the product estimates them."""
    values = np.concatenate([first, second], axis=-1)
    model = _estimated(NullDesign((2,), (first.shape[1], second.shape[1])), values)
    found = model.difference([({"F0": "t0"}, 1.0), ({"F0": "t1"}, -1.0)])
    return found.estimate, found.error, found.freedom, model.spread


def _covers_d(first: Floats, second: Floats) -> NDArray[np.bool_]:
    """Return whether the interval of d holds the true one: inverting its distribution is asking for its two tails."""
    true = 0.8
    estimate, error, freedom, spread = _differences(first + true, second)
    below = stats.nct.cdf(estimate / error, freedom, true * spread / error)
    for place in range(_INVERTED):  # the product's interval is that one
        size = cohens_d(*(float(each[place]) for each in (estimate, error, freedom, spread)))
        if size is None or size.interval is None:
            raise ValueError("an interval of d is missing")
        if (size.interval.low <= true <= size.interval.high) is not bool(0.025 <= below[place] <= 0.975):
            raise ValueError(f"the interval of d is {size.interval}, and {below[place]} of d lie below")
    return np.asarray((below >= 0.025) & (below <= 0.975))


def _row(name: str, covered: Sequence[bool] | NDArray[np.bool_], expectation: str) -> Row:
    share = 100 * float(np.mean(covered))
    error = 100 * math.sqrt(0.05 * 0.95 / len(covered))
    low, high = _COVERED
    verdict = (
        "holds" if low - 2 * error <= share <= high + 2 * error else "does not hold" if expectation else "DOES NOT HOLD"
    )
    return Row(name, f"{share:.1f} %", "", verdict, expectation or f"{low} to {high} %")


# Power.


def _power(random: np.random.Generator, count: int) -> Iterator[Row]:
    for size in (5, 10, 30):
        yield _power_of(NullDesign((2,), size), random, count, "")
        for levels in (3, 5):
            expectation = "" if size >= 30 else "Welch's weights cost 3 to 10 points of few runs"
            yield _power_of(NullDesign((levels,), size), random, count, expectation)
            few = "" if size >= 10 else "4 to 7 points"
            yield _power_of(NullDesign((levels,), size), random, count, few, Statistic.ANOVA_TYPE)
        yield _power_of(NullDesign((2, 2), size), random, count, "")
        yield _power_of(NullDesign((3, 2), size), random, count, "" if size >= 10 else "3 to 6 points")
    for blocks in (5, 10, 30):
        yield _power_of(NullDesign((2,), 1, blocks=blocks), random, count, "")
    yield _power_of(NullDesign((3,), 1, blocks=10), random, count, "")
    yield _power_of(NullDesign((4,), 1, blocks=15), random, count, "")
    yield _power_of(NullDesign((4,), 1, blocks=6), random, count, "11 points: Greenhouse-Geisser is careful")


def _power_of(
    design: NullDesign,
    random: np.random.Generator,
    count: int,
    expectation: str,
    statistic: Statistic = Statistic.WELCH_JAMES,
) -> Row:
    """Compare the power for the first factor with that of the analysis of variance, which takes spreads to be equal."""
    rows = design.rows()
    levels, units = design.levels[0], len(rows) / np.prod(design.levels)
    others = np.prod(design.levels[1:])
    # An effect that the analysis of variance finds in about four of five experiments.
    each = np.linspace(-0.5, 0.5, levels)
    size = math.sqrt((8 + 1.4 * (levels - 2)) / np.sum(each**2) / (units * others)) * (1 + 1 / units)
    effect = size * each[[cell[0] for _, cell, _ in rows]]
    values = design.draw(random, count) + effect
    test = next(_estimated(design, values, statistic).effects())
    ours, best = 100 * np.mean(test.p_value <= _ALPHA), 100 * np.mean(_classical(design, values) <= _ALPHA)
    verdict = "holds" if best - ours <= _POWER else "" if expectation else "DOES NOT HOLD"
    bound = expectation or f"{_POWER:.0f} points less"
    return Row(f"{design.name}: {test.test}", f"{ours:.1f} %", f"{best:.1f} %", f"{ours - best:+.1f} {verdict}", bound)


def _classical(design: NullDesign, values: Floats) -> Floats:
    """Return p-values of the first factor by the analysis of variance with one variance."""
    rows = design.rows()
    cells, blocks = np.array([place for _, _, place in rows]), np.array([block for block, _, _ in rows])
    factor = np.array([cell[0] for _, cell, _ in rows])
    model = np.stack([cells == place for place in range(len(design.cells))], axis=1).astype(float)
    if design.blocks:
        model = np.column_stack([model, *[blocks == block for block in range(1, design.blocks)]])
    residuals = values - values @ (model @ np.linalg.pinv(model))
    freedom = (design.levels[0] - 1, len(rows) - np.linalg.matrix_rank(model))
    means = np.stack([values[:, factor == level].mean(axis=1) for level in range(design.levels[0])], axis=1)
    between = len(rows) / design.levels[0] * np.sum((means - means.mean(axis=1, keepdims=True)) ** 2, axis=1)
    f_value = between / freedom[0] / (np.sum(residuals**2, axis=1) / freedom[1])
    return np.asarray(stats.f.sf(f_value, *freedom))


if __name__ == "__main__":
    import sys

    main(sys.argv[1:])
