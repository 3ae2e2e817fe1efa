"""The planned run table: exactly the full factorial less the exclusions, times the repetitions, in some order."""

from __future__ import annotations

import itertools
import pickle
import tracemalloc
from collections import Counter
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel

if TYPE_CHECKING:
    from robot_runner.core.design.planned_runs import PlannedRun

names = st.lists(st.sampled_from(["A", "B", "C", "D"]), min_size=1, max_size=3, unique=True)
treatments = st.lists(
    st.integers(-5, 5) | st.text(st.characters(categories=["L"]), max_size=3), min_size=1, max_size=4, unique_by=str
)


@st.composite
def designs(draw: st.DrawFn) -> tuple[list[Factor], dict[str, Any], int]:
    factors = [Factor(name, draw(treatments)) for name in draw(names)]
    excluded = {
        factor.name: draw(st.lists(st.sampled_from(factor.treatments), max_size=2))
        for factor in factors
        if draw(st.booleans())
    }
    covers_all = all(
        set(map(str, excluded.get(factor.name, factor.treatments))) >= set(factor.texts) for factor in factors
    )
    return factors, {} if covers_all else excluded, draw(st.integers(1, 4))


def expected(factors: list[Factor], exclusion: dict[str, Any]) -> list[tuple[Any, ...]]:
    combinations = [
        dict(zip([factor.name for factor in factors], values, strict=True))
        for values in itertools.product(*(factor.treatments for factor in factors))
    ]
    return [
        tuple(combination.values())
        for combination in combinations
        if not exclusion or not all(combination[name] in wanted for name, wanted in exclusion.items())
    ]


def model_of(design: tuple[list[Factor], dict[str, Any], int], **order: Any) -> RunTableModel:
    factors, exclusion, repetitions = design
    return RunTableModel(factors, [exclusion] if exclusion else [], repetitions, **order)


@pytest.mark.long
@given(designs())
def test_as_written_the_plan_is_the_factorial_less_the_exclusions_times_the_repetitions(design: Any) -> None:
    factors, exclusion, repetitions = design
    plan = model_of(design).plan()
    once = expected(factors, exclusion)
    assert [tuple(run.combination.values()) for run in plan] == once * repetitions
    assert [run.repetition for run in plan] == [number for number in range(1, repetitions + 1) for _ in once]
    assert [run.run_id for run in plan] == [f"r_{number}" for number in range(1, len(plan) + 1)]
    assert [run.number for run in plan] == list(range(1, len(plan) + 1))


@pytest.mark.long
@given(designs(), st.integers(0, 2**64))
def test_a_random_order_is_a_permutation_and_the_same_for_the_same_seed(design: Any, seed: int) -> None:
    as_written = model_of(design).plan()
    shuffled = model_of(design, shuffle=True, seed=seed).plan()
    again = model_of(design).randomize_runs_order(seed)

    def key(run: PlannedRun) -> tuple[str, int]:
        return str(run.combination), run.repetition

    assert sorted(map(key, shuffled)) == sorted(map(key, as_written))
    assert list(shuffled) == list(again)


@pytest.mark.long
@given(designs(), st.data())
def test_every_block_is_complete(design: Any, data: st.DataObject) -> None:
    factors, exclusion, repetitions = design
    blocks = data.draw(st.sampled_from([factor.name for factor in factors] + ["Repetition"] * (repetitions > 1)))
    plan = model_of(design, shuffle=True, seed=data.draw(st.integers(0, 99)), blocks=blocks).plan()
    numbers = [run.block for run in plan]
    assert numbers == sorted(numbers, key=lambda number: number or 0)
    assert set(numbers) == set(range(1, max(number or 0 for number in numbers) + 1))
    once = Counter(map(str, expected(factors, exclusion)))
    for number in set(numbers):
        runs = [run for run in plan if run.block == number]
        found = Counter(str(tuple(run.combination.values())) for run in runs)
        if blocks == "Repetition" and repetitions > 1:
            assert found == once
        else:
            assert len({run.combination[blocks] for run in runs}) == 1
            assert found == Counter({text: once[text] * repetitions for text in found})


@pytest.mark.long
@given(designs(), st.booleans())
def test_rows_hold_the_factors_own_treatments(design: Any, shuffle: bool) -> None:
    plan = model_of(design, shuffle=shuffle, seed=3).plan()
    for factor in plan.model.factors:
        own = set(map(id, factor.treatments))
        assert all(id(run.combination[factor.name]) in own for run in plan)
        places = [factor.position_of(run.combination[factor.name]) for run in plan]
        assert [factor.treatments[place] for place in places if place is not None] == [
            run.combination[factor.name] for run in plan
        ]


def test_it_is_a_sequence_that_cannot_be_changed() -> None:
    plan = RunTableModel([Factor("A", ["x", "y", "z"])]).plan()
    assert len(plan) == 3
    assert plan[-1] == plan[2]
    assert plan[1:] == (plan[1], plan[2])
    assert plan[::-1][0].run_id == "r_3"
    with pytest.raises(IndexError):
        plan[3]
    with pytest.raises(TypeError):
        plan[0] = plan[1]  # type: ignore[index]
    with pytest.raises(TypeError):
        plan[0].combination["A"] = "other"  # type: ignore[index]


def test_a_run_can_be_sent_to_another_process() -> None:
    run = RunTableModel([Factor("Task", ["Video"]), Factor("Speed", [0.1])]).plan()[0]
    assert pickle.loads(pickle.dumps(run)) == run  # noqa: S301 - our own bytes
    assert str(run.combination) == "Task='Video', Speed=0.1"
    assert run.combination == {"Task": "Video", "Speed": 0.1}


@pytest.mark.long
def test_a_large_table_takes_few_bytes_a_run() -> None:
    factors = [Factor("A", range(300)), Factor("B", range(200))]
    tracemalloc.start()
    try:
        plan = RunTableModel(factors, shuffle=True).plan()
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert held / len(plan) < 320  # bytes: 304 with Python 3.11; from 3.14 on each tuple keeps its hash as well
