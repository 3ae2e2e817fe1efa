"""Figures of measures: distributions, interactions, residuals; and the section of these figures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from itertools import combinations
from typing import TYPE_CHECKING

from robot_runner.analysis.figures.distribution import (
    Group,
    draw_distribution,
    draw_proportions,
    draw_quantiles,
    draw_run_order,
)
from robot_runner.analysis.figures.effects import draw_interaction
from robot_runner.analysis.report.blocks import Block, FigureBlock, Gallery, Paragraph, Part, Section, Tone, one_word
from robot_runner.analysis.report.material import ALL_RUNS, JOINT, Material, origin_in_words
from robot_runner.analysis.report.mission_figures import mission_parts, stills_part, trajectory_part
from robot_runner.analysis.statistics.nested_factors import IDLE
from robot_runner.analysis.wording import RHO, difference_unit, shown_coefficient, shown_level, shown_number, with_unit
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.words import combination_label, counted, enumerated

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.outcome import Description, Drift, MeasureStatistics
    from robot_runner.analysis.statistics.tested import Interval

_MOST_COMBINATIONS = 16
_MOST_LINES = 8
#: The most pairs of factors to draw: 12 factors have 66, which nobody reads and which take more than a minute.
_MOST_PAIRS = 10


def quantile_figure(material: Material, measure: MeasureStatistics) -> FigureBlock | None:
    """Return the Q-Q plot of a measure's residuals, if these could be computed."""
    pairs = measure.quantiles
    if pairs is None:
        return None
    return FigureBlock(
        f"qq {measure.name}",
        f"Residuals of {measure.name} (value {material.residual_in_words(measure)}) against the normal distribution; "
        "points on the dashed line would be normal. The line goes through the quartiles.",
        f"Q-Q figure of {counted(len(pairs.observed), 'residual')} of {measure.name}.",
        lambda: draw_quantiles(
            pairs.theoretical,
            pairs.observed,
            slope=pairs.slope,
            intercept=pairs.intercept,
            value_label=material.results.label(measure.name),
        ),
    )


def drift_figure(material: Material, measure: MeasureStatistics, drift: Drift) -> FigureBlock:
    """Return the figure of a measure over the order of execution, or of the table if that is not known."""
    within = f" within {enumerated(drift.within)}" if drift.within else ""
    return FigureBlock(
        f"order {measure.name}",
        f"{measure.name} over the {material.order_of_runs}{within}: each run {material.residual_in_words(measure)}. "
        f"Dashed: slope of Theil and Sen, {with_unit(drift.slope, difference_unit(measure.unit), 3)} a run "
        f"(Spearman's {RHO} = {shown_coefficient(drift.correlation)}).",
        f"Residuals of {measure.name} over the {material.order_of_runs}.",
        lambda: draw_run_order(
            drift.places,
            drift.residuals,
            [material.labels[run_id] for run_id in drift.run_ids],
            order=material.order,
            value_label=material.results.label(measure.name),
            place_label=f"Place in the {material.order_of_runs}{within}",
            slope=drift.slope,
        ),
    )


def _distributions(material: Material, measure: MeasureStatistics) -> Iterator[FigureBlock]:
    """Yield figures of a measure's distribution, by combination or by each factor; none where no run has a number."""
    of = measure.proportions
    draw, described = (_distribution, measure.overall) if of is None else (_proportions, of.overall)
    if described is None or not described.n:
        return
    runs = material.described(measure)
    factors = tuple(name for name in material.statistics.design.factors if runs[name].nunique() > 1)
    if len(factors) > 1 and len(material.order_by(factors)) <= _MOST_COMBINATIONS:
        yield draw(material, measure, factors)
        return
    for factor in factors:
        yield draw(material, measure, (factor,))
    if not factors:
        yield draw(material, measure, ())


def _proportions(material: Material, measure: MeasureStatistics, factors: tuple[str, ...]) -> FigureBlock:
    of = measure.proportions
    assert of is not None  # noqa: S101 - a measure of yes and no has proportions
    groups = [each for each in (of.overall, *of.by_treatment, *of.by_combination) if tuple(each.treatments) == factors]
    by = f" by {JOINT.join(factors)}" if factors else ""
    described = "; ".join(f"{each.label}: {each.count} of {each.n}" for each in groups[:8])
    level = _level(each.interval for each in groups)
    bars = f", with their {level} confidence intervals" if level else ""
    return FigureBlock(
        f"distribution {one_word(measure.name)}{by}",
        f"{measure.name}{by}: how many runs say yes{bars}.{origin_in_words(measure.origin)}",
        f"Proportions of {measure.name}{by}. {described}.",
        partial(
            draw_proportions,
            groups,
            value_label=f"{measure.name} (% of runs)",
            group_label=JOINT.join(map(material.results.label, factors)),
            order=_applied_order(material, factors),
        ),
    )


def _distribution(material: Material, measure: MeasureStatistics, factors: tuple[str, ...]) -> FigureBlock:
    groups = _groups(material, measure, factors)
    outliers = frozenset(outlier.run_id for group in _descriptions(measure, factors) for outlier in group.outliers)
    by = f" by {JOINT.join(factors)}" if factors else ""
    described = "; ".join(
        f"{group.label}: mean {shown_number(group.mean)}, n = {group.size}" for group in groups[:8] if group.size
    )
    level = _level(each.mean_interval for each in _descriptions(measure, factors))
    means = f"diamond and bar: mean and its {level} confidence interval." if level else "diamond: mean."
    return FigureBlock(
        f"distribution {one_word(measure.name)}{by}",
        f"{material.results.label(measure.name)}{by}. Each point is a run; box: quartiles and median, whiskers: "
        f"Tukey's; {means}" + (" Named runs are outliers." if outliers else "") + origin_in_words(measure.origin),
        f"Distribution of {measure.name}{by}. {described}.",
        partial(
            draw_distribution,
            groups,
            value_label=material.results.label(measure.name),
            group_label=JOINT.join(map(material.results.label, factors)),
            outliers=outliers,
        ),
    )


def _descriptions(measure: MeasureStatistics, factors: tuple[str, ...]) -> tuple[Description, ...]:
    several = (*measure.by_treatment, *measure.by_combination)
    if not factors:
        return (measure.overall,) if measure.overall is not None else ()
    return tuple(group for group in several if set(group.treatments) == set(factors))


def _level(intervals: Iterable[Interval | None]) -> str:
    """Return the level of a figure's intervals, as in `95%`; empty without any."""
    return " or ".join(dict.fromkeys(shown_level(each.level) for each in intervals if each is not None))


def _groups(material: Material, measure: MeasureStatistics, factors: tuple[str, ...]) -> list[Group]:
    labels = material.labels_by(factors)
    told = _descriptions(measure, factors)
    described = {combination_label(each.treatments[name] for name in factors) or ALL_RUNS: each for each in told}
    runs = material.described(measure)
    order = _applied_order(material, factors)
    members: dict[str, list[tuple[float, str]]] = {label: [] for label in order}
    for run_id, value in zip(runs[RUN_ID].tolist(), runs[measure.name].tolist(), strict=True):
        if labels[run_id] in members:
            members[labels[run_id]].append((float(value), run_id))
    groups = []
    for label, pairs in members.items():
        description = described.get(label)
        interval = description.mean_interval if description is not None else None
        low, high = (interval.low, interval.high) if interval is not None else (None, None)
        groups.append(Group(label, tuple(value for value, _ in pairs), tuple(run for _, run in pairs), low, high))
    return groups


def _applied_order(material: Material, factors: tuple[str, ...]) -> list[str]:
    """Return the labels of all groups in order, without that of runs to which a conditional factor does not apply."""
    within = material.statistics.design.within
    return [label for label in material.order_by(factors) if label != IDLE or not within.keys() >= {*factors}]


def _interactions(material: Material, measure: MeasureStatistics) -> list[FigureBlock]:
    """Return interaction plots of a measure for pairs of factors; of many, those with the clearest interaction."""
    pairs = list(_pairs(material, measure))
    if len(pairs) > _MOST_PAIRS:
        effects = measure.test.effects if measure.test is not None else ()
        told = {frozenset(each.factors): each.p_value for each in effects if each.p_value is not None}
        clearest = sorted(pairs, key=lambda pair: told.get(frozenset(pair), 1.0))[:_MOST_PAIRS]
        pairs = [pair for pair in pairs if pair in clearest]
    return [_interaction(material, measure, *pair) for pair in pairs]


def _pairs(material: Material, measure: MeasureStatistics) -> Iterator[tuple[str, str]]:
    """Yield the pairs of factors that can be drawn; none where no run has a number."""
    if measure.overall is None or not measure.overall.n:
        return
    varied, is_full = material.statistics.design.factors, material.statistics.design.kind == "full_factorial"
    tested = {effect.factors for effect in measure.test.effects} if measure.test is not None else set()
    nested = material.statistics.design.within
    for along, across in combinations(varied, 2):
        if (along, across) not in tested and not nested.keys().isdisjoint((along, across)):
            continue  # the factors do not apply together
        if not is_full and (measure.surface is not None or (along, across) not in tested):
            continue  # the design cannot estimate the interaction, or a surface shows it
        if material.done[along].nunique() < material.done[across].nunique():
            along, across = across, along  # noqa: PLW2901 - fewer lines over more positions are easier to read
        if material.done[across].nunique() <= _MOST_LINES:
            yield along, across


def _interaction(material: Material, measure: MeasureStatistics, along: str, across: str) -> FigureBlock:
    groups = {group.label: group for group in _groups(material, measure, (along, across)) if group.size}
    treatments = _applied(material, along)
    by_second = {
        second: {first: groups[key] for first in treatments if (key := combination_label((first, second))) in groups}
        for second in _applied(material, across)
    }
    lines = {second: members for second, members in by_second.items() if members}
    effects = measure.test.effects if measure.test is not None else ()
    within = "".join(f" within {each.within}" for each in effects if each.within and {*each.factors} == {along, across})
    level = _level(each.mean_interval for each in _descriptions(measure, (along, across)))
    bars = f" Bars: {level} confidence intervals." if level else ""
    return FigureBlock(
        f"interaction {one_word(measure.name)} {one_word(along)} {one_word(across)}",
        f"Mean {material.results.label(measure.name)} of each combination of {along} and {across}{within}. Lines that "
        f"are not parallel hint at an interaction.{bars}{origin_in_words(measure.origin)}",
        f"Interaction of {along} and {across} on {measure.name}.",
        partial(
            draw_interaction,
            lines,
            treatments=treatments,
            value_label=material.results.label(measure.name),
            along=material.results.label(along),
            across=material.results.label(across),
        ),
    )


def _applied(material: Material, factor: str) -> list[str]:
    """Return the treatments of a factor, without the one for runs to which it does not apply."""
    texts = [str(each) for each in material.runs[factor].cat.categories]
    return [text for text in texts if text != IDLE or factor not in material.statistics.design.within]


def figures_section(material: Material) -> Section:
    """Return the section of figures."""
    measures = [measure for measure in material.statistics.measures if measure.name in material.drawn]
    blocks: list[Block] = [*mission_parts(material), *trajectory_part(material), *stills_part(material)]
    distributions = [each for measure in measures for each in _distributions(material, measure)]
    if distributions:
        blocks.append(Part("distributions", "Measures by treatment", (Gallery(tuple(distributions)),)))
    interactions = [each for measure in measures for each in _interactions(material, measure)]
    if interactions:
        blocks.append(Part("interactions", "Interactions of factors", (Gallery(tuple(interactions)),)))
    if any(len(list(_pairs(material, measure))) > _MOST_PAIRS for measure in measures):
        words = f"Of each measure, the {_MOST_PAIRS} pairs of factors are drawn whose interaction is clearest."
        blocks.append(Paragraph(words, Tone.NOTE))
    others = len(material.statistics.measures) - len(measures)
    if others:
        words = f"{counted(others, 'more measure')} {'is' if others == 1 else 'are'} not drawn"
        blocks.append(Paragraph(f"{words}: name those to draw by --measure.", Tone.NOTE))
    if not blocks:
        why = "no run that is done has a number" if len(material.done) else "no run is done"
        blocks.append(Paragraph(f"There is nothing to draw: {why}.", Tone.WARNING))
    return Section("figures", "Figures", tuple(blocks))
