"""Designs of their own are analysed as textbooks and R do; figures of Montgomery 2013 where nothing else is said."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from tests.analysis.statistics import designed_data as data
from tests.analysis.statistics.designed_data import designed

from robot_runner.analysis import analyse
from robot_runner.analysis.statistics.analysed_design import BATCH, VALUE, covariate_column, design_of
from robot_runner.analysis.statistics.designed_columns import residuals_of
from robot_runner.analysis.statistics.designed_models import designed_model_of
from robot_runner.analysis.statistics.known_design import before_column, role_column
from robot_runner.analysis.statistics.lenth_test import LenthContrast, pseudo_error
from robot_runner.analysis.statistics.tested import TestMethod
from robot_runner.analysis.statistics.tests import model_of
from robot_runner.core.design.analysis_plan import AnalysisPlan, Estimand, Statistic
from robot_runner.core.design.columns import EXCLUDED, RUN_ID


def effects_of(results, measure="y"):
    found = analyse(results).measure(measure)
    assert found.test is not None, found.not_computed
    return found.test, {effect.label: effect for effect in found.test.effects}


def figures(effect):
    return effect.statistic, *effect.degrees_of_freedom


@pytest.mark.long
def test_a_split_plot_has_two_errors():
    # Table 14.15: methods against the error of whole plots, temperatures and the interaction within them.
    facts = {"kind": "split_plot", "whole_plot": "Batch", "whole_plot_factors": ["Method"], "replicate": "Replicate"}
    rows = [(rep, f"{rep}, {method}", method, temperature, y) for rep, method, temperature, y in data.PAPER]
    test, effects = effects_of(designed(rows, ["Replicate", "Batch", "Method", "Temperature"], facts))
    assert test.method is TestMethod.SPLIT_PLOT
    assert figures(effects["Method"]) == pytest.approx((7.08, 2, 4), abs=0.005)
    assert effects["Method"].p_value == pytest.approx(0.0485, abs=5e-5)
    assert figures(effects["Temperature"]) == pytest.approx((36.43, 3, 18), abs=0.005)
    assert figures(effects["Method x Temperature"]) == pytest.approx((3.15, 6, 18), abs=0.006)
    assert effects["Method x Temperature"].p_value == pytest.approx(0.0271, abs=5e-5)
    # Whole plots that are numbered anew in each replicate are the same ones.
    again = [(rep, int(method[1:]), method, *rest) for rep, method, *rest in data.PAPER]
    _, found = effects_of(designed(again, ["Replicate", "Batch", "Method", "Temperature"], facts))
    for name, effect in effects.items():
        assert (found[name].p_value, *figures(found[name])) == pytest.approx(
            (effect.p_value, *figures(effect)), rel=1e-12
        )


@pytest.mark.parametrize(("factors", "is_said"), [(["Gaze", "Voice"], True), (["Gaze and voice"], False)])
def test_that_subjects_respond_alike_to_several_factors_is_said_to_be_assumed(factors, is_said):
    """Of four subjects, periods and the treatments before explain how each responds."""
    random = np.random.default_rng(5)
    sequences = [(0, 1, 3, 2), (1, 2, 0, 3), (2, 3, 1, 0), (3, 0, 2, 1)]
    rows = [
        (f"s{subject}", period, *((each // 2, each % 2) if is_said else (each,)), float(random.normal()))
        for subject in range(4)
        for period, each in enumerate(sequences[subject], start=1)
    ]
    facts = {"kind": "crossover", "subject": "Person", "period": "Period"}
    test, _ = effects_of(designed(rows, ["Person", "Period", *factors], facts))
    told = "Each Person is taken to respond alike to Gaze and Voice, as one variance serves their effects:"
    assert [note.startswith(told) for note in test.notes if "respond alike" in note] == [True] * is_said


def test_a_split_plot_that_lost_runs_is_still_adjusted_for_its_replicates_and_covariates():
    """Of four of twelve plots: those of up to a quarter would be left out."""
    names, facts, rows, values = made_tables()["split_plot_in_replicates"]
    voltage = [float(place * place % 7) for place in range(len(rows))]
    lines = [[*row, value, volt] for row, value, volt in zip(rows, values, voltage, strict=True)]
    lines = [line for place, line in enumerate(lines) if place not in {0, 13, 20, 35}]
    plan = AnalysisPlan(measures=["y"], covariates=["U"])
    found = analyse(designed(lines, names, facts, ["y", "U"], plan)).measure("y")
    assert found.test.method is TestMethod.MIXED_MODEL
    # nlme 3.1: anova(lme(y ~ Hard * Easy + Replicate + U, random = ~ 1 | Plot, contrasts = sums), type = "marginal").
    assert {each.label: figures(each) for each in found.test.effects} == {
        "Hard": pytest.approx((8.86192955, 2, 6), rel=1e-6),
        "Easy": pytest.approx((16.5174704, 2, 13), rel=1e-6),
        "Hard x Easy": pytest.approx((1.15357331, 4, 13), rel=1e-6),
    }
    assert "each block with a random mean, adjusted for Replicate and U." in found.test.reason
    # Replicates that were added later tell the batches: what either adds is taken out once.
    data = design_of(designed(lines, names, facts, ["y", "U"], plan)).data("y")
    batches = 1 + (data.frame[role_column("Replicate")] > "r1").astype(int)
    extended = replace(data, frame=data.frame.assign(**{BATCH: batches}), is_extended=True)
    apart, added = (list(model_of(each, Estimand.MEAN).effects()) for each in (data, extended))
    assert [each.freedom for each in added] == [each.freedom for each in apart]
    assert [each.statistic for each in added] == pytest.approx([each.statistic for each in apart])


def test_a_covariate_that_tells_the_treatment_is_named_among_what_cannot_be_told_apart():
    """As the place in the order does, where each whole plot has its treatments in the same order."""
    names, facts, rows, values = made_tables()["split_plot_in_replicates"]
    easy = names.index("Easy")
    places = {treatment: place for place, treatment in enumerate(dict.fromkeys(row[easy] for row in rows))}
    lines = [[*row, value, places[row[easy]]] for row, value in zip(rows, values, strict=True)]
    plan = AnalysisPlan(measures=["y"], covariates=["U"])
    found = analyse(designed(lines, names, facts, ["y", "U"], plan)).measure("y")
    (why,) = [each.why for each in found.not_computed if each.what == "the test"]
    assert why == "factors, blocks and covariates go together so closely that effects cannot be told apart."


@pytest.mark.long
def test_rows_and_columns_of_a_latin_square_are_taken_out():
    # Table 4.12: the formulation, SS 330 of 4, error 128 of 12.
    rows = [(batch, operator, letter, y) for batch, operator, letter, _, y in data.PROPELLANTS]
    facts = {"kind": "latin_square", "row": "Batch", "column": "Operator"}
    test, effects = effects_of(designed(rows, ["Batch", "Operator", "Formulation"], facts))
    assert list(effects) == ["Formulation"]
    assert figures(effects["Formulation"]) == pytest.approx((330 / 4 / (128 / 12), 4, 12))
    assert effects["Formulation"].p_value == pytest.approx(0.0025, abs=5e-5)
    assert "Batch and Operator" in test.reason
    # Table 4.21: with test assemblies, error 66 of 8.
    facts = {"kind": "graeco_latin_square", "row": "Batch", "column": "Operator", "greek": "Assembly"}
    _, effects = effects_of(
        designed(
            [(*row[:2], row[3], row[2], row[4]) for row in data.PROPELLANTS],
            [*"BO", "Assembly", "Formulation"],
            facts | {"row": "B", "column": "O"},
        )
    )
    assert figures(effects["Formulation"]) == pytest.approx((330 / 4 / (66 / 8), 4, 8))
    assert effects["Formulation"].p_value == pytest.approx(0.0033, abs=5e-5)


def test_incomplete_blocks_are_compared_within_blocks():
    # Table 4.25: catalysts adjusted for blocks, SS 22.75 of 3, error 3.25 of 5.
    facts = {"kind": "balanced_incomplete_blocks", "block": "Batch"}
    found = analyse(designed(data.CATALYSTS, ["Batch", "Catalyst"], facts)).measure("y")
    (effect,) = found.test.effects
    assert figures(effect) == pytest.approx((22.75 / 3 / 0.65, 3, 5))
    assert effect.p_value == pytest.approx(0.0107, abs=5e-5)
    # Section 4.4.1: adjusted effects are k Q / (lambda a), -9/8, -7/8, -4/8 and 20/8; of their
    # differences sqrt(2 k MSE / (lambda a)).
    pairs = {(pair.first, pair.second): pair for pair in found.post_hoc[0].comparisons}
    assert pairs["c1", "c4"].difference == pytest.approx(-29 / 8)
    assert pairs["c2", "c3"].difference == pytest.approx(-3 / 8)
    assert abs(pairs["c1", "c4"].difference / pairs["c1", "c4"].statistic) == pytest.approx((2 * 3 * 0.65 / 8) ** 0.5)


def test_a_crossover_is_the_one_of_the_textbook():
    # Cochran and Cox 1957, p. 135: direct effects, adjusted for residual ones, 2854.55 of 2; residual effects, adjusted
    # for direct ones, 616.19 of 2; error 199.25 of 4. Periods differ between squares. R's lm() has the same.
    rows = [(cow, period, method, y) for _, cow, period, method, y in data.COWS]
    facts = {"kind": "crossover", "subject": "Cow", "period": "Period"}
    test, effects = effects_of(designed(rows, ["Cow", "Period", "Method"], facts))
    error = 199.25 / 4
    assert figures(effects["Method"]) == pytest.approx((2854.55 / 2 / error, 2, 4), rel=1e-5)
    assert f"F(2, 4) = {616.19 / 2 / error:.3g}, p = 0.060" in " ".join(test.notes)
    # Washed out: the same without residual effects, of 6.
    _, effects = effects_of(designed(rows, ["Cow", "Period", "Method"], facts | {"washout": True}))
    assert figures(effects["Method"]) == pytest.approx((2276.78 / 2 / ((616.19 + 199.25) / 6), 2, 6), rel=1e-5)


def test_a_crossover_of_two_periods_is_not_said_to_be_adjusted_for_the_treatment_before():
    rows = [(f"s{each}", str(period), "AB"[(each + period) % 2]) for each in range(8) for period in (1, 2)]
    lines = [[*row, float(number * 7 % 5)] for number, row in enumerate(rows)]
    facts = {"kind": "crossover", "subject": "Subject", "period": "Period"}
    test = analyse(designed(lines, ["Subject", "Period", "Drug"], facts)).measure("y").test
    assert "cannot be told apart from subjects or periods" in " ".join(test.notes)
    assert "means are compared, adjusted for Subject and Period. " in test.reason


def without_runs(results, *run_ids):
    """The same results after `exclude`: a column has the reason."""
    frame = results.table
    reasons = pd.array(["the robot was pushed" if each in run_ids else None for each in frame[RUN_ID]], dtype="str")
    return replace(results, table=frame.assign(**{EXCLUDED: reasons}))


def test_a_run_that_is_excluded_was_there_for_what_it_carries_over():
    names, facts, rows, values = made_tables()["crossover"]
    lines = [[*row, value] for row, value in zip(rows, values, strict=True)]
    lost = design_of(without_runs(designed(lines, names, facts), "r_2")).data("y").frame
    before = dict(zip(lost[RUN_ID], lost[before_column("Treatment")], strict=True))
    assert (before["r_1"], before["r_3"], before["r_4"]) == ("", rows[1][2], rows[2][2])
    # R: crossover of designs_in_r.R, whose treatments before are told first, without runs of more than a quarter.
    left = analyse(without_runs(designed(lines, names, facts), "r_2", "r_7", "r_12")).measure("y")
    assert figures(left.test.effects[0]) == pytest.approx((2.211605635, 3, 12), rel=1e-6)


def test_excluding_a_run_changes_the_test_no_more_than_a_run_that_fails():
    complete = [(day, task, float(place % 4)) for place, (day, task) in enumerate(product("MDWTF", "abc"))]
    results = designed(complete, ["Day", "Task"], {"kind": "blocks", "block": ["Day"]})
    failed = replace(results, table=results.table.assign(y=results.table["y"].where(results.table[RUN_ID] != "r_2")))
    methods = {analyse(each).measure("y").test.reason for each in (failed, without_runs(results, "r_2"))}
    assert len(methods) == 1


@pytest.mark.long
def test_a_fraction_names_what_it_cannot_tell_apart():
    # Table 8.3 and example 8.1: effects 19, 1.5, 14, 16.5, -1, -18.5, 19.
    facts = {"kind": "fractional_factorial", "resolution": 4}
    found = analyse(designed(data.FILTRATION_HALF, ["A", "B", "C", "D"], facts)).measure("y")
    labels = [effect.label for effect in found.test.effects]
    assert labels[:4] == [
        f"{a} (aliased with {bcd})"
        for a, bcd in zip("ABCD", ("B x C x D", "A x C x D", "A x B x D", "A x B x C"), strict=True)
    ]
    assert labels[4:] == ["A x B (aliased with C x D)", "A x C (aliased with B x D)", "A x D (aliased with B x C)"]
    assert found.test.method is TestMethod.LENTH
    differences = [each.comparisons[0].difference for each in found.post_hoc]
    assert differences == pytest.approx([-19, -1.5, -14, -16.5])
    for effect in found.test.effects:
        assert f", aliased with {' x '.join(effect.aliases[0])}," in effect.conclusion
    # Each combination twice: Welch's t of contrasts, and an interaction is not compared pair by pair.
    twice = [(*row[:4], row[4] + shift) for row in data.FILTRATION_HALF for shift in (-1.0, 1.0)]
    _, effects = effects_of(designed(twice, ["A", "B", "C", "D"], facts))
    assert {effect.test for effect in effects.values()} == {"Welch's t"}
    # All variances are 2: the error of an effect is sqrt(8 (1/4)^2 2 / 2), with Satterthwaite's 8.
    first = effects["A (aliased with B x C x D)"]
    assert figures(first) == pytest.approx((-19 / 0.5**0.5, 8))


def test_a_model_says_of_a_combination_that_it_has_a_single_run_only_where_one_has():
    rows = [(a, b, 10 + 3 * place + 7 * run % 4) for place, (a, b) in enumerate(("xp", "yp", "xq")) for run in range(4)]
    around = design_of(designed(rows, ["A", "B"], {"kind": "one_factor_at_a_time", "base": {"A": "x", "B": "p"}}))
    voltage = {covariate_column("U"): np.arange(len(rows)) ** 2 % 5 / 10}
    for count, start in ((len(rows), "Main"), (9, "Some combinations have a single run: main")):
        known = around.data("y")
        frame = known.frame.assign(**voltage)[:count]
        model = designed_model_of(replace(known, frame=frame, covariates=("U",)), Estimand.MEAN, Statistic.COMBINED)
        assert model.reason.startswith(f"{start} effects and what else")
        assert ", adjusted for U." in model.reason


def test_a_factor_that_cannot_be_tested_gives_its_effect_to_no_other():
    # Only the resolution of the camera costs anything, and it goes together with the sensor and, in part, the speed.
    cells = {("camera", "720p", "2"): 0, ("camera", "1080p", "1"): 9, ("camera", "1080p", "2"): 9}
    cells |= {("lidar", "none", "1"): 0, ("lidar", "none", "2"): 0}
    rows = [[*cell, cost + run] for cell, cost in cells.items() for run in (0.0, 1.0, 0.5)]
    found = analyse(designed(rows, ["Sensor", "Resolution", "Speed"], {"kind": "d_optimal", "model": "main"}))
    assert found.measure("y").test is None
    assert "what Resolution does cannot be told apart" in found.measure("y").not_computed[0].why


@pytest.mark.long
def test_lenth_is_as_published():
    signs = np.array([[1 if place >> bit & 1 else -1 for bit in range(4)] for place in range(16)])
    columns = [np.prod(signs[:, [bit for bit in range(4) if which >> bit & 1]], axis=1) for which in range(1, 16)]
    effects = np.stack(columns) @ np.array(data.FILTRATION) / 8
    assert pseudo_error(effects) == pytest.approx(2.625)  # example 6.2
    # Ye and Hamada 2000: critical values of single effects at 5 %.
    for count, critical in ((7, 2.297), (15, 2.156), (31, 2.082)):
        found = LenthContrast(np.asarray(critical), np.asarray(1.0), np.asarray(count / 3))
        assert float(found.p_value) == pytest.approx(0.05, abs=0.0015)


def test_the_effect_that_is_the_median_has_the_same_p_value_in_every_unit():
    # Of an odd number of effects one is the median itself: its t is 1 / 1.5, as it is in a seventh of what is drawn.
    random = np.random.default_rng(1)
    for _ in range(20):
        sizes = random.uniform(1, 2, size=7) / 3
        middle = np.sort(sizes)[3]
        found = LenthContrast(np.asarray(middle), pseudo_error(sizes), np.asarray(7 / 3))
        assert float(found.p_value) == pytest.approx(0.578, abs=0.003)


def test_a_surface_has_coefficients_lack_of_fit_and_a_stationary_point():
    # Section 11.3 and table 11.7: 79.94 + 0.99 x1 + 0.52 x2 - 1.38 x1^2 - 1.00 x2^2 + 0.25 x1 x2.
    facts = {"kind": "central_composite", "model": "quadratic", "ranges": {"Time": [80, 90], "Temperature": [170, 180]}}
    found = analyse(designed(data.PROCESS, ["Time", "Temperature"], facts)).measure("y")
    surface = found.surface
    estimates = {each.label: each.estimate for each in surface.coefficients}
    published = {"constant": 79.94, "Time": 0.99, "Temperature": 0.52, "Time^2": -1.38, "Temperature^2": -1.00}
    assert estimates == pytest.approx(published | {"Time x Temperature": 0.25}, abs=0.006)
    assert surface.lack_of_fit.f_value == pytest.approx(1.78, abs=0.01)
    assert surface.lack_of_fit.p_value == pytest.approx(0.2897, abs=0.002)  # the axial points are rounded
    assert surface.stationary.kind == "maximum"
    assert surface.stationary.is_inside
    assert surface.stationary.value == pytest.approx(80.21, abs=0.005)
    at = surface.stationary.at
    assert ((at["Time"] - 85) / 5, (at["Temperature"] - 175) / 5) == pytest.approx((0.389, 0.306), abs=0.002)
    assert [each for each, _ in surface.stationary.curvatures] == pytest.approx([-1.4143, -0.9634], abs=5e-4)
    assert float(surface.at(at)) == pytest.approx(surface.stationary.value)
    assert found.post_hoc == ()
    assert [effect.label for effect in found.test.effects] == ["Time", "Temperature", "Time x Temperature"]


def test_what_blocks_explain_is_no_part_of_what_a_surface_could_explain():
    # Dummy columns of the blocks and the constant are linearly dependent: an arbitrary direction was taken out as well.
    random, days = np.random.default_rng(3), ("Mon", "Tue", "Wed")
    rows = [
        (day, time, temperature, strength + 5 * days.index(day) + float(random.normal()))
        for day in days
        for time, temperature, strength in (*data.PROCESS[:5], *data.PROCESS[9:])  # with one run at the centre
    ]
    facts = {"kind": "central_composite", "model": "quadratic", "block": ["Day"]}
    results = designed(rows, ["Day", "Time", "Temperature"], facts)
    surface = model_of(design_of(results).data("y"), Estimand.MEAN).surface(0.05)
    frame = pd.DataFrame(rows, columns=["Day", "Time", "Temperature", "y"])
    within = frame["y"] - frame.groupby("Day")["y"].transform("mean")
    fitted = surface.at({name: frame[name].to_numpy(dtype=float) for name in ("Time", "Temperature")})
    left = frame["y"] - fitted
    left -= left.groupby(frame["Day"]).transform("mean")
    assert surface.r_squared == pytest.approx(1 - (left**2).sum() / (within**2).sum())


def left_of(results, **changed):
    return residuals_of(replace(design_of(results).data("y"), **changed))[0]


def test_residuals_hold_nothing_that_the_model_of_the_design_takes_out():
    tables = made_tables()
    # Whole plots that are numbered anew in each replicate are the same ones.
    names, facts, rows, values = tables["split_plot_in_replicates"]
    lines = [[*row, value] for row, value in zip(rows, values, strict=True)]
    anew = [[replicate, f"p{plot[-1]}", *rest] for replicate, plot, *rest in lines]
    apart = designed(lines, names, facts)
    assert left_of(designed(anew, names, facts)) == pytest.approx(left_of(apart))
    # What is carried over from the treatment before is in the model of a crossover without a washout.
    names, facts, rows, _ = tables["crossover"]
    before = dict(zip(rows[1:], rows, strict=False))
    carried = [3.0 * int(before[row][2][1]) if row[1] != "1" else 0.0 for row in rows]
    lines = [[*row, value] for row, value in zip(rows, carried, strict=True)]
    assert left_of(designed(lines, names, facts)) == pytest.approx(0)
    assert np.ptp(left_of(designed(lines, names, facts | {"washout": True}))) > 1
    # So are batches and covariates, whatever the design.
    results = designed(lines, names, facts)
    frame = design_of(results).data("y").frame
    batch, voltage = np.arange(len(frame)) % 2 + 1, np.arange(len(frame)) ** 2 / 100
    told = frame.assign(**{BATCH: batch, covariate_column("U"): voltage, VALUE: frame[VALUE] + 7 * batch - voltage})
    assert left_of(results, frame=told, is_extended=True, covariates=("U",)) == pytest.approx(0)
    # An interaction is, also where a few runs are lost.
    facts = {"kind": "fractional_factorial", "resolution": 4}
    twice = [(*row[:4], int(row[0] == row[1])) for row in [*data.FILTRATION_HALF] * 2][2:]
    assert left_of(designed(twice, [*"ABCD"], facts)) == pytest.approx(0)


def drifting(days, slope):
    """Incomplete blocks, one after another: what each adds, and what each run does."""
    random = np.random.default_rng(4)
    rows = [(f"d{day}", f"t{one}", shift) for day, shift in enumerate(days) for one in random.permutation(5)[:4]]
    values = [shift + slope * place + float(random.normal()) / 4 for place, (*_, shift) in enumerate(rows)]
    lines = [(day, one, value) for (day, one, _), value in zip(rows, values, strict=True)]
    return analyse(designed(lines, ["Day", "Treatment"], {"kind": "blocks", "block": ["Day"]})).measure("y")


@pytest.mark.long
def test_a_drift_is_looked_for_within_the_blocks_that_the_model_takes_out():
    falling = drifting([0.0] * 8, -1.0).drift
    assert falling.slope == pytest.approx(-1, abs=0.05)  # and not the 0 that blocks leave over all runs
    assert falling.slope_interval.low < -1 < falling.slope_interval.high
    assert falling.within == ("Day",)
    assert "y falls over the order of the table, which may be another than that of execution, within Day by" in (
        falling.warning
    )
    jumping = drifting([7.0, -9.0, 3.0, 30.0, 4.0, -6.0, 2.0, 11.0], -1.0).drift
    assert jumping.slope == pytest.approx(falling.slope)  # whatever days differ by


@pytest.mark.long
@pytest.mark.parametrize("lost", [None, 7, 12], ids=["whole", "one lost", "another lost"])
def test_rows_and_columns_leave_nothing_of_the_order_to_look_for_a_drift_in(lost):
    """A run that is left out moves those after it by one, of which fractions of a place are left in its row."""
    rows = [(batch, operator, letter, y) for batch, operator, letter, _, y in data.PROPELLANTS]
    kept = [row for place, row in enumerate(rows) if place != lost]
    found = analyse(
        designed(kept, ["Batch", "Operator", "X"], {"kind": "latin_square", "row": "Batch", "column": "Operator"})
    )
    assert found.measure("y").drift is None
    assert "the model takes out what tells the order" in " ".join(each.why for each in found.measure("y").not_computed)


def with_effects(values):
    """Values with noise of a fixed seed, and what each block adds."""
    random = np.random.default_rng(11)
    return [value + float(random.normal()) for value in values]


def made_tables():
    """Run tables by name: the columns, the facts, and the rows with a value."""
    plots = [(f"r{r}", f"p{r}{h}", f"h{h}", f"e{e}") for r, h, e in product(range(4), range(3), range(3))]
    of_plots = with_effects([2 * int(plot[1]) + int(plot[2]) + 0.8 * int(easy[1]) for _, plot, _, easy in plots])
    square = [(f"r{r}", f"c{c}", f"t{(r + c) % 5}") for r, c in product(range(5), range(5))]
    of_square = with_effects([int(r[1]) + 3 * int(c[1]) + 0.7 * int(t[1]) for r, c, t in square])
    orders = ((0, 1, 3, 2), (1, 2, 0, 3), (2, 3, 1, 0), (3, 0, 2, 1)) * 2
    crossed = [(f"s{s}", f"{p + 1}", f"t{t}") for s, order in enumerate(orders) for p, t in enumerate(order)]
    of_crossed = with_effects([2 * int(s[1]) + int(p) + 0.6 * int(t[1]) for s, p, t in crossed])
    fano = ((0, 1, 3), (1, 2, 4), (2, 3, 5), (3, 4, 6), (4, 5, 0), (5, 6, 1), (6, 0, 2))
    held = [(f"b{b}", f"t{t}") for b, each in enumerate(fano) for t in each]
    single = [
        tuple(f"{name}{level}" for name, level in zip("ABC", levels, strict=True))
        for levels in ((0, 0, 0), (1, 1, 0), (2, 0, 1), (0, 1, 1), (1, 0, 1), (2, 1, 0), (0, 1, 0))
    ]
    points = [
        (0.1, 5.0),
        (0.1, 9.0),
        (0.3, 5.0),
        (0.3, 9.0),
        (0.2, 7.0),
        (0.2, 7.0),
        (0.3, 7.0),
        (0.1, 7.0),
        (0.2, 5.0),
        (0.2, 9.0),
    ]
    plot_facts = {"kind": "split_plot", "whole_plot": "Plot"}
    crossing = {"kind": "crossover", "subject": "Subject", "period": "Period"}
    return {
        "split_plot": (["Plot", "Hard", "Easy"], plot_facts, [plot[1:] for plot in plots], of_plots),
        "split_plot_in_replicates": (
            ["Replicate", "Plot", "Hard", "Easy"],
            plot_facts | {"replicate": "Replicate"},
            plots,
            of_plots,
        ),
        "latin_squares": (
            ["Row", "Column", "Treatment"],
            {"kind": "latin_square", "row": "Row", "column": "Column"},
            square,
            of_square,
        ),
        "crossover": (["Subject", "Period", "Treatment"], crossing, crossed, of_crossed),
        "crossover_washed_out": (["Subject", "Period", "Treatment"], crossing | {"washout": True}, crossed, of_crossed),
        "incomplete": (
            ["Block", "Treatment"],
            {"kind": "blocks", "block": ["Block"]},
            held,
            with_effects([3 * int(b[1]) + 0.5 * int(t[1]) for b, t in held]),
        ),
        "single_runs": (
            [*"ABC"],
            {"kind": "d_optimal", "model": "main"},
            single,
            with_effects([2 * int(a[1]) + int(c[1]) for a, _, c in single]),
        ),
        **tables_of_several_responses(),
        "surface": (
            ["X", "Y"],
            {"kind": "central_composite", "model": "quadratic"},
            points,
            with_effects([30 * (x - 0.22) ** 2 + y for x, y in points]),
        ),
    }


def tables_of_several_responses():
    """Run tables whose units have each combination of several factors, and respond differently to one."""
    random = np.random.default_rng(23)

    def valued(rows):
        steps = {}

        def step(of):
            return steps.setdefault(of, float(random.normal()))

        return [step(row[-3:-1]) + 2 * step((row[0], row[-1])) + float(random.normal()) for row in rows]

    def plots(count, replicates, factors):
        cells = list(product(*factors))
        rows = [(f"p{r}{h}", f"h{h}", *cell) for r, h, cell in product(range(count), range(2), cells)]
        return [row for row in rows for _ in range(replicates)]

    a, b, c = ("a1", "a2"), ("b1", "b2", "b3"), ("c1", "c2")
    names, facts = ["Plot", "Hard", "A", "B"], {"kind": "split_plot", "whole_plot": "Plot"}
    orders = ((0, 1, 3, 2), (1, 2, 0, 3), (2, 3, 1, 0), (3, 0, 2, 1)) * 2
    several = {
        "periods_of_each": (
            ["Subject", "Period", "A"],
            {"kind": "crossover", "subject": "Subject", "period": "Period", "washout": True},
            [
                (f"s{s}", f"{p}", f"a{t}")
                for s in range(8)
                for p, t in enumerate((0, 1, 1, 0) if s % 2 else (1, 0, 0, 1))
            ],
        ),
        "split_plot_of_two": (names, facts, plots(4, 2, (a, b))),
        "few_plots_of_two": (names, facts, plots(2, 1, (a, (*b, "b4")))),
        "split_plot_of_three": (
            ["Replicate", "Plot", "Hard", "A", "B", "C"],
            facts | {"replicate": "Replicate"},
            [(f"r{row[0][1]}", *row) for row in plots(5, 1, (a, ("b1", "b2"), c))],
        ),
        "crossover_of_two": (
            ["Subject", "Period", "A", "B"],
            {"kind": "crossover", "subject": "Subject", "period": "Period", "washout": True},
            [
                (f"s{s}", f"{p}", a[t // 2], b[t % 2])
                for s, order in enumerate(orders)
                for p, t in enumerate(order, start=1)
            ],
        ),
    }
    return {name: (*of, valued(of[2])) for name, of in several.items()}


@pytest.mark.long
@pytest.mark.skipif(shutil.which("Rscript") is None, reason="R is not installed (Debian: apt install r-base-core)")
def test_all_designs_are_analysed_as_r_does(tmp_path):
    ours = {}
    for name, (names, facts, rows, values) in made_tables().items():
        lines = [[*row, value] for row, value in zip(rows, values, strict=True)]
        table = [dict(zip([*names, "y"], line, strict=True)) for line in lines]
        if name == "crossover":
            for one, row in zip([None, *table], table, strict=False):
                row["Before"] = one["Treatment"] if one and one["Subject"] == row["Subject"] else ""
        with (tmp_path / f"{name}.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, list(table[0]))
            writer.writeheader()
            writer.writerows(table)
        for effect in effects_of(designed(lines, names, facts))[0].effects:
            ours[name, ":".join(effect.factors)] = (*figures(effect), effect.p_value)
    script = Path(__file__).with_name("designs_in_r.R")
    done = subprocess.run(
        ["Rscript", str(script), str(tmp_path)], capture_output=True, text=True, check=True, timeout=60
    )
    found = list(map(json.loads, done.stdout.splitlines()))
    theirs = {(each["design"], each["effect"]): each["figures"] for each in found if "figures" in each}
    assert len(theirs) == 36
    for which, expected in theirs.items():
        assert ours[which] == pytest.approx(expected, rel=1e-6), which
    corrected = {(each["design"], each["effect"]): each["corrected"] for each in found if "corrected" in each}
    assert len(corrected) == 8
    for which, expected in corrected.items():
        assert (ours[which][0], ours[which][-1]) == pytest.approx(expected, rel=1e-6), which


def test_effects_that_are_there_are_found_as_often_as_theory_says():
    # Power of F by the noncentral distribution: shifts of whole plots beside their error, of treatments in squares.
    random = np.random.default_rng(4)
    square = made_tables()["latin_squares"]
    shifts = {f"t{place}": shift for place, shift in enumerate((-1.0, -0.5, 0.0, 0.5, 1.0))}
    found, expected = [], []
    names, facts, rows, _ = square
    values = random.normal(size=(4000, 25)) + [shifts[treatment] for _, _, treatment in rows]
    found.append(share_found(designed([[*row, 0.5 * place] for place, row in enumerate(rows)], names, facts), values))
    expected.append(stats.ncf.sf(stats.f.isf(0.05, 4, 12), 4, 12, 5 * 2.5))
    names, facts, rows, _ = made_tables()["split_plot"]
    plots = {row[0]: place for place, row in enumerate(dict.fromkeys((row[0],) for row in rows))}
    of_plots = 1.5 * random.normal(size=(4000, len(plots)))[:, [plots[row[0]] for row in rows]]
    values = random.normal(size=(4000, 36)) + of_plots + [2.0 * (row[1] == "h2") for row in rows]
    found.append(share_found(designed([[*row, 0.5 * place] for place, row in enumerate(rows)], names, facts), values))
    # 12 runs a treatment, the mean square of whole plots being 1 + 3 x 1.5^2.
    shift = np.array([0.0, 0.0, 2.0]) - 2 / 3
    expected.append(stats.ncf.sf(stats.f.isf(0.05, 2, 9), 2, 9, 12 * float(shift @ shift) / (1 + 3 * 1.5**2)))
    assert found == pytest.approx(expected, abs=0.025)


def share_found(results, values):
    """How often the first effect is found among experiments with these values."""
    measure = design_of(results).data("y")
    model = designed_model_of(measure, Estimand.MEAN, Statistic.COMBINED, values)
    return float(np.mean(next(model.effects()).p_value < 0.05))
