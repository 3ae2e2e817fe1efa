"""Compares two experiments, measure by measure and combination by combination."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.analysis.comparison.bounds import Bound, Bounds
from robot_runner.analysis.comparison.circumstances import differing_circumstances, names_of
from robot_runner.analysis.comparison.matching import chosen_measures, match_runs
from robot_runner.analysis.comparison.measure import MeasureComparing
from robot_runner.analysis.comparison.outcome import Comparison, Side
from robot_runner.analysis.results import Results, load_results
from robot_runner.errors import AnalysisError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

__all__ = ["compare"]

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
