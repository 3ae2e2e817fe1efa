"""How precisely a measure is known after the repetitions so far, and whether another one is needed (`repeat_until`)."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain
from itertools import combinations as pairs_of
from typing import Any

from robot_runner.core.design.asking import Decision, Told
from robot_runner.core.design.batches import REPEATED, missing_runs
from robot_runner.core.design.extended_design import ExtendedDesign, copies_in
from robot_runner.core.design.factor import Combination, Factor, texts_of
from robot_runner.core.design.numeric_range import is_number
from robot_runner.core.design.planned_runs import PlannedRun
from robot_runner.core.design.precision import PreciseOf, Precision, most_repetitions
from robot_runner.core.design.repeated_intervals import half_width_of, level_at_each_look
from robot_runner.core.errors import Finding
from robot_runner.core.words import INACTIVE, combination_label, counted, listed

#: At how many looks in a row everything has to be precise, as an interval may be narrow by chance: tests at 5 % err in
#: up to 9 % at the first such look, and in 5 to 6.5 % after three more repetitions (`python -m benchmarks statistics`).
#: That a few more suffice: Simons, On the cost of not knowing the variance when making a fixed-width confidence
#: interval for the mean, Annals of Mathematical Statistics 39, 1968.
LOOKS_IN_A_ROW = 4

#: Sums of larger values may be beyond all floats.
_LARGEST = 1e300
#: The treatments of a combination: pairs of factor and text.
Treatments = tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Observed:
    """The value of one run that counts: not excluded, and no warm-up run.

    Attributes:
        treatments: of the run, by factor, as text.
        repetition: of its combination, from 1.
        value: of the measure; None where the run failed or has none.
        batch: in which it was planned, from 1.
    """

    run_id: str
    treatments: Mapping[str, str]
    repetition: int
    value: Any
    batch: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """How precisely one mean, or one difference of means, is known.

    Attributes:
        of: its name, such as `Video / 0.2`, or `Video - Network` for a difference; empty for the measure as a whole.
        n: the number of values; for a difference that of repetitions.
        mean: in the measure's unit; None where there is no value.
        half_width: half the width of its interval, in the unit; None for fewer than two values.
        wanted: the wanted half width, in the unit; None where that is not known.
        problem: why it cannot be known, however often it is repeated; empty where it can.
        oddity: a warning about it, or empty.
    """

    of: str
    n: int
    mean: float | None = None
    half_width: float | None = None
    wanted: float | None = None
    problem: str = ""
    oddity: str = ""

    @property
    def is_precise(self) -> bool:
        """Whether it is known as precisely as wanted."""
        return self.half_width is not None and self.wanted is not None and self.half_width <= self.wanted


@dataclass(frozen=True, slots=True)
class Judgement:
    """All means or differences of one rule, at one look.

    Attributes:
        rule: what was asked for.
        level: the confidence of each interval at this look.
        repetitions: how often each combination was planned until now.
        known: each mean, or difference.
        in_a_row: at how many looks in a row, up to this one, everything was as precise as wanted.
    """

    rule: Precision
    level: float
    repetitions: int
    known: tuple[Known, ...]
    in_a_row: int = 0

    @property
    def is_precise(self) -> bool:
        """Whether all is known as precisely as is wanted."""
        return bool(self.known) and all(each.is_precise for each in self.known)

    @property
    def is_settled(self) -> bool:
        """Whether it is precise and was so at enough looks; where nothing varies, one is enough."""
        varies = any(each.half_width for each in self.known)
        return self.is_precise and (self.in_a_row >= LOOKS_IN_A_ROW or not varies)

    @property
    def problems(self) -> tuple[str, ...]:
        """Why the rule cannot be followed; empty where it can be."""
        if not self.known:
            return ("there is nothing to compare: no factor has two treatments that are combined with the same",)
        return tuple(": ".join(filter(None, (each.of, each.problem))) for each in self.known if each.problem)

    @property
    def needs_more(self) -> bool:
        """Whether another repetition is to be executed for this rule."""
        return not (self.is_settled or self.problems or self.repetitions >= self.rule.at_most)

    @property
    def widest(self) -> Known | None:
        """The least precise one, relative to its goal; None where no half width is known."""
        told = [each for each in self.known if each.half_width is not None and each.wanted]
        return max(told, key=lambda each: each.half_width / each.wanted, default=None)  # type: ignore[operator]

    def in_words(self) -> str:
        """Return the judgement in words."""
        measure, worst = self.rule.measure, self.widest
        if worst is None:
            return f"{measure}: {'; '.join(self.problems) or 'too few values'}"
        reached = worst.half_width / worst.wanted * self.rule.half_width  # type: ignore[operator]
        shown = f"± {reached:.3g} {'%' if self.rule.is_relative else self.rule.unit}".strip()
        known = sum(each.is_precise for each in self.known)
        what = "mean" if self.rule.of is PreciseOf.MEANS else "difference"
        wanted = f"± {self.rule.wanted_in_words} is wanted"
        looks = f", {self.in_a_row} of {LOOKS_IN_A_ROW} looks in a row" if self.is_precise and self.needs_more else ""
        precise = f"{known} of {counted(len(self.known), what)} precise{looks}"
        return f"{measure}: {shown} for {worst.of}, {wanted} ({precise})"


def judge(rule: Precision, looks: tuple[int, int], repetitions: int, runs: Iterable[Observed]) -> Judgement:
    """Judge how precisely a rule is fulfilled, and at how many looks in a row.

    `looks` are the numbers of repetitions at the first look and at the last possible one of all rules; `runs` are all
    that count, those without a value included.
    """
    first, last = looks
    level = level_at_each_look(first, max(last, repetitions, first))
    observed = list(runs)
    problem = next((f"{run.run_id} has {run.value!r}, {why}" for run in observed if (why := _unusable(run.value))), "")
    if problem:
        return Judgement(rule, level, repetitions, (Known(of="", n=0, problem=problem),))
    make = _means if rule.of is PreciseOf.MEANS else _differences

    def judged_after(count: int) -> Judgement:
        known = make(rule, level, [run for run in observed if run.repetition <= count])
        return Judgement(rule, level, count, tuple(known))

    found = judged_after(repetitions)
    in_a_row = int(found.is_precise)
    for count in range(repetitions - 1, first - 1, -1):
        if not 0 < in_a_row < LOOKS_IN_A_ROW or not judged_after(count).is_precise:
            break
        in_a_row += 1
    return replace(found, in_a_row=in_a_row)


def _unusable(value: Any) -> str:
    """Return why a value cannot be computed with; empty where it can, or where there is none."""
    if value is None or (is_number(value) and abs(value) <= _LARGEST):
        return ""
    return "which is too large to compute with" if is_number(value) else "which is not a number"


def _means(rule: Precision, level: float, observed: Sequence[Observed]) -> Iterator[Known]:
    values: dict[Treatments, list[float]] = {}
    for run in observed:
        own = values.setdefault(tuple(run.treatments.items()), [])
        if run.value is not None:
            own.append(float(run.value))
    for treatments, found in values.items():
        of = combination_label(text for _, text in treatments) or "all runs"
        yield _known(rule, level, of, found, found)


def _differences(rule: Precision, level: float, observed: Sequence[Observed]) -> Iterator[Known]:
    """Yield the difference between any two treatments of a factor.

    Each repetition yields one difference, of the means over all combinations that differ in this factor alone. So
    changes from one repetition to the next cancel, and spreads need not be equal (Scheffe, On solutions of the
    Behrens-Fisher problem, Annals of Mathematical Statistics 14, 1943). Runs of different batches are not compared.
    """
    values = {(tuple(run.treatments.items()), run.repetition): (run.value, run.batch) for run in observed}
    batches: defaultdict[Treatments, set[int]] = defaultdict(set)
    for run in observed:
        batches[tuple(run.treatments.items())].add(run.batch)
    for _, one, other, pairs in _compared(batches):
        same = [pair for pair in pairs if not batches[pair[0]].isdisjoint(batches[pair[1]])]
        if same:
            differences, all_values = _within_repetitions(values, *zip(*same, strict=True))
            yield _known(rule, level, f"{one} - {other}", differences, all_values)


def _compared(
    combinations: Collection[Treatments],
) -> Iterator[tuple[str, str, str, list[tuple[Treatments, Treatments]]]]:
    """Yield each factor with any two of its treatments, and the pairs of combinations that differ in these alone."""
    for factor in dict(next(iter(combinations), ())):
        others: defaultdict[str, dict[Treatments, Treatments]] = defaultdict(dict)
        for each in combinations:
            rest = tuple(item for item in each if item[0] != factor)
            others[dict(each)[factor]][rest] = each
        for one, other in pairs_of(others, 2):
            pairs = [(others[one][rest], others[other][rest]) for rest in others[one] if rest in others[other]]
            yield factor, one, other, pairs


def uncompared(where: str, rules: Sequence[Precision], combinations: Iterable[Combination]) -> Iterator[Finding]:
    """Yield a warning of the differences that rules do not look at, as where another factor applies to some runs only.

    `combinations`, all that are executed, are read only where differences are asked for.
    """
    if any(rule.of is PreciseOf.DIFFERENCES for rule in rules):
        known = dict.fromkeys(tuple(texts_of(each).items()) for each in combinations)
        pairs = (each for each in _compared(known) if not (each[3] or str(INACTIVE) in each[1:3]))
        if names := [f"{one} - {other} of {factor}" for factor, one, other, _ in pairs]:
            problem = f"differences are not looked at whose runs differ in other factors, too: {listed(names)}"
            yield Finding.warning(where, problem, 'Ask for the means (of="means"), in which these runs count.')


def _within_repetitions(
    values: Mapping[tuple[Treatments, int], tuple[Any, int]], ones: Sequence[Treatments], others: Sequence[Treatments]
) -> tuple[list[float], list[float]]:
    """Return the difference in each repetition that has all values, and these values."""
    differences, all_values = [], []
    for repetition in sorted({repetition for _, repetition in values}):
        left = [values.get((each, repetition), (None, 0)) for each in ones]
        right = [values.get((each, repetition), (None, 0)) for each in others]
        found = [float(value) for value, _ in (*left, *right) if value is not None]
        if len(found) == len(left) + len(right) and all(
            one[1] == other[1] for one, other in zip(left, right, strict=True)
        ):
            differences.append((math.fsum(found[: len(left)]) - math.fsum(found[len(left) :])) / len(left))
            all_values += found
    return differences, all_values


def _known(rule: Precision, level: float, of: str, values: Sequence[float], whole: Sequence[float]) -> Known:
    """Return the mean of `values` and its interval; a wanted percentage is of the mean of `whole`."""
    if not values:
        return Known(of=of, n=0, problem=f"no run has a value of {rule.measure}")
    mean = math.fsum(values) / len(values)
    size = abs(math.fsum(whole) / len(whole))
    if rule.is_relative and size == 0:
        problem = f"the mean is 0, of which {rule.wanted_in_words} is not a width"
        return Known(of=of, n=len(values), mean=mean, problem=problem)
    wanted = size * rule.half_width / 100 if rule.is_relative else rule.half_width
    if len(values) < 2:  # noqa: PLR2004 - one value has no spread
        return Known(of=of, n=len(values), mean=mean, wanted=wanted)
    half_width = half_width_of(values, level)
    oddity = f"all {len(values)} values are {values[0]:g}, so that nothing tells their spread" if not half_width else ""
    return Known(of=of, n=len(values), mean=mean, half_width=half_width, wanted=wanted, oddity=oddity)


# The decision: another repetition, or the end.


class UntilPrecise:
    """Asks for one repetition after another until all rules are fulfilled, or give up.

    At the first look there are `least` repetitions.
    """

    def __init__(self, rules: Sequence[Precision], factors: Sequence[Factor], least: int) -> None:
        self._rules = rules
        self._factors = factors
        self._looks = (least, most_repetitions(rules))
        self.measures = tuple(dict.fromkeys(rule.measure for rule in rules))

    def may_add(self, runs: Sequence[PlannedRun]) -> bool:
        """Return whether there may be another repetition."""
        return _repetitions(runs) < self._looks[1]

    def ask(self, told: Sequence[Told]) -> Decision:
        """Return the next repetition of all combinations, or why there is none."""
        runs = [each.run for each in told]
        now = _repetitions(runs)
        judged = tuple(judge(rule, self._looks, now, _observed(told, rule.measure)) for rule in self._rules)
        wanted = list(self._next(runs, now + 1)) if any(each.needs_more for each in judged) else []
        known = "; ".join(each.in_words() for each in judged)
        follows = f"once more, {counted(len(wanted), 'run')}" if wanted else "repeated no further"
        return Decision(
            name=f"repetition {now + 1}",
            in_words=f"after {counted(now, 'repetition')}, {known}: {follows}",
            runs=wanted,
            kind=REPEATED,
            # A record that adds runs has the number of their repetition.
            facts={**({} if wanted else {"repetition": now}), "precision": list(map(_facts, judged))},
            findings=() if wanted else tuple(chain.from_iterable(map(_ending_findings, judged))),
        )

    def _next(self, runs: Sequence[PlannedRun], repetitions: int) -> Iterator[tuple[Combination, int]]:
        combinations = {run.combination.texts: run.combination for run in runs}
        factors, copies = tuple(self._factors), copies_in(runs)
        design = ExtendedDesign(factors, list(combinations.values()), repetitions, {}, {}, copies)
        return missing_runs(runs, design)


def _repetitions(runs: Sequence[PlannedRun]) -> int:
    return max(run.repetition for run in runs)


def _observed(told: Sequence[Told], measure: str) -> Iterator[Observed]:
    """Yield the value of each run that is not excluded."""
    for each in told:
        if not each.is_excluded or each.is_doubtful:
            treatments = texts_of(each.run.combination)
            yield Observed(each.run.run_id, treatments, each.run.repetition, each.values.get(measure), each.run.batch)


def _facts(judgement: Judgement) -> dict[str, Any]:
    """Return a judgement as plain data, for the journal."""
    return {
        **judgement.rule.as_mapping(),
        "is_precise": judgement.is_precise,
        "in_a_row": judgement.in_a_row,
        "level": judgement.level,
        "in_words": judgement.in_words(),
        "known": [{name: value for name, value in asdict(each).items() if value} for each in judgement.known],
    }


def _ending_findings(judgement: Judgement) -> Iterator[tuple[str, str]]:
    """Yield problem and fix of each warning at the end, once no repetition follows."""
    measure = judgement.rule.measure
    for problem in judgement.problems:
        yield f"{measure}: {problem}", _SEE_WHY
    for each in judgement.known:
        if each.oddity:
            yield f"{measure} of {each.of}: {each.oddity}", "Check whether it is resolved."
    if not judgement.is_precise and not judgement.problems:
        often, most = counted(judgement.repetitions, "repetition"), judgement.rule.at_most
        # Another rule may go on for longer.
        which = "which is at_most" if judgement.repetitions == most else f"and at_most is {most}"
        problem = f"not as precise as wanted after {often}, {which}. {judgement.in_words()}"
        yield problem, "Report the interval that there is: more was not planned."


_SEE_WHY = "See why, or ask for a half width in the measure's unit. It was not repeated for this."
