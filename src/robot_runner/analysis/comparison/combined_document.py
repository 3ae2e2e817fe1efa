"""A meta-analysis in sentences, as a document with forest plots, and as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from robot_runner.analysis.comparison.comparison_document import circumstances_table, not_computed
from robot_runner.analysis.figures.effects import ForestLine, draw_forest
from robot_runner.analysis.report.blocks import (
    Block,
    Card,
    Cards,
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
    one_word,
)
from robot_runner.analysis.report.document import plain
from robot_runner.analysis.report.material import origin_badges
from robot_runner.analysis.report.tables import build_table, coefficient, interval, number, p_value, text
from robot_runner.analysis.wording import (
    ALPHA,
    difference_unit,
    labelled,
    p_in_words,
    p_values_in_words,
    shown_interval,
    shown_number,
    with_unit,
)
from robot_runner.core.words import counted, enumerated

if TYPE_CHECKING:
    from robot_runner.analysis.comparison.combined import Combined, CombinedEffect, CombinedMeasure, MetaAnalysis
    from robot_runner.analysis.statistics.tested import Interval

_FORMAT = 1
_COMMON, _RANDOM, _FURTHER = "Common effect", "Average (random effects)", "A further experiment"
_MOST_CARDS = 8


def json_of_meta_analysis(found: MetaAnalysis) -> str:
    """Return a meta-analysis as JSON; missing, not computed and infinite values are null."""
    return json.dumps({"format": _FORMAT, **plain(found)}, indent=2, ensure_ascii=False, allow_nan=False)


def combined_document(found: MetaAnalysis, *, made: str) -> Document:
    """Return a meta-analysis as a document; its figures are not drawn yet."""
    runs = counted(sum(each.runs for each in found.experiments), "run")
    return Document(
        kicker="Experiments combined",
        title=enumerated(each.name for each in found.experiments),
        subtitle=f"{counted(len(found.experiments), 'experiment')}, {runs} done",
        badges=(),
        sections=(
            Section("in-brief", "In brief", tuple(_brief(found))),
            Section("what-is-combined", "What is combined", tuple(_circumstances(found))),
            Section("effects", "Effects", tuple(_measures(found))),
        ),
        made=made,
    )


def _brief(found: MetaAnalysis) -> Iterator[Block]:
    effects = [(measure, effect) for measure in found.measures for effect in measure.effects]
    if cards := [_card(measure, effect) for measure, effect in effects[:_MOST_CARDS]]:
        yield Cards(tuple(cards))
    for measure in found.measures:
        badges = origin_badges(*measure.origins.values())
        for effect in measure.effects:
            yield Paragraph(effect.conclusion, lead=f"{measure.name}, {effect.label}", badges=badges)
        if not measure.effects:
            why = measure.not_computed[0].why if measure.not_computed else ""
            yield Paragraph(f"Nothing could be combined: {why}", Tone.WARNING, lead=measure.name)


def _card(measure: CombinedMeasure, effect: CombinedEffect) -> Card:
    random = effect.difference.random
    value = with_unit(random.estimate, difference_unit(measure.unit))
    tone = Tone.GOOD if effect.is_significant else Tone.NOTE
    return Card(value, f"{measure.name}: {effect.label}", shown_interval(random.interval), tone)


def _circumstances(found: MetaAnalysis) -> Iterator[Block]:
    fields = (
        text("Name here", "name"),
        text("Experiment", "experiment"),
        text("Folder", "folder.name"),
        number("Runs done", "runs"),
    )
    yield build_table(
        "experiments", "The experiments, in the order in which they were given.", found.experiments, fields
    )
    yield Paragraph(_METHOD, Tone.NOTE)
    if found.differing:
        yield circumstances_table([each.name for each in found.experiments], found.differing)
    if found.findings:
        remarks = (
            Remark(
                each.where, f"{each.problem[:1].upper()}{each.problem[1:]}. {each.fix}".strip(), Tone.NOTE, "Matching"
            )
            for each in found.findings
        )
        yield Remarks(tuple(remarks))


_METHOD = (
    "In each experiment treatments are compared as its report does. Averages: random effects of Paule and Mandel with "
    "the interval of Hartung, Knapp, Sidik and Jonkman; the common effect has the standard error of Meier. How far "
    "experiments differ is tested by Welch's F; the interval of the standard deviation is that of the profile of Q "
    "(Viechtbauer); a further experiment is predicted as Higgins et al. do. P-values are adjusted after Holm among the "
    "effects on a measure."
)


def _measures(found: MetaAnalysis) -> Iterator[Part]:
    for measure in found.measures:
        blocks: list[Block] = []
        if measure.effects:
            blocks.append(_averages(found, measure))
        for effect in measure.effects:
            blocks += [Paragraph(effect.conclusion, lead=effect.label), effect_table(found, measure, effect)]
            blocks.append(Gallery((_forest(found, measure, effect),)))
        blocks += not_computed(measure.not_computed)
        yield Part(f"effects-{measure.name}", measure.label, tuple(blocks))


def _averages(found: MetaAnalysis, measure: CombinedMeasure) -> Table:
    level = f"{100 * (1 - found.alpha):g} %"
    fields = (
        text("Effect", "label"),
        number("k", lambda effect: len(effect.experiments)),
        number("Average", "difference.random.estimate"),
        interval(f"{level} CI", "difference.random.interval"),
        p_value("p", "adjusted_p_value", "is_significant"),
        number("Hedges' g", lambda effect: effect.standardised and effect.standardised.random.estimate, 3),
        number("SD between", lambda effect: math.sqrt(effect.difference.heterogeneity.tau_squared), 3),
        number("I² (%)", "difference.heterogeneity.i_squared", 3),
        p_value("p, differ", "difference.heterogeneity.p_value"),
        interval("Further experiment", "difference.prediction"),
    )
    caption = f"{measure.label}: averages over experiments (random effects)."
    note = f"p: adjusted after Holm, {ALPHA} = {found.alpha:g}. p, differ: of no difference between experiments."
    return build_table(f"averages {measure.name}", caption, measure.effects, fields, note)


def _lines(effect: CombinedEffect) -> Iterator[ForestLine]:
    found, sizes = effect.difference, effect.standardised
    for each, weight in zip(effect.experiments, found.random_weights, strict=True):
        yield ForestLine(each.experiment, each.estimate, each.interval, weight, each.runs, each.p_value, each.g)
    for label, which in ((_RANDOM, "random"), (_COMMON, "common")):
        pooled = getattr(found, which)
        g = None if sizes is None else getattr(sizes, which).estimate
        yield ForestLine(label, pooled.estimate, pooled.interval, p_value=pooled.p_value, g=g)
    if found.prediction is not None:
        yield ForestLine(_FURTHER, interval=found.prediction)


def effect_table(found: MetaAnalysis, measure: CombinedMeasure, effect: CombinedEffect) -> Table:
    """Return a table of each experiment's estimate of an effect, then of the averages."""
    level = f"{100 * (1 - found.alpha):g} %"
    fields = (
        text("Experiment", "label"),
        number("n", "runs"),
        number("Difference", "estimate"),
        interval(f"{level} CI", "interval"),
        p_value("p", "p_value"),
        number("Weight (%)", lambda line: None if line.weight is None else 100 * line.weight, 3),
        coefficient("Hedges' g", "g"),
    )
    caption = f"{measure.label}: {effect.label}."
    note = "p-values before adjustment. Weights are those of the average."
    return build_table(f"effect {one_word(measure.name)} {effect.label}", caption, tuple(_lines(effect)), fields, note)


def _forest(found: MetaAnalysis, measure: CombinedMeasure, effect: CombinedEffect) -> FigureBlock:
    label = labelled(f"Difference of {measure.name}", difference_unit(measure.unit))
    return FigureBlock(
        f"forest {one_word(measure.name)} {effect.label}",
        f"{measure.label}: {effect.label}. Squares: experiments, their area the weight, with "
        f"{100 * (1 - found.alpha):g} % confidence intervals; diamonds: averages over them; bar: where the effect in a "
        "further experiment is expected.",
        f"Forest plot of {effect.label}: {effect.conclusion}",
        lambda: draw_forest(tuple(_lines(effect)), value_label=label, average=effect.difference.random.estimate),
        is_wide=True,
    )


_FEW = 5
_PAIR = 2
_WORDS = {3: "Three", 4: "Four"}


def conclusion_of_effect(effect: CombinedEffect, measure: str, unit: str, alpha: float) -> str:
    """Return sentences on the average effect, the heterogeneity, and the effect expected in a further experiment."""
    return " ".join(_sentences(effect, measure, difference_unit(unit), alpha))


def _sentences(effect: CombinedEffect, measure: str, unit: str, alpha: float) -> Iterator[str]:
    found = effect.difference
    yield _average(effect, measure, unit)
    yield _variation(found, unit, alpha)
    if found.prediction is not None and effect.is_significant and found.prediction.low <= 0 <= found.prediction.high:
        between = _between(found.prediction, unit)
        yield f"A further experiment may find the opposite: its effect is expected between {between}."
    p_value = found.common.p_value
    if p_value is not None and effect.is_significant is not None and (p_value < alpha) is not effect.is_significant:
        before = "" if found.random.p_value == effect.adjusted_p_value else " before correction"
        verdict = f"{'is' if p_value < alpha else 'is not'} significant{before} ({p_in_words(p_value)})"
        size = with_unit(found.common.estimate, unit)
        yield f"If all experiments estimated one and the same effect, it would be {size}, which {verdict}."
    if len(effect.experiments) < _FEW:
        yield what_so_many_tell(len(effect.experiments))


def _average(effect: CombinedEffect, measure: str, unit: str) -> str:
    random, count = effect.difference.random, counted(len(effect.experiments), "experiment")
    size = with_unit(random.estimate, unit)
    if random.interval is None or random.p_value is None or effect.adjusted_p_value is None:
        return f"All {count} found the same, {size}, so that there is no variation to test against."
    between = f"{100 * random.interval.level:g} % confidence interval {_between(random.interval, unit, 'to')}"
    facts = f"({size}, {between}, {p_values_in_words(random.p_value, effect.adjusted_p_value)})"
    if effect.statement:
        verdict = "differs from zero" if effect.is_significant else "is not shown to differ from zero"
        return f'Over {count} the contrast of "{effect.statement}" {verdict} on average {facts}.'
    first, second = effect.weights
    if not effect.is_significant:
        return f"The {count} do not show that {measure} differs between {first} and {second} on average {facts}."
    direction = "higher" if random.estimate > 0 else "lower"
    return f"Over {count} the {measure} of {first} is {direction} than that of {second} on average {facts}."


def _variation(found: Combined, unit: str, alpha: float) -> str:
    told = found.heterogeneity
    share = with_unit(told.i_squared, "%", 3)
    facts = f"Q({told.freedom}) = {shown_number(told.q, 3)}, {p_in_words(told.p_value)}, I² = {share}"
    tau, low, high = (
        math.sqrt(each) for each in (told.tau_squared, told.tau_squared_interval.low, told.tau_squared_interval.high)
    )
    between = f"{shown_number(low, 3)} to {with_unit(high, unit, 3)}"
    spread = f"effects vary between experiments by a standard deviation of {with_unit(tau, unit, 3)} ({between})"
    if told.p_value < alpha:
        return f"The experiments differ by more than chance explains ({facts}): {spread}."
    return f"That they differ by more than chance explains is not shown ({facts}), nor that they agree: {spread}."


def _between(interval: Interval, unit: str, word: str = "and") -> str:
    return f"{shown_number(interval.low)} {word} {with_unit(interval.high, unit)}"


def what_so_many_tell(count: int) -> str:
    """Return a warning of what so few experiments cannot tell."""
    if count == _PAIR:
        return (
            "Two experiments do not tell how experiments vary: the interval of the average has one degree of freedom, "
            "which makes it some six times as wide as that of many, and nothing is predicted."
        )
    return f"{_WORDS[count]} experiments hardly tell how experiments vary: their standard deviation is rough."
