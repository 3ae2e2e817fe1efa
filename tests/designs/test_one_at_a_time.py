"""One factor at a time: a base, and what differs from it in one factor."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
from tests.designs.factor_sets import factors_of, findings_of, rows_of

from robot_runner import INACTIVE, Factor, Range, RunTableModel
from robot_runner.designs import OneFactorAtATime


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(1, 5), min_size=1, max_size=6), st.randoms(use_true_random=False))
def test_each_treatment_of_each_factor_is_there_once_beside_the_base(levels: list[int], random: object) -> None:
    factors = factors_of(levels)
    base = tuple(random.choice(factor.treatments) for factor in factors)
    named = {factor.name: each for factor, each in zip(factors, base, strict=True)}
    rows = rows_of(RunTableModel(factors, design=OneFactorAtATime(base=named)))
    assert rows[0] == base
    assert len(set(rows)) == len(rows) == 1 + sum(count - 1 for count in levels)
    assert all(sum(one != other for one, other in zip(row, base, strict=True)) == 1 for row in rows[1:])


def test_the_base_may_lie_within_a_range_and_decide_which_factors_apply() -> None:
    factors = [
        Factor("Speed", Range(0.05, 0.22, unit="m/s")),
        Factor("Sensor", ["camera", "lidar"]),
        Factor("Resolution", ["720p", "1080p"], when={"Sensor": "camera"}),
    ]
    model = RunTableModel(factors, design=OneFactorAtATime(base={"Speed": 0.1}))
    assert rows_of(model) == [
        (0.1, "camera", "720p"),
        (0.05, "camera", "720p"),
        (0.22, "camera", "720p"),
        (0.1, "lidar", INACTIVE),
        (0.1, "camera", "1080p"),
    ]
    assert model.factors[0].treatments == (0.05, 0.1, 0.22)
    other = RunTableModel(factors, design=OneFactorAtATime(base={"Sensor": "lidar"}))
    assert [row[2] for row in rows_of(other)] == [INACTIVE, INACTIVE, INACTIVE, "720p"]
    assert "Resolution" in str(other.warnings[0])


def test_a_wrong_base_is_told_with_what_is_near() -> None:
    factors = [*factors_of([2, 2]), Factor("Speed", Range(0, 5))]
    assert findings_of(factors, design=OneFactorAtATime(base={"F0": "t9", "Spede": 1, "Speed": 7})) == [
        "base['F0']: 't9' is not a treatment of factor 'F0' → Choose one of: 't0', 't1'.",
        "base['Spede']: there is no factor 'Spede' → Did you mean 'Speed'?",
        "base['Speed']: 7 is not a treatment of factor 'Speed' → Give a number from 0 to 5.",
    ]
    steps = [Factor("Speed", Range(0.0, 1.0, step=0.5)), Factor("Robots", Range(1, 9)), *factors_of([2])]
    assert findings_of(steps, design=OneFactorAtATime(base={"Speed": 0.3, "Robots": 2.5})) == [
        (
            "base['Speed']: 0.3 is not a treatment of factor 'Speed' → Give a number from 0.0 to 1.0 in steps of 0.5, "
            "such as 0.5."
        ),
        (
            "base['Robots']: 2.5 is not a treatment of factor 'Robots' → "
            "Give a number from 1 to 9 in steps of 1, such as 3."
        ),
    ]
    assert "is of type list" in findings_of(factors, design=OneFactorAtATime(base=["t0"]))[0]


def test_treatments_that_are_equal_or_have_no_hash_are_all_there() -> None:
    factors = [Factor("Level", [1, True, 2]), Factor("Route", [["door"], ["lift", "door"]])]
    assert rows_of(RunTableModel(factors, design=OneFactorAtATime())) == [
        (1, ["door"]),
        (True, ["door"]),
        (2, ["door"]),
        (1, ["lift", "door"]),
    ]


def test_excluded_treatments_are_left_out() -> None:
    model = RunTableModel(factors_of([3, 2]), [{"F0": "t2"}], design=OneFactorAtATime())
    assert [row[0] for row in rows_of(model)] == ["t0", "t1", "t0"]
    assert "compared with nothing" in str(model.warnings[0])


def test_it_is_said_that_nothing_is_compared_where_the_base_is_excluded() -> None:
    model = RunTableModel(factors_of([2, 2]), [{"F0": "t0", "F1": "t0"}], design=OneFactorAtATime())
    assert rows_of(model) == [("t1", "t0"), ("t0", "t1")]
    assert "the base is one of them" in str(model.warnings[0])
