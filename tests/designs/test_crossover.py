from __future__ import annotations

from collections import Counter
from itertools import groupby, pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.design.warm_up import WarmUp
from robot_runner.core.errors import DesignError
from robot_runner.designs import Crossover
from robot_runner.designs.crossover import williams_sequences

#: The design for four treatments as Williams (1949) gives it, and the one for three, each sequence beside its mirror.
PUBLISHED = {
    4: {"ABDC", "BCAD", "CDBA", "DACB"},
    3: {"ABC", "BCA", "CAB", "CBA", "ACB", "BAC"},
    2: {"AB", "BA"},
}


@pytest.mark.parametrize("treatments", PUBLISHED)
def test_sequences_are_the_published_ones(treatments: int) -> None:
    found = {"".join("ABCD"[each] for each in sequence) for sequence in williams_sequences(treatments)}
    assert found == PUBLISHED[treatments]


@settings(deadline=None, max_examples=30)
@given(
    treatments=st.integers(2, 8),
    turns=st.integers(1, 3),
    repetitions=st.integers(1, 2),
    seed=st.integers(0, 2**32 - 1),
    shuffle=st.booleans(),
)
def test_each_treatment_follows_each_other_one_and_comes_in_each_period_equally_often(
    treatments: int, turns: int, repetitions: int, seed: int, shuffle: bool
) -> None:
    units = turns * treatments * (1 if treatments % 2 == 0 else 2)

    def planned(units: int) -> RunTableModel:
        factors = [Factor("Robot", range(units)), Factor("Period", range(treatments)), Factor("P", range(treatments))]
        design = Crossover("Robot", "Period")
        return RunTableModel(factors, repetitions=repetitions, seed=seed, shuffle=shuffle, design=design)

    runs = list(planned(units).plan())
    follows: Counter[tuple[int, int]] = Counter()
    in_period: Counter[tuple[int, int]] = Counter()
    for robot, of_robot in groupby(runs, key=lambda run: run.combination["Robot"]):
        mine = list(of_robot)
        assert [run.combination["Period"] for run in mine] == [p for p in range(treatments) for _ in range(repetitions)]
        sequence = [run.combination["P"] for run in mine[::repetitions]]
        assert sorted(sequence) == list(range(treatments))
        assert {run.block for run in mine} == {robot + 1}
        follows.update(pairwise(sequence))
        in_period.update(enumerate(sequence))
    assert len(runs) == units * treatments * repetitions
    assert set(follows.values()) == {units // treatments}
    assert len(follows) == treatments * (treatments - 1)
    assert set(in_period.values()) == {units // treatments}
    assert list(planned(2 * units).plan())[: len(runs)] == runs, "further units leave the sequences of the first ones"


def test_periods_may_begin_with_runs_that_wash_the_treatment_before_out() -> None:
    factors = [Factor("Robot", ["A", "B"]), Factor("Period", [1, 2]), Factor("P", ["old", "new"])]
    model = RunTableModel(factors, warm_up=WarmUp(1, per="combination"), design=Crossover("Robot", "Period"))
    assert [(run.run_id, run.combination["Robot"], run.combination["P"]) for run in model.plan()] == [
        (f"{kind}_{number}", robot, planner)
        for number, (robot, planner) in enumerate((("A", "old"), ("A", "new"), ("B", "new"), ("B", "old")), start=1)
        for kind in "wr"
    ]
    assert model.design_facts["sequences"] == {"A": ["old", "new"], "B": ["new", "old"]}


@pytest.mark.parametrize(
    ("units", "periods", "treatments", "problem", "fix"),
    [
        (5, 3, 3, "5 units, and 3 treatments take 6 sequences", "Have 6 units"),
        (10, 4, 4, "10 units, and 4 treatments take 4 sequences", "Have 8 or 12 units"),
        (4, 3, 4, "P has 4 combinations, and Period has 3 periods", "Have 4 periods"),
        (2, 1, 1, "nothing is compared", "another treatment"),
    ],
)
def test_numbers_that_do_not_suit_each_other_are_a_finding(
    units: int, periods: int, treatments: int, problem: str, fix: str
) -> None:
    factors = [Factor("Robot", range(units)), Factor("Period", range(periods)), Factor("P", range(treatments))]
    with pytest.raises(DesignError) as caught:
        RunTableModel(factors, design=Crossover("Robot", "Period"))
    assert problem in str(caught.value)
    assert fix in str(caught.value)


@pytest.mark.parametrize("washout", [-1, float("nan"), float("inf"), "1 h", True, None])
def test_a_washout_is_a_time_and_all_findings_are_told_at_once(washout: object) -> None:
    with pytest.raises(DesignError) as caught:
        RunTableModel([Factor("P", [1, 2])], design=Crossover("Robot", "Period", washout_in_s=washout))
    assert len(caught.value.findings) == 3
    assert "is not a time to wait" in caught.value.findings[2].problem
