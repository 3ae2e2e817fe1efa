"""What a rule of repetition says, where it does not fit, and what is known after the repetitions that there are."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.core.design.asking import Told
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.numeric_range import Range
from robot_runner.core.design.precise_estimates import Judgement, Observed, UntilPrecise, judge, uncompared
from robot_runner.core.design.precision import (
    PreciseOf,
    Precision,
    precision_findings,
    rule_in_words,
    rules_as_mapping,
    rules_of_mapping,
)
from robot_runner.core.design.repeated_intervals import half_width_of, level_at_each_look
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import DesignError
from robot_runner.designs import CentralComposite

if TYPE_CHECKING:
    from collections.abc import Mapping


def rule(half_width: str | float = "2 %", at_most: int = 30, **more: Any) -> Precision:
    return Precision("Energy", half_width=half_width, at_most=at_most, **more)


def judged(values: Mapping[Any, list[Any]], asked: Precision, least: int = 5) -> Judgement:
    runs = [
        Observed(f"r_{place}_{number}", dict(zip(("Task", "Speed"), treatments, strict=False)), number, value)
        for place, (treatments, found) in enumerate(values.items())
        for number, value in enumerate(found, start=1)
    ]
    return judge(asked, (least, asked.at_most), max(map(len, values.values())), runs)


@pytest.mark.parametrize(
    ("given", "is_relative", "unit"), [("2 %", True, ""), ("2%", True, ""), ("5 J", False, "J"), (0.5, False, "")]
)
def test_a_half_width_is_a_share_or_in_a_unit(given: Any, is_relative: bool, unit: str) -> None:
    found = rule(given)
    assert (found.is_relative, found.unit) == (is_relative, unit)
    assert Precision.of_mapping(found.as_mapping()) == found


def test_what_cannot_be_is_refused_all_at_once() -> None:
    with pytest.raises(DesignError) as refused:
        Precision("", half_width="two", at_most=True, of="mean")
    problems = [finding.problem for finding in refused.value.findings]
    assert problems == ["the measure is ''", "half_width is 'two'", "at_most is True", "of is 'mean'"]
    assert refused.value.findings[-1].fix == "Did you mean 'means'?"
    for wrong in ({"half_width": 0}, {"half_width": "-2 %"}, {"at_most": 2}, {"at_most": 201}):
        with pytest.raises(DesignError):
            rule(**{"half_width": "2 %", "at_most": 30, **wrong})


def test_a_rule_that_does_not_fit_the_design_is_found() -> None:
    units = {"Energy": "J", "Count": ""}
    rules = [rule("5 mJ"), Precision("Enrgy", half_width=1, at_most=4), Precision("Count", half_width="1 m", at_most=9)]
    found = {finding.problem: finding.fix for finding in precision_findings("here", rules, 5, units)}
    assert found == {
        "half_width is '5 mJ', and Energy has J": "Give it as a share ('2 %'), or in the measure's unit (J).",
        "there is no measure 'Enrgy'": "Did you mean 'Energy'?",
        "at_most is 4, and 5 repetitions are planned": (
            "Plan fewer repetitions, or allow more: at_most counts all of them."
        ),
        "half_width is '1 m', and Count has no unit": "Give it as a share ('2 %'), or in the measure's unit (no unit).",
    }
    few = {
        repetitions: [each.severity.value for each in precision_findings("here", [rule()], repetitions, units)]
        for repetitions in (1, 2, 3, 4, 5)
    }
    assert few == {1: ["error"], 2: ["error"], 3: ["warning"], 4: ["warning"], 5: []}


def test_a_percentage_of_a_temperature_is_warned_of() -> None:
    found = precision_findings(
        "here", [Precision("Room", half_width="2 %", at_most=9)], 5, {"Room": "\N{DEGREE SIGN}C"}
    )
    [told] = [(each.severity.value, each.fix) for each in found]
    assert told == ("warning", "Give it in the measure's unit, such as '1 \N{DEGREE SIGN}C'.")
    assert not Precision("Room", half_width="1 \N{DEGREE SIGN}C", at_most=9).is_relative


def test_each_combination_is_known_by_itself() -> None:
    values = {("Video",): [200.0, 202, 198, 201, 199], ("Idle",): [10.0, 20, 5, 12, 30]}
    found = judged(values, rule("5 %"))
    level = level_at_each_look(5, 30)
    assert [(each.of, each.n, each.is_precise) for each in found.known] == [("Video", 5, True), ("Idle", 5, False)]
    assert found.known[0].half_width == pytest.approx(half_width_of(values["Video",], level))
    assert found.known[0].wanted == pytest.approx(10.0)
    assert found.needs_more
    assert found.in_words() == "Energy: ± 141 % for Idle, ± 5 % is wanted (1 of 2 means precise)"


def test_of_a_half_width_in_a_unit_the_widest_is_told_in_that_unit() -> None:
    found = judged({("Video",): [200.0, 202, 198, 201, 199], ("Idle",): [10.0, 20, 5, 12, 30]}, rule("4 J"))
    assert found.in_words() == "Energy: ± 21.7 J for Idle, ± 4 J is wanted (1 of 2 means precise)"


def test_differences_are_those_within_repetitions() -> None:
    drift = [0.0, 50, 100, 150, 200]
    values = {
        ("Video", "1"): [300 + each for each in drift],
        ("Idle", "1"): [101 + each for each in drift],
        ("Video", "2"): [310 + each + (-1) ** place for place, each in enumerate(drift)],
        ("Idle", "2"): [None, *(103 + each for each in drift[1:])],
    }
    found = judged(values, rule("5 J", of="differences"))
    by_name = {each.of: each for each in found.known}
    assert set(by_name) == {"Video - Idle", "1 - 2"}
    assert by_name["Video - Idle"].n == 4, "a repetition that lacks a value yields no difference"
    assert by_name["Video - Idle"].mean == pytest.approx((199 + 207) / 2)
    assert found.is_precise, "what changes from one repetition to the next falls out"
    assert not judged(values, rule("5 J", of=PreciseOf.MEANS)).is_precise


@pytest.mark.parametrize(
    ("values", "asked", "problem"),
    [
        ({("Video",): [-1.0, 1, -1, 1, 0]}, "2 %", "Video: the mean is 0, of which 2 % is not a width"),
        ({("Video",): [1.0, 2, 3, 4, 5], ("Idle",): [None] * 5}, "2 %", "Idle: no run has a value of Energy"),
        ({("Video",): [1.0, "high", 3, 4, 5]}, "2 %", "r_0_2 has 'high', which is not a number"),
        ({("Video",): [True] * 5}, "2 %", "r_0_1 has True, which is not a number"),
        ({("Video",): [1.0, -1e308, 2, 3, 4]}, "2 %", "r_0_2 has -1e+308, which is too large to compute with"),
    ],
)
def test_what_cannot_be_known_ends_the_repetition(values: Any, asked: str, problem: str) -> None:
    found = judged(values, rule(asked))
    assert found.problems == (problem,)
    assert not found.needs_more


def test_a_measure_that_cannot_be_judged_is_named_once() -> None:
    found = judged({("Video",): [True] * 5}, rule())
    assert found.in_words() == "Energy: r_0_1 has True, which is not a number"


def test_values_that_are_all_the_same_are_precise_and_odd() -> None:
    found = judged({("Video",): [7.0] * 5}, rule())
    assert found.is_precise
    assert found.known[0].oddity == "all 5 values are 7, so that nothing tells their spread"


def test_it_has_to_remain_precise_for_three_more_repetitions() -> None:
    looks = {
        (100.0, 101, 99, 100, 101): 1,
        (100.0, 101, 99, 100, 101, 100, 99): 3,
        (100.0, 101, 99, 100, 101, 100, 99, 100): 4,
        (100.0, 101, 99, 100, 101, 100, 99, 100, 101): 4,
        (100.0, 101, 99, 100, 101, 100, 115, 100): 0,
    }
    found = {values: judged({("Video",): list(values)}, rule("4 %")) for values in looks}
    assert {values: each.in_a_row for values, each in found.items()} == looks
    assert {values: each.needs_more for values, each in found.items()} == {
        values: in_a_row < 4 for values, in_a_row in looks.items()
    }
    assert "1 of 1 mean precise, 3 of 4 looks in a row" in found[100.0, 101, 99, 100, 101, 100, 99].in_words()
    assert not judged({("Video",): [100.0, 101, 99, 100, 101, 100]}, rule("4 %", at_most=6)).needs_more


def test_one_value_is_too_few_and_at_most_is_the_end() -> None:
    few = judged({("Video",): [7.0, None, None, None, None]}, rule())
    assert few.known[0].half_width is None
    assert few.needs_more
    assert not judged({("Video",): [1.0, 90, 4]}, rule(at_most=3), least=3).needs_more


def test_differences_of_nothing_are_no_precision() -> None:
    found = judged({("Video",): [1.0, 2, 3]}, rule(of="differences"))
    assert not found.is_precise
    assert not found.needs_more
    assert found.problems


def test_the_rule_says_how_often_at_least_and_at_most() -> None:
    rules = [rule(), Precision("Time", half_width="1 s", at_most=12, of="differences")]
    assert rule_in_words(rules, 5) == (
        "until the mean of Energy in each combination is known to ± 2 % and each difference of Time between treatments "
        "is known to ± 1 s; at least 5, at most 30 repetitions"
    )
    assert rule_in_words((), 5) == ""


def test_rules_come_back_from_what_is_kept_and_damaged_ones_are_refused() -> None:
    rules = (rule("5 J"), rule("2 %", of="differences"))
    assert rules_of_mapping(rules_as_mapping(rules, 5)) == (rules, 5)
    assert rules_of_mapping(rules_as_mapping((), 5)) == ((), 0)
    for damaged in (3, {}, {"rules": 1, "least": 5}, {"rules": [{}], "least": 5}, {"rules": [], "least": "few"}):
        with pytest.raises(DesignError, match="rules of repetition are damaged"):
            rules_of_mapping(damaged)


def test_a_rule_comes_back_from_the_manifest_to_the_last_digit() -> None:
    for half_width in (0.1, 1234567.8, 0.123456789, 1e-9):
        rule = Precision("Energy", half_width=half_width, at_most=30)
        assert Precision.of_mapping(rule.as_mapping()) == rule
    assert Precision("Energy", half_width=5, at_most=30).wanted_in_words == "5"


def test_treatments_of_different_batches_have_no_difference() -> None:
    observed = [
        Observed(f"{task}{speed}_{number}", {"Task": task, "Speed": speed}, number, 10 + number % 2, batch)
        for task in "ab"
        for speed, batch in (("1", 1), ("2", 1), ("3", 2))
        for number in range(1, 7)
    ]
    rule = Precision("Energy", half_width=1, at_most=30, of="differences")
    known = {each.of: each.n for each in judge(rule, (5, 30), 6, observed).known}
    assert known == {"a - b": 6, "1 - 2": 6}
    later = [Observed(f"later_{each.run_id}", each.treatments, each.repetition + 6, each.value, 3) for each in observed]
    known = {each.of: each.n for each in judge(rule, (5, 30), 12, [*observed, *later]).known}
    assert known == {"a - b": 12, "1 - 2": 12, "1 - 3": 6, "2 - 3": 6}


def test_another_repetition_of_a_surface_has_all_its_centre_points() -> None:
    factors = [Factor(name, Range(0, 1, step=0.1)) for name in "XY"]
    model = RunTableModel(factors, repetitions=3, design=CentralComposite(centre=4))
    told = [Told(run, {"Energy": float(run.number)}) for run in model.plan()]
    decision = UntilPrecise([rule(at_most=4)], model.factors, 3).ask(told)
    planned = [run.combination.texts for run in model.plan() if run.repetition == 1]
    assert Counter(combination.texts for combination, _ in decision.runs) == Counter(planned)
    assert {repetition for _, repetition in decision.runs} == {4}


def test_differences_that_no_two_runs_have_are_warned_of() -> None:
    factors = [Factor("Robot", ["a", "b"]), Factor("Gripper", ["u", "v"], when={"Robot": "a"})]
    combinations = [run.combination for run in RunTableModel(factors).plan()]
    (finding,) = uncompared("repeat_until", [rule(of="differences")], combinations)
    assert finding.problem.endswith("differ in other factors, too: a - b of Robot")
    assert not [*uncompared("repeat_until", [rule()], combinations)]
    crossed = RunTableModel([factors[0], Factor("Floor", ["wood", "tiles"])]).plan()
    assert not [*uncompared("repeat_until", [rule(of="differences")], (run.combination for run in crossed))]
