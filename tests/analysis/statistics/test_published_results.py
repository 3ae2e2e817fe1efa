"""What R, its packages' documentation and textbooks print for these data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.analysis.statistics import reference_data as data

from robot_runner.analysis.statistics.choice import Choice, choose_test, equal_variances, normality
from robot_runner.analysis.statistics.correlations import correlations_of
from robot_runner.analysis.statistics.effect_sizes import cliffs_delta, cohens_d, paired_d, vargha_delaney
from robot_runner.analysis.statistics.linear_model import aligned, fit_aligned, fit_linear, terms_of
from robot_runner.analysis.statistics.post_hoc import adjusted, compare_pairs
from robot_runner.analysis.statistics.power import _power, repetitions_needed
from robot_runner.analysis.statistics.tested import Magnitude, TestMethod
from robot_runner.analysis.statistics.tests import carry_out, mixed_model
from robot_runner.core.design.analysis_plan import Correction


def forced(measure, method):
    """The result of one test, whichever would be chosen."""
    choice = Choice(method, "", (), fit_linear(measure, terms_of(measure)))
    return carry_out(measure, choice, 0.05), choice


def pairs(measure, method, correction=Correction.HOLM):
    test, choice = forced(measure, method)
    return compare_pairs(measure, choice, test, 0.05, correction)[0][0].comparisons


def test_welch_t_of_sleep():
    # t.test(extra ~ group, data = sleep)
    (effect,) = forced(data.one_factor(data.SLEEP), TestMethod.WELCH_T)[0].effects
    assert effect.statistic == pytest.approx(-1.8608, abs=5e-5)
    assert effect.degrees_of_freedom[0] == pytest.approx(17.776, abs=5e-4)
    assert effect.p_value == pytest.approx(0.07939, abs=5e-6)
    (pair,) = pairs(data.one_factor(data.SLEEP), TestMethod.WELCH_T)
    assert (pair.interval.low, pair.interval.high) == pytest.approx((-3.3654832, 0.2054832), abs=5e-8)


def test_paired_t_of_sleep():
    # t.test(Pair(extra.1, extra.2) ~ 1)
    measure = data.one_factor(data.SLEEP, in_blocks=True)
    test, _ = forced(measure, TestMethod.PAIRED_T)
    (effect,) = test.effects
    assert effect.statistic == pytest.approx(-4.0621, abs=5e-5)
    assert effect.degrees_of_freedom == (9.0,)
    assert effect.p_value == pytest.approx(0.002833, abs=5e-7)
    (pair,) = pairs(measure, TestMethod.PAIRED_T)
    assert pair.difference == pytest.approx(-1.58)
    assert (pair.interval.low, pair.interval.high) == pytest.approx((-2.4598858, -0.7001142), abs=5e-8)


def test_cohens_d_of_paired_sleep():
    # effectsize: repeated_measures_d / cohens_d(paired = TRUE) of sleep: -1.28 [-2.12, -0.41]
    effect = paired_d(np.array(data.SLEEP["1"]) - np.array(data.SLEEP["2"]))
    assert effect.value == pytest.approx(-1.28, abs=0.005)
    assert (effect.interval.low, effect.interval.high) == pytest.approx((-2.12, -0.41), abs=0.005)


def test_t_tests_of_mtcars():
    # t.test(mpg ~ am, data = mtcars), and with var.equal = TRUE
    (welch,) = forced(data.one_factor(data.MILES_PER_GALLON), TestMethod.WELCH_T)[0].effects
    assert welch.statistic == pytest.approx(-3.7671, abs=5e-5)
    assert welch.p_value == pytest.approx(0.001374, abs=5e-7)
    (student,) = forced(data.one_factor(data.MILES_PER_GALLON), TestMethod.STUDENT_T)[0].effects
    assert student.statistic == pytest.approx(-4.1061, abs=5e-5)
    assert student.p_value == pytest.approx(0.000285, abs=5e-7)


def test_cohens_d_of_mtcars():
    # effectsize: cohens_d(mpg ~ am, data = mtcars): -1.48 [-2.27, -0.67]
    automatic, manual = (np.array(values) for values in data.MILES_PER_GALLON.values())
    effect = cohens_d(automatic, manual)
    assert effect.value == pytest.approx(-1.48, abs=0.005)
    assert (effect.interval.low, effect.interval.high) == pytest.approx((-2.27, -0.67), abs=0.005)
    assert effect.magnitude is Magnitude.LARGE


def test_wilcoxon_rank_sum_of_mtcars():
    # wilcox.test(mpg ~ am, data = mtcars): W = 42, p-value = 0.001871
    (effect,) = forced(data.one_factor(data.MILES_PER_GALLON), TestMethod.MANN_WHITNEY)[0].effects
    assert effect.statistic == 42
    assert effect.p_value == pytest.approx(0.001871, abs=5e-7)


def test_cliffs_delta_of_the_package_effsize():
    # effsize: cliff.delta(treatment, control): -0.25 (small), [-0.7265846, 0.3890062]
    treatment = np.array([10, 10, 20, 20, 20, 30, 30, 30, 40, 50], dtype=float)
    control = np.array([10, 20, 30, 40, 40, 50], dtype=float)
    effect = cliffs_delta(treatment, control)
    assert effect.value == -0.25
    assert (effect.interval.low, effect.interval.high) == pytest.approx((-0.7265846, 0.3890062), abs=5e-8)
    assert effect.magnitude is Magnitude.SMALL
    assert vargha_delaney(treatment, control).value == 0.375


def test_anova_of_plant_growth():
    # summary(aov(weight ~ group, data = PlantGrowth)): F = 4.846, p = 0.0159
    (effect,) = forced(data.one_factor(data.PLANT_GROWTH), TestMethod.ANOVA)[0].effects
    assert effect.statistic == pytest.approx(4.846, abs=5e-4)
    assert effect.degrees_of_freedom == (2.0, 27.0)
    assert effect.p_value == pytest.approx(0.01591, abs=5e-6)
    assert effect.effect_sizes[0].value == pytest.approx(0.2641, abs=5e-5)


def test_intervals_of_plant_growth():
    # confint(lm(weight ~ group, PlantGrowth)): grouptrt1 -0.9430126 to 0.2010126, grouptrt2 -0.0780126 to 1.0660126
    found = {(pair.first, pair.second): pair for pair in pairs(data.one_factor(data.PLANT_GROWTH), TestMethod.ANOVA)}
    ends = {names: (pair.interval.low, pair.interval.high) for names, pair in found.items()}
    assert ends["ctrl", "trt1"] == pytest.approx((-0.2010126, 0.9430126), abs=5e-8)
    assert ends["ctrl", "trt2"] == pytest.approx((-1.0660126, 0.0780126), abs=5e-8)


def test_assumptions_of_plant_growth():
    # shapiro.test(residuals(aov(...))): W = 0.96607, p = 0.4379; car::leveneTest: F = 1.1192, p = 0.3412
    measure = data.one_factor(data.PLANT_GROWTH)
    shapiro = normality(measure.residuals(), 0.05)
    assert shapiro.statistic == pytest.approx(0.96607, abs=5e-6)
    assert shapiro.p_value == pytest.approx(0.4379, abs=5e-5)
    levene = equal_variances(measure.groups(["A"]), 0.05)
    assert levene.statistic == pytest.approx(1.1192, abs=5e-5)
    assert levene.p_value == pytest.approx(0.3412, abs=5e-5)


def test_plant_growth_is_analysed_as_in_textbooks():
    assert choose_test(data.one_factor(data.PLANT_GROWTH), 0.05).method is TestMethod.ANOVA


def test_welch_anova_of_plant_growth():
    # oneway.test(weight ~ group, data = PlantGrowth): F = 5.181, denom df = 17.128, p-value = 0.01739
    (effect,) = forced(data.one_factor(data.PLANT_GROWTH), TestMethod.WELCH_ANOVA)[0].effects
    assert effect.statistic == pytest.approx(5.181, abs=5e-4)
    assert effect.degrees_of_freedom[1] == pytest.approx(17.128, abs=5e-4)
    assert effect.p_value == pytest.approx(0.01739, abs=5e-6)


def test_pairwise_t_tests_of_plant_growth():
    # pairwise.t.test(weight, group, p.adjust.method = "BH"): 0.194, 0.132, 0.013
    compared = pairs(data.one_factor(data.PLANT_GROWTH), TestMethod.ANOVA, Correction.BENJAMINI_HOCHBERG)
    assert [(pair.first, pair.second) for pair in compared] == [("ctrl", "trt1"), ("ctrl", "trt2"), ("trt1", "trt2")]
    assert [round(pair.adjusted_p_value, 3) for pair in compared] == [0.194, 0.132, 0.013]


def test_pairwise_t_tests_of_airquality():
    # pairwise.t.test(Ozone, Month), adjusted by Holm, from the examples of R
    compared = pairs(data.one_factor(data.AIR_QUALITY), TestMethod.ANOVA)
    found = {(pair.first, pair.second): pair.adjusted_p_value for pair in compared}
    published = {
        ("May", "Jul"): 0.00026,
        ("Jun", "Jul"): 0.05113,
        ("May", "Aug"): 0.00019,
        ("Jun", "Aug"): 0.04987,
        ("Jul", "Sep"): 0.00488,
        ("Aug", "Sep"): 0.00388,
        ("May", "Jun"): 1.0,
        ("Jul", "Aug"): 1.0,
        ("May", "Sep"): 1.0,
        ("Jun", "Sep"): 1.0,
    }
    assert {pair: round(p_value, 5) for pair, p_value in found.items()} == published


def test_kruskal_wallis_of_airquality():
    # kruskal.test(Ozone ~ Month, data = airquality): 29.267, df = 4, p-value = 6.901e-06
    (effect,) = forced(data.one_factor(data.AIR_QUALITY), TestMethod.KRUSKAL_WALLIS)[0].effects
    assert effect.statistic == pytest.approx(29.267, abs=5e-4)
    assert effect.degrees_of_freedom == (4.0,)
    assert effect.p_value == pytest.approx(6.901e-06, abs=5e-10)


def test_insect_sprays():
    # kruskal.test: 54.691, df = 5, p-value = 1.511e-10; summary(aov): F = 34.7; oneway.test: F = 36.065, 30.043, 8e-12
    measure = data.one_factor(data.INSECT_SPRAYS)
    (ranks,) = forced(measure, TestMethod.KRUSKAL_WALLIS)[0].effects
    assert (ranks.statistic, ranks.p_value) == (pytest.approx(54.691, abs=5e-4), pytest.approx(1.511e-10, rel=5e-4))
    (means,) = forced(measure, TestMethod.ANOVA)[0].effects
    assert means.statistic == pytest.approx(34.7, abs=0.05)
    (welch,) = forced(measure, TestMethod.WELCH_ANOVA)[0].effects
    assert welch.statistic == pytest.approx(36.065, abs=5e-4)
    assert welch.degrees_of_freedom[1] == pytest.approx(30.043, abs=5e-4)


def test_anova_of_unequal_groups():
    # anova(lm(weight ~ feed, data = chickwts)): F = 15.365 on 5 and 65, p = 5.936e-10
    (effect,) = forced(data.one_factor(data.CHICK_WEIGHTS), TestMethod.ANOVA)[0].effects
    assert effect.statistic == pytest.approx(15.365, abs=5e-4)
    assert effect.degrees_of_freedom == (5.0, 65.0)
    assert effect.p_value == pytest.approx(5.936e-10, abs=5e-14)


def test_dunns_test_of_tooth_growth():
    # rstatix: ToothGrowth %>% dunn_test(len ~ dose): z = 3.55, 6.36, 2.81
    by_dose: dict[str, list[float]] = {}
    for (_, dose), values in data.TOOTH_GROWTH.items():
        by_dose.setdefault(dose, []).extend(values)
    compared = pairs(data.one_factor(by_dose), TestMethod.KRUSKAL_WALLIS)
    assert [round(abs(pair.statistic), 2) for pair in compared] == [3.55, 6.36, 2.81]
    assert all(pair.difference < 0 and pair.statistic < 0 for pair in compared)


def test_two_way_anova_of_tooth_growth():
    # summary(aov(len ~ supp * factor(dose), data = ToothGrowth))
    supplement, dose, interaction = forced(data.two_factors(data.TOOTH_GROWTH), TestMethod.FACTORIAL_ANOVA)[0].effects
    assert supplement.statistic == pytest.approx(15.572, abs=5e-4)
    assert supplement.p_value == pytest.approx(0.000231, abs=5e-7)
    assert dose.statistic == pytest.approx(92.000, abs=5e-4)
    assert interaction.statistic == pytest.approx(4.107, abs=5e-4)
    assert interaction.p_value == pytest.approx(0.02186, abs=5e-6)
    assert interaction.degrees_of_freedom == (2.0, 54.0)


def test_two_way_anova_of_warp_breaks():
    # anova(lm(breaks ~ wool * tension, data = warpbreaks))
    wool, tension, interaction = forced(data.two_factors(data.WARP_BREAKS), TestMethod.FACTORIAL_ANOVA)[0].effects
    assert (wool.statistic, wool.p_value) == pytest.approx((3.7653, 0.0582130), abs=5e-5)
    assert (tension.statistic, tension.p_value) == pytest.approx((8.4980, 0.0006926), abs=5e-5)
    assert (interaction.statistic, interaction.p_value) == pytest.approx((4.1891, 0.0210442), abs=5e-5)


def test_aligned_rank_transform_of_artool():
    # ARTool, tests of anova.art: Row, Column and their interaction of Higgins1990Table1
    effects = forced(data.two_factors(data.HIGGINS_TABLE_1), TestMethod.ALIGNED_RANKS)[0].effects
    assert [round(effect.statistic, 4) for effect in effects] == [29.9925, 77.8668, 0.6417]
    assert round(effects[2].p_value, 4) == 0.6374


def test_aligned_rank_transform_within_blocks():
    # The same of Higgins1990Table5: Fertilizer and its interaction with Moisture, both within trays
    measure = data.split_plot(data.HIGGINS_TABLE_5)
    terms = terms_of(measure)
    fertilizer = fit_aligned(measure, terms, ("B",)).tests["B",]
    interaction = fit_aligned(measure, terms, ("A", "B")).tests["A", "B"]
    assert (round(fertilizer.f_value, 4), fertilizer.freedom) == (122.4017, (3.0, 24.0))
    assert (round(interaction.f_value, 4), interaction.freedom) == (5.1180, (9.0, 24.0))


def test_aligning_leaves_nothing_of_the_other_effects():
    # Wobbrock et al. 2011: F values of the effects that were stripped are 0
    measure = data.two_factors(data.WARP_BREAKS)
    for effect in terms_of(measure).effects:
        tests = fit_linear(measure, terms_of(measure), aligned(measure, effect)).tests
        assert all(test.f_value < 1e-20 for others, test in tests.items() if others != effect)


def test_friedman_of_rounding_times():
    # friedman.test(RoundingTimes): 11.143, df = 2, p-value = 0.003805
    measure = data.one_factor(data.ROUNDING_TIMES, in_blocks=True)
    (effect,) = forced(measure, TestMethod.FRIEDMAN)[0].effects
    assert effect.statistic == pytest.approx(11.143, abs=5e-4)
    assert effect.p_value == pytest.approx(0.003805, abs=5e-7)
    assert effect.effect_sizes[0].value == pytest.approx(11.143 / 44, abs=1e-4)


def test_anova_with_blocks_of_ergo_stool():
    # nlme: anova(lme(effort ~ Type, random = ~ 1 | Subject)): F = 22.3556 on 3 and 24
    (effect,) = forced(data.one_factor(data.ERGO_STOOL, in_blocks=True), TestMethod.BLOCKED_ANOVA)[0].effects
    assert effect.statistic == pytest.approx(22.3556, abs=5e-5)
    assert effect.degrees_of_freedom == (3.0, 24.0)


def test_mixed_model_of_ergo_stool():
    # nlme: lme(effort ~ Type, random = ~ 1 | Subject): standard deviations 1.332465 (subjects) and 1.100295 (residual);
    # its anova: F = 22.3556 on 3 and 24, p < .0001; its summary: standard error 0.5186838 of each difference
    measure = data.one_factor(data.ERGO_STOOL, in_blocks=True)
    test, choice = forced(measure, TestMethod.MIXED_MODEL)
    fitted = mixed_model(measure, choice)
    assert np.sqrt(fitted.scale) == pytest.approx(1.100295, abs=5e-6)
    assert np.sqrt(float(fitted.cov_re.iloc[0, 0])) == pytest.approx(1.332465, abs=5e-5)
    assert test.effects[0].statistic == pytest.approx(22.3556, abs=5e-4)
    assert test.effects[0].degrees_of_freedom == (3.0, 24.0)
    compared = {(pair.first, pair.second): pair for pair in pairs(measure, TestMethod.MIXED_MODEL)}
    first = [compared["T1", other] for other in ("T2", "T3", "T4")]
    assert [pair.difference for pair in first] == pytest.approx([-3.888889, -2.222222, -0.666667])
    assert [pair.statistic for pair in first] == pytest.approx([-7.49761, -4.28435, -1.28530], abs=5e-4)
    assert [pair.p_value for pair in first[1:]] == pytest.approx([0.0003, 0.2110], abs=5e-5)
    # qt(0.975, 24) * 0.5186838 = 1.070511 on either side
    assert (first[0].interval.low, first[0].interval.high) == pytest.approx((-4.959399, -2.818378), abs=5e-6)


def test_mixed_model_of_two_treatments_is_the_paired_t_test():
    # nlme: anova(lme(extra ~ group, random = ~ 1 | ID, data = sleep)); t of the paired test is -4.0621, p = 0.002833
    (effect,) = forced(data.one_factor(data.SLEEP, in_blocks=True), TestMethod.MIXED_MODEL)[0].effects
    assert effect.statistic == pytest.approx(4.0621**2, rel=5e-5)
    assert effect.degrees_of_freedom == (1.0, 9.0)
    assert effect.p_value == pytest.approx(0.002833, abs=5e-6)


def test_mixed_model_of_a_factor_that_blocks_do_not_vary():
    # ARTool: anova(art(DryMatter ~ Moisture*Fertilizer + (1|Tray), data = Higgins1990Table5)), by Kenward and Roger:
    # 23.833 on 3 and 8, p = 0.00024199; 122.402 on 3 and 24, 1.1124e-14; 5.118 on 9 and 24, 0.00064665
    effects = forced(data.split_plot(data.HIGGINS_TABLE_5), TestMethod.MIXED_ALIGNED_RANKS)[0].effects
    assert [effect.degrees_of_freedom for effect in effects] == [(3.0, 8.0), (3.0, 24.0), (9.0, 24.0)]
    assert [effect.statistic for effect in effects] == pytest.approx([23.833, 122.402, 5.118], abs=1e-3)
    assert [effect.p_value for effect in effects] == pytest.approx([0.00024199, 1.1124e-14, 0.00064665], rel=1e-3)


def test_an_interaction_that_only_blocks_tell():
    # summary(aov(yield ~ N*P*K + Error(block), npk)): N:P:K 0.483 on 1 and 4, p = 0.525; N 12.259, P 0.544, K 6.166,
    # N:P 1.378, N:K 2.146, P:K 0.031 on 1 and 12, p = 0.00437, 0.47490, 0.02880, 0.26317, 0.16865, 0.86275
    effects = {each.label: each for each in forced(data.npk(), TestMethod.MIXED_MODEL)[0].effects}
    found = {label: (round(each.statistic, 3), each.degrees_of_freedom[1]) for label, each in effects.items()}
    assert found == {
        "N": (12.259, 12),
        "P": (0.544, 12),
        "K": (6.166, 12),
        "N x P": (1.378, 12),
        "N x K": (2.146, 12),
        "P x K": (0.031, 12),
        "N x P x K": (0.483, 4),
    }
    assert effects["N"].p_value == pytest.approx(0.00437, abs=5e-6)
    assert effects["K"].p_value == pytest.approx(0.02880, abs=5e-6)
    assert effects["N x P x K"].p_value == pytest.approx(0.525, abs=5e-4)


def test_a_covariance_that_holds_where_variances_differ():
    # The last effect of all is tested by Wald's F with HC3 = (X'X)^-1 X' diag(e^2 / (1 - h)^2) X (X'X)^-1
    measure = data.two_factors(data.WARP_BREAKS)
    effect = forced(measure, TestMethod.ROBUST_ANOVA)[0].effects[-1]
    wool = np.where(measure.frame["A"] == "A", 1.0, -1.0)
    tension = np.column_stack([(measure.frame["B"] == each) - 1.0 * (measure.frame["B"] == "H") for each in "LM"])
    design = np.column_stack([np.ones(len(wool)), wool, tension, tension * wool[:, None]])
    inverse = np.linalg.inv(design.T @ design)
    beta = inverse @ design.T @ measure.values
    leverage = np.einsum("ij,jk,ik->i", design, inverse, design)
    weights = ((measure.values - design @ beta) / (1 - leverage)) ** 2
    covariance = inverse @ (design.T * weights) @ design @ inverse
    expected = beta[4:] @ np.linalg.inv(covariance[4:, 4:]) @ beta[4:] / 2
    assert effect.statistic == pytest.approx(expected)
    assert effect.degrees_of_freedom == (2.0, 48.0)


def test_wilcoxon_signed_rank_of_hollander_and_wolfe():
    # wilcox.test(x, y, paired = TRUE, alternative = "greater"): V = 40, p-value = 0.01953
    (effect,) = forced(data.one_factor(data.DEPRESSION, in_blocks=True), TestMethod.WILCOXON)[0].effects
    assert effect.statistic == 45 - 40  # the smaller sum of ranks
    assert effect.p_value == pytest.approx(2 * 0.01953, abs=1e-5)
    assert effect.effect_sizes[0].value == pytest.approx((40 - 5) / 45)


def test_wilcoxon_rank_sum_of_hollander_and_wolfe():
    # wilcox.test(x, y, alternative = "g"): W = 35, p-value = 0.1272
    (effect,) = forced(data.one_factor(data.PERMEABILITY), TestMethod.MANN_WHITNEY)[0].effects
    assert effect.statistic == 35
    assert effect.p_value == pytest.approx(2 * 0.1272, abs=1e-4)


def test_correlation_of_hollander_and_wolfe():
    # cor.test(x, y): 0.5711816, interval -0.1497426 to 0.8955795; method = "spearman": rho = 0.6
    colour, quality = (data.one_factor({"tuna": values}) for values in data.TUNA.values())
    quality = replace(quality, name="quality")
    ((found,), _) = correlations_of([colour, quality], Correction.HOLM)
    assert found.pearson == pytest.approx(0.5711816, abs=5e-8)
    ends = (found.pearson_interval.low, found.pearson_interval.high)
    assert ends == pytest.approx((-0.1497426, 0.8955795), abs=5e-8)
    assert found.spearman == pytest.approx(0.6)


def test_power_of_a_t_test():
    # power.t.test(n = 20, delta = 1, sd = 1): 0.8689528, which neglects the other tail (3e-7);
    # power.t.test(power = .90, delta = 1): n = 22.02110
    assert _power(1.0, 20, 2, 0.05) == pytest.approx(0.8689528, abs=5e-7)
    assert _power(1.0, 22.02110, 2, 0.05) == pytest.approx(0.9, abs=5e-7)
    assert repetitions_needed(1.0, 2, power=0.9) == 23


def test_power_of_an_analysis_of_variance():
    # power.anova.test(groups = 4, n = 5, between.var = 1, within.var = 3): 0.3535594; with power = .80: n = 11.92613
    f = np.sqrt(1 * 3 / 4 / 3)
    assert _power(f, 5, 4, 0.05) == pytest.approx(0.3535594, abs=5e-8)
    assert _power(f, 11.92613, 4, 0.05) == pytest.approx(0.8, abs=5e-6)
    assert repetitions_needed(f, 4) == 12


def test_adjusting_as_r_does():
    # Of 0.01, 0.02, 0.03 and 0.04, p.adjust makes these by "holm" and by "BH"
    assert adjusted([0.01, 0.02, 0.03, 0.04], Correction.HOLM) == pytest.approx([0.04, 0.06, 0.06, 0.06])
    assert adjusted([0.01, 0.02, 0.03, 0.04], Correction.BENJAMINI_HOCHBERG) == pytest.approx([0.04] * 4)
