"""Yes-or-no measures whose runs belong together: shares of yes of blocks, subjects or plots are compared as means are.

Exact tests take runs for independent. Where a block, a subject or a whole plot has several runs of a treatment, it may
respond to treatments in its own way, and differences of all are then found by chance in 10 to 34 %. By simulation
(docs/procedures.md) tests of shares find them in 0 to 7 %.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from robot_runner.analysis.statistics.analysed_design import VALUE, MeasureData
from robot_runner.analysis.statistics.batch_strata import comparable
from robot_runner.analysis.statistics.cell_means import CellMeans
from robot_runner.analysis.statistics.linear_model import FittedModel
from robot_runner.analysis.statistics.post_hoc import MOST_PAIRS, carry_out_contrast, compare_pairs, with_adjusted
from robot_runner.analysis.statistics.proportion_contrasts import carry_out_contrast_of_proportions, with_larger_p_value
from robot_runner.analysis.statistics.proportions import PROPORTION, QUANTITY, compare_proportions, runs_together
from robot_runner.analysis.statistics.strata_model import StrataModel
from robot_runner.analysis.statistics.tested import (
    Comparison,
    ContrastTest,
    Interval,
    MeasureTest,
    NotComputed,
    PostHoc,
)
from robot_runner.analysis.statistics.tests import AnyModel, Choices, carry_out, model_of
from robot_runner.core.design.analysis_plan import Estimand

if TYPE_CHECKING:
    from robot_runner.core.design.hypothesis import Hypothesis

#: The largest difference of two shares, in percentage points.
_MOST = 100.0


def in_points(answers: MeasureData) -> MeasureData:
    """Return a yes-or-no measure with 100 for yes, so that its means are percentages."""
    frame, every = (of.assign(**{VALUE: 100 * of[VALUE]}) for of in (answers.frame, answers.every))
    return replace(answers, frame=frame, every=every)


class ComparedShares(NamedTuple):
    """The comparisons of a yes-or-no measure whose runs belong together.

    Attributes:
        contrasts: of hypotheses; why there is none, where it could not be computed.
        missed: what else was not computed.
    """

    test: MeasureTest
    pairs: tuple[PostHoc, ...]
    contrasts: tuple[ContrastTest | NotComputed, ...]
    missed: tuple[NotComputed, ...]


def belong_together(answers: MeasureData) -> bool:
    """Return whether runs of a block, a subject or a plot may respond to treatments in their own way."""
    return bool(answers.known.columns) or (answers.is_blocked and runs_together(answers) > 1)


def are_compared(answers: MeasureData, model: AnyModel | NotComputed) -> bool:
    """Return whether shares are compared by this model, and not by exact tests.

    Mixed models serve where a whole plot has lost a run; those of incomplete blocks have one response for all blocks.
    """
    return isinstance(model, (StrataModel, FittedModel) if answers.known.columns else CellMeans)


def compare_shares(
    answers: MeasureData, choices: Choices, hypotheses: Sequence[Hypothesis] = ()
) -> ComparedShares | None:
    """Return the comparisons of a yes-or-no measure whose runs belong together.

    Answers are 1 for yes and 0 for no. Means are compared, whatever the estimand, and hypotheses are in percentage
    points.

    Returns:
        None where exact tests serve: of runs that stand by themselves, of blocks with a single run of each treatment,
        and where too many blocks are incomplete or all of them respond in the same way.
    """
    choices = replace(choices, estimand=Estimand.MEAN)
    if not belong_together(answers):
        return None
    shares, note, apart = comparable(in_points(answers))
    model = model_of(shares, Estimand.MEAN, choices.statistic)
    if isinstance(model, NotComputed) or not are_compared(answers, model):
        return None
    test = carry_out(shares, model, choices)
    found, missed = compare_pairs(shares, model, test, choices)
    pairs = tuple(replace(of, quantity=QUANTITY, comparisons=tuple(map(_of_shares, of.comparisons))) for of in found)
    if not answers.known.columns:
        known = {each.factors for each in test.effects if each.p_value is not None}
        pairs = tuple(_with_exact(pairs, known, answers, choices))
    return ComparedShares(
        replace(
            test,
            notes=(note, *test.notes) if note else test.notes,
            estimand=PROPORTION,
            reason=f"{test.reason} The measure is yes or no: shares of yes are compared, as means are.",
            effects=tuple(replace(each, effect_sizes=(), check=None) for each in test.effects),
        ),
        pairs,
        tuple(_of_sum(carry_out_contrast(model, each, choices), each, answers, choices) for each in hypotheses),
        (*apart, *missed),
    )


def _of_shares(pair: Comparison) -> Comparison:
    """Return a pair without what is of numbers only, and with an interval of differences that are possible."""
    interval = None if pair.interval is None else _limited(pair.interval, _MOST)
    return replace(pair, interval=interval, effect_sizes=(), check_p_value=None)


def _of_sum(
    found: ContrastTest | NotComputed, hypothesis: Hypothesis, answers: MeasureData, choices: Choices
) -> ContrastTest | NotComputed:
    """Return the test of a contrast with an interval of sums that are possible.

    Treatments that do not vary, as two that always succeed, may still be within a bound: each block is a run then.
    """
    if isinstance(found, NotComputed):
        is_by_score = hypothesis.has_bound and not answers.known.columns
        return carry_out_contrast_of_proportions(answers, hypothesis, choices) if is_by_score else found
    if hypothesis.has_bound:
        found = with_larger_p_value(found, answers, hypothesis)
    most = _MOST * sum(max(0.0, weight) for weight in (hypothesis.contrast or {"": 1.0}).values())
    return replace(found, interval=_limited(found.interval, most))


def _limited(interval: Interval, most: float) -> Interval:
    return replace(interval, low=max(-most, interval.low), high=min(most, interval.high))


def _with_exact(
    found: Sequence[PostHoc], known: Collection[tuple[str, ...]], answers: MeasureData, choices: Choices
) -> Iterator[PostHoc]:
    """Yield the pairs; of known effects, those that differ alike in all blocks, as two that always succeed, exactly."""
    lacking = [of for of in found if of.factors in known and any(pair.p_value is None for pair in of.comparisons)]
    exact = {
        (each.factors, pair.first, pair.second): pair
        for each in (compare_proportions(answers, choices, MOST_PAIRS) if lacking else ())
        if isinstance(each, PostHoc)
        for pair in each.comparisons
    }
    for of in found:
        if of not in lacking:
            yield of
            continue
        pairs = [
            pair
            if pair.p_value is not None
            else replace(exact.get((of.factors, pair.first, pair.second), pair), difference=pair.difference)
            for pair in of.comparisons
        ]
        method = f"{of.method}; exact tests where all blocks differ in the same way"
        yield replace(of, method=method, comparisons=with_adjusted(pairs, choices))
