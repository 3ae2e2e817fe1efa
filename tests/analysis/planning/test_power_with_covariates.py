"""Covariates of a plan are drawn independently of the measures, so that they explain nothing of these."""

from __future__ import annotations

import numpy as np
import pytest

from robot_runner.analysis.planning.assumed_values import assumed_scenario, differences_of
from robot_runner.analysis.planning.planned_study import Study
from robot_runner.analysis.planning.power_simulation import Simulation
from robot_runner.analysis.statistics.families import effect_key
from robot_runner.core.design.analysis_plan import AnalysisPlan
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel


def simulation_of(*measures: str) -> Simulation:
    model = RunTableModel([Factor("Task", ["Video", "Network"])], repetitions=10)
    plan = AnalysisPlan(measures, covariates=["Voltage"])
    study = Study.of_model("study", model, plan, dict.fromkeys([*measures, "Voltage"], ""))
    spreads = dict.fromkeys(measures, 4.0)
    scenario = assumed_scenario(study, measures, differences_of(study, ["Task=6"], measures), spreads, {}, "assumed")
    return Simulation(study, scenario, 10, seed=(1,))


@pytest.mark.parametrize("measures", [("Energy",), ("Energy", "Time")])
def test_each_experiment_can_be_tested(measures: tuple[str, ...]) -> None:
    p_values = simulation_of(*measures).p_values(0, 3)
    assert all(np.isfinite(p_values[effect_key(name, ["Task"])]).all() for name in measures)


@pytest.mark.long
def test_a_covariate_costs_hardly_any_power() -> None:
    found = simulation_of("Energy").found(0, 100)[effect_key("Energy", ["Task"])]
    assert np.mean(found) == pytest.approx(0.89, abs=0.1)  # TTestIndPower: 6 J at 4 J, 10 and 10 runs
