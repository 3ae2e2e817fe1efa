"""Recompute measures from samples, and compare them with the table's values."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.importing.description import Aggregation, Recipe
from robot_runner.analysis.importing.units import Unit, split_heading
from robot_runner.core.errors import AnalysisError, did_you_mean

if TYPE_CHECKING:
    from robot_runner.analysis.importing.foreign_samples import ForeignSamples, RunSamples

_MEANS = re.compile(r"^(?:avg|average|mean)[_ ]+|[_ ]+(?:avg|average|mean)$", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Difference:
    """A measure's value in the table and the one that was recomputed from the samples, both in SI.

    Attributes:
        run_id: the run.
        measure: its name in the table.
        table, recomputed: the two values.
        unit: their SI unit; empty where it is not known.
    """

    run_id: str
    measure: str
    table: float
    recomputed: float
    unit: str = ""

    @property
    def absolute(self) -> float:
        """The recomputed value minus the table's."""
        return self.recomputed - self.table

    @property
    def relative(self) -> float | None:
        """The difference as a share of the table's value; None where that is 0 and the other is not."""
        if self.table == 0:
            return 0.0 if self.recomputed == 0 else None
        return self.absolute / abs(self.table)


def recompute(recipe: Recipe, run: RunSamples) -> float | None:
    """Return a measure of one run in SI; None if there are too few samples, or a counter started again in a long step.

    Samples without a value are left out. `mean` is the plain mean, as most tools compute it.

    Raises:
        AnalysisError: the column has text.
    """
    times = run.times
    if recipe.how is Aggregation.COUNT:
        return float(len(times))
    if recipe.how is Aggregation.DURATION:
        return float(times[-1] - times[0]) if len(times) > 1 else None
    try:
        values = np.asarray(run.values[recipe.column], dtype=np.float64)
    except ValueError as error:
        fix = "Name a column of numbers."
        problem = f"column {recipe.column!r} holds no numbers"
        raise AnalysisError(problem, where=f"recompute {recipe.measure} = {recipe.words}", fix=fix) from error
    valid = np.isfinite(values)
    if recipe.how is Aggregation.CHANGE and recipe.column in run.span.restarted:
        return _bridged(times[valid], values[valid])
    return _aggregated(recipe.how, times[valid], values[valid])


#: The share of a run that a step may last in which a counter started again: it is bridged by the mean of the others.
#: Of 47 logs of a processor's counters, at 5 Hz, in which one wrapped around, none was wrong by more than 0.02 %.
_SHORT = 0.02


def _bridged(times: Floats, counts: Floats) -> float | None:
    steps, seconds = np.diff(counts), np.diff(times)
    known = steps >= 0
    if np.sum(seconds[~known]) >= _SHORT * np.sum(seconds):
        return None
    return float(np.sum(steps[known]) / np.sum(seconds[known]) * np.sum(seconds))


def _aggregated(how: Aggregation, times: Floats, values: Floats) -> float | None:
    if how in _TRAPEZOIDS:
        times, values = _one_a_moment(times, values)
    least = 2 if how in _OVER_TIME else 1
    if len(values) < least or (how is Aggregation.TIME_MEAN and times[-1] == times[0]):
        return None
    found = float(_COMPUTED[how](times, values))
    return found if math.isfinite(found) else None


def _one_a_moment(times: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return the mean of the values of each moment: of all samples of a second, only two would count otherwise."""
    moments, places = np.unique(times, return_inverse=True)
    return moments, np.bincount(places, values) / np.bincount(places)


_TRAPEZOIDS = frozenset({Aggregation.INTEGRAL, Aggregation.TIME_MEAN})
_OVER_TIME = _TRAPEZOIDS | {Aggregation.ENERGY_PT}

_COMPUTED: Mapping[Aggregation, Callable[[Floats, Floats], Any]] = {
    Aggregation.INTEGRAL: lambda times, values: np.trapezoid(values, times),
    Aggregation.TIME_MEAN: lambda times, values: np.trapezoid(values, times) / (times[-1] - times[0]),
    Aggregation.ENERGY_PT: lambda times, values: np.mean(values) * (times[-1] - times[0]),
    Aggregation.CHANGE: lambda _, values: values[-1] - values[0],
    Aggregation.MEAN: lambda _, values: np.mean(values),
    Aggregation.SUM: lambda _, values: np.sum(values),
    Aggregation.MIN: lambda _, values: np.min(values),
    Aggregation.MAX: lambda _, values: np.max(values),
    Aggregation.MEDIAN: lambda _, values: np.median(values),
}


def unit_of_recipe(recipe: Recipe, samples: ForeignSamples) -> str:
    """Return the SI unit of a recomputed measure; empty where it is not known."""
    if recipe.how is Aggregation.COUNT:
        return "1"
    if recipe.how is Aggregation.DURATION:
        return "s"
    unit = samples.units.get(recipe.column)
    if unit is None:
        return ""
    if recipe.how in {Aggregation.INTEGRAL, Aggregation.ENERGY_PT}:
        return "J" if unit.si == "W" else f"{unit.si} s"
    return unit.si


def check_recipes(recipes: Sequence[Recipe], samples: Sequence[ForeignSamples]) -> None:
    """Raise AnalysisError if a recipe's file or column does not exist."""
    by_file = {each.file: each for each in samples}
    for recipe in recipes:
        where = f"recompute {recipe.measure}"
        if recipe.file not in by_file:
            fix = did_you_mean(recipe.file, by_file) or "Describe the file with samples."
            raise AnalysisError(f"no samples are in {recipe.file!r}", where=where, fix=fix)
        columns = by_file[recipe.file].columns
        if recipe.how.needs_column and recipe.column not in columns:
            fix = did_you_mean(recipe.column, columns)
            raise AnalysisError(f"{recipe.file} has no column {recipe.column!r}", where=where, fix=fix)


def guess_recipes(
    measures: Mapping[str, Unit | None], samples: Sequence[ForeignSamples], given: Sequence[Recipe]
) -> list[Recipe]:
    """Return recipes for measures without one, where the right column of samples is nearly certain.

    A measure in joules is the integral of the only sampled power; `avg_x`, `mean_x` and `x` are the mean of the only
    column of samples named `x`, or its change where that counts joules.
    """
    known = {recipe.measure for recipe in given}
    powers = [(each, name) for each in samples for name, unit in each.units.items() if unit and unit.si == "W"]
    energies = [name for name, unit in measures.items() if unit and unit.si == "J"]
    guessed = []
    for measure in measures:
        if measure in known:
            continue
        if measure in energies and len(powers) == 1 and len(energies) == 1:
            source, column = powers[0]
            guessed.append(Recipe(measure, Aggregation.INTEGRAL, source.file, column, is_guessed=True))
            continue
        base = _MEANS.sub("", split_heading(measure)[0]).casefold()
        named = [(each, name) for each in samples for name in each.numeric if split_heading(name)[0].casefold() == base]
        if len(named) == 1:
            source, column = named[0]
            unit = source.units.get(column)
            how = Aggregation.CHANGE if unit and unit.si == "J" else Aggregation.MEAN
            guessed.append(Recipe(measure, how, source.file, column, is_guessed=True))
    return guessed


#: Values that differ by less, as a share of the table's value, differ only by rounding and the method of integration.
TOLERANCE = 0.001

#: Factors by which values differ when a unit was mistaken.
_FACTORS = (1e-9, 1e-6, 1e-3, 1e-2, 1 / 60, 60.0, 3.6, 1 / 3.6, 100.0, 1e3, 3600.0, 1 / 3600, 1e6, 1e9)
_SAME_FACTOR = 0.02


@dataclass(frozen=True, slots=True)
class Agreement:
    """How well the recomputed values of one measure agree with the table's.

    Attributes:
        compared: the number of runs with both values.
        differing: the differences above the tolerance, the largest first.
        largest: the largest difference, whether within the tolerance or not.
        factor: the factor between all recomputed values and the table's, where it looks like a mistaken unit.
    """

    measure: str
    compared: int
    differing: tuple[Difference, ...]
    largest: Difference
    factor: float | None


def agreements(differences: Iterable[Difference]) -> tuple[Agreement, ...]:
    """Return the agreement of each measure, in the order of the differences.

    Example:
        >>> agreements([Difference("r_1", "Energy", 870.0, 870.1)])[0].differing
        ()
    """
    by_measure: dict[str, list[Difference]] = {}
    for each in differences:
        by_measure.setdefault(each.measure, []).append(each)
    return tuple(_agreement(measure, found) for measure, found in by_measure.items())


def _agreement(measure: str, found: list[Difference]) -> Agreement:
    ordered = sorted(found, key=_size, reverse=True)
    differing = tuple(each for each in ordered if _size(each) > TOLERANCE)
    return Agreement(measure, len(found), differing, ordered[0], _factor(found) if differing else None)


def _size(difference: Difference) -> float:
    relative = difference.relative
    return float("inf") if relative is None else abs(relative)


def _factor(found: list[Difference]) -> float | None:
    ratios = [each.recomputed / each.table for each in found if each.table]
    if not ratios:
        return None
    middle = median(ratios)
    return next((factor for factor in _FACTORS if abs(middle / factor - 1) < _SAME_FACTOR), None)
