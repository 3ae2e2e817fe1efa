from __future__ import annotations

from collections import Counter
from itertools import combinations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import DesignError
from robot_runner.designs import Blocks
from robot_runner.designs.balanced_blocks import balanced_blocks, pair_count
from robot_runner.designs.block_search import efficiency, efficiency_bound

#: Treatments, blocks, replicates, size, pairs: the designs of up to 16 treatments with up to 9 replicates that are no
#: smaller one repeated, but for (16, 24, 9, 6, 3), and three larger ones, of Colbourn and Dinitz (eds.), Handbook of
#: Combinatorial Designs, 2nd ed., 2007, table II.1.28.
PUBLISHED = [
    (7, 7, 3, 3, 1), (9, 12, 4, 3, 1), (13, 13, 4, 4, 1), (6, 10, 5, 3, 2), (16, 20, 5, 4, 1), (11, 11, 5, 5, 2),
    (13, 26, 6, 3, 1), (10, 15, 6, 4, 2), (16, 16, 6, 6, 2), (15, 35, 7, 3, 1), (8, 14, 7, 4, 3), (15, 15, 7, 7, 3),
    (9, 18, 8, 4, 3), (10, 30, 9, 3, 2), (10, 18, 9, 5, 4), (21, 21, 5, 5, 1), (25, 30, 6, 5, 1), (31, 31, 6, 6, 1),
]  # fmt: skip
#: Such designs do not exist though counting allows them (Bruck, Ryser and Chowla; Hall and Connor).
IMPOSSIBLE = [(15, 21, 7, 5, 2), (22, 22, 7, 7, 2)]


@pytest.mark.parametrize(("treatments", "blocks", "replicates", "size", "pairs"), PUBLISHED)
def test_each_published_balanced_design_is_found(
    treatments: int, blocks: int, replicates: int, size: int, pairs: int
) -> None:
    factors = [Factor("Day", range(blocks)), Factor("Planner", range(treatments))]
    model = RunTableModel(factors, repetitions=replicates, shuffle=True, seed=4, design=Blocks("Day"))
    held: dict[int, list[int]] = {}
    for run in model.plan():
        held.setdefault(run.combination["Day"], []).append(run.combination["Planner"])
        assert run.block == run.combination["Day"] + 1
    assert list(held) == list(range(blocks)), "one block after another, as written"
    assert {len(set(each)) for each in held.values()} == {size}
    assert Counter(each for block in held.values() for each in block) == dict.fromkeys(range(treatments), replicates)
    together = Counter(pair for block in held.values() for pair in combinations(sorted(block), 2))
    assert together == dict.fromkeys(combinations(range(treatments), 2), pairs)
    facts = model.design_facts["balance"]["Day"]
    assert facts["is_balanced"]
    assert facts["efficiency"] == pytest.approx(pairs * treatments / (replicates * size), abs=1e-6)  # E = lv/(rk)
    assert facts["efficiency_bound"] == pytest.approx(facts["efficiency"], abs=1e-6)


def test_of_two_kinds_of_blocks_each_says_how_often_its_pairs_are_together() -> None:
    factors = [Factor("Day", range(3)), Factor("Robot", range(2)), Factor("Planner", range(4))]
    model = RunTableModel(factors, repetitions=3, seed=1, design=Blocks("Day", "Robot"))
    for kind in ("Day", "Robot"):
        held: dict[int, Counter[int]] = {}
        for run in model.plan():
            held.setdefault(run.combination[kind], Counter())[run.combination["Planner"]] += 1
        together = [
            sum(block[one] * block[other] for block in held.values()) for one, other in combinations(range(4), 2)
        ]
        assert model.design_facts["balance"][kind]["pairs"] == [min(together), max(together)]


@pytest.mark.long
def test_what_does_not_exist_is_not_found_and_the_best_that_is_says_its_efficiency() -> None:
    for treatments, blocks, _, size, pairs in IMPOSSIBLE:
        assert pair_count(treatments, size, blocks) == pairs
        assert balanced_blocks(treatments, size, blocks) is None
    assert pair_count(16, 6, 8) is None, "Fisher's inequality: fewer blocks than treatments"
    factors = [Factor("Day", range(21)), Factor("Planner", range(15))]
    facts = RunTableModel(factors, repetitions=7, design=Blocks("Day")).design_facts
    assert not facts["balance"]["Day"]["is_balanced"]
    assert 0.98 < facts["balance"]["Day"]["efficiency"] / facts["balance"]["Day"]["efficiency_bound"] < 1
    assert "not balanced" in facts["notes"][0]


@pytest.mark.parametrize(("side", "replicates"), [(3, 2), (3, 3), (4, 2), (4, 3)])
def test_the_search_comes_within_2_percent_of_square_lattices(side: int, replicates: int) -> None:
    """Square lattices are optimal: E = (k + 1)(r - 1) / ((k + 1)(r - 1) + r) (Cochran and Cox, 2nd ed., 1957, 10.3)."""
    factors = [Factor("Day", range(side * replicates)), Factor("Planner", range(side**2))]
    facts = RunTableModel(factors, repetitions=replicates, seed=2, design=Blocks("Day")).design_facts["balance"]["Day"]
    published = (side + 1) * (replicates - 1) / ((side + 1) * (replicates - 1) + replicates)
    assert published * 0.98 < facts["efficiency"] < published + 1e-6


@pytest.mark.long
@settings(deadline=None, max_examples=15)
@given(
    treatments=st.integers(2, 5),
    days=st.integers(2, 4),
    operators=st.integers(1, 3),
    repetitions=st.integers(2, 5),
    seed=st.integers(0, 2**32 - 1),
    shuffle=st.booleans(),
)
def test_each_combination_is_spread_as_evenly_as_can_be(
    treatments: int, days: int, operators: int, repetitions: int, seed: int, shuffle: bool
) -> None:
    factors = [Factor("Day", range(days)), Factor("Operator", range(operators)), Factor("P", range(treatments))]
    assume(treatments * repetitions >= 2 * days * operators)  # else blocks may compare nothing
    model = RunTableModel(
        factors, repetitions=repetitions, seed=seed, shuffle=shuffle, design=Blocks("Day", "Operator")
    )
    runs = list(model.plan())
    counts = Counter(run.combination["P"] for run in runs)
    assert counts == dict.fromkeys(range(treatments), repetitions)
    assert sorted((run.combination["P"], run.repetition) for run in runs) == [
        (each, number) for each in range(treatments) for number in range(1, repetitions + 1)
    ]
    cells = Counter((run.combination["Day"], run.combination["Operator"]) for run in runs)
    assert len(cells) == days * operators
    assert max(cells.values()) - min(cells.values()) <= 1
    for kind in ("Day", "Operator"):
        sizes = Counter(run.combination[kind] for run in runs).values()
        assert max(sizes) - min(sizes) <= 1
    if repetitions % (days * operators) == 0:
        assert all(each["is_complete"] for each in model.design_facts["balance"].values())
    again = RunTableModel(
        factors, repetitions=repetitions, seed=seed, shuffle=shuffle, design=Blocks("Day", "Operator")
    )
    assert list(again.plan()) == runs


@pytest.mark.parametrize(("days", "operators", "treatments", "repetitions"), [(2, 2, 3, 2), (2, 3, 5, 2), (3, 2, 3, 3)])
def test_no_combination_is_on_one_day_or_with_one_operator_more_often_than_on_others(
    days: int, operators: int, treatments: int, repetitions: int
) -> None:
    factors = [Factor("Day", range(days)), Factor("Operator", range(operators)), Factor("P", range(treatments))]
    runs = RunTableModel(factors, repetitions=repetitions, design=Blocks("Day", "Operator")).plan()
    for kind in factors[:2]:
        often = Counter((run.combination[kind.name], run.combination["P"]) for run in runs)
        for planner in range(treatments):
            counts = [often[each, planner] for each in kind.treatments]
            assert max(counts) - min(counts) <= 1
        sizes = [sum(often[each, planner] for planner in range(treatments)) for each in kind.treatments]
        assert max(sizes) - min(sizes) <= 1


@settings(deadline=None, max_examples=25)
@given(st.integers(2, 7), st.data())
def test_the_efficiency_is_the_harmonic_mean_of_the_canonical_ones(treatments: int, data: st.DataObject) -> None:
    block = st.lists(st.integers(0, treatments - 1), min_size=1, max_size=6)
    blocks = [*data.draw(st.lists(block, min_size=1, max_size=6)), list(range(treatments))]
    incidence = np.array([[block.count(each) for block in blocks] for each in range(treatments)])
    replicates, sizes = incidence.sum(axis=1), incidence.sum(axis=0)
    scale = np.diag(replicates**-0.5)
    information = np.eye(treatments) - scale @ (incidence / sizes) @ incidence.T @ scale
    values = np.sort(np.linalg.eigvalsh(information))[1:]
    root = np.sqrt(replicates)[:, None]
    assert information @ root == pytest.approx(0, abs=1e-9)
    found = efficiency(treatments, blocks)
    assert found == pytest.approx((treatments - 1) / sum(1 / values))
    if len(set(replicates)) == 1:
        assert found <= efficiency_bound(treatments, blocks) + 1e-9


def test_blocks_that_cannot_be_are_findings() -> None:
    days, planners = Factor("Day", range(4)), Factor("Planner", ["A", "B", "C"])
    with pytest.raises(DesignError, match="3 runs are spread over 4 blocks"):
        RunTableModel([days, planners], design=Blocks("Day"))
    with pytest.raises(DesignError, match="never compared within one Day"):
        RunTableModel([Factor("Day", range(3)), Factor("P", range(3))], design=Blocks("Day"))
    with pytest.raises(DesignError, match="no factor is named"):
        RunTableModel([days, planners], design=Blocks())
    with pytest.raises(DesignError, match="'Day' is by already"):
        RunTableModel([days, planners], design=Blocks("Day", "Day"))
    with pytest.raises(DesignError, match="every combination is excluded"):
        RunTableModel([days, planners], [{"Planner": ["A", "B", "C"]}], design=Blocks("Day"))
