"""How units (subjects, whole plots, blocks) respond to the factors that differ within them, if their runs tell."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.analysis.statistics.analysed_design import MeasureData
from robot_runner.analysis.statistics.effect_coding import Factors
from robot_runner.analysis.statistics.grouped_runs import numbered
from robot_runner.analysis.statistics.known_design import role_column
from robot_runner.analysis.statistics.nested_factors import codes_of
from robot_runner.analysis.statistics.strata_model import StrataModel
from robot_runner.core.words import enumerated

if TYPE_CHECKING:
    from numpy.typing import NDArray

_PAIR = 2


def note_on_responses(data: MeasureData, model: object) -> Iterator[str]:
    """Yield a note that blocks are taken to respond alike, where two factors and more vary within them.

    So it is of one factor that a subject has in several periods. A single variance then serves effects to which blocks
    may respond differently. By simulation of crossovers, squares and split plots with two factors within 4 to 24 units.
    """
    within = within_units(data, data.unit_names)
    is_told = isinstance(model, StrataModel) and model.is_of_units
    units = UnitRuns.of_data(data)
    several = len(within) > 1 or (units is not None and units.are_repeated)
    if (data.known.columns or data.is_blocked) and several and not is_told:
        names, factors = enumerated(data.known.unit_columns or [data.block or "block"]), enumerated(within)
        yield (
            f"Each {names} is taken to respond alike to {factors}, as one variance serves their effects: these runs "
            "do not tell how each responds. Where each responds differently to one factor, by as much as runs vary, "
            "its effect is found by chance in 14 % instead of 5 %, where by twice as much in 20 %, and other effects "
            "are hardly found; more often where each has a combination in several runs."
        )


def within_units(data: MeasureData, units: Sequence[object]) -> tuple[str, ...]:
    """Return the factors that differ within units."""
    unit = pd.Series(units, index=data.frame.index)
    return tuple(name for name in data.factors if data.frame[name].astype(str).groupby(unit).nunique().max() > 1)


class UnitRuns(NamedTuple):
    """The runs of units (subjects, whole plots, blocks) that have combinations of factors within them.

    Attributes:
        unit: of each run.
        factors: those that differ within units.
        cell: the combination of these, of each run.
        held: the number of runs of each combination in each unit, (units, combinations).
        are_repeated: whether a unit has a combination in several periods.
    """

    unit: Numbers
    factors: Factors
    cell: Numbers
    held: Numbers
    are_repeated: bool

    @property
    def are_complete(self) -> NDArray[np.bool_]:
        """Whether each unit has each combination."""
        return np.asarray(self.held.min(axis=1) > 0)

    @classmethod
    def of_data(cls, data: MeasureData) -> UnitRuns | None:
        """Return the units of a measure; None without units, and where they tell nothing of their responses.

        They tell nothing of two treatments that each has once, which are compared with the variation within units
        anyway, nor where other blocks than periods cross them, such as columns of a square, which may respond
        differently as well.
        """
        known, treatments = data.known, data.treatments
        if not known.unit_columns or treatments.conditions:
            return None
        unit = numbered(data.frame, list(map(role_column, known.unit_columns)))
        others = [role_column(name) for name in known.blocks if name not in {*known.unit_columns, known.period}]
        if any(data.frame[name].groupby(unit, observed=True).nunique().max() > 1 for name in others):
            return None
        factors = treatments.only(within_units(data, list(unit)))
        if not factors or factors.count > len(unit):
            return None
        shape = (int(unit.max()) + 1, factors.count)
        cell = factors.numbers(codes_of(data.frame, factors))
        periods = data.frame[role_column(known.period)] if known.period else pd.Series(unit)
        are_repeated = bool(periods.groupby([unit, cell], observed=True).nunique().max() > 1)
        if factors.count == _PAIR and not are_repeated:
            return None
        held = np.bincount(unit * shape[1] + cell, minlength=shape[0] * shape[1]).reshape(shape)
        return cls(unit, factors, cell, held, are_repeated)


def responses_of(data: MeasureData) -> tuple[Floats, ...]:
    """Return the contrasts that tell how each unit responds to factors that differ within units.

    Returns:
        (units, contrasts, runs), orthonormal, for each of these factors and interactions; empty where units do not tell
        it, and where one lacks a combination.
    """
    found = UnitRuns.of_data(data)
    if found is None or np.any(found.held != 1):
        return ()
    belongs = np.eye(len(found.held))[found.unit]
    terms = found.factors.terms(len(found.factors))
    return tuple(np.einsum("ru,dr->udr", belongs, found.factors.contrasts(term)[:, found.cell]) for term in terms)
