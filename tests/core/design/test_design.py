"""One parameter of the run-table model takes every design: what chooses combinations, and what plans runs."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.core.design.batches import described_design
from robot_runner.core.design.design import ChosenCombinations, DesignedRuns, FullFactorial
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.full_factorial import full_factorial
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import DesignError, Finding

if TYPE_CHECKING:
    from collections.abc import Iterator

FACTORS = [Factor("Task", ["a", "b"]), Factor("Speed", [1, 2])]


class Parts:
    def findings(self, factors: Any) -> Iterator[Finding]:
        if len(factors) > 2:
            yield Finding.error("design", "too many", "Remove one.")

    def as_mapping(self) -> dict[str, Any]:
        return {"kind": "part", "every": 2}


class EverySecond(Parts):
    def choose(self, factors: Any, is_allowed: Any) -> ChosenCombinations:
        kept = [each for each in full_factorial(factors) if is_allowed(each)]
        return ChosenCombinations(kept[::2], {"kind": "part"}, warnings=(Finding.warning("design", "half"),))


class Backwards(Parts):
    def runs(self, factors: Any, is_allowed: Any, repetitions: int, seed: int, shuffle: bool) -> DesignedRuns:
        kept = [each for each in full_factorial(factors) if is_allowed(each)]
        runs = [(each, 1, place) for place, each in enumerate(reversed(kept), start=1)]
        return DesignedRuns.in_order(runs, {"kind": "backwards", "seed": seed, "shuffle": shuffle})


def rows(model: RunTableModel) -> list[tuple[Any, ...]]:
    return [(*run.combination.treatments, run.repetition, run.block) for run in model.plan()]


def test_a_design_of_combinations_leaves_repetitions_blocks_order_and_warm_up_to_the_model() -> None:
    model = RunTableModel(FACTORS, repetitions=2, blocks="Repetition", warm_up=1, design=EverySecond())
    assert rows(model) == [("a", 1, 0, 1), ("a", 1, 1, 1), ("b", 1, 1, 1), ("a", 1, 2, 2), ("b", 1, 2, 2)]
    assert [str(each) for each in model.warnings] == ["design: half"]
    assert model.combinations_of(FACTORS[::-1]) == [{"Speed": 1, "Task": "a"}, {"Speed": 1, "Task": "b"}]
    shuffled = RunTableModel(FACTORS, repetitions=9, shuffle=True, seed=3, design=EverySecond())
    assert rows(shuffled) == rows(RunTableModel(FACTORS, repetitions=9, shuffle=True, seed=3, design=EverySecond()))
    assert (
        Counter(rows(shuffled)).keys()
        == Counter(rows(RunTableModel(FACTORS, repetitions=9, design=EverySecond()))).keys()
    )


def test_a_design_of_runs_decides_on_blocks_and_order_from_the_recorded_seed() -> None:
    model = RunTableModel(FACTORS, [{"Task": "a", "Speed": 2}], design=Backwards(), shuffle=True)
    assert rows(model) == [("b", 2, 1, 1), ("b", 1, 1, 2), ("a", 1, 1, 3)]
    model.plan(seed=77)
    assert described_design(model)["facts"] == {"kind": "backwards", "seed": 77, "shuffle": True}
    assert described_design(model)["parameters"] == {"kind": "part", "every": 2}
    assert "facts" not in described_design(RunTableModel(FACTORS, design=FullFactorial()))


def test_all_that_is_wrong_with_a_design_is_told_with_all_that_is_wrong_beside_it() -> None:
    with pytest.raises(DesignError) as caught:
        RunTableModel(
            [*FACTORS, Factor("Load", [1])], [{"Taks": "a"}], blocks="Task", repetitions=0, design=Backwards()
        )
    assert [str(finding) for finding in caught.value.findings] == [
        "repetitions: 0 is less than 1 → Give a whole number from 1.",
        "blocks: blocks='Task', and the design makes blocks of its own → Leave blocks out.",
        "design: too many → Remove one.",
        "exclude_combinations[0]: there is no factor 'Taks' → Did you mean 'Task'?",
    ]


@pytest.mark.parametrize("wrong", [EverySecond, "fractional", 3])
def test_what_is_no_design_is_refused(wrong: Any) -> None:
    with pytest.raises(DesignError, match="is of type"):
        RunTableModel(FACTORS, design=wrong)


def test_exclusions_that_leave_nothing_and_other_factors_are_refused() -> None:
    with pytest.raises(DesignError, match="leave no run"):
        RunTableModel(FACTORS, [lambda each: True], design=EverySecond())
    with pytest.raises(DesignError, match="chose its combinations"):
        RunTableModel(FACTORS, design=EverySecond()).combinations_of([FACTORS[0], Factor("Speed", [1, 3])])


def test_a_predicate_that_raises_is_told_as_such() -> None:
    with pytest.raises(DesignError, match="KeyError") as caught:
        RunTableModel(FACTORS, [lambda each: each["Sped"]], design=EverySecond())
    assert caught.value.fix == "Did you mean 'Speed'?"
