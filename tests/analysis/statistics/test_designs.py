"""The design and the plan fix the tests; the values never do."""

from __future__ import annotations

from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from scipy import special, stats
from tests.analysis.made_experiment import make_experiment
from tests.analysis.statistics.designed_data import designed
from tests.analysis.statistics.reference_data import one_factor, split_plot, two_factors

from robot_runner.analysis import analyse, load_results
from robot_runner.analysis.statistics.analysed_design import design_of
from robot_runner.analysis.statistics.cell_layout import layout_of
from robot_runner.analysis.statistics.contrasts import (
    Moments,
    bootstrapped,
    combined,
    contrast,
    unbiased_squares,
    welch_james,
)
from robot_runner.analysis.statistics.descriptive import describe
from robot_runner.analysis.statistics.effect_sizes import cohens_d, noncentralities_of_f, noncentralities_of_t
from robot_runner.analysis.statistics.linear_model import FittedModel
from robot_runner.analysis.statistics.post_hoc import compare_pairs
from robot_runner.analysis.statistics.tested import NotComputed, TestMethod
from robot_runner.analysis.statistics.tests import Choices, carry_out, model_of
from robot_runner.core.design.analysis_plan import AnalysisPlan, Estimand
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.hypothesis import Hypothesis
from robot_runner.core.errors import AnalysisError

NORMAL = np.random.default_rng(5).normal(0, 1, 400)
SKEWED = np.exp(2 * NORMAL)
CHOICES = Choices()


def groups(count, values, *, spread=None, size=20):
    spread = spread or [1.0] * count
    return {f"t{k}": list(10 + k + spread[k] * values[k * size : (k + 1) * size]) for k in range(count)}


def cells(values, size=10, a="xy", b="pq"):
    names = [(one, other) for one in a for other in b]
    return {name: list(5 + values[place * size : (place + 1) * size]) for place, name in enumerate(names)}


def in_blocks(values, *, blocks=8, a="xy", b="pq", runs=1):
    order = [(block, one, other) for block in range(blocks) for one in a for other in b for _ in range(runs)]
    return [(f"b{block}", one, other, float(values[place])) for place, (block, one, other) in enumerate(order)]


def test_of(measure):
    model = model_of(measure, Estimand.MEAN)
    return model if isinstance(model, NotComputed) else carry_out(measure, model, CHOICES)


test_of.__test__ = False

BOTH = "Welch-James and ANOVA-type"
DESIGNS = {
    "two treatments": (lambda values: one_factor(groups(2, values)), TestMethod.WELCH_T, ["Welch's t"]),
    "three treatments": (lambda values: one_factor(groups(3, values)), TestMethod.COMBINED, [BOTH]),
    "many treatments of few runs": (
        lambda values: one_factor(groups(8, values, size=4)),
        TestMethod.COMBINED,
        [f"{BOTH}, parametric bootstrap"],
    ),
    "two factors": (lambda values: two_factors(cells(values)), TestMethod.WELCH_JAMES, ["Welch's t"] * 3),
    "a factor of three treatments": (
        lambda values: two_factors(cells(values, a="xyz")),
        TestMethod.COMBINED,
        [BOTH, "Welch's t", BOTH],
    ),
    "two treatments in blocks": (
        lambda values: one_factor(groups(2, values), in_blocks=True),
        TestMethod.PAIRED_T,
        ["t within blocks"],
    ),
    "three treatments in blocks": (
        lambda values: one_factor(groups(3, values), in_blocks=True),
        TestMethod.BLOCKS,
        ["Huynh-Feldt"],
    ),
    "three treatments in few blocks": (
        lambda values: one_factor(groups(3, values, size=3), in_blocks=True),
        TestMethod.BLOCKS,
        ["Greenhouse-Geisser"],
    ),
    "five treatments in few blocks": (
        lambda values: one_factor(groups(5, values, size=8), in_blocks=True),
        TestMethod.BLOCKS,
        ["Greenhouse-Geisser, sign flips"],
    ),
    "two factors in blocks": (
        lambda values: split_plot(in_blocks(values, b="pqr", blocks=14)),
        TestMethod.BLOCKS,
        ["t within blocks", "Huynh-Feldt", "Huynh-Feldt"],
    ),
    "incomplete blocks": (
        lambda values: split_plot([row for place, row in enumerate(in_blocks(values)) if place % 3]),
        TestMethod.MIXED_MODEL,
        ["linear mixed model"] * 3,
    ),
    "single runs": (
        lambda values: two_factors(cells(values, size=1, a="wxyz", b="pqr")),
        TestMethod.LINEAR_MODEL,
        ["linear model with one variance"] * 2,
    ),
}


@pytest.mark.parametrize("name", DESIGNS)
def test_the_design_fixes_the_test_whatever_the_values_are(name):
    make, method, tests = DESIGNS[name]
    for values in (NORMAL, SKEWED, NORMAL * np.linspace(0.1, 9, len(NORMAL))):
        test = test_of(make(values))
        assert (test.method, [effect.test for effect in test.effects]) == (method, tests)
        assert test.reason.endswith(".")
        assert all(effect.check is not None and effect.check.p_value is not None for effect in test.effects)


def test_a_block_that_lacks_a_treatment_is_left_out_and_named():
    lacking = groups(3, NORMAL)
    lacking["t2"] = lacking["t2"][:-1]
    measure = one_factor(lacking, in_blocks=True)
    test = test_of(measure)
    assert test.method is TestMethod.BLOCKS
    assert "these runs are left out of the tests: r_20, r_40." in test.notes[0]
    assert int(layout_of(measure).sizes[0]) == 19


def test_repeated_runs_of_a_block_are_no_independent_runs():
    # Blocks of ten runs each whose response to the treatment differs: of 10 blocks, not of 100 runs.
    random = np.random.default_rng(8)
    rows = [
        (f"b{block}", a, "p", float(random.normal() + (a == "x") * response))
        for block, response in enumerate(3 * random.normal(size=10))
        for a in "xy"
        for _ in range(10)
    ]
    measure = split_plot(rows)
    measure = type(measure)("y", measure.frame, measure.every, ("A",), is_blocked=True)
    (effect,) = test_of(measure).effects
    assert effect.degrees_of_freedom == pytest.approx((9.0,))
    wide = measure.frame.pivot_table(index=" block", columns="A", values=" value", observed=True)
    differences = (wide["x"] - wide["y"]).to_numpy()
    assert effect.statistic == pytest.approx(differences.mean() / (differences.std(ddof=1) / np.sqrt(10)))


def test_a_factor_that_blocks_do_not_vary_is_compared_between_blocks():
    rows = [
        (f"b{block}", "x" if block < 6 else "y", b, 5 + NORMAL[place] + block)
        for place, (block, b) in enumerate((block, b) for block in range(12) for b in "pq")
    ]
    between, within, _ = test_of(split_plot(rows)).effects
    means = [np.mean([row[3] for row in rows if row[0] == f"b{block}"]) for block in range(12)]
    variance = np.var(means[:6], ddof=1) / 6 + np.var(means[6:], ddof=1) / 6
    assert between.statistic == pytest.approx((np.mean(means[:6]) - np.mean(means[6:])) / np.sqrt(variance))
    assert between.degrees_of_freedom[0] <= 10
    assert within.degrees_of_freedom[0] <= 10


def test_combinations_without_spread_are_compared_all_the_same():
    test = test_of(one_factor({"a": [1.0] * 4, "b": [2.0] * 4, "c": [1.0, 2.0, 3.0, 4.0]}))
    assert test.effects[0].test == "ANOVA-type"
    assert test.effects[0].p_value is not None


@pytest.mark.parametrize(("runs", "is_told"), [(5, True), (12, False), (16, False)])
def test_a_smaller_group_whose_runs_are_all_alike_is_told(runs, is_told):
    rows = [("a", 0.0)] * runs + [("b", float(value)) for value in (0, 0, 1, 0, 2, 0, 0, 3, 0, 1, 0, 0)]
    notes = analyse(designed(rows, ["Planner"], {})).measure("y").test.notes
    told = "All runs of a have the same value, and others, with more runs, vary: its variance counts as 0."
    assert any(note.startswith(told) for note in notes) is is_told


@pytest.mark.parametrize(("runs", "is_told"), [((2, 6), True), ((3, 9), True), ((3, 8), False), ((4, 20), False)])
def test_two_or_three_runs_beside_many_are_told(runs, is_told):
    rows = [("ab"[place], NORMAL[run]) for place, count in enumerate(runs) for run in range(count)]
    notes = analyse(designed(rows, ["Planner"], {})).measure("y").test.notes
    assert any(note.startswith("a: 2 or 3 runs, and others have 3 times as many") for note in notes) is is_told


@pytest.mark.parametrize(("values", "is_told"), [((0, 1, 0, 1), True), ((0, 2, 1, 0), False), ((1, 2, 1, 2), False)])
def test_numbers_that_are_zero_and_one_may_be_no_and_yes(values, is_told):
    rows = [(planner, float(value)) for planner in "ab" for value in values]
    notes = analyse(designed(rows, ["Planner"], {})).measure("y").test.notes
    assert any(note.startswith("All values are 0 or 1.") for note in notes) is is_told


def test_names_of_treatments_and_blocks_may_hold_what_formulas_are_made_of():
    def compared(names, blocks):
        rows = [
            (blocks[block], a, b, 5 + NORMAL[place] + 3 * block + (a == names[1]))
            for place, (block, a, b) in enumerate((block, a, b) for block in range(4) for a in names for b in "pq")
        ]
        measure = split_plot([row for place, row in enumerate(rows) if place % 5])
        model = model_of(measure, Estimand.MEAN)
        assert isinstance(model, FittedModel)
        test = carry_out(measure, model, CHOICES)
        found, _ = compare_pairs(measure, model, test, CHOICES)
        return [effect.p_value for effect in test.effects], [
            (each.difference, each.p_value) for each in found[0].comparisons
        ]

    plain = compared(("x", "y"), ("b0", "b1", "b2", "b3"))
    odd = compared(("C(b)[T.0]:", "]:y ~ x"), ("08:00", "09:00", "10:00", "C(b)"))
    assert odd == plain


def test_too_few_runs_leave_no_interactions():
    single = test_of(two_factors(cells(NORMAL, size=1, a="wxyz", b="pqr")))
    assert single.notes == ("Interactions cannot be estimated: there are too few runs a combination.",)
    empty = cells(NORMAL)
    empty["y", "q"] = []
    assert "Interactions cannot be estimated: some combinations have no run." in test_of(two_factors(empty)).notes


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (one_factor({"a": [1.0, 2.0, 3.0]}), "nothing to compare"),
        (one_factor({"a": [1.0], "b": [2.0], "c": [3.0]}), "each treatment has a single run"),
        (one_factor({"a": [1.0] * 4, "b": [1.0] * 4}), "all values are equal"),
        (one_factor({"a": [1.0] * 4, "b": [2.0] * 4}), "within each combination all values are equal"),
        (one_factor({"a": [1.0, 2.0, 3.0], "b": [2.0, 3.0, 4.0]}, in_blocks=True), "in the same way"),
        (two_factors({("x", "p"): [1.0], ("y", "q"): [2.0]}), "too few runs"),
    ],
    ids=["one treatment", "one repetition", "all equal", "no variation", "no variation of blocks", "too few runs"],
)
def test_what_cannot_be_tested_says_why(data, why):
    if len(data.levels("A")) == 1:
        data = type(data)(data.name, data.frame, data.every, (), is_blocked=False)
    found = test_of(data)
    assert isinstance(found, NotComputed)
    assert why in found.why


def test_trimmed_means_of_blocks_are_refused_with_the_reason():
    found = model_of(one_factor(groups(3, NORMAL), in_blocks=True), Estimand.TRIMMED_MEAN)
    assert isinstance(found, NotComputed)
    assert "trimmed means are compared of runs of their own" in found.why


def test_the_bootstrap_agrees_with_the_approximation_where_that_holds():
    layout = layout_of(one_factor(groups(4, NORMAL, size=25)))
    moments = layout.moments(NORMAL[:100] + np.repeat([0.0, 0.2, 0.4, 0.6], 25))
    (effect,) = layout.effects
    again = bootstrapped(lambda drawn: welch_james(drawn, effect.between).p_value, moments)
    assert float(again) == pytest.approx(float(welch_james(moments, effect.between).p_value), abs=0.01)


def test_welch_james_keeps_its_digits_where_variances_differ_by_far():
    means, variances = [0, 3, 1, 5, 2, 4], [3, *(Fraction(each, 2**38) for each in (1, 5, 2, 7, 4))]
    contrasts = [[1, -1, -1, 1, 0, 0], [1, -1, 1, -1, -2, 2]]
    (a, b), (_, d) = (
        [sum(x * y * of for x, y, of in zip(one, other, variances, strict=True)) for other in contrasts]
        for one in contrasts
    )
    inverse = [[d / (a * d - b * b), -b / (a * d - b * b)], [-b / (a * d - b * b), a / (a * d - b * b)]]
    differences = [sum(x * mean for x, mean in zip(each, means, strict=True)) for each in contrasts]
    wald = sum(differences[i] * inverse[i][j] * differences[j] for i in (0, 1) for j in (0, 1))
    shares = [
        of * sum(contrasts[i][at] * inverse[i][j] * contrasts[j][at] for i in (0, 1) for j in (0, 1))
        for at, of in enumerate(variances)
    ]
    chance = sum(each**2 for each in shares) / 9
    moments = Moments(
        np.array(means, dtype=float)[:, None], np.array(variances, dtype=float)[:, None, None], np.full(6, 9.0)
    )
    found = welch_james(moments, np.array(contrasts, dtype=float))
    assert float(found.f_value) == pytest.approx(float(wald / (2 + 2 * chance - 6 * chance / 4)), rel=1e-9)
    assert float(found.within) == pytest.approx(float(8 / (3 * chance)), rel=1e-9)


def test_two_p_values_together_are_a_mean_of_both():
    first, second = np.array([0.04, 0.01, 0.5, 0.0]), np.array([0.04, 0.5, 0.01, 0.3])
    together = combined([first, second])
    assert together == pytest.approx([0.04, 0.0392, 0.0392, 0.0], abs=5e-4)
    assert np.all((together >= np.minimum(first, second)) & (together <= np.maximum(first, second)))


@pytest.mark.long
def test_degrees_of_freedom_are_unbiased_for_groups_of_blocks():
    # Of 4 and 7 blocks whose covariances of three treatments differ: the ratio of what the estimates estimate
    random = np.random.default_rng(12)
    roots = [np.diag([1.0, 2.0, 3.0]), np.array([[2.0, 0, 0], [1, 1, 0], [0, 1, 1]])]
    sizes = np.array([4, 7])
    errors = [
        np.stack([np.cov((random.normal(size=(size, 3)) @ root.T).T) / size for _ in range(4000)])
        for root, size in zip(roots, sizes, strict=True)
    ]
    true = np.stack([root @ root.T / size for root, size in zip(roots, sizes, strict=True)])
    traces, squares = (np.einsum(each, *of) for each, of in (("gaa->g", [true]), ("gab,gba->g", [true, true])))
    found = np.stack(errors, axis=1)
    estimated = unbiased_squares(np.einsum("egaa->eg", found), np.einsum("egab,egba->eg", found, found), sizes - 1.0, 3)
    assert estimated.mean(axis=0) == pytest.approx(squares, rel=0.06)
    total = np.einsum("egaa->eg", found) ** 2 - 2 * estimated / (sizes - 1.0)
    assert total.mean(axis=0) == pytest.approx(traces**2, rel=0.06)


@pytest.mark.long
def test_intervals_of_d_do_not_depend_on_the_order_of_treatments():
    assert np.isnan(special.nctdtr(18, 30, -2)), "what intervals were made of before"
    random = np.random.default_rng(3)
    for _ in range(150):
        t_value, freedom = random.normal() * 10 ** random.uniform(-2, 3), 10 ** random.uniform(0.05, 4)
        low, high = noncentralities_of_t(t_value, freedom, 0.95)
        assert low <= t_value <= high
        assert noncentralities_of_t(-t_value, freedom, 0.95) == pytest.approx((-high, -low), rel=1e-6)
    assert noncentralities_of_f(0.2, (2, 10), 0.9) == (0.0, pytest.approx(1.36, abs=2))
    assert cohens_d(1.0, 1e-9, 9.0, 1.0).interval is None, "beyond floating-point numbers there is none, and no NaN"


def test_intervals_of_means_are_students():
    (group,) = one_factor({"a": [4.1, 5.0, 5.2, 5.9, 6.3]}).described_groups([])
    # t.test(c(4.1, 5.0, 5.2, 5.9, 6.3))$conf.int: 4.24276120 6.35723880
    interval = describe(group).mean_interval
    assert (interval.low, interval.high) == pytest.approx((4.24276120, 6.35723880), abs=5e-9)
    assert interval.method == "t distribution"


# The family, hypotheses and blocks of a plan.

TASKS = Factor("Task", ["Video", "Idle"])
SPEEDS = Factor("Speed", ["slow", "fast"])


def analysed(tmp_path, plan, shift=0.0, **made):
    random = np.random.default_rng(4)

    def values(treatments, repetition):
        return {"Energy": shift * (treatments["Task"] == "Video") + random.normal(), "CPU": random.normal()}

    folder = make_experiment(
        tmp_path / "e", [TASKS, SPEEDS], values, repetitions=8, measures=["Energy", "CPU"], analysis=plan, **made
    )
    return load_results(folder.root)


@pytest.mark.parametrize(
    ("plan", "sizes"),
    [
        ({"measures": ["Energy", "CPU"]}, (6, 6)),
        ({"measures": ["Energy"], "secondary": ["CPU"]}, (3, 3)),
        ({"measures": ["Energy", "CPU"], "family": "measure"}, (3, 3)),
        (
            {
                "measures": ["Energy"],
                "family": "hypotheses",
                "hypotheses": [{"statement": "It does.", "measure": "Energy", "factors": ["Task"]}],
            },
            (1, 3),
        ),
    ],
)
def test_errors_are_controlled_among_the_family_of_the_plan(tmp_path, plan, sizes):
    found = analyse(analysed(tmp_path, plan, shift=1.2))
    assert tuple(found.measure(name).test.family_size for name in ("Energy", "CPU")) == sizes
    assert [each.is_primary for each in found.measures] == [name in plan["measures"] for name in ("Energy", "CPU")]
    task = found.measure("Energy").test.effects[0]
    assert task.adjusted_p_value == pytest.approx(task.p_value * sizes[0])


@pytest.mark.long
def test_asking_for_one_measure_changes_none_of_its_p_values(tmp_path):
    results = analysed(tmp_path, {"measures": ["Energy", "CPU"]}, shift=1.0)
    alone, among = analyse(results, measures=["Energy"]), analyse(results)
    assert [each.name for each in alone.measures] == ["Energy"]
    assert alone.measure("Energy").test == among.measure("Energy").test


def test_a_given_plan_whose_contrast_names_no_treatment_is_refused_with_the_nearest(tmp_path):
    claim = Hypothesis("So.", measure="Energy", factors="Task", contrast={"Vido": 1, "Idle": -1})
    with pytest.raises(AnalysisError, match="'Vido', in the contrast, is not a treatment of 'Task'") as refused:
        analyse(analysed(tmp_path, None, shift=1.0), plan=AnalysisPlan(hypotheses=[claim]))
    assert "Did you mean 'Video'?" in refused.value.fix


def test_why_a_bound_of_three_treatments_is_not_tested_is_told(tmp_path):
    claim = {"statement": "They are alike.", "measure": "Energy", "factors": ["Speed"], "within": 3}
    made = make_experiment(
        tmp_path / "made",
        [Factor("Speed", [0.1, 0.2, 0.3])],
        lambda of, repetition: {"Energy": of["Speed"] + repetition % 2},
        repetitions=4,
        analysis={"measures": ["Energy"], "hypotheses": [claim]},
    )
    (found,) = analyse(load_results(made.root)).hypotheses
    assert "a bound is of two treatments, and it names none by a contrast of those of Speed: 0.1, 0.2, 0.3." in (
        found.conclusion
    )


def test_a_contrast_and_a_bound_of_equivalence_are_judged(tmp_path):
    def claim(statement, **more):
        return {"statement": statement, "measure": "Energy", "factors": ["Task"], **more}

    hypotheses = [
        claim("Video costs more.", contrast={"Video": 1, "Idle": -1}),
        claim("They are within 3 J.", within=3),
        claim("They are within 0.1 J.", within=0.1),
        claim("Music costs more.", contrast={"Music": 1, "Idle": -1}),
    ]
    found = analyse(analysed(tmp_path, {"measures": ["Energy"], "hypotheses": hypotheses}, shift=1.5))
    assert [each.is_supported for each in found.hypotheses] == [True, True, False, None]
    assert "its treatments are not those of Task: Video, Idle." in found.hypotheses[3].conclusion
    contrast, bound, *_ = found.measure("Energy").contrasts
    (pair,) = found.measure("Energy").post_hoc[0].comparisons
    assert (contrast.estimate, contrast.p_value) == (pytest.approx(pair.difference), pytest.approx(pair.p_value))
    assert -3 < bound.interval.low < bound.interval.high < 3
    assert found.hypotheses[1].conclusion.endswith("; the claim is within ±3.")
    assert bound.interval.level == pytest.approx(0.9)


@pytest.mark.parametrize(("below", "is_supported"), [(2.5, True), (0, False), (-1, False), (-4, False)])
def test_a_difference_below_a_bound_is_judged_as_scipys_one_sided_test_does(tmp_path, below, is_supported):
    weights = {"Video": 1, "Idle": -1}
    claim = {"statement": "No more.", "measure": "Energy", "factors": ["Task"], "contrast": weights, "below": below}
    random = np.random.default_rng(4)
    made = make_experiment(
        tmp_path / "made",
        [TASKS],
        lambda of, repetition: {"Energy": random.normal(1.5, 2) if of["Task"] == "Video" else random.normal()},
        repetitions=20,
        analysis={"measures": ["Energy"], "family": "hypotheses", "hypotheses": [claim]},
    )
    results = load_results(made.root)
    found = analyse(results)
    (outcome,), (contrast,) = found.hypotheses, found.measure("Energy").contrasts
    video, idle = (results.runs.loc[results.runs["Task"] == task, "Energy"] for task in weights)
    exact = stats.ttest_ind(video - below, idle, equal_var=False, alternative="less")
    assert contrast.p_value == pytest.approx(exact.pvalue)
    assert contrast.interval.high == pytest.approx(below + exact.confidence_interval(0.95).high)
    assert (outcome.is_supported, contrast.interval.high < below) == (is_supported, is_supported)
    assert "another direction" not in outcome.conclusion
    assert outcome.conclusion.endswith(f"; the claim is below {below}.")


def test_ranks_have_no_unit_and_no_bound_in_one_but_a_direction(tmp_path):
    claim = {"measure": "Energy", "factors": ["Task"]}
    weights = {"Video": 1, "Idle": -1}
    hypotheses = [
        {"statement": "Video costs more.", "contrast": weights, **claim},
        {"statement": "They are within 1 J.", "within": 1, **claim},
        {"statement": "Video costs less than 1 J more.", "contrast": weights, "below": 1, **claim},
        {"statement": "Idling costs less.", "contrast": {"Idle": 1, "Video": -1}, "below": 0, **claim},
    ]
    plan = {"measures": ["Energy"], "estimand": "rank", "hypotheses": hypotheses}
    contrast, bound, below, direction = analyse(analysed(tmp_path, plan, shift=50)).hypotheses
    assert below.is_supported is None
    assert direction.is_supported
    assert "The contrast of relative ranks is estimated as" in contrast.conclusion
    assert " J" not in contrast.conclusion
    assert bound.is_supported is None
    assert "a bound in the unit of the measure says nothing of ranks" in bound.conclusion


@pytest.mark.long
def test_a_plan_names_the_blocks(tmp_path):
    results = analysed(tmp_path, {"measures": ["Energy"], "blocks": "Repetition"})
    measure = analyse(results).measure("Energy")
    assert measure.test.method is TestMethod.BLOCKS
    assert measure.test.effects[0].degrees_of_freedom == pytest.approx((7.0,))


def test_a_check_that_disagrees_is_told(tmp_path):
    random = np.random.default_rng(2)

    def values(treatments, repetition):
        base = random.normal() + 1.6 * (treatments["Task"] == "Video")
        return {"Energy": 500.0 if (treatments["Task"], repetition) == ("Idle", 1) else base}

    folder = make_experiment(tmp_path / "e", [TASKS], values, repetitions=12)
    (effect,) = analyse(load_results(folder.root)).measure("Energy").test.effects
    assert not effect.is_significant
    assert effect.check.p_value < 0.05
    assert effect.conclusion.endswith("): the treatments may differ in other ways.")


def test_a_factorial_with_gaps_has_a_variance_for_each_combination():
    # Two of twelve combinations have no run, and the spread of one factor differs four times.
    random = np.random.default_rng(8)
    values = {
        (a, b, c): list(50 + 3 * (a == "y") + (4 if b == "q" else 1) * random.normal(size=4 + (c == "v")))
        for a, b, c in product("xy", "pq", "uvw")
        if (a, b) != ("x", "p") or c == "u"
    }
    rows = [(*cell, value) for cell, several in values.items() for value in several]
    data = design_of(designed(rows, "ABC", {"kind": "full_factorial"})).data("y")
    test = test_of(data)
    assert test.reason == (
        "3 factors, of whose combinations 10 have runs, each run by itself: means are compared, with a variance for "
        "each combination."
    )
    (note, *_) = test.notes
    assert note.startswith("Some combinations have no run: effects are those that least squares estimate")
    # By hand: what least squares makes of the means of combinations, each with its own squared error.
    cells = list(values)
    coded = [{"x": 1, "y": -1}, {"p": 1, "q": -1}]
    of_c = {"u": (1, 0), "v": (0, 1), "w": (-1, -1)}
    main = [[coded[0][a], coded[1][b], *of_c[c]] for a, b, c in cells]
    pairs = [[r[0] * r[1], r[0] * r[2], r[0] * r[3], r[1] * r[2], r[1] * r[3]] for r in main]
    weights = np.linalg.pinv(np.column_stack([np.ones(len(cells)), main, pairs]))[1]
    means, errors, counts = (np.array([of(values[cell]) for cell in cells]) for of in (np.mean, stats.sem, len))
    error = np.sqrt(np.sum((weights * errors) ** 2))
    freedom = error**4 / np.sum((weights * errors) ** 4 / (counts - 1))
    effect = test.effects[0]
    assert effect.test == "Welch's t"
    assert effect.statistic == pytest.approx(weights @ means / error)
    assert effect.degrees_of_freedom == pytest.approx((freedom,))
    assert [each.factors for each in test.effects][3:] == [("A", "B"), ("A", "C"), ("B", "C")]


def test_few_blocks_of_many_treatments_are_compared_by_the_signs_of_their_contrasts():
    random = np.random.default_rng(4)
    values = random.normal(size=(8, 5)) + np.linspace(0, 2.5, 5)
    data = one_factor({f"t{place}": list(column) for place, column in enumerate(values.T)}, in_blocks=True)
    (effect,) = test_of(data).effects
    # By hand: of all 2^8 patterns of signs of what blocks leave of their means, how many sum up to as much.
    left = values - values.mean(axis=1, keepdims=True)
    sums = [np.sum((np.array(signs) @ left) ** 2) for signs in product((1, -1), repeat=8)]
    assert effect.p_value == pytest.approx(np.mean(np.array(sums) >= sums[0] * (1 - 1e-9)))
    assert effect.statistic == pytest.approx(
        8 * 7 * np.sum(left.mean(axis=0) ** 2) / np.sum((left - left.mean(axis=0)) ** 2)
    )
    assert effect.p_value < 0.05


def test_no_contrast_has_more_degrees_of_freedom_than_the_runs_that_it_compares():
    # Where a combination lacks, runs of the others counted that a contrast does not look at: p = 0.035 for 0.080.
    a_1, a_2, b_2 = (138.4, 140.9), (141.1, 143.9), (162.0, 155.7)
    rows = [
        (*treatments, value)
        for treatments, runs in zip(["a1", "a2", "b2"], [a_1, a_2, b_2], strict=True)
        for value in runs
    ]
    of_task, of_speed = analyse(designed(rows, ["Task", "Speed"], {})).measure("y").test.effects
    for effect, one, other in ((of_task, a_2, b_2), (of_speed, a_1, a_2)):
        alone = stats.ttest_ind(one, other, equal_var=False)
        assert effect.statistic == pytest.approx(alone.statistic)
        assert alone.df <= effect.degrees_of_freedom[0] <= 2 * (1 + 1e-12)  # rounded


@pytest.mark.parametrize("weights", [[1, -1, 0, 0], [1, 1, -1, -1], [3, -1, -1, -1]])
def test_with_equal_variances_contrasts_of_two_runs_each_keep_their_level(weights):
    values = np.random.default_rng(1).normal(size=(40_000, len(weights), 2))
    moments = Moments(values.mean(-1)[..., None], (values.var(-1, ddof=1) / 2)[..., None, None], np.ones(len(weights)))
    found = contrast(moments, np.array(weights, float)[:, None], is_corrected=True)
    assert np.mean(found.p_value < 0.05) < 0.05
