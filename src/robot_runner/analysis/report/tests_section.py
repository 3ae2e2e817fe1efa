"""Tests of effects, each with its reason and its conclusion in a sentence."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.analysis.report.blocks import (
    Badge,
    Block,
    Cell,
    Column,
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
from robot_runner.analysis.report.measure_figures import quantile_figure
from robot_runner.analysis.report.numbers import (
    ALPHA,
    RHO,
    interval_cells,
    interval_columns,
    listed,
    number_cell,
    p_cell,
    sentence,
    shown_number,
)
from robot_runner.analysis.report.tables import assumption_table, correction_in_words, effect_table, post_hoc_table
from robot_runner.analysis.wording import counted

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from robot_runner.analysis.report.material import Material
    from robot_runner.analysis.statistics.outcome import MeasureStatistics, NotComputed, Power

__all__ = ["tests_section"]

_PLANNED = Badge("planned", Tone.GOOD, "Measure, level and correction were fixed before the experiment.")
_EXPLORATORY = Badge("exploratory", Tone.PLAIN, "It was not fixed before the experiment.")


def tests_section(material: Material) -> Section:
    """Return the section."""
    blocks: list[Block] = [Paragraph(_planned(material), Tone.NOTE)]
    blocks += _hypotheses(material)
    blocks += [_part(material, measure) for measure in material.statistics.measures]
    blocks += _correlations(material)
    missed = material.statistics.not_computed
    if missed:
        blocks.append(_missed(missed))
    return Section("tests", "Tests", tuple(blocks))


def _missed(several: Sequence[NotComputed]) -> Remarks:
    return Remarks(
        tuple(
            Remark(sentence(each.what).rstrip("."), sentence(each.why), Tone.WARNING, "Not computed")
            for each in several
        )
    )


def _planned(material: Material) -> str:
    statistics = material.statistics
    exploratory = [each.name for each in statistics.measures if not each.is_planned]
    level = (
        f"The level of significance is {ALPHA} = {statistics.alpha:g}; p-values of several comparisons are adjusted "
        f"after {correction_in_words(statistics.correction)}."
    )
    if not statistics.is_planned:
        return f"{level} Nothing was fixed for the analysis before the experiment: all of it is exploratory."
    rest = f" Exploratory: {listed(exploratory)}." if exploratory else ""
    return f"{level} Measures, level and hypotheses were fixed before the experiment.{rest}"


def _hypotheses(material: Material) -> Iterator[Block]:
    outcomes = material.statistics.hypotheses
    if not outcomes:
        return
    columns = (
        Column("Hypothesis"),
        Column("Measure"),
        Column("Factors"),
        Column("p", is_number=True),
        Column("Adjusted p", is_number=True),
        Column("Conclusion"),
    )
    rows = tuple(
        (
            Cell.of_text(each.hypothesis.statement),
            Cell.of_text(each.hypothesis.measure),
            Cell.of_text(" x ".join(each.hypothesis.factors)),
            p_cell(each.p_value, is_significant=None),
            p_cell(each.adjusted_p_value, is_significant=each.is_supported),
            Cell.of_text(each.conclusion),
        )
        for each in outcomes
    )
    yield Table("hypotheses", "Hypotheses that were fixed before the experiment.", columns, rows)


def _part(material: Material, measure: MeasureStatistics) -> Part:
    blocks: list[Block] = [*_test(material, measure), *_assumptions(material, measure)]
    blocks += [
        post_hoc_table(
            f"pairs {measure.name} {' '.join(each.factors)}",
            f"{material.results.label(measure.name)}: all pairs of {' / '.join(each.factors)}.",
            each,
        )
        for each in measure.post_hoc
    ]
    if measure.power is not None:
        blocks.append(Paragraph(_power(measure.power), Tone.NOTE, lead="Power."))
    if measure.not_computed:
        blocks.append(_missed(measure.not_computed))
    badges = (_PLANNED if measure.is_planned else _EXPLORATORY, *origin_badges(measure.origin))
    return Part(f"test-{measure.name}", material.results.label(measure.name), tuple(blocks), badges)


def _test(material: Material, measure: MeasureStatistics) -> Iterator[Block]:
    test = measure.test
    if test is None:
        if not measure.not_computed:
            yield Paragraph("There is nothing to compare.", Tone.WARNING)
        return
    for effect in test.effects:
        yield Paragraph(effect.conclusion, Tone.GOOD)
    yield Paragraph(test.reason, lead=f"{test.method.value[:1].upper()}{test.method.value[1:]}.")
    caption = f"{material.results.label(measure.name)}: {test.method.value}."
    yield effect_table(f"test {measure.name}", caption, test, material.statistics.alpha)
    for note in test.notes:
        yield Paragraph(note, Tone.NOTE)


def _assumptions(material: Material, measure: MeasureStatistics) -> Iterator[Block]:
    blocks: list[Block] = []
    if measure.assumptions:
        caption = f"{material.results.label(measure.name)}: assumptions."
        blocks.append(assumption_table(f"assumptions {measure.name}", caption, measure.assumptions))
    figure = quantile_figure(material, measure) if measure.name in material.drawn else None
    if figure is not None:
        blocks.append(Gallery((figure,)))
    if blocks:
        yield Part(f"assumptions-{measure.name}", "Assumptions", tuple(blocks), is_folded=True)


def _power(power: Power) -> str:
    needed = ", ".join(
        f"{each.repetitions:,} for {'the observed' if each.magnitude == 'observed' else f'a {each.magnitude}'} effect "
        f"({shown_number(each.effect_size, 3)})"
        for each in power.needed
    )
    observed = f"{power.effect_name} = {shown_number(power.observed_effect, 3)}"
    parts = [f"For an effect as large as the observed one ({observed}) the power is {_share(power.achieved_power)}."]
    if power.detectable_effect is not None:
        parts.append(
            f"The smallest effect found with a power of {power.target_power:.2f} is "
            f"{power.effect_name} = {shown_number(power.detectable_effect, 3)}."
        )
    if needed:
        parts.append(f"Runs that a group needs for that power: {needed}.")
    return " ".join([*parts, power.note])


def _share(power: float) -> str:
    return "> 0.999" if power > 0.999 else f"{power:.3f}"  # noqa: PLR2004 - as p-values are printed


def _correlations(material: Material) -> Iterator[Block]:
    found = material.statistics.correlations
    if not found:
        return
    columns = (
        Column("First"),
        Column("Second"),
        Column("n", is_number=True),
        Column("Pearson's r", is_number=True),
        *interval_columns("CI"),
        Column(f"Spearman's {RHO}", is_number=True),
        Column("Adjusted p", is_number=True),
        Column("r within treatments", is_number=True),
        Column("Magnitude"),
    )
    rows = []
    for each in found:
        significant = each.adjusted_p_value < material.statistics.alpha
        rows.append(
            (
                Cell.of_text(each.first),
                Cell.of_text(each.second),
                number_cell(each.n),
                number_cell(each.pearson, 3),
                *interval_cells(each.pearson_interval, 3),
                number_cell(each.spearman, 3),
                p_cell(each.adjusted_p_value, is_significant=significant),
                number_cell(each.within, 3),
                Cell.of_text(each.magnitude.value),
            )
        )
    note = (
        f"p-values are of Spearman's {RHO}, {counted(len(found), 'pair')}. Within treatments: what is left once the "
        "effect of the treatments is taken away."
    )
    table = Table("correlations", "How measures go together, over all runs that are done.", columns, tuple(rows), note)
    yield Part("correlations", "Correlations", (table,))
