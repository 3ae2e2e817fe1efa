"""A factor or a treatment that is called by another name is the same in every part of an experiment's design."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from tests.analysis.made_experiment import make_experiment

from robot_runner.analysis import load_results
from robot_runner.analysis.comparison.harmonising import Experiment
from robot_runner.analysis.statistics.tested import NotComputed
from robot_runner.analysis.statistics.tests import AnyModel, planned_model_of
from robot_runner.core.design.analysis_plan import Estimand
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.numeric_range import Range
from robot_runner.designs import CentralComposite, Crossover, FractionalFactorial

if TYPE_CHECKING:
    from pathlib import Path

SENSORS = ["camera", "lidar", "sonar"]
DESIGNS: dict[str, tuple[list[Factor], int, Any]] = {
    "a conditional factor": (
        [Factor("Sensor", SENSORS), Factor("Resolution", ["720p", "1080p"], when={"Sensor": "camera"})],
        4,
        None,
    ),
    "a crossover, carried over": (
        [Factor("Sensor", SENSORS), Factor("Driver", list("abcdef")), Factor("Period", [1, 2, 3])],
        1,
        Crossover("Driver", "Period"),
    ),
    "a fraction": (
        [Factor("Sensor", SENSORS[:2]), *(Factor(name, [0, 1]) for name in "XYZ")],
        2,
        FractionalFactorial(resolution=4),
    ),
    "a surface": ([Factor("Sensor", Range(1, 9)), Factor("Speed", Range(0.1, 0.5))], 1, CentralComposite()),
}


def model(of: Experiment) -> AnyModel:
    data = of.data("Energy", "J")
    assert data is not None
    found = planned_model_of(data, Estimand.MEAN)
    assert not isinstance(found, NotComputed)
    return found


@pytest.mark.parametrize("name", DESIGNS)
def test_what_is_called_otherwise_has_the_same_effects(tmp_path: Path, name: str) -> None:
    factors, repetitions, chosen = DESIGNS[name]
    random = np.random.default_rng(6)

    def values(treatments: dict[str, Any], _: int) -> dict[str, Any]:
        return {"Energy": 3.0 * (str(treatments["Sensor"]) in {"camera", "1.0", "9.0"}) + float(random.normal())}

    made = make_experiment(
        tmp_path / "made", factors, values, repetitions=repetitions, units={"Energy": "J"}, chosen=chosen
    )
    plain = Experiment.of_results("lab", load_results(made.root))
    renamed = plain.with_name("Sensor", "Detector")
    if "surface" not in name:
        renamed = renamed.with_name("camera", "eye")
    new = {"Sensor": "Detector", "camera": "eye"}
    before, after = ({each.factors: each for each in model(of).effects()} for of in (plain, renamed))
    assert list(after) == [tuple(new.get(each, each) for each in term) for term in before]
    for one, other in zip(before.values(), after.values(), strict=True):
        assert float(other.p_value) == pytest.approx(float(one.p_value), rel=1e-9)
    if "surface" not in name:
        pairs = [[({"Sensor": "camera"}, 1.0), ({"Sensor": "lidar"}, -1.0)]]
        pairs += [[({"Detector": "eye"}, 1.0), ({"Detector": "lidar"}, -1.0)]]
        found = [model(of).difference(pair) for of, pair in zip((plain, renamed), pairs, strict=True)]
        assert float(found[1].estimate) == pytest.approx(float(found[0].estimate), rel=1e-9)
        assert float(found[1].error) == pytest.approx(float(found[0].error), rel=1e-9)
