"""What shifts a whole batch is no effect, and hides none; what differs only between batches is not tested."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from statsmodels.formula.api import ols
from statsmodels.stats.anova import anova_lm

from robot_runner.analysis.statistics.analysed_design import BATCH, VALUE, MeasureData
from robot_runner.analysis.statistics.batch_strata import comparable
from robot_runner.analysis.statistics.cell_layout import layout_of
from robot_runner.analysis.statistics.cell_means import CellMeans
from robot_runner.analysis.statistics.designed_columns import residuals_of
from robot_runner.analysis.statistics.linear_model import FittedModel
from robot_runner.analysis.statistics.post_hoc import compare_pairs
from robot_runner.analysis.statistics.tested import NotComputed, TestMethod
from robot_runner.analysis.statistics.tests import Choices, carry_out, model_of
from robot_runner.core.design.analysis_plan import Estimand

SHIFT = 5.0
CHOICES = Choices()

#: Runs of each treatment in each batch: very unequal shares of the later one.
UNEQUAL = {"a": (9, 3), "b": (3, 8), "c": (4, 5)}


def measure(rows, *, in_blocks=False, names="A"):
    """Return the data of rows (batch, value, treatments..., and a block where there are any)."""
    frame = pd.DataFrame(rows, columns=["batch", VALUE, *names, *([" block"] if in_blocks else [])])
    frame[BATCH] = pd.Categorical(frame.pop("batch"), ordered=True)
    frame["run_id"] = [f"r_{place}" for place in range(1, len(frame) + 1)]
    frame[" place"] = range(1, len(frame) + 1)
    for name in names:
        frame[name] = pd.Categorical(frame[name], sorted(set(frame[name])), ordered=True)
    return MeasureData("y", frame, frame, tuple(names), in_blocks, len(set(frame[BATCH])) > 1)


def cells(counts, value=lambda treatments, batch: 0.0):
    return [
        (batch, value(key, batch), *key)
        for key, of in counts.items()
        for batch, count in enumerate(of, start=1)
        for _ in range(count)
    ]


def share_of_significant(data, estimand=Estimand.MEAN, *, spreads=None, effect=0.0, seed=3, count=4000):
    """Return how often each effect is found in values whose second batch is shifted."""
    random = np.random.default_rng(seed)
    frame = data.frame
    spread = np.array([(spreads or {}).get(each, 1.0) for each in frame["A"]])
    means = SHIFT * (frame[BATCH].astype(int).to_numpy() - 1) + effect * (frame["A"] == "b").to_numpy()
    values = means + spread * random.normal(size=(count, len(frame)))
    if data.is_blocked:  # blocks differ, and respond to the treatments by chance
        _, place = np.unique(frame[[" block", "A"]].astype(str).agg("/".join, axis=1), return_inverse=True)
        values += random.normal(size=(count, place.max() + 1))[:, place]
    tests = CellMeans.of_values(layout_of(data), values, estimand).effects()
    return [float(np.mean(each.p_value < CHOICES.alpha)) for each in tests]


@pytest.mark.parametrize("estimand", Estimand)
@pytest.mark.parametrize("spreads", [None, {"b": 3.0}], ids=["equal spreads", "unequal spreads"])
def test_a_shift_between_batches_is_found_as_often_as_chance_has_it(estimand, spreads):
    data = measure(cells(UNEQUAL))
    (found,) = share_of_significant(data, estimand, spreads=spreads)
    assert 0.035 < found < 0.065
    (before,) = share_of_significant(replace(data, is_extended=False), estimand, spreads=spreads, count=1000)
    assert before > 0.1


def test_effects_of_two_factors_hold_their_level_beside_a_shift():
    counts = {("a", "x"): (6, 2), ("a", "y"): (2, 6), ("b", "x"): (3, 3), ("b", "y"): (5, 2)}
    data = measure(cells(counts), names="AB")
    assert all(0.035 < each < 0.065 for each in share_of_significant(data))
    assert max(share_of_significant(replace(data, is_extended=False), count=500)) > 0.2


def test_an_effect_is_found_beside_a_shift_that_hid_it():
    data = measure(cells({"a": (5, 5), "b": (5, 5)}))
    (found,) = share_of_significant(data, effect=2.0)
    (before,) = share_of_significant(replace(data, is_extended=False), effect=2.0)
    (without_shift,) = share_of_significant(measure(cells({"a": (10, 0), "b": (10, 0)})), effect=2.0)
    assert before < 0.5
    assert found > 0.95
    assert found == pytest.approx(without_shift, abs=0.02)


def test_blocks_that_go_on_across_batches_stay_one_unit_each():
    rows = [
        (batch, 0.0, each, f"room {room}")
        for room in range(12)
        for each, counts in {"a": (3, 1), "b": (1, 2)}.items()
        for batch, count in enumerate(counts, start=1)
        for _ in range(count)
    ]
    data = measure(rows, in_blocks=True)
    assert layout_of(data).sizes.tolist() == [12]
    (found,) = share_of_significant(data)
    assert 0.035 < found < 0.065
    (before,) = share_of_significant(replace(data, is_extended=False), count=500)
    assert before > 0.3


def test_runs_whose_batch_lacks_a_treatment_of_their_block_are_named_for_that():
    random = np.random.default_rng(1)
    held = {"a": (1, 2), "b": (0, 2)}  # the second batch completes each room
    rows = [
        (batch, random.normal(), each, f"room {room}")
        for room in range(6)
        for each, counts in held.items()
        for batch, count in enumerate(counts, start=1)
        for _ in range(count)
    ]
    data = measure(rows, in_blocks=True)
    found = carry_out(data, model_of(data, Estimand.MEAN), CHOICES)
    (told,) = [note for note in found.notes if "left out" in note]
    assert told.startswith("What their batch has of their block lacks some combinations, so these runs are left out of")
    assert "r_1" in told


def blocks_of(kinds, per_batch):
    """Return rows of blocks that lie within batches; each has all of `a` and `b`, and one of `kinds`."""
    return [
        (batch, 0.0, each, kind, f"{batch} {kind} {number}")
        for batch in (1, 2)
        for kind in kinds
        for number in range(per_batch[batch - 1][kind])
        for each in "ab"
    ]


DESIGNS = {
    "runs of their own": lambda: measure(cells(UNEQUAL)),
    "a linear model": lambda: measure(cells({"a": (4, 1), "b": (3, 0), "c": (0, 3)})),
    "blocks within batches": lambda: measure(
        [row[:3] + row[4:] for row in blocks_of("p", [{"p": 5}] * 2)], in_blocks=True
    ),
    "factors between blocks": lambda: measure(
        blocks_of("pq", [{"p": 6, "q": 2}, {"p": 3, "q": 5}]), in_blocks=True, names="AB"
    ),
}


@pytest.mark.parametrize("estimand", Estimand)
@pytest.mark.parametrize("design", DESIGNS)
def test_whatever_shifts_a_whole_batch_changes_nothing(design, estimand):
    data = DESIGNS[design]()
    found = []
    for shift in (0.0, 50.0):
        values = np.random.default_rng(4).normal(size=len(data.frame)) + shift * (data.batches == 2)
        frame = data.frame.assign(**{VALUE: values})
        shifted = replace(data, frame=frame, every=frame)
        model = model_of(shifted, estimand)
        if isinstance(model, NotComputed):
            assert estimand is Estimand.TRIMMED_MEAN
            return
        test = carry_out(shifted, model, CHOICES)
        pairs, _ = compare_pairs(shifted, model, test, CHOICES)
        found.append([each.p_value for each in test.effects] + [each.check.p_value for each in test.effects])
        found[-1] += [size.value for each in pairs for pair in each.comparisons for size in pair.effect_sizes]
    assert found[0] == pytest.approx(found[1], rel=1e-4)


def spread_out(mean, count):
    """Return values with exactly this mean and a variance of 1."""
    values = np.arange(count) - (count - 1) / 2
    return mean + values / values.std(ddof=1)


def test_differences_are_those_of_least_squares_with_a_constant_for_each_batch():
    """statsmodels finds the same; with equal spreads within batches the errors are the same as well."""
    counts = {"a": (9, 3), "b": (4, 8)}
    rows = [
        (batch, value, name)
        for name, of in counts.items()
        for batch, count in enumerate(of, start=1)
        for value in spread_out(2.0 * (name == "b") + SHIFT * batch + 0.7 * (name == "b") * batch, count)
    ]
    data = measure(rows)
    plain = pd.DataFrame(rows, columns=["batch", "y", "task"])
    additive = ols("y ~ C(batch) + C(task)", plain).fit()
    model = model_of(data, Estimand.MEAN)
    found = model.difference([({"A": "b"}, 1.0), ({"A": "a"}, -1.0)])
    assert float(found.estimate) == pytest.approx(additive.params["C(task)[T.b]"])
    # The additive model has as chance what the effect differs by between batches, too; the full one does not.
    shares = np.array([1 / (1 / 9 + 1 / 4), 1 / (1 / 3 + 1 / 8)])
    row = np.array([0, 0, 1, shares[1] / shares.sum()])
    full = ols("y ~ C(batch) * C(task)", plain).fit().t_test(row)
    assert float(found.estimate) == pytest.approx(float(np.squeeze(full.effect)))
    assert float(found.error) == pytest.approx(float(np.squeeze(full.sd)))
    assert model.spread == pytest.approx(1.0)


def test_few_runs_in_a_batch_are_compared_by_least_squares_as_statsmodels_does():
    random = np.random.default_rng(8)
    counts = {"a": (4, 1), "b": (3, 0), "c": (0, 3)}
    rows = cells(counts, lambda treatments, batch: float(random.normal() + SHIFT * batch))
    data = measure(rows)
    kept = comparable(data)
    assert len(kept.data.frame) == 11
    model = model_of(kept.data, Estimand.MEAN)
    assert isinstance(model, FittedModel)
    test = carry_out(kept.data, model, CHOICES)
    plain = pd.DataFrame(rows, columns=["batch", "y", "task"])
    fit = ols("y ~ C(batch) + C(task)", plain).fit()
    expected = anova_lm(fit, typ=2).loc["C(task)"]
    (effect,) = test.effects
    assert test.method is TestMethod.LINEAR_MODEL
    assert (effect.statistic, effect.p_value) == pytest.approx((expected["F"], expected["PR(>F)"]))
    assert effect.degrees_of_freedom == (2.0, fit.df_resid)
    pairs, _ = compare_pairs(kept.data, model, test, CHOICES)
    assert -pairs[0].comparisons[0].difference == pytest.approx(fit.params["C(task)[T.b]"])
    assert "each batch adds a constant" in test.reason


def test_a_treatment_that_only_the_later_batch_has_is_compared_within_it():
    kept = comparable(measure(cells({"a": (5, 3), "b": (5, 3), "c": (0, 4)})))
    assert set(kept.data.batches) == {2}
    assert not kept.data.is_extended
    assert len(kept.data.frame) == 10
    assert "10 runs are left out of the tests" in kept.note
    assert "compare runs of batch 2 only" in kept.note
    assert kept.missing == ()


def test_a_treatment_that_was_added_alone_cannot_be_told_apart_from_its_batch():
    kept = comparable(measure(cells({"a": (5, 0), "b": (5, 0), "c": (0, 5)})))
    assert kept.data.levels("A") == ["a", "b"]
    (missing,) = kept.missing
    assert missing.what == "comparisons with c"
    assert "cannot be told apart" in missing.why
    assert "batch 1 only" in kept.note


def test_a_factor_that_differs_only_between_batches_is_not_compared():
    counts = {("a", "x"): (4, 0), ("b", "x"): (4, 0), ("a", "y"): (0, 5), ("b", "y"): (0, 5)}
    kept = comparable(measure(cells(counts), names="AB"))
    assert kept.data.factors == ("A",)
    assert len(kept.data.frame) == 18
    assert [each.what for each in kept.missing] == ["the effect of B"]
    nothing = comparable(measure(cells({"a": (4, 0), "b": (0, 4)})))
    assert nothing.data.factors == ()
    assert len(nothing.missing) == 1


def test_residuals_are_without_what_a_batch_adds():
    data = measure(cells(UNEQUAL, lambda treatments, batch: SHIFT * batch + ord(treatments[0])))
    assert np.abs(residuals_of(data)[0]).max() < 1e-9


@pytest.mark.long
def test_data_of_one_batch_are_as_they_were():
    data = measure(cells({"a": (5, 0), "b": (4, 0)}))
    assert comparable(data) == (data, "", ())
