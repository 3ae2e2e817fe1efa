"""The power of the report's procedure: thousands of experiments are simulated and analysed at once.

The tests, their families and corrections are those of `analyse`: the same functions are called with the values of many
experiments. Descriptions, figures and sentences are left out, so that it takes a thousandth of the time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from robot_runner.analysis.arrays import Floats, Numbers
from robot_runner.analysis.planning.answer_tests import ExactTests, answer_model_of
from robot_runner.analysis.statistics.analysed_design import Design, MeasureData, design_of
from robot_runner.analysis.statistics.batch_strata import comparable
from robot_runner.analysis.statistics.cell_means import CellMeans
from robot_runner.analysis.statistics.descriptive import quiet
from robot_runner.analysis.statistics.designed_models import designed_model_of
from robot_runner.analysis.statistics.families import Key, claim_of, contrast_key, contrasts_of, effect_key, families_of
from robot_runner.analysis.statistics.left_out import left_out_of
from robot_runner.analysis.statistics.lenth_test import LenthModel
from robot_runner.analysis.statistics.post_hoc import adjusted, contrast_of, p_value_of_contrast
from robot_runner.analysis.statistics.strata_model import StrataModel
from robot_runner.analysis.statistics.surface_model import SurfaceModel
from robot_runner.analysis.statistics.tested import NotComputed, named_within
from robot_runner.analysis.statistics.tests import AnyModel, Choices, planned_model_of
from robot_runner.core.design.analysis_plan import Estimand
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.errors import AnalysisError
from robot_runner.core.words import counted, enumerated

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from robot_runner.analysis.planning.assumed_values import AssumedMeasure, Scenario
    from robot_runner.analysis.planning.planned_study import Cell, Study

#: The number of experiments that are drawn and analysed together, so that counts do not depend on the batch size.
AT_ONCE = 500

#: The fewest draws of bootstrapped and permuted tests: over many experiments, the error of a p-value averages out.
_DRAWS = 499
#: How many times finer than the smallest level p-values are: none is below 1 / (draws + 1).
_FINER = 10


class Claim(NamedTuple):
    """A tested claim: an effect or a hypothesis.

    Attributes:
        key: its key in families of tests.
    """

    key: Key
    label: str
    measure: str
    is_hypothesis: bool


@dataclass(frozen=True, slots=True)
class _Prepared:
    """A measure that is ready for simulation.

    Attributes:
        rows: the indices of the compared runs.
        blocks: the block of each run.
        data: of one example experiment.
        model: of its values.
        every: the same experiment, with the runs that are not compared within batches.
    """

    assumed: AssumedMeasure
    rows: Numbers
    blocks: tuple[str, ...]
    data: MeasureData
    model: AnyModel | ExactTests
    every: MeasureData

    @property
    def effects(self) -> tuple[tuple[str, ...], ...]:
        """The factors of each tested effect."""
        if isinstance(self.model, ExactTests):
            return self.model.effects
        return tuple(test.factors for test in self.model.effects())


class Simulation:
    """Simulated experiments for a number of repetitions and a scenario.

    Attributes:
        is_slow: whether models are fitted one experiment at a time.

    Raises:
        AnalysisError: no test is possible for so few runs.
    """

    def __init__(
        self, study: Study, scenario: Scenario, repetitions: int, *, seed: Sequence[int], first_batch: int | None = None
    ) -> None:
        self._study, self._plan = study, study.plan
        self._repetitions, self._first_batch = repetitions, first_batch
        self._seed = (*seed, repetitions)
        self._cells: tuple[Cell, ...] = tuple(study.cells[place] for place in study.cells_of(repetitions))
        self._choices = Choices()
        if plan := study.plan:
            self._choices = Choices(plan.alpha, plan.correction, plan.estimand, plan.statistic)
        self._measures = self._prepared(scenario)
        self.is_slow = not all(map(self._is_fast, self._measures))

    def _prepared(self, scenario: Scenario) -> list[_Prepared]:
        random = np.random.default_rng(self._seed)
        design = self._design({each.name: random.normal(size=len(self._cells)) for each in scenario.measures}, random)
        prepared = []
        for assumed in scenario.measures:
            every = _drawn(design, assumed.name)
            blocks = tuple(every.unit_names)
            data, model = self._analysed(design, assumed)
            if isinstance(model, NotComputed):
                many = counted(self._repetitions, "repetition")
                problem = f"with {many} nothing can be tested of {assumed.name}: {model.why}"
                fix = "Give more repetitions: --repetitions FROM..TO."
                if assumed.is_share:  # the design, however often repeated, has no test of it
                    fix = "Choose a factorial, blocks or a split plot, or name other measures with --measure."
                raise AnalysisError(problem.rstrip("."), where="power", fix=fix)
            places = {run_id: place for place, run_id in enumerate(every.frame[RUN_ID])}
            rows = np.array([places[run_id] for run_id in data.frame[RUN_ID]])
            prepared.append(_Prepared(assumed, rows, blocks, data, model, every))
        return prepared

    def _design(self, values: Mapping[str, Floats], random: np.random.Generator) -> Design:
        """Return the design of an experiment with these values; covariates are independent of them."""
        covariates = self._plan.covariates if self._plan is not None else ()
        drawn = {name: random.normal(size=len(self._cells)) for name in covariates if name in self._study.units}
        results = self._study.results(self._repetitions, {**drawn, **values}, self._first_batch)
        design = design_of(results, blocks=self._plan.blocks if self._plan is not None else None)
        return replace(design, covariates=covariates)

    def _analysed(
        self, design: Design, assumed: AssumedMeasure
    ) -> tuple[MeasureData, AnyModel | ExactTests | NotComputed]:
        """Return the data of a measure, without the values that the plan leaves out, and its model."""
        name = assumed.name
        gone = frozenset(each.run_id for each in left_out_of(design, name, self._plan, ()))
        data = _drawn(replace(design, covariates=()) if assumed.is_share else replace(design, without=gone), name)
        compared = comparable(data).data
        if assumed.is_share:
            return compared, answer_model_of(data, compared, self._choices.statistic)
        return compared, planned_model_of(compared, self._choices.estimand, self._choices.statistic)

    def _is_fast(self, prepared: _Prepared) -> bool:
        """Return whether many experiments can be computed at once: all of them use the same runs."""
        if isinstance(prepared.model, ExactTests):
            return True
        leaves_out = self._plan is not None and self._plan.outliers is not None and not prepared.assumed.is_share
        if leaves_out or (prepared.data.covariates and not isinstance(prepared.model, CellMeans)):
            return False
        return isinstance(prepared.model, CellMeans | StrataModel | LenthModel | SurfaceModel)

    @cached_property
    def claims(self) -> tuple[Claim, ...]:
        """The tested claims: the hypotheses of the plan, then all effects on each measure."""
        stated = self._plan.hypotheses if self._plan is not None else ()
        names = [each.assumed.name for each in self._measures]
        found = [
            Claim(claim_of(each), each.statement, each.measure, is_hypothesis=True)
            for each in stated
            if each.measure in names
        ]
        for each in self._measures:
            for factors in each.effects:
                what = named_within(enumerated_factors(factors), each.data.within(factors))
                label = f"{what} on {each.assumed.name}"
                found.append(
                    Claim(effect_key(each.assumed.name, factors), label, each.assumed.name, is_hypothesis=False)
                )
        return tuple(found)

    @cached_property
    def _draws(self) -> int:
        """The number of draws of a test: the smallest level is that of one test among all, corrected."""
        names = {each.assumed.name for each in self._measures}
        planned = names | set(self._plan.measures if self._plan is not None else ())
        tests = len(self.claims) * len(planned) / len(names)  # what is not simulated may share their family
        return max(_DRAWS, math.ceil(_FINER * tests / self._choices.alpha))

    def found(self, part: int, experiments: int = AT_ONCE) -> dict[Key, NDArray[np.bool_]]:
        """Return which claims are significant after correction, in each experiment of a part."""
        p_values = self.p_values(part, experiments)
        tested = {each.assumed.name: self._keys(each, p_values) for each in self._measures}
        # What is not simulated shares their family: it is corrected for, and taken to be never found.
        effects = {factors for each in self._measures for factors in each.effects}
        for name in self._plan.measures if self._plan is not None else ():
            if name not in tested:
                stated = (contrast_key(each.statement) for each in contrasts_of(self._plan, name))
                tested[name] = [*(effect_key(name, factors) for factors in effects), *stated]
                p_values |= dict.fromkeys(tested[name], np.ones(experiments))
        found: dict[Key, NDArray[np.bool_]] = {}
        for _, keys in families_of(tested, self._plan):
            if keys:
                found |= self._significant(keys, np.stack([p_values[key] for key in keys], axis=-1))
        return found

    def _significant(self, keys: Sequence[Key], p_values: Floats) -> dict[Key, NDArray[np.bool_]]:
        is_found = np.zeros(p_values.shape, dtype=bool)
        for place, row in enumerate(p_values):
            known = np.isfinite(row)
            is_found[place, known] = np.array(adjusted(row[known], self._choices.correction)) < self._choices.alpha
        return dict(zip(keys, is_found.T, strict=True))

    def _keys(self, prepared: _Prepared, p_values: Mapping[Key, Floats]) -> list[Key]:
        """Return the keys of the tests of a measure, in the order of the report."""
        name = prepared.assumed.name
        effects = [effect_key(name, factors) for factors in prepared.effects]
        contrasts = [contrast_key(each.statement) for each in contrasts_of(self._plan, name)]
        return [*effects, *(key for key in contrasts if key in p_values)]

    def p_values(self, part: int, experiments: int = AT_ONCE) -> dict[Key, Floats]:
        """Return the uncorrected p-value of each test in each experiment; NaN where there is none."""
        found: dict[Key, Floats] = {}
        with quiet():
            for prepared, values in zip(self._measures, self.values(part, experiments).values(), strict=True):
                of = self._of_all if self._is_fast(prepared) else self._of_each
                found |= of(prepared, values, part)
        return found

    def values(self, part: int, experiments: int = AT_ONCE) -> dict[str, Floats]:
        """Return the values of each measure, (experiments, runs), with runs in the order of the study."""
        return {
            each.assumed.name: each.assumed.draw(
                np.random.default_rng((*self._seed, part, place)),
                AT_ONCE,
                tuple(self._study.factors),
                self._cells,
                each.blocks,
            )[:experiments]
            for place, each in enumerate(self._measures)
        }

    def _of_all(self, prepared: _Prepared, values: Floats, part: int) -> dict[Key, Floats]:
        del part  # nothing is drawn
        name, is_share = prepared.assumed.name, prepared.assumed.is_share
        if isinstance(prepared.model, ExactTests):
            return prepared.model.p_values(values, contrasts_of(self._plan, name), self._draws)
        estimand = Estimand.MEAN if is_share else self._choices.estimand
        choices, mine = (estimand, self._choices.statistic), values[:, prepared.rows]
        if isinstance(prepared.model, CellMeans):
            means = CellMeans.of_values(prepared.model.layout, mine, *choices, self._draws)
            found, alike = self._tested(name, means, estimand), ~means.has_variation
            return self._of_shares(found, prepared.every, values, alike) if is_share else found
        model = designed_model_of(prepared.data, *choices, mine)
        if model is None or isinstance(model, NotComputed):
            raise TypeError(f"{name} has to be fitted one experiment at a time")
        found = self._tested(name, model, estimand)
        return self._of_shares(found, prepared.every, values, np.zeros(len(values), dtype=bool)) if is_share else found

    def _of_shares(
        self, found: dict[Key, Floats], data: MeasureData, values: Floats, alike: NDArray[np.bool_]
    ) -> dict[Key, Floats]:
        """Return the p-values: of bounds the larger ones, and exact ones where all blocks respond alike."""
        exact, hypotheses = ExactTests(data), contrasts_of(self._plan, data.name)
        for hypothesis in hypotheses:
            if (independent := exact.independent(values, hypothesis)) is not None:
                key = contrast_key(hypothesis.statement)
                found[key] = np.maximum(found[key], independent)
                if not data.known.columns and (unknown := np.isnan(found[key])).any():
                    found[key][unknown] = exact.p_values(values[unknown], [hypothesis], self._draws)[key]
        if alike.any():
            of_alike = exact.p_values(values[alike], hypotheses, self._draws)
            for key, p_values in found.items():
                p_values[alike] = of_alike.get(key, np.full(int(alike.sum()), np.nan))
        return found

    def _of_each(self, prepared: _Prepared, values: Floats, part: int) -> dict[Key, Floats]:
        # Zeros at the end of a seed change nothing: without a place of their own, covariates would be those of place 0.
        random = np.random.default_rng((*self._seed, part, len(self._measures)))
        name = prepared.assumed.name
        found: list[dict[Key, Floats]] = []
        for row in values:
            _, model = self._analysed(self._design({name: row}, random), prepared.assumed)
            if isinstance(model, NotComputed | ExactTests):
                found.append({})
            else:
                found.append(self._tested(name, model, self._choices.estimand))
        missing = np.asarray(np.nan)
        # If values hardly vary, no experiment may be testable: then no effect is found.
        effects = [effect_key(name, factors) for factors in prepared.effects]
        keys = dict.fromkeys([*effects, *(key for each in found for key in each)])
        return {key: np.array([float(each.get(key, missing)) for each in found]) for key in keys}

    def _tested(self, name: str, model: AnyModel, estimand: Estimand) -> dict[Key, Floats]:
        found = {}
        for test in model.effects():
            figures = np.broadcast_arrays(test.p_value, test.statistic, *test.freedom)
            is_known = np.all(np.isfinite(figures), axis=0)
            found[effect_key(name, test.factors)] = np.where(is_known, test.p_value, np.nan)
        for hypothesis in contrasts_of(self._plan, name):
            contrast = contrast_of(model, hypothesis, estimand)
            if not isinstance(contrast, NotComputed):
                p_values = np.where(contrast.error > 0, p_value_of_contrast(contrast, hypothesis), np.nan)
                found[contrast_key(hypothesis.statement)] = p_values
        return found


def _drawn(design: Design, name: str) -> MeasureData:
    data = design.data(name)
    if data is None:
        raise TypeError(f"{name} was drawn, and is not a number")
    return data


def enumerated_factors(factors: Sequence[str]) -> str:
    """Return an effect in words.

    Example:
        >>> enumerated_factors(["Task"]), enumerated_factors(["Task", "Speed"])
        ('effect of Task', 'interaction of Task and Speed')
    """
    return f"{'effect' if len(factors) == 1 else 'interaction'} of {enumerated(list(factors))}"
