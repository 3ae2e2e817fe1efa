"""Several experiments combined: as a document with forest plots, and as JSON."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, NamedTuple

from robot_runner.analysis.comparison.combined_conclusions import difference_unit
from robot_runner.analysis.comparison.comparison_document import circumstances_table
from robot_runner.analysis.figures.forest import ForestLine, draw_forest
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
)
from robot_runner.analysis.report.document import plain
from robot_runner.analysis.report.material import origin_badges
from robot_runner.analysis.report.tables import build_table, interval, number, p_value, text
from robot_runner.analysis.wording import ALPHA, shown_interval, shown_number, with_unit
from robot_runner.core.words import counted, enumerated

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.analysis.comparison.combined import Combined, CombinedEffect, CombinedMeasure, MetaAnalysis
    from robot_runner.analysis.statistics.tested import Interval

__all__ = ["combined_document", "effect_table", "json_of_meta_analysis"]

_FORMAT = 1
_COMMON, _RANDOM, _FURTHER = "Common effect", "Average (random effects)", "A further experiment"
_MOST_CARDS = 8


def json_of_meta_analysis(found: MetaAnalysis) -> str:
    """Return a meta-analysis as JSON; what is missing, not computed or infinite is null."""
    return json.dumps({"format": _FORMAT, **plain(found)}, indent=2, ensure_ascii=False, allow_nan=False)


def combined_document(found: MetaAnalysis, *, made: str) -> Document:
    """Return a meta-analysis as a document; its figures are not drawn yet.

    Args:
        found: what was found.
        made: when and by what it is made.
    """
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
        badges = {badge.text: badge for origin in measure.origins.values() for badge in origin_badges(origin)}
        for effect in measure.effects:
            yield Paragraph(effect.conclusion, lead=f"{measure.name}, {effect.label}", badges=tuple(badges.values()))
        if not measure.effects:
            why = measure.not_computed[0].why if measure.not_computed else ""
            yield Paragraph(f"Nothing could be combined: {why}", Tone.WARNING, lead=measure.name)


def _card(measure: CombinedMeasure, effect: CombinedEffect) -> Card:
    random = None if effect.difference is None else effect.difference.random
    value = with_unit(None if random is None else random.estimate, difference_unit(measure.unit), 3)
    note = "" if random is None else shown_interval(random.interval, 3)
    tone = Tone.GOOD if effect.is_significant else Tone.NOTE
    return Card(value, f"{measure.name}: {effect.label}", note, tone)


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
            if effect.difference is not None:
                blocks.append(Gallery((_forest(found, measure, effect, effect.difference),)))
        if measure.not_computed:
            remarks = tuple(Remark(each.what, each.why, Tone.WARNING, "Note") for each in measure.not_computed)
            blocks.append(Remarks(remarks))
        yield Part(f"effects-{measure.name}", measure.label, tuple(blocks))


def _averages(found: MetaAnalysis, measure: CombinedMeasure) -> Table:
    level = f"{100 * (1 - found.alpha):g} %"
    fields = (
        text("Effect", "label"),
        number("k", lambda effect: len(effect.experiments)),
        number("Average", "difference.random.estimate"),
        interval(f"{level} CI", "difference.random.interval"),
        p_value("p", "adjusted_p_value", "is_significant"),
        number("Hedges' g", "standardised.random.estimate", 3),
        number("SD between", lambda effect: math.sqrt(effect.difference.heterogeneity.tau_squared), 3),
        number("I² (%)", "difference.heterogeneity.i_squared", 3),
        p_value("p, differ", "difference.heterogeneity.p_value"),
        interval("Further experiment", "difference.prediction"),
    )
    caption = f"{measure.label}: averages over experiments (random effects)."
    note = f"p: adjusted after Holm, {ALPHA} = {found.alpha:g}. p, differ: of no difference between experiments."
    return build_table(f"averages {measure.name}", caption, measure.effects, fields, note)


class _Line(NamedTuple):
    """A line of the table of an effect; `g` is Hedges' g."""

    label: str
    runs: int | None
    estimate: float | None
    interval: Interval | None
    p_value: float | None
    weight: float | None
    g: float | None


def _lines(effect: CombinedEffect) -> Iterator[_Line]:
    found, sizes = effect.difference, effect.standardised
    weights = [None] * len(effect.experiments) if found is None else found.random_weights
    for each, weight in zip(effect.experiments, weights, strict=True):
        yield _Line(each.experiment, each.runs, each.estimate, each.interval, each.p_value, weight, each.g)
    if found is None:
        return
    for label, which in ((_RANDOM, "random"), (_COMMON, "common")):
        pooled = getattr(found, which)
        g = None if sizes is None else getattr(sizes, which).estimate
        yield _Line(label, None, pooled.estimate, pooled.interval, pooled.p_value, None, g)
    if found.prediction is not None:
        yield _Line(_FURTHER, None, None, found.prediction, None, None, None)


def effect_table(found: MetaAnalysis, measure: CombinedMeasure, effect: CombinedEffect) -> Table:
    """Return what each experiment says of an effect, then what they say together."""
    level = f"{100 * (1 - found.alpha):g} %"
    fields = (
        text("Experiment", "label"),
        number("n", "runs"),
        number("Difference", "estimate"),
        interval(f"{level} CI", "interval"),
        p_value("p", "p_value"),
        number("Weight (%)", lambda line: None if line.weight is None else 100 * line.weight, 3),
        number("Hedges' g", "g", 3),
    )
    caption = f"{measure.label}: {effect.label}."
    note = "p-values before adjustment. Weights are those of the average."
    return build_table(f"effect {measure.name} {effect.label}", caption, tuple(_lines(effect)), fields, note)


def _forest(found: MetaAnalysis, measure: CombinedMeasure, effect: CombinedEffect, combined: Combined) -> FigureBlock:
    lines = [
        ForestLine(
            line.label,
            line.estimate,
            line.interval,
            line.weight,
            f"{'' if line.estimate is None else shown_number(line.estimate)} {shown_interval(line.interval)}".strip(),
        )
        for line in _lines(effect)
    ]
    unit = difference_unit(measure.unit)
    label = f"Difference of {measure.name}" + (f" ({unit})" if unit not in {"", "1"} else "")
    return FigureBlock(
        f"forest {measure.name} {effect.label}",
        f"{measure.label}: {effect.label}. Squares: experiments, their area the weight, with "
        f"{100 * (1 - found.alpha):g} % confidence intervals; diamonds: averages over them; bar: where the effect in a "
        "further experiment is expected.",
        f"Forest plot of {effect.label}: {effect.conclusion}",
        lambda: draw_forest(lines, value_label=label, average=combined.random.estimate),
        is_wide=True,
    )
