"""The models of special designs: fractions, squares, crossovers, split plots, response surfaces.

The design determines the model, never the values. Full factorials and complete blocks are in `tests`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.analysis.statistics.analysed_design import BATCH, VALUE, MeasureData, covariate_column
from robot_runner.analysis.statistics.cell_layout import MOST_FACTORS, listed_layout, relative_ranks
from robot_runner.analysis.statistics.cell_means import CellMeans
from robot_runner.analysis.statistics.cell_moments import averaged_out
from robot_runner.analysis.statistics.designed_columns import block_columns, carried_over, numbers_of_levels
from robot_runner.analysis.statistics.effect_coding import Factors, Term, coded_columns
from robot_runner.analysis.statistics.known_design import role_column
from robot_runner.analysis.statistics.lenth_test import LenthModel, fit_lenth
from robot_runner.analysis.statistics.nested_factors import codes_of
from robot_runner.analysis.statistics.strata_model import Hypothesis, StrataModel, fit_strata
from robot_runner.analysis.statistics.surface_model import SurfaceModel, fit_surface
from robot_runner.analysis.statistics.tested import NotComputed, NoVariation, TestMethod
from robot_runner.analysis.wording import p_in_words, shown_test
from robot_runner.core.design.analysis_plan import Estimand, Statistic
from robot_runner.core.words import enumerated

#: The models of special designs, besides the means of combinations.
DesignedModel = StrataModel | LenthModel | SurfaceModel

_ONE_VARIANCE = "One variance serves all runs."


def designed_model_of(
    data: MeasureData, estimand: Estimand, statistic: Statistic, values: Floats | None = None
) -> CellMeans | DesignedModel | NotComputed | None:
    """Return the model that the design of a measure requires; None for full factorials and complete blocks.

    Args:
        data: the measure.
        estimand: of the plan.
        statistic: which tests several contrasts at once.
        values: replace those of the measure, (..., runs): for many simulated experiments at once.
    """
    if data.known.is_plain:
        return None
    if estimand is Estimand.TRIMMED_MEAN:
        return NotComputed("the test", "trimmed means are compared of runs of a full factorial without blocks.")
    values = data.values if values is None else values  # noqa: PD011 - no data frame
    if estimand is Estimand.RANK:
        values = relative_ranks(values, data.batches if data.is_extended else None)
    unit = _units(data)
    if unit is None:
        return _Fitting(data, values).model(estimand, statistic)
    model = _Fitting(*_averaged(data, values, unit)).model(estimand, statistic)
    return replace(model, averaged_out=averaged_out(values, unit)) if isinstance(model, StrataModel) else model


def _units(data: MeasureData) -> Numbers | None:
    """Return the combination within its blocks of each run; None if each has one run, or there are no blocks."""
    if not data.known.columns:
        return None
    names = [*data.factors, *map(role_column, data.known.columns), *([BATCH] if data.is_extended else [])]
    unit = data.frame.groupby(names, observed=True, sort=False).ngroup().to_numpy()
    return None if int(unit.max()) + 1 == len(unit) else np.asarray(unit, dtype=np.intp)


def _averaged(data: MeasureData, values: Floats, unit: Numbers) -> tuple[MeasureData, Floats]:
    """Return one row for each combination within its blocks: repeated runs are reduced to their mean.

    Such runs are not independent: they share the response of the block to the treatment.
    """
    belongs = np.eye(int(unit.max()) + 1)[unit]
    belongs /= belongs.sum(axis=0)
    frame = data.frame.iloc[np.unique(unit, return_index=True)[1]].reset_index(drop=True)
    told = {covariate_column(name): data.covariate(name) @ belongs for name in data.covariates}
    means = values @ belongs
    own = {VALUE: means} if means.ndim == 1 else {}
    return replace(data, frame=frame.assign(**told, **own)), means


@dataclass(frozen=True)
class _Fitting:
    """The fit of one measure, with the parts that its models share."""

    data: MeasureData
    values: Floats

    def model(self, estimand: Estimand, statistic: Statistic) -> CellMeans | DesignedModel | NotComputed | None:
        known = self.data.known
        problem = self._problem
        if problem:
            return NotComputed("the test", problem)
        if known.is_surface:
            return self._surface()
        if known.whole_plot:
            return self._split_plot()
        if not known.columns and not self.data.is_extended and not self.data.covariates:
            layout = listed_layout(self.factors, self._codes, self._terms)
            if layout is not None:
                draws = {} if self.values.ndim == 1 else {"draws": 499}
                found = CellMeans.of_values(layout, self.values, estimand, statistic, **draws)
                return found if found.has_variation else _NO_VARIATION
            single = fit_lenth(self.factors, self._codes, self._terms, self.values)
            if single is not None:
                return single
        return self._beside_blocks()

    @property
    def _problem(self) -> str:
        """Why factors cannot be tested in this design; empty if they can."""
        known = self.data.known
        if self.factors.conditions and (known.is_surface or known.is_one_at_a_time):
            names = enumerated(list(self.factors.conditions))
            one, other = ("applies", "it") if len(self.factors.conditions) == 1 else ("apply", "them")
            why = f"{names} {one} to some runs only, which a design of this kind ({known.in_words}) does not allow for."
            return f"{why} A full factorial or DOptimal can test {other}."
        told = {*known.terms, *(term for several in known.aliases.values() for term in several)}
        mixed = [] if known.is_surface else [name for name in self.factors if told and (name,) not in told]
        if not mixed:
            return ""
        # A model without them would attribute their effects to the factors that they are confounded with.
        alike = "cannot be told apart from what other factors do: in part they change together."
        fix = "More combinations would tell, or one factor in place of those that change together."
        return f"what {enumerated(mixed)} does {alike} {fix}"

    @cached_property
    def factors(self) -> Factors:
        return self.data.treatments

    @cached_property
    def _codes(self) -> dict[str, Numbers]:
        return codes_of(self.data.frame, self.factors)

    @property
    def _terms(self) -> tuple[Term, ...]:
        """The effects that the planned combinations can estimate, of factors that still vary."""
        known = self.data.known
        if known.terms:
            return tuple(term for term in known.terms if set(term) <= set(self.factors))
        return self.factors.terms(MOST_FACTORS)

    def _hypotheses(self, terms: tuple[Term, ...]) -> dict[Term, Hypothesis]:
        return {
            term: Hypothesis(columns, self.factors.squares(term))
            for term, columns in self.factors.columns(self._codes, terms).items()
        }

    @cached_property
    def _blocks(self) -> Floats:
        """The nuisance columns: blocks, batches and covariates."""
        parts = [block_columns(self.data, name) for name in self.data.known.blocks]
        if self.data.is_extended:
            parts.append(pd.get_dummies(self.data.batches, dtype=np.float64).to_numpy())
        for name in self.data.covariates:
            covariate = self.data.covariate(name)
            if np.isfinite(covariate).all() and np.ptp(covariate) > 0:
                parts.append(((covariate - covariate.mean()) / covariate.std())[:, None])
        return np.column_stack(parts) if parts else np.empty((len(self.data.frame), 0))

    def _beside_blocks(self) -> StrataModel | NotComputed | None:
        """Fit effects and blocks; interactions are left out if runs are too few."""
        known = self.data.known
        rank = int(np.linalg.matrix_rank(np.column_stack([np.ones(len(self.data.frame)), self._blocks])))
        terms, notes = self._terms, []
        if len(self.data.frame) - rank - sum(map(self.factors.size, terms)) < 1:
            terms = tuple(term for term in terms if len(term) == 1)
            notes.append("Interactions cannot be estimated: there are too few runs.")
        blocks = self._blocks
        if known.period:
            before = self._carried_over(blocks)
            if before is None:
                notes.append(
                    "What is carried over from the treatment before cannot be told apart from subjects or periods: the "
                    "test takes it to be washed out."
                )
            else:
                notes.append(self._carry_over_in_words(before, blocks, terms))
                blocks = np.column_stack([blocks, before]) if known.carry_over else blocks
        if len(self.data.frame) < len(self.data.every.dropna(subset=[VALUE])) and known.columns:
            notes.append("Runs of one combination in the same blocks are reduced to their mean.")
        told = (TestMethod.CROSSOVER if known.period else self._method, self._reason, tuple(notes))
        return fit_strata(self.factors, self._hypotheses(terms), self.values, blocks, None, told)

    @property
    def _method(self) -> TestMethod:
        return TestMethod.ADJUSTED_FOR_BLOCKS if self.data.known.columns else TestMethod.LINEAR_MODEL

    @property
    def _reason(self) -> str:
        known = self.data.known
        adjusted = f", adjusted for {enumerated(self.data.covariates)}" if self.data.covariates else ""
        if known.period:
            carried = ["the treatment before"] if known.carry_over else []
            others = enumerated([known.subject, known.period, *carried, *self.data.covariates])
            return f"Each subject has several treatments: means are compared, adjusted for {others}. {_ONE_VARIANCE}"
        if known.columns:
            others = enumerated([*known.blocks, *self.data.covariates])
            return f"Means are compared, adjusted for {others}. {_ONE_VARIANCE}"
        single = self.data.frame.groupby(list(self.factors), observed=True).size().min() == 1
        effects = "Some combinations have a single run: main effects" if single else "Main effects"
        return f"{effects} and what else the combinations tell are compared{adjusted}. {_ONE_VARIANCE}"

    # Crossover.

    def _carried_over(self, blocks: Floats) -> Floats | None:
        """Return the columns of carry-over; None if it is not estimable."""
        main = [each.columns for each in self._hypotheses(tuple((name,) for name in self.factors)).values()]
        return carried_over(self.data.frame, self.factors, np.column_stack([np.ones(len(blocks)), blocks, *main]))

    def _carry_over_in_words(self, before: Floats, blocks: Floats, terms: tuple[Term, ...]) -> str:
        """Return a sentence with the test of the carry-over; nothing is chosen by it."""
        known, values = self.data.known, np.atleast_2d(self.values)[0]
        count = before.shape[1]
        treatments = np.column_stack([each.columns for each in self._hypotheses(terms).values()])
        spread: dict[Term, Hypothesis] = {("before",): Hypothesis(before, np.eye(count))}
        told: tuple[TestMethod, str, tuple[str, ...]] = (TestMethod.CROSSOVER, "", ())
        found = fit_strata(self.factors, spread, values, np.column_stack([blocks, treatments]), None, told)
        what = "it is in the model" if known.carry_over else "a washout was planned, and it is not in the model"
        if not isinstance(found, StrataModel):
            return f"What is carried over from the treatment before could not be tested; {what}."
        (effect,) = found.effects()
        figures = f"{shown_test('F', (count, effect.freedom[1]), float(effect.statistic))}, "
        figures += p_in_words(float(effect.p_value))
        return f"Carried over from the treatment before: {figures}; {what}, whatever this says."

    # Split plot.

    def _split_plot(self) -> StrataModel | NotComputed | None:
        """Fit both strata; None if whole plots are unequal, where a mixed model is fitted instead."""
        plots = self.data.plots
        terms = self._terms
        reason = (
            f"Some factors change from one {self.data.known.whole_plot} to the next only: they are compared with how "
            "these vary, and the others with how runs vary within them. One variance serves each stratum."
        )
        told: tuple[TestMethod, str, tuple[str, ...]] = (TestMethod.SPLIT_PLOT, reason, ())
        found = fit_strata(self.factors, self._hypotheses(terms), self.values, self._blocks, plots, told)
        if isinstance(found, NotComputed):
            main = tuple(term for term in terms if len(term) == 1)
            told = (TestMethod.SPLIT_PLOT, reason, ("Interactions cannot be estimated: there are too few runs.",))
            found = fit_strata(self.factors, self._hypotheses(main), self.values, self._blocks, plots, told)
        return found

    # Response surface.

    def _surface(self) -> SurfaceModel | NotComputed:
        numeric = {name: levels for name, levels in self.factors.items() if numbers_of_levels(levels) is not None}
        sizes = {name: len(levels) for name, levels in self.factors.items()}
        others = {name: coded_columns(self._codes, sizes, (name,)) for name in self.factors if name not in numeric}
        if not numeric:
            return NotComputed("the test", "no factor is a number, so that there is no surface.")
        levels = {name: self.data.frame[name].astype(str).tolist() for name in numeric}
        return fit_surface(self.factors, levels, others, self._blocks, self.values, self.data.known.coding)


_NO_VARIATION = NoVariation(
    "the test", "within each combination all values are equal, so that there is no variation to test against."
)


def note_on_responses(data: MeasureData) -> Iterator[str]:
    """Yield a note that blocks are taken to respond alike, where two factors and more vary within them.

    A single variance then serves effects to which blocks may respond differently. By simulation of crossovers, squares
    and split plots with two factors within 4 to 24 units.
    """
    units = pd.Series(data.unit_names, index=data.frame.index)
    within = [name for name in data.factors if data.frame[name].astype(str).groupby(units).nunique().max() > 1]
    if (data.known.columns or data.is_blocked) and len(within) > 1:
        names = enumerated(data.known.unit_columns or [data.block or "block"])
        yield (
            f"Each {names} is taken to respond alike to {enumerated(within)}, as one variance serves their effects. "
            "Where each responds differently to one factor, by as much as runs vary, its effect is found by chance in "
            "14 % instead of 5 %, where by twice as much in 20 %, and other effects are hardly found."
        )
