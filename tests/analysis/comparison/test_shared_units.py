"""What a design adds beside treatments, such as days, is none: runs of one day vary together, and count together."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy import stats
from tests.analysis.made_experiment import make_experiment

from robot_runner.analysis import DeclaredDesign, with_declared_design
from robot_runner.analysis.comparison.compared import Bound, Verdict
from robot_runner.analysis.comparison.comparing import compare
from robot_runner.analysis.comparison.comparison_document import comparison_document, json_of_comparison
from robot_runner.analysis.comparison.equivalence import difference_test, equivalence_p_value
from robot_runner.analysis.comparison.matching import match_runs
from robot_runner.analysis.comparison.shared_units import estimate_of
from robot_runner.analysis.results import load_results
from robot_runner.core.design.factor import Factor
from robot_runner.core.storage.table_columns import ColumnRole
from robot_runner.core.storage.table_schema import read_schema, write_schema
from robot_runner.designs import Blocks, Crossover, LatinSquare, SplitPlot

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from robot_runner.core.storage.layout import ExperimentFolder

TASK = Factor("Task", ["Video", "Network"])
DAYS = Factor("Day", ["Mon", "Tue", "Wed", "Thu"])
DRINK = Factor("Planner", ["x", "y", "z"])


@pytest.fixture
def made(tmp_path: Path) -> Callable[..., ExperimentFolder]:
    """Return what makes an experiment whose runs share the value of their block, and have a bit of their own."""
    numbers = itertools.count(1)

    def make(factors: list[Factor], chosen: Any, by: str = "", seed: int = 1, **settings: Any) -> ExperimentFolder:
        draw, shared = np.random.default_rng(seed), {}

        def values(of: dict[str, Any], _: int) -> dict[str, Any]:
            unit = shared.setdefault(str(of.get(by)), draw.normal(0.0, 3.0)) if by else 0.0
            return {"Energy": 100.0 + unit + draw.normal(0.0, 1.0)}

        folder = tmp_path / f"made_{next(numbers)}"
        return make_experiment(folder, factors, settings.pop("values", values), chosen=chosen, **settings)

    return make


def in_blocks(made: Callable[..., ExperimentFolder], seed: int = 1, days: Factor = DAYS, **settings: Any) -> Path:
    repetitions = settings.pop("repetitions", 2 * len(days.treatments))
    return made([TASK, days], Blocks(days), "Day", seed, repetitions=repetitions, **settings).root


def means_of_units(folder: Path, unit: str, **treatments: str) -> Any:
    done = load_results(folder).done
    for name, treatment in treatments.items():
        done = done[done[name].astype(str) == treatment]
    return done.groupby(unit, observed=True)["Energy"].mean()


def test_days_are_no_treatments_and_the_means_of_days_are_compared(made):
    original, replication = in_blocks(made), in_blocks(made, 2, Factor("Day", ["1", "2", "3", "4", "5"]))
    comparison = compare(original, replication, bound="20%")
    assert comparison.factors == ("Task",)
    video, network = comparison.measure("Energy").differences
    assert (video.label, video.first_n, video.second_n) == ("Video", 8, 10)
    assert (video.unit, video.first_units, video.second_units) == ("Day", 4, 5)
    ours, theirs = (means_of_units(each, "Day", Task="Network") for each in (original, replication))
    expected = stats.ttest_ind(theirs, ours, equal_var=False)
    assert network.p_value == pytest.approx(expected.pvalue)
    interval = expected.confidence_interval(0.95)
    assert (network.interval.low, network.interval.high) == pytest.approx((interval.low, interval.high))
    within = [stats.ttest_ind(theirs, ours * share, equal_var=False).confidence_interval(0.9) for share in (0.8, 1.2)]
    assert within[0].low > 0 > within[1].high
    assert comparison.verdict is Verdict.EQUIVALENT


def test_complete_blocks_with_a_single_run_of_each_combination_are_compared_run_by_run(made):
    original, replication = (in_blocks(made, seed, repetitions=4) for seed in (1, 2))
    comparison = compare(original, replication)
    video = comparison.measure("Energy").differences[0]
    runs = [load_results(each).done.query("Task == 'Video'")["Energy"] for each in (original, replication)]
    assert video.p_value == float(stats.ttest_ind(runs[1].to_numpy(), runs[0].to_numpy(), equal_var=False).pvalue)
    assert (video.unit, video.first_units) == ("", None)
    assert "each run counts by itself" in " ".join(comparison.notes)


def test_one_experiment_may_have_blocks_and_the_other_none(made):
    original, replication = in_blocks(made), made([TASK], None, repetitions=6).root
    comparison = compare(original, replication)
    [video, _] = comparison.measure("Energy").differences
    assert (video.first_units, video.second_units) == (4, None)
    ours = means_of_units(original, "Day", Task="Video").to_numpy()
    theirs = load_results(replication).done.query("Task == 'Video'")["Energy"].to_numpy()
    assert video.p_value == pytest.approx(stats.ttest_ind(theirs, ours, equal_var=False).pvalue)
    assert not any("Only made" in note for note in comparison.notes)


def test_a_column_that_is_a_block_in_one_experiment_is_one_in_the_other(made):
    comparison = compare(in_blocks(made), made([TASK, DAYS], None, repetitions=2).root)
    assert comparison.factors == ("Task",)
    assert comparison.measure("Energy").differences[0].second_units == 4


def test_whole_plots_are_the_units_of_what_changes_rarely(made):
    factors = [Factor("Floor", ["wood", "stone"]), TASK, Factor("Laying", range(1, 7))]
    design = SplitPlot(hard=factors[0], plot=factors[2])
    folders = [made(factors, design, "Laying", seed, repetitions=2).root for seed in (1, 2)]
    comparison = compare(*folders)
    assert comparison.factors == ("Floor", "Task")
    first = comparison.measure("Energy").differences[0]
    assert (first.unit, first.first_units, first.first_n) == ("Laying", 3, 6)
    means = [means_of_units(each, "Laying", Floor="wood", Task="Video") for each in folders]
    assert first.p_value == pytest.approx(stats.ttest_ind(means[1], means[0], equal_var=False).pvalue)


def test_one_whole_plot_of_a_kind_tells_nothing_of_chance(made):
    factors = [Factor("Floor", ["wood", "stone"]), TASK, Factor("Laying", range(1, 3))]
    folders = [made(factors, SplitPlot(hard=factors[0], plot=factors[2]), "Laying", each).root for each in (1, 2)]
    first = compare(*folders, bound="50%").measure("Energy").differences[0]
    assert first.not_computed == (
        "All runs of one experiment are of one Laying: how much these differ by chance is not known."
    )
    assert first.verdict is Verdict.UNDECIDED


def test_subjects_are_units_and_periods_are_no_treatments(made):
    factors = [Factor("Robot", list("abcdef")), Factor("Period", [1, 2, 3]), DRINK]
    folders = [made(factors, Crossover(unit="Robot", period="Period"), "Robot", each).root for each in (1, 2)]
    comparison = compare(*folders)
    assert comparison.factors == ("Planner",)
    x = comparison.measure("Energy").differences[0]
    assert (x.unit, x.first_units, x.second_units) == ("Robot", 6, 6)
    means = [means_of_units(each, "Robot", Planner="x") for each in folders]
    assert x.p_value == pytest.approx(stats.ttest_ind(means[1], means[0], equal_var=False).pvalue)


def test_rows_and_columns_of_squares_both_count(made):
    factors = [DAYS, Factor("Robot", list("abcd")), Factor("Planner", list("wxyz"))]
    folders = [made(factors, LatinSquare(rows="Day", columns="Robot"), "Robot", each).root for each in (1, 2)]
    comparison = compare(*folders)
    assert comparison.factors == ("Planner",)
    [first, *_] = comparison.measure("Energy").differences
    assert first.unit == "Day or Robot or Repetition"
    robots = means_of_units(folders[0], "Robot", Planner="w")
    assert first.first_error >= float(robots.std() / 2) - 1e-12


def test_a_declared_design_is_followed(made):
    declared = DeclaredDesign.of_mapping({"kind": "blocks", "blocks": ["Day"]})
    folders = [made([TASK, DAYS], None, "Day", each, repetitions=2).root for each in (1, 2)]
    assert compare(*folders).factors == ("Task", "Day")
    comparison = compare(*(with_declared_design(load_results(each), declared, "plan.toml") for each in folders))
    assert comparison.factors == ("Task",)
    assert comparison.measure("Energy").differences[0].first_units == 4


def test_blocks_of_the_plan_are_units(made):
    plan = {"measures": ["Energy"], "blocks": "Day"}
    comparison = compare(*(made([TASK, DAYS], None, "Day", each, analysis=plan).root for each in (1, 2)))
    assert comparison.factors == ("Task",)
    assert comparison.measure("Energy").differences[0].first_units == 4


def with_robots(folder: ExperimentFolder) -> Path:
    """Make a measure of an experiment the robots that the tool chose from."""
    columns = read_schema(folder.schema)
    write_schema(
        folder.schema,
        [replace(each, owner="robots", type="string") if each.name == "Robot" else each for each in columns],
    )
    return folder.root


@pytest.mark.parametrize("names", ["abc", "xyz"])
def test_robots_are_units_unless_both_used_the_same(made, names):
    def on(robots: str) -> Path:
        def values(of: dict[str, Any], repetition: int) -> dict[str, Any]:
            robot = robots[repetition % 3]
            return {"Energy": 100.0 + ord(robot) % 7 + repetition / 10, "Robot": robot}

        return with_robots(made([TASK], None, values=values, repetitions=6, measures=["Energy", "Robot"]))

    comparison = compare(on("abc"), on(names))
    video = comparison.measure("Energy").differences[0]
    assert (video.unit, video.first_units) == (("", None) if names == "abc" else ("Robot", 3))
    assert any("taken for the same robots" in note for note in comparison.notes) == (names == "abc")


def test_pairs_are_those_of_one_block_and_repetition(made):
    folders = [in_blocks(made, each) for each in (1, 2)]
    video = compare(*folders, is_paired=True).measure("Energy").differences[0]
    assert (video.first_n, video.first_units) == (8, 4)
    means = [means_of_units(each, "Day", Task="Video") for each in folders]
    assert video.p_value == pytest.approx(stats.ttest_rel(means[1], means[0]).pvalue)


def test_answers_of_one_day_count_together(made):
    def values(of: dict[str, Any], repetition: int) -> dict[str, Any]:
        return {"Done": of["Day"] in {"Mon", "Tue"}}

    folders = [in_blocks(made, values=values, measures=["Done"], repetitions=16) for _ in range(2)]
    [done] = compare(*folders, bound=0.5).measures
    [first, _] = done.differences
    assert first.p_value == pytest.approx(1.0)
    assert first.interval.high - first.interval.low > 1.1  # as of four runs each, and not of sixteen
    assert first.interval.method == "Newcombe's score interval, runs of one Day counting together"
    assert first.verdict is Verdict.UNDECIDED


def test_the_procedure_and_the_reason_are_told(made):
    comparison = compare(in_blocks(made), in_blocks(made, 2), bound="0.1%", rope="1%")
    document = comparison_document(comparison, made="now")
    told = repr(document)
    assert "Welch's t-test, runs of one Day counting together (cluster-robust variance)" in told
    assert "Runs of one Day vary together, and count together" in told
    plain = json.loads(json_of_comparison(comparison))
    assert plain["together"] == ["Day"]
    assert "runs of one Day counting together" in plain["measures"][0]["procedure"]
    assert "(8 runs a combination, of 4 units of Day)" in comparison.measure("Energy").conclusion
    practical = comparison.measure("Energy").differences[0].practical
    assert practical.below + practical.within + practical.above == pytest.approx(1.0)


def test_runs_without_blocks_are_compared_as_before(two_tasks):
    comparison = compare(two_tasks().root, two_tasks(tuple(range(870, 875))).root, bound="1%")
    energy = comparison.measure("Energy")
    assert energy.procedure == "Welch's t-test"
    assert (comparison.together, comparison.notes) == ((), ())
    assert [(each.unit, each.first_units, each.first_error) for each in energy.differences] == [("", None, None)] * 2


def test_nested_units_count_as_the_larger_ones():
    draw = np.random.default_rng(3)
    values, blocks, plots = draw.normal(size=8), np.repeat([0, 1], 4), np.repeat([0, 1, 2, 3], 2)
    assert estimate_of(values, (blocks, plots)) == estimate_of(values, (blocks,))


def test_units_of_different_sizes_leave_fewer_degrees_of_freedom():
    draw = np.random.default_rng(3)
    assert estimate_of(draw.normal(size=8), (np.repeat([0, 1, 2, 3], 2),)).freedom == pytest.approx(3.0)
    assert estimate_of(draw.normal(size=8), (np.repeat([0, 1, 2, 3], [1, 1, 1, 5]),)).freedom < 1.7


def test_the_level_holds_where_days_differ_much(made):
    results = load_results(in_blocks(made))
    units, draw = match_runs(results, results, is_paired=False).groups[0].units, np.random.default_rng(7)

    def drawn(kinds: Any) -> Any:
        return draw.normal(0.0, 3.0, 4)[kinds[0]] + draw.normal(size=len(kinds[0]))

    found = []
    for _ in range(100):
        one, other = drawn(units.first), drawn(units.second)
        found.append(
            (
                difference_test(one, other, alpha=0.05, is_paired=False, units=units).p_value,
                equivalence_p_value(one, other + 6.0, Bound(6.0), is_paired=False, units=units),
                difference_test(one, other, alpha=0.05, is_paired=False).p_value,
            )
        )
    differs, is_same, differs_by_run = np.mean(np.array(found) < 0.05, axis=0)
    assert differs <= 0.09
    assert is_same <= 0.09
    assert differs_by_run > 0.12  # what counts each run by itself finds differences that are none


@pytest.mark.parametrize("later", [2, 1])
def test_runs_of_several_batches_are_told_to_be_compared_as_one(made, later):
    def in_batches(last: int) -> Path:
        def values(of: dict[str, Any], repetition: int) -> dict[str, Any]:
            return {"Energy": 100.0 + repetition % 4 + last, "batch": last if repetition > 3 else 1}

        folder = made([TASK], None, values=values, repetitions=6, measures=["Energy", "batch"])
        columns = read_schema(folder.schema)
        extended = [replace(each, role=ColumnRole.BATCH) if each.name == "batch" else each for each in columns]
        write_schema(folder.schema, extended)
        return folder.root

    comparison = compare(in_batches(later), in_batches(1))
    told = [note for note in comparison.notes if "was extended" in note]
    assert told == ([] if later == 1 else [f"{comparison.first.name}{WAS_EXTENDED}"])


WAS_EXTENDED = (
    " was extended: runs of its batches 1 and 2, which were executed at other times, are compared as one. What changed "
    "between these is taken for chance between runs, and may pass for a difference of the experiments. Tests of "
    "treatments, in the reports, are within batches."
)
