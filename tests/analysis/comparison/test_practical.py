"""How probable it is that a difference does not matter, against a posterior that was drawn, and in closed form."""

from __future__ import annotations

import copy
import json

import numpy as np
import pytest
from scipy import stats
from tests.analysis.comparison.combined_agreement import disagreements_of_two

from robot_runner.analysis.comparison.compared import Bound, Verdict
from robot_runner.analysis.comparison.comparing import compare
from robot_runner.analysis.comparison.comparison_document import comparison_document, json_of_comparison
from robot_runner.analysis.comparison.equivalence import Regions, equivalence_p_value, practical_equivalence
from robot_runner.core.errors import AnalysisError

FIRST = np.array([870.1, 872.4, 869.0, 874.2, 871.3])
SECOND = np.array([871.0, 877.9, 868.4, 876.1, 880.3, 872.2, 871.7])
DRAWS = 400_000


def drawn(values, random):
    """Draw means from the posterior under the prior 1 / sd: first the variance, then the mean."""
    count = len(values)
    variances = (count - 1) * values.var(ddof=1) / random.chisquare(count - 1, DRAWS)
    return random.normal(values.mean(), np.sqrt(variances / count))


@pytest.mark.parametrize("bound", [Bound(2.0), Bound(5.0), Bound(0.3, is_relative=True), Bound(40.0, is_relative=True)])
@pytest.mark.parametrize("scale", [1.0, -1.0, 30.0])
def test_probabilities_are_those_of_a_posterior_that_was_drawn(bound, scale):
    # Scaled about its mean the second experiment varies much more than the first; or the first mean is negative.
    first = FIRST * (-1 if scale < 0 else 1)
    second = SECOND * (-1 if scale < 0 else 1)
    second = second.mean() + abs(scale) * (second - second.mean())
    found = practical_equivalence(first, second, bound, alpha=0.05, is_paired=False)
    random = np.random.default_rng(42)
    one, other = drawn(first, random), drawn(second, random)
    half = np.abs(one) * bound.value / 100 if bound.is_relative else bound.value
    expected = [np.mean(other < one - half), np.mean(np.abs(other - one) <= half), np.mean(other > one + half)]
    assert [found.below, found.within, found.above] == pytest.approx(expected, abs=0.004)
    assert found.below + found.within + found.above == pytest.approx(1.0)
    ends = np.quantile(other - one, [0.025, 0.975])
    assert (found.interval.low, found.interval.high) == pytest.approx(ends, abs=0.02 * (ends[1] - ends[0]))


def test_of_one_spread_much_smaller_the_posterior_is_students_t():
    sharp = 10.0 + 1e-9 * np.arange(5)
    values = np.array([10.2, 11.0, 9.4, 10.9, 10.1])
    found = practical_equivalence(sharp, values, Bound(0.5), alpha=0.1, is_paired=False)
    posterior = stats.t(4, values.mean() - 10, stats.sem(values))
    assert found.below == pytest.approx(posterior.cdf(-0.5), abs=1e-6)
    assert found.above == pytest.approx(posterior.sf(0.5), abs=1e-6)
    assert (found.interval.low, found.interval.high) == pytest.approx(posterior.interval(0.9), abs=1e-6)


@pytest.mark.parametrize("bound", [Bound(0.8), Bound(8.0, is_relative=True)])
def test_of_pairs_the_larger_tail_is_the_p_value_of_equivalence(bound):
    first, second = FIRST / 80, FIRST / 80 + np.array([0.3, -0.2, 0.6, 0.1, 0.5])
    found = practical_equivalence(first, second, bound, alpha=0.05, is_paired=True)
    assert max(found.below, found.above) == pytest.approx(equivalence_p_value(first, second, bound, is_paired=True))
    interval = stats.ttest_rel(second, first).confidence_interval(0.95)
    assert (found.interval.low, found.interval.high) == pytest.approx((interval.low, interval.high))


def test_two_runs_say_little():
    found = practical_equivalence(np.array([1.0, 1.1]), np.array([1.0, 1.2]), Bound(0.05), alpha=0.05, is_paired=False)
    assert 0.1 < found.within < 0.6
    assert found.interval.high - found.interval.low > 1


def test_values_that_do_not_vary_have_no_posterior(two_tasks):
    assert practical_equivalence(np.ones(4), FIRST, Bound(1.0), alpha=0.05, is_paired=False) is None
    assert practical_equivalence(FIRST, FIRST + 1.0, Bound(1.0), alpha=0.05, is_paired=True) is None
    measure = compare(two_tasks(video=(1.0,) * 5).root, two_tasks().root, rope="5%").measure("Energy")
    assert measure.differences[0].practical is None
    assert any(each.what == "probabilities of Video" for each in measure.not_computed)


def test_a_comparison_tells_probabilities_and_its_verdict_stays(two_tasks):
    one, other = two_tasks().root, two_tasks(tuple(FIRST + 1.0)).root
    without, found = compare(one, other, bound="1%"), compare(one, other, bound="1%", rope=["3 J"])
    assert found.verdict is without.verdict is Verdict.EQUIVALENT
    energy = found.measure("Energy")
    assert energy.region == Bound(3.0)
    least = min(energy.differences, key=lambda each: each.practical.within)
    assert f"is {least.practical.within:.3f} (least of all combinations: {least.label})" in energy.conclusion
    table = next(each for each in comparison_document(found, made="").tables if each.name == "difference Energy")
    assert [column.name for column in table.columns][-3:] == ["P, below", "P, within", "P, above"]
    assert "prior" in table.note
    facts = json.loads(json_of_comparison(found), parse_constant=pytest.fail)
    told = facts["measures"][0]["differences"][0]["practical"]
    assert told["region"] == 3.0
    assert told["below"] + told["within"] + told["above"] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("texts", "measure", "unit", "expected"),
    [
        (["2%"], "Energy", "J", Bound(2.0, is_relative=True)),
        (["2 %"], "CPU", "%", Bound(2.0, is_relative=True)),
        (["5 J"], "Energy", "kJ", Bound(0.005)),
        (["5J", "3 ms"], "Time", "s", Bound(0.003)),
        (["5 J"], "CPU", "%", None),
        (["5 J", "1%"], "CPU", "%", Bound(1.0, is_relative=True)),
        (["1", "Energy=5"], "Energy", "J", Bound(5.0)),
        (["2 degC"], "Temperature", "K", Bound(2.0)),
        ([], "Energy", "J", None),
    ],
)
def test_a_region_is_in_the_unit_of_the_measure(texts, measure, unit, expected):
    found = Regions.parse(texts).of(measure, unit)
    if expected is None:
        assert found is None
    else:
        assert found.is_relative is expected.is_relative
        assert found.value == pytest.approx(expected.value)


@pytest.mark.parametrize(
    ("rope", "problem", "fix"),
    [
        ("five", "'five' is not a region", "--rope 2%"),
        ("-2%", "'-2%' is not a region", "--rope 2%"),
        ("0", "the region is 0", "--rope 2%"),
        ("200%", "the region is 200%", "--rope 2%"),
        ("5 Jule", "'Jule' is not a unit", ""),
        (["1%", "2%"], "second region", "Leave one"),
        ("5 V", "no measure that is compared can be in V", "They are in J"),
        ("Energy=5 V", "the region of Energy is in V", "--rope Energy=2%"),
        ("CPU=5", "a region is given for 'CPU'", "Compared are: Energy"),
    ],
)
def test_what_is_no_region_is_refused_with_a_way_out(two_tasks, rope, problem, fix):
    with pytest.raises(AnalysisError, match=r"region|unit|measure") as caught:
        compare(two_tasks().root, two_tasks().root, rope=rope)
    assert problem in caught.value.problem
    assert fix in caught.value.fix


@pytest.mark.parametrize("shift", [0.0, 0.8, 3.0, 30.0])
@pytest.mark.parametrize(
    "settings", [{}, {"bound": "1%", "rope": "1%"}, {"bound": 3.0, "rope": ["3 J"], "is_paired": True}]
)
def test_a_comparison_of_two_agrees_with_itself(two_tasks, shift, settings):
    random = np.random.default_rng(int(10 * shift))
    video, network = (tuple(base + shift + 2 * random.normal(size=5)) for base in (871.0, 835.0))
    comparison = compare(two_tasks().root, two_tasks(video, network).root, **settings)
    assert disagreements_of_two(json.loads(json_of_comparison(comparison))) == []


def test_what_contradicts_itself_in_a_comparison_of_two_is_found(two_tasks):
    facts = json.loads(json_of_comparison(compare(two_tasks().root, two_tasks(tuple(FIRST + 9)).root, rope="3 J")))
    assert disagreements_of_two(facts) == []
    for change in (
        lambda measure: measure.update(verdict="equivalent"),
        lambda measure: measure.update(conclusion="Equivalent."),
        lambda measure: measure["differences"][0].update(p_value=0.9),
        lambda measure: measure["differences"][0].update(verdict="undecided"),
        lambda measure: measure["differences"][0].update(difference=-9.0),
        lambda measure: measure["differences"][0]["practical"].update(within=0.9),
    ):
        other = copy.deepcopy(facts)
        change(other["measures"][0])
        assert disagreements_of_two(other)
