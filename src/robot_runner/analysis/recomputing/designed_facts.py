"""The facts of a special design for a recomputation: the nuisance columns and the effects of its model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.analysis.recomputing.reported import Number, Reported, attributes, ends
from robot_runner.analysis.run_frame import treatment_texts
from robot_runner.analysis.statistics.designed_columns import numbers_of_levels, residual_effects, telling_covariates
from robot_runner.core.design.analysis_plan import ORDER

if TYPE_CHECKING:
    from robot_runner.analysis.results import Results
    from robot_runner.analysis.statistics.analysed_design import MeasureData
    from robot_runner.analysis.statistics.effect_coding import Term
    from robot_runner.analysis.statistics.surface_model import Surface


@dataclass(frozen=True, slots=True)
class Before:
    """The columns that determine the previous treatment, for the carry-over in the model of a crossover.

    Attributes:
        subject, period: columns.
        periods: in their order.
    """

    subject: str
    period: str
    periods: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Designed:
    """The model of a design, for its residuals.

    Attributes:
        columns: the blocks that the model adjusts for, besides batches (`is_extended`) and whole plots (`has_plots`).
        covariates: measures, or `order`, that it adjusts for.
        before: the columns for the carry-over; None if it is not in the model.
        terms: the effects, by their factors.
        powers: for a response surface, the factors of each product.
        coding: the centre and half the range of these factors.
    """

    columns: tuple[str, ...]
    covariates: tuple[str, ...]
    is_extended: bool
    has_plots: bool
    before: Before | None
    terms: tuple[Term, ...]
    powers: tuple[Term, ...]
    coding: Mapping[str, tuple[float, float]]


@dataclass(frozen=True, slots=True)
class SurfaceFacts:
    """A response surface to recompute.

    Attributes:
        coding: the centre and half the range of each numeric factor.
        terms: of the polynomial.
        others: the factors that are not numeric.
        reported: its coefficients.
        whole: its lack of fit, its share of the variance and its stationary point.
    """

    coding: Mapping[str, tuple[float, float]]
    terms: tuple[Term, ...]
    others: tuple[str, ...]
    reported: Reported
    whole: Reported
    has_stationary: bool


def designed_facts(data: MeasureData, results: Results) -> Designed | None:
    """Return the model of a measure's design; None for a factorial, and for models that scripts do not support."""
    known, factors = data.known, data.treatments
    if known.is_plain or factors.conditions or data.lacking:
        return None
    covariates = tuple(name for name, _ in telling_covariates(data))
    if not all(name in results.measures or (name == ORDER and name not in results.runs) for name in covariates):
        return None
    effects, before = residual_effects(data), None
    if known.carry_over:
        periods = treatment_texts(results.runs[known.period]).cat.categories
        before = Before(known.subject, known.period, tuple(map(str, periods)))
    return Designed(
        columns=known.blocks,
        covariates=covariates,
        is_extended=data.is_extended,
        has_plots=bool(known.whole_plot),
        before=None if effects.before is None else before,
        terms=tuple(effects.terms),
        powers=tuple(effects.powers),
        coding={name: _ends(factors[name]) for (name, *more) in effects.powers if not more},
    )


def _ends(levels: list[str]) -> tuple[float, float]:
    numbers = numbers_of_levels(levels) or [0.0]
    return (max(numbers) + min(numbers)) / 2, (max(numbers) - min(numbers)) / 2 or 1.0


def surface_facts(surface: Surface) -> SurfaceFacts:
    """Return the facts of a response surface."""
    rows = [
        (each.label, attributes(each, "estimate") | ends(each.interval) | attributes(each, "statistic", p="p_value"))
        for each in surface.coefficients
    ]
    whole: dict[str, Number] = {"R squared": surface.r_squared}
    if (lack := surface.lack_of_fit) is not None:
        whole |= {"statistic": lack.f_value, "df": lack.freedom[0], "df 2": lack.freedom[1], "p": lack.p_value}
    if (point := surface.stationary) is not None:
        whole |= {f"at {name}": each for name, each in point.at.items()} | {"value": point.value}
        for place, (curvature, interval) in enumerate(point.curvatures, start=1):
            whole |= {f"curvature {place}": curvature, f"low {place}": interval.low, f"high {place}": interval.high}
    return SurfaceFacts(
        coding=surface.coding,
        terms=tuple(each.term for each in surface.coefficients if each.term),
        others=surface.others,
        reported=Reported.of(rows),
        whole=Reported.of([("surface", whole)]),
        has_stationary=surface.stationary is not None,
    )
