"""Writes the comparison of two experiments as a page, and as JSON."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from functools import partial
from typing import TYPE_CHECKING

from robot_runner.analysis.comparison.compared import Verdict
from robot_runner.analysis.figures.differences import Estimate, draw_agreement, draw_differences
from robot_runner.analysis.figures.style import FigureFormat, figure_bytes
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
from robot_runner.analysis.report.document import plain
from robot_runner.analysis.report.html import html_of
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
from robot_runner.analysis.report.writing import made_by
from robot_runner.analysis.wording import counted
from robot_runner.core.storage.safe_write import write_beside_and_rename

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from robot_runner.analysis.comparison.compared import Agreement, Comparison, Difference, MeasureComparison

__all__ = [
    "TONES",
    "comparison_document",
    "conclusion_of",
    "difference_table",
    "difference_unit",
    "json_of_comparison",
    "shown_bound",
    "shown_percentage",
    "write_comparison",
]


# What comparing two experiments found, in sentences.


def conclusion_of(measure: MeasureComparison) -> str:
    """Return one or two plain sentences about a measure."""
    if not measure.differences:
        return "There are no runs of the same combination to compare."
    largest = max(
        (each for each in measure.differences if each.difference is not None),
        key=lambda each: abs(each.difference or 0.0),
        default=None,
    )
    tail = f" {_largest(measure, largest)}" if largest is not None else ""
    match measure.verdict:
        case Verdict.EQUIVALENT:
            return f"Equivalent: differences are within the bound of {shown_bound(measure)}.{tail}"
        case Verdict.DIFFERENT:
            return f"Different{_where(measure)}.{tail}"
        case _:
            return f"Undecided: {_why_undecided(measure)}{tail}"


def shown_bound(measure: MeasureComparison) -> str:
    """Return the bound as it was stated, with the unit."""
    if measure.bound is None:
        return "no bound"
    return str(measure.bound) if measure.bound.is_relative else with_unit(measure.bound.value, measure.unit)


def shown_percentage(value: float | None) -> str:
    """Return a percentage with its sign, as in `+3.5 %`.

    Example:
        >>> shown_percentage(3.54)
        '+3.54 %'
    """
    if value is None:
        return shown_number(None)
    return f"{'+' if value > 0 else ''}{shown_number(value, 3)} %"


def difference_unit(measure: MeasureComparison) -> str:
    """Return the unit of a difference: that of percentages is not a percentage of anything."""
    return "percentage points" if measure.unit == "%" else measure.unit


def _where(measure: MeasureComparison) -> str:
    different = [each.label for each in measure.differences if each.verdict is Verdict.DIFFERENT]
    return "" if len(different) == len(measure.differences) else f" for {listed(different)}"


def _largest(measure: MeasureComparison, difference: Difference) -> str:
    where = f" ({difference.label})" if len(measure.differences) > 1 else ""
    size = with_unit(difference.difference, difference_unit(measure))
    return f"The largest difference is {size}, {shown_percentage(difference.relative)}{where}."


def _why_undecided(measure: MeasureComparison) -> str:
    open_ones = [each for each in measure.differences if each.verdict is Verdict.UNDECIDED]
    untested = [each for each in open_ones if each.not_computed]
    if len(untested) == len(measure.differences):
        return f"nothing could be tested. {untested[0].not_computed}"
    if measure.bound is None:
        return "no difference was found, and without a bound nothing can be called equivalent."
    which = listed(each.label for each in open_ones)
    return (
        f"for {which} the runs suffice neither to show a difference nor to show that it is within the bound of "
        f"{shown_bound(measure)} ({counted(min(each.first_n for each in open_ones), 'run')} a combination)."
    )


# The comparison of two experiments as a document.

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


_FORMAT = 1


def write_comparison(comparison: Comparison, path: Path) -> None:
    """Write a comparison as one HTML file that needs nothing beside it.

    Raises:
        StorageError: it cannot be written.
    """
    document = comparison_document(comparison, made=made_by("Comparison", datetime.now(UTC)))
    drawings = {block.name: figure_bytes(block.draw(), FigureFormat.SVG) for block in document.figures}
    text = html_of(document, drawings)
    write_beside_and_rename(path, lambda file: file.write(text))


def json_of_comparison(comparison: Comparison) -> str:
    """Return a comparison as JSON; what is missing or could not be computed is null."""
    facts = {"format": _FORMAT, "verdict": comparison.verdict, **plain(comparison)}
    return json.dumps(plain(facts), indent=2, ensure_ascii=False, allow_nan=False)
