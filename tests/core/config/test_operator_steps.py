"""Operator steps, questions and notifications that cannot be carried out are found before anything is executed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from robot_runner.core.config.operator_steps import OperatorStep, Question, Scale, operator_measures, read_answers
from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import MeasureError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

MALFORMED = """
operator_steps = [
    OperatorStep(""),
    OperatorStep("swap", every=0, first=True),
    OperatorStep("swap", when_changes="Tsk"),
    OperatorStep("place", before={"Task": "Vidoe", "Floor": "wood"}),
    OperatorStep("a", before=3),
    OperatorStep("b", before=lambda run: run["Tsk"]),
    OperatorStep("c", ask=[3]),
    OperatorStep("d", ask=[Question("Task"), Question("run_id"), Question("v", float, low=3, high=2)]),
    OperatorStep("e", ask=[Question("v", list), Question("w", low=3), Question("x", int, choices=[1, "2"])]),
    OperatorStep("f", after={"Task": "Vidoe"}),
    OperatorStep("g", after=3),
    OperatorStep("h", after=True, every=2, before={"Task": "Video"}),
    OperatorStep("i", ask=3),
    OperatorStep("j", when_changes=3),
    OperatorStep("k", ask=[Question("a=b"), Question("k1", choices="ab"), Question("k2", unit=3)]),
    OperatorStep("l", ask=[Question("l1", choices=["left", "Left"]), Question("l2", float, low="1", high=2)]),
    OperatorStep("m", ask=[Question("m1", note="no"), Question("m2", optional="no")]),
    OperatorStep("n", ask=[Scale("Floor=", ["n1", "n1"], low=1, high=5), Scale("n2", [], low=5, high=1)]),
    OperatorStep("o", ask=[Scale("o1", ["o2"], low=1, high=5, reverse=["o3"], type=str, to=(0, 1, 2))]),
    OperatorStep("p", ask=[Scale("p1", ["p1"], low="1", high=5, reverse="p1", to=(1, 1))]),
    OperatorStep("q", ask=[Scale("q1", 3, low=0, high=1)]),
]
"""


def test_everything_that_is_wrong_with_steps_and_questions_is_said_at_once(write_config: Callable[..., Path]) -> None:
    found = {
        f"{each.where.partition('operator_')[2]}: {each.problem}" for each in prepare(write_config(MALFORMED)).findings
    }
    assert found == {
        "steps[0]: the name is ''",
        "steps[1]: there are 2 steps 'swap'",
        "steps[1]: every is 0",
        "steps[2]: there are 2 steps 'swap'",
        "steps[2]: when_changes: there is no factor 'Tsk'",
        "steps[3]: before: 'Vidoe' is not a treatment of 'Task'",
        "steps[3]: before: there is no factor 'Floor'",
        "steps[4]: before is 3",
        "steps[5]: before(Task='Video') raised UnknownFactorError: the run has no factor 'Tsk': did you mean 'Task'?",
        "steps[6]: ask holds 3, of type int",
        "steps[7], question 'Task': 'Task' is the name of a factor",
        "steps[7], question 'v': the name is given 2 times",
        "steps[7], question 'v': no answer is taken: low is 3, and high is 2",
        "steps[8], question 'v': the name is given 2 times",
        "steps[8], question 'v': the type is <class 'list'>",
        "steps[8], question 'w': low and high are limits of numbers, and there are answers of type str",
        "steps[8], question 'x': choice '2' is of type str, and answers of type int",
        "steps[9]: after: 'Vidoe' is not a treatment of 'Task'",
        "steps[10]: after is 3",
        "steps[11]: every, before and after are given",
        "steps[12]: ask is 3",
        "steps[13]: when_changes is 3",
        "steps[14], question 'a=b': the name holds '='",
        "steps[14], question 'k1': choices is 'ab'",
        "steps[14], question 'k2': unit and text are not both texts",
        "steps[15], question 'l1': choices look alike: left",
        "steps[15], question 'l2': low is '1', and high is 2",
        "steps[16], question 'm1': note and optional are not both True or False",
        "steps[16], question 'm2': note and optional are not both True or False",
        "steps[17], scale 'Floor=': the name holds '='",
        "steps[17], question 'n1': the name is given 2 times",
        "steps[17], scale 'n2': items is []",
        "steps[17], scale 'n2': low is 5, and high is 1",
        "steps[18], scale 'o1': reverse: there is no item 'o3'",
        "steps[18], scale 'o1': the type is <class 'str'>, and the mean of answers is formed",
        "steps[18], scale 'o1': to is (0, 1, 2)",
        "steps[18], question 'o2': low and high are limits of numbers, and there are answers of type str",
        "steps[19], scale 'p1': the name is given 2 times",
        "steps[19], question 'p1': the name is given 2 times",
        "steps[19], scale 'p1': reverse is 'p1'",
        "steps[19], scale 'p1': low is '1', and high is 5",
        "steps[19], scale 'p1': to is (1, 1)",
        "steps[19], question 'p1': low is '1', and high is 5",
        "steps[20], scale 'q1': items is 3",
        ": the run table has a column of that name already",
    }


def test_steps_are_a_list_of_steps(write_config: Callable[..., Path]) -> None:
    (finding,) = prepare(write_config('operator_steps = ["swap the battery"]')).findings
    assert finding.fix == "It must be a list of OperatorStep(...) in the config file; from outside, none."
    config = write_config('operator_steps = [OperatorStep("swap", ask=[Question("voltage", float)])]')
    left_out = prepare(config, {"operator_steps": "none"}).experiment
    assert left_out is not None
    assert left_out.columns.names == ("Energy",), "a rehearsal goes without"
    experiment = prepare(config).experiment
    assert experiment is not None
    assert experiment.columns.names == ("Energy", "voltage")


@pytest.mark.parametrize(
    ("question", "text", "value"),
    [
        (Question("a"), " two words ", "two words"),
        (Question("a", int), "-3", -3),
        (Question("a", bool), "Yes", True),
        (Question("a", bool), "0", False),
        (Question("a", choices=[1.5, 2.5]), "2.5", 2.5),
        (Question("a", choices=[True, False]), "no", False),
        (Question("a", optional=True), "  ", None),
    ],
)
def test_an_answer_has_the_type_of_its_question(question: Question, text: str, value: object) -> None:
    read = question.read(text)
    assert (read, type(read)) == (value, type(value))
    assert Question.from_mapping(question.as_mapping()).read(text) == value


@pytest.mark.parametrize(
    ("question", "text", "problem"),
    [
        (Question("a", int), "3.5", "'3.5' is not a whole number"),
        (Question("a", bool), "maybe", "'maybe' is neither yes nor no"),
        (Question("a"), "red\x1b[31m", "the text holds characters that cannot be printed"),
        (Question("a", float), "inf", "'inf' is not finite"),
        (Question("a", float), "11_8", "'11_8' is not a number"),  # in Python, but what was meant is 11.8
        (Question("a", int), "1_1", "'1_1' is not a whole number"),
        (Question("a", float), "11,8", "'11,8' is not a number: its decimals stand behind a point"),
        (Question("a", int), "1,180", "'1,180' is not a whole number"),
        (Question("a", int), "9" * 5000, "is not a whole number"),
        (Question("a", int), "9" * 400, "'9{400}' is not finite"),
    ],
)
def test_what_is_no_answer_is_refused(question: Question, text: str, problem: str) -> None:
    with pytest.raises(MeasureError, match=problem.replace("(", "\\(")):
        question.read(text)


def test_all_answers_are_judged_at_once() -> None:
    questions = [Question("voltage", float, low=9), Question("place"), Question("remark", optional=True)]
    taken, findings = read_answers(questions, {"voltage": "3", "plaec": "A"})
    assert taken == {"remark": None}
    assert [(each.where, each.problem) for each in findings] == [
        ("voltage", "3 is below 9"),
        ("plaec", "no question asks for this"),
        ("place", "the question is not answered"),
    ]
    assert findings[1].fix == "Did you mean 'place'?"


@pytest.mark.parametrize("wanted", ["(0, 0)", "[(0, 0)]", "{(0, 0)}"])
def test_a_step_is_for_a_treatment_that_is_a_tuple_or_for_several(
    write_config: Callable[..., Path], wanted: str
) -> None:
    factors = "[Factor('Place', [(0, 0), (1, 1)]), Factor('N', [1, 2])]"
    table = f"    def create_run_table(self): return RunTableModel({factors})\n"
    step = f"OperatorStep('carry it there', before={{'Place': {wanted}, 'N': range(1, 3)}})"
    experiment = prepare(write_config(f"operator_steps = [{step}]", table=table)).experiment
    assert experiment is not None
    (step,) = experiment.parameters.operator_steps
    assert [step.suits(run.combination) for run in experiment.model.plan()] == [True, True, False, False]


#: The System Usability Scale: odd items are worded in favour of the system, even ones against it.
SUS = Scale(
    "SUS", [f"s{n}" for n in range(1, 11)], low=1, high=5, reverse=[f"s{n}" for n in range(2, 11, 2)], to=(0, 100)
)


@pytest.mark.parametrize("answers", ["5151515151", "1515151515", "3333333333", "4242534132", "5555555555"])
def test_a_scale_of_ten_items_scores_as_brooke_computes_the_system_usability_scale(answers: str) -> None:
    given = [int(each) for each in answers]
    brooke = 2.5 * (sum(each - 1 for each in given[::2]) + sum(5 - each for each in given[1::2]))
    assert SUS.score({f"s{n}": each for n, each in enumerate(given, 1)}) == brooke


def test_a_score_is_the_mean_of_the_answers_their_sum_where_it_is_moved_so_and_missing_with_one_of_them() -> None:
    mean = Scale("Load", {"a": "Mental demand", "b": "Effort", "c": "Frustration"}, low=0, high=100)
    assert mean.score({"a": 10, "b": 20, "c": 40, "of another": 5}) == 70 / 3
    assert replace(mean, reverse=["c"]).score({"a": 10, "b": 20, "c": 40}) == 30
    assert replace(mean, to=(0, 300)).score({"a": 10, "b": 20, "c": 40}) == 70
    assert replace(mean, optional=True).score({"a": 10, "b": None, "c": 40}) is None


def test_the_measure_of_a_score_says_how_it_is_formed_and_items_that_are_notes_are_none() -> None:
    scale = Scale("Trust", ["relied", "doubted"], low=1, high=5, reverse=["doubted"], to=(0, 100), note=True)
    (score,) = operator_measures([OperatorStep("ask", ask=[scale])])
    assert (score.name, score.low, score.high) == ("Trust", 0, 100)
    assert score.description == "The mean of relied and doubted (reversed), each from 1 to 5, moved to 0 to 100."
    kept = operator_measures([OperatorStep("ask", ask=[replace(scale, note=False)])])
    assert [(each.name, each.low, each.high) for each in kept] == [
        ("relied", 1, 5),
        ("doubted", 1, 5),
        ("Trust", 0, 100),
    ]
