"""Parts of the section on tests: values left out and covariates by the plan, and the results without these choices."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from robot_runner.analysis.report.blocks import Block, Cell, Paragraph, Part, Table, Tone
from robot_runner.analysis.report.tables import build_table, field, interval, number, p_value, text
from robot_runner.analysis.statistics.disclosed import Adjustment, Beside, Slope
from robot_runner.analysis.statistics.left_out import MOST_FALSE_POSITIVES, rate_in_words
from robot_runner.analysis.wording import (
    MISSING,
    about_intervals,
    difference_unit,
    p_in_words,
    sentence,
    shown_number,
    with_unit,
)
from robot_runner.core.design.analysis_plan import Estimand

if TYPE_CHECKING:
    from robot_runner.analysis.report.material import Material
    from robot_runner.analysis.statistics.outcome import MeasureStatistics, Standing
    from robot_runner.analysis.statistics.tested import MeasureTest

_TITLES = {
    Beside.WITHOUT_DOUBTFUL: "Without doubtful values",
    Beside.ALL_RUNS: "With all runs",
    Beside.WITHOUT_COVARIATES: "Without covariates",
}
_CAPTIONS = {
    Beside.WITHOUT_DOUBTFUL: "Whether conclusions stand when the runs are left out whose values are doubtful.",
    Beside.ALL_RUNS: "Whether conclusions stand with the runs that are left out.",
    Beside.WITHOUT_COVARIATES: "Whether conclusions stand where means are not adjusted for covariates.",
}


def planned_parts(measure: MeasureStatistics, label: str) -> Iterator[Block]:
    """Yield the values that are left out, and the adjustment for covariates."""
    if measure.left_out:
        yield _left_out_table(measure, label)
    rate = measure.rule_false_positives
    if rate is not None:
        tone = Tone.WARNING if rate > MOST_FALSE_POSITIVES else Tone.NOTE
        yield Paragraph(sentence(rate_in_words(rate)), tone, lead="Outliers.")
    if measure.adjustment is not None:
        yield from _adjustment(measure, measure.adjustment, label)


def _left_out_table(measure: MeasureStatistics, label: str) -> Table:
    fields = (text("Run", "run_id"), number("Value", "value"), text("Rule", "reason.value"), text("Reason", "why"))
    caption = f"{label}: values that the analysis leaves out; the run table keeps them."
    return build_table(f"left out {measure.name}", caption, measure.left_out, fields)


def _adjustment(measure: MeasureStatistics, found: Adjustment, label: str) -> Iterator[Block]:
    yield _slope_table(measure, found.slopes, label)
    is_of_ranks = measure.test is not None and measure.test.estimand == Estimand.RANK.value
    fields = (
        text("Treatment", "label"),
        number("Mean", "mean"),
        number("Adjusted mean", "adjusted"),
        interval("CI", "interval"),
    )
    what = "mean relative ranks" if is_of_ranks else "means"
    caption = f"{label}: {what} as measured, and at the mean of the covariates."
    about = about_intervals(each.interval for each in found.means)
    note = f"{about}Each combination counts the same."
    if not about:
        note += " Within blocks only differences have an interval."
    table = build_table(f"adjusted {measure.name}", caption, found.means, fields, note)
    yield table.without_blank("CI")
    unit, of_ranks = ("", " of relative ranks") if is_of_ranks else (difference_unit(measure.unit), "")
    spread, left = (with_unit(each, unit, 3) for each in (found.spread, found.residual_spread))
    told = f"The standard deviation{of_ranks} is {spread} as measured, {left} once adjusted for covariates."
    yield Paragraph(told, Tone.NOTE)
    for warning in found.warnings:
        yield Paragraph(warning, Tone.WARNING)


def _slope_table(measure: MeasureStatistics, slopes: Sequence[Slope], label: str) -> Table:
    def shown(slope: Slope) -> Cell:
        value = MISSING if slope.value is None else f"{shown_number(slope.value)} {slope.unit}".strip()
        return Cell(slope.value, value)

    fields = (
        text("Covariate", "covariate"),
        field("Slope", shown),
        interval("CI", "interval"),
        p_value("p", "p_value"),
        number("Mean of the covariate", "centre"),
        number("Variance inflation", "inflation", 3),
        p_value("p of treatments", "treatments_p_value"),
    )
    about = about_intervals(slope.interval for slope in slopes)
    note = f"{about}p of treatments: of the test that the covariate does not differ between treatments."
    equal = None if measure.adjustment is None else measure.adjustment.slopes_p_value
    if equal is not None:
        note += f" Slopes are taken to be the same for all treatments; the test of that, a check: {p_in_words(equal)}."
    return build_table(f"slopes {measure.name}", f"{label}: slopes of the covariates.", slopes, fields, note)


def besides(material: Material, name: str) -> Iterator[tuple[str, MeasureTest]]:
    """Yield the tests of a measure beside the planned one, each with a title."""
    for which in Beside:
        for measure in material.statistics.beside(which):
            if measure.name == name and measure.test is not None:
                yield _TITLES[which], measure.test


def standing_parts(material: Material) -> Iterator[Part]:
    """Yield a part for each analysis beside the planned one, with the conclusions that stand."""
    for which in Beside:
        mine = [each for each in material.statistics.standings if each.beside is which]
        if mine:
            title = _TITLES[which]
            name = title.casefold().removesuffix(" values")
            yield Part(name.replace(" ", "-"), title, (_standing_table(name, _CAPTIONS[which], mine),))


def _standing_table(name: str, caption: str, standings: Sequence[Standing]) -> Table:
    words = {None: "not known", True: "stands", False: "does not stand"}
    without = "p without them" if name == "without doubtful" else "p then"
    fields = (
        text("Measure", "measure"),
        text("Conclusion about", "label"),
        number("Runs left out", lambda each: len(each.left_out)),
        p_value("p", "p_value"),
        p_value(without, "p_value_without"),
        field(
            "Verdict", lambda each: Cell(each.stands, words[each.stands], Tone.GOOD if each.stands else Tone.WARNING)
        ),
    )
    note = "p-values of hypotheses are adjusted; all other tables are of the analysis as it was planned."
    return build_table(name, caption, standings, fields, note)
