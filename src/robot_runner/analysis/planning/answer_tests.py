"""The tests of a yes-or-no measure in many simulated experiments: those that its report will have.

The report compares runs that stand by themselves by exact tests, and runs of a block, a subject or a plot by their
shares of yes, as means (docs/procedures.md). The design tells which; only where all blocks respond in the same way the
exact tests serve again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.statistics.analysed_design import MeasureData
from robot_runner.analysis.statistics.families import Key, contrast_key, effect_key
from robot_runner.analysis.statistics.proportion_contrasts import (
    compared_weights,
    independent_p_value,
    most_runs,
    p_value_of,
    shares_of,
)
from robot_runner.analysis.statistics.proportions import Strata, problem_of
from robot_runner.analysis.statistics.shares import are_compared, belong_together
from robot_runner.analysis.statistics.tested import NotComputed
from robot_runner.analysis.statistics.tests import AnyModel, model_of
from robot_runner.core.design.analysis_plan import Estimand, Statistic
from robot_runner.core.design.hypothesis import Hypothesis

_HALF = 50.0


@dataclass(frozen=True, slots=True)
class ExactTests:
    """The exact tests of proportions.

    Attributes:
        data: of one experiment.
    """

    data: MeasureData

    @property
    def effects(self) -> tuple[tuple[str, ...], ...]:
        """The factors of each tested effect: there are no interactions."""
        return tuple((name,) for name in self.data.factors)

    def p_values(self, percent: Floats, hypotheses: Sequence[Hypothesis], draws: int) -> dict[Key, Floats]:
        """Return the uncorrected p-value of each test in each experiment; NaN where there is none.

        The percentages are 100 for yes and 0 for no, (experiments, runs). For three or more treatments, random tables
        are drawn.
        """

        def of_effect(table: Strata) -> float:
            return table.p_value(draws) if table.statistic()[1] else np.nan

        answers = (percent > _HALF).astype(np.float64)
        found = {
            effect_key(self.data.name, (name,)): self._of_each(name, self.data.levels(name), answers, of_effect)
            for name in self.data.factors
        }
        for hypothesis in hypotheses:
            weights = compared_weights(self.data, hypothesis)
            if isinstance(weights, NotComputed):
                continue
            most, of = most_runs(self.data, weights, hypothesis), list(weights.values())

            def p_value(
                table: Strata, stated: Hypothesis = hypothesis, of: list[float] = of, most: float = most
            ) -> float:
                shares = shares_of(table, of, most)
                return np.nan if shares is None else p_value_of(table, shares, of, stated)

            p_values = self._of_each(hypothesis.factors[0], list(weights), answers, p_value)
            is_known = np.ones(len(answers), dtype=bool) if hypothesis.has_bound else np.ptp(answers, axis=1)
            found[contrast_key(hypothesis.statement)] = np.where(is_known, p_values, np.nan)
        return found

    def independent(self, percent: Floats, hypothesis: Hypothesis) -> Floats | None:
        """Return the p-value of a bound in each experiment, as if all runs were independent; None if it has none."""
        weights = compared_weights(self.data, hypothesis)
        if isinstance(weights, NotComputed) or not hypothesis.has_bound:
            return None
        of, answers = list(weights.values()), (percent > _HALF).astype(np.float64)
        return self._of_each(
            hypothesis.factors[0], list(weights), answers, lambda table: independent_p_value(table, of, hypothesis)[0]
        )

    def _of_each(
        self, factor: str, levels: Sequence[str], answers: Floats, p_value: Callable[[Strata], float]
    ) -> Floats:
        known: dict[bytes, float] = {}  # experiments of few runs are often the same
        found = []
        for table in Strata.of_each(self.data, factor, levels, answers):
            told = table.yes.tobytes()
            if told not in known:
                known[told] = p_value(table)
            found.append(known[told])
        return np.array(found)


def answer_model_of(
    data: MeasureData, compared: MeasureData, statistic: Statistic
) -> AnyModel | ExactTests | NotComputed:
    """Return the tests that the design of a yes-or-no measure has: the model of its shares, or exact tests.

    The data is of one experiment, with any numbers for answers; `compared` is the part of it that can be compared
    within batches.
    """
    if belong_together(data):
        model = model_of(compared, Estimand.MEAN, statistic)
        if not isinstance(model, NotComputed) and are_compared(data, model):
            return model
    problem = problem_of(data)
    return NotComputed("the test", problem) if problem else ExactTests(data)
