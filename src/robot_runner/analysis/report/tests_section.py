"""The section on tests, each with its reason, its assumptions and its conclusion in a sentence."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING

from robot_runner.analysis.plan_file import choices_in_words
from robot_runner.analysis.report.blocks import (
    Badge,
    Beside,
    Block,
    Cell,
    Column,
    Paragraph,
    Part,
    Place,
    Remark,
    Remarks,
    Section,
    Table,
    Tone,
    one_word,
)
from robot_runner.analysis.report.material import Material, correction_in_words
from robot_runner.analysis.report.measure_figures import quantile_figure
from robot_runner.analysis.report.plan_part import besides, planned_parts, standing_parts
from robot_runner.analysis.report.surface_part import surface_parts
from robot_runner.analysis.report.tables import Field, build_table, coefficient, field, interval, number, p_value, text
from robot_runner.analysis.statistics.disclosed import runs_without_value
from robot_runner.analysis.statistics.proportions import PROPORTION, QUANTITY
from robot_runner.analysis.statistics.tested import (
    Comparison,
    Effect,
    EffectSize,
    MeasureTest,
    NotComputed,
    PostHoc,
    named_within,
)
from robot_runner.analysis.wording import (
    ALPHA,
    MISSING,
    RHO,
    about_intervals,
    listed,
    sentence,
    shown_coefficient,
    shown_interval,
    shown_level,
    shown_number,
    shown_test,
)
from robot_runner.core.design.analysis_plan import Estimand
from robot_runner.core.words import combination_label, counted, enumerated

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.outcome import Correlation, MeasureStatistics, Power

_PLANNED = Badge("planned", Tone.GOOD, "Measure, level and correction were fixed before the experiment.")
_EXPLORATORY = Badge("exploratory", Tone.PLAIN, "The analysis was not fixed before the experiment.")


def tests_section(material: Material) -> Section:
    """Return the section on tests."""
    blocks: list[Block] = [Paragraph(_planned(material), Tone.NOTE)]
    if material.statistics.hypotheses:
        blocks.append(_hypothesis_table(material))
    blocks += [_part(material, measure) for measure in material.statistics.measures]
    blocks += standing_parts(material)
    if material.statistics.correlations:
        blocks.append(Part("correlations", "Correlations", (_correlation_table(material),)))
    blocks += _missed(material.statistics.not_computed)
    return Section("tests", "Tests", tuple(blocks))


def _planned(material: Material) -> str:
    statistics = material.statistics
    exploratory = [each.name for each in statistics.measures if not each.is_planned]
    level = (
        f"The level of significance is {ALPHA} = {statistics.alpha:g}; p-values of several comparisons are adjusted "
        f"after {correction_in_words(statistics.correction)}."
    )
    if not statistics.is_planned and statistics.plan is not None:
        choices = "; ".join(choices_in_words(statistics.plan, material.results.unit))
        return f"{level} The plan was given for this report{f' ({choices})' * bool(choices)}: all of it is exploratory."
    if not statistics.is_planned and material.results.plan is not None:
        return f"{level} The experiment's plan has another level or correction: all of this report is exploratory."
    if not statistics.is_planned:
        return f"{level} Nothing was fixed for the analysis before the experiment: all of it is exploratory."
    rest = f" Exploratory: {listed(exploratory)}." if exploratory else ""
    return f"{level} Measures, level and hypotheses were fixed before the experiment.{rest}"


def _part(material: Material, measure: MeasureStatistics) -> Part:
    label = material.results.label(measure.name)
    blocks: list[Block] = [*_test(material, measure), *planned_parts(measure, label), *_assumptions(material, measure)]
    blocks += surface_parts(material, measure)
    blocks += [_pair_table(measure, label, each) for each in measure.post_hoc]
    blocks += _beside(material, measure, label)
    if measure.power is not None:
        blocks.append(Paragraph(_power(measure.power), Tone.NOTE, lead="Power."))
    blocks += _missed(measure.not_computed)
    badges = (_PLANNED if measure.is_planned else _EXPLORATORY, *material.badges(measure))
    return Part(f"test-{measure.name}", label, tuple(blocks), badges)


def _test(material: Material, measure: MeasureStatistics) -> Iterator[Block]:
    test = measure.test
    if test is None:
        if not measure.not_computed:
            yield Paragraph("There is nothing to compare.", Tone.WARNING)
        return
    for effect in test.effects:
        yield Paragraph(effect.conclusion, Tone.GOOD)
    for standing in material.statistics.standings:
        if standing.measure == measure.name:
            tone = Tone.PLAIN if standing.stands else Tone.WARNING
            yield Paragraph(standing.conclusion, tone, lead=standing.statement)
    method = test.method.value
    if any(each.size > 1 for each in test.families):
        yield Paragraph(_families(test), Tone.NOTE, lead="Family.")
    yield Paragraph(test.reason, lead=f"{method[:1].upper()}{method[1:]}.")
    caption = f"{material.results.label(measure.name)}: {method}."
    yield _effect_table(f"test {one_word(measure.name)}", caption, test, material.statistics.alpha)
    for note in test.notes:
        yield Paragraph(note, Tone.NOTE)


def _families(test: MeasureTest) -> str:
    """Return among how many tests p-values are adjusted, for each family of the tests of a measure."""
    if len(test.families) == 1:
        return f"p-values are adjusted for {counted(test.family_size, 'test')}: {test.family}."
    told = (f"{enumerated(each.tests)} among {counted(each.size, 'test')} ({each.name})" for each in test.families)
    return f"p-values are adjusted within families: {'; '.join(told)}."


def _beside(material: Material, measure: MeasureStatistics, label: str) -> Iterator[Part]:
    """Yield the tests with one choice changed, folded, because the planned test comes first."""
    for title, test in besides(material, measure.name):
        name = f"test {one_word(measure.name)} {title.casefold()}"
        caption = f"{label}, {title.casefold()}: {test.method.value}."
        table = _effect_table(name, caption, test, material.statistics.alpha)
        yield Part(name.replace(" ", "-"), title, (table,), is_folded=True)


def _assumptions(material: Material, measure: MeasureStatistics) -> Iterator[Block]:
    blocks: list[Block] = []
    figure = quantile_figure(material, measure) if measure.name in material.drawn else None
    if figure is not None:
        blocks.append(figure)
    if measure.assumptions:
        fields = (
            text("Check", "name"),
            text("Of", lambda check: combination_label(check.treatments.values()) or "all groups"),
            coefficient("Statistic", "statistic"),
            p_value("p", "p_value"),
            text("Conclusion", "conclusion"),
        )
        caption = f"{material.results.label(measure.name)}: how values are distributed."
        note = "They describe the values; no test is chosen by them."
        blocks.append(build_table(f"assumptions {measure.name}", caption, measure.assumptions, fields, note))
    if blocks:
        yield Part(f"assumptions-{measure.name}", "Distribution", (Beside(tuple(blocks)),), is_folded=True)


def _power(power: Power) -> str:
    needed = ", ".join(
        f"{each.repetitions:,} for a {each.magnitude} effect ({shown_number(each.effect_size, 3)})"
        for each in power.needed
    )
    parts = []
    if power.detectable_effect is not None:
        parts.append(
            f"The smallest effect found with a power of {power.target_power:.2f} is "
            f"{power.effect_name} = {shown_number(power.detectable_effect, 3)}."
        )
    if needed:
        parts.append(f"{sentence(power.counted).rstrip('.')} that are needed for that power: {needed}.")
    return " ".join([*parts, power.note])


def _missed(several: Iterable[NotComputed]) -> Iterator[Remarks]:
    remarks = tuple(
        Remark(sentence(each.what).rstrip("."), sentence(each.why), Tone.WARNING, "Not computed") for each in several
    )
    if remarks:
        yield Remarks(remarks)


def _hypothesis_table(material: Material) -> Table:
    fields = (
        text("Hypothesis", "hypothesis.statement"),
        text("Measure", "hypothesis.measure"),
        text("Factors", lambda each: " x ".join(each.hypothesis.factors)),
        p_value("p", "p_value"),
        p_value("Adjusted p", "adjusted_p_value", "is_supported"),
        text("Conclusion", "conclusion"),
    )
    caption = "Hypotheses that were fixed before the experiment."
    return build_table("hypotheses", caption, material.statistics.hypotheses, fields)


def _effect_table(name: str, caption: str, test: MeasureTest, alpha: float) -> Table:
    words = {None: "not computed", True: "significant", False: "not significant"}
    checked = "means" if test.estimand == Estimand.RANK.value else "ranks"
    fields = (
        text("Effect", "label"),
        text("Test", "test"),
        field("Statistic", lambda effect: Cell(effect.statistic, _shown_statistic(effect))),
        text("Effect size", lambda effect: "; ".join(map(_shown_size, effect.effect_sizes)) or MISSING),
        p_value("p", "p_value"),
        p_value("Adjusted p", "adjusted_p_value", "is_significant"),
        p_value(
            f"p of {checked}",
            lambda effect: effect.check.p_value if effect.check else None,
            lambda effect: effect.check is not None and effect.check.agrees is False,
        ),
        field(f"At {ALPHA} = {alpha:g}", lambda effect: Cell(effect.is_significant, words[effect.is_significant])),
    )
    note = f"Computed with {test.library}."
    hidden = {"Effect size"} if test.estimand == PROPORTION else set()
    if any(effect.check for effect in test.effects):
        note += f" The last p-value is of a check: the test of {checked}."
    else:
        hidden.add(f"p of {checked}")
    shown = (each for each in fields if each.column.name not in hidden)
    return build_table(name, caption, test.effects, tuple(shown), note)


def _shown_statistic(effect: Effect) -> str:
    """Return the statistic of an effect; both statistics where two tests are combined."""
    if effect.statistic is None:
        return MISSING
    parts = effect.parts or (effect,)
    return "; ".join(shown_test(effect.statistic_name, of.degrees_of_freedom, of.statistic) for of in parts)


def _shown_size(size: EffectSize) -> str:
    of = size.interval
    ends = "" if of is None else f" {shown_interval(of, shown_coefficient)} ({shown_level(of.level)})"
    return f"{size.name} = {shown_coefficient(size.value)}{ends}, {size.magnitude.value}"


def _pair_table(measure: MeasureStatistics, label: str, post_hoc: PostHoc) -> Table:
    sizes = list(dict.fromkeys(size.name for pair in post_hoc.comparisons for size in pair.effect_sizes))
    fields: list[Field | tuple[Field, ...]] = [
        text("First", "first"),
        text("Second", "second"),
        field(f"Difference of {post_hoc.quantity}", _difference_on_two_lines, is_number=True, place=Place.PAGE),
        number(f"Difference of {post_hoc.quantity}", "difference", place=Place.FILE),
        *interval("CI", "interval")[1:],
        *map(_size_fields, sizes),
        p_value("p", "p_value"),
        p_value("Adjusted p", "adjusted_p_value", "is_significant"),
        p_value(check := f"p of {'means' if post_hoc.quantity.endswith('ranks') else 'ranks'}", "check_p_value"),
    ]
    name = f"pairs {' '.join(map(one_word, (measure.name, *post_hoc.factors)))}"
    pairs = f"all pairs of {named_within(' / '.join(post_hoc.factors), post_hoc.within)}"
    caption = f"{label}: {pairs}, the first less the second."
    note = (
        f"{post_hoc.method}; {_about_brackets(post_hoc)} Adjusted after "
        f"{correction_in_words(post_hoc.correction)}, and no smaller than the p-value of the effect."
    )
    return build_table(name, caption, post_hoc.comparisons, fields, note).without_blank(check)


def _about_brackets(post_hoc: PostHoc) -> str:
    intervals = (pair.interval for pair in post_hoc.comparisons if pair.interval is not None)
    level = next((shown_level(each.level) for each in intervals), "")
    # Exact tests, which have no statistic, are not inverted: of proportions, the test decides.
    is_exact = post_hoc.quantity == QUANTITY and any(pair.statistic is None for pair in post_hoc.comparisons)
    belong = "say how large differences may be; p decides whether there is one" if is_exact else "belong to p"
    return f"{level} confidence intervals, in brackets, {belong}.".lstrip()


def _size_fields(name: str) -> tuple[Field, ...]:
    """Return the columns of an effect size: one for readers, and its parts for programs."""

    def part(which: str, read: Callable[[EffectSize], float | str | None]) -> Field:
        def cell(pair: Comparison) -> Cell:
            size = next((each for each in pair.effect_sizes if each.name == name), None)
            value = None if size is None else read(size)
            return Cell(value, value if isinstance(value, str) else shown_number(value))

        place = Place.FILE if which else Place.PAGE
        return Field(Column(f"{name}, {which}" if which else name, place=place), cell)

    return (
        part("", _size_on_two_lines),
        part("value", lambda size: size.value),
        part("low", lambda size: None if size.interval is None else size.interval.low),
        part("high", lambda size: None if size.interval is None else size.interval.high),
        part("magnitude", lambda size: size.magnitude.value),
    )


def _difference_on_two_lines(pair: Comparison) -> Cell:
    ends = "" if pair.interval is None else f"\n{shown_interval(pair.interval)}"
    return Cell(pair.difference, f"{shown_number(pair.difference)}{ends}")


def _size_on_two_lines(size: EffectSize) -> str:
    ends = "" if size.interval is None else f"\n{shown_interval(size.interval, shown_coefficient)}"
    return f"{shown_coefficient(size.value)}, {size.magnitude.value}{ends}"


def _correlation_table(material: Material) -> Table:
    found, alpha = material.statistics.correlations, material.statistics.alpha

    def is_significant(each: Correlation) -> bool:
        return each.adjusted_p_value is not None and each.adjusted_p_value < alpha

    fields = (
        text("First", "first"),
        text("Second", "second"),
        number("n", "n"),
        coefficient("Pearson's r", "pearson"),
        interval("CI", "pearson_interval", shown_coefficient),
        coefficient(f"Spearman's {RHO}", "spearman"),
        p_value("Adjusted p", "adjusted_p_value", is_significant),
        coefficient("r within treatments", "within"),
        text("Magnitude", "magnitude.value"),
    )
    about = about_intervals((each.pearson_interval for each in found), " of r")
    told = f"p-values are of Spearman's {RHO}, {counted(len(found), 'pair')}."
    if all(each.p_value is None for each in found):
        told = "Runs of one block, plot, subject or batch vary together: there are neither p-values nor intervals."
    note = (
        f"{about}{told} Within treatments: what is left once the effects of the treatments, and of blocks and batches, "
        "are taken away."
    )
    if any(runs_without_value(each.left_out) for each in material.statistics.measures):
        note += " Values that are left out of the analysis of a measure are left out here, too."
    caption = "How measures go together, over all runs that are done."
    return build_table("correlations", caption, found, fields, note)
