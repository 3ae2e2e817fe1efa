"""Measures that are yes or no are described, tested and drawn as proportions."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy import stats
from statsmodels.stats.contingency_tables import StratifiedTable
from statsmodels.stats.proportion import confint_proportions_2indep, proportion_confint
from tests.analysis.made_experiment import make_experiment
from tests.analysis.statistics.designed_data import designed

from robot_runner.analysis import analyse, load_results
from robot_runner.analysis.statistics.disclosed import Reason
from robot_runner.analysis.statistics.grouped_runs import Group
from robot_runner.analysis.statistics.proportions import QUANTITY, Strata, _proportion, _statistics_drawn
from robot_runner.analysis.statistics.tested import TestMethod
from robot_runner.core.design.analysis_plan import AnalysisPlan, Estimand, Hypothesis
from robot_runner.core.design.factor import Factor

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from robot_runner.analysis.statistics.outcome import ExperimentStatistics, MeasureStatistics

PLANNER = Factor("Planner", ["DWB", "TEB"])
ROOM = Factor("Room", ["lab", "hall", "yard"])


def analysed(
    folder: Path, factors: Sequence[Factor], yes: dict[tuple[str, ...], list[bool | None]], **more: Any
) -> ExperimentStatistics:
    """Analyse an experiment whose runs of each combination say these, one a repetition; None is missing."""
    experiment = make_experiment(
        folder / "made",
        factors,
        lambda treatments, repetition: {"Success": yes[tuple(map(str, treatments.values()))][repetition - 1]},
        repetitions=max(map(len, yes.values())),
        measures=("Success",),
        **more,
    )
    return analyse(load_results(experiment.root))


def said(count: int, n: int) -> list[bool | None]:
    """Return the answers of `n` runs, of which so many say yes."""
    return [True] * count + [False] * (n - count)


#: Runs that say yes, of ten each; tested in R 4.2.2 by mantelhaen.test(exact=TRUE), without it, and fisher.test.
IN_ROOMS = {
    ("DWB", "lab"): said(8, 10),
    ("DWB", "hall"): said(5, 10),
    ("DWB", "yard"): said(9, 10),
    ("TEB", "lab"): said(3, 10),
    ("TEB", "hall"): said(1, 10),
    ("TEB", "yard"): said(6, 10),
}


def test_a_proportion_has_the_score_interval_of_wilson(tmp_path: Path) -> None:
    found = analysed(tmp_path, [PLANNER], {("DWB",): said(8, 10), ("TEB",): [*said(3, 9), None]}).measure("Success")
    assert found.proportions is not None
    one, other = found.proportions.by_treatment
    assert (one.n, one.missing, one.count, one.percent) == (10, 0, 8, 80)
    assert one.interval is not None
    # R: prop.test(8, 10, correct = FALSE)$conf.int
    assert (one.interval.low, one.interval.high) == pytest.approx((49.0162471537, 94.3317848546))
    assert (other.n, other.missing, other.count) == (9, 1, 3)
    assert found.overall is None, "nothing of it is a mean"
    assert found.unit == "%"


def wilson(count: float, n: float, units: int) -> tuple[float, float]:
    """Return Wilson's interval in percent, with t in the place of z, by statsmodels."""
    alpha = 2 * stats.norm.sf(stats.t.isf(0.025, units - 1))
    low, high = proportion_confint(count, n, alpha, method="wilson")
    return 100 * low, 100 * high


def test_runs_of_a_block_count_together_in_the_interval_of_a_proportion(tmp_path: Path) -> None:
    rooms = [2, 0, 1, 3, 3, 1]  # how many of the three missions of each block reach their goal
    yes = {("DWB", room): [count > place for count in rooms] for place, room in enumerate(ROOM.texts)}
    yes |= {("TEB", room): [True] * 6 for room in ROOM.texts}
    found = analysed(tmp_path, [PLANNER, ROOM], yes, blocks="Repetition").measure("Success").proportions
    assert found is not None
    dwb, teb = found.by_treatment[:2]
    shares = np.array(rooms) / 3
    variance, share = np.var(shares, ddof=1) / 6, np.mean(shares)
    worth = share * (1 - share) / variance
    assert 6 < worth < 18
    assert dwb.interval is not None
    assert (dwb.interval.low, dwb.interval.high) == pytest.approx(wilson(share * worth, worth, 6))
    assert dwb.interval.method == "Wilson's score interval, runs of one Repetition counting together"
    assert teb.interval is not None
    assert (teb.interval.low, teb.interval.high) == pytest.approx(wilson(6, 6, 6)), "all alike: a block is worth a run"
    lab = found.by_combination[0].interval
    assert lab is not None
    low, high = (100 * each for each in proportion_confint(5, 6, method="wilson"))
    assert ((lab.low, lab.high), lab.method) == (pytest.approx((low, high)), "Wilson's score interval"), "one run each"


@pytest.mark.parametrize(("plots", "worth"), [((4, 0, 4, 0), 4), ((3, 3, 3, 3), 16), ((4, 4, 4, 4), 4)])
def test_runs_are_worth_no_less_than_their_plots_and_no_more_than_themselves(
    plots: tuple[int, ...], worth: int
) -> None:
    units = np.repeat(np.arange(4), 4)
    values = np.array([float(place < count) for count in plots for place in range(4)])
    found = _proportion(Group({}, values, ("",) * 16, units=units, unit="Laying")).interval
    assert found is not None
    assert (found.low, found.high) == pytest.approx(wilson(values.mean() * worth, worth, 4))
    assert _proportion(Group({}, values[:4], ("",) * 4, units=units[:4], unit="Laying")).interval is None


def test_the_proportions_of_a_split_plot_and_of_a_crossover_know_their_units() -> None:
    def of(unit: str, facts: dict[str, Any]) -> str:
        rows = [
            (f"u{each}", 1 + each // 2 % 2, "ab"[each % 2], run == each % 3) for each in range(8) for run in range(2)
        ]
        results = designed(rows, (unit, "Period", "Planner"), facts)
        results.table["y"] = results.table["y"].astype("boolean")
        found = analyse(results).measure("y").proportions
        assert found is not None
        assert found.by_treatment[-1].interval is not None
        return found.by_treatment[-1].interval.method

    told = "Wilson's score interval, runs of one {} counting together"
    assert of("Laying", {"kind": "split_plot", "whole_plot": "Laying"}) == told.format("Laying")
    assert of("Driver", {"kind": "crossover", "subject": "Driver", "period": "Period"}) == told.format("Driver")


def test_two_treatments_are_compared_by_fishers_exact_test(tmp_path: Path) -> None:
    found = analysed(tmp_path, [PLANNER], {("DWB",): said(8, 10), ("TEB",): said(3, 10)}).measure("Success")
    assert found.test is not None
    (effect,) = found.test.effects
    assert effect.test == "Fisher's exact"
    assert effect.p_value == pytest.approx(0.0697785186949)  # R: fisher.test
    assert effect.p_value == pytest.approx(stats.fisher_exact([[8, 2], [3, 7]]).pvalue)
    (pair,) = found.post_hoc[0].comparisons
    assert pair.difference == pytest.approx(50)
    low, high = confint_proportions_2indep(8, 10, 3, 10, method="newcomb", compare="diff")
    assert pair.interval is not None
    assert (pair.interval.low, pair.interval.high) == pytest.approx((100 * low, 100 * high))
    assert pair.adjusted_p_value == effect.p_value


def test_runs_are_compared_that_differ_in_nothing_else(tmp_path: Path) -> None:
    found = analysed(tmp_path, [PLANNER, ROOM], IN_ROOMS).measure("Success")
    assert found.test is not None
    planner, room = found.test.effects
    assert planner.test == "exact Cochran-Mantel-Haenszel"
    assert planner.p_value == pytest.approx(0.00214069941867)  # R
    strata = [np.array([[8, 2], [3, 7]]), np.array([[5, 5], [1, 9]]), np.array([[9, 1], [6, 4]])]
    assert planner.statistic == pytest.approx(StratifiedTable(strata).test_null_odds().statistic)
    # R: mantelhaen.test of the three rooms, by planner; its p-value, 0.00905, is that of very many runs.
    assert (room.statistic, room.degrees_of_freedom) == (pytest.approx(9.4095744680851), (2.0,))
    assert room.p_value == pytest.approx(0.00905, rel=0.25)
    assert "Interactions of proportions are not tested" in found.test.notes[0]


def test_three_treatments_have_the_probability_of_all_tables_as_uneven(tmp_path: Path) -> None:
    counts, sizes = (4, 1, 0), (4, 5, 3)
    answers = {(room,): [*said(count, n), None, None][:5] for room, count, n in zip(ROOM.treatments, counts, sizes)}  # noqa: B905
    found = analysed(tmp_path, [ROOM], answers).measure("Success")
    assert found.test is not None
    statistics, chances = [], []
    for table in itertools.product(*(range(n + 1) for n in sizes)):
        if sum(table) == sum(counts):
            chances.append(math.prod(map(math.comb, sizes, table)))
            statistics.append(sum((k - n * 5 / 12) ** 2 / n for k, n in zip(table, sizes, strict=True)))
            if table == counts:
                seen = statistics[-1]
    exact = sum(p for p, each in zip(chances, statistics, strict=True) if each >= seen - 1e-9) / sum(chances)
    p_value = found.test.effects[0].p_value
    assert p_value == pytest.approx(exact, abs=4 * math.sqrt(exact * (1 - exact) / 49_999))


def test_where_three_treatments_say_yes_equally_often_no_table_is_less_uneven() -> None:
    """Their statistic is 0, and some 1e-32 by rounding, as is that of many tables that are dealt."""
    yes = [[1, 1, 1], [1, 1, 1], [0, 0, 1], [1, 1, 1], [1, 1, 0], [1, 0, 0], [0, 1, 1]]
    table = Strata(np.ones((7, 3), dtype=np.int64), np.array(yes))
    assert table.statistic() == (0, 2)
    assert table.p_value(999) == 1
    assert Strata(np.full((1, 7), 6), np.full((1, 7), 5)).p_value(999) == 1


def test_runs_are_compared_within_their_block(tmp_path: Path) -> None:
    answers = {("DWB",): [True, True, True, True, False, True], ("TEB",): [False, True, False, False, False, False]}
    found = analysed(tmp_path, [PLANNER], answers, blocks="Repetition").measure("Success")
    assert found.test is not None
    # Of pairs that differ, 4 speak for one and none for the other: the test of McNemar.
    assert found.test.effects[0].p_value == pytest.approx(stats.binomtest(4, 4).pvalue)
    assert "of one block" in found.test.reason


#: How many of five runs say yes in each of six blocks.
IN_SIX_BLOCKS = {"DWB": (5, 4, 5, 3, 4, 5), "TEB": (2, 3, 4, 3, 1, 3), "MPPI": (4, 4, 2, 5, 3, 4)}


def in_blocks(folder: Path, counts: dict[str, tuple[int, ...]]) -> MeasureStatistics:
    """Analyse planners in blocks of five runs of each."""
    blocks = [f"room {place}" for place in range(6)]
    yes = {(planner, block): said(of, 5) for planner, k in counts.items() for block, of in zip(blocks, k, strict=True)}
    factors = [Factor("Planner", list(counts)), Factor("Room", blocks)]
    return analysed(folder, factors, yes, blocks="Room").measure("Success")


def test_shares_of_blocks_are_compared_where_these_have_several_runs_of_a_treatment(tmp_path: Path) -> None:
    """Exact tests would take runs of a block for independent, and find (p = 0.010) what may be of some rooms only."""
    found = in_blocks(tmp_path, {name: IN_SIX_BLOCKS[name] for name in ("DWB", "TEB")})
    assert found.test is not None
    (effect,), (pair,) = found.test.effects, found.post_hoc[0].comparisons
    # R 4.2.2: t.test(20 * dwb, 20 * teb, paired = TRUE); summary(aov(yes ~ planner + Error(room / planner))).
    assert [effect.p_value, pair.p_value] == pytest.approx([0.01986805] * 2, abs=5e-9)
    assert (effect.statistic, effect.degrees_of_freedom) == (pytest.approx(11.36364**0.5), (5.0,))
    assert pair.difference == pytest.approx(33.33333333)
    assert pair.interval is not None
    assert (pair.interval.low, pair.interval.high) == pytest.approx((7.914739839, 58.751926827))
    assert (found.test.estimand, found.post_hoc[0].quantity) == ("proportion", QUANTITY)
    assert found.test.reason == (
        "One factor with 2 treatments, in blocks: means are compared within each block, and chance is how blocks "
        "differ in that. The measure is yes or no: shares of yes are compared, as means are."
    )
    assert effect.conclusion.startswith(
        "Planner has an effect on Success: the proportion of DWB is higher than that of TEB by 33.33 percentage points"
    )


def test_three_treatments_within_blocks_of_several_runs_have_the_analysis_of_variance_of_their_shares(
    tmp_path: Path,
) -> None:
    found = in_blocks(tmp_path, IN_SIX_BLOCKS).test
    assert found is not None
    # R: anova(lm(shares ~ 1), X = ~1, test = "Spherical"), by Huynh and Feldt.
    assert found.effects[0].statistic == pytest.approx(3.87755, abs=5e-6)
    assert found.effects[0].p_value == pytest.approx(0.05667403539)


def test_factors_within_blocks_are_tested_with_interactions_by_shares(tmp_path: Path) -> None:
    """In R 4.2.2: summary(aov(yes ~ planner * load + Error(block / (planner * load))))."""
    by_block = ["1110", "1100", "1010", "1101", "0100", "1111"]
    cells = [("DWB", "empty"), ("DWB", "full"), ("TEB", "empty"), ("TEB", "full")]
    yes: dict[tuple[str, ...], list[bool | None]] = {
        cell: [of[place] == "1" for of in by_block] for place, cell in enumerate(cells)
    }
    found = analysed(tmp_path, [PLANNER, Factor("Load", ["empty", "full"])], yes, blocks="Repetition").measure(
        "Success"
    )
    assert found.test is not None
    figures = {each.label: (each.statistic**2, each.p_value) for each in found.test.effects if each.statistic}
    assert figures["Planner"] == pytest.approx((7.35294, 0.042194), rel=1e-5)
    assert figures["Load"] == pytest.approx((0.12195, 0.74115), rel=1e-4)
    assert figures["Planner x Load"] == pytest.approx((0.29412, 0.61088), rel=1e-4)


def test_intervals_of_differences_of_shares_end_at_100_points(tmp_path: Path) -> None:
    found = in_blocks(tmp_path, {"DWB": (5, 5, 5, 5, 5, 5), "TEB": (0, 0, 0, 0, 0, 2)})
    (pair,) = found.post_hoc[0].comparisons
    assert pair.interval is not None
    assert (pair.difference, pair.interval.high) == (pytest.approx(100 * 28 / 30), 100)
    assert 0 < pair.interval.low < 90


def test_where_all_blocks_respond_in_the_same_way_the_exact_test_serves_and_says_so(tmp_path: Path) -> None:
    found = in_blocks(tmp_path, {"DWB": (5,) * 6, "TEB": (0,) * 6}).test
    assert found is not None
    assert found.effects[0].test == "exact Cochran-Mantel-Haenszel"
    assert found.effects[0].p_value == pytest.approx(2 * math.comb(10, 5) ** -6)
    assert [note for note in found.notes if "all of these respond in the same way: so runs of one count" in note]


@pytest.mark.long
def test_pairs_that_differ_alike_in_all_blocks_have_their_exact_test(tmp_path: Path) -> None:
    counts = {"DWB": (5,) * 6, "TEB": (2, 3, 4, 3, 1, 3), "MPPI": (5,) * 6, "None": (0,) * 6}
    (of,) = in_blocks(tmp_path, counts).post_hoc
    pairs = {(each.first, each.second): each for each in of.comparisons}
    p_values = {pair: each.p_value for pair, each in pairs.items()}
    shares = (np.array(counts["DWB"]) - np.array(counts["TEB"])) / 5
    assert p_values["DWB", "TEB"] == pytest.approx(stats.ttest_1samp(shares, 0).pvalue)
    assert p_values["DWB", "None"] == pytest.approx(2 * math.comb(10, 5) ** -6)
    alike = pairs["DWB", "MPPI"]
    assert (alike.p_value, alike.adjusted_p_value, alike.difference) == (1, 1, 0)
    assert alike.interval is not None
    assert alike.interval.method == "Newcombe's score interval"
    assert pairs["DWB", "None"].is_significant
    assert of.method.endswith("exact tests where all blocks differ in the same way")


def test_blocks_with_a_run_of_each_treatment_have_the_exact_test(tmp_path: Path) -> None:
    """Its level does not depend on how blocks respond."""
    yes = {("DWB",): said(6, 6), ("TEB",): said(1, 6)}
    found = analysed(tmp_path, [PLANNER], yes, blocks="Repetition").measure("Success").test
    assert found is not None
    assert found.effects[0].test == "exact Cochran-Mantel-Haenszel"
    assert not [note for note in found.notes if "count as independent" in note]


def test_a_treatment_that_always_succeeds_is_no_obstacle(tmp_path: Path) -> None:
    found = analysed(tmp_path, [PLANNER], {("DWB",): said(8, 8), ("TEB",): said(0, 8)}).measure("Success")
    assert found.test is not None
    (effect,) = found.test.effects
    assert effect.p_value == pytest.approx(2 / math.comb(16, 8))
    assert effect.conclusion == (
        "Planner has an effect on Success: the proportion of DWB is higher than that of TEB by 100.0 percentage points "
        "(Mantel-Haenszel χ²(1) = 15.0, p < 0.001)."
    )
    (pair,) = found.post_hoc[0].comparisons
    assert pair.interval is not None
    assert 0 < pair.interval.low < pair.interval.high <= 100


@pytest.mark.parametrize(("answers", "why"), [(said(6, 6), "all runs say yes."), (said(0, 6), "all runs say no.")])
def test_where_all_say_the_same_nothing_is_tested(tmp_path: Path, answers: list[bool | None], why: str) -> None:
    found = analysed(tmp_path, [PLANNER], {("DWB",): answers, ("TEB",): answers}).measure("Success")
    assert found.test is None
    assert [each.why for each in found.not_computed] == [why]
    assert found.proportions is not None
    assert found.proportions.overall.n == 12


@pytest.mark.long
def test_an_exact_p_value_that_is_the_level_is_not_below_it() -> None:
    """Of 2 and 14 runs, of which both and two say yes: 6 of 120 tables, which rounding left below 0.05."""
    for yes in ([2, 2], [0, 12]):
        assert Strata(np.array([[2, 14]]), np.array([yes])).p_value() == 6 / 120
    assert Strata(np.array([[3, 3]]), np.array([[3, 0]])).p_value() == 0.1


def test_a_pair_is_judged_by_the_exact_test_as_an_effect_is(tmp_path: Path) -> None:
    answers = {("lab",): said(8, 10), ("hall",): said(3, 10), ("yard",): said(10, 10)}
    found = analysed(tmp_path, [ROOM], answers).measure("Success")
    p_values = [pair.p_value for pair in found.post_hoc[0].comparisons]
    exact = [stats.fisher_exact(of).pvalue for of in ([[8, 2], [3, 7]], [[8, 2], [10, 0]], [[3, 7], [10, 0]])]
    assert p_values == pytest.approx(exact)
    # In strata, too; those in which all say the same tell nothing.
    both = analysed(tmp_path / "rooms", [PLANNER, ROOM], IN_ROOMS).measure("Success")
    assert both.test is not None
    assert both.post_hoc[0].comparisons[0].p_value == both.test.effects[0].p_value == pytest.approx(0.00214069941867)
    alike = analysed(tmp_path / "alike", [ROOM], answers | {("lab",): said(10, 10)}).measure("Success")
    assert [pair.p_value for pair in alike.post_hoc[0].comparisons] == pytest.approx([exact[2], 1.0, exact[2]])


def test_hypotheses_families_and_doubtful_runs_are_as_the_plan_has_them(tmp_path: Path) -> None:
    hypotheses = [
        {"statement": "Planners differ.", "measure": "Success", "factors": ["Planner"]},
        {
            "statement": "DWB is better.",
            "measure": "Success",
            "factors": ["Planner"],
            "contrast": {"DWB": 1, "TEB": -1},
        },
        {"statement": "It depends on the room.", "measure": "Success", "factors": ["Planner", "Room"]},
    ]
    found = analysed(
        tmp_path,
        [PLANNER, ROOM],
        IN_ROOMS,
        analysis={"measures": ["Success"], "hypotheses": hypotheses, "doubtful": "leave out"},
        doubts={"r_1": "a person carried the robot"},
    )
    measure = found.measure("Success")
    assert [(each.run_id, each.reason) for each in measure.left_out] == [("r_1", Reason.DOUBTFUL)]
    assert measure.proportions is not None
    assert measure.proportions.overall.n == 59
    differ, better, interact = found.hypotheses
    assert measure.test is not None
    assert differ.is_supported
    assert differ.adjusted_p_value == measure.test.effects[0].adjusted_p_value
    assert better.is_supported
    assert better.p_value == measure.test.effects[0].p_value, "one test decides on a pair, whoever asks"
    assert "interactions of proportions are not tested" in interact.conclusion


TUNED = Factor("Planner", ["DWB", "TEB", "MPPI"])
NOT_WORSE = {"statement": "TEB is not worse.", "measure": "Success", "factors": ["Planner"]}
NOT_WORSE |= {"contrast": {"DWB": 1, "TEB": -1}}


def test_a_proportion_is_within_a_bound_where_the_interval_of_newcombe_is(tmp_path: Path) -> None:
    low, high = confint_proportions_2indep(46, 50, 47, 50, method="newcomb", alpha=0.1)
    for bound, at in (("below", high), ("within", max(high, -low))):
        for far in (0.001, -0.001):
            stated = NOT_WORSE | {bound: 100 * at + far}
            found = analysed(
                tmp_path / f"{bound}{far}",
                [PLANNER],
                {("DWB",): said(46, 50), ("TEB",): said(47, 50)},
                analysis={"hypotheses": [stated], "family": "hypotheses"},
            )
            (outcome,), (contrast,) = found.hypotheses, found.measure("Success").contrasts
            assert outcome.is_supported == (far > 0)
            assert outcome.p_value == pytest.approx(0.05, abs=1e-4)
            assert contrast.estimate == pytest.approx(-2)
            ends = (contrast.interval.low, contrast.interval.high, contrast.interval.level)
            assert ends == pytest.approx((100 * low, 100 * high, 0.9))
    assert "the claim is within ±" in outcome.conclusion
    assert "percentage points" in outcome.conclusion


def test_a_bound_that_reads_as_a_fraction_is_told_in_points_and_in_percent(tmp_path: Path) -> None:
    answers = {("DWB",): said(46, 50), ("TEB",): said(47, 50)}
    found = analysed(tmp_path, [PLANNER], answers, analysis={"hypotheses": [NOT_WORSE | {"below": 0.1}]})
    assert "the claim is below 0.1 percentage points (10% would be 10)." in found.hypotheses[0].conclusion


def test_a_bound_of_three_treatments_that_always_succeed_has_its_own_reason(tmp_path: Path) -> None:
    stated = {"statement": "Alike.", "measure": "Success", "factors": ["Planner"], "within": 20}
    answers = {(each,): said(5, 5) for each in "ABC"}
    found = analysed(tmp_path, [Factor("Planner", list("ABC"))], answers, analysis={"hypotheses": [stated]})
    conclusion = found.hypotheses[0].conclusion
    assert conclusion.startswith("It could not be tested: a bound is of two treatments, and it names none")


def test_treatments_that_always_succeed_are_alike_within_a_bound(tmp_path: Path) -> None:
    answers = {("DWB",): said(30, 30), ("TEB",): said(30, 30)}
    # The upper end of Wilson's interval of 0 of 30 at 90 %: z^2 / (30 + z^2) = 8.27 %.
    for bound, is_supported in ((8.28, True), (8.26, False)):
        plan = {"hypotheses": [NOT_WORSE | {"below": bound}]}
        found = analysed(tmp_path / f"{bound}", [PLANNER], answers, analysis=plan)
        assert found.measure("Success").test is None
        assert found.hypotheses[0].is_supported is is_supported
    # Where runs of a block may all respond alike, a block counts as one run: 0 of 5 is at most 35.1 %.
    in_blocks = {(planner, room): said(6, 6) for planner in PLANNER.treatments for room in "abcde"}
    for bound, is_supported in ((35.2, True), (35.0, False)):
        plan = {"hypotheses": [NOT_WORSE | {"below": bound}], "blocks": "Room"}
        found = analysed(tmp_path / f"b{bound}", [PLANNER, Factor("Room", list("abcde"))], in_blocks, analysis=plan)
        assert found.hypotheses[0].is_supported is is_supported


def test_two_that_always_succeed_in_all_rooms_beside_one_that_does_not_are_alike_within_a_bound(tmp_path: Path) -> None:
    rooms = Factor("Room", list("abcde"))
    answers = {(planner, room): said(6, 6) for planner in ("DWB", "TEB") for room in rooms.texts}
    answers |= {("MPPI", room): said(count, 6) for room, count in zip(rooms.texts, (3, 5, 4, 2, 5), strict=True)}
    for bound, is_supported in ((35.2, True), (35.0, False)):
        plan = {"hypotheses": [NOT_WORSE | {"below": bound}], "family": "hypotheses", "blocks": "Room"}
        found = analysed(tmp_path / f"{bound}", [TUNED, rooms], answers, analysis=plan)
        assert found.hypotheses[0].is_supported is is_supported
        assert found.measure("Success").test.method is TestMethod.BLOCKS


def test_a_weighted_sum_of_proportions_has_the_interval_of_zou_huang_and_zhang(tmp_path: Path) -> None:
    # Zou, Huang and Zhang 2009: from Wilson's limits of each, by statsmodels.
    counts, weights = {"DWB": 31, "TEB": 38, "MPPI": 36}, {"DWB": -1.0, "TEB": 0.5, "MPPI": 0.5}
    stated = NOT_WORSE | {"statement": "The tuned ones are better.", "contrast": weights}
    answers = {(name,): said(count, 40) for name, count in counts.items()}
    found = analysed(tmp_path, [TUNED], answers, analysis={"hypotheses": [stated]}).measure("Success")
    (contrast,) = found.contrasts
    total = below = above = 0.0
    for name, count in counts.items():
        ends = proportion_confint(count, 40, method="wilson")
        reach = sorted(weights[name] * (end - count / 40) for end in ends)
        total, below, above = total + weights[name] * count / 40, below + reach[0] ** 2, above + reach[1] ** 2
    assert contrast.estimate == pytest.approx(100 * total)
    ends = (contrast.interval.low, contrast.interval.high)
    assert ends == pytest.approx((100 * (total - math.sqrt(below)), 100 * (total + math.sqrt(above))))
    assert contrast.p_value < 0.05
    assert contrast.interval.low > 0


def test_bounds_of_shares_in_blocks_have_the_paired_t_of_these(tmp_path: Path) -> None:
    dwb, teb = [5, 2, 5, 3, 5, 4], [2, 5, 5, 4, 3, 5]
    rooms = Factor("Room", list("abcdef"))
    answers = {("DWB", room): said(count, 5) for room, count in zip(rooms.texts, dwb, strict=True)}
    answers |= {("TEB", room): said(count, 5) for room, count in zip(rooms.texts, teb, strict=True)}
    plan = {"hypotheses": [NOT_WORSE | {"below": 20}], "blocks": "Room"}
    found = analysed(tmp_path, [PLANNER, rooms], answers, analysis=plan)
    shares = 20.0 * (np.array(dwb) - np.array(teb))
    truth = stats.ttest_1samp(shares, 20, alternative="less")
    assert found.hypotheses[0].p_value == pytest.approx(float(truth.pvalue))
    assert found.measure("Success").contrasts[0].estimate == pytest.approx(shares.mean())
    # t takes a treatment that hardly fails to be surer than runs are: Newcombe's interval of all runs may be wider.
    dwb, teb = [20, 20, 20, 20, 20, 20], [20, 20, 20, 20, 20, 19]
    answers = {("DWB", room): said(count, 20) for room, count in zip(rooms.texts, dwb, strict=True)}
    answers |= {("TEB", room): said(count, 20) for room, count in zip(rooms.texts, teb, strict=True)}
    plan = {"hypotheses": [NOT_WORSE | {"below": 5}], "blocks": "Room"}
    (contrast,) = analysed(tmp_path / "surer", [PLANNER, rooms], answers, analysis=plan).measure("Success").contrasts
    low, high = confint_proportions_2indep(120, 120, 119, 120, method="newcomb", alpha=0.1)
    apart = 5 / 6 + np.array([-1, 1]) * stats.t.isf(0.05, 5) * 5 / 6
    assert contrast.interval.low == pytest.approx(min(100 * low, apart[0]))
    assert contrast.interval.high == pytest.approx(max(100 * high, apart[1]))
    assert 100 * high > apart[1]
    assert contrast.p_value > stats.t.sf((5 - 5 / 6) / (5 / 6), 5)


def test_a_factor_that_goes_along_with_another_one_is_not_tested(tmp_path: Path) -> None:
    answers = {(planner, room): said(0, 0) for planner in PLANNER.treatments for room in ROOM.treatments}
    answers |= {("DWB", "lab"): said(5, 6), ("TEB", "hall"): said(1, 6)}
    padded = {key: [*of, *[None] * 6][:6] for key, of in answers.items()}
    found = analysed(tmp_path, [PLANNER, ROOM], padded).measure("Success")
    assert found.test is not None
    assert [each.p_value for each in found.test.effects] == [None, None]
    assert "differ in nothing but Planner and Room" in " ".join(found.test.notes)
    assert found.post_hoc == ()


def test_where_like_runs_all_say_the_same_neither_the_factor_nor_its_pairs_are_tested(tmp_path: Path) -> None:
    answers = {
        (planner, room): said(3 * (room == "hall"), 3) for planner in PLANNER.treatments for room in ("lab", "hall")
    }
    found = analysed(tmp_path, [PLANNER, Factor("Room", ["lab", "hall"])], answers).measure("Success")
    assert found.test is not None
    planner, room = found.test.effects
    assert (planner.p_value, room.p_value) == (None, pytest.approx(2 * math.comb(6, 3) ** -2))
    assert [each.factors for each in found.post_hoc] == [("Room",)], "a p-value of 1 beside a factor that has none"
    told = {each.what: each.why for each in found.not_computed}
    assert "differ in nothing but Planner" in told["pairwise comparisons of Planner"]


def test_a_run_without_a_covariate_is_in_the_proportions_all_the_same(tmp_path: Path) -> None:
    experiment = make_experiment(
        tmp_path / "made",
        [PLANNER],
        lambda treatments, repetition: {
            "Success": repetition > 2 or treatments["Planner"] == "DWB",
            "Voltage": None if repetition == 1 else 11.0 + repetition / 10,
        },
        repetitions=6,
        measures=("Success", "Voltage"),
        analysis={"measures": ["Success"], "covariates": ["Voltage"]},
    )
    found = analyse(load_results(experiment.root)).measure("Success")
    assert found.proportions is not None
    assert found.proportions.overall.n == 12
    assert found.test is not None
    assert found.test.effects[0].p_value == pytest.approx(stats.fisher_exact([[6, 0], [4, 2]]).pvalue)
    assert [each.what for each in found.not_computed] == ["adjustment for covariates"]


#: How many of four runs say yes, by seed of the training, policy and scene.
TRAINED = {
    ("s1", "imitation"): (4, 2),
    ("s2", "diffusion"): (4, 4),
    ("s3", "imitation"): (2, 1),
    ("s4", "diffusion"): (3, 3),
    ("s5", "imitation"): (3, 0),
    ("s6", "diffusion"): (4, 2),
}


@pytest.mark.long
def test_the_shares_of_a_split_plot_are_compared_as_its_means_are() -> None:
    """In R 4.2.2: summary(aov(100 * yes ~ Policy * Scene + Error(Seed / Scene)))."""
    scenes = ("clean", "clutter")
    rows = [
        (seed, policy, scene, place < count)
        for (seed, policy), counts in TRAINED.items()
        for scene, count in zip(scenes, counts, strict=True)
        for place in range(4)
    ]
    facts = {"kind": "split_plot", "whole_plot": "Seed", "whole_plot_factors": ["Policy"]}
    plan = AnalysisPlan(
        "y", estimand=Estimand.RANK, hypotheses=[Hypothesis("The policy matters.", measure="y", factors="Policy")]
    )
    results = designed(rows, ["Seed", "Policy", "Scene"], facts, plan=plan)
    results.table["y"] = results.table["y"].astype("boolean")
    statistics = analyse(results)
    found = statistics.measure("y")
    assert found.test is not None
    assert (found.test.estimand, found.unit) == ("proportion", "%")
    figures = {each.label: (each.statistic, *each.degrees_of_freedom) for each in found.test.effects}
    assert figures["Policy"] == pytest.approx((4.923, 1, 4), abs=5e-4)
    assert figures["Scene"] == pytest.approx((9.143, 1, 4), abs=5e-4)
    assert figures["Policy x Scene"] == pytest.approx((2.286, 1, 4), abs=5e-4)
    (policies, _) = found.post_hoc
    assert policies.comparisons[0].difference == pytest.approx(-100 / 3)
    assert found.proportions is not None
    assert found.proportions.overall.count == 32
    assert [each.p_value for each in statistics.hypotheses] == [found.test.effects[0].p_value]
    # Numbers are ranked, as the plan has it; nobody is told to publish what has no other test.
    of_numbers = analyse(designed(rows, ["Seed", "Policy", "Scene"], facts, plan=plan)).measure("y").test
    assert of_numbers is not None
    assert "relative ranks are compared" in of_numbers.reason
    assert "relative ranks" not in found.test.reason
    assert not [note for note in of_numbers.notes if "publish False and True" in note]


@pytest.mark.long
def test_the_shares_of_a_split_plot_that_lost_a_run_are_compared() -> None:
    rows = [
        (seed, policy, scene, count > 2)
        for (seed, policy), counts in TRAINED.items()
        for scene, count in zip(("clean", "clutter"), counts, strict=True)
    ]
    facts = {"kind": "split_plot", "whole_plot": "Seed", "whole_plot_factors": ["Policy"]}
    results = designed(rows[1:], ["Seed", "Policy", "Scene"], facts)
    results.table["y"] = results.table["y"].astype("boolean")
    test = analyse(results).measure("y").test
    assert test is not None
    assert "each block with a random mean" in test.reason
    assert all(each.p_value is not None for each in test.effects)


def test_tables_with_the_same_margins_are_compared_with_the_same_random_tables() -> None:
    """`power` tests thousands of simulated experiments with few different margins."""
    runs = np.array([[7, 8, 9], [4, 4, 4]])
    uneven, even = np.array([[7, 3, 1], [2, 1, 0]]), np.array([[3, 4, 4], [1, 1, 1]])
    _statistics_drawn.cache_clear()
    p_values = [Strata(runs, yes).p_value(999) for yes in (uneven, even)]
    assert p_values[0] < 0.02
    assert p_values[1] > 0.5
    assert _statistics_drawn.cache_info().misses == 1
