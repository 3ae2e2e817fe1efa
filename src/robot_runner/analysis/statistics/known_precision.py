"""The precision of measures in an experiment with `repeat_until`; the core computes the intervals."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from scipy import stats

from robot_runner.analysis.statistics.descriptive import quiet
from robot_runner.analysis.statistics.tested import Interval
from robot_runner.core.design.columns import RUN_ID, STATUS
from robot_runner.core.design.numeric_range import is_number
from robot_runner.core.design.precise_estimates import Judgement, Known, Observed, judge
from robot_runner.core.design.precision import PreciseOf, Precision, most_repetitions, rule_in_words, rules_of_mapping
from robot_runner.core.design.repeated_intervals import CONFIDENCE, METHOD, level_at_each_look
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.words import counted

if TYPE_CHECKING:
    from robot_runner.analysis.results import Results

#: The skewness from which on values count as skewed, and the fewest values of a combination for an estimate. By
#: simulation, this flags 1 to 10 % of experiments with normal values (most often with few), and 50 to 100 % with
#: exponential ones.
_SKEWED, _TELLING = 0.8, 5


@dataclass(frozen=True, slots=True)
class KnownPrecision:
    """The precision of one measure of `repeat_until`.

    Attributes:
        asked: the rule in words: the precision, and the fewest and most repetitions.
        level: the confidence level of each interval at one look, so that all looks together have 95 %.
        means, differences: of each combination, and between any two treatments of a factor within repetitions.
    """

    measure: str
    asked: str
    repetitions: int
    level: float
    is_reached: bool
    means: tuple[Known, ...]
    differences: tuple[Known, ...]
    sentence: str


def known_precisions(results: Results, left_out: Mapping[str, Collection[str]]) -> tuple[KnownPrecision, ...]:
    """Return the precision of each measure of `repeat_until`; empty without such a rule.

    `left_out` has the runs whose value the analysis leaves out, by measure.
    """
    return tuple(
        _known(results, measure, rules, left_out.get(measure, ())) for measure, rules in _rules(results).items()
    )


def level_of_looks(results: Results, measure: str) -> float | None:
    """Return the level of each interval of a measure of `repeat_until`; None for other measures."""
    return level_at_each_look(*_looks(results)) if measure in _rules(results) else None


def repeated_interval(known: Known) -> Interval | None:
    """Return the interval of a mean or difference, at 95 % over all looks."""
    if known.mean is None or known.half_width is None:
        return None
    return Interval(known.mean - known.half_width, known.mean + known.half_width, CONFIDENCE, METHOD)


def _rules(results: Results) -> dict[str, list[Precision]]:
    """Return the rules of each measure in the run table."""
    found: dict[str, list[Precision]] = {}
    for rule in rules_of_mapping(results.manifest.get("repeat_until"))[0] if results.repetition else ():
        if rule.measure in results.measures:
            found.setdefault(rule.measure, []).append(rule)
    return found


def _looks(results: Results) -> tuple[int, int]:
    """Return the numbers of repetitions at the first look, and at the last possible one."""
    rules, least = rules_of_mapping(results.manifest["repeat_until"])
    return least, max(least, most_repetitions(rules), _repetitions(results))


def _repetitions(results: Results) -> int:
    return int(results.runs[results.repetition].max())


def _known(results: Results, measure: str, rules: list[Precision], left_out: Collection[str]) -> KnownPrecision:
    looks, repetitions = _looks(results), _repetitions(results)
    observed = list(_observed(results, measure, left_out))
    judged = [judge(rule, looks, repetitions, observed) for rule in rules]
    asked = rule_in_words(rules, looks[0])
    known = {}
    for of in PreciseOf:
        # Without a rule on them, they are computed all the same; of several rules, one that is not reached is taken.
        own = [each for each in judged if each.rule.of is of]
        other = Precision(measure, half_width=rules[0].wanted_in_words, at_most=rules[0].at_most, of=of)
        found = next((each for each in own if not each.is_precise), None) or next(iter(own), None)
        known[of] = (found or judge(other, looks, repetitions, observed)).known
    return KnownPrecision(
        measure,
        asked,
        repetitions,
        judged[0].level,
        all(each.is_precise for each in judged),
        known[PreciseOf.MEANS],
        known[PreciseOf.DIFFERENCES],
        _sentence(measure, asked, judged, _skewness(observed)) + _without(left_out),
    )


def _observed(results: Results, measure: str, left_out: Collection[str]) -> Iterator[Observed]:
    runs = results.runs
    values = runs[measure].where(runs[STATUS] == RunStatus.DONE.value)
    treatments = zip(*(runs[name].astype("str") for name in results.factors), strict=True)
    batches = [1] * len(runs) if results.batch is None else runs[results.batch]
    rows = zip(runs[RUN_ID], treatments, runs[results.repetition], values, values.isna(), batches, strict=True)
    for run_id, texts, repetition, value, is_missing, batch in rows:
        plain = None if is_missing or run_id in left_out else value.item() if hasattr(value, "item") else value
        yield Observed(run_id, dict(zip(results.factors, texts, strict=True)), int(repetition), plain, int(batch))


def _without(left_out: Collection[str]) -> str:
    if not left_out:
        return ""
    return f" This is without {counted(len(left_out), 'value')} that the analysis leaves out; see there."


def _sentence(measure: str, asked: str, judged: list[Judgement], skewness: float) -> str:
    """Return the summary: the rule and what was reached, the kind of intervals, and the error rate of the tests."""
    reached = "; ".join(each.in_words() for each in judged)
    level = f"{judged[0].level:.1%}".replace("%", " %")
    is_early = any(each.needs_more for each in judged)
    sized = "up to 9 %, as it ended before the rule was followed to its end," if is_early else "3.5 to 6.5 %"
    skewed = (
        f" Values are skewed ({skewness:.1f} within combinations), and few skewed values tell little of their tail: "
        "the intervals hold in 88 to 95 %, as Student's do of planned numbers."
    )
    return (
        f"Combinations were repeated {asked}. After {judged[0].repetitions}, {reached}. Student's intervals hold less "
        f"often than they say after that (92 %), so those of the means of {measure} are repeated confidence intervals: "
        f"each has a level of {level}, with which all looks together hold at 95 %. Tests and their p-values take no "
        f"account of the looks: at 5 %, {sized} of experiments without a difference show one."
    ) + (skewed if abs(skewness) > _SKEWED else "")


def _skewness(observed: list[Observed]) -> float:
    """Return the mean of the bias-corrected skewness of combinations; 0 if all have too few values."""
    groups: dict[tuple[tuple[str, str], ...], list[float]] = {}
    for run in observed:
        if is_number(run.value):
            groups.setdefault(tuple(run.treatments.items()), []).append(float(run.value))
    with quiet():
        found = [float(stats.skew(each, bias=False)) for each in groups.values() if len(each) >= _TELLING]
    return math.fsum(told) / len(told) if (told := [each for each in found if math.isfinite(each)]) else 0.0
