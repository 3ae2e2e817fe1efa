"""Two experiments are compared by what they have in common, and nothing is claimed that the runs do not show."""

from __future__ import annotations

import itertools
import json
import shutil

import numpy as np
import pytest
from scipy import stats
from statsmodels.stats.proportion import confint_proportions_2indep
from tests.analysis.experiment_folders import searched
from tests.analysis.made_experiment import make_experiment

from robot_runner.analysis.comparison.compared import Bound, Verdict
from robot_runner.analysis.comparison.comparing import compare
from robot_runner.analysis.comparison.comparison_document import (
    comparison_document,
    difference_table,
    json_of_comparison,
)
from robot_runner.analysis.comparison.equivalence import equivalent_proportions
from robot_runner.analysis.results import load_results
from robot_runner.core.design.factor import Factor
from robot_runner.core.errors import AnalysisError, StorageError


def shifted(values, by):
    return tuple(value + by for value in values)


VIDEO = (870.1, 872.4, 869.0, 874.2, 871.3)
NETWORK = (834.0, 836.1, 833.2, 838.0, 835.5)


def test_two_of_a_kind_are_equivalent_within_a_bound(two_tasks):
    comparison = compare(two_tasks().root, two_tasks(shifted(VIDEO, 0.8), shifted(NETWORK, -0.6)).root, bound="1%")
    assert comparison.verdict is Verdict.EQUIVALENT
    [energy] = comparison.measures
    assert [each.verdict for each in energy.differences] == [Verdict.EQUIVALENT] * 2
    assert energy.differences[0].difference == pytest.approx(0.8)
    assert energy.differences[0].bound == pytest.approx(8.714)
    assert "within the bound of 1 %" in energy.conclusion


def test_a_difference_beyond_the_bound_is_found(two_tasks):
    comparison = compare(two_tasks().root, two_tasks(shifted(VIDEO, 30.0)).root, bound="1%")
    by_label = {each.label: each for each in comparison.measure("Energy").differences}
    assert by_label["Video"].verdict is Verdict.DIFFERENT
    assert by_label["Video"].relative == pytest.approx(30.0 / 871.4 * 100)
    assert by_label["Network"].verdict is Verdict.EQUIVALENT
    assert comparison.verdict is Verdict.DIFFERENT
    assert "Different for Video" in comparison.measure("Energy").conclusion


def test_a_significant_difference_within_the_bound_does_not_matter(two_tasks):
    comparison = compare(two_tasks().root, two_tasks(shifted(VIDEO, 5.0), shifted(NETWORK, 5.0)).root, bound=20.0)
    video = comparison.measure("Energy").differences[0]
    assert video.adjusted_p_value < 0.05
    assert video.verdict is Verdict.EQUIVALENT


def test_too_few_runs_decide_nothing(two_tasks):
    comparison = compare(two_tasks().root, two_tasks(shifted(VIDEO, 1.5)).root, bound=2.0)
    assert comparison.measure("Energy").differences[0].verdict is Verdict.UNDECIDED
    assert "suffice neither" in comparison.measure("Energy").conclusion


@pytest.mark.parametrize(("many", "is_told"), [(9, True), (8, False)])
def test_two_or_three_runs_beside_many_are_told(two_tasks, many, is_told):
    first = two_tasks(tuple(870 + each * 37 % 11 for each in range(many)), NETWORK)
    notes = compare(first.root, two_tasks(VIDEO[:3], NETWORK).root).notes
    assert any(note.startswith("Video of ") and "3 runs, and others have 3 times" in note for note in notes) is is_told


def test_the_runs_that_do_not_suffice_are_those_of_both(two_tasks):
    conclusion = compare(two_tasks().root, two_tasks(VIDEO[:3], NETWORK).root, bound=0.1).measure("Energy").conclusion
    assert "(5 and 3 runs a combination)" in conclusion


def test_a_level_of_confidence_is_not_rounded(two_tasks):
    comparison = compare(two_tasks().root, two_tasks(shifted(VIDEO, 1.5)).root, alpha=0.001)
    assert "99.9% CI" in [column.name for column in difference_table(comparison, comparison.measure("Energy")).columns]


def test_without_a_bound_nothing_is_equivalent(two_tasks):
    comparison = compare(two_tasks().root, two_tasks().root)
    assert comparison.verdict is Verdict.UNDECIDED
    assert all(each.equivalence_p_value is None for each in comparison.measure("Energy").differences)
    assert "without a bound" in comparison.measure("Energy").conclusion


@pytest.mark.long
def test_the_narrow_interval_decides_as_the_two_tests_do(two_tasks):
    first = load_results(two_tasks().root)
    for shift in np.linspace(0.0, 6.0, 25):
        second = compare(first, two_tasks(shifted(VIDEO, shift)).root, bound=3.0)
        video = second.measure("Energy").differences[0]
        is_within = video.narrow_interval.low > -3.0 and video.narrow_interval.high < 3.0
        assert (video.equivalence_p_value < 0.05) == is_within


def test_p_values_are_adjusted_for_the_number_of_combinations(two_tasks):
    comparison = compare(two_tasks().root, two_tasks(shifted(VIDEO, 2.0), shifted(NETWORK, 1.0)).root)
    first, second = comparison.measure("Energy").differences
    assert first.p_value < second.p_value
    assert first.adjusted_p_value == pytest.approx(2 * first.p_value)
    assert second.adjusted_p_value == pytest.approx(max(second.p_value, first.adjusted_p_value))


def test_runs_within_one_experiment_are_pairs(make_folder):
    rows = [("a", 10.0, 10.6), ("a", 14.0, 14.5), ("b", 18.0, 18.4), ("b", 25.0, 25.5)]
    folder = make_folder(factors={"Task": ["a", "b"]}, rows=rows, measures={"Energy": "J", "Model": "J"})
    comparison = compare(folder.root, folder.root, measures=["Energy=Model"], bound="10%")
    assert comparison.is_paired
    assert (comparison.first.name, comparison.second.name) == ("Energy", "Model")
    [measure] = comparison.measures
    assert measure.name == "Energy and Model"
    assert measure.agreement.are_natural
    assert measure.agreement.bias == pytest.approx(0.5)
    assert measure.agreement.pairs["a"] == [(10.0, 10.6), (14.0, 14.5)]
    expected = np.mean([0.6 / 10, 0.5 / 14, 0.4 / 18, 0.5 / 25]) * 100
    assert measure.agreement.error == pytest.approx(expected)
    assert measure.differences[0].narrow_interval.method == "paired t"


def test_experiments_have_no_natural_pairs_unless_the_user_says_so(two_tasks):
    one, other = two_tasks().root, two_tasks(shifted(VIDEO, 1.0)).root
    assert not compare(one, other).measure("Energy").agreement.are_natural
    assert compare(one, other, is_paired=True).measure("Energy").agreement.are_natural


def test_the_relative_error_of_independent_runs_is_of_their_means(two_tasks):
    comparison = compare(two_tasks().root, two_tasks(shifted(VIDEO, 8.714)).root)
    assert comparison.measure("Energy").agreement.error == pytest.approx((1.0 + 0.0) / 2)


def test_a_relative_error_of_nothing_is_not_computed(two_tasks):
    comparison = compare(two_tasks(video=(0.0, 0.0)).root, two_tasks(video=(1.0, 2.0)).root)
    assert comparison.measure("Energy").agreement.error is None


def test_what_only_one_experiment_has_is_told(make_folder):
    one = make_folder(factors={"Task": ["a", "b"]}, rows=[("a", 1.0), ("a", 1.1), ("b", 2.0)], measures={"E": "J"})
    other = make_folder(
        factors={"Task": ["a", "c"], "Speed": ["x"]},
        rows=[("a", "x", 1.0), ("a", "x", 1.2), ("c", "x", 9.0)],
        measures={"E": "J"},
        name="other",
    )
    comparison = compare(one.root, other.root)
    assert [each.label for each in comparison.measure("E").differences] == ["a"]
    notes = " ".join(comparison.notes)
    assert "Only trial has b." in notes
    assert "Only other has c." in notes
    assert "Only other has the factor Speed" in notes


def test_experiments_without_a_factor_in_common_are_compared_as_a_whole(make_folder):
    one = make_folder(factors={"A": ["x"]}, rows=[("x", 1.0), ("x", 1.1)], measures={"E": "J"})
    other = make_folder(factors={"B": ["y"]}, rows=[("y", 1.0), ("y", 1.2)], measures={"E": "J"})
    comparison = compare(one.root, other.root)
    assert [each.label for each in comparison.measure("E").differences] == ["all runs"]
    assert any("no factor in common" in note for note in comparison.notes)


def test_units_that_differ_are_converted_and_told(make_folder):
    one = make_folder(factors={}, rows=[(1000.0,), (1100.0,)], measures={"E": "J"})
    other = make_folder(factors={}, rows=[(1.0,), (1.2,)], measures={"E": "kJ"}, name="other")
    comparison = compare(one.root, other.root)
    [difference] = comparison.measure("E").differences
    assert (difference.second_mean, difference.difference) == pytest.approx((1100.0, 50.0))
    assert any("J and kJ: values of other are converted to J" in note for note in comparison.notes)


def test_no_percentage_is_of_a_temperature_whose_0_is_agreed_upon(make_folder):
    degree = "\N{DEGREE SIGN}C"
    rows = [["Video", 20.1], ["Video", 19.9], ["Network", 24.0], ["Network", 24.1]]
    tasks, units = {"Task": ["Video", "Network"]}, {"Room": degree}
    one, other = (make_folder(factors=tasks, rows=rows, measures=units, name=name).root for name in ("one", "other"))
    [room] = compare(one, other, bound="5%", rope="2%").measures
    assert room.verdict is Verdict.UNDECIDED
    assert f"a percentage says nothing of values in {degree}" in room.conclusion
    assert {each.relative for each in room.differences} == {None}
    assert (room.agreement.error, {each.practical for each in room.differences}) == (None, {None})
    assert compare(one, other, bound=2.0).verdict is Verdict.EQUIVALENT


def test_a_share_in_percent_is_converted_to_one_of_one(make_folder):
    percent = make_folder(factors={}, rows=[(40.0,), (50.0,)], measures={"Load": "%"})
    share = make_folder(factors={}, rows=[(0.41,), (0.51,)], measures={"Load": "1"})
    for folders, difference in (((percent, share), 1.0), ((share, percent), -0.01)):
        [found] = compare(*(each.root for each in folders)).measure("Load").differences
        assert found.difference == pytest.approx(difference)


SEARCHED = [("a", 1, 9.0), ("b", 1, 9.9), ("a", 2, 5.0), ("a", 2, 5.2)]


def test_of_a_search_the_runs_that_confirm_it_are_compared(make_folder, tmp_path):
    other = make_folder(factors={"T": ["a", "b"]}, rows=[("a", 5.1), ("a", 5.2)], measures={"E": "J"}, name="other")
    comparison = compare(other.root, searched(tmp_path / "search", SEARCHED, is_confirmed=True))
    [difference] = comparison.measure("E").differences
    assert (difference.second_n, difference.second_mean) == (2, pytest.approx(5.1))
    assert difference.p_value is not None
    assert any("and not the 2 runs of it" in note for note in comparison.notes)


def test_a_search_that_nothing_confirms_is_not_tested(make_folder, tmp_path):
    other = make_folder(factors={"T": ["a", "b"]}, rows=[("a", 5.1), ("a", 5.2)], measures={"E": "J"})
    search = searched(tmp_path / "search", SEARCHED, is_confirmed=False)
    [difference] = compare(other.root, search, bound="5%").measure("E").differences
    assert (difference.p_value, difference.verdict) == (None, Verdict.UNDECIDED)
    assert "the best of many looks better than it is" in difference.not_computed


@pytest.mark.parametrize(("unit", "told"), [("V", "J and V"), ("", "J and not known")])
def test_units_that_cannot_be_converted_are_told_and_other_quantities_have_no_verdict(make_folder, unit, told):
    one = make_folder(factors={}, rows=[(1.0,), (1.1,)], measures={"E": "J"})
    other = make_folder(factors={}, rows=[(1.0,), (1.2,)], measures={"E": unit})
    found = compare(one.root, other.root, bound=1.0).measure("E")
    [missed] = found.not_computed
    assert told in missed.why
    assert (found.verdict is Verdict.UNDECIDED) is (unit == "V")


def test_origins_and_circumstances_that_differ_are_told(two_tasks):
    simulated = two_tasks(origin="simulated", name="other", manifest={"robot": "simulated", "seed": 8})
    comparison = compare(two_tasks().root, simulated.root)
    assert (comparison.measure("Energy").first_origin, comparison.measure("Energy").second_origin) == (
        "measured",
        "simulated",
    )
    assert ("Robot", "ros1", "simulated") in comparison.differing
    assert ("Seed of the order", "7", "8") in comparison.differing


def test_a_branch_that_was_another_commit_is_told_and_not_one_that_was_elsewhere(two_tasks):
    def at(commit, place):
        kept = {"repository": place, "commit": commit * 8, "build": "make", "path": "/tree"}
        revisions = {"Task": {"Video": kept, "Network": {**kept, "commit": "abcde" * 8}}}
        return two_tasks(name=commit, manifest={"revisions": revisions}).root

    compared = compare(at("12345", "lab.example/nav"), at("67890", "/srv/lab/nav"))
    assert [each for each in compared.differing if "Task" in each[0]] == [
        ("Task Video", "123451234512 (lab.example/nav)", "678906789067 (/srv/lab/nav)")
    ]


@pytest.mark.parametrize(
    ("video", "reason"),
    [((), "There are 0"), ((870.0,), "There are 1"), ((None, None), "There are 0")],
)
def test_without_runs_there_is_no_test_and_a_reason(two_tasks, video, reason):
    others = [value and value + 1 for value in video]
    comparison = compare(two_tasks(video=video).root, two_tasks(video=others).root, bound="5%")
    measure = comparison.measure("Energy")
    untested = [each for each in measure.differences if each.label == "Video"]
    assert all(each.p_value is None and each.equivalence_p_value is None for each in untested)
    assert all(each.verdict is Verdict.UNDECIDED and reason in each.not_computed for each in untested)
    json.loads(json_of_comparison(comparison))
    comparison_document(comparison, made="")


def test_values_that_are_all_equal_within_each_experiment_cannot_be_tested(two_tasks):
    comparison = compare(two_tasks(video=(1.0,) * 5).root, two_tasks(video=(1.1,) * 5).root, bound="20%")
    [video, _] = comparison.measure("Energy").differences
    assert video.p_value is None
    assert "equal" in video.not_computed
    assert video.verdict is Verdict.UNDECIDED
    assert "nothing could be tested for Video. Within each" in comparison.measure("Energy").conclusion


@pytest.mark.parametrize("count", [1, 5])
def test_values_that_are_all_equal_in_both_experiments_are_identical(two_tasks, count):
    ones = (1.0,) * count
    one, other = two_tasks(video=ones), two_tasks(video=ones, network=shifted(NETWORK, 0.1))
    energy = compare(one.root, other.root, bound="1%").measure("Energy")
    assert [each.verdict for each in energy.differences] == [Verdict.IDENTICAL, Verdict.EQUIVALENT]
    assert energy.verdict is Verdict.EQUIVALENT
    assert not energy.not_computed
    assert compare(one.root, other.root).measure("Energy").verdict is Verdict.UNDECIDED
    alike = compare(*(two_tasks(ones, ones).root for _ in range(2))).measure("Energy")
    assert (alike.verdict, alike.conclusion) == (Verdict.IDENTICAL, "Identical: no value differs, in any combination.")


def test_pairs_none_of_which_differ_are_identical(two_tasks):
    energy = compare(two_tasks().root, two_tasks().root, is_paired=True).measure("Energy")
    assert energy.verdict is Verdict.IDENTICAL
    swapped = (VIDEO[1], VIDEO[0], *VIDEO[2:])
    [video, _] = compare(two_tasks().root, two_tasks(swapped).root, is_paired=True).measure("Energy").differences
    assert video.verdict is Verdict.UNDECIDED


@pytest.mark.parametrize(("second", "verdict"), [(101.0, Verdict.EQUIVALENT), (150.0, Verdict.DIFFERENT)])
def test_simulated_values_without_any_spread_are_judged_without_a_test(two_tasks, second, verdict):
    simulated = {"robot": "simulated:seed=3"}
    folders = [two_tasks((value,) * 3, (7.0,) * 3, manifest=simulated).root for value in (100.0, second)]
    energy = compare(*folders, bound="5%").measure("Energy")
    assert (energy.differences[0].verdict, energy.verdict) == (verdict, verdict)
    [missed] = energy.not_computed
    assert (missed.what, "hold no chance" in missed.why) == ("test of Video", True)
    assert compare(*folders).measure("Energy").verdict is Verdict.UNDECIDED
    real = two_tasks((second,) * 3, (7.0,) * 3).root
    assert compare(folders[0], real, bound="5%").measure("Energy").verdict is Verdict.UNDECIDED


@pytest.mark.parametrize(("offset", "step"), [(2.0**53, 2.0), (1e6, 2.0**-30)])
def test_values_that_differ_by_too_little_beside_their_size_are_not_called_equal(two_tasks, offset, step):
    values = [offset + step * number for number in (0, 3, 1, 4, 2)]
    one, other = (two_tasks(video=[each + more * step for each in values]) for more in (0, 7))
    video = compare(one.root, other.root).measure("Energy").differences[0]
    assert "differ by too little relative to their size" in video.not_computed
    assert "equal" not in video.not_computed


@pytest.mark.parametrize(("size", "told"), [(1e300, "too large"), (1e-300, "too small")])
def test_values_that_cannot_be_computed_with_are_not_tested(two_tasks, size, told):
    odd = two_tasks(video=tuple(size * value for value in (1.0, 3.0, 2.0, 5.0, 4.0)))
    comparison = compare(odd.root, two_tasks().root, bound="5%")
    [video, network] = comparison.measure("Energy").differences
    assert video.p_value is None
    assert f"{told} to compute with" in video.not_computed
    assert video.verdict is Verdict.UNDECIDED
    assert network.p_value is not None
    json.loads(json_of_comparison(comparison), parse_constant=pytest.fail)


def test_experiments_without_a_run_that_is_done_are_undecided(two_tasks):
    nothing = dict.fromkeys(range(10), "-")
    comparison = compare(two_tasks(statuses=nothing).root, two_tasks().root, bound="5%")
    assert comparison.verdict is Verdict.UNDECIDED
    assert "no runs of the same combination" in comparison.measure("Energy").conclusion


def test_text_is_not_compared_as_numbers(make_folder):
    rows = [("a", "ok"), ("a", "stuck")]
    folder = make_folder(factors={"T": ["a"]}, rows=rows, measures={"State": ""}, types={"State": "string"})
    [difference] = compare(folder.root, folder.root).measure("State").differences
    assert difference.p_value is None
    assert "values that are not numbers" in difference.not_computed


def test_a_measure_that_is_not_there_is_named(two_tasks):
    one, other = two_tasks().root, two_tasks().root
    for measure in ("Enery", "Energy=Enery", "Enery=Energy"):
        with pytest.raises(AnalysisError, match="'Enery'") as caught:
            compare(one, other, measures=[measure])
        assert "'Energy'" in caught.value.fix


def test_experiments_without_a_measure_in_common_say_how_to_name_them(make_folder):
    one = make_folder(factors={}, rows=[(1.0,)], measures={"Energy": "J"})
    other = make_folder(factors={}, rows=[(1.0,)], measures={"E": "J"})
    with pytest.raises(AnalysisError) as caught:
        compare(one.root, other.root)
    assert "--measure Energy=E" in caught.value.fix


def test_a_bound_for_what_is_not_compared_is_refused(two_tasks):
    with pytest.raises(AnalysisError, match="'CPU'"):
        compare(two_tasks().root, two_tasks().root, bound=["CPU=5%"])


@pytest.mark.parametrize("alpha", [0.0, 0.5, 1.0, -1.0])
def test_an_alpha_that_cannot_be_is_refused(two_tasks, alpha):
    with pytest.raises(AnalysisError, match="alpha"):
        compare(two_tasks().root, two_tasks().root, alpha=alpha)


def test_a_folder_without_an_experiment_is_refused(two_tasks, tmp_path):
    with pytest.raises(StorageError):
        compare(two_tasks().root, tmp_path)


def test_experiments_of_one_name_are_told_apart(two_tasks):
    one, other = two_tasks(), two_tasks()
    comparison = compare(one.root, other.root)
    assert (comparison.first.name, comparison.second.name) == (one.root.name, other.root.name)
    assert compare(one.root, one.root).second.name == "second trial"


def test_bounds_may_be_given_for_each_measure(make_folder):
    rows = [(1.0, 50.0), (1.1, 51.0), (0.9, 49.0)]
    folder = make_folder(factors={}, rows=rows, measures={"E": "J", "CPU": "%"})
    comparison = compare(folder.root, folder.root, bound=["5%", "CPU=2"])
    assert comparison.measure("E").bound == Bound(5.0, is_relative=True)
    assert comparison.measure("CPU").bound == Bound(2.0)


def test_json_has_everything_and_no_nan(two_tasks):
    comparison = compare(two_tasks().root, two_tasks(video=(1.0,)).root, bound="5%")
    facts = json.loads(json_of_comparison(comparison), parse_constant=pytest.fail)
    assert facts["verdict"] == "undecided"
    assert facts["measures"][0]["differences"][1]["treatments"] == {"Task": "Network"}


def of_answers(root, yes, n):
    planner = Factor("Planner", ["DWB"])
    return make_experiment(
        root, [planner], lambda _, repetition: {"Success": repetition <= yes}, repetitions=n, measures=["Success"]
    ).root


@pytest.mark.long
def test_proportions_have_score_intervals_that_decide_as_their_tests_do(tmp_path):
    folders = of_answers(tmp_path / "one", 18, 20), of_answers(tmp_path / "other", 33, 40)
    (difference,) = compare(*folders, bound=0.25).measure("Success").differences
    ends = confint_proportions_2indep(33, 40, 18, 20, method="newcomb", compare="diff")
    assert (difference.interval.low, difference.interval.high) == pytest.approx(ends)
    narrow = confint_proportions_2indep(33, 40, 18, 20, method="newcomb", compare="diff", alpha=0.1)
    assert (difference.narrow_interval.low, difference.narrow_interval.high) == pytest.approx(narrow)
    assert difference.verdict is Verdict.EQUIVALENT
    for bound in (0.1, 0.2, -difference.narrow_interval.low + 0.001, -difference.narrow_interval.low - 0.001, 0.3):
        (again,) = compare(*folders, bound=bound).measure("Success").differences
        assert (again.equivalence_p_value < 0.05) is (-bound < again.narrow_interval.low)


def test_experiments_all_of_whose_runs_succeed_are_compared(tmp_path):
    (difference,) = (
        compare(of_answers(tmp_path / "one", 40, 40), of_answers(tmp_path / "other", 40, 40), bound=0.1)
        .measure("Success")
        .differences
    )
    assert (difference.difference, difference.p_value) == (0, 1)
    assert -0.1 < difference.interval.low < 0 < difference.interval.high < 0.1
    assert difference.verdict is Verdict.EQUIVALENT


def test_a_bound_that_every_proportion_is_within_shows_nothing(tmp_path):
    folders = of_answers(tmp_path / "one", 20, 20), of_answers(tmp_path / "other", 0, 20)
    for bound in (1, 10.0):
        measure = compare(*folders, bound=bound).measure("Success")
        assert measure.verdict is Verdict.DIFFERENT
        [missed] = measure.not_computed
        assert "o proportions differ by more than 1" in missed.why
    alike = compare(folders[0], folders[0], bound=10, is_paired=False).measure("Success")
    assert alike.verdict is Verdict.UNDECIDED
    assert "no proportions differ by more than 1" in alike.conclusion


def test_answers_have_no_limits_of_agreement_and_are_said_to_be_proportions(tmp_path):
    comparison = compare(of_answers(tmp_path / "one", 5, 9), of_answers(tmp_path / "other", 4, 9))
    measure = comparison.measure("Success")
    assert (measure.agreement.lower, measure.agreement.upper) == (None, None)
    assert measure.agreement.error == pytest.approx(20.0)
    assert "Newcombe's score intervals" in difference_table(comparison, measure).note
    page = repr(comparison_document(comparison, made=""))
    assert "Bland-Altman figure" not in page
    assert "Welch" not in page


def test_the_option_for_measures_of_other_names_is_quoted_where_a_shell_needs_it(make_folder):
    rows = [("a", value) for value in (1.0, 1.5, 2.0)]
    one = make_folder(factors={"T": ["a"]}, rows=rows, measures={"time (s)": "s"}, name="one").root
    other = make_folder(factors={"T": ["a"]}, rows=rows, measures={"time (ms)": "ms"}, name="other").root
    with pytest.raises(AnalysisError, match=r"--measure 'time \(s\)=time \(ms\)'\."):
        compare(one, other)


def test_values_some_of_which_are_texts_are_not_compared(make_folder):
    rows = [("a", "3"), ("a", "timeout"), ("a", "5"), ("a", "4")]
    mixed = make_folder(factors={"T": ["a"]}, rows=rows, measures={"Time": "s"}, types={"Time": "any"})
    numbers = make_folder(factors={"T": ["a"]}, rows=[("a", 3.0), ("a", 4.0), ("a", 5.5)], measures={"Time": "s"})
    for folders in ((mixed.root, numbers.root), (numbers.root, mixed.root)):
        [difference] = compare(*folders, bound="5%").measure("Time").differences
        assert difference.difference is None
        assert "values that are not numbers" in difference.not_computed


def test_what_one_experiment_does_not_measure_is_told(make_folder):
    rows = [("a", value, value + 1) for value in (1.0, 1.5, 2.0)]
    one = make_folder(factors={"T": ["a"]}, rows=rows, measures={"E": "J", "time_s": "s"}, name="one").root
    other = make_folder(factors={"T": ["a"]}, rows=rows, measures={"E": "J", "time_ms": "ms"}, name="other").root
    assert compare(one, other, bound="5%").notes == (
        "Only one has time_s, not compared.",
        "Only other has time_ms, not compared.",
        "If measures of other names are the same, say so: --measure time_s=time_ms.",
    )
    assert not compare(one, other, measures="E").notes, "as the user says"
    assert not any("not compared" in note for note in compare(one, one).notes)


def test_what_is_text_in_both_leaves_the_verdict_to_the_numbers(make_folder):
    rows = [("a", value, "left") for value in (1.0, 1.001, 1.002)]
    made = {"factors": {"T": ["a"]}, "measures": {"E": "J", "Robot": ""}, "types": {"Robot": "string"}}
    one, other = (make_folder(rows=rows, name=name, **made).root for name in ("one", "other"))
    found = compare(one, other, bound="5%")
    assert ([each.label for each in found.measures], found.verdict) == (["E (J)"], Verdict.EQUIVALENT)
    assert found.notes == ("No means are compared of what is text in both: Robot.",)
    assert compare(one, other, measures="Robot").verdict is Verdict.UNDECIDED


def test_of_several_measures_it_is_told_how_often_one_of_them_differs_by_chance(make_folder):
    values = ((1.0, 1.1), (1.2, 0.9), (0.9, 1.0), (1.1, 1.2))
    made = {"factors": {"T": ["a"]}, "measures": {"E": "J", "P": "W"}}
    one = make_folder(rows=[("a", *each) for each in values], name="one", **made).root
    other = make_folder(rows=[("a", first + 5, second) for first, second in values], name="other", **made).root
    (note,) = compare(one, other).notes
    assert note == (
        "2 measures are compared, each by itself at a level of 5%: where none differs, one of them is found to differ "
        "in 9.75% of comparisons; in fewer where they go together."
    )
    assert compare(one, other, measures="E").notes == ()
    assert compare(one, other, measures="P").notes == ()


def test_notes_tell_experiments_of_one_name_apart(make_folder):
    one = make_folder(factors={"T": ["a", "b"]}, rows=[("a", 1.0), ("b", 1.1)], measures={"E": "J"})
    other = make_folder(factors={"T": ["a", "c"]}, rows=[("a", 1.0), ("c", 1.2)], measures={"E": "kJ"})
    first, second, converted = compare(one.root, other.root).notes
    assert (first, second) == (f"Only {one.root.name} has b.", f"Only {other.root.name} has c.")
    assert f"values of {other.root.name} are converted" in converted


def test_doubtful_values_are_told(tmp_path):
    tasks = [Factor("Task", ["Video", "Network"])]
    one = make_experiment(tmp_path / "one", tasks, doubts={"r_2": "the sensor was stuck"}).root
    other = make_experiment(tmp_path / "other", tasks).root
    assert compare(one, other).notes == ("Energy of r_2 is doubtful in one, and counts all the same.",)
    assert compare(other, other).notes == ()


def test_doubtful_values_of_the_same_runs_are_told_together(tmp_path):
    def values(treatments, repetition):
        return {"Energy": 1.0, "CPU": 2.0}

    tasks = [Factor("Task", ["Video", "Network"])]
    doubts = {"r_2": "the sensor was stuck"}
    one, other = (
        make_experiment(
            tmp_path / name, tasks, values, measures=["Energy", "CPU"], doubts=doubts if is_odd else None
        ).root
        for name, is_odd in (("one", True), ("other", False))
    )
    assert compare(one, other).notes == ("Energy and CPU of r_2 are doubtful in one, and count all the same.",)


def test_values_that_the_plan_of_an_experiment_leaves_out_are_told(tmp_path):
    def values(treatments, repetition):
        return {"Energy": 900.0 if (treatments["Task"], repetition) == ("Video", 2) else 10.0 + repetition / 10}

    tasks = [Factor("Task", ["Video", "Network"])]
    plan = {"measures": ["Energy"], "doubtful": "leave out", "outliers": {"bounds": {"Energy": [0, 50]}}}
    one = make_experiment(tmp_path / "one", tasks, values, analysis=plan, doubts={"r_1": "hot", "r_4": "hot"}).root
    other = make_experiment(tmp_path / "other", tasks, values).root
    told = "Energy of r_1, r_4, r_3 is left out by the report of one, and counts all the same."
    assert compare(one, other, is_paired=True).notes == (told,)


def test_values_that_were_changed_by_hand_are_told(two_tasks):
    edited = two_tasks(shifted(VIDEO, 0.8))
    table = edited.files.run_table
    table.write_text(table.read_text().replace(",870.9", ",970.9"), encoding="utf-8")
    (note,) = (each for each in compare(two_tasks().root, edited.root).notes if "by hand" in each)
    assert note.startswith(
        f"Of {edited.root.name}, cells of runs that were executed were changed by hand: Energy of r_1"
    )


def test_values_that_were_changed_by_hand_and_accepted_are_told_as_well(two_tasks):
    accepted = two_tasks(shifted(VIDEO, 0.8))
    change = {"at": "2026-11-30T12:00:00.000Z", "run": "r_1", "column": "Energy", "was": "870.9", "is": "20.5"}
    manifest = json.loads(accepted.files.manifest.read_text(encoding="utf-8"))
    accepted.files.manifest.write_text(json.dumps(manifest | {"table_deviations": [change]}), encoding="utf-8")
    told = (
        f"Of {accepted.root.name}, cells were changed by hand in run_table.csv: Energy of r_1 from '870.9' to '20.5'."
    )
    assert told in compare(two_tasks().root, accepted.root).notes


def test_a_single_name_and_a_bound_of_numpy_are_taken_as_they_are(two_tasks):
    one, other = two_tasks().root, two_tasks().root
    plain = compare(one, other, measures=["Energy"], bound=5)
    for bound in (np.int64(5), np.float32(5)):
        assert compare(one, other, measures="Energy", bound=bound) == plain


@pytest.mark.parametrize(("n", "bound", "first", "second"), [(30, 50, 0.5, 0.75), (30, 25, 0.7, 0.875)])
def test_proportions_are_equivalent_within_a_percentage_by_chance_in_few_of_the_cases(n, bound, first, second):
    # Exactly: of all answers that so many runs may give where the second proportion lies at the bound.
    answers = [np.repeat([1.0, 0.0], [yes, n - yes]) for yes in range(n + 1)]
    chances = [stats.binom.pmf(range(n + 1), n, each) for each in (first, second)]
    within = Bound(bound, is_relative=True)
    rate = sum(
        chances[0][one] * chances[1][other]
        for one, other in itertools.product(range(1, n + 1), range(n + 1))
        if chances[0][one] * chances[1][other] > 1e-6
        and equivalent_proportions(answers[one], answers[other], within) < 0.05
    )
    assert 0.03 < rate < 0.06


def copied(root):
    return shutil.copytree(root, root.with_name(f"{root.name}_copied"))


def test_a_copy_of_an_experiment_is_told_to_be_one(two_tasks):
    original = two_tasks().root
    comparison = compare(original, copied(original), bound="1%")
    told = comparison.again
    assert "two_tasks_1_copied is two_tasks_1 again: the runs were executed at the same times" in told
    assert told.endswith("That values agree proves nothing.")
    assert told in repr(comparison_document(comparison, made=""))


def test_a_copy_is_told_to_be_one_whatever_is_compared(make_folder):
    rows = [("a", 10.0, 10.6), ("a", 14.0, 14.5), ("b", 18.0, 18.4), ("b", 25.0, 25.5)]
    original = make_folder(factors={"Task": ["a", "b"]}, rows=rows, measures={"Energy": "J", "Model": "J"}).root
    told = compare(original, copied(original), measures=["Energy=Model"]).again
    assert "Compare measures of one experiment within one folder, where runs are pairs." in told


def test_a_simulation_with_the_same_seed_is_told_to_be_the_same(two_tasks):
    told = compare(two_tasks().root, two_tasks(day="2026-02-01").root, bound="1%").again
    assert "every value is the same to the last digit, as of a copy, or a simulation with the same seed" in told
    assert told.endswith("That values agree tells nothing of runs that differ by chance.")


def test_measures_that_are_the_same_in_each_run_are_told_where_others_differ(make_folder):
    # As a replication computes again what follows from the seed, beside what the machine took for it.
    rows = [("a", 10.5, 3.1, 1.5), ("a", 14.5, 3.2, 1.5), ("b", 18.5, 3.3, 2.5), ("b", 25.5, 3.4, 2.5)]
    settings = {"factors": {"Task": ["a", "b"]}, "measures": {"Energy": "J", "Time": "s", "Step": "m"}}
    original = make_folder(rows=rows, **settings).root
    others = [(task, energy, time + 0.05, step) for task, energy, time, step in rows]
    told = compare(original, make_folder(rows=others, day="2026-02-01", **settings).root, bound="5%").again
    assert told == (
        "experiment_2 has the values of experiment_1 again, of Energy: every value is the same to the last digit, as of"
        " a copy, or a simulation with the same seed. That they agree tells nothing of runs that differ by chance, and"
        " the tests take them for independent, which they are not."
    )
    others = [(task, energy + 0.05, time + 0.05, step) for task, energy, time, step in rows]
    assert compare(original, make_folder(rows=others, day="2026-02-01", **settings).root).again == ""


def test_an_experiment_of_which_some_runs_were_repeated_is_told_to_be_the_other_in_the_rest(two_tasks):
    # As a table is published once more after its outliers were measured again.
    video, network = (870.1, 872.4, 869.3, 874.2, 871.3), (834.6, 836.1, 833.2, 838.7, 835.5)
    first = two_tasks(video, network).root
    told = compare(first, two_tasks((*video[:4], 871.9), network, day="2026-02-01").root).again
    assert told.startswith(
        "two_tasks_2 is two_tasks_1 again in 9 of 10 runs: every value is the same to the last digit"
    )
    assert told.endswith("the tests take the two experiments for independent, which they are not.")
    assert compare(first, two_tasks((875.0, 873.1, *video[2:]), network[::-1], day="2026-02-01").root).again == ""
    rounded = two_tasks((0.5, 0.5, 0.5, 0.5, 0.5), (0.7, 0.7, 0.7, 0.7, 0.9)).root
    assert compare(rounded, two_tasks((0.5,) * 5, (0.7,) * 5, day="2026-02-01").root).again == ""


def test_a_measure_compared_with_itself_is_told(two_tasks):
    root = two_tasks().root
    told = compare(root, root, bound="1%").again
    assert "both are the same folder" in told


def test_measures_of_one_experiment_are_compared_without_such_a_word(make_folder):
    rows = [("a", 10.0, 10.6), ("a", 14.0, 14.5), ("b", 18.0, 18.4), ("b", 25.0, 25.5)]
    root = make_folder(factors={"Task": ["a", "b"]}, rows=rows, measures={"Energy": "J", "Model": "J"}).root
    assert compare(root, root, measures=["Energy=Model"]).again == ""
    assert compare(root, root, measures=["Energy=Model", "Energy"]).again
