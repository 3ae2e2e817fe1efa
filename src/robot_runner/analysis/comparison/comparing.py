"""Compare two experiments, measure by measure and combination by combination."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.comparison.compared import (
    Bound,
    Bounds,
    Comparison,
    Difference,
    MeasureComparison,
    Side,
    Verdict,
    why_meaningless,
)
from robot_runner.analysis.comparison.comparison_document import conclusion_of, largest_in_words, procedure_of
from robot_runner.analysis.comparison.equivalence import (
    Regions,
    agreement_of,
    difference_test,
    equivalence_p_value,
    equivalent_proportions,
    practical_equivalence,
    proportion_test,
    spread_of,
    why_not_testable,
)
from robot_runner.analysis.comparison.harmonising import (
    COPIED,
    SAME_VALUES,
    Experiment,
    notes_on_oddities,
    same_measures,
    same_runs,
    sameness,
)
from robot_runner.analysis.comparison.matching import (
    MatchedValues,
    Matching,
    are_answers,
    are_texts,
    chosen_measures,
    differing_circumstances,
    in_unit,
    match_runs,
    names_of,
    notes_on_left_out,
    of_one_quantity,
    why_incomparable,
)
from robot_runner.analysis.comparison.shared_units import Units, estimate_of
from robot_runner.analysis.results import Results, results_of
from robot_runner.analysis.statistics.experiment_statistics import SEARCHED
from robot_runner.analysis.statistics.post_hoc import adjusted_known
from robot_runner.analysis.statistics.tested import NotComputed
from robot_runner.analysis.statistics.tests import note_on_few
from robot_runner.analysis.wording import listed, sentence, shown_level, shown_number
from robot_runner.core.design.analysis_plan import Correction
from robot_runner.core.errors import AnalysisError
from robot_runner.core.words import counted, has_true_zero

_ALPHA = 0.05
_PERCENT = 100.0


def compare(
    first: Results | Path | str,
    second: Results | Path | str,
    *,
    measures: str | Sequence[str] | None = None,
    bound: str | float | Bound | Iterable[str] | None = None,
    alpha: float = _ALPHA,
    is_paired: bool | None = None,
    rope: str | Iterable[str] = (),
) -> Comparison:
    """Compare the runs of two experiments that are done, matched by the factors of both.

    Args:
        first: the reference experiment, or its folder: the original, the real robot, the measurement.
        second: the other experiment: the replication, the simulated robot, the model's estimate.
        measures: names, or `one=other` where they differ; None for all measures of both, except texts.
        bound: the largest difference that does not matter, as in `10`, `"5%"` or `["5%", "Energy=10"]`; None for no
            claim of equivalence.
        alpha: the level of significance, below 0.5.
        is_paired: whether the runs of a combination are pairs; None for pairs only within one experiment.
        rope: regions of practical equivalence, as in `"2%"` or `["5 J", "CPU=2"]`, to compute the probability that a
            difference lies within. Verdicts do not depend on them.

    Example:
        >>> comparison = compare("original", "replication", bound="5%")  # doctest: +SKIP
        >>> comparison.measure("Energy").verdict  # doctest: +SKIP
        <Verdict.EQUIVALENT: 'equivalent'>

    Raises:
        StorageError: a folder holds no experiment, or cannot be read.
        AnalysisError: there is no such measure, or a bound, a region or alpha is invalid.
    """
    if not 0 < alpha < 0.5:  # noqa: PLR2004 - 1 - 2 alpha is a level of confidence
        raise AnalysisError(f"alpha is {alpha!r}", where="compare", fix="Give a number between 0 and 0.5.")
    given = tuple(map(results_of, (first, second)))
    ours, theirs = (each.confirming for each in given)
    paired = ours.folder == theirs.folder if is_paired is None else is_paired
    bounds = _bounds(bound)
    chosen = chosen_measures(ours, theirs, measures)
    _check_bounds("bound", bounds.own, [name for name, _ in chosen], ours)
    regions = _regions(Regions.parse([rope] if isinstance(rope, str) else rope), [name for name, _ in chosen], ours)
    matching = match_runs(ours, theirs, is_paired=paired)
    simulated = all(str(each.manifest.get("robot") or "").startswith("simulated") for each in (ours, theirs))
    compared = tuple(
        _compare_measure(matching, names, _Asked(bounds.of(names[0]), regions[names[0]], alpha, paired, simulated))
        for names in chosen
    )
    is_same, names = ours.folder == theirs.folder, names_of(ours, theirs)
    labels = chosen[0] if is_same and len(chosen) == 1 and len(set(chosen[0])) > 1 else names
    called = (ours.name, theirs.name) if is_same else names
    notes = [
        *_notes_on_searches(called, given),
        *matching.notes,
        *(notes_on_left_out(called, (ours, theirs), chosen) if measures is None else ()),
        *_notes_on_values((ours, theirs), called, chosen),
        *_note_on_chance(compared, alpha),
        *filter(None, [_note_on_few(compared, called)]),
    ]
    return Comparison(
        Side(labels[0], ours.name, ours.folder, len(ours.done)),
        Side(labels[1], theirs.name, theirs.folder, len(theirs.done)),
        alpha,
        matching.factors,
        paired,
        compared,
        differing_circumstances(ours, theirs),
        tuple(dict.fromkeys(notes)),
        matching.together,
        _again(called, given, chosen),
    )


def _again(called: tuple[str, ...], experiments: tuple[Results, ...], chosen: Sequence[tuple[str, str]]) -> str:
    """Return a warning where an experiment is compared with itself, unless these are two measures of one table."""
    is_of_one_name = any(one == other for one, other in chosen)
    why = sameness(*experiments)
    same, of = (0, 0) if why else same_runs(*experiments)
    if same and same >= COPIED * of:
        return (
            f"{called[1]} is {called[0]} again in {same} of {counted(of, 'run')}: {SAME_VALUES}. That these values "
            "agree proves nothing, and the tests take the two experiments for independent, which they are not."
        )
    alike = [name for name in same_measures(*experiments) if (name, name) in chosen]
    if not why and alike:
        return (
            f"{called[1]} has the values of {called[0]} again, of {listed(alike)}: {SAME_VALUES}. That they agree "
            "tells nothing of runs that differ by chance, and the tests take them for independent, which they are not."
        )
    if not why or (not is_of_one_name and experiments[0].folder == experiments[1].folder):
        return ""
    advice = "" if is_of_one_name else " Compare measures of one experiment within one folder, where runs are pairs."
    # An equal simulation may have been computed again, which tells something; a copy tells nothing.
    tells = "tells nothing of runs that differ by chance" if why == SAME_VALUES else "proves nothing"
    return f"{called[1]} is {called[0]} again: {why}. That values agree {tells}.{advice}"


def _notes_on_searches(called: tuple[str, ...], experiments: tuple[Results, ...]) -> Iterator[str]:
    for name, results in zip(called, experiments, strict=True):
        if searched := len(results.done) - len(results.confirming.done):
            runs = counted(searched, "run")
            yield f"Of {name}, runs that confirm what a search found are compared, and not the {runs} of it."


def _note_on_chance(compared: Sequence[MeasureComparison], alpha: float) -> Iterator[str]:
    """Yield a note on the error rate of the common verdict where several measures are tested and one differs."""
    tested = sum(any(each.p_value is not None for each in measure.differences) for measure in compared)
    if tested > 1 and Verdict.DIFFERENT in {measure.verdict for measure in compared}:
        any_of_them, level = shown_number(_PERCENT * (1 - (1 - alpha) ** tested), 3), shown_level(alpha)
        yield (
            f"{tested} measures are compared, each by itself at a level of {level}: where none differs, one of them is "
            f"found to differ in {any_of_them}% of comparisons; in fewer where they go together."
        )


def _note_on_few(compared: Sequence[MeasureComparison], called: tuple[str, ...]) -> str:
    """Return a note on combinations of which one experiment has two or three runs, and the other many."""
    means = (each for measure in compared if not measure.are_answers for each in measure.differences)
    pairs = [(f"{each.label} of ", each.first_n, each.second_n) for each in means if each.p_value is not None]
    return note_on_few(*({label + called[0]: first, label + called[1]: second} for label, first, second in pairs))


def _notes_on_values(
    experiments: tuple[Results, Results], called: tuple[str, ...], chosen: Sequence[tuple[str, str]]
) -> Iterator[str]:
    first, second = experiments
    for one, other in chosen:
        units = first.unit(one), second.unit(other)
        if units[0] != units[1] and of_one_quantity(units[1], units[0]):
            yield f"{one} is in {units[0]} and {units[1]}: values of {called[1]} are converted to {units[0]}."
    for name, results, measures in zip(called, experiments, zip(*chosen, strict=True), strict=True):
        yield from notes_on_oddities(Experiment.of_results(name, results), measures)


def _bounds(given: str | float | Bound | Iterable[str] | None) -> Bounds:
    if given is None:
        return Bounds(None, {})
    if isinstance(given, Bound):
        return Bounds(given, {})
    if isinstance(given, Iterable):
        return Bounds.parse([given] if isinstance(given, str) else map(str, given))
    return Bounds(Bound(float(given)), {})


def _check_bounds(what: str, own: Iterable[str], names: Sequence[str], first: Results) -> None:
    for name in own:
        if name not in names:
            fix = f"Compared are: {', '.join(names)}."
            raise AnalysisError(f"a {what} is given for {name!r}, which is not compared", where=first.name, fix=fix)


def _regions(regions: Regions, names: Sequence[str], first: Results) -> dict[str, Bound | None]:
    """Return the region of each measure, in the measure's unit."""
    _check_bounds("region", regions.own, names, first)
    found = {name: regions.of(name, first.unit(name)) for name in names}
    if (regions.general or regions.own) and not any(found.values()):
        units = ", ".join(dict.fromkeys(first.unit(name) or "no unit" for name in names))
        problem = f"no measure that is compared can be in {', '.join(regions.general)}"
        raise AnalysisError(problem, where="rope", fix=f"They are in {units}; a percentage holds for all: --rope 2%.")
    return found


class _Asked(NamedTuple):
    """The settings of one measure's comparison, and the properties of its values, such as why it cannot be compared."""

    bound: Bound | None
    region: Bound | None
    alpha: float
    is_paired: bool
    are_simulated: bool
    unit: str = ""
    are_answers: bool = False
    obstacle: str = ""

    @property
    def are_proportions(self) -> bool:
        """Whether proportions are compared: answers that are not pairs."""
        return self.are_answers and not self.is_paired

    def why_meaningless(self, bound: Bound | None) -> str:
        """Return why a bound, or a region, is meaningless for the measure; empty where it is not."""
        return why_meaningless(bound, self.unit, are_answers=self.are_answers)

    def telling(self, bound: Bound | None) -> Bound | None:
        """Return the bound, or region, if it is meaningful for the measure; None otherwise."""
        return None if self.why_meaningless(bound) else bound


def _compare_measure(matching: Matching, names: tuple[str, str], asked: _Asked) -> MeasureComparison:
    """Compare a measure in all combinations; p-values are adjusted by Holm for their number."""
    units = matching.first.unit(names[0]), matching.second.unit(names[1])
    obstacle = why_incomparable(units[1], units[0])
    if matching.first.is_exploratory or matching.second.is_exploratory:
        obstacle = sentence(SEARCHED)
    elif any(map(are_texts, (matching.first, matching.second), names)):
        obstacle = "One of the experiments has values that are not numbers."
    asked = asked._replace(unit=units[0], are_answers=are_answers(matching, names), obstacle=obstacle)
    found_values = (group.values(*names, is_paired=asked.is_paired) for group in matching.groups)
    values = [each._replace(second=in_unit(each.second, units[1], units[0])) for each in found_values]
    found = [_tested(group.treatments, each, asked) for group, each in zip(matching.groups, values, strict=True)]
    differences = tuple(_judged(each, asked.alpha) for each in _adjusted(found))
    ours, theirs = matching.first.columns[names[0]], matching.second.columns[names[1]]
    labelled = {each.label: pair[:2] for each, pair in zip(differences, values, strict=True)}
    together = tuple(dict.fromkeys(name for each in values if each.units.are_shared for name in each.units.names))
    compared = MeasureComparison(
        *names,
        unit=ours.unit,
        first_origin=ours.origin,
        second_origin=theirs.origin,
        bound=asked.bound,
        differences=differences,
        agreement=agreement_of(
            labelled, is_paired=asked.is_paired, has_limits=not asked.are_answers, has_shares=has_true_zero(units[0])
        ),
        verdict=Verdict.of_all([each.verdict for each in differences]),
        conclusion="",
        not_computed=tuple(_missed(differences, asked, *units)),
        region=asked.region,
        are_answers=asked.are_answers,
        procedure=procedure_of(are_proportions=asked.are_proportions, is_paired=asked.is_paired, together=together),
    )
    compared = replace(compared, largest=largest_in_words(compared))
    return replace(compared, conclusion=conclusion_of(compared))


def _tested(treatments: Mapping[str, str], values: MatchedValues, asked: _Asked) -> Difference:
    """Compare the values of one combination; p-values are not adjusted yet."""
    (first, second, units), alpha, is_paired = values, asked.alpha, asked.is_paired
    bound, region = asked.telling(asked.bound), asked.telling(asked.region)
    one, other = (float(each.mean()) if len(each) else None for each in (first, second))
    size = None if one is None or other is None else other - one
    described = Difference(
        treatments,
        len(first),
        len(second),
        one,
        other,
        spread_of(first),
        spread_of(second),
        size,
        relative=size / abs(one) * _PERCENT if size is not None and one and has_true_zero(asked.unit) else None,
        bound=None if bound is None or one is None else bound.in_units(one),
        **_facts_of(units, first, second),
    )
    if asked.obstacle:
        return replace(described, not_computed=asked.obstacle)
    practical = None
    if asked.are_proportions and size is not None:
        if why := units.why_unknown:
            return replace(described, not_computed=why)
        test = proportion_test(first, second, alpha=alpha, units=units)
        equivalence = partial(equivalent_proportions, units=units)
    elif why := why_not_testable(first, second, is_paired=is_paired, units=units):
        return _untested(described, why, first, second, asked)
    else:
        test = difference_test(first, second, alpha=alpha, is_paired=is_paired, units=units)
        equivalence = partial(equivalence_p_value, is_paired=is_paired, units=units)
        if region:
            practical = practical_equivalence(first, second, region, alpha=alpha, is_paired=is_paired, units=units)
    return replace(
        described,
        interval=test.interval,
        narrow_interval=test.narrow,
        p_value=test.p_value,
        equivalence_p_value=equivalence(first, second, bound) if bound and described.bound else None,
        practical=practical,
    )


def _untested(difference: Difference, why: str, first: Floats, second: Floats, asked: _Asked) -> Difference:
    """Judge a difference without a test: all values are equal, or were simulated without chance."""
    is_same = np.array_equal(first, second) if asked.is_paired else len({*first, *second}) == 1
    if is_same and len(first) and len(second):
        return replace(difference, verdict=Verdict.IDENTICAL)
    if asked.are_simulated and difference.bound is not None and difference.first_sd == difference.second_sd == 0:
        is_within = abs(float(second.mean()) - float(first.mean())) <= difference.bound
        why = "On a simulated robot values that are all equal hold no chance: the difference is judged without a test."
        return replace(difference, verdict=Verdict.EQUIVALENT if is_within else Verdict.DIFFERENT, not_computed=why)
    return replace(difference, not_computed=why)


def _facts_of(units: Units, first: Floats, second: Floats) -> dict[str, Any]:
    """Return the facts of units whose runs count together; none where runs are independent."""
    if not units.are_shared:
        return {}
    found: dict[str, Any] = {"unit": units.name}
    pairs = zip((first, second), units.kinds, units.counts, strict=True)
    for name, (values, kinds, count) in zip(("first", "second"), pairs, strict=True):
        found[f"{name}_units"] = count
        if len(values) > 1 and count != 1:
            found[f"{name}_error"] = estimate_of(values, kinds).error
    return found


def _adjusted(differences: Sequence[Difference]) -> list[Difference]:
    holm = adjusted_known((each.p_value for each in differences), Correction.HOLM)
    return [replace(each, adjusted_p_value=value) for each, value in zip(differences, holm, strict=True)]


def _judged(difference: Difference, alpha: float) -> Difference:
    if difference.equivalence_p_value is not None and difference.equivalence_p_value < alpha:
        return replace(difference, verdict=Verdict.EQUIVALENT)
    if difference.adjusted_p_value is not None and difference.adjusted_p_value < alpha:
        return replace(difference, verdict=Verdict.DIFFERENT)
    return difference


def _missed(differences: Sequence[Difference], asked: _Asked, one: str, other: str) -> Iterator[NotComputed]:
    for what, bound in (("equivalence", asked.bound), ("probabilities", asked.region)):
        if why := asked.why_meaningless(bound):
            yield NotComputed(what, sentence(why))
    for each in differences:
        if each.not_computed:
            yield NotComputed(f"test of {each.label}", each.not_computed)
        elif each.bound == 0:
            why = "The bound is a percentage of the first mean, which is 0: give it in the unit of the measure."
            yield NotComputed(f"equivalence of {each.label}", why)
        elif asked.telling(asked.region) is not None and each.practical is None:
            why = "The runs of one experiment are all equal, so that there is no posterior distribution."
            why = "They are computed of means, and not of proportions." if asked.are_proportions else why
            yield NotComputed(f"probabilities of {each.label}", why)
    if one != other and not (of_one_quantity(other, one) or why_incomparable(other, one)):
        why = f"The units are {one or 'not known'} and {other or 'not known'}: numbers are compared as they are."
        yield NotComputed("conversion of units", why)
