"""Yes-or-no measures whose runs belong together: shares of yes of blocks, subjects or plots are compared as means are.

Exact tests take runs for independent. Where a block, a subject or a whole plot has several runs of a treatment, it may
respond to treatments in its own way, and differences of all are then found by chance in 10 to 34 %. By simulation
(docs/procedures.md) tests of shares find them in 0 to 7 %.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

from robot_runner.analysis.statistics.analysed_design import VALUE, MeasureData
from robot_runner.analysis.statistics.batch_strata import comparable
from robot_runner.analysis.statistics.cell_means import CellMeans
from robot_runner.analysis.statistics.linear_model import FittedModel
from robot_runner.analysis.statistics.post_hoc import MOST_PAIRS, adjusted, compare_pairs
from robot_runner.analysis.statistics.proportions import PROPORTION, QUANTITY, compare_proportions, runs_together
from robot_runner.analysis.statistics.strata_model import StrataModel
from robot_runner.analysis.statistics.tested import Comparison, MeasureTest, NotComputed, PostHoc
from robot_runner.analysis.statistics.tests import Choices, carry_out, model_of
from robot_runner.core.design.analysis_plan import Estimand

#: The largest difference of two shares, in percentage points.
_MOST = 100.0


def in_points(answers: MeasureData) -> MeasureData:
    """Return a yes-or-no measure with 100 for yes, so that its means are percentages."""
    frame, every = (of.assign(**{VALUE: 100 * of[VALUE]}) for of in (answers.frame, answers.every))
    return replace(answers, frame=frame, every=every)


def compare_shares(
    answers: MeasureData, choices: Choices
) -> tuple[MeasureTest, tuple[PostHoc, ...], tuple[NotComputed, ...]] | None:
    """Return the test and the pairs of a yes-or-no measure whose runs belong together, with what was not computed.

    Args:
        answers: the measure, 1 for yes and 0 for no.
        choices: of the analysis plan; means are compared, whatever its estimand.

    Returns:
        None where exact tests serve: of runs that stand by themselves, of blocks with a single run of each treatment,
        and where too many blocks are incomplete or all of them respond in the same way.
    """
    choices = replace(choices, estimand=Estimand.MEAN)
    if not answers.known.columns and not (answers.is_blocked and runs_together(answers) > 1):
        return None
    shares, note, apart = comparable(in_points(answers))
    model = model_of(shares, Estimand.MEAN, choices.statistic)
    # Mixed models serve where a whole plot has lost a run; those of incomplete blocks have one response for all blocks.
    served = (StrataModel, FittedModel) if answers.known.columns else CellMeans
    if not isinstance(model, served):
        return None
    test = carry_out(shares, model, choices)
    found, missed = compare_pairs(shares, model, test, choices)
    pairs = tuple(replace(of, quantity=QUANTITY, comparisons=tuple(map(_of_shares, of.comparisons))) for of in found)
    if not answers.known.columns:
        known = {each.factors for each in test.effects if each.p_value is not None}
        pairs = tuple(_with_exact(pairs, known, answers, choices))
    return (
        replace(
            test,
            notes=(note, *test.notes) if note else test.notes,
            estimand=PROPORTION,
            reason=f"{test.reason} The measure is yes or no: shares of yes are compared, as means are.",
            effects=tuple(replace(each, effect_sizes=(), check=None) for each in test.effects),
        ),
        pairs,
        (*apart, *missed),
    )


def _of_shares(pair: Comparison) -> Comparison:
    """Return a pair without what is of numbers only, and with an interval of differences that are possible."""
    interval = pair.interval
    if interval is not None:
        interval = replace(interval, low=max(-_MOST, interval.low), high=min(_MOST, interval.high))
    return replace(pair, interval=interval, effect_sizes=(), check_p_value=None)


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
        after = iter(adjusted([each.p_value for each in pairs if each.p_value is not None], choices.correction))
        told = tuple(
            pair
            if pair.p_value is None
            else replace(pair, adjusted_p_value=(value := next(after)), is_significant=value < choices.alpha)
            for pair in pairs
        )
        yield replace(of, method=f"{of.method}; exact tests where all blocks differ in the same way", comparisons=told)
