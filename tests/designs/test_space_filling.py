"""Latin hypercubes and Sobol' points fill the ranges evenly, stay within them, and respect exclusions."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.designs.factor_sets import findings_of, numeric, rows_of

from robot_runner import INACTIVE, Factor, Range, RunTableModel
from robot_runner.designs import LatinHypercube, Sobol


@settings(max_examples=25, deadline=None)
@given(st.integers(2, 30), st.integers(1, 5), st.integers(0, 9))
def test_each_run_of_a_hypercube_has_a_slice_of_each_range_of_its_own(runs: int, factors: int, seed: int) -> None:
    names = [f"F{place}" for place in range(factors)]
    fine = [Factor(name, Range(-3.0, 7.0, step=1e-6)) for name in names]
    design = LatinHypercube(runs=runs, seed=seed)
    model = RunTableModel([*fine, Factor("Task", ["a", "b"])], design=design)
    for name in names:
        values = sorted(run.combination[name] for run in model.plan())
        assert [int((value + 3) / 10 * runs + 1e-4 * (place + 1 < runs)) for place, value in enumerate(values)] == list(
            range(runs)
        )
    tasks = [run.combination["Task"] for run in model.plan()]
    assert abs(tasks.count("a") - tasks.count("b")) <= 1
    assert rows_of(RunTableModel([*fine, Factor("Task", ["a", "b"])], design=design)) == rows_of(model)


@pytest.mark.parametrize(
    ("span", "steps"),
    [
        (Range(1, 5), [1, 2, 3, 4, 5]),
        (Range(0.0, 0.2, step=0.05), [0.0, 0.05, 0.1, 0.15, 0.2]),
        (Range(0.0, 0.22, step=0.05), [0.0, 0.05, 0.1, 0.15, 0.2]),
    ],
)
@pytest.mark.parametrize("seed", range(3))
def test_all_steps_of_a_range_are_as_often_in_a_hypercube(span: Range, steps: list[float], seed: int) -> None:
    model = RunTableModel([Factor("Robots", span), *numeric("A")], design=LatinHypercube(runs=10, seed=seed))
    assert sorted(row[0] for row in rows_of(model)) == sorted(2 * steps)


@pytest.mark.parametrize("design", [LatinHypercube(runs=4), Sobol(runs=4)])
def test_treatments_that_are_equal_or_have_no_hash_are_as_often_as_others(design: object) -> None:
    factors = [Factor("Level", [1, True]), Factor("Route", [["door"], ["lift", "door"]]), *numeric("A")]
    rows = rows_of(RunTableModel(factors, design=design))
    assert sorted(str(row[0]) for row in rows) == ["1", "1", "True", "True"]
    assert sorted(len(row[1]) for row in rows) == [1, 1, 2, 2]


def test_each_half_of_each_range_has_half_of_the_sobol_points_and_each_quarter_a_quarter() -> None:
    rows = rows_of(RunTableModel(numeric("AB"), design=Sobol(runs=16)))
    quarters = [(int(one // 5), int(other // 5)) for one, other in rows]
    assert {quarters.count(each) for each in quarters} == {4}
    assert len(set(quarters)) == 4


@pytest.mark.parametrize("design", [LatinHypercube(runs=12), Sobol(runs=12)])
def test_exclusions_and_conditions_are_respected_and_the_number_of_runs_is_kept(design: object) -> None:
    factors = [
        *numeric("AB"),
        Factor("Sensor", ["camera", "lidar"]),
        Factor("Rate", Range(1, 30, unit="Hz"), when={"Sensor": "camera"}),
    ]

    def is_out(combination: dict[str, object]) -> bool:
        return combination["A"] + combination["B"] > 12

    exclusions = [is_out, {"Sensor": "lidar", "Rate": INACTIVE, "A": 0.0}]
    model = RunTableModel(factors, exclusions, design=design, repetitions=2)
    combinations = [run.combination for run in model.plan()]
    assert len(combinations) == 24
    assert len(set(map(str, combinations))) == 12
    assert not any(map(is_out, combinations))
    assert all((each["Rate"] is INACTIVE) == (each["Sensor"] == "lidar") for each in combinations)
    rate = next(factor for factor in model.factors if factor.name == "Rate")
    assert rate.treatments == (*sorted(rate.treatments[:-1]), INACTIVE)
    assert {type(each) for each in rate.treatments[:-1]} == {int}
    assert (rate.unit, rate.range) == ("Hz", Range(1, 30, unit="Hz"))
    said = "not a power of two" if isinstance(design, Sobol) else ""
    assert [said in str(each) for each in model.warnings] == [True] * bool(said)


def test_what_keeps_points_from_being_spread_is_said() -> None:
    assert findings_of([Factor("Task", ["a", "b"])], design=LatinHypercube(runs=1)) == [
        "design: runs=1 is less than 2 → Give a whole number from 2.",
        (
            "design: no factor is numeric: there is no space to fill → Give a factor a range, as in "
            'Factor("Speed", Range(0.05, 0.22)), or choose CoveringArray.'
        ),
    ]
    assert findings_of(numeric("A"), design=Sobol(runs=2**31)) == [
        "design: runs=2,147,483,648 is more than 10,000,000 → Give 10,000,000 or less."
    ]
    assert findings_of([Factor("Speed", Range(1, 3))], design=Sobol(runs=8)) == [
        (
            "design: fewer than 8 combinations are allowed among 512 points → Exclude less, give finer steps, or fewer "
            "runs."
        )
    ]


def test_a_missing_library_is_told_with_the_extra_that_brings_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robot_runner.designs.choosing.find_spec", lambda name: None)
    assert findings_of(numeric("A"), design=Sobol(runs=4)) == [
        "design: the design needs scipy, which is not installed → Install it: pip install 'robot-runner[designs]'."
    ]
