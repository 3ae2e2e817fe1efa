"""The comparison of two experiments as a document."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from robot_runner.analysis.comparison.outcome import Verdict
from robot_runner.analysis.comparison.wording import difference_unit, shown_bound, shown_percentage
from robot_runner.analysis.figures.agreement import draw_agreement
from robot_runner.analysis.figures.equivalence import Estimate, draw_differences
from robot_runner.analysis.report.blocks import (
    Badge,
    Block,
    Card,
    Cards,
    Cell,
    Column,
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
from robot_runner.analysis.report.material import origin_badges
from robot_runner.analysis.report.numbers import (
    ALPHA,
    interval_cells,
    interval_columns,
    listed,
    number_cell,
    p_cell,
    shown_number,
    with_unit,
)
from robot_runner.analysis.wording import counted

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.analysis.comparison.outcome import Agreement, Comparison, MeasureComparison

__all__ = ["TONES", "comparison_document", "difference_table"]

TONES = {Verdict.EQUIVALENT: Tone.GOOD, Verdict.DIFFERENT: Tone.BAD, Verdict.UNDECIDED: Tone.WARNING}


def comparison_document(comparison: Comparison, *, made: str) -> Document:
    """Return the comparison as a document; its figures are not drawn yet.

    Args:
        comparison: what was found.
        made: when and by what it is made.
    """
    names = (comparison.first.name, comparison.second.name)
    return Document(
        kicker="Two experiments compared",
        title=f"{names[0]} and {names[1]}",
        subtitle=f"{counted(comparison.first.runs, 'run')} and {counted(comparison.second.runs, 'run')} done",
        badges=(Badge(comparison.verdict.value, TONES[comparison.verdict]),),
        sections=(
            Section("in-brief", "In brief", tuple(_brief(comparison))),
            Section("what-is-compared", "What is compared", tuple(_circumstances(comparison))),
            Section("differences", "Differences", tuple(_differences(comparison))),
            Section("agreement", "Agreement", tuple(_agreements(comparison))),
        ),
        made=made,
    )


def difference_table(comparison: Comparison, measure: MeasureComparison) -> Table:
    """Return the differences of one measure, one row a combination."""
    level = f"{1 - comparison.alpha:.0%}"
    columns = (
        Column(" / ".join(comparison.factors) or "Group"),
        Column("Verdict"),
        Column("n", is_number=True),
        Column(comparison.first.name, is_number=True),
        Column(comparison.second.name, is_number=True),
        Column("Difference", is_number=True),
        *interval_columns(f"{level} CI"),
        Column("Relative", is_number=True),
        Column("p, different", is_number=True),
        Column("p, equivalent", is_number=True),
    )
    rows = tuple(
        (
            Cell.of_text(each.label),
            Cell.of_text(each.verdict.value, TONES[each.verdict]),
            Cell.of_text(str(each.first_n) if each.first_n == each.second_n else f"{each.first_n}, {each.second_n}"),
            number_cell(each.first_mean),
            number_cell(each.second_mean),
            number_cell(each.difference),
            *interval_cells(each.interval),
            Cell(each.relative, shown_percentage(each.relative)),
            p_cell(each.adjusted_p_value, is_significant=None),
            p_cell(each.equivalence_p_value, is_significant=None),
        )
        for each in measure.differences
    )
    test = "t-test of pairs" if comparison.is_paired else "Welch's t-test"
    bound = f"two one-sided tests with a bound of {shown_bound(measure)}" if measure.bound else "no bound was stated"
    note = f"Difference: {test}, p-values adjusted after Holm. Equivalence: {bound}. {ALPHA} = {comparison.alpha:g}."
    caption = f"{measure.label}: {comparison.second.name} less {comparison.first.name}."
    return Table(f"difference {measure.name}", caption, columns, rows, note)


def _brief(comparison: Comparison) -> Iterator[Block]:
    yield Cards(tuple(map(_card, comparison.measures)))
    for measure in comparison.measures:
        badges = {badge.text: badge for origin in _origins(measure) for badge in origin_badges(origin)}
        yield Paragraph(measure.conclusion, lead=measure.name, badges=tuple(badges.values()))
    if any(measure.bound is None for measure in comparison.measures):
        text = "Without a bound, that no difference was found does not mean that there is none: state one with --bound."
        yield Remarks((Remark("No bound was stated", text, Tone.WARNING, "Equivalence"),))


def _card(measure: MeasureComparison) -> Card:
    error = measure.agreement.error if measure.agreement is not None else None
    note = "" if error is None else f"relative error {shown_number(error, 3)} %"
    return Card(measure.verdict.value, measure.name, note, TONES[measure.verdict])


def _origins(measure: MeasureComparison) -> tuple[str | None, str | None]:
    return measure.first_origin, measure.second_origin


def _circumstances(comparison: Comparison) -> Iterator[Block]:
    matched = f"by {' and '.join(comparison.factors)}" if comparison.factors else "as one group"
    pairs = "Runs of a combination belong together one by one." if comparison.is_paired else "Runs are independent."
    yield Paragraph(f"Runs that are done are matched {matched}. {pairs}")
    columns = (Column("What differs"), Column(comparison.first.name), Column(comparison.second.name))
    rows = tuple(tuple(map(Cell.of_text, row)) for row in comparison.differing)
    if rows:
        yield Table("circumstances", "Circumstances that differ.", columns, rows)
    else:
        yield Paragraph("Nothing that was recorded of their circumstances differs.", Tone.NOTE)
    origins = [
        Remark(
            f"{measure.name} has two origins",
            f"It is {measure.first_origin or 'of unknown origin'} in {comparison.first.name}, and "
            f"{measure.second_origin or 'of unknown origin'} in {comparison.second.name}.",
            Tone.WARNING,
            "Origin",
        )
        for measure in comparison.measures
        if measure.first_origin != measure.second_origin
    ]
    notes = [Remark("Matching", note, Tone.NOTE) for note in comparison.notes]
    if origins or notes:
        yield Remarks((*origins, *notes))


def _differences(comparison: Comparison) -> Iterator[Block]:
    for measure in comparison.measures:
        blocks: list[Block] = [Paragraph(measure.conclusion, Tone.GOOD), difference_table(comparison, measure)]
        if any(each.interval is not None for each in measure.differences):
            blocks.append(Gallery((_estimates(comparison, measure),)))
        if measure.not_computed:
            remarks = tuple(Remark(each.what, each.why, Tone.WARNING, "Note") for each in measure.not_computed)
            blocks.append(Remarks(remarks))
        badge = Badge(measure.verdict.value, TONES[measure.verdict])
        yield Part(f"difference-{measure.name}", measure.label, tuple(blocks), (badge,))


def _estimates(comparison: Comparison, measure: MeasureComparison) -> FigureBlock:
    estimates = [
        Estimate(each.label, each.difference, each.interval.low, each.interval.high, each.bound)
        for each in measure.differences
        if each.difference is not None and each.interval is not None
    ]
    shaded = f" Shaded: the bound of {shown_bound(measure)}." if measure.bound is not None else ""
    return FigureBlock(
        f"difference {measure.name}",
        f"{measure.label}: {comparison.second.name} less {comparison.first.name}, with {1 - comparison.alpha:.0%} "
        f"confidence intervals.{shaded}",
        f"Differences of {measure.name} with confidence intervals: {measure.conclusion}",
        partial(draw_differences, estimates, value_label=_difference_label(measure)),
    )


def _difference_label(measure: MeasureComparison) -> str:
    unit = difference_unit(measure)
    return f"Difference of {measure.name} ({unit})" if unit not in {"", "1"} else f"Difference of {measure.name}"


def _agreements(comparison: Comparison) -> Iterator[Block]:
    found = [(measure, measure.agreement) for measure in comparison.measures if measure.agreement is not None]
    if not found:
        yield Paragraph("There are no pairs of runs.", Tone.WARNING)
        return
    yield Paragraph(_about_pairs(comparison), Tone.NOTE)
    columns = (
        Column("Measure"),
        Column("Pairs", is_number=True),
        Column("Bias", is_number=True),
        Column("Lower limit", is_number=True),
        Column("Upper limit", is_number=True),
        Column("Relative error (MAPE)", is_number=True),
    )
    rows = tuple(
        (
            Cell.of_text(measure.label),
            number_cell(sum(map(len, agreement.pairs.values()))),
            number_cell(agreement.bias),
            number_cell(agreement.lower),
            number_cell(agreement.upper),
            Cell(agreement.error, with_unit(agreement.error, "%", 3)),
        )
        for measure, agreement in found
    )
    yield Table("agreement", "Bias, limits of agreement and relative error.", columns, rows)
    yield Gallery(tuple(_agreement_figure(comparison, measure, agreement) for measure, agreement in found))


def _about_pairs(comparison: Comparison) -> str:
    limits = "Limits of agreement: 95 % of the differences are expected between them (Bland and Altman, 1986)."
    if comparison.is_paired:
        return f"{limits} The relative error is the mean over all pairs."
    return (
        f"{limits} The experiments have no natural pairs: runs of one combination were put beside each other, so the "
        "limits say how far apart one run of each may lie. The relative error is of the combinations' means."
    )


def _agreement_figure(comparison: Comparison, measure: MeasureComparison, agreement: Agreement) -> FigureBlock:
    names = (comparison.first.name, comparison.second.name)
    return FigureBlock(
        f"agreement {measure.name}",
        f"Bland-Altman figure of {measure.label}: the difference of each pair over its mean, with bias and limits of "
        "agreement.",
        f"Bias {shown_number(agreement.bias)}, limits of agreement {shown_number(agreement.lower)} to "
        f"{shown_number(agreement.upper)}, groups {listed(agreement.pairs)}.",
        partial(
            draw_agreement,
            agreement.pairs,
            bias=agreement.bias,
            lower=agreement.lower,
            upper=agreement.upper,
            value_label=measure.label,
            names=names,
            unit=difference_unit(measure),
        ),
    )
