"""What is fixed for the analysis before the experiment is checked, and survives the manifest."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.core.design.analysis_plan import AnalysisPlan, Correction, Estimand, Family, Statistic
from robot_runner.core.design.hypothesis import Hypothesis
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
HYPOTHESES = EFFECTS | CONTRASTS
PLANS = st.builds(
    AnalysisPlan,
    st.lists(NAMES, min_size=1, max_size=3),
    alpha=st.floats(0.001, 0.5),
    correction=st.sampled_from(Correction),
    secondary=st.lists(NAMES, max_size=2),
    family=st.sampled_from([Family.PRIMARY, Family.MEASURE]),
    estimand=st.sampled_from(Estimand),
    statistic=st.sampled_from(Statistic),
    blocks=st.none() | NAMES,
    hypotheses=st.lists(HYPOTHESES, max_size=2),
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


@pytest.mark.parametrize("alpha", [0, 1, -0.1, 5, "0.05", None, float("nan")])
def test_alpha_lies_between_0_and_1(alpha):
    with pytest.raises(DesignError, match="alpha is"):
        AnalysisPlan("Energy", alpha=alpha)


def test_a_plan_without_measures_is_refused():
    with pytest.raises(DesignError, match="the plan names no measure"):
        AnalysisPlan()


def test_a_correction_is_one_of_ours():
    with pytest.raises(DesignError, match="correction is 'holm'"):
        AnalysisPlan("Energy", correction="holm")


def test_hypotheses_are_hypotheses():
    with pytest.raises(DesignError, match="is no hypothesis"):
        AnalysisPlan("Energy", hypotheses=["The task matters."])


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
        ({"within": 0}, "within is 0"),
        ({"within": True}, "within is True"),
        ({"factors": ["Task", "Speed"], "within": 5}, "a contrast or a bound is of one factor"),
    ],
)
def test_a_contrast_is_one_and_a_bound_lies_above_0(claim, problem):
    with pytest.raises(DesignError, match=problem):
        Hypothesis(**{"statement": "It does.", "measure": "Energy", "factors": "Task", **claim})


@pytest.mark.parametrize("name", ["family", "estimand", "statistic", "correction"])
def test_choices_are_those_that_there_are(name):
    with pytest.raises(DesignError, match=f"{name} is 'whatever'"):
        AnalysisPlan("Energy", **{name: "whatever"})


def test_a_family_of_hypotheses_takes_hypotheses():
    with pytest.raises(DesignError, match="the family is that of the hypotheses, and there are none"):
        AnalysisPlan("Energy", family=Family.HYPOTHESES)


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
