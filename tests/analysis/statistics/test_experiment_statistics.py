"""The statistics of an experiment hold for whatever its table is, and say what could not be computed."""

from __future__ import annotations

import json
import math
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from tests.analysis.experiment_folders import Folder
from tests.analysis.made_experiment import make_experiment
from tests.analysis.statistics.reference_data import one_factor

from robot_runner.analysis import analyse, load_results
from robot_runner.analysis.statistics.correlations import drift_of
from robot_runner.analysis.statistics.designed_columns import residuals_of
from robot_runner.analysis.statistics.detectable_effect import repetitions_needed
from robot_runner.analysis.statistics.post_hoc import adjusted
from robot_runner.analysis.statistics.tested import TestMethod
from robot_runner.core.design.analysis_plan import Correction
from robot_runner.core.design.factor import Factor
from robot_runner.core.errors import AnalysisError

NOISE = np.random.default_rng(11).normal(0, 1, 400).tolist()
TASKS = Factor("Task", ["Video", "Network", "Idle"])


def energy(treatments, repetition):
    base = {"Video": 870.0, "Network": 830.0, "Idle": 700.0}[treatments["Task"]]
    return {"Energy": base + NOISE[hash_of(treatments, repetition)]}


def hash_of(treatments, repetition):
    return (sum(map(ord, "".join(map(str, treatments.values())))) * 31 + repetition) % 400


def statistics(tmp_path, factors=(TASKS,), values=energy, **made):
    folder = make_experiment(tmp_path / "e", factors, values, **made)
    return analyse(load_results(folder.root))


def numbers(found):
    """Every number in the result, however deep."""
    if isinstance(found, float):
        yield found
    elif is_dataclass(found):
        for field in fields(found):
            yield from numbers(getattr(found, field.name))
    elif isinstance(found, tuple | list):
        for each in found:
            yield from numbers(each)


def test_within_blocks_nothing_is_said_of_equal_variances_which_blocks_hide(tmp_path):
    def values(treatments, repetition):
        spread = 3.0 if treatments["Task"] == "Idle" else 1.0
        return {"Energy": 10 * NOISE[repetition] + spread * NOISE[hash_of(treatments, repetition)]}

    found = statistics(tmp_path, values=values, repetitions=12, blocks="Repetition").measure("Energy")
    assert "Levene" not in {each.name for each in found.assumptions}
    assert [each.why for each in found.not_computed if each.what == "Levene test"] == [
        "all groups also have the spread of blocks, which hides how theirs differ."
    ]


def test_a_plain_experiment(tmp_path):
    found = statistics(tmp_path, repetitions=6, units={"Energy": "J"})
    measure = found.measure("Energy")
    assert measure.test.method is TestMethod.COMBINED
    assert measure.test.effects[0].is_significant
    assert [each.label for each in measure.by_treatment] == ["Video", "Network", "Idle"]
    assert [each.n for each in measure.by_treatment] == [6, 6, 6]
    assert len(measure.post_hoc[0].comparisons) == 3
    assert measure.not_computed == ()
    assert found.design.is_balanced
    assert found.design.sentence == "18 runs are done; varied: Task (3 treatments); 6 runs a combination."


def test_percentages_differ_by_percentage_points(tmp_path):
    effect = statistics(tmp_path, repetitions=6, units={"Energy": "%"}).measure("Energy").test.effects[0]
    assert "percentage points, the largest difference (" in effect.conclusion


def test_outliers_are_named_by_their_run(tmp_path):
    def one_off(treatments, repetition):
        return {"Energy": 2000.0} if (treatments["Task"], repetition) == ("Idle", 2) else energy(treatments, repetition)

    measure = statistics(tmp_path, values=one_off, repetitions=8).measure("Energy")
    idle = measure.by_treatment[2]
    (outlier,) = idle.outliers
    assert (outlier.run_id, outlier.value, outlier.is_extreme) == ("r_6", 2000.0, True)


def test_no_run_is_done(tmp_path):
    found = statistics(tmp_path, values=lambda treatments, repetition: None)
    assert found.design.sentence == "No run is done."
    assert [each.why for each in found.measure("Energy").not_computed] == ["no run that is done has a value."]
    assert "9 runs of the table are not done and left out." in found.warnings


def test_one_treatment_only(tmp_path):
    measure = statistics(tmp_path, [Factor("Task", ["Video"])], repetitions=5).measure("Energy")
    assert measure.test is None
    assert measure.overall.n == 5
    assert "nothing to compare" in measure.not_computed[0].why


def test_one_repetition(tmp_path):
    measure = statistics(tmp_path, repetitions=1).measure("Energy")
    assert measure.test is None
    assert any("repeat the runs" in each.why for each in measure.not_computed)
    assert measure.by_treatment[0].sd is None


def test_residuals_that_their_design_fixes_are_not_tested_for_normality(tmp_path):
    found = statistics(tmp_path, (Factor("Task", ["Video", "Network"]),), repetitions=2).measure("Energy")
    assert "Shapiro-Wilk" not in {each.name for each in found.assumptions}
    why = {each.what: each.why for each in found.not_computed}["Shapiro-Wilk test of the residuals"]
    assert "fewer than 3 degrees of freedom" in why


def test_groups_of_too_few_values_for_a_test_of_normality_are_named_together(tmp_path):
    def energy(treatments, repetition):
        return {"Energy": float(ord(treatments["Task"]) + repetition % 2)}

    few = statistics(tmp_path, (Factor("Task", [*"ABCDEFGH"]),), energy, repetitions=2).measure("Energy")
    whys = {each.what: each.why for each in few.not_computed if each.what.startswith("Shapiro")}
    assert whys["Shapiro-Wilk test of A, B, C, D, E, F and 2 more"].endswith("and there are fewer.")
    assert len(whys) <= 2


def test_all_values_are_equal(tmp_path):
    measure = statistics(tmp_path, values=lambda treatments, repetition: {"Energy": 5.0}, repetitions=4).measure(
        "Energy"
    )
    assert (measure.test, measure.quantiles, measure.power) == (None, None, None)
    assert "all values are equal." in [each.why for each in measure.not_computed]
    assert measure.overall.mean_interval is None


def test_missing_values_are_counted_and_left_out(tmp_path):
    def gaps(treatments, repetition):
        return {"Energy": None} if repetition == 1 else energy(treatments, repetition)

    measure = statistics(tmp_path, values=gaps, repetitions=6).measure("Energy")
    assert [(each.n, each.missing) for each in measure.by_treatment] == [(5, 1)] * 3
    assert measure.test is not None


def test_unequal_groups(tmp_path):
    def some(treatments, repetition):
        return None if treatments["Task"] == "Idle" and repetition > 3 else energy(treatments, repetition)

    found = statistics(tmp_path, values=some, repetitions=6)
    assert (found.design.smallest_group, found.design.largest_group) == (3, 6)
    assert "The combinations have 3 to 6 runs." in found.warnings
    assert found.measure("Energy").test is not None


def test_a_measure_that_is_a_text(tmp_path):
    measure = statistics(tmp_path, values=lambda treatments, repetition: {"Energy": "fast"}).measure("Energy")
    assert measure.overall is None
    assert [each.why for each in measure.not_computed] == ["its values are neither numbers nor True and False."]


def test_a_measure_that_is_yes_or_no_in_some_runs_and_a_number_in_others(tmp_path):
    def mixed(treatments, repetition):
        return {"Energy": True if repetition > 1 else 1.0}

    (missing,) = statistics(tmp_path, values=mixed).measure("Energy").not_computed
    assert missing.why == "some of its values are True or False, and others numbers: publish all as one of them."


def test_a_measure_without_any_value_is_said_to_have_none(tmp_path):
    made = make_experiment(tmp_path / "e", values=lambda *_: {"Energy": None}, measures=("Energy",))
    schema = made.root / "run_table.schema.json"
    told = json.loads(schema.read_text(encoding="utf-8"))
    for column in told["fields"]:
        if column["name"] == "Energy":
            column["type"] = "string"
    schema.write_text(json.dumps(told), encoding="utf-8")
    (missing,) = analyse(load_results(made.root)).measure("Energy").not_computed
    assert missing.why == "no run that is done has a value."


def test_a_measure_of_texts_that_read_as_numbers_says_how_they_become_some(tmp_path):
    measure = statistics(tmp_path, values=lambda treatments, repetition: {"Energy": f"{repetition}.5"}).measure(
        "Energy"
    )
    assert measure.overall is None
    why = "its values are texts that read as numbers, such as '1.5': publish them as numbers (float)."
    assert [each.why for each in measure.not_computed] == [why]


@pytest.mark.long
def test_a_factor_of_a_hundred_treatments(tmp_path):
    level = Factor("Level", range(100))
    found = statistics(
        tmp_path,
        [level],
        lambda treatments, repetition: {"Energy": NOISE[treatments["Level"] + repetition]},
        repetitions=2,
    )
    measure = found.measure("Energy")
    assert measure.test is not None
    assert len(measure.by_treatment) == 100
    assert [each.why for each in measure.not_computed if "pairwise" in each.what] == [
        "100 groups make 4,950 pairs: compare chosen ones."
    ]


def test_names_may_hold_anything(tmp_path):
    odd = Factor('T<b>&_$\\ask" ~ C(x)', ["a:b", "50 %", "<script>", "x / y"])
    other = Factor("[b]", [1, 2])
    found = statistics(
        tmp_path,
        [odd, other],
        lambda treatments, repetition: {"Energy": NOISE[hash_of(treatments, repetition)]},
        repetitions=4,
    )
    assert found.measure("Energy").test.effects[2].factors == (odd.name, "[b]")


def test_whole_numbers_are_analysed(tmp_path):
    found = statistics(
        tmp_path,
        values=lambda treatments, repetition: {"Energy": len(treatments["Task"]) * 10 + repetition},
        repetitions=5,
    )
    assert found.measure("Energy").test.effects[0].is_significant


def test_an_interaction_is_compared_combination_by_combination(tmp_path):
    factors = [Factor("A", ["x", "y"]), Factor("B", ["p", "q"])]

    def crossed(treatments, repetition):
        high = treatments["A"] == "x" and treatments["B"] == "q"
        return {"Energy": 20.0 * high + NOISE[hash_of(treatments, repetition)]}

    measure = statistics(tmp_path, factors, crossed, repetitions=8).measure("Energy")
    assert measure.test.effects[2].is_significant
    (of_combinations,) = [each for each in measure.post_hoc if len(each.factors) == 2]
    assert len(of_combinations.comparisons) == 6
    found = {(each.first, each.second): each for each in of_combinations.comparisons}
    assert found["x / p", "x / q"].is_significant
    assert found["x / p", "x / q"].difference == pytest.approx(-20, abs=2)
    assert not found["x / p", "y / p"].is_significant
    assert len(measure.by_combination) == 4


def test_blocks_of_repetitions_are_compared_within(tmp_path):
    def by_day(treatments, repetition):
        return {"Energy": energy(treatments, repetition)["Energy"] + 200.0 * repetition}

    measure = statistics(tmp_path, values=by_day, repetitions=6, blocks="Repetition").measure("Energy")
    assert measure.test.method is TestMethod.BLOCKS
    assert measure.test.effects[0].is_significant


@pytest.mark.long
def test_residuals_and_drift_are_those_within_blocks(tmp_path):
    days = [0.0, 300.0, -500.0, 200.0, 900.0, -100.0]

    def energies(name, days=days, **made):
        def value(treatments, repetition):
            return {"Energy": energy(treatments, repetition)["Energy"] + days[repetition - 1]}

        return statistics(tmp_path / name, values=value, repetitions=6, shuffle=True, **made).measure("Energy")

    jumping, level = energies("jumping", blocks="Repetition"), energies("level", blocks="Repetition", days=[0.0] * 6)
    assert jumping.quantiles.observed == pytest.approx(level.quantiles.observed)  # whatever blocks differ by
    assert jumping.drift.p_value == pytest.approx(level.drift.p_value)
    assert jumping.drift.within == ("blocks",)
    assert energies("plain").drift.within == ("treatments",)
    # Where each run is of a block of its own, nothing would be left.
    of_days = one_factor({"a": [1.0, 2.0, 5.0], "b": [3.0, 4.0, 9.0]}, in_blocks=True)
    between = replace(of_days, frame=of_days.frame.assign(**{" block": [f"d{place}" for place in range(6)]}))
    assert sum(residuals_of(between)[0] ** 2) == pytest.approx(26 / 3 + 62 / 3)


def test_rooms_that_differ_are_no_drift_where_a_factor_differs_between_them(tmp_path):
    """Runs of one room follow each other: over all 54 % of such experiments seem to drift, at 5 %."""
    rooms = [0.0, 2.0, -1.0, 4.0, 6.0, 3.0]
    rows = [
        (f"room {place // 10}", ("Video", "Idle")[place // 30], rooms[place // 10] + 0.3 * NOISE[place])
        for place in range(60)
    ]
    factors = {"Room": [f"room {number}" for number in range(6)], "Task": ["Video", "Idle"]}
    design = {"source": "config", "factors": factors, "blocks": "Room"}
    folder = Folder(tmp_path / "rooms", factors, rows, {"Energy": "J"}, manifest={"design": design})
    drift = analyse(load_results(folder.write())).measure("Energy").drift
    assert drift.within == ("blocks",)
    assert not drift.is_significant


def test_drift_over_the_order_of_execution_is_warned_of(tmp_path):
    def falling(treatments, repetition):
        return {"Energy": 900.0 - 3.0 * repetition + 0.1 * NOISE[hash_of(treatments, repetition)]}

    found = statistics(tmp_path, values=falling, repetitions=10, units={"Energy": "J"})
    drift = found.measure("Energy").drift
    assert drift.is_significant
    assert drift.slope == pytest.approx(-1.0, abs=0.1)  # three runs a repetition
    assert found.warnings[0].startswith("Energy falls over the order of execution within treatments by about")
    assert not drift.is_confounded


def test_an_order_that_was_not_randomised_is_warned_of(tmp_path):
    assert any("was not randomised" in warning for warning in statistics(tmp_path).warnings)


def test_treatments_that_were_executed_one_after_the_other_are_confounded_with_drift():
    rising = {"a": list(np.arange(10.0)), "b": list(np.arange(10.0, 20.0))}
    assert drift_of(one_factor(rising), 0.05).is_confounded
    told = drift_of(one_factor(rising), 0.05, is_ordered=False).warning
    order = "order of the table, which may be another than that of execution, within treatments"
    assert f"over the {order} by about" in told


def test_what_was_planned_is_told_from_what_is_exploratory(tmp_path):
    plan = {
        "measures": ["Energy"],
        "alpha": 0.01,
        "correction": "benjamini-hochberg",
        "hypotheses": [
            {"statement": "The task matters.", "measure": "Energy", "factors": ["Task"]},
            {"statement": "Speed matters.", "measure": "Energy", "factors": ["Speed"]},
        ],
    }

    def two(treatments, repetition):
        return {**energy(treatments, repetition), "CPU": NOISE[repetition]}

    folder = make_experiment(tmp_path / "e", [TASKS], two, measures=["CPU", "Energy"], repetitions=5, analysis=plan)
    found = analyse(load_results(folder.root))
    assert (found.alpha, found.correction, found.is_planned) == (0.01, Correction.BENJAMINI_HOCHBERG, True)
    assert [(each.name, each.is_planned) for each in found.measures] == [("Energy", True), ("CPU", False)]
    supported, untested = found.hypotheses
    assert (supported.is_supported, untested.is_supported) == (True, None)
    assert untested.conclusion == "It could not be tested: the test has no effect of Speed."


def test_another_alpha_than_the_planned_makes_everything_exploratory(tmp_path):
    plan = {"measures": ["Energy"], "alpha": 0.01}
    folder = make_experiment(tmp_path / "e", [TASKS], energy, repetitions=5, analysis=plan)
    found = analyse(load_results(folder.root), alpha=0.1)
    assert not found.is_planned
    assert not found.measures[0].is_planned


def test_a_level_of_confidence_is_not_taken_for_alpha(tmp_path):
    folder = make_experiment(tmp_path / "e", (TASKS,), energy)
    with pytest.raises(AnalysisError, match=r"alpha is 0.95 .*Give one below 0.5: 0.05 for a confidence of 0.95"):
        analyse(load_results(folder.root), alpha=0.95)


def test_a_measure_that_is_not_there_is_named(tmp_path):
    folder = make_experiment(tmp_path / "e", [TASKS], energy)
    with pytest.raises(AnalysisError, match="there is no measure 'Enrgy'") as refused:
        analyse(load_results(folder.root), measures=["Enrgy"])
    assert refused.value.fix == "Did you mean 'Energy'?"


def test_correlation_within_treatments_is_told_from_that_of_the_treatments(tmp_path):
    def both(treatments, repetition):
        base = {"Video": 0.0, "Network": 10.0, "Idle": 20.0}[treatments["Task"]]
        place = hash_of(treatments, repetition)
        return {"Energy": base + NOISE[place], "CPU": base + NOISE[-place - 1]}

    (found,) = statistics(tmp_path, values=both, measures=["Energy", "CPU"], repetitions=10).correlations
    assert found.pearson > 0.95
    assert abs(found.within) < 0.5


def test_what_is_said_of_power_does_not_hang_on_the_effect_that_was_observed(tmp_path):
    # The power of the observed effect is the p-value once more (Hoenig and Heisey 2001).
    def values(size):
        return lambda treatments, repetition: {
            "Energy": 100 + size * (treatments["Task"] == "Video") + NOISE[repetition + 20 * len(treatments["Task"])]
        }

    none, large = (
        statistics(tmp_path / str(size), values=values(size), repetitions=8).measure("Energy") for size in (0, 50)
    )
    assert none.test.effects[0].p_value != large.test.effects[0].p_value
    assert none.power == large.power
    assert none.power.detectable_effect is not None


@pytest.mark.parametrize(
    ("is_within", "detectable", "counted", "needed"),
    [(True, 2.0287721, "blocks", [395, 65, 27]), (False, 3.0709084, "blocks of a group", [394, 64, 26])],
)
def test_many_runs_of_few_blocks_find_no_small_effect(tmp_path, is_within, detectable, counted, needed):
    """In R, with `strict = TRUE`: sqrt(2) * power.t.test(n = 6, power = 0.8, type = "one.sample")$delta, and n = 3."""
    places = range(60)
    tasks = [("Video", "Idle")[place % 2 if is_within else place % 6 // 3] for place in places]
    rows = [(f"room {place // 10 if is_within else place % 6}", tasks[place], NOISE[place]) for place in places]
    factors = {"Room": [f"room {number}" for number in range(6)], "Task": ["Video", "Idle"]}
    design = {"source": "config", "factors": factors, "blocks": "Room"}
    folder = Folder(tmp_path / "rooms", factors, rows, {"Energy": "J"}, manifest={"design": design})
    power = analyse(load_results(folder.write())).measure("Energy").power
    assert power.detectable_effect == pytest.approx(detectable, rel=2e-5)
    assert (power.counted, [each.repetitions for each in power.needed]) == (counted, needed)
    assert "More runs in the same blocks" in power.note or "more runs of the same blocks" in power.note


def test_power_within_blocks_of_three_treatments_is_that_of_the_f_test():
    """As simulated in R: `anova(lm(y ~ block + task))` of 8 blocks and f = 0.7 finds it in 79 % of experiments."""
    assert 7 < repetitions_needed(0.7, 3, in_blocks=True) <= 9


def test_what_power_is_of_incomplete_blocks_is_not_said(tmp_path):
    def values(treatments, repetition):
        lacks = repetition % 3 == TASKS.texts.index(treatments["Task"])
        return None if lacks else {"Energy": NOISE[repetition] + NOISE[repetition + 7 * len(treatments["Task"])]}

    found = statistics(tmp_path, values=values, repetitions=9, blocks="Repetition").measure("Energy")
    assert found.power is None
    assert [each.why for each in found.not_computed if each.what == "power"] == [
        "it is computed for runs that stand by themselves, and for complete blocks."
    ]


def test_more_power_needs_more_runs():
    assert repetitions_needed(0.2, 2) > repetitions_needed(0.8, 2)
    assert repetitions_needed(0.25, 3) > repetitions_needed(0.25, 3, power=0.5)


@settings(max_examples=settings.default.max_examples // 7)  # statsmodels collects garbage at each call
@example([5e-324] * 2 + [1.0] * 7, Correction.BENJAMINI_HOCHBERG)
@given(st.lists(st.floats(0, 1), min_size=1, max_size=20), st.sampled_from(Correction))
def test_adjusted_p_values_agree_with_statsmodels(p_values, correction):
    from statsmodels.stats.multitest import multipletests

    method = {Correction.HOLM: "holm", Correction.BENJAMINI_HOCHBERG: "fdr_bh"}[correction]
    theirs = multipletests(p_values, method=method)[1]
    below_normal = np.finfo(np.float64).tiny  # where one rounding changes a number by up to its own size
    np.testing.assert_allclose(adjusted(p_values, correction), theirs, atol=below_normal)


@pytest.mark.long
@settings(max_examples=settings.default.max_examples // 8, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    values=st.lists(
        st.none() | st.integers(-3, 3).map(float) | st.floats(-1e6, 1e6, width=32), min_size=12, max_size=12
    ),
    blocks=st.sampled_from([None, "Repetition"]),
    two=st.booleans(),
)
def test_whatever_was_measured_no_number_is_not_finite(tmp_path_factory, values, blocks, two):
    factors = [Factor("A", ["x", "y"]), Factor("B", ["p", "q"])] if two else [Factor("A", ["x", "y", "z"])]
    left = iter(values)
    found = statistics(
        tmp_path_factory.mktemp("any"),
        factors,
        lambda treatments, repetition: {"Energy": next(left)},
        repetitions=3 if two else 4,
        blocks=blocks,
    )
    assert all(map(math.isfinite, numbers(found)))
    for measure in found.measures:
        for effect in measure.test.effects if measure.test else ():
            assert effect.p_value is None or 0 <= effect.p_value <= 1
        assert measure.test is not None or measure.not_computed


def test_a_folder_and_one_name_are_taken_and_what_is_no_correction_or_no_measure_is_refused(tmp_path):
    folder = make_experiment(tmp_path / "e", [Factor("Task", ["Video", "Network"])]).root
    assert [each.name for each in analyse(folder, measures="Energy").measures] == ["Energy"]
    # The text of a correction is another thing: p-values would be Holm's, and called others.
    with pytest.raises(AnalysisError, match="correction is 'benjamini-hochberg'"):
        analyse(folder, correction="benjamini-hochberg")
    with pytest.raises(AnalysisError, match="no measure 'Task'"):
        analyse(folder, measures=["Task"])


def test_factors_that_go_together_are_named_and_the_others_are_not(make_folder):
    # As of models that come in some sizes each, of which no two share one: what of the two makes a difference?
    cells = [
        (version, size, task) for version, size in (("1", "7"), ("2", "8"), ("3", "1"), ("3", "3")) for task in "xy"
    ]
    rows = [(*cell, 10.0 + NOISE[place]) for place, cell in enumerate(cells * 4)]
    factors = {"Version": ["1", "2", "3"], "Size": ["1", "3", "7", "8"], "Task": ["x", "y"]}
    found = analyse(load_results(make_folder(factors=factors, rows=rows, measures={"E": "J"}).root))
    (why,) = [each.why for each in found.measure("E").not_computed if each.what == "the test"]
    assert why.startswith("the factors Version and Size go together so closely that their effects cannot be told apart")
    assert why.endswith("take one of them, or both as one factor.")
