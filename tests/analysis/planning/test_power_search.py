"""Further experiments of a number of repetitions are others than those that it has."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from robot_runner.analysis.planning.assumed_values import assumed_scenario, differences_of
from robot_runner.analysis.planning.planned_study import Study
from robot_runner.analysis.planning.power_search import FEWEST_OF_MODELS, MOST_OF_MODELS, Search, search_repetitions
from robot_runner.analysis.planning.power_simulation import Simulation
from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.outliers import Outliers
from robot_runner.core.design.run_table_model import RunTableModel

if TYPE_CHECKING:
    import pytest
    from numpy.typing import NDArray

    from robot_runner.analysis.statistics.families import Key


def test_no_experiment_is_counted_twice_where_models_are_fitted_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    model = RunTableModel([Factor("Task", ["Video", "Network"])], repetitions=6)
    plan = AnalysisPlan("Energy", outliers=Outliers(interquartile_ranges=1.0))
    study = Study.of_model("study", model, plan, {"Energy": "J"})
    scenario = assumed_scenario(
        study, ["Energy"], differences_of(study, ["Task=1"], ["Energy"]), {"Energy": 1.0}, {}, "assumed"
    )
    drawn: list[float] = []

    def four_of_five(self: Simulation, part: int, experiments: int) -> dict[Key, NDArray[np.bool_]]:
        drawn.extend(self.values(part, experiments)["Energy"][:, 0].tolist())
        return {claim.key: np.arange(experiments) % 5 > 0 for claim in self.claims}  # a power of 80 %: more are needed

    monkeypatch.setattr(Simulation, "found", four_of_five)
    found = search_repetitions(study, scenario, Search(first=6, last=6))
    assert FEWEST_OF_MODELS < MOST_OF_MODELS == found.point(6).least.simulations == len(drawn)
    assert len(set(drawn)) == len(drawn)
