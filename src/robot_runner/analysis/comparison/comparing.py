"""Compares two experiments, measure by measure and combination by combination."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from statsmodels.stats.multitest import multipletests

from robot_runner.analysis.comparison.compared import Comparison, Difference, MeasureComparison, Side, Verdict
from robot_runner.analysis.comparison.comparison_document import conclusion_of
from robot_runner.analysis.comparison.equivalence import (
    Bound,
    Bounds,
    agreement_of,
    difference_test,
    equivalence_p_value,
    why_not_testable,
)
from robot_runner.analysis.comparison.matching import chosen_measures, differing_circumstances, match_runs, names_of
from robot_runner.analysis.results import Results, load_results
from robot_runner.analysis.statistics.outcome import NotComputed
from robot_runner.core.errors import AnalysisError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from robot_runner.analysis.comparison.matching import Matching

__all__ = ["MeasureComparing", "compare"]


# Compares one measure of two experiments.

_PERCENT = 100.0
_FEWEST = 2


@dataclass(frozen=True, slots=True)
class MeasureComparing:
    """How one measure is compared.

    Attributes:
        first, second: the experiments.
        names: of the measure, in each.
        bound: what would not matter, if anything was stated.
        alpha: the level of significance.
        is_paired: whether runs belong together one by one.
    """

    first: Results
    second: Results
    names: tuple[str, str]
    bound: Bound | None
    alpha: float
    is_paired: bool

    def compare(self, matching: Matching) -> MeasureComparison:
        """Compare all combinations."""
        values = [group.values(*self.names, is_paired=self.is_paired) for group in matching.groups]
        treatments = [group.treatments for group in matching.groups]
        found = [self._difference(group, *pair) for group, pair in zip(treatments, values, strict=True)]
        differences = tuple(map(self._judged, _adjusted(found)))
        one, other = self.first.columns[self.names[0]], self.second.columns[self.names[1]]
        compared = MeasureComparison(
            *self.names,
            unit=one.unit,
            first_origin=one.origin,
            second_origin=other.origin,
            bound=self.bound,
            differences=differences,
            agreement=agreement_of(
                {each.label: pair for each, pair in zip(differences, values, strict=True)}, is_paired=self.is_paired
            ),
            verdict=Verdict.of_all([each.verdict for each in differences]),
            conclusion="",
            not_computed=tuple(self._missed(differences)),
        )
        return replace(compared, conclusion=conclusion_of(compared))

    def _difference(
        self, treatments: Mapping[str, str], first: NDArray[np.float64], second: NDArray[np.float64]
    ) -> Difference:
        one, other = _mean(first), _mean(second)
        difference = None if one is None or other is None else other - one
        described = Difference(
            treatments=treatments,
            first_n=len(first),
            second_n=len(second),
            first_mean=one,
            second_mean=other,
            first_sd=_sd(first),
            second_sd=_sd(second),
            difference=difference,
            relative=difference / abs(one) * _PERCENT if difference is not None and one else None,
            bound=None if self.bound is None or one is None else self.bound.in_units(one),
            not_computed=why_not_testable(first, second, is_paired=self.is_paired),
        )
        return described if described.not_computed else self._tested(described, first, second)

    def _tested(self, described: Difference, first: NDArray[np.float64], second: NDArray[np.float64]) -> Difference:
        tested = difference_test(first, second, alpha=self.alpha, is_paired=self.is_paired)
        p_value = (
            equivalence_p_value(first, second, self.bound, is_paired=self.is_paired)
            if self.bound is not None and described.bound
            else None
        )
        return replace(
            described,
            interval=tested.interval,
            narrow_interval=tested.narrow,
            p_value=tested.p_value,
            equivalence_p_value=p_value,
        )

    def _judged(self, difference: Difference) -> Difference:
        if difference.equivalence_p_value is not None and difference.equivalence_p_value < self.alpha:
            return replace(difference, verdict=Verdict.EQUIVALENT)
        if difference.adjusted_p_value is not None and difference.adjusted_p_value < self.alpha:
            return replace(difference, verdict=Verdict.DIFFERENT)
        return difference

    def _missed(self, differences: Sequence[Difference]) -> Iterator[NotComputed]:
        for each in differences:
            if each.not_computed:
                yield NotComputed(f"test of {each.label}", each.not_computed)
        one, other = self.first.unit(self.names[0]), self.second.unit(self.names[1])
        if one != other:
            why = f"The units are {one or 'not known'} and {other or 'not known'}: numbers are compared as they are."
            yield NotComputed("conversion of units", why)


def _mean(values: NDArray[np.float64]) -> float | None:
    return float(values.mean()) if len(values) else None


def _sd(values: NDArray[np.float64]) -> float | None:
    return float(values.std(ddof=1)) if len(values) >= _FEWEST else None


def _adjusted(differences: Sequence[Difference]) -> list[Difference]:
    """Return the differences with p-values adjusted after Holm for the number of combinations."""
    p_values = [each.p_value for each in differences if each.p_value is not None]
    if not p_values:
        return list(differences)
    adjusted = iter(multipletests(p_values, method="holm")[1])
    return [
        each if each.p_value is None else replace(each, adjusted_p_value=float(next(adjusted))) for each in differences
    ]


_ALPHA = 0.05


def compare(
    first: Results | Path | str,
    second: Results | Path | str,
    *,
    measures: Sequence[str] | None = None,
    bound: str | float | Bound | Iterable[str] | None = None,
    alpha: float = _ALPHA,
    is_paired: bool | None = None,
) -> Comparison:
    """Compare the runs that are done of two experiments; runs are matched by the factors that both have.

    Args:
        first: the experiment that is compared with, or its folder: the original, the real robot, what was measured.
        second: the other one: the replication, the simulated robot, what a model estimated.
        measures: names, or `one=other` where they differ; None for all that both have.
        bound: what difference would not matter, as in `10`, `"5%"` or `["5%", "Energy=10"]`; None claims nothing.
        alpha: the level of significance, below 0.5.
        is_paired: whether the runs of a combination belong together one by one; None means within one experiment only.

    Example:
        >>> comparison = compare("original", "replication", bound="5%")  # doctest: +SKIP
        >>> comparison.measure("Energy").verdict  # doctest: +SKIP
        <Verdict.EQUIVALENT: 'equivalent'>

    Raises:
        StorageError: there is no experiment in a folder, or it cannot be read.
        AnalysisError: there is no such measure, or a bound or alpha cannot be.
    """
    if not 0 < alpha < 0.5:  # noqa: PLR2004 - 1 - 2 alpha is a level of confidence
        raise AnalysisError(f"alpha is {alpha!r}", where="compare", fix="Give a number between 0 and 0.5.")
    ours, theirs = (each if isinstance(each, Results) else load_results(each) for each in (first, second))
    paired = ours.folder == theirs.folder if is_paired is None else is_paired
    bounds = _bounds(bound)
    chosen = chosen_measures(ours, theirs, measures)
    _check_bounds(bounds, [name for name, _ in chosen], ours)
    matching = match_runs(ours, theirs, is_paired=paired)
    compared = tuple(
        MeasureComparing(ours, theirs, names, bounds.of(names[0]), alpha, paired).compare(matching) for names in chosen
    )
    labels = names_of(ours, theirs, chosen)
    return Comparison(
        Side(labels[0], ours.name, ours.folder, len(ours.done)),
        Side(labels[1], theirs.name, theirs.folder, len(theirs.done)),
        alpha,
        matching.factors,
        paired,
        compared,
        differing_circumstances(ours, theirs),
        matching.notes,
    )


def _bounds(given: str | float | Bound | Iterable[str] | None) -> Bounds:
    if given is None:
        return Bounds(None, {})
    if isinstance(given, Bound):
        return Bounds(given, {})
    if isinstance(given, int | float):
        return Bounds(Bound(float(given)), {})
    return Bounds.parse([given] if isinstance(given, str) else given)


def _check_bounds(bounds: Bounds, names: Sequence[str], first: Results) -> None:
    for name in bounds.own:
        if name not in names:
            fix = f"Compared are: {', '.join(names)}."
            raise AnalysisError(f"a bound is given for {name!r}, which is not compared", where=first.name, fix=fix)
