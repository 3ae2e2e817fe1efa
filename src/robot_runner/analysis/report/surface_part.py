"""The part on a response surface: its coefficients, lack of fit, stationary point and figure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.figures.style import COLUMN, DASHED, INK, figure_style, label_axes, new_axes
from robot_runner.analysis.report.blocks import Block, FigureBlock, Paragraph, Part, Table
from robot_runner.analysis.report.tables import build_table, interval, number, p_value, text
from robot_runner.analysis.wording import (
    about_intervals,
    p_in_words,
    shown_interval,
    shown_number,
    shown_share,
    shown_test,
    with_unit,
)
from robot_runner.core.words import enumerated

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from robot_runner.analysis.report.material import Material
    from robot_runner.analysis.statistics.outcome import MeasureStatistics
    from robot_runner.analysis.statistics.surface_model import Surface

_GRID = 60
_PAIR = 2


def surface_parts(material: Material, measure: MeasureStatistics) -> Iterator[Block]:
    """Yield the part on a measure's surface, if it has one."""
    surface = measure.surface
    if surface is None:
        return
    blocks: list[Block] = [Paragraph(each) for each in surface_in_words(material, measure, surface)]
    figure = surface_figure(material, measure) if measure.name in material.drawn else None
    if figure is not None:
        blocks.append(figure)
    blocks.append(_coefficients(material, measure, surface))
    yield Part(f"surface-{measure.name}", "Response surface", tuple(blocks))


def surface_in_words(material: Material, measure: MeasureStatistics, surface: Surface) -> Iterator[str]:
    """Yield sentences on the fit of a surface and its stationary point."""
    alpha, others = material.statistics.alpha, enumerated(surface.others)
    if others:
        yield (
            f"The surface is that of the average over the treatments of {others}, which are taken to shift it as a "
            "whole: whether they change its shape or its optimum is not tested."
        )
    explained = f"The surface explains {shown_share(surface.r_squared)} of the variance"
    fit = surface.lack_of_fit
    if fit is None:
        yield f"{explained}; whether it lacks something is not known, as no combination was repeated."
    else:
        figures = f"{shown_test('F', fit.freedom, fit.f_value)}, {p_in_words(fit.p_value)}"
        verdict = (
            "it lacks something, so that its coefficients describe the measure only roughly"
            if fit.p_value < alpha
            else "repeated runs do not show that it lacks something"
        )
        yield f"{explained}; {verdict} (lack of fit: {figures})."
    point = surface.stationary
    if point is None:
        yield "It has no stationary point: it was fitted without squares, or has no curvature."
        return
    at = enumerated([f"{name} = {with_unit(value, material.results.unit(name))}" for name, value in point.at.items()])
    kind = {
        "minimum": "a minimum",
        "maximum": "a maximum",
        "saddle point": "a saddle point: it rises in one direction, and falls in another",
        "ridge": "on a ridge, or not known: the intervals of its curvatures do not all leave out 0",
    }[point.kind]
    where = "within the region that was explored" if point.is_inside else "outside the region: do not rely on it"
    curvatures = "; ".join(f"{shown_number(each)} {shown_interval(of)}" for each, of in point.curvatures)
    value = with_unit(point.value, measure.unit)
    average = f"on average over {others}, " if others else ""
    yield f"Its stationary point is {kind}. It lies at {at}, {where}; {average}{measure.name} is {value} there."
    yield f"Curvatures along its own axes, of coded factors: {curvatures}."


def _coefficients(material: Material, measure: MeasureStatistics, surface: Surface) -> Table:
    alpha = material.statistics.alpha
    fields = (
        text("Term", "label"),
        number(f"Coefficient ({measure.unit})" if measure.unit else "Coefficient", "estimate"),
        interval("CI", "interval"),
        number("t", "statistic", 3),
        p_value("p", "p_value", lambda each: bool(each.term) and each.p_value < alpha),
    )
    coding = "; ".join(f"{name}: ({name} - {middle:g}) / {half:g}" for name, (middle, half) in surface.coding.items())
    note = (
        f"{about_intervals(each.interval for each in surface.coefficients)}Of coded factors. {coding}. p-values of "
        "coefficients are not adjusted: conclusions are those of the tests."
    )
    caption = f"{material.results.label(measure.name)}: coefficients of the surface."
    return build_table(f"surface {measure.name}", caption, surface.coefficients, fields, note)


def surface_figure(material: Material, measure: MeasureStatistics) -> FigureBlock | None:
    """Return contours over the two most important factors; others are at the stationary point or in the middle."""
    surface = measure.surface
    if surface is None:
        return None
    weight = {
        name: max(abs(each.estimate) for each in surface.coefficients if name in each.term) for name in surface.coding
    }
    names = sorted(surface.coding, key=lambda name: -weight[name])[:_PAIR]
    inside = surface.stationary if surface.stationary is not None and surface.stationary.is_inside else None
    point = dict(inside.at) if inside is not None else {}
    fixed = {name: point.get(name, middle) for name, (middle, _) in surface.coding.items()}
    axes = [_axis(material, name, point.get(name)) for name in names]
    label = material.results.label(measure.name)
    others = [f"{name} = {shown_number(fixed[name])}" for name in surface.coding if name not in names]
    held = f" {enumerated(others)}." if others else ""
    if len(axes) < _PAIR:
        values = pd.to_numeric(material.done[measure.name], errors="coerce").tolist()
        heights = surface.at({names[0]: axes[0].numbers})
        kind, sign, draw = "Curve", "a dashed line", partial(draw_curve, axes[0], heights, values, label)
    else:
        along, across = np.meshgrid(axes[0].numbers, axes[1].numbers)
        everywhere = {name: np.full_like(along, value) for name, value in fixed.items()}
        heights = surface.at(everywhere | {names[0]: along, names[1]: across})
        kind, sign, draw = "Contours", "a cross", partial(draw_contours, axes[0], axes[1], heights, label)
    over = f"over {enumerated(names)}"
    average = f", on average over {enumerated(surface.others)}" if surface.others else ""
    stationary = f", {sign} the stationary point" if point else ""
    caption = f"Response surface of {label} {over}{average}; points are runs{stationary}.{held}"
    return FigureBlock(f"surface {measure.name}", caption, f"{kind} of {measure.name} {over}.", draw)


def _axis(material: Material, name: str, stationary: float | None) -> Axis:
    runs = [float(each) for each in material.done[name].astype("str")]
    return Axis(material.results.label(name), np.linspace(min(runs), max(runs), _GRID), runs, stationary)


_LEVELS = 9


class Axis(NamedTuple):
    """A factor on an axis of a surface's figure.

    Attributes:
        label: the label of the axis.
        numbers: the values at which the surface is computed, ascending.
        runs: the treatment of each run.
        stationary: the stationary point; None where it lies outside the figure.
    """

    label: str
    numbers: Floats
    runs: Sequence[float]
    stationary: float | None


@figure_style()
def draw_contours(along: Axis, across: Axis, heights: Floats, value_label: str) -> Figure:
    """Draw contour lines, the runs as points, and the stationary point as a cross."""
    figure, axes = new_axes(COLUMN, 3.0)
    filled = axes.contourf(along.numbers, across.numbers, heights, levels=_LEVELS, cmap="cividis", alpha=0.6)
    lines = axes.contour(along.numbers, across.numbers, heights, levels=filled.levels, colors=INK, linewidths=0.5)
    axes.clabel(lines, fontsize=6, fmt="%.4g")
    axes.scatter(along.runs, across.runs, s=12, facecolors="white", edgecolors=INK, linewidths=0.6, zorder=3)
    if along.stationary is not None and across.stationary is not None:
        axes.scatter([along.stationary], [across.stationary], s=40, marker="x", color=INK, zorder=4)
    figure.colorbar(filled, ax=axes, label=value_label)
    label_axes(axes, along.label, across.label, grid="both")
    return figure


@figure_style()
def draw_curve(along: Axis, heights: Floats, values: Sequence[float], value_label: str) -> Figure:
    """Draw the curve over a single factor, with the value of each run."""
    figure, axes = new_axes(COLUMN, 2.5)
    axes.plot(along.numbers, heights, color=INK)
    axes.scatter(along.runs, values, s=12, facecolors="white", edgecolors=INK, linewidths=0.6, zorder=3)
    if along.stationary is not None:
        axes.axvline(along.stationary, color=INK, linestyle=DASHED, linewidth=0.8)
    label_axes(axes, along.label, value_label, grid="both")
    return figure
