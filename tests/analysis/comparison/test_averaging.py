"""Several experiments are combined by what they have in common; what is no replication, or no number, is told."""

from __future__ import annotations

import copy
import itertools
import json
import math
import shutil

import numpy as np
import pytest
from scipy import stats
from tests.analysis.comparison.combined_agreement import disagreements_of_combined
from tests.long_cases import soak_but

from robot_runner.analysis import analyse, load_results
from robot_runner.analysis.comparison.averaging import hedges_g, meta_analyse
from robot_runner.analysis.comparison.combined_document import combined_document, json_of_meta_analysis
from robot_runner.analysis.figures.style import FigureFormat, figure_bytes
from robot_runner.analysis.wording import p_values_in_words
from robot_runner.core.errors import AnalysisError


@pytest.fixture
def lab(make_folder):
    """Make an experiment of one lab: means by treatment, a spread, runs a treatment."""
    numbers = itertools.count()

    def make(means, *, spread=1.0, runs=6, seed=None, measure="Energy", unit="J", factor="Task", scale=1.0, **more):
        number = next(numbers)
        random = np.random.default_rng(number if seed is None else seed)
        rows = [
            (name, scale * float(mean + spread * random.normal())) for name, mean in means.items() for _ in range(runs)
        ]
        settings = {"name": f"lab_{number}", "day": f"20{10 + number % 80}-01-31", **more}
        return make_folder(factors={factor: list(means)}, rows=rows, measures={measure: unit}, **settings).root

    return make


def facts_of(*folders, **settings):
    return json.loads(json_of_meta_analysis(meta_analyse(*folders, **settings)), parse_constant=pytest.fail)


TASKS = {"Video": 30.0, "Network": 20.0, "Idle": 20.0}


@pytest.mark.parametrize(("estimand", "told"), [("rank", ["ranks"]), ("trimmed mean", ["trimmed means"]), ("mean", [])])
def test_it_is_said_where_the_report_of_an_experiment_compares_no_means(lab, estimand, told):
    planned = lab(TASKS, manifest={"analysis": {"measures": ["Energy"], "estimand": estimand}})
    found = meta_analyse(planned, lab(TASKS)).findings
    problems = [each.problem for each in found if "means are combined" in each.problem]
    assert problems == [f"the plan of this experiment compares {what}, and means are combined" for what in told]


def test_values_that_were_changed_by_hand_are_told_of_each_experiment(lab):
    first, second = lab(TASKS), lab(TASKS)
    table = (second / "run_table.csv").read_text()
    (second / "run_table.csv").write_text(table.replace(table.splitlines()[1], "r_1,Done,Video,99.0"))
    (told,) = (each for each in meta_analyse(first, second).findings if "by hand" in each.problem)
    assert (told.where, "Energy of r_1 is '99.0'" in told.problem) == ("lab_1", True)


def test_without_a_standardised_difference_of_an_experiment_the_page_has_the_others(lab, make_folder):
    # Of two runs of each treatment, of which one does not vary, a single degree of freedom is left: g has no mean.
    rows = [("Video", 30.0), ("Video", 31.5), ("Network", 20.0), ("Network", 20.0)]
    factors = {"Task": ["Video", "Network"]}
    few = make_folder(factors=factors, rows=rows, measures={"Energy": "J"}, name="few", day="2009-01-31").root
    found = meta_analyse(few, lab({"Video": 30.0, "Network": 20.0}))
    assert found.measure("Energy").effects[0].standardised is None
    (averages,) = [each for each in combined_document(found, made="now").tables if each.name == "averages Energy"]
    row = dict(zip([column.name for column in averages.columns], averages.rows[0], strict=True))
    assert (row["Hedges' g"].value, row["Average"].value is None) == (None, False)


@pytest.mark.long
def test_the_differences_of_each_experiment_are_those_of_its_report(lab):
    folders = [lab(TASKS) for _ in range(3)]
    effects = meta_analyse(*folders).measure("Energy").effects
    assert [each.label for each in effects] == ["Video less Network", "Video less Idle", "Network less Idle"]
    for place, folder in enumerate(folders):
        pairs = analyse(load_results(folder)).measure("Energy").post_hoc[0].comparisons
        for effect, pair in zip(effects, pairs, strict=True):
            told = effect.experiments[place]
            assert (told.estimate, told.p_value) == pytest.approx((pair.difference, pair.p_value))
            assert (told.interval.low, told.interval.high) == pytest.approx((pair.interval.low, pair.interval.high))
            assert told.runs == 12
            d = next(each.value for each in pair.effect_sizes if each.name == "Cohen's d")
            assert abs(told.g) < abs(d) < abs(told.g) * 1.3


def test_an_average_over_labs_is_found_where_there_is_one(lab):
    found = meta_analyse(*(lab({"Video": 30 + shift, "Network": 20.0}) for shift in (-1, 0, 1, 0.5, -0.5)))
    (effect,) = found.measure("Energy").effects
    assert effect.is_significant
    assert effect.difference.random.interval.low < 10 < effect.difference.random.interval.high
    assert "higher than that of Network" in effect.conclusion
    assert effect.standardised.random.estimate > 3


def test_an_effect_that_one_lab_alone_has_is_not_one_of_all(lab):
    found = meta_analyse(*(lab({"Video": mean, "Network": 20.0}, spread=0.5) for mean in (30, 20, 20)))
    (effect,) = found.measure("Energy").effects
    assert not effect.is_significant
    assert effect.difference.common.p_value < 0.001
    assert effect.difference.heterogeneity.p_value < 0.001
    assert "If all experiments estimated one and the same effect" in effect.conclusion


def test_a_common_effect_among_several_is_said_to_be_significant_before_correction(lab):
    found = meta_analyse(*(lab({"Video": each, "Network": 20.0, "Idle": 20.0}, spread=0.5) for each in (30, 20, 20)))
    effect = next(each for each in found.measure("Energy").effects if set(each.weights) == {"Video", "Network"})
    assert effect.adjusted_p_value > effect.difference.random.p_value
    assert "which is significant before correction (p < 0.001)" in effect.conclusion


@pytest.mark.parametrize("count", [2, 3, 4, 5])
def test_it_is_said_what_so_few_experiments_cannot_tell(lab, count):
    (effect,) = meta_analyse(*(lab({"a": 2.0, "b": 1.0}) for _ in range(count))).measure("Energy").effects
    assert (effect.difference.prediction is None) is (count == 2)
    assert ("one degree of freedom" in effect.conclusion) is (count == 2)
    assert ("hardly tell" in effect.conclusion) is (count in {3, 4})


def test_units_are_converted(lab):
    means = {"a": 2000.0, "b": 1000.0}
    one, other = lab(means), lab(means, unit="kJ", scale=0.001, name="in_kilojoules")
    found = meta_analyse(one, other)
    (effect,) = found.measure("Energy").effects
    assert found.measure("Energy").unit == "J"
    assert [each.estimate for each in effect.experiments] == pytest.approx([1000, 1000], abs=4)
    (finding,) = found.findings
    assert (finding.where, finding.problem) == ("in_kilojoules", "Energy is in kJ: its values are converted to J")


def test_temperatures_of_two_scales_have_the_same_differences(lab):
    means = {"a": 20.0, "b": 10.0}
    found = meta_analyse(lab(means, unit="K"), lab(means, unit="degC"))
    assert [each.estimate for each in found.measure("Energy").effects[0].experiments] == pytest.approx([10, 10], abs=3)


def test_a_unit_that_is_not_known_is_told(lab):
    found = meta_analyse(lab(TASKS), lab(TASKS, unit=""))
    assert "its values are taken to be in J" in found.findings[0].problem


def test_everything_that_refuses_a_meta_analysis_is_told_at_once(lab, tmp_path):
    one, other = lab(TASKS, name="one"), lab(TASKS, name="volts", unit="V")
    copy_of_one = tmp_path / "copied"
    shutil.copytree(one, copy_of_one)
    with pytest.raises(AnalysisError) as caught:
        meta_analyse(one, other, copy_of_one, measures=["Energy", "Enrgy"], same=["Video=Vidoe", "Task", "Nope=Nope"])
    told = " ".join(map(str, caught.value.findings))
    assert "copied: this is" in told
    assert "executed at the same times" in told
    assert "cannot be converted to J" in told
    assert "no experiment has a measure 'Enrgy' → Did you mean 'Energy'?" in told
    assert "'Vidoe' → Did you mean 'Video'?" in told
    assert "'Task' names one name, not two" in told
    assert "no experiment has a factor or a treatment 'Nope'" in told


def test_an_experiment_is_no_replication_of_itself(lab):
    one = lab(TASKS)
    with pytest.raises(AnalysisError, match="the same folder") as caught:
        meta_analyse(one, lab(TASKS), one)
    assert "count twice" in caught.value.fix


def test_a_simulation_with_the_same_seed_is_no_replication(lab):
    with pytest.raises(AnalysisError, match="same to the last digit"):
        meta_analyse(lab(TASKS, seed=5), lab(TASKS, seed=5))


def test_counts_may_be_the_same_by_chance(make_folder):
    rows = [("a", 1.0), ("a", 2.0), ("b", 3.0), ("b", 5.0)]
    folders = [
        make_folder(factors={"T": ["a", "b"]}, rows=rows, measures={"Goals": ""}, day=f"2026-02-0{day}", name=f"n{day}")
        for day in (1, 2)
    ]
    (effect,) = meta_analyse(*(each.root for each in folders)).measure("Goals").effects
    assert effect.adjusted_p_value is None
    assert "there is no variation to test against" in effect.conclusion
    assert disagreements_of_combined(facts_of(*(each.root for each in folders))) == []


@pytest.mark.long
def test_names_that_differ_are_told_with_the_option_that_joins_them(lab):
    one = lab({"Video": 30.0, "Network": 20.0}, name="one")
    other = lab({"video": 30.0, "Network": 20.0}, name="other", factor="Tasks", measure="energy")
    third = lab({"Video": 30.0, "Network": 20.0}, name="third")
    told = " ".join(map(str, meta_analyse(one, other, third).findings))
    assert "--same Task=Tasks" in told
    assert "--measure Energy=energy" in told
    told = " ".join(map(str, meta_analyse(one, other, third, measures=["Energy=energy"], same=["Task=Tasks"]).findings))
    assert "--same Video=video" in told
    found = meta_analyse(one, other, third, measures=["Energy=energy"], same=["Task=Tasks", "Video=video"])
    assert not found.findings
    assert found.measure("Energy").names == {"one": "Energy", "other": "energy", "third": "Energy"}
    assert [each.experiment for each in found.measure("Energy").effects[0].experiments] == ["one", "other", "third"]


@pytest.mark.parametrize(
    ("same", "planned"),
    [
        (["Aufgabe=Task", "Job=Task"], "Task"),
        (["Task=Job", "Job=Aufgabe"], "Job"),
        (["Aufgabe=Job", "Task=Aufgabe", "Task=Job"], "Job"),
    ],
)
def test_three_names_of_one_factor_may_be_joined_in_any_order(lab, same, planned):
    """The contrast of a plan stays one of the factor that was renamed twice."""
    plan = {"analysis": json.loads(json.dumps(PLAN).replace("Task", planned))}
    labs = [lab(TASKS, factor=name, manifest=plan if name == planned else {}) for name in ("Task", "Aufgabe", "Job")]
    found = meta_analyse(*labs, same=same)
    assert not found.findings
    *pairs, contrast = found.measure("Energy").effects
    assert (len(pairs), contrast.statement) == (3, "Idle needs less than half of both.")
    assert len(contrast.experiments) == 3


def test_options_are_proposed_as_a_shell_takes_them(lab):
    one, other = lab({"wet tiles": 30, "wood": 20}), lab({"Wet tiles": 30, "wood": 20}, measure="Energy (J)")
    with pytest.raises(AnalysisError) as refused:
        meta_analyse(one, other, measures=["Energy"])
    assert "--measure 'Energy=Energy (J)'." in str(refused.value)
    told = " ".join(map(str, meta_analyse(one, other, measures=["Energy=Energy (J)"]).findings))
    assert "--same 'wet tiles=Wet tiles'." in told


def test_a_further_name_of_a_measure_that_no_experiment_has_is_told(lab):
    with pytest.raises(
        AnalysisError, match=r"no experiment has a measure 'Energy \(kJ\)'.*Did you mean 'Energie \(kJ\)'"
    ):
        meta_analyse(lab(TASKS), lab(TASKS, measure="Energie (kJ)"), measures=["Energy=Energy (kJ)"])


def test_why_measures_of_yes_and_no_are_not_combined_is_told(make_folder):
    rows = [(task, "True" if run % 3 else "False") for task in ("Video", "Network") for run in range(6)]
    made = {"factors": {"Task": ["Video", "Network"]}, "rows": rows, "measures": {"Success": ""}}
    folders = [
        make_folder(**made, types={"Success": "boolean"}, name=name, day=f"20{year}-01-31").root
        for name, year in (("one", 24), ("other", 25))
    ]
    found = meta_analyse(*folders, measures=["Success"]).measure("Success")
    assert found.not_computed[0].why == "proportions are not combined: compare two experiments at a time."


def test_numbers_that_are_written_otherwise_are_proposed_to_be_the_same(lab):
    found = meta_analyse(lab({"1": 30, "2": 20}), lab({"1.0": 30, "2.0": 20}))
    told = " ".join(each.fix for each in found.findings)
    assert "--same 1.0=1." in told
    assert "--same 2.0=2." in told


def test_names_that_one_experiment_tells_apart_are_not_joined(lab):
    with pytest.raises(AnalysisError, match="both 'Video' and 'Network'"):
        meta_analyse(lab(TASKS), lab(TASKS), same=["Video=Network"])


def test_an_effect_that_only_one_experiment_tells_of_is_named(lab):
    found = meta_analyse(lab(TASKS, name="one"), lab({"Video": 30.0, "Network": 20.0}, name="other"))
    energy = found.measure("Energy")
    assert [each.label for each in energy.effects] == ["Video less Network"]
    assert {each.what: each.why for each in energy.not_computed} == {
        "average of Video less Idle": "only one estimates it: two are needed.",
        "average of Network less Idle": "only one estimates it: two are needed.",
    }
    assert any(each.where == "other" and "'Idle'" in each.problem for each in found.findings)


def test_an_experiment_whose_values_do_not_vary_is_left_out_and_named(lab):
    found = meta_analyse(lab(TASKS), lab(TASKS), lab(TASKS, spread=0.0, name="constant")).measure("Energy")
    assert all(len(each.experiments) == 2 for each in found.effects)
    assert any(each.what == "Energy in constant" and "equal" in each.why for each in found.not_computed)


def test_runs_that_a_design_searched_among_are_not_combined(lab):
    search = {"design": {"source": "config", "factors": {"Task": list(TASKS)}, "facts": {"decides": "Optimise"}}}
    (energy,) = meta_analyse(lab(TASKS), lab(TASKS), lab(TASKS, manifest=search)).measures
    assert [each.experiment for each in energy.effects[0].experiments] == ["lab_0", "lab_1"]
    assert "the best of many" in energy.not_computed[0].why


def test_experiments_that_vary_nothing_in_common_say_so(lab):
    found = meta_analyse(lab(TASKS), lab({"slow": 1.0, "fast": 2.0}, factor="Speed")).measure("Energy")
    assert found.effects == ()
    assert "no two experiments vary the same factor" in found.not_computed[0].why


def test_factors_beside_it_are_averaged_over(make_folder):
    random = np.random.default_rng(11)
    rows = [
        (task, speed, 10.0 * (task == "b") + 3.0 * (speed == "fast") + random.normal())
        for task in "ab"
        for speed in ("slow", "fast")
        for _ in range(5)
    ]
    factors = {"Task": ["a", "b"], "Speed": ["slow", "fast"]}
    one = make_folder(factors=factors, rows=rows, measures={"E": "J"}, name="one").root
    plain = [(task, 10.0 * (task == "b") + random.normal()) for task in "ab" for _ in range(5)]
    other = make_folder(
        factors={"Task": ["a", "b"]}, rows=plain, measures={"E": "J"}, name="other", day="2026-03-01"
    ).root
    found = meta_analyse(one, other)
    assert [each.label for each in found.measure("E").effects] == ["a less b"]
    assert found.measure("E").effects[0].difference.random.estimate == pytest.approx(-10, abs=1.5)
    assert any(each.where == "other" and "no factor 'Speed'" in each.problem for each in found.findings)


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 8, 32])
def test_a_g_whose_parts_are_known_equally_well_up_to_the_last_digit_is_averaged(make_folder, seed):
    # Of two treatments beside another factor, error and standard deviation have the same degrees of freedom; the last
    # digit of these is chance.
    random = np.random.default_rng(seed)
    factors = {"Task": ["a", "b"], "Speed": ["slow", "fast"]}
    labs = []
    for day in ("2026-01-31", "2026-03-01"):
        cells = itertools.product("ab", factors["Speed"], range(5))
        rows = [(task, speed, 10.0 * (task == "b") + random.normal()) for task, speed, _ in cells]
        labs.append(make_folder(factors=factors, rows=rows, measures={"E": "J"}, name=f"lab_{len(labs)}", day=day).root)
    effects = meta_analyse(*labs).measure("E").effects
    assert [each.label for each in effects] == ["a less b", "slow less fast"]
    assert all(each.g_freedom > 1e12 for effect in effects for each in effect.experiments)
    assert all(math.isfinite(effect.standardised.random.estimate) for effect in effects)


PLAN = {
    "measures": ["Energy"],
    "hypotheses": [
        {
            "statement": "Idle needs less than half of both.",
            "measure": "Energy",
            "factors": ["Task"],
            "contrast": {"Idle": 2, "Video": -1, "Network": -1},
        },
        {"statement": "A pair.", "measure": "Energy", "factors": ["Task"], "contrast": {"Video": 1, "Network": -1}},
    ],
}


JOBS = json.loads(json.dumps(PLAN).replace("Task", "Job").replace('"Idle"', '"Nothing"'))


@pytest.mark.long
def test_contrasts_of_plans_are_combined_beside_the_pairs(lab):
    planned = lab(TASKS, manifest={"analysis": PLAN})
    found = meta_analyse(planned, lab(TASKS), lab(TASKS))
    assert found.measure("Energy").is_primary
    *_, contrast = found.measure("Energy").effects
    assert len(found.measure("Energy").effects) == 4
    assert contrast.label == "Idle needs less than half of both."
    assert contrast.difference.random.estimate == pytest.approx(-10, abs=2)
    assert "differs from zero on average" in contrast.conclusion
    other = lab({"Video": 30.0, "Network": 20.0, "Nothing": 20.0}, factor="Job")
    renamed = lab({"Video": 30.0, "Network": 20.0, "Nothing": 20.0}, factor="Job", manifest={"analysis": JOBS})
    *_, contrast = meta_analyse(renamed, other, same=["Task=Job", "Idle=Nothing"]).measure("Energy").effects
    assert (contrast.factor, contrast.weights) == ("Task", {"Idle": 2.0, "Video": -1.0, "Network": -1.0})


def test_a_sentence_tells_which_p_value_is_after_correction(lab):
    effects = meta_analyse(lab(TASKS), lab(TASKS), lab(TASKS)).measure("Energy").effects
    averages = {each.conclusion: each.difference.random for each in effects}
    corrected = [each for each in effects if each.adjusted_p_value != averages[each.conclusion].p_value]
    assert corrected
    for each in corrected:
        assert p_values_in_words(averages[each.conclusion].p_value, each.adjusted_p_value) in each.conclusion


@pytest.mark.long
def test_an_experiment_is_analysed_as_its_own_plan_has_it(make_folder):
    random = np.random.default_rng(6)

    def make(name, day, **plan):
        rows = []
        for task in "ab":
            for run in range(8):
                warmth = 20 + run
                value = 10.0 * (task == "b") + 0.7 * warmth + 0.3 * random.normal() + 40 * (run == 3 and task == "a")
                rows.append((task, float(value), float(warmth)))
        manifest = {"analysis": {"measures": ["Energy"], **plan}}
        measures = {"Energy": "J", "Warmth": "degC"}
        return make_folder(
            factors={"Task": ["a", "b"]}, rows=rows, measures=measures, name=name, day=day, manifest=manifest
        ).root

    one = make("one", "2026-06-01", covariates=["Warmth"], outliers={"median_deviations": 4.0})
    other = make("other", "2026-06-02")
    found = meta_analyse(one, other)
    told = found.measure("Energy").effects[0].experiments
    for each, folder in zip(told, (one, other), strict=True):
        pair = analyse(load_results(folder)).measure("Energy").post_hoc[0].comparisons[0]
        assert (each.estimate, each.p_value) == pytest.approx((pair.difference, pair.p_value))
    assert told[0].estimate == pytest.approx(-10, abs=1)
    assert told[1].estimate > told[0].estimate + 3
    assert [str(each) for each in found.findings] == ["one: the plan of this experiment leaves out Energy of r_4"]


def test_without_a_choice_primary_measures_are_combined(make_folder):
    random = np.random.default_rng(2)

    def make(**settings):
        rows = [(task, random.normal(), random.normal()) for task in "ab" for _ in range(4)]
        return make_folder(
            factors={"Task": ["a", "b"]}, rows=rows, measures={"Energy": "J", "CPU": "%"}, **settings
        ).root

    plan = {"analysis": {"measures": ["Energy"]}}
    folders = [make(day=f"2026-04-0{day}", name=f"p{day}", manifest=plan if day == 1 else {}) for day in (1, 2)]
    assert [each.name for each in meta_analyse(*folders).measures] == ["Energy"]
    both = meta_analyse(*folders, measures=["CPU", "Energy"])
    assert [(each.name, each.is_primary) for each in both.measures] == [("CPU", False), ("Energy", True)]
    assert "percentage points" in both.measure("CPU").effects[0].conclusion


def test_what_cannot_be_is_refused(lab):
    with pytest.raises(AnalysisError, match="1 experiment is given"):
        meta_analyse(lab(TASKS))
    with pytest.raises(AnalysisError, match="alpha"):
        meta_analyse(lab(TASKS), lab(TASKS), alpha=1.0)


def test_a_confidence_that_is_given_for_alpha_is_refused(lab):
    with pytest.raises(AnalysisError, match=r"alpha is 0.95 .*Give a number between 0 and 0.5"):
        meta_analyse(lab(TASKS), lab(TASKS), alpha=0.95)


def test_text_is_not_combined(make_folder):
    folders = [
        make_folder(
            factors={"T": ["a", "b"]},
            rows=[("a", "ok"), ("b", "stuck")],
            measures={"State": ""},
            types={"State": "string"},
            day=f"2026-05-0{day}",
            name=f"t{day}",
        ).root
        for day in (1, 2)
    ]
    with pytest.raises(AnalysisError, match="no measure of one name"):
        meta_analyse(*folders)
    found = meta_analyse(*folders, measures=["State"]).measure("State")
    assert "the values are not numbers" in found.not_computed[0].why


def test_hedges_g_is_that_of_metafor():
    # escalc(measure="SMD", vtype="UB") of means 10 and 7, sd 2, eight runs; of 5 and 5.5, sd 1, twelve runs.
    one = hedges_g(3.0, math.sqrt(4 / 8 + 4 / 8), 14, 2.0)
    other = hedges_g(-0.5, math.sqrt(1 / 12 + 1 / 12), 22, 1.0)
    assert (one[0], other[0]) == pytest.approx((1.417931593960, -0.482725329395))
    assert (one[1] ** 2, other[1] ** 2) == pytest.approx((0.331958576579, 0.172417683034))
    assert hedges_g(1.0, 1.0, 1.0, 1.0) == (None, None)


def test_the_standard_error_of_g_is_that_of_its_distribution():
    random, count, effect = np.random.default_rng(3), 8, 1.2
    one, other = random.normal(effect, 1, (4000, count)), random.normal(0, 1, (4000, count))
    spreads = np.sqrt((np.var(one, axis=1, ddof=1) + np.var(other, axis=1, ddof=1)) / 2)
    differences = one.mean(axis=1) - other.mean(axis=1)
    found = np.array(
        [
            hedges_g(difference, spread * math.sqrt(2 / count), 2 * count - 2, spread)
            for difference, spread in zip(differences, spreads, strict=True)
        ]
    )
    assert found[:, 0].mean() == pytest.approx(effect, abs=0.03)
    assert np.mean(found[:, 1] ** 2) == pytest.approx(found[:, 0].var(), rel=0.06)


def test_the_average_of_large_effects_in_few_runs_is_not_drawn_towards_none(lab):
    # By its own variance, a g that is larger by chance counts less: the average of ten of 3 was 2.6 by simulation.
    folders = [lab({"Video": 23.0, "Network": 20.0}, runs=5, seed=seed) for seed in range(8)]
    (effect,) = meta_analyse(*folders).measure("Energy").effects
    plain = np.mean([each.g for each in effect.experiments])
    assert effect.standardised.random.estimate == pytest.approx(plain, rel=0.02)
    assert effect.standardised.common.estimate == pytest.approx(plain, rel=0.02)


@pytest.mark.parametrize("covariates", soak_but([[]], [[], ["Warmth"]]))
def test_hedges_g_of_few_blocks_of_many_runs_is_hardly_less_than_the_d_of_the_report(make_folder, covariates):
    # Three days tell their own variance with two degrees of freedom, and the standard deviation of a run with hundreds.
    random = np.random.default_rng(8)
    plan = {"measures": ["Energy"], "blocks": "Day", "covariates": covariates}

    def make(name, day):
        rows = [
            (each, task, float(2.0 * (task == "b") + random.normal()), float(random.normal()))
            for each in ("Mon", "Tue", "Wed")
            for task in "ab"
            for _ in range(40)
        ]
        factors = {"Day": ["Mon", "Tue", "Wed"], "Task": ["a", "b"]}
        settings = {"name": name, "day": day, "manifest": {"analysis": plan}}
        return make_folder(factors=factors, rows=rows, measures={"Energy": "J", "Warmth": "degC"}, **settings).root

    folders = [make("one", "2026-06-01"), make("other", "2026-06-02")]
    (effect,) = meta_analyse(*folders, measures=["Energy"]).measure("Energy").effects
    for told, folder in zip(effect.experiments, folders, strict=True):
        pair = analyse(load_results(folder)).measure("Energy").post_hoc[0].comparisons[0]
        d = next(each.value for each in pair.effect_sizes if each.name == "Cohen's d")
        assert told.freedom == pytest.approx(2.0, abs=0.2)
        assert told.g == pytest.approx(d, rel=0.02)
        assert told.g == pytest.approx(-2.0, abs=0.3)
    # The standard deviation is known here, and the error is not: by simulation a normal interval held in 82 %.
    assert effect.standardised.common.freedom == pytest.approx(effect.difference.common.freedom, rel=0.15)


@pytest.mark.long
@pytest.mark.parametrize(
    "drawn", soak_but([(2, 0.0), (3, 0.5), (6, 4.0)], itertools.product([2, 3, 6], [0.0, 0.5, 4.0]))
)
def test_a_meta_analysis_agrees_with_itself(lab, drawn):
    count, between = drawn
    random = np.random.default_rng(int(10 * between) + count)
    labs = [
        load_results(
            lab(
                {name: mean + between * random.normal() for name, mean in TASKS.items()},
                spread=1 + place % 2,
                runs=4 + place,
            )
        )
        for place in range(count)
    ]
    assert disagreements_of_combined(facts_of(*labs)) == []
    assert disagreements_of_combined(facts_of(*labs, alpha=0.3)) == []


def test_what_contradicts_itself_is_found(lab):
    folders = [lab({"Video": 30.0 + shift, "Network": 20.0}) for shift in (-1, 0, 1)]
    facts = facts_of(*folders)
    assert disagreements_of_combined(facts) == []

    def spoiled(change):
        other = copy.deepcopy(facts)
        change(other["measures"][0]["effects"][0])
        return disagreements_of_combined(other)

    changes = [
        lambda effect: effect.update(conclusion="The 3 experiments do not show that Energy differs."),
        lambda effect: effect.update(conclusion=effect["conclusion"].replace("higher", "lower")),
        lambda effect: effect.update(conclusion=effect["conclusion"].replace("Three experiments", "Many")),
        lambda effect: effect.update(conclusion=effect["conclusion"].replace("I² = ", "I² = 1")),
        lambda effect: effect.update(is_significant=False),
        lambda effect: effect.update(adjusted_p_value=0.9),
        lambda effect: effect["difference"]["random"].update(p_value=0.9),
        lambda effect: effect["difference"]["common"]["interval"].update(low=-9.0, high=99.0),
        lambda effect: effect["difference"]["random"].update(estimate=99.0),
        lambda effect: effect["difference"].update(prediction=None),
        lambda effect: effect["difference"]["heterogeneity"].update(
            p_value=0.9 if effect["difference"]["heterogeneity"]["p_value"] < 0.05 else 1e-9
        ),
        lambda effect: effect["difference"]["heterogeneity"].update(i_squared=77.7),
        lambda effect: effect["difference"].update(random_weights=[0.5, 0.5, 0.5]),
        lambda effect: effect["experiments"][0].update(g=-1.0),
        lambda effect: effect["experiments"].pop(),
    ]
    for place, change in enumerate(changes):
        assert spoiled(change), place


@pytest.mark.long
def test_the_page_shows_a_forest_plot_for_each_effect(lab):
    found = meta_analyse(*(lab(TASKS) for _ in range(3)))
    document = combined_document(found, made="today")
    assert [each.name for each in document.figures] == [
        f"forest Energy {name}" for name in ("Video less Network", "Video less Idle", "Network less Idle")
    ]
    figure = document.figures[0].draw()
    labels = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    names = [each.name for each in found.experiments]
    assert labels == [*names, "Average (random effects)", "Common effect", "A further experiment"]
    for kind, begins in ((FigureFormat.SVG, b"<?xml"), (FigureFormat.PNG, b"\x89PNG"), (FigureFormat.PDF, b"%PDF")):
        assert figure_bytes(figure, kind).startswith(begins)


def test_experiments_of_different_lengths_are_weighted_by_what_they_know(lab):
    (effect,) = meta_analyse(lab({"a": 2, "b": 1}, runs=4), lab({"a": 2, "b": 1}, runs=60)).measure("Energy").effects
    assert effect.difference.common_weights[1] > 0.8
    errors = [each.error for each in effect.experiments]
    assert effect.difference.common_weights[1] == pytest.approx(errors[0] ** 2 / (errors[0] ** 2 + errors[1] ** 2))
    assert effect.difference.heterogeneity.q == pytest.approx(
        (effect.experiments[0].estimate - effect.experiments[1].estimate) ** 2 / (errors[0] ** 2 + errors[1] ** 2)
    )
    assert stats.chi2.sf(effect.difference.heterogeneity.q, 1) <= effect.difference.heterogeneity.p_value + 1e-12


def test_contrasts_of_two_factors_whose_treatments_have_the_same_names_are_both_combined(make_folder):
    weights = {"low": -1, "middle": 0.5, "high": 0.5}
    plan = {
        "measures": ["Energy"],
        "hypotheses": [
            {"statement": f"{name} matters.", "measure": "Energy", "factors": [name], "contrast": weights}
            for name in ("Speed", "Load")
        ],
    }
    folders = []
    for place in (1, 2):
        random = np.random.default_rng(place)
        rows = [
            (speed, load, float(random.normal()))
            for speed, load in itertools.product(weights, weights)
            for _ in range(2)
        ]
        factors = {"Speed": list(weights), "Load": list(weights)}
        settings = {"name": f"lab_{place}", "day": f"201{place}-01-31", "manifest": {"analysis": plan}}
        folders.append(make_folder(factors=factors, rows=rows, measures={"Energy": "J"}, **settings).root)
    labels = [each.label for each in meta_analyse(*folders).measure("Energy").effects]
    assert set(labels[-2:]) == {"Speed matters.", "Load matters."}
