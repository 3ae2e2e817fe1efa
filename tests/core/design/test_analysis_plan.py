"""What is fixed for the analysis before the experiment is checked, and survives the manifest."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.core.design.analysis_plan import AnalysisPlan, Correction, Estimand, Family, Statistic
from robot_runner.core.design.hypothesis import Hypothesis
from robot_runner.core.design.outliers import Doubtful, Outliers
from robot_runner.core.errors import DesignError

NAMES = st.text(min_size=1, max_size=8).filter(lambda name: name.strip())
EFFECTS = st.builds(Hypothesis, NAMES, measure=NAMES, factors=st.lists(NAMES, min_size=1, max_size=3, unique=True))
CONTRASTS = st.builds(
    Hypothesis,
    NAMES,
    measure=NAMES,
    factors=NAMES,
    contrast=st.sampled_from([None, {"a": 1, "b": -1}, {"a": 1, "b": -0.5, "c": -0.5}]),
    within=st.none() | st.floats(0.1, 9),
)
DIRECTED = st.builds(
    Hypothesis, NAMES, measure=NAMES, factors=NAMES, contrast=st.just({"a": 1, "b": -1}), below=st.floats(-9, 9)
)
HYPOTHESES = EFFECTS | CONTRASTS | DIRECTED
SPREADS = st.fixed_dictionaries({"interquartile_ranges": st.floats(0.1, 9)}) | st.fixed_dictionaries(
    {"median_deviations": st.floats(0.1, 9)}
)
BOUNDS = st.dictionaries(NAMES, st.sampled_from([(0, None), (None, 5.5), (-1, 1)]), min_size=1, max_size=2)
RULES = SPREADS.map(lambda spread: Outliers(**spread)) | st.builds(
    lambda spread, bounds: Outliers(**spread, bounds=bounds), SPREADS | st.just({}), BOUNDS
)
PLANS = st.builds(
    AnalysisPlan,
    st.lists(NAMES, min_size=1, max_size=3),
    alpha=st.floats(0.001, 0.5, exclude_max=True),
    correction=st.sampled_from(Correction),
    secondary=st.lists(NAMES, max_size=2),
    family=st.sampled_from([Family.PRIMARY, Family.MEASURE]),
    estimand=st.sampled_from(Estimand),
    statistic=st.sampled_from(Statistic),
    blocks=st.none() | NAMES,
    hypotheses=st.lists(HYPOTHESES, max_size=2, unique_by=lambda each: each.statement),
    outliers=st.none() | RULES,
    doubtful=st.sampled_from(Doubtful),
)


@given(PLANS)
def test_a_plan_comes_back_from_plain_data(plan):
    assert AnalysisPlan.of_mapping(plan.as_mapping()) == plan


def test_one_name_may_stand_for_a_list():
    assert AnalysisPlan("Energy").measures == ("Energy",)
    assert Hypothesis("It does.", measure="Energy", factors="Task").factors == ("Task",)


def test_the_measures_of_hypotheses_are_planned():
    plan = AnalysisPlan("Energy", hypotheses=[Hypothesis("It does.", measure="CPU", factors="Task")])
    assert plan.measures == ("Energy", "CPU")


@pytest.mark.parametrize(("measure", "factors"), [("", "Task"), ("Energy", ()), ("Energy", [3])])
def test_a_hypothesis_names_a_measure_and_factors(measure, factors):
    with pytest.raises(DesignError):
        Hypothesis("It does.", measure=measure, factors=factors)


def test_names_that_the_design_lacks_are_found_with_the_nearest():
    plan = AnalysisPlan("Enrgy", hypotheses=[Hypothesis("It does.", measure="CPU", factors="Tsk")])
    found = [(finding.problem, finding.fix) for finding in plan.findings(["Task"], ["Energy", "CPU"])]
    assert found == [
        ("there is no measure 'Enrgy'", "Did you mean 'Energy'?"),
        ("there is no factor 'Tsk'", "Did you mean 'Task'?"),
    ]


@pytest.mark.parametrize(
    ("claim", "problem"),
    [
        ({"contrast": {"Video": 1, "Idle": 1}}, "the weights of the contrast are"),
        ({"contrast": {"Video": 0, "Idle": 0}}, "the weights of the contrast are"),
        ({"contrast": {"Video": "1"}}, "contrast is"),
        ({"contrast": {0.1: 1, "0.1": 1, 0.2: -2}}, "a treatment has two weights"),
        ({"within": 0}, "within is 0"),
        ({"within": True}, "within is True"),
        ({"below": True, "contrast": {"Video": 1, "Idle": -1}}, "below is True"),
        ({"below": math.nan, "contrast": {"Video": 1, "Idle": -1}}, "below is nan"),
        ({"below": 5}, "which difference is to be below 5"),
        ({"below": 5, "within": 5, "contrast": {"Video": 1, "Idle": -1}}, "both within and below are given"),
        ({"factors": ["Task", "Speed"], "within": 5}, "a contrast or a bound is of one factor"),
    ],
)
def test_a_contrast_and_a_bound_have_to_be_testable(claim, problem):
    with pytest.raises(DesignError, match=problem):
        Hypothesis(**{"statement": "It does.", "measure": "Energy", "factors": "Task", **claim})


def test_blocks_and_secondary_measures_are_those_of_the_design():
    plan = AnalysisPlan("Energy", secondary="CUP", blocks="Tsk")
    problems = [finding.problem for finding in plan.findings(["Task"], ["Energy", "CPU"])]
    assert problems == ["there is no measure 'CUP'", "there is no factor 'Tsk' whose treatments could be blocks"]
    assert not list(AnalysisPlan("Energy", blocks="Repetition").findings(["Task"], ["Energy"]))


@pytest.mark.parametrize(
    "plain", [{"alhpa": 0.05}, {"measures": "E", "hypotheses": [{"about": 1}]}, {"correction": "x"}]
)
def test_what_is_no_plan_is_refused(plain):
    with pytest.raises(DesignError):
        AnalysisPlan.of_mapping({"measures": ["Energy"], **plain})


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        ({}, "there is no rule"),
        ({"interquartile_ranges": 0}, "interquartile_ranges is 0"),
        ({"median_deviations": "3"}, "median_deviations is '3'"),
        ({"interquartile_ranges": 3, "median_deviations": 3}, "there are two rules of spread"),
        ({"bounds": {"Energy": (5, 1)}}, "the bounds of Energy are"),
        ({"bounds": {"Energy": 5}}, "the bounds of Energy are 5"),
        ({"bounds": {"Energy": (None, None)}}, "the bounds of Energy are"),
        ({"bounds": [1, 2]}, "bounds is"),
    ],
)
def test_a_rule_for_outliers_is_one_that_can_be_followed(given, problem):
    with pytest.raises(DesignError, match=problem):
        Outliers(**given)


def test_all_that_is_wrong_with_a_rule_is_told_at_once():
    with pytest.raises(DesignError) as raised:
        Outliers(median_deviations=-1, bounds={"Energy": (5, 1), "CPU": "low"})
    assert len(raised.value.findings) == 3


def test_a_rule_says_what_it_leaves_out():
    rule = Outliers(interquartile_ranges=3, bounds={"Energy": (0, 5000)})
    assert rule.in_words("Energy", "J") == (
        "more than 3 interquartile ranges beyond the quartiles of its combination, or below 0 J, or above 5000 J"
    )
    assert Outliers(bounds={"Energy": (0, None)}).in_words("CPU") == ""


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        ({"measures": ()}, "the plan names no measure"),
        *(({"alpha": alpha}, "alpha is") for alpha in (0, 1, 0.95, -0.1, 5, "0.05", None, math.nan)),
        ({"correction": "holm"}, "correction is 'holm'"),
        *(({name: "what"}, f"{name} is 'what'") for name in ("family", "estimand", "statistic", "correction")),
        ({"hypotheses": ["The task matters."]}, "is not a hypothesis"),
        ({"hypotheses": "The task matters."}, "hypotheses is 'The task matters"),
        ({"family": Family.HYPOTHESES}, "the family is that of the hypotheses, and there are none"),
        ({"blocks": 3}, "blocks is 3"),
        *(({name: ["CPU", 3]}, f"{name} has 3, of type int") for name in ("measures", "secondary", "covariates")),
        ({"outliers": 3}, "outliers is 3"),
        ({"doubtful": "keep"}, "doubtful is 'keep'"),
        ({"covariates": [3]}, "covariates has 3"),
        ({"covariates": "Energy"}, "'Energy' is a primary measure and a covariate"),
        ({"covariates": "Voltage", "estimand": Estimand.TRIMMED_MEAN}, "trimmed means are not adjusted"),
    ],
)
def test_choices_that_cannot_be_are_refused(given, problem):
    with pytest.raises(DesignError, match=problem):
        AnalysisPlan(**{"measures": "Energy", **given})


def test_covariates_and_bounds_that_the_design_lacks_are_found_with_the_nearest():
    plan = AnalysisPlan(
        "Energy", covariates=["Volts", "Task", "order", "elapsed"], outliers=Outliers(bounds={"Enrgy": (0, 9)})
    )
    found = list(plan.findings(["Task"], ["Energy", "Voltage", "Volt"]))
    assert [finding.problem for finding in found] == [
        "there is no measure 'Volts' that could be a covariate",
        "the covariate 'Task' is a factor",
        "there is no measure 'Enrgy' that could have bounds",
    ]
    assert ["Volt" in found[0].fix, "Energy" in found[2].fix] == [True, True]


def test_plans_of_earlier_versions_are_read_and_written_as_they_were():
    earlier = AnalysisPlan("Energy").as_mapping()
    assert not {"outliers", "doubtful", "covariates"} & set(earlier)
    plan = AnalysisPlan.of_mapping(earlier)
    assert (plan.outliers, plan.doubtful, plan.covariates) == (None, Doubtful.KEEP, ())


def test_plain_data_that_is_no_rule_is_refused_as_such():
    with pytest.raises(DesignError):
        AnalysisPlan.of_mapping({"measures": ["Energy"], "outliers": {"sigmas": 3}})


def test_covariates_come_back_from_plain_data():
    plan = AnalysisPlan("Energy", covariates=["Voltage", "order"])
    assert AnalysisPlan.of_mapping(plan.as_mapping()) == plan


def test_two_hypotheses_of_one_statement_are_refused():
    with pytest.raises(DesignError, match=r"2 hypotheses state 'Tasks differ\.'"):
        AnalysisPlan(
            hypotheses=[
                Hypothesis("Tasks differ.", measure=name, factors="Task", contrast={"Video": 1, "Idle": -1})
                for name in ("Energy", "CPU")
            ]
        )
