"""Checks of operator steps and their questions, before anything is executed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from typing import Any

from robot_runner.core.config.operator_steps import ANSWER_TYPES, OperatorStep, Question, Scale
from robot_runner.core.design.columns import name_findings
from robot_runner.core.design.numeric_range import is_number, is_whole
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import Finding, did_you_mean
from robot_runner.core.words import counted, enumerated, listed

#: With how many runs the function of a step is tried.
_TRIED = 200
_RULES = ("every", "when_changes", "first")


def check_operator_steps(where: str, steps: Sequence[OperatorStep], model: RunTableModel | None) -> list[Finding]:
    """Return all problems of the steps of a config."""
    findings: list[Finding] = []
    names = Counter(step.name for step in steps if isinstance(step.name, str))
    asked = Counter(each.name for step in steps for each in _columns(step) if isinstance(each.name, str))
    for place, step in enumerate(steps):
        at = f"{where}.operator_steps[{place}]"
        findings += _step_findings(at, step, names)
        findings += _when_findings(at, step, model)
        for each in _columns(step):
            kind = "scale" if isinstance(each, Scale) else "question"
            inside = f"{at}, {kind} {each.name!r}"
            findings += _name_findings(inside, kind, each.name, asked, model)
            findings += _scale_findings(inside, each) if isinstance(each, Scale) else _question_findings(inside, each)
    return findings


def _columns(step: OperatorStep) -> Iterator[Question | Scale]:
    """Yield the scales and questions of a step, the items of scales included."""
    for each in step.ask if isinstance(step.ask, list | tuple) else ():
        if isinstance(each, Question | Scale):
            yield each
        if isinstance(each, Scale) and _has_items(each):
            yield from each.questions


def _has_items(scale: Scale) -> bool:
    return isinstance(scale.items, Mapping | list | tuple) and all(isinstance(each, str) for each in scale.items)


def _step_findings(at: str, step: OperatorStep, names: Mapping[str, int]) -> Iterator[Finding]:
    name = step.name
    if not isinstance(name, str) or not name.strip() or not name.isprintable():
        yield Finding.error(at, f"the name is {name!r}", "Say in one line what is to be done.")
    elif names[name] > 1:
        yield Finding.error(at, f"there are {names[name]} steps {name!r}", "Rename or remove one.")
    if not isinstance(step.ask, list | tuple):
        yield Finding.error(at, f"ask is {step.ask!r}", "Give a list of Question(...) and Scale(...).")
    else:
        for each in step.ask:
            if not isinstance(each, Question | Scale):
                problem = f"ask holds {each!r}, of type {type(each).__name__}"
                yield Finding.error(at, problem, "Give Question(...) or Scale(...).")
    every = step.every
    if every is not None and (not is_whole(every) or every < 1):
        yield Finding.error(at, f"every is {every!r}", "Give a whole number of runs, 1 or more.")
    given = [rule for rule in _RULES if getattr(step, rule)]
    if step.is_after:
        given += [name for name in ("before", "after") if getattr(step, name) is not None]
    if len(given) > 1:
        yield Finding.error(at, f"{enumerated(given)} are given", "Give one of them, or make two steps.")


def _when_findings(at: str, step: OperatorStep, model: RunTableModel | None) -> Iterator[Finding]:
    factors = {factor.name: factor for factor in model.factors} if model is not None else None
    changes = step.when_changes
    if not isinstance(changes, str | list | tuple) or not all(isinstance(each, str) for each in changes):
        yield Finding.error(at, f"when_changes is {changes!r}", "Give the name of a factor, or a list of names.")
    elif factors is not None:
        for name in filter(None, step.factors):
            if name not in factors:
                yield Finding.error(at, f"when_changes: there is no factor {name!r}", did_you_mean(name, factors))
    yield from _condition_findings(at, "before", step, model)
    yield from _condition_findings(at, "after", step, model)


def _condition_findings(at: str, rule: str, step: OperatorStep, model: RunTableModel | None) -> Iterator[Finding]:
    condition = step.before if rule == "before" else step.after
    if condition is None or (rule == "after" and isinstance(condition, bool)):
        return
    if not (isinstance(condition, Mapping) or callable(condition)):
        for_each = "True for each run, or " if rule == "after" else ""
        fix = f'Give {for_each}treatments by factor, such as {{"Task": "Video"}}, or a function of them.'
        yield Finding.error(at, f"{rule} is {condition!r}", fix)
    elif isinstance(condition, Mapping):
        yield from _mapping_findings(at, rule, condition, model) if model is not None else ()
    else:
        yield from _tried(at, rule, step, model) if model is not None else ()


def _mapping_findings(at: str, rule: str, condition: Mapping[Any, Any], model: RunTableModel) -> Iterator[Finding]:
    factors = {factor.name: factor for factor in model.factors}
    for name, wanted in condition.items():
        if name not in factors:
            yield Finding.error(at, f"{rule}: there is no factor {name!r}", did_you_mean(str(name), factors))
            continue
        for each in factors[name].named(wanted):
            if factors[name].position_of(each) is None:
                problem = f"{rule}: {each!r} is not a treatment of {name!r}"
                yield Finding.error(at, problem, factors[name].suggestion(each))


def _tried(at: str, rule: str, step: OperatorStep, model: RunTableModel) -> Iterator[Finding]:
    for run in islice(model.plan(), _TRIED):
        try:
            step.suits(run.combination)
        except (Exception, SystemExit) as error:  # noqa: BLE001 - the user's own function
            problem = f"{rule}({run.combination}) raised {type(error).__name__}: {error}"
            yield Finding.error(at, problem, "Correct the function: it is given the treatments by factor.")
            return


def _name_findings(
    at: str, kind: str, name: str, asked: Mapping[str, int], model: RunTableModel | None
) -> Iterator[Finding]:
    factors = [factor.name for factor in model.factors] if model is not None else []
    yield from name_findings(name, kind=kind, repetitions=model.repetitions if model is not None else 1)
    if isinstance(name, str) and asked[name] > 1:
        yield Finding.error(at, f"the name is given {counted(asked[name], 'time')}", "Rename or remove one.")
    if name in factors:
        yield Finding.error(at, f"{name!r} is the name of a factor", f"Rename the {kind}.")
    if isinstance(name, str) and "=" in name:
        yield Finding.error(at, "the name holds '='", "Leave it out: answers are given as NAME=VALUE.")


def _scale_findings(at: str, scale: Scale) -> Iterator[Finding]:
    if not _has_items(scale) or not scale.items:
        fix = 'Give what is asked by column, such as {"mental": "Mental demand"}, or a list of columns.'
        yield Finding.error(at, f"items is {scale.items!r}", fix)
    elif not isinstance(scale.reverse, list | tuple):
        yield Finding.error(at, f"reverse is {scale.reverse!r}", "Give a list of items.")
    else:
        for each in scale.reverse:
            if each not in scale.items:
                yield Finding.error(at, f"reverse: there is no item {each!r}", did_you_mean(str(each), scale.items))
    if scale.type not in {int, float}:
        yield Finding.error(at, f"the type is {scale.type!r}, and the mean of answers is formed", "Give int or float.")
    if not _is_span((scale.low, scale.high)):
        fix = "Give two finite numbers, low the smaller one."
        yield Finding.error(at, f"low is {scale.low!r}, and high is {scale.high!r}", fix)
    if scale.to is not None and not _is_span(scale.to):
        yield Finding.error(at, f"to is {scale.to!r}", "Give the least and the largest score, such as (0, 100).")


def _is_span(limits: Any) -> bool:
    match limits:
        case [least, largest]:
            return is_number(least) and is_number(largest) and least < largest
    return False


def _question_findings(at: str, question: Question) -> Iterator[Finding]:
    kind = question.kind
    if not isinstance(question.choices, list | tuple):
        yield Finding.error(at, f"choices is {question.choices!r}", "Give a list.")
        return
    yield from _type_findings(at, question)
    if kind not in ANSWER_TYPES.values():
        yield Finding.error(at, f"the type is {kind!r}", "Choose float, int, str or bool.")
        return
    yield from _limit_findings(at, question)
    for choice in question.choices:
        if type(choice) is not kind:
            problem = f"choice {choice!r} is of type {type(choice).__name__}, and answers of type {kind.__name__}"
            yield Finding.error(at, problem, "Give all choices the same type, or the question the type of its choices.")
    texts = Counter(str(choice).casefold() for choice in question.choices)
    if twice := [text for text, times in texts.items() if times > 1]:
        yield Finding.error(at, f"choices look alike: {listed(twice)}", "Rename or remove one.")


def _type_findings(at: str, question: Question) -> Iterator[Finding]:
    if not isinstance(question.unit, str) or not isinstance(question.text, str):
        yield Finding.error(at, "unit and text are not both texts", 'Give texts, such as unit="V".')
    if not isinstance(question.note, bool) or not isinstance(question.optional, bool):
        yield Finding.error(at, "note and optional are not both True or False", "Give True or False, without quotes.")


def _limit_findings(at: str, question: Question) -> Iterator[Finding]:
    low, high = question.low, question.high
    limits = [limit for limit in (low, high) if limit is not None]
    if not limits:
        return
    if question.kind not in {int, float} or question.choices:
        what = "choices" if question.choices else f"answers of type {question.kind.__name__}"
        yield Finding.error(at, f"low and high are limits of numbers, and there are {what}", "Leave them out.")
    elif not all(map(is_number, limits)):
        yield Finding.error(at, f"low is {low!r}, and high is {high!r}", "Give finite numbers.")
    elif low is not None and high is not None and low > high:
        yield Finding.error(at, f"no answer is taken: low is {low}, and high is {high}", "Give low the smaller number.")
