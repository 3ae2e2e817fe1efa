"""A factor that applies to some runs only is tested among these, and all others over all runs."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from tests.analysis.statistics.designed_data import designed

from robot_runner.analysis import analyse
from robot_runner.analysis.statistics.analysed_design import design_of
from robot_runner.analysis.statistics.cell_layout import layout_of
from robot_runner.analysis.statistics.cell_means import CellMeans
from robot_runner.analysis.statistics.linear_model import fit_model
from robot_runner.analysis.statistics.nested_factors import NestedFactors, conditions_of
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.hypothesis import Hypothesis
from robot_runner.core.design.run_table_model import RunTableModel

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.analysis.results import Results
    from robot_runner.analysis.statistics.outcome import MeasureStatistics

FACTORIAL = {"kind": "full_factorial"}
SENSOR, SPEED = Factor("Sensor", ["camera", "lidar"]), Factor("Speed", ["slow", "fast"])
RESOLUTION = Factor("Resolution", ["720p", "1080p"], when={"Sensor": "camera"})


def planned(*factors: Factor) -> pd.DataFrame:
    runs = RunTableModel(list(factors)).plan()
    return pd.DataFrame([{name: str(each) for name, each in run.combination.items()} for run in runs])


def nested(*factors: Factor) -> NestedFactors:
    table = planned(*factors)
    found = conditions_of(table)
    texts = {name: list(dict.fromkeys(table[name])) for name in table}
    return NestedFactors(
        {name: [each for each in of if name not in found or each != "inactive"] for name, of in texts.items()}, found
    )


def experiment(
    effect: Callable[..., float],
    runs: int | Callable[..., int] = 6,
    **blocks: int,
) -> Results:
    """Return results of Sensor, Resolution within the camera, and Speed; values are drawn."""
    random = np.random.default_rng(7)
    rows = []
    for cell in planned(SENSOR, RESOLUTION, SPEED).itertuples(index=False, name=None):
        numbers = range(runs if isinstance(runs, int) else runs(*cell))
        rows += [(*cell, *([f"b{number}"] if blocks else []), effect(*cell) + random.normal()) for number in numbers]
    names = ["Sensor", "Resolution", "Speed", *blocks]
    found = designed(rows, names, FACTORIAL)
    found.manifest["design"]["blocks"] = next(iter(blocks), None)
    return found


def p_values(found: MeasureStatistics) -> dict[str, float | None]:
    assert found.test is not None
    return {effect.label: effect.p_value for effect in found.test.effects}


SEVERAL = Factor("Sensor", ["camera", "lidar", "sonar"])


@pytest.mark.parametrize(
    ("factors", "expected"),
    [
        ([SENSOR, RESOLUTION, SPEED], {"Resolution": {"Sensor": ("camera",)}}),
        (
            [SEVERAL, Factor("A", [1, 2], when={"Sensor": ["camera", "lidar"]})],
            {"A": {"Sensor": ("camera", "lidar")}},
        ),
        (
            [SEVERAL, Factor("A", [1, 2], when={"Sensor": "camera"}), Factor("B", [1, 2], when={"A": 2}), SPEED],
            {"A": {"Sensor": ("camera",)}, "B": {"A": ("2",)}},
        ),
        (
            [SEVERAL, Factor("A", [1, 2], when={"Sensor": "camera"}), Factor("B", [1, 2], when={"Sensor": "camera"})],
            {"A": {"Sensor": ("camera",)}, "B": {"Sensor": ("camera",)}},
        ),
        (
            [SENSOR, Factor("A", [1, 2], when={"Sensor": "camera", "Speed": "slow"}), SPEED],
            {"A": {"Sensor": ("camera",), "Speed": ("slow",)}},
        ),
        ([Factor("Governor", ["active", "inactive"]), SPEED], {}),
        (
            [Factor("Governor", ["active", "inactive"]), Factor("Boost", [1, 2], when={"Governor": "inactive"})],
            {"Boost": {"Governor": ("inactive",)}},
        ),
    ],
    ids=["one", "several treatments", "a chain", "two beside", "two conditions", "a treatment", "a treatment decides"],
)
def test_where_a_factor_applies_is_read_from_the_combinations(factors: list[Factor], expected: dict[str, Any]) -> None:
    found = nested(*factors)
    assert found.conditions == expected
    assert set(found.cells) == set(planned(*factors).itertuples(index=False, name=None))
    assert found.count == len(found.cells)
    # All effects together tell all differences of combinations, and none of them twice.
    contrasts = np.vstack([found.contrasts(term) for term in found.terms(len(found))])
    assert len(contrasts) == np.linalg.matrix_rank(contrasts) == len(found.cells) - 1


def test_the_coding_of_effects_and_their_contrasts_ask_the_same() -> None:
    found = nested(SEVERAL, Factor("A", [1, 2, 3], when={"Sensor": ["camera", "lidar"]}), SPEED)
    terms = found.terms(3)
    inverse = np.linalg.inv([found.row(terms, dict(zip(found, cell, strict=True))) for cell in found.cells])
    start = 1
    for term in terms:
        both = np.vstack([found.contrasts(term), inverse[start : start + found.size(term)]])
        assert np.linalg.matrix_rank(both, tol=1e-9) == found.size(term)
        start += found.size(term)
    for name, levels in found.items():
        for text in levels:
            assert found.row(terms, {name: text}) @ inverse == pytest.approx(found.weights({name: text}), abs=1e-12)


@pytest.mark.long
def test_a_conditional_factor_is_tested_among_the_runs_where_it_applies() -> None:
    results = experiment(lambda sensor, resolution, _: 4.0 * (resolution == "1080p") + 2.0 * (sensor == "lidar"))
    found = analyse(results)
    effects = p_values(found.measure("y"))
    assert list(effects) == [
        "Sensor",
        "Resolution within Sensor=camera",
        "Speed",
        "Sensor x Speed",
        "Resolution x Speed within Sensor=camera",
    ]
    assert [label for label, value in effects.items() if value < 0.01] == ["Resolution within Sensor=camera"]
    test = found.measure("y").test
    assert test.effects[1].conclusion.startswith("Resolution has an effect on y within Sensor=camera: the mean of 720p")
    assert "on y within Sensor=camera depends" not in test.effects[4].conclusion
    assert any("In a mean of Sensor, each treatment" in note for note in test.notes)
    # The same test among these runs alone, as there is one variance for each combination.
    done = results.done[results.done["Sensor"] == "camera"]
    rows = done[["Resolution", "Speed", "y"]].astype({"Resolution": str, "Speed": str}).to_numpy().tolist()
    alone = p_values(analyse(designed(rows, ["Resolution", "Speed"], FACTORIAL)).measure("y"))
    assert effects["Resolution within Sensor=camera"] == pytest.approx(alone["Resolution"])
    assert effects["Resolution x Speed within Sensor=camera"] == pytest.approx(alone["Resolution x Speed"])
    pairs = {
        each.label: [(pair.first, pair.second) for pair in each.comparisons] for each in found.measure("y").post_hoc
    }
    assert pairs == {
        "Sensor": [("camera", "lidar")],
        "Resolution within Sensor=camera": [("720p", "1080p")],
        "Speed": [("slow", "fast")],
    }
    assert found.design.empty_combinations == 0
    assert "Resolution (2 treatments within Sensor=camera)" in found.design.sentence
    assert [each.label for each in found.measure("y").by_treatment] == [
        "camera",
        "lidar",
        "720p",
        "1080p",
        "slow",
        "fast",
    ]


def test_each_treatment_of_a_nested_factor_counts_the_same_in_the_mean_that_it_is_nested_within() -> None:
    results = experiment(
        lambda _, resolution, __: 3.0 * (resolution == "1080p"),
        lambda _, resolution, __: 9 if resolution == "720p" else 4,
    )
    found = analyse(results).measure("y")
    done = results.done
    cells = done.groupby(["Sensor", "Resolution", "Speed"], observed=True)["y"]
    mean, error, count = cells.mean(), cells.var() / cells.size(), cells.size()
    weights = pd.Series(
        [1 / 4 if sensor == "camera" else -1 / 2 for sensor, _, _ in mean.index], mean.index
    )  # Welch's t by hand
    parts = weights**2 * error
    difference, freedom = float((weights * mean).sum()), float(parts.sum() ** 2 / (parts**2 / (count - 1)).sum())
    (pair,) = found.post_hoc[0].comparisons
    assert pair.difference == pytest.approx(difference)
    assert pair.degrees_of_freedom == pytest.approx(freedom)
    t_value = difference / float(parts.sum()) ** 0.5
    assert pair.p_value == pytest.approx(2 * stats.t.sf(abs(t_value), freedom))


def test_with_single_runs_the_effects_are_those_of_a_nested_linear_model() -> None:
    # In R: contrasts of sums; drop1(lm(y ~ S + S:R + V), . ~ ., test = "F") with Resolution within the camera.
    data = design_of(experiment(lambda *_: 0.0, 1)).data("y")
    model = fit_model(data)
    effects = {test.factors: test for test in model.effects()}
    assert list(effects) == [("Sensor",), ("Resolution",), ("Speed",)]
    frame = data.frame.astype({"Sensor": str, "Resolution": str, "Speed": str})
    coded = {
        "Sensor": np.where(frame["Sensor"] == "camera", 1.0, -1.0),
        "Resolution": frame["Resolution"].map({"720p": 1.0, "1080p": -1.0, "inactive": 0.0}).to_numpy(),
        "Speed": np.where(frame["Speed"] == "slow", 1.0, -1.0),
    }

    def left(names: list[str]) -> float:
        columns = np.column_stack([np.ones(len(frame)), *(coded[name] for name in names)])
        return float(np.linalg.lstsq(columns, data.values)[1][0])

    for name in coded:
        others = [each for each in coded if each != name]
        expected = (left(others) - left(list(coded))) / (left(list(coded)) / 2)
        assert effects[(name,)].statistic == pytest.approx(expected)
        assert effects[(name,)].freedom == (1.0, 2.0)


@pytest.mark.parametrize("is_blocked", [False, True], ids=["runs", "blocks"])
@pytest.mark.parametrize(
    ("shift", "expected"),
    [
        (lambda *_: 0.0, set()),
        (lambda _, resolution, __: {"720p": -2.0, "1080p": 2.0}.get(resolution, 0.0), {("Resolution",)}),
        (lambda sensor, *_: 4.0 * (sensor == "lidar"), {("Sensor",)}),
        (
            lambda _, resolution, speed: {"720p": -2.0, "1080p": 2.0}.get(resolution, 0.0) * (-1) ** (speed == "slow"),
            {("Resolution", "Speed")},
        ),
    ],
    ids=["nothing", "nested", "parent", "interaction"],
)
def test_only_the_effects_that_there_are_are_found(
    shift: Callable[..., float], expected: set[tuple[str, ...]], is_blocked: bool
) -> None:
    data = design_of(experiment(lambda *_: 0.0, 8, **({"Room": 1} if is_blocked else {}))).data("y")
    layout = layout_of(data)
    assert layout.is_blocked is is_blocked
    random = np.random.default_rng(1)
    means = np.array([shift(*row[:3]) for row in data.frame[list(data.factors)].itertuples(index=False)])
    rooms = np.unique(data.blocks, return_inverse=True)[1] if is_blocked else np.zeros(len(means), dtype=int)
    drawn = random.normal(size=(1000, len(means))) + 3 * random.normal(size=(1000, 8))[:, rooms] * is_blocked
    for test in CellMeans.of_values(layout, means + drawn).effects():
        found = float(np.mean(test.p_value < 0.05))
        assert found > 0.95 if test.factors in expected else found < 0.065


def test_where_blocks_do_not_hold_the_same_combinations_a_mixed_model_takes_them_out() -> None:
    rows = [
        (*cell, f"room {room}", float(run))
        for run, (room, cell) in enumerate(
            (room, cell)
            for room in range(8)
            for cell in planned(SENSOR, RESOLUTION, SPEED).itertuples(index=False, name=None)
            if (cell[0] == "camera") is (room % 2 == 0)
        )
    ]
    results = designed(
        [(*row[:-1], row[-1] ** 2 % 7) for row in rows], ["Sensor", "Resolution", "Speed", "Room"], FACTORIAL
    )
    results.manifest["design"]["blocks"] = "Room"
    found = analyse(results).measure("y").test
    freedom = {effect.label: effect.degrees_of_freedom for effect in found.effects}
    assert freedom["Sensor"] == (1.0, 6.0)  # between rooms
    assert freedom["Resolution within Sensor=camera"] == (1.0, 12.0)  # within them


def test_hypotheses_name_a_conditional_factor_like_any_other() -> None:
    results = experiment(lambda _, resolution, __: 4.0 * (resolution == "1080p"))
    stated = [
        Hypothesis("It matters", measure="y", factors="Resolution"),
        Hypothesis("It matters much", measure="y", factors="Resolution", contrast={"1080p": 1, "720p": -1}),
        Hypothesis("It is the same", measure="y", factors="Resolution", within=1),
        Hypothesis("It hangs on the sensor", measure="y", factors=("Sensor", "Resolution")),
    ]
    results.manifest["analysis"] = {"measures": ["y"], "hypotheses": [each.as_mapping() for each in stated]}
    matters, much, same, impossible = analyse(results).hypotheses
    assert (matters.is_supported, much.is_supported, same.is_supported) == (True, True, False)
    assert impossible.conclusion.endswith(
        "has no effect of Sensor x Resolution: Resolution is tested within Sensor=camera."
    )


def test_proportions_of_a_parent_are_of_all_of_its_runs() -> None:
    cells = planned(SENSOR, RESOLUTION).itertuples(index=False, name=None)
    yes = {"720p": 1, "1080p": 7, "inactive": 4}
    rows = [(*cell, float(run < yes[cell[1]])) for cell in cells for run in range(8)]
    results = designed(rows, ["Sensor", "Resolution"], FACTORIAL)
    results.table["y"] = results.table["y"].astype("boolean")
    found = analyse(results).measure("y")
    sensor, resolution = found.test.effects
    assert (sensor.label, resolution.label) == ("Sensor", "Resolution within Sensor=camera")
    assert sensor.p_value == pytest.approx(stats.fisher_exact([[8, 8], [4, 4]]).pvalue)
    assert resolution.p_value == pytest.approx(stats.fisher_exact([[1, 7], [7, 1]]).pvalue)
    assert [each.label for each in found.post_hoc] == ["Sensor", "Resolution within Sensor=camera"]
    assert [each.label for each in found.proportions.by_treatment] == ["camera", "lidar", "720p", "1080p"]


@pytest.mark.long
def test_a_design_that_is_made_for_main_effects_tells_a_conditional_one() -> None:
    # Only the resolution of the camera costs anything.
    cells = {("camera", "720p", "2"): 0, ("camera", "1080p", "1"): 9, ("camera", "1080p", "2"): 9}
    cells |= {("lidar", "inactive", "1"): 4.5, ("lidar", "inactive", "2"): 4.5}
    rows = [[*cell, cost + run] for cell, cost in cells.items() for run in (0.0, 1.0, 0.5)]
    names = ["Sensor", "Resolution", "Speed"]
    found = p_values(analyse(designed(rows, names, {"kind": "d_optimal", "model": "main"})).measure("y"))
    assert found["Resolution within Sensor=camera"] < 0.001
    assert found["Sensor"] == pytest.approx(1)
    assert found["Speed"] == pytest.approx(1)
    numbers = [(sensor, resolution.removesuffix("p"), *rest) for sensor, resolution, *rest in rows]
    assert p_values(analyse(designed(numbers, names, {"kind": "d_optimal", "model": "main"})).measure("y")) == found
    refused = analyse(designed(rows, names, {"kind": "one_factor_at_a_time"})).measure("y")
    assert refused.test is None
    assert "A full factorial or DOptimal can test it." in refused.not_computed[0].why


def test_a_factor_is_not_tested_where_what_decides_on_it_is_not_compared() -> None:
    results = experiment(lambda *_: 0.0, 4)
    results.manifest["design"]["blocks"] = "Sensor"
    found = analyse(results).measure("y")
    assert found.test is None
    assert "what Resolution does shows within Sensor alone, which is not compared here" in found.not_computed[0].why


def test_a_treatment_that_a_schema_of_ours_calls_inactive_is_one() -> None:
    rows = [
        (governor, boost, float(run % 3)) for run in range(4) for governor, boost in (("on", "a"), ("off", "inactive"))
    ]
    rows += [("on", "b", float(run % 2)) for run in range(4)]
    results = designed(rows, ["Governor", "Boost"], FACTORIAL)
    assert design_of(results).conditions
    described = {name: replace(each, description="A factor.") for name, each in results.columns.items()}
    assert not design_of(replace(results, columns=described)).conditions


def test_an_effect_is_no_larger_than_its_largest_difference_however_much_is_nested_within_a_treatment():
    camera = {"Sensor": ("camera",)}
    factors = NestedFactors(
        {"Sensor": ["camera", "lidar", "sonar"], "Resolution": list("abcd")}, {"Resolution": camera}
    )
    effects = np.array([-0.5162, 0.2789, 0.2373])  # of six combinations four are of the camera
    found = effects[:2] @ factors.squares(("Sensor",)) @ effects[:2]
    assert found == pytest.approx(np.var(np.repeat(effects, [4, 1, 1])))
    assert found < (np.ptp(effects) / 2) ** 2
