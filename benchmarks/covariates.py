"""What adjusting for covariates does: false positives of the product's own procedure, and the power that is gained.

`python -m benchmarks.covariates --experiments 10000` takes longer and is surer of the last digit.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.null_designs import NullDesign
from benchmarks.table import Row, print_table
from robot_runner.analysis.statistics.analysed_design import VALUE, covariate_column
from robot_runner.analysis.statistics.descriptive import quiet
from robot_runner.analysis.statistics.tested import NotComputed
from robot_runner.analysis.statistics.tests import planned_model_of
from robot_runner.core.design.analysis_plan import Estimand

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

_SEED = 2022
_ALPHA = 0.05
_EXPERIMENTS = 1000
#: The bounds that are to hold, in percent.
_LEAST, _MOST = 3.5, 6.5
_FEW_BLOCKS = "below: the errors of fewer than eight blocks are careful"
_CROWDED = "below: many treatments of few runs"
_BETWEEN = "below: slopes are those of few blocks where a factor differs between them"


@dataclass(frozen=True, slots=True)
class _Adjusted:
    """A design with covariates.

    Attributes:
        design: without effects.
        slope: how much the measure changes with a standard deviation of each covariate.
        covariates: how many there are.
        is_skewed: whether they are lognormal, else normal.
        expectation: in words, where the level is not expected to hold.
    """

    design: NullDesign
    slope: float = 2.0
    covariates: int = 1
    is_skewed: bool = False
    expectation: str = ""

    @property
    def name(self) -> str:
        parts = [self.design.name, f"slope {self.slope:g}"]
        parts += [f"{self.covariates} covariates"] if self.covariates > 1 else []
        return ", ".join([*parts, *(["skewed covariate"] if self.is_skewed else [])])


_DESIGNS = (
    *(_Adjusted(NullDesign((2,), runs)) for runs in (5, 10, 30)),
    _Adjusted(NullDesign((2,), (5, 15), (3, 1))),
    _Adjusted(NullDesign((2,), (5, 15), (1, 3))),
    _Adjusted(NullDesign((2,), 10, (1, 10))),
    _Adjusted(NullDesign((2,), 10, (1, 3)), covariates=3),
    _Adjusted(NullDesign((2,), (5, 15), (3, 1)), is_skewed=True),
    _Adjusted(NullDesign((3,), 5, (1, 1, 4))),
    _Adjusted(NullDesign((3,), (5, 10, 15), (3, 2, 1))),
    _Adjusted(NullDesign((5,), 5), expectation=_CROWDED),
    _Adjusted(NullDesign((2, 2), 5, (1, 1, 1, 4))),
    _Adjusted(NullDesign((3, 2), (5, 8, 12, 5, 9, 6), (3, 2, 1, 4, 1, 2))),
    _Adjusted(NullDesign((2,), 1, blocks=5), expectation=_FEW_BLOCKS),
    _Adjusted(NullDesign((2,), 1, blocks=10)),
    _Adjusted(NullDesign((3,), 1, blocks=10, response=2.0)),
    _Adjusted(NullDesign((3,), 1, (1, 1, 4), blocks=10)),
    _Adjusted(NullDesign((2, 2), 1, blocks=10)),
    _Adjusted(NullDesign((2, 2), 1, blocks=8, between=1), expectation=_BETWEEN),
)


def main(arguments: list[str] | None = None) -> None:
    """Print false positives and power, each with what is expected of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--experiments", type=int, default=_EXPERIMENTS, help="simulated experiments a design")
    count = parser.parse_args(arguments if arguments is not None else []).experiments
    random = np.random.default_rng(_SEED)
    print_table(
        f"False positives at 5 % ({count:,} experiments a design)", [_row(each, random, count) for each in _DESIGNS]
    )
    print_table("Power of ten runs a treatment, with the covariate and without", list(_power(random, count)))


def _p_values(adjusted: _Adjusted, random: np.random.Generator, count: int, effect: float = 0.0) -> Floats:
    """Return the p-value of each effect in each experiment, (experiments, effects)."""
    design = adjusted.design
    every = design.draw(random, count)
    data = design.data(every[0])
    shift = effect * np.array([cell[0] for _, cell, _ in design.rows()])
    names = tuple(f"C{place}" for place in range(adjusted.covariates))
    found = []
    for values in every:
        drawn = random.normal(size=(len(names), len(values)))
        drawn = np.exp(drawn) if adjusted.is_skewed else drawn
        told = {covariate_column(name): each for name, each in zip(names, drawn, strict=True)}
        frame = data.frame.assign(**told, **{VALUE: values + shift + adjusted.slope * drawn.sum(axis=0)})
        model = planned_model_of(replace(data, frame=frame, every=frame, covariates=names), Estimand.MEAN)
        if isinstance(model, NotComputed):
            raise TypeError(f"{adjusted.name}: {model.why}")
        with quiet():
            found.append([float(each.p_value) for each in model.effects()])
    return np.array(found)


def _row(adjusted: _Adjusted, random: np.random.Generator, count: int) -> Row:
    rates = 100 * np.mean(_p_values(adjusted, random, count) <= _ALPHA, axis=0)
    slack = 2 * 100 * math.sqrt(_ALPHA * (1 - _ALPHA) / count)
    holds = rates.min() >= _LEAST - slack and rates.max() <= _MOST + slack
    shown = f"{rates.min():.1f}" if len(rates) == 1 else f"{rates.min():.1f} to {rates.max():.1f}"
    verdict = "" if adjusted.expectation else "holds" if holds else "DOES NOT HOLD"
    return Row(adjusted.name, f"{shown} %", "", verdict, adjusted.expectation or f"{_LEAST} to {_MOST} %")


def _power(random: np.random.Generator, count: int) -> Iterator[Row]:
    """Yield how often an effect of one standard deviation is found, by what covariates have to do with the values."""
    for slope in (0.0, 1.0, 2.0):
        adjusted = _Adjusted(NullDesign((2,), 10), slope)
        found = 100 * np.mean(_p_values(adjusted, random, count, effect=1.0) <= _ALPHA)
        values = adjusted.design.draw(random, count) + slope * random.normal(size=(count, 20))
        plain = np.array([_plain(adjusted.design, each) for each in values + (np.arange(20) >= 10)])
        without = 100 * np.mean(plain <= _ALPHA)
        yield Row(
            f"slope {slope:g}", f"{found:.1f} %", f"{without:.1f} % without", "", f"{found - without:+.1f} points"
        )


def _plain(design: NullDesign, values: Floats) -> float:
    model = planned_model_of(design.data(values), Estimand.MEAN)
    if isinstance(model, NotComputed):
        raise TypeError(model.why)
    return float(next(model.effects()).p_value)


if __name__ == "__main__":
    import sys

    main(sys.argv[1:])
