"""Means have intervals that hold, whether runs stand by themselves or share a block, a whole plot or a subject."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from scipy import stats
from statsmodels.api import OLS
from tests.analysis.made_experiment import make_experiment
from tests.analysis.statistics.designed_data import designed
from tests.analysis.statistics.reference_data import split_plot

from robot_runner.analysis import analyse, load_results
from robot_runner.analysis.statistics.descriptive import describe
from robot_runner.analysis.statistics.left_out import outside
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.outliers import Outliers
from robot_runner.core.design.repeated_intervals import METHOD, half_width_of

TASKS, SPEEDS = ["Video", "Idle"], ["slow", "fast"]


def in_plots(value, repetitions=2):
    """Return eight whole plots of two floors, three speeds in each."""
    rows = [
        (floor, f"p{plot}", speed, value(plot, speed))
        for plot, floor in enumerate(["wood", "carpet"] * 4)
        for speed in (1, 2, 4)
        for _ in range(repetitions)
    ]
    facts = {"kind": "split_plot", "whole_plot": "Laying"}
    return designed(rows, ("Floor", "Laying", "Speed"), facts)


def in_blocks(rows, factors=()):
    """Return the groups of runs, each of which has a block, a treatment and a value."""
    return split_plot([(block, treatment, "-", value) for block, treatment, value in rows]).described_groups(factors)


def students(values):
    """Return Student's interval of the mean, by another route."""
    return stats.t.interval(0.95, len(values) - 1, np.mean(values), stats.sem(values))


def test_runs_of_one_whole_plot_count_together_in_the_interval_of_a_mean():
    random = np.random.default_rng(3)
    plots = random.normal(0, 2, 8)
    results = in_plots(lambda plot, speed: 100 + 2 * speed + plots[plot] + random.normal(0, 0.5))
    measure = analyse(results).measure("y")
    runs = results.runs.assign(y=results.runs["y"].astype(float))
    wood = measure.by_treatment[0]
    means = runs[runs["Floor"] == "wood"].groupby("Laying", observed=True)["y"].mean()
    assert (wood.treatments, wood.n, len(means)) == ({"Floor": "wood"}, 24, 4)
    assert (wood.mean_interval.low, wood.mean_interval.high) == pytest.approx(students(means))
    assert wood.mean_interval.method == "t distribution, runs of one Laying counting together"
    for each in (measure.overall, *measure.by_treatment, *measure.by_combination):
        chosen = runs[np.all([runs[name] == of for name, of in each.treatments.items()] or [runs["y"] > 0], axis=0)]
        means = chosen.groupby("Laying", observed=True)["y"].mean()
        assert (each.mean_interval.low, each.mean_interval.high) == pytest.approx(students(means))


@pytest.mark.long
def test_plots_of_different_numbers_of_runs_have_the_cluster_robust_interval_of_statsmodels():
    random = np.random.default_rng(4)
    results = in_plots(lambda plot, speed: math.nan if plot + speed < 3 else plot % 3 + random.normal())
    wood = analyse(results).measure("y").by_treatment[0]
    runs = results.runs[(results.runs["Floor"] == "wood") & results.runs["y"].notna()]
    y, plot = runs["y"].astype(float).to_numpy(), runs["Laying"].cat.codes.to_numpy()
    (ends,) = OLS(y, np.ones(len(y))).fit(cov_type="cluster", cov_kwds={"groups": plot}, use_t=True).conf_int()
    assert (wood.n, wood.missing) == (20, 4)
    assert (wood.mean_interval.low, wood.mean_interval.high) == pytest.approx(tuple(ends))


def test_a_unit_by_itself_and_units_that_do_not_differ_leave_no_interval():
    alone = [
        group
        for group in in_blocks([("b1", "x", 1.0), ("b1", "x", 2.0), ("b2", "y", 1.0)], ["A"])
        if group.treatments["A"] == "x"
    ]
    assert describe(alone[0]).mean_interval is None
    (alike,) = in_blocks([("b1", "x", 1.0), ("b1", "x", 2.0), ("b2", "x", 1.5)])
    assert describe(alike).mean_interval is None


@pytest.mark.parametrize("dtype", ["float64", "boolean"])
def test_groups_whose_runs_are_all_of_one_plot_say_why_they_have_no_interval(dtype):
    rows = [(floor, place, speed, speed == 2) for place, floor in enumerate("abab") for speed in (1, 2, 2)][:9]
    results = designed(rows, ("Floor", "Laying", "Speed"), {"kind": "split_plot", "whole_plot": "Laying"})
    results.table["y"] = results.table["y"].astype(dtype)
    told = [(each.what, each.why) for each in analyse(results).measure("y").not_computed]
    why = "all runs of a group are of one Laying, so that nothing tells how much these differ."
    assert [what for what, because in told if because == why] == ["the interval of b", "the interval of b / 2"]


def test_the_margin_of_a_blocked_factorial_has_the_interval_of_the_means_of_blocks(tmp_path):
    random = np.random.default_rng(8)
    rooms = random.normal(0, 3, 6)
    energies = {
        (task, speed, block): float(50 + rooms[block - 1] + 4 * (speed == "fast") + random.normal())
        for task, speed, block in product(TASKS, SPEEDS, range(1, 7))
    }
    folder = make_experiment(
        tmp_path / "made",
        [Factor("Task", TASKS), Factor("Speed", SPEEDS)],
        lambda of, block: {"Energy": energies[of["Task"], of["Speed"], block]},
        repetitions=6,
        blocks="Repetition",
    )
    measure = analyse(load_results(folder.root)).measure("Energy")
    video = measure.by_treatment[0].mean_interval
    means = [np.mean([energies["Video", speed, block] for speed in SPEEDS]) for block in range(1, 7)]
    assert (video.low, video.high) == pytest.approx(students(means))
    assert video.method == "t distribution, runs of one Repetition counting together"
    one = [energies["Video", "slow", block] for block in range(1, 7)]
    slow = measure.by_combination[0].mean_interval
    assert ((slow.low, slow.high), slow.method) == (students(one), "t distribution"), (
        "one run a block: to the last digit"
    )


def test_two_runs_of_a_period_count_as_one_subject():
    random = np.random.default_rng(9)
    rows = [
        (f"s{subject}", 1 + period, "ab"[(subject + period) % 2], 10 + 3 * (subject % 4) + random.normal())
        for subject in range(8)
        for period in range(2)
        for _ in range(2)
    ]
    facts = {"kind": "crossover", "subject": "Subject", "period": "Period", "washout": "a night"}
    names = ("Subject", "Period", "Planner")
    found = analyse(designed(rows, names, facts)).measure("y").by_treatment[0].mean_interval
    means = [np.mean([y for one, _, of, y in rows if (one, of) == (f"s{each}", "a")]) for each in range(8)]
    assert (found.low, found.high) == pytest.approx(students(means))
    assert found.method == "t distribution, runs of one Subject counting together"
    once = analyse(designed(rows[::2], names, facts)).measure("y").by_treatment[0].mean_interval
    values = np.array([y for *_, of, y in rows[::2] if of == "a"])
    assert ((once.low, once.high), once.method) == (students(values), "t distribution"), "one run a subject"


def test_intervals_after_repeated_looks_take_runs_of_a_block_together():
    rows = [(f"b{block}", "x", 3.0 * block + 0.1 * run) for block in range(1, 6) for run in range(2)]
    found = describe(in_blocks(rows)[0], level_of_looks=0.99).mean_interval
    means = [np.mean([y for of, _, y in rows if of == f"b{block}"]) for block in range(1, 6)]
    assert (found.high - found.low) / 2 == pytest.approx(half_width_of(means, 0.99))
    assert (found.level, found.method) == (0.95, f"{METHOD}, runs of one block counting together")


def test_values_that_are_all_equal_have_this_mean_and_no_spread():
    rows = [(task, 3.7) for task in "ab" for _ in range(5)]  # whose sum is 37.00000000000001
    overall = analyse(designed(rows, ["Task"], {})).measure("y").overall
    assert (overall.mean, overall.sd, overall.mean_interval) == (3.7, 0.0, None)


#: Tenths of which the largest is on the fence: 12.7 + 1.5 (12.7 - 11.9) = 13.9. In binary it was beyond.
ON_THE_FENCE = [11.2, 11.8, 11.9, 12.2, 12.3, 12.5, 12.7, 13.1, 13.9]


@pytest.mark.parametrize("size", [1.0, 1e-9, 1e9])
def test_a_value_on_a_fence_is_not_beyond_it_by_rounding(size):
    values = size * np.array(ON_THE_FENCE)
    rows = [(task, value) for task in "ab" for value in values]
    overall = analyse(designed(rows, ["Task"], {})).measure("y").by_treatment[0]
    assert overall.outliers == ()
    assert not outside(values, Outliers(interquartile_ranges=1.5)).any()
    values[-1] += size * 1e-6
    assert outside(values, Outliers(interquartile_ranges=1.5)).tolist() == [False] * 8 + [True]


def test_a_value_as_far_from_the_median_as_a_rule_allows_is_not_beyond_it_by_rounding():
    values = np.array([0.1, 0.2, 0.3, 0.4, 0.5])
    scaled = 0.2 / (0.1 * 1.4826)  # how many scaled deviations the outer ones lie from 0.3
    assert not outside(values, Outliers(median_deviations=scaled)).any()
