"""The operator's steps before or after runs, when they are due, and their questions with typed answers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from math import fsum
from typing import Any

from robot_runner.core.design.factor import treatments_are_equal
from robot_runner.core.design.numeric_range import is_number
from robot_runner.core.errors import Finding, MeasureError, did_you_mean
from robot_runner.core.events.measure import Measure, MeasureValue, as_measure_value
from robot_runner.core.words import enumerated

#: A class, such as float.
AnswerType = type
#: What an answer can be, by the name under which the journal keeps the type.
ANSWER_TYPES: dict[str, type] = {"text": str, "number": float, "whole number": int, "yes or no": bool}
_TYPE_NAMES = {kind: name for name, kind in ANSWER_TYPES.items()}
_YES, _NO = frozenset({"y", "yes", "true", "1"}), frozenset({"n", "no", "false", "0"})

#: The attributes of a question that are plain data.
_PLAIN = ("unit", "low", "high", "note", "optional", "text")

#: For which runs a step is done: a function of the treatments, or treatments by factor.
StepCondition = Callable[[Mapping[str, Any]], bool] | Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Question:
    """A question about a run. The answer is a measure of that run, entered by hand, or a note of it.

    Attributes:
        name: the column of the run table, such as `voltage`.
        type: float, int, str or bool; by default that of the choices, or str.
        unit: as that of a measure.
        low, high: a number below or above is refused, and asked for again.
        choices: the accepted answers; none for any.
        note: whether the answer is a note in the journal instead of a measure.
        optional: whether an empty answer is accepted, as a missing value.
        text: what the person reads in place of the name.

    Example:
        >>> Question("voltage", float, unit="V", low=9, high=13).read("11.8")
        11.8
        >>> Question("place", choices=["A", "B"]).hint
        'A or B'
    """

    name: str
    type: AnswerType | None = None
    _: KW_ONLY
    unit: str = ""
    low: float | None = None
    high: float | None = None
    choices: Sequence[Any] = ()
    note: bool = False
    optional: bool = False
    text: str = ""

    @property
    def kind(self) -> AnswerType:
        """The type of the answers."""
        return self.type or (self.choices[0].__class__ if self.choices else str)

    @property
    def asked(self) -> str:
        """The question with unit and limits: `voltage (V, 9 to 13)`."""
        return f"{self.text or self.name}{f' ({self.hint})' if self.hint else ''}"

    @property
    def hint(self) -> str:
        """The accepted answers, in a few words."""
        if self.choices:
            *most, last = map(_shown, self.choices)
            return f"{', '.join(most)} or {last}" if most else last
        kind = "yes or no" if self.kind is bool else ""
        optional = "may be left empty" if self.optional else ""
        return ", ".join(filter(None, (self.unit, self._limits, kind, optional)))

    @property
    def _limits(self) -> str:
        if self.low is not None:
            return f"{self.low} or more" if self.high is None else f"{self.low} to {self.high}"
        return "" if self.high is None else f"{self.high} or less"

    def read(self, text: str) -> MeasureValue:
        """Return the answer that a text gives; None for an empty text, if the question is optional.

        Raises:
            MeasureError: it is refused.
        """
        said = text.strip()
        if not said and self.optional:
            return None
        if not said:
            raise self._refusal("nothing was entered")
        if self.choices:
            return self._chosen(said)
        value = as_measure_value(self.name, self._typed(said), where=self.name)
        if is_number(value):
            if self.low is not None and value < self.low:
                raise self._refusal(f"{said} is below {self.low} {self.unit}".rstrip())
            if self.high is not None and value > self.high:
                raise self._refusal(f"{said} is above {self.high} {self.unit}".rstrip())
        return value

    def _typed(self, said: str) -> Any:
        if self.kind is bool:
            if said.casefold() not in _YES | _NO:
                raise self._refusal(f"{said!r} is neither yes nor no")
            return said.casefold() in _YES
        if self.kind is str:
            if not said.isprintable():
                raise self._refusal("the text holds characters that cannot be printed")
            return said
        try:
            number = self.kind(said.replace("_", "?"))  # Python reads 11_8, a slip for 11.8, as 118
        except ValueError:
            comma = ": its decimals stand behind a point" if self.kind is float and "," in said else ""
            raise self._refusal(f"{said!r} is not a {_TYPE_NAMES[self.kind]}{comma}") from None
        if not is_number(number):
            raise self._refusal(f"{said!r} is not finite")
        return number

    def _chosen(self, said: str) -> MeasureValue:
        shown = {_shown(choice): choice for choice in self.choices}
        alike = [choice for text, choice in shown.items() if text.casefold() == said.casefold()]
        if said in shown or len(alike) == 1:
            return as_measure_value(self.name, shown.get(said, alike[0]), where=self.name)
        raise MeasureError(f"{said!r} is none of the choices", where=self.name, fix=did_you_mean(said, shown))

    def _refusal(self, problem: str) -> MeasureError:
        return MeasureError(problem, where=self.name, fix=f"Enter {self._wanted()}.")

    def _wanted(self) -> str:
        """Return the accepted answers as a sentence."""
        if self.kind in {bool, str} or self.choices:
            return self.hint or "an answer"
        has_both = self.low is not None and self.high is not None
        limits = f"{' from' if has_both else ','} {self._limits}" if self._limits else ""
        unit = f" (in {self.unit})" if self.unit else ""
        return f"a {_TYPE_NAMES[self.kind]}{limits}{unit}"

    def as_mapping(self) -> dict[str, Any]:
        """Return the question as plain data: the journal keeps it, so that any terminal can show it."""
        facts = {name: getattr(self, name) for name in _PLAIN}
        return {"name": self.name, "type": _TYPE_NAMES[self.kind], "choices": list(self.choices), **facts}

    @classmethod
    def from_mapping(cls, facts: Mapping[str, Any]) -> Question:
        """Return the question that `as_mapping` made plain data of."""
        plain = {name: facts[name] for name in ("choices", *_PLAIN)}
        return cls(str(facts["name"]), ANSWER_TYPES[facts["type"]], **plain)


@dataclass(frozen=True, slots=True)
class Scale:
    """Several questions about a run whose answers make one score, such as NASA-TLX or SUS: their mean.

    Attributes:
        name: the column of the score, which is a measure of the run.
        items: what the person reads, by the column of the answer; or the columns alone.
        low, high: the least and the largest answer, of all items.
        type: of the answers, int or float.
        reverse: the items whose answers count from the other end, as `low + high` less the answer.
        to: the least and the largest score, such as `(0, 100)`; by default `low` and `high`.
        note: whether the answers, not the score, are notes in the journal instead of measures.
        optional: whether an empty answer is accepted; there is no score then.

    Example:
        >>> Scale("Trust", ["relied", "doubted"], low=1, high=5, reverse=["doubted"]).score({"relied": 5, "doubted": 2})
        4.5
    """

    name: str
    items: Mapping[str, str] | Sequence[str]
    _: KW_ONLY
    low: float
    high: float
    type: AnswerType = int
    reverse: Sequence[str] = ()
    to: tuple[float, float] | None = None
    note: bool = False
    optional: bool = False

    @property
    def questions(self) -> tuple[Question, ...]:
        """The items as questions."""
        texts = self.items.items() if isinstance(self.items, Mapping) else [(name, "") for name in self.items]
        facts: dict[str, Any] = {name: getattr(self, name) for name in ("low", "high", "note", "optional")}
        return tuple(Question(name, self.type, text=text, **facts) for name, text in texts)

    @property
    def measure(self) -> Measure:
        """The score; its description says how it is formed."""
        names = [f"{name} (reversed)" if name in self.reverse else name for name in self.items]
        moved = "" if self.to is None else f", moved to {self.to[0]} to {self.to[1]}"
        least, largest = self.to or (self.low, self.high)
        formed = f"The mean of {enumerated(names)}, each from {self.low} to {self.high}{moved}."
        return Measure(self.name, "", formed, low=least, high=largest)

    def score(self, answers: Mapping[str, MeasureValue]) -> float | None:
        """Return the score that answers, by item, make; None where one of them is missing."""
        given = {name: answers[name] for name in self.items}
        counted = [self.low + self.high - x if name in self.reverse else x for name, x in given.items() if is_number(x)]
        if len(counted) < len(given):
            return None
        if self.to is None:
            return fsum(counted) / len(counted)
        least, largest = self.to
        above = fsum(counted) - len(counted) * self.low
        return least + above * (largest - least) / (len(counted) * (self.high - self.low))


def _shown(choice: Any) -> str:
    return ("yes" if choice else "no") if isinstance(choice, bool) else str(choice)


@dataclass(frozen=True, slots=True)
class OperatorStep:
    """A person's work before a run, such as swapping a battery. The run starts once they confirm it.

    By default, a step is done before each run, and before each further attempt at it. With `after` it is done once a
    run is done, and the next one at its place waits until then.

    Attributes:
        name: what is to be done, for the person to read.
        every: before the first run, and once this many runs have begun since it was done last.
        when_changes: a factor, or several: before a run with other treatments of these than it was done for last.
        first: once, before the first run.
        before: only before these runs; can be combined with any of the three above.
        after: after each run that is done (`True`), or after these runs; cannot be combined.
        ask: the questions once it is done, and scales of several.

    Example:
        >>> OperatorStep("place the robot at A", before={"Room": "lab"}).suits({"Room": "lab"})
        True
    """

    name: str
    ask: Sequence[Question | Scale] = ()
    every: int | None = None
    when_changes: str | Sequence[str] = ()
    first: bool = False
    before: StepCondition | None = None
    after: StepCondition | bool | None = None

    @property
    def questions(self) -> tuple[Question, ...]:
        """All that is asked, the items of scales included."""
        return tuple(
            question for each in self.ask for question in (each.questions if isinstance(each, Scale) else (each,))
        )

    @property
    def scales(self) -> tuple[Scale, ...]:
        """The scales among what is asked."""
        return tuple(each for each in self.ask if isinstance(each, Scale))

    @property
    def is_after(self) -> bool:
        """Whether the step is done after runs."""
        return self.after is not None and self.after is not False

    @property
    def factors(self) -> tuple[str, ...]:
        """The factors of `when_changes`."""
        return (self.when_changes,) if isinstance(self.when_changes, str) else tuple(self.when_changes)

    @property
    def is_for_each_attempt(self) -> bool:
        """Whether the step prepares each single attempt, as placing a robot does."""
        return self.every is None and not self.factors and not self.first

    def suits(self, combination: Mapping[str, Any]) -> bool:
        """Return whether `before`, or `after`, lets the step be done for a run with these treatments."""
        condition = self.after if self.is_after else self.before
        if condition is None or isinstance(condition, bool):
            return True
        if not isinstance(condition, Mapping):
            return bool(condition(combination))
        return all(
            any(treatments_are_equal(combination[factor], each) for each in _treatments_among(wanted))
            for factor, wanted in condition.items()
        )


def _treatments_among(wanted: Any) -> Sequence[Any]:
    """Return the treatments that one entry of a condition names, for `Factor.named`."""
    return (wanted, *wanted) if isinstance(wanted, list | tuple | range | set | frozenset) else (wanted,)


def operator_measures(steps: Sequence[OperatorStep]) -> tuple[Measure, ...]:
    """Return the measures of the answers of steps, and of their scores."""
    measures: list[Measure] = []
    for step in steps:
        entered = f"Entered by hand when this was done: {step.name}."
        asked = (each for each in step.questions if not each.note)
        measures += [Measure(each.name, each.unit, entered, low=each.low, high=each.high) for each in asked]
        measures += [scale.measure for scale in step.scales]
    return tuple(measures)


def asked_after(steps: Sequence[OperatorStep]) -> frozenset[str]:
    """Return the names of what is known after runs only: of questions, and of scores."""
    after = [step for step in steps if step.is_after]
    questions = {question.name for step in after for question in step.questions}
    return frozenset(questions.union(scale.name for step in after for scale in step.scales))


def read_answers(
    questions: Sequence[Question], answers: Mapping[str, str], answered: Mapping[str, MeasureValue] | None = None
) -> tuple[dict[str, MeasureValue], list[Finding]]:
    """Read the answers to several questions; all findings at once.

    Return the accepted values, and a finding for each refused one, each question without an answer, and each name
    without a question.
    """
    by_name = {question.name: question for question in questions}
    taken = dict(answered or {})
    findings: list[Finding] = []
    for name, text in answers.items():
        try:
            taken[name] = _asked_for(name, by_name).read(text)
        except MeasureError as error:
            findings.append(error.as_finding())
    for name, question in by_name.items():
        if name in taken or name in answers:
            continue
        if question.optional:
            taken[name] = None
        else:
            fix = f"Add --answer {name}=..., with {question.hint or 'any text'}."
            findings.append(Finding.error(name, "the question is not answered", fix))
    return taken, findings


def _asked_for(name: str, questions: Mapping[str, Question]) -> Question:
    if name in questions:
        return questions[name]
    fix = did_you_mean(name, questions) if questions else "Leave it out: there are no questions."
    raise MeasureError("no question asks for this", where=name, fix=fix)
