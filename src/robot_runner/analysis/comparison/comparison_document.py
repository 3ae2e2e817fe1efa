"""The comparison of two experiments in sentences, as a document and as JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.analysis.comparison.compared import (
    Agreement,
    Bound,
    Comparison,
    Difference,
    MeasureComparison,
    Verdict,
    why_meaningless,
)
from robot_runner.analysis.figures.effects import Estimate, draw_agreement, draw_differences
from robot_runner.analysis.report.blocks import (
    Badge,
    Block,
    Card,
    Cards,
    Cell,
    Document,
    FigureBlock,
    Gallery,
    Paragraph,
    Part,
    Remark,
    Remarks,
    Section,
    Table,
    Tone,
)
from robot_runner.analysis.report.document import plain
from robot_runner.analysis.report.material import origin_badges
from robot_runner.analysis.report.tables import Field, build_table, field, interval, number, p_value, text
from robot_runner.analysis.report.writing import made_by, write_page
from robot_runner.analysis.wording import ALPHA, difference_unit, labelled, listed, shown_level, shown_number, with_unit
from robot_runner.core.words import counted

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.tested import NotComputed

_FORMAT = 1
_TONES = {
    Verdict.IDENTICAL: Tone.GOOD,
    Verdict.EQUIVALENT: Tone.GOOD,
    Verdict.DIFFERENT: Tone.BAD,
    Verdict.UNDECIDED: Tone.WARNING,
}


def write_comparison(comparison: Comparison, path: Path) -> None:
    """Write a comparison as one self-contained HTML file.

    Raises:
        StorageError: the file cannot be written.
    """
    write_page(comparison_document(comparison, made=made_by("Comparison", datetime.now(UTC))), path)


def json_of_comparison(comparison: Comparison) -> str:
    """Return a comparison as JSON; missing and not computed values are null."""
    facts = {"format": _FORMAT, "verdict": comparison.verdict, **plain(comparison)}
    return json.dumps(plain(facts), indent=2, ensure_ascii=False, allow_nan=False)


def conclusion_of(measure: MeasureComparison) -> str:
    """Return one or two plain sentences about a measure."""
    if not measure.differences:
        return "There are no runs of the same combination to compare."
    match measure.verdict:
        case Verdict.IDENTICAL:
            return "Identical: no value differs, in any combination."
        case Verdict.EQUIVALENT:
            verdict = f"Equivalent: differences are within the bound of {shown_bound(measure)}."
        case Verdict.DIFFERENT:
            different = [each.label for each in measure.differences if each.verdict is Verdict.DIFFERENT]
            where = "" if len(different) == len(measure.differences) else f" for {listed(different)}"
            verdict = f"Different{where}."
        case _:
            verdict = f"Undecided: {_why_undecided(measure)}"
    largest = f" The largest difference is {measure.largest}." if measure.largest else ""
    return f"{verdict}{largest}{_practical(measure)}"


def _practical(measure: MeasureComparison) -> str:
    """Return the probability that a difference does not matter, for the combination where it is smallest."""
    known = [(each.practical.within, each.label) for each in measure.differences if each.practical is not None]
    if measure.region is None or not known:
        return ""
    share, label = min(known, key=itemgetter(0))
    where = f" (least of all combinations: {label})" if len(known) > 1 else ""
    region = _shown_bound(measure.region, measure.unit)
    told = f"the probability that the difference is within {region} is {shown_probability(share)}{where}"
    return f" With the reference prior, {told}."


def shown_probability(value: float | None) -> str:
    """Return a probability as papers print it, never as 0 or 1.

    Example:
        >>> [shown_probability(each) for each in (0.98765, 0.0, 0.9999)]
        ['0.988', '< 0.001', '> 0.999']
    """
    if value is None:
        return shown_number(None)
    least = 0.001
    return f"< {least}" if value < least else f"> {1 - least}" if value > 1 - least else f"{value:.3f}"


def shown_bound(measure: MeasureComparison) -> str:
    """Return the bound as it was stated, with the unit."""
    return "no bound" if measure.bound is None else _shown_bound(measure.bound, measure.unit)


def _shown_bound(bound: Bound, unit: str) -> str:
    return str(bound) if bound.is_relative else with_unit(bound.value, unit)


def _why_undecided(measure: MeasureComparison) -> str:
    undecided = [each for each in measure.differences if each.verdict is Verdict.UNDECIDED]
    untested = [each for each in undecided if each.not_computed]
    if len(untested) == len(undecided):
        where = "" if len(undecided) == len(measure.differences) else f" for {listed(each.label for each in undecided)}"
        return f"nothing could be tested{where}. {untested[0].not_computed}"
    if measure.bound is None:
        return "no difference was found, and without a bound nothing can be called equivalent."
    if why := why_meaningless(measure.bound, measure.unit, are_answers=measure.are_answers):
        return why
    if without := [each.label for each in undecided if each.bound == 0]:
        return f"the bound is a percentage of the first mean, which is 0 for {listed(without)}: give it in its unit."
    return (
        f"for {listed(each.label for each in undecided)} the runs suffice neither to show a difference nor to show "
        f"that the difference is within the bound of {shown_bound(measure)} "
        f"({_fewest_runs(undecided)})."
    )


def _fewest_runs(differences: Sequence[Difference]) -> str:
    """Return the number of runs of the smallest combinations, of each experiment where these differ."""
    first, second = (min(getattr(each, name) for each in differences) for name in ("first_n", "second_n"))
    runs = counted(first, "run") if first == second else f"{first} and {counted(second, 'run')}"
    of_units = [each for each in differences if each.unit]
    if not of_units:
        return f"{runs} a combination"
    units = min(count for each in of_units for count in (each.first_units, each.second_units) if count is not None)
    return f"{runs} a combination, of {counted(units, 'unit')} of {of_units[0].unit}"


def largest_in_words(measure: MeasureComparison) -> str:
    """Return the largest difference of a combination, as in `1.131 J, +0.129 % (Video)`; empty without any."""
    known = [each for each in measure.differences if each.difference is not None]
    if not known:
        return ""
    largest = max(known, key=lambda each: abs(each.difference or 0.0))
    where = f" ({largest.label})" if len(measure.differences) > 1 else ""
    size = with_unit(largest.difference, difference_unit(measure.unit))
    share = "" if largest.relative is None else f", {_percentage(largest.relative)}"
    return f"{size}{share}{where}"


def _percentage(value: float | None) -> str:
    """Return a percentage with its sign, as in `+3.50 %`."""
    if value is None:
        return shown_number(None)
    return f"{'+' if value > 0 else ''}{shown_number(value, 3)} %"


def comparison_document(comparison: Comparison, *, made: str) -> Document:
    """Return the comparison as a document; its figures are not drawn yet."""
    runs = " and ".join(counted(side.runs, "run") for side in (comparison.first, comparison.second))
    return Document(
        kicker="Two experiments compared",
        title=f"{comparison.first.name} and {comparison.second.name}",
        subtitle=f"{runs} done",
        badges=(_verdict(comparison.verdict),),
        sections=(
            Section("in-brief", "In brief", tuple(_brief(comparison))),
            Section("what-is-compared", "What is compared", tuple(_circumstances(comparison))),
            Section("differences", "Differences", tuple(_differences(comparison))),
            Section("agreement", "Agreement", tuple(_agreements(comparison))),
        ),
        made=made,
    )


def _verdict(verdict: Verdict) -> Badge:
    return Badge(verdict.value, _TONES[verdict])


def difference_table(comparison: Comparison, measure: MeasureComparison) -> Table:
    """Return a table of the differences of one measure, one row a combination."""

    def size(each: Difference) -> Cell:
        return Cell.of_text(", ".join(map(str, dict.fromkeys((each.first_n, each.second_n)))))

    def units(each: Difference) -> Cell:
        counts = dict.fromkeys((each.first_units, each.second_units))
        return Cell.of_text(", ".join("apart" if count is None else str(count) for count in counts))

    fields: list[Field | tuple[Field, ...]] = [
        text(" / ".join(comparison.factors) or "Group", "label"),
        text("Verdict", "verdict.value", lambda each: _TONES[each.verdict]),
        field("n", size, is_number=True),
        *([field(" or ".join(comparison.together), units, is_number=True)] if comparison.together else []),
        number(comparison.first.name, "first_mean"),
        number(comparison.second.name, "second_mean"),
        number("Difference", "difference"),
        interval(f"{shown_level(1 - comparison.alpha)} CI", "interval"),
        field("Relative", lambda each: Cell(each.relative, _percentage(each.relative)), is_number=True),
        p_value("p, different", "adjusted_p_value"),
        p_value("p, equivalent", "equivalence_p_value"),
    ]
    if measure.region is not None:
        fields += [_probability(name) for name in ("below", "within", "above")]
    bound = f"two one-sided tests with a bound of {shown_bound(measure)}" if measure.bound else "no bound was stated"
    note = f"Difference: {measure.procedure}, p-values adjusted after Holm. Equivalence: {bound}. "
    note += f"{ALPHA} = {comparison.alpha:g}."
    if measure.region is not None:
        region = _shown_bound(measure.region, measure.unit)
        note += f" P: that the second mean is below, within or above {region} of the first; prior of each mean and "
        note += "standard deviation: 1 / standard deviation."
    caption = f"{measure.label}: {comparison.second.name} less {comparison.first.name}."
    return build_table(f"difference {measure.name}", caption, measure.differences, fields, note)


def procedure_of(*, are_proportions: bool, is_paired: bool, together: Sequence[str]) -> str:
    """Return the test of a difference in words; `together` are the units whose runs count together."""
    of_means = "t-test of pairs" if is_paired else "Welch's t-test"
    test = "Newcombe's score intervals" if are_proportions else of_means
    if not together:
        return test
    alike = f"runs of one {' or '.join(together)} counting together"
    return f"{test}, {alike} ({'effective numbers of runs' if are_proportions else 'cluster-robust variance'})"


def _probability(which: str) -> Field:
    def cell(each: Difference) -> Cell:
        value = None if each.practical is None else float(getattr(each.practical, which))
        return Cell(value, shown_probability(value))

    return field(f"P, {which}", cell, is_number=True)


def _brief(comparison: Comparison) -> Iterator[Block]:
    yield Cards(tuple(map(_card, comparison.measures)))
    if comparison.again:
        yield Remarks((Remark("The same runs", comparison.again, Tone.WARNING, "Runs"),))
    for measure in comparison.measures:
        badges = origin_badges(measure.first_origin, measure.second_origin)
        yield Paragraph(measure.conclusion, lead=measure.name, badges=badges)
    if any(measure.bound is None for measure in comparison.measures):
        note = "Without a bound, that no difference was found does not mean that there is none: state one with --bound."
        yield Remarks((Remark("No bound was stated", note, Tone.WARNING, "Equivalence"),))


def _card(measure: MeasureComparison) -> Card:
    error = measure.agreement.error if measure.agreement is not None else None
    note = "" if error is None else f"relative error {shown_number(error, 3)} %"
    return Card(measure.verdict.value, measure.name, note, _TONES[measure.verdict])


def _circumstances(comparison: Comparison) -> Iterator[Block]:
    names = (comparison.first.name, comparison.second.name)
    matched = f"by {' and '.join(comparison.factors)}" if comparison.factors else "as one group"
    pairs = "Runs of a combination belong together one by one." if comparison.is_paired else "Runs are independent."
    if comparison.together:
        alike = f"Runs of one {' or '.join(comparison.together)} vary together, and count together."
        pairs = f"{pairs} {alike}" if comparison.is_paired else alike
    yield Paragraph(f"Runs that are done are matched {matched}. {pairs}")
    if comparison.differing:
        yield circumstances_table(names, comparison.differing)
    else:
        yield Paragraph("Nothing that was recorded of their circumstances differs.", Tone.NOTE)
    remarks = [
        Remark(f"{measure.name} has two origins", _two_origins(measure, *names), Tone.WARNING, "Origin")
        for measure in comparison.measures
        if measure.first_origin != measure.second_origin
    ]
    remarks += [Remark("Matching", note, Tone.NOTE) for note in comparison.notes]
    if remarks:
        yield Remarks(tuple(remarks))


def circumstances_table(names: Sequence[str], differing: Sequence[Sequence[str]]) -> Table:
    """Return a table of differing circumstances, one row a circumstance and one column an experiment."""
    fields = [text(name, itemgetter(place)) for place, name in enumerate(("What differs", *names))]
    return build_table("circumstances", "Circumstances that differ.", differing, fields)


def _two_origins(measure: MeasureComparison, first: str, second: str) -> str:
    origins = [each or "of unknown origin" for each in (measure.first_origin, measure.second_origin)]
    return f"{measure.name} is {origins[0]} in {first}, and {origins[1]} in {second}."


def _differences(comparison: Comparison) -> Iterator[Part]:
    for measure in comparison.measures:
        blocks: list[Block] = [Paragraph(measure.conclusion, Tone.GOOD), difference_table(comparison, measure)]
        if any(each.interval is not None for each in measure.differences):
            blocks.append(Gallery((_estimates(comparison, measure),)))
        blocks += not_computed(measure.not_computed)
        yield Part(f"difference-{measure.name}", measure.label, tuple(blocks), (_verdict(measure.verdict),))


def not_computed(several: Sequence[NotComputed]) -> Iterator[Remarks]:
    """Yield remarks on what could not be computed, if there is anything."""
    if several:
        yield Remarks(tuple(Remark(each.what, each.why, Tone.WARNING, "Note") for each in several))


def _estimates(comparison: Comparison, measure: MeasureComparison) -> FigureBlock:
    estimates = [
        Estimate(each.label, each.difference, each.interval.low, each.interval.high, each.bound)
        for each in measure.differences
        if each.difference is not None and each.interval is not None
    ]
    is_shaded = any(each.bound is not None for each in estimates)
    shaded = f" Shaded: the bound of {shown_bound(measure)}." if is_shaded else ""
    label = labelled(f"Difference of {measure.name}", difference_unit(measure.unit))
    return FigureBlock(
        f"difference {measure.name}",
        f"{measure.label}: {comparison.second.name} less {comparison.first.name}, with "
        f"{shown_level(1 - comparison.alpha)} confidence intervals.{shaded}",
        f"Differences of {measure.name} with confidence intervals: {measure.conclusion}",
        lambda: draw_differences(estimates, value_label=label),
    )


def _agreements(comparison: Comparison) -> Iterator[Block]:
    measures = [measure for measure in comparison.measures if measure.agreement is not None]
    if not measures:
        yield Paragraph("There are no pairs of runs.", Tone.WARNING)
        return
    yield Paragraph(_about_pairs(comparison), Tone.NOTE)

    def error(measure: MeasureComparison) -> Cell:
        value = measure.agreement.error if measure.agreement else None
        return Cell(value, with_unit(value, "%", 3))

    fields = (
        text("Measure", "label"),
        number("Pairs", lambda measure: sum(map(len, measure.agreement.pairs.values()))),
        number("Bias", "agreement.bias"),
        number("Lower limit", "agreement.lower"),
        number("Upper limit", "agreement.upper"),
        field("Relative error (MAPE)", error, is_number=True),
    )
    yield build_table("agreement", "Bias, limits of agreement and relative error.", measures, fields)
    figures = tuple(
        _agreement_figure(comparison, each, each.agreement)
        for each in measures
        if each.agreement is not None and not each.are_answers  # for yes and no, only three points
    )
    if figures:
        yield Gallery(figures)


def _about_pairs(comparison: Comparison) -> str:
    limits = "Limits of agreement: 95 % of the differences are expected between them (Bland and Altman, 1986)."
    if comparison.is_paired:
        return f"{limits} The relative error is the mean over all pairs."
    return (
        f"{limits} The experiments have no natural pairs: runs of one combination were put beside each other, so the "
        "limits say how far apart one run of each may lie. The relative error is of the combinations' means."
    )


def _agreement_figure(comparison: Comparison, measure: MeasureComparison, agreement: Agreement) -> FigureBlock:
    return FigureBlock(
        f"agreement {measure.name}",
        f"Bland-Altman figure of {measure.label}: the difference of each pair over its mean, with bias and limits of "
        "agreement.",
        f"Bias {shown_number(agreement.bias)}, limits of agreement {shown_number(agreement.lower)} to "
        f"{shown_number(agreement.upper)}, groups {listed(agreement.pairs)}.",
        lambda: draw_agreement(
            agreement.pairs,
            bias=agreement.bias,
            lower=agreement.lower,
            upper=agreement.upper,
            value_label=measure.label,
            names=(comparison.first.name, comparison.second.name),
            unit=difference_unit(measure.unit),
        ),
    )
