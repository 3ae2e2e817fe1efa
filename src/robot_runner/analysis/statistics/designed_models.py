"""The models of special designs: fractions, squares, crossovers, split plots, response surfaces.

The design determines the model, never the values. Full factorials and complete blocks are in `tests`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.analysis.statistics.analysed_design import BATCH, VALUE, MeasureData, covariate_column
from robot_runner.analysis.statistics.cell_layout import COMPLETE, MOST_FACTORS, listed_layout, relative_ranks
from robot_runner.analysis.statistics.cell_means import CellMeans
from robot_runner.analysis.statistics.cell_moments import averaged_out
from robot_runner.analysis.statistics.designed_columns import (
    block_columns,
    carried_over,
    numbers_of_levels,
    telling_covariates,
)
from robot_runner.analysis.statistics.effect_coding import Factors, Term, coded_columns
from robot_runner.analysis.statistics.grouped_runs import numbered
from robot_runner.analysis.statistics.known_design import role_column
from robot_runner.analysis.statistics.lenth_test import LenthModel, fit_lenth
from robot_runner.analysis.statistics.nested_factors import codes_of
from robot_runner.analysis.statistics.strata_model import Hypothesis, StrataModel, fit_strata
from robot_runner.analysis.statistics.surface_model import SurfaceModel, fit_surface
from robot_runner.analysis.statistics.tested import NotComputed, NoVariation, TestMethod
from robot_runner.analysis.statistics.unit_responses import UnitRuns, responses_of
from robot_runner.analysis.wording import listed, p_in_words, shown_test
from robot_runner.core.design.analysis_plan import Estimand, Statistic
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.words import enumerated

#: The models of special designs, besides the means of combinations.
DesignedModel = StrataModel | LenthModel | SurfaceModel

_ONE_VARIANCE = "One variance serves all runs."

_NO_INTERACTIONS = "Interactions cannot be estimated: there are too few runs."
_BLOCKS = "blocks"


def designed_model_of(
    data: MeasureData, estimand: Estimand, statistic: Statistic, values: Floats | None = None
) -> CellMeans | DesignedModel | NotComputed | None:
    """Return the model that the design of a measure requires; None for full factorials and complete blocks.

    `values` replace those of the measure, (..., runs), for many simulated experiments at once.
    """
    if data.known.is_plain:
        return None
    if estimand is Estimand.TRIMMED_MEAN:
        return NotComputed("the test", "trimmed means are compared of runs of a full factorial without blocks.")
    values = data.values if values is None else values  # noqa: PD011 - no data frame
    return _fitted_by_units(data, values, estimand, statistic) or _fitted(
        data, values, _units(data), estimand, statistic
    )


def _fitted_by_units(data: MeasureData, values: Floats, estimand: Estimand, statistic: Statistic) -> StrataModel | None:
    """Return the model of the mean of each combination in each unit; None where these do not tell how units respond."""
    units = UnitRuns.of_data(data)
    if units is None or units.are_complete.mean() < COMPLETE:
        return None
    kept = units.are_complete[units.unit]
    runs, names = data.frame[RUN_ID][~kept], enumerated(data.known.unit_columns)
    every = data.every[~data.every[RUN_ID].isin(set(runs))]
    left = replace(data, frame=data.frame[kept].reset_index(drop=True), every=every)
    if left.treatments != data.treatments:
        return None
    _, unit = np.unique(units.unit[kept] * units.factors.count + units.cell[kept], return_inverse=True)
    found = _fitted(left, values[..., kept], unit, estimand, statistic, names)
    is_trials = len(units.factors) == 1 and units.are_repeated
    if not isinstance(found, StrataModel) or not (found.has_responses or is_trials):
        return None
    notes = [f"Not each {names} has all combinations, so these runs are left out of the tests: {listed(runs)}."]
    out = tuple(map(int, np.flatnonzero(~kept)))
    return replace(found, left_out=out, notes=(*found.notes, *(notes if out else [])), is_of_units=True)


def _fitted(
    data: MeasureData,
    values: Floats,
    unit: Numbers | None,
    estimand: Estimand,
    statistic: Statistic,
    within: str = _BLOCKS,
) -> CellMeans | DesignedModel | NotComputed | None:
    """Return the model of means of runs.

    `unit` is the mean that each run belongs to; None if each run is one. For `within`, see `_Fitting`.
    """
    if estimand is Estimand.RANK:
        values = relative_ranks(values, data.batches if data.is_extended else None)
    if unit is None or int(unit.max()) + 1 == len(unit):
        return _Fitting(data, values, data).model(estimand, statistic)
    model = replace(_averaged(data, values, unit), within=within).model(estimand, statistic)
    if not isinstance(model, StrataModel):
        return model
    periods = numbered(data.frame, [role_column(data.known.period)]) if data.known.period else None
    return replace(model, averaged_out=averaged_out(values, unit, batches=periods))


def _units(data: MeasureData) -> Numbers | None:
    """Return the combination within its blocks of each run; None without blocks."""
    if not data.known.columns:
        return None
    names = [*data.factors, *map(role_column, data.known.columns), *([BATCH] if data.is_extended else [])]
    return np.asarray(data.frame.groupby(names, observed=True, sort=False).ngroup(), dtype=np.intp)


def _averaged(data: MeasureData, values: Floats, unit: Numbers) -> _Fitting:
    """Return the fit of one row for each combination within its blocks or unit: its runs are reduced to their mean.

    Such runs are not independent: they share the response of the block to the treatment.
    """
    belongs = np.eye(int(unit.max()) + 1)[unit]
    belongs /= belongs.sum(axis=0)
    frame = data.frame.iloc[np.unique(unit, return_index=True)[1]].reset_index(drop=True)
    told = {covariate_column(name): data.covariate(name) @ belongs for name in data.covariates}
    means = values @ belongs
    own = {VALUE: means} if means.ndim == 1 else {}
    return _Fitting(replace(data, frame=frame.assign(**told, **own)), means, data, belongs)


@dataclass(frozen=True)
class _Fitting:
    """The fit of one measure, with the parts that its models share.

    Attributes:
        data: one row for each mean of runs.
        values: these means.
        runs: one row for each run.
        belongs: the weight of each run in each mean, (runs, means); None if each run is one.
        within: what the runs of a mean have in common besides their treatments, in words.
    """

    data: MeasureData
    values: Floats
    runs: MeasureData
    belongs: Floats | None = None
    within: str = _BLOCKS

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
                return found if np.all(found.has_variation) else _NO_VARIATION
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
        parts = [self._mean_of(block_columns(self.runs, name)) for name in self.data.known.blocks]
        if self.data.is_extended:
            parts.append(self._mean_of(pd.get_dummies(self.runs.batches, dtype=np.float64).to_numpy()))
        parts += [((each - each.mean()) / each.std())[:, None] for _, each in telling_covariates(self.data)]
        return np.column_stack(parts) if parts else np.empty((len(self.data.frame), 0))

    def _mean_of(self, columns: Floats) -> Floats:
        return columns if self.belongs is None else self.belongs.T @ columns

    def _beside_blocks(self) -> StrataModel | NotComputed | None:
        """Fit effects and blocks; interactions are left out if runs are too few."""
        known = self.data.known
        rank = int(np.linalg.matrix_rank(np.column_stack([np.ones(len(self.data.frame)), self._blocks])))
        terms, notes = self._terms, []
        if len(self.data.frame) - rank - sum(map(self.factors.size, terms)) < 1:
            terms = tuple(term for term in terms if len(term) == 1)
            notes.append(_NO_INTERACTIONS)
        blocks, responses, is_carried = self._blocks, responses_of(self.data), False
        if known.period:
            before = self._carried_over(blocks)
            if before is None and known.carry_over and self.within != _BLOCKS:
                return NotComputed("the test", "means of units do not tell what is carried over, and runs may.")
            if before is None:
                notes.append(
                    "What is carried over from the treatment before cannot be told apart from subjects or periods: the "
                    "test takes it to be washed out."
                )
            else:
                notes.append(self._carry_over_in_words(before, blocks, terms, responses))
                is_carried = known.carry_over
                blocks = np.column_stack([blocks, before]) if is_carried else blocks
        if len(self.data.frame) < len(self.data.every.dropna(subset=[VALUE])) and known.columns:
            notes.append(f"Runs of one combination in the same {self.within} are reduced to their mean.")
        method = TestMethod.CROSSOVER if known.period else self._method
        told = (method, self._reason(is_carried=is_carried), tuple(notes))
        found = fit_strata(self.factors, self._hypotheses(terms), self.values, blocks, None, told, responses)
        return self._compared(found, _ONE_VARIANCE, "Each effect is compared")

    def _compared(
        self, found: StrataModel | NotComputed | None, runs: str, responses: str
    ) -> StrataModel | NotComputed | None:
        """Return a model whose reason says what effects within units are compared with.

        The reason ends with `runs` where this is the variation of runs, and with what begins with `responses` where it
        is how units vary in their response to each effect.
        """
        if not isinstance(found, StrataModel):
            return found
        if found.has_responses or self.within != _BLOCKS:
            runs = f"{responses} with how it differs from one {enumerated(self.data.known.unit_columns)} to the next."
            if any(each.contrasts > 1 for each in found.fits[-1].responses):
                runs += " Degrees of freedom are those of Huynh and Feldt, or for few of Geisser and Greenhouse."
        return replace(found, reason=f"{found.reason} {runs}")

    @property
    def _method(self) -> TestMethod:
        return TestMethod.ADJUSTED_FOR_BLOCKS if self.data.known.columns else TestMethod.LINEAR_MODEL

    def _reason(self, *, is_carried: bool) -> str:
        known = self.data.known
        adjusted = f", adjusted for {enumerated(self.data.covariates)}" if self.data.covariates else ""
        if known.period:
            carried = ["the treatment before"] if is_carried else []
            others = enumerated([known.subject, known.period, *carried, *self.data.covariates])
            return f"Each subject has several treatments: means are compared, adjusted for {others}."
        if known.columns:
            others = enumerated([*known.blocks, *self.data.covariates])
            return f"Means are compared, adjusted for {others}."
        single = self.data.frame.groupby(list(self.factors), observed=True).size().min() == 1
        effects = "Some combinations have a single run: main effects" if single else "Main effects"
        return f"{effects} and what else the combinations tell are compared{adjusted}."

    # Crossover.

    def _carried_over(self, blocks: Floats) -> Floats | None:
        main = [each.columns for each in self._hypotheses(tuple((name,) for name in self.factors)).values()]
        beside = np.column_stack([np.ones(len(blocks)), blocks, *main])
        return carried_over(self.runs.frame, self.factors, beside, self._mean_of)

    def _carry_over_in_words(
        self, before: Floats, blocks: Floats, terms: tuple[Term, ...], responses: Sequence[Floats]
    ) -> str:
        """Return a sentence with the test of the carry-over; nothing is chosen by it."""
        known, values = self.data.known, np.atleast_2d(self.values)[0]
        count = before.shape[1]
        treatments = np.column_stack([each.columns for each in self._hypotheses(terms).values()])
        spread: dict[Term, Hypothesis] = {("before",): Hypothesis(before, np.eye(count))}
        told: tuple[TestMethod, str, tuple[str, ...]] = (TestMethod.CROSSOVER, "", ())
        found = fit_strata(self.factors, spread, values, np.column_stack([blocks, treatments]), None, told, responses)
        what = "it is in the model" if known.carry_over else "a washout was planned, and it is not in the model"
        if not isinstance(found, StrataModel):
            return f"What is carried over from the treatment before could not be tested; {what}."
        (effect,) = found.effects()
        figures = f"{shown_test('F', tuple(map(float, effect.freedom)), float(effect.statistic))}, "
        figures += p_in_words(float(effect.p_value))
        return f"Carried over from the treatment before: {figures}; {what}, whatever this says."

    # Split plot.

    def _split_plot(self) -> StrataModel | NotComputed | None:
        """Fit both strata; None if whole plots are unequal, where a mixed model is fitted instead."""
        reason = (
            f"Some factors change from one {self.data.known.whole_plot} to the next only: they are compared with how "
            "these vary."
        )
        plots, responses = self.data.plots, responses_of(self.data)

        def fitted(terms: tuple[Term, ...], *notes: str) -> StrataModel | NotComputed | None:
            effects, told = self._hypotheses(terms), (TestMethod.SPLIT_PLOT, reason, notes)
            return fit_strata(self.factors, effects, self.values, self._blocks, plots, told, responses)

        found = fitted(self._terms)
        if isinstance(found, NotComputed):
            found = fitted(tuple(term for term in self._terms if len(term) == 1), _NO_INTERACTIONS)
        runs = "The others are compared with how runs vary within them. One variance serves each stratum."
        return self._compared(found, runs, "Each other effect is compared")

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
