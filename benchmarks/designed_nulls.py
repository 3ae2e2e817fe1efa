"""Designs of their own without effects: how often something is found, and how often by what is often done instead.

The tests are those of the report: the same functions are called with the values of many experiments.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy import stats

from benchmarks.table import Judged
from robot_runner.analysis.planning.planned_study import PlannedResults
from robot_runner.analysis.statistics.analysed_design import design_of
from robot_runner.analysis.statistics.cell_layout import incomplete_layout
from robot_runner.analysis.statistics.cell_means import CellMeans
from robot_runner.analysis.statistics.descriptive import quiet
from robot_runner.analysis.statistics.designed_models import designed_model_of
from robot_runner.analysis.statistics.known_design import PLAIN
from robot_runner.analysis.statistics.lenth_test import LenthModel, fit_lenth
from robot_runner.analysis.statistics.nested_factors import codes_of
from robot_runner.analysis.statistics.post_hoc import adjusted
from robot_runner.analysis.statistics.tested import NotComputed
from robot_runner.core.design.analysis_plan import Correction, Estimand, Statistic
from robot_runner.core.design.columns import RUN_ID, STATUS
from robot_runner.core.storage.table_columns import ColumnDescription, ColumnRole

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from robot_runner.analysis.statistics.analysed_design import MeasureData

    Floats = NDArray[np.float64]

__all__ = ["DESIGNED_NULLS", "DesignedNull", "data_of"]

_ALPHA = 0.05
#: Draws of the bootstrap, as so many experiments are made of each design.
_DRAWS = 199
#: Any of a family is to be found in no more, in percent.
_FAMILY = 6.5


@dataclass(frozen=True, slots=True)
class DesignedNull:
    """A design without effects.

    Attributes:
        name: in words.
        facts: as the design writes them into the manifest.
        names: the columns of `rows`.
        rows: the treatments of each run, as texts.
        varying: the standard deviation of what each treatment of these columns adds to its runs; several, as in
            `A x B`, add it together.
        spreads: how many times as much runs of a treatment of the first column vary as others.
        bounds: between which every single effect is to be found, in percent at alpha = 5 %.
        why: they are others than those of all designs; empty otherwise.
    """

    name: str
    facts: Mapping[str, Any]
    names: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    varying: Mapping[str, float] = field(default_factory=dict)
    spreads: Mapping[str, float] = field(default_factory=dict)
    bounds: tuple[float, float] = (3.5, 6.5)
    why: str = ""

    def draw(self, random: np.random.Generator, experiments: int) -> Floats:
        """Return the values of all runs, (experiments, runs)."""
        scale = np.array([self.spreads.get(row[0], 1.0) for row in self.rows])
        values: Floats = scale * random.normal(size=(experiments, len(self.rows)))
        for names, spread in self.varying.items():
            columns = [self.names.index(name) for name in names.split(" x ")]
            texts = [" / ".join(row[column] for column in columns) for row in self.rows]
            _, code = np.unique(texts, return_inverse=True)
            values += spread * random.normal(size=(experiments, int(code.max()) + 1))[:, code]
        return values


def data_of(design: DesignedNull, values: Floats) -> MeasureData:
    """Return an experiment with these values."""
    count = len(design.rows)
    frame: dict[str, Any] = {
        RUN_ID: pd.array([f"r_{place}" for place in range(1, count + 1)], dtype="str"),
        STATUS: pd.Categorical(["Done"] * count, ["Done"]),
    }
    for name, texts in zip(design.names, zip(*design.rows, strict=True), strict=True):
        frame[name] = pd.Categorical(texts, list(dict.fromkeys(sorted(texts))), ordered=True)
    roles = {RUN_ID: ColumnRole.PROGRESS, STATUS: ColumnRole.PROGRESS} | dict.fromkeys(design.names, ColumnRole.FACTOR)
    columns = {name: ColumnDescription(name=name, role=role, unit="") for name, role in roles.items()}
    columns["y"] = ColumnDescription(name="y", role=ColumnRole.MEASURE, unit="")
    manifest = {"experiment_name": design.name, "design": {"facts": dict(design.facts)}}
    results = PlannedResults(Path(), manifest, columns, table=pd.DataFrame({**frame, "y": values}))
    found = design_of(results).data("y")
    if found is None:
        raise TypeError(f"{design.name}: its values are not numbers")
    return found


def _judged(design: DesignedNull, random: np.random.Generator, count: int) -> Judged:
    values = design.draw(random, count)
    data = data_of(design, values[0])
    p_values = _p_values(data, values)
    rates = 100 * np.mean(p_values <= _ALPHA, axis=1)
    family = 100 * float(np.mean(len(p_values) * p_values.min(axis=0) <= _ALPHA))  # Holm's adjustment of the smallest
    holm = min(adjusted(p_values[:, 0].tolist(), Correction.HOLM))
    if not np.isclose(min(1.0, len(p_values) * p_values[:, 0].min()), holm):
        raise ValueError(f"{design.name}: Holm's adjustment is another")
    beside = f"family {family:.1f} %" if len(rates) > 1 else ""
    wrongly = _wrongly(data, values)
    if wrongly is not None:
        naive = 100 * np.mean(wrongly[1] <= _ALPHA, axis=1)
        beside = "; ".join(filter(None, [beside, f"{wrongly[0]}: {naive.min():.1f} to {naive.max():.1f} %"]))
    slack = 2 * 100 * math.sqrt(_ALPHA * (1 - _ALPHA) / count)
    highest = max(float(rates.max()), family if not design.why else 0.0)
    return Judged(design.name, float(rates.min()), highest, design.bounds, design.why, beside, slack)


def _p_values(data: MeasureData, values: Floats) -> Floats:
    """Return the p-values of the effects of many experiments, (effects, experiments)."""
    with quiet():
        model = designed_model_of(data, Estimand.MEAN, Statistic.COMBINED, values)
        if model is None and (layout := incomplete_layout(data)) is not None:
            model = CellMeans.of_values(layout, values, draws=_DRAWS)
        if model is None or isinstance(model, NotComputed):
            raise TypeError(f"no model: {model}")
        return np.stack([np.asarray(each.p_value) for each in model.effects()])


def _wrongly(data: MeasureData, values: Floats) -> tuple[str, Floats] | None:
    """Return what is often done instead, in words, and the p-values that it has; None where nothing comes to mind."""
    if data.known.columns:
        plain = replace(data, known=replace(PLAIN, kind="independent", terms=data.known.terms))
        return "runs taken as independent", _p_values(plain, values)
    if data.known.is_plain:
        return "one variance for all", _of_one_variance(data, values)
    if data.known.is_surface or len(values[0]) > len(data.frame[list(data.factors)].drop_duplicates()):
        return None
    factors = data.treatments
    model = fit_lenth(factors, codes_of(data.frame, factors), data.known.terms, values)
    if not isinstance(model, LenthModel):
        raise TypeError("the fraction is not orthogonal")
    effects = values @ model.columns
    half = effects.shape[1] // 2
    error = np.sqrt(np.mean(np.sort(effects**2, axis=1)[:, :half], axis=1))[:, None]
    p_values = 2 * stats.t.sf(np.abs(effects[:, : len(model.terms)]) / error, half)
    return "the smaller half of effects taken for error", np.asarray(p_values.T)


def _of_one_variance(data: MeasureData, values: Floats) -> Floats:
    """Return the p-values of main effects of two treatments each, by least squares."""
    coded = [np.where(data.frame[name] == data.levels(name)[0], 1, -1) for name in data.factors]
    exog = np.column_stack([np.ones(len(data.frame)), *coded])
    inverse = np.linalg.pinv(exog)
    estimates = values @ inverse.T
    freedom = exog.shape[0] - exog.shape[1]
    variance = np.sum((values - estimates @ exog.T) ** 2, axis=1) / freedom
    errors = np.sqrt(variance[:, None] * np.diag(inverse @ inverse.T))
    return np.asarray(2 * stats.t.sf(np.abs(estimates / errors), freedom))[:, 1:].T


def _with_gaps(gaps: Sequence[Sequence[str]], runs: Callable[[tuple[str, ...]], int]) -> Iterator[tuple[str, ...]]:
    """Yield the runs of a factorial of factors with two treatments, without the combinations that begin as told."""
    for cell in product("ab", repeat=4):
        if not any(cell[: len(gap)] == tuple(gap) for gap in gaps):
            yield from [cell] * runs(cell)


def _split_plot(plots: int, hard: int, easy: int, *, replicates: bool) -> Iterator[tuple[str, ...]]:
    for plot in range(plots):
        for number, treatment in product(range(hard), range(easy)):
            replicate = f"replicate {plot}" if replicates else "all"
            yield replicate, f"plot {plot * hard + number}", f"hard {number}", f"easy {treatment}"


def _square(size: int, squares: int = 1) -> Iterator[tuple[str, ...]]:
    for square, row, column in product(range(squares), range(size), range(size)):
        yield f"row {square}.{row}", f"column {square}.{column}", f"t{(row + column) % size}"


#: Williams, Experimental designs balanced for the estimation of residual effects of treatments (Australian Journal of
#: Scientific Research A 2, 1949): of three and four treatments.
_WILLIAMS = {
    2: ((0, 1), (1, 0)),
    3: ((0, 1, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0), (0, 2, 1), (1, 0, 2)),
    4: ((0, 1, 3, 2), (1, 2, 0, 3), (2, 3, 1, 0), (3, 0, 2, 1)),
}


def _crossover(treatments: int, subjects: int) -> Iterator[tuple[str, ...]]:
    sequences = _WILLIAMS[treatments]
    for subject in range(subjects):
        for period, treatment in enumerate(sequences[subject % len(sequences)]):
            yield f"subject {subject:02}", f"{period + 1}", f"t{treatment}"


def _of_two(runs: Iterator[tuple[str, ...]]) -> Iterator[tuple[str, ...]]:
    """Yield the same runs, whose four treatments are the combinations of two factors."""
    for *others, treatment in runs:
        yield *others, f"a{int(treatment[-1]) // 2}", f"b{int(treatment[-1]) % 2}"


def _fraction(basic: int, generated: Sequence[Sequence[int]], runs: int) -> Iterator[tuple[str, ...]]:
    for signs in product((-1, 1), repeat=basic):
        every = [*signs, *(math.prod(signs[place] for place in word) for word in generated)]
        for _ in range(runs):
            yield tuple("+" if sign > 0 else "-" for sign in every)


#: Seven treatments in seven blocks of three: the Fano plane.
_FANO = ((0, 1, 3), (1, 2, 4), (2, 3, 5), (3, 4, 6), (4, 5, 0), (5, 6, 1), (6, 0, 2))


def _incomplete(blocks: Sequence[Sequence[int]], times: int = 1) -> Iterator[tuple[str, ...]]:
    for number, block in enumerate(list(blocks) * times):
        for treatment in block:
            yield f"block {number:02}", f"t{treatment}"


_PLOTS = {"kind": "split_plot", "whole_plot": "Plot", "replicate": "Replicate"}
_SQUARE = {"kind": "latin_square", "row": "Row", "column": "Column"}
_CROSSED = {"kind": "crossover", "subject": "Subject", "period": "Period"}
_BLOCKS = {"kind": "balanced_incomplete_blocks", "block": "Block"}
_FRACTION = {"kind": "fractional_factorial"}
_SURFACE = {"kind": "central_composite", "model": "quadratic"}

#: How many runs a combination has.
_RUNS: Mapping[str, Callable[[tuple[str, ...]], int]] = {
    "5": lambda _: 5,
    "20": lambda _: 20,
    "12 and 4": lambda cell: 12 if cell[0] == "a" else 4,
}
_COMPOSITE = (*product((-1, 1), repeat=2), (0, 0), (0, 0), (0, 0), (1.414, 0), (-1.414, 0), (0, 1.414), (0, -1.414))

_DESIGNS = (
    *(
        DesignedNull(
            f"split plot, {plots} whole plots of each of {hard}, {easy} within{', in replicates' * replicates}",
            _PLOTS,
            ("Replicate", "Plot", "Hard", "Easy"),
            list(_split_plot(plots, hard, easy, replicates=replicates)),
            {"Plot": 2.0, "Replicate": 1.0},
        )
        for plots, hard, easy, replicates in ((3, 2, 4, False), (4, 3, 2, True), (3, 3, 4, True))
    ),
    *(
        DesignedNull(
            f"{squares} Latin square{'s' * (squares > 1)} of {size}",
            _SQUARE,
            ("Row", "Column", "Treatment"),
            list(_square(size, squares)),
            {"Row": 2.0, "Column": 2.0},
        )
        for size, squares in ((3, 3), (4, 1), (5, 1))
    ),
    *(
        DesignedNull(
            f"crossover of {treatments} treatments, {subjects} subjects{', washout' * washout}",
            {**_CROSSED, "washout": washout},
            ("Subject", "Period", "Treatment"),
            list(_crossover(treatments, subjects)),
            {"Subject": 2.0, "Period": 1.0},
        )
        for treatments, subjects, washout in ((2, 8, True), (3, 6, False), (4, 8, False), (4, 8, True))
    ),
    *(
        DesignedNull(
            f"crossover of 2 x 2 treatments, {subjects} subjects who respond differently to A{', washout' * washout}",
            {**_CROSSED, "washout": washout},
            ("Subject", "Period", "A", "B"),
            list(_of_two(_crossover(4, subjects))),
            {"Subject": 2.0, "Period": 1.0, "Subject x A": 2.0},
        )
        for subjects, washout in ((8, True), (12, False))
    ),
    DesignedNull(
        "split plot, 6 whole plots of each of 2, 2 x 2 within, which respond differently to A",
        _PLOTS,
        ("Replicate", "Plot", "Hard", "A", "B"),
        list(_of_two(_split_plot(6, 2, 4, replicates=False))),
        {"Plot": 2.0, "Plot x A": 2.0},
    ),
    DesignedNull(
        "7 treatments in 7 blocks of 3", _BLOCKS, ("Block", "Treatment"), list(_incomplete(_FANO)), {"Block": 2.0}
    ),
    DesignedNull(
        "4 treatments in 12 blocks of 2",
        _BLOCKS,
        ("Block", "Treatment"),
        list(_incomplete([(0, 1), (2, 3), (0, 2), (1, 3), (0, 3), (1, 2)], 2)),
        {"Block": 2.0},
    ),
    DesignedNull("2^(4-1), single runs", _FRACTION, tuple("ABCD"), list(_fraction(3, [(0, 1, 2)], 1))),
    DesignedNull("2^(5-1), single runs", _FRACTION, tuple("ABCDE"), list(_fraction(4, [(0, 1, 2, 3)], 1))),
    DesignedNull(
        "2^(7-4), single runs", _FRACTION, tuple("ABCDEFG"), list(_fraction(3, [(0, 1), (0, 2), (1, 2), (0, 1, 2)], 1))
    ),
    DesignedNull(
        "2^(4-1), 2 runs each",
        _FRACTION,
        tuple("ABCD"),
        list(_fraction(3, [(0, 1, 2)], 2)),
    ),
    DesignedNull("2^(4-1), 5 runs each", _FRACTION, tuple("ABCD"), list(_fraction(3, [(0, 1, 2)], 5))),
    *(
        DesignedNull(
            f"2 x 2 x 2 x 2 without {of}, sd 1 and {large}, n {words}",
            {"kind": PLAIN.kind},
            tuple("ABCD"),
            list(_with_gaps(gaps, runs)),
            spreads={"b": large},
        )
        for of, gaps in (("2 combinations", ["aab"]), ("3 combinations", ["aab", "bbba"]))
        for words, runs in _RUNS.items()
        for large in (1.0, 4.0)
    ),
    DesignedNull("response surface, 11 runs", _SURFACE, ("X", "Y"), [tuple(map(str, row)) for row in _COMPOSITE]),
)

#: What judges each of them.
DESIGNED_NULLS: tuple[Callable[[np.random.Generator, int], Judged], ...] = tuple(
    partial(_judged, design) for design in _DESIGNS
)
