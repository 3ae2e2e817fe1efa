"""What R, its packages' documentation and textbooks print for these data."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate, optimize, special, stats
from tests.analysis.statistics import reference_data as data

from robot_runner.analysis.statistics.assumptions import equal_variances, normality
from robot_runner.analysis.statistics.correlations import correlations_of
from robot_runner.analysis.statistics.designed_columns import residuals_of
from robot_runner.analysis.statistics.detectable_effect import _detectable, _power, repetitions_needed
from robot_runner.analysis.statistics.effect_sizes import cliffs_delta, cohens_d, noncentralities_of_f, vargha_delaney
from robot_runner.analysis.statistics.linear_model import fit_model
from robot_runner.analysis.statistics.post_hoc import adjusted, compare_pairs
from robot_runner.analysis.statistics.tested import Magnitude, TestMethod
from robot_runner.analysis.statistics.tests import Choices, carry_out, model_of
from robot_runner.core.design.analysis_plan import Correction, Estimand, Statistic


def computed(measure, **choices):
    """The tests of a measure and the pairs of its first factor, as the design and these choices fix them."""
    chosen = Choices(**choices)
    model = model_of(measure, chosen.estimand, chosen.statistic)
    test = carry_out(measure, model, chosen)
    return test, compare_pairs(measure, model, test, chosen)[0][0].comparisons


#: In R, of squared errors v of means m on f degrees of freedom, with contrasts L: P = L' (L L')^-1 L, q = diag(P),
#: s = q^2 v^2 f / (f + 2), own = sum(q v), total = own^2 - 2 sum(s / f), crossed = sum(P^2 outer(v, v)) -
#: sum(q^2 v^2) + sum(s); F = m' P m / own on total / crossed and total / sum(s / f); together mean(p^(-1/3))^-3.
def parts(effect):
    """The ANOVA-type test of an effect beside its Welch-James test, and the p-value of both."""
    weighed, plain = effect.parts
    assert (weighed.statistic, weighed.degrees_of_freedom) == (effect.statistic, effect.degrees_of_freedom)
    return (plain.statistic, *plain.degrees_of_freedom, plain.p_value), effect.p_value


def ends(size):
    return (size.interval.low, size.interval.high)


def test_welch_t_of_sleep():
    # t.test(extra ~ group, data = sleep)
    test, (pair,) = computed(data.one_factor(data.SLEEP))
    (effect,) = test.effects
    assert test.method is TestMethod.WELCH_T
    assert effect.statistic == pytest.approx(pair.statistic)
    assert effect.statistic == pytest.approx(-1.8608, abs=5e-5)
    assert effect.degrees_of_freedom[0] == pytest.approx(17.776, abs=5e-4)
    assert effect.p_value == pytest.approx(0.07939414, abs=5e-9)
    assert ends(pair) == pytest.approx((-3.3654832, 0.2054832), abs=5e-8)


def test_paired_t_of_sleep():
    # t.test(Pair(extra.1, extra.2) ~ 1)
    test, (pair,) = computed(data.one_factor(data.SLEEP, in_blocks=True))
    (effect,) = test.effects
    assert test.method is TestMethod.PAIRED_T
    assert effect.statistic == pytest.approx(-4.0621, abs=5e-5)
    assert effect.degrees_of_freedom == pytest.approx((9.0,))
    assert effect.p_value == pytest.approx(0.002833, abs=5e-7)
    assert pair.difference == pytest.approx(-1.58)
    assert ends(pair) == pytest.approx((-2.4598858, -0.7001142), abs=5e-8)


def test_cohens_d_of_paired_sleep():
    # effectsize: cohens_d(paired = TRUE) of sleep: -1.28 [-2.12, -0.41], in standard deviations of differences; those
    # are the square root of two times larger than what is left of single values within blocks
    _, (pair,) = computed(data.one_factor(data.SLEEP, in_blocks=True))
    effect = pair.effect_sizes[0]
    assert effect.value == pytest.approx(-1.28 * np.sqrt(2), abs=0.01)
    assert ends(effect) == pytest.approx((-2.12 * np.sqrt(2), -0.41 * np.sqrt(2)), abs=0.01)


def test_t_test_of_mtcars():
    # t.test(mpg ~ am, data = mtcars)
    (effect,) = computed(data.one_factor(data.MILES_PER_GALLON))[0].effects
    assert effect.statistic == pytest.approx(-3.7671, abs=5e-5)
    assert effect.p_value == pytest.approx(0.001374, abs=5e-7)


def test_cohens_d_of_mtcars():
    # effectsize: cohens_d(mpg ~ am, data = mtcars): -1.48 [-2.27, -0.67], of the pooled standard deviation
    automatic, manual = (np.array(values) for values in data.MILES_PER_GALLON.values())
    n, m = len(automatic), len(manual)
    pooled = np.sqrt(((n - 1) * automatic.var(ddof=1) + (m - 1) * manual.var(ddof=1)) / (n + m - 2))
    error = pooled * np.sqrt(1 / n + 1 / m)
    effect = cohens_d(automatic.mean() - manual.mean(), error, n + m - 2, pooled)
    assert effect.value == pytest.approx(-1.48, abs=0.005)
    assert ends(effect) == pytest.approx((-2.27, -0.67), abs=0.005)
    assert effect.magnitude is Magnitude.LARGE


@pytest.mark.parametrize(("is_blocked", "last"), [(False, "Vargha-Delaney A12"), (True, "rank-biserial correlation")])
def test_intervals_of_effect_sizes_have_the_level_of_the_study(is_blocked, last):
    random = np.random.default_rng(1)
    values = {"a": random.normal(0, 1, 9).tolist(), "b": random.normal(1, 1, 9).tolist()}
    measure = data.one_factor(values, in_blocks=is_blocked)
    usual, strict = (computed(measure, alpha=alpha)[1][0].effect_sizes for alpha in (0.05, 0.01))
    assert (usual[-1].name, len(usual)) == (last, 2 if is_blocked else 3)
    for one, other in zip(usual, strict, strict=True):
        assert other.interval != one.interval
        assert (one.interval.level, other.interval.level) == pytest.approx((0.95, 0.99))
        assert other.interval.low <= one.interval.low < one.value < one.interval.high <= other.interval.high


@pytest.mark.long
def test_cliffs_delta_of_thousands_of_runs_holds_no_table_of_all_pairs():
    random = np.random.default_rng(4)
    one, other = np.round(random.normal(0.2, 1, 4_000), 2), np.round(random.normal(size=4_000), 2)
    tracemalloc.start()
    effect = cliffs_delta([(one, other)])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5e6  # the table would take 128 MB
    dominance = np.sign(one[:, None] - other[None, :])
    assert effect.value == pytest.approx(dominance.mean(), rel=1e-12)
    parts = [np.var(dominance.mean(axis=axis), ddof=1) / 4_000 for axis in (1, 0)]
    freedom = sum(parts) ** 2 / sum(part**2 / 3_999 for part in parts)
    reach = stats.t.ppf(0.975, freedom) * np.sqrt(sum(parts)) / (1 - effect.value**2)
    assert np.arctanh([effect.interval.low, effect.interval.high]) == pytest.approx(
        [np.arctanh(effect.value) - reach, np.arctanh(effect.value) + reach]
    )


def test_cliffs_delta_is_zero_where_as_many_pairs_are_won_as_lost_and_one_where_all_are():
    one, other = np.array([6.0, 3.0, 8.0]), np.array([8.0, 5.0, 5.0])
    assert cliffs_delta([(one, other)]).value == 0
    thirds = [([6, 8, 4], [5, 8, 2]), ([7, 1, 3], [6, 5, 1]), ([5, 5, 8], [5, 7, 8])]
    assert cliffs_delta([(np.array(a, float), np.array(b, float)) for a, b in thirds]).value == 0
    assert cliffs_delta([(np.arange(49.0) + 49, np.arange(49.0))] * 3).value == 1


def test_cliffs_delta_of_the_package_effsize():
    # effsize: cliff.delta(treatment, control): -0.25 (small)
    treatment = np.array([10, 10, 20, 20, 20, 30, 30, 30, 40, 50], dtype=float)
    control = np.array([10, 20, 30, 40, 40, 50], dtype=float)
    effect = cliffs_delta([(treatment, control)])
    assert effect.value == -0.25
    assert effect.magnitude is Magnitude.SMALL
    assert vargha_delaney(effect).value == 0.375
    found = stats.brunnermunzel(treatment, control)
    freedom = optimize.brentq(lambda each: 2 * stats.t.sf(found.statistic, each) - found.pvalue, 5, 14)
    error = (0.5 - 0.375) / found.statistic  # of A12, whose logit is given limits
    logit, reach = np.log(0.375 / 0.625), stats.t.ppf(0.975, freedom) * error / (0.375 * 0.625)
    ends = vargha_delaney(effect).interval
    assert (ends.low, ends.high) == pytest.approx((special.expit(logit - reach), special.expit(logit + reach)))


@pytest.mark.long
@pytest.mark.parametrize(
    ("spread", "sizes", "delta"),
    [
        (3, [(5, 30)], 0.6),
        pytest.param(3, [(10, 30)], 0.85, marks=pytest.mark.soak),
        (3, [(30, 30)], 0.95),
        pytest.param(1, [(3, 10)], 0.3, marks=pytest.mark.soak),
        pytest.param(1, [(20, 20)], 0, marks=pytest.mark.soak),
        (1, [(2, 8), (8, 2)], 0),
        pytest.param(1, [(5, 5), (20, 20)], 0.6, marks=pytest.mark.soak),
    ],
)
def test_the_interval_of_cliffs_delta_holds_as_often_as_it_says(spread, sizes, delta):
    shift = np.hypot(spread, 1) * stats.norm.ppf((1 + delta) / 2)
    random = np.random.default_rng(3)
    drawn = [[(random.normal(shift, spread, n), random.normal(size=m)) for n, m in sizes] for _ in range(2_000)]
    ends = [cliffs_delta(pairs).interval for pairs in drawn]
    assert 0.92 <= np.mean([each.low <= delta <= each.high for each in ends]) <= 0.99


@pytest.mark.long
def test_a_batch_of_two_runs_does_not_make_cliffs_delta_seem_certain():
    random = np.random.default_rng(3)
    drawn = [[(random.normal(size=n), random.normal(size=n)) for n in (2, 30)] for _ in range(1_000)]
    ends = [cliffs_delta(pairs).interval for pairs in drawn]
    assert np.mean([each.low <= 0 <= each.high for each in ends]) >= 0.95


def test_assumptions_of_plant_growth():
    # shapiro.test(residuals(aov(...))): W = 0.96607, p = 0.4379; car::leveneTest: F = 1.1192, p = 0.3412
    measure = data.one_factor(data.PLANT_GROWTH)
    shapiro = normality(residuals_of(measure)[0], 0.05)
    assert shapiro.statistic == pytest.approx(0.96607, abs=5e-6)
    assert shapiro.p_value == pytest.approx(0.4379, abs=5e-5)
    levene = equal_variances(measure.groups(["A"]), 0.05)
    assert levene.statistic == pytest.approx(1.1192, abs=5e-5)
    assert levene.p_value == pytest.approx(0.3412, abs=5e-5)


def test_welch_anova_of_plant_growth():
    # oneway.test(weight ~ group, data = PlantGrowth): F = 5.180972408, denom df = 17.12841862, p-value = 0.0173928215
    test, _ = computed(data.one_factor(data.PLANT_GROWTH))
    (effect,) = test.effects
    assert test.method is TestMethod.COMBINED
    assert effect.statistic == pytest.approx(5.180972408, abs=5e-9)
    assert effect.degrees_of_freedom == pytest.approx((2.0, 17.12841862), abs=5e-8)
    assert effect.parts[0].p_value == pytest.approx(0.0173928215, abs=5e-10)
    plain, together = parts(effect)
    assert plain == pytest.approx((4.8460878623801, 1.9287951838316, 25.1435635707892, 0.0174846509888), rel=1e-9)
    assert together == pytest.approx(0.0174386556462, rel=1e-9)
    (alone,) = computed(data.one_factor(data.PLANT_GROWTH), statistic=Statistic.WELCH_JAMES)[0].effects
    assert (alone.test, alone.p_value, alone.parts) == ("Welch's ANOVA", effect.parts[0].p_value, ())


def test_noncentralities_of_plant_growth():
    # uniroot(function(n) pf(5.180972408, 2, 17.12841862, ncp = n) - p, c(0, 500)) at p = 0.95 and 0.05; and
    # effectsize: F_to_eta2(5.180972408, 2, 17.12841862, ci = 0.9, alternative = "two.sided"): 0.0540366391, 0.586884784
    low, high = noncentralities_of_f(5.180972408, (2, 17.12841862), 0.9)
    assert (low, high) == pytest.approx((0.97843402, 24.33318318), abs=5e-8)
    shares = (low / (low + 17.12841862), high / (high + 17.12841862))
    assert shares == pytest.approx((0.0540366391, 0.586884784), abs=5e-8)


def test_welch_anova_of_insect_sprays_and_of_their_ranks():
    # oneway.test(count ~ spray): 36.065, 5, 30.043, 7.999e-12; of ranks N / tr(TV) p'Tp with Box's degrees of freedom,
    # as Brunner, Dette and Munk 1997 have it, computed with R's matrices: 44.2664175739, 4.82835064051, 63.1918861159
    (effect,) = computed(data.one_factor(data.INSECT_SPRAYS))[0].effects
    assert effect.statistic == pytest.approx(36.065, abs=5e-4)
    assert effect.degrees_of_freedom[1] == pytest.approx(30.043, abs=5e-4)
    assert effect.parts[0].p_value == pytest.approx(7.999e-12, rel=1e-3)
    assert parts(effect)[1] == pytest.approx(2.76458896013e-12, rel=1e-6)
    assert effect.check.statistic == pytest.approx(44.2664175739, abs=5e-10)
    assert effect.check.degrees_of_freedom == pytest.approx((4.82835064051, 63.1918861159), abs=5e-10)
    assert effect.check.p_value == pytest.approx(4.13827753240e-19, rel=1e-6)
    assert effect.check.agrees


def test_welch_james_of_warp_breaks():
    # m <- lm(breaks ~ 0 + interaction(wool, tension)); car::linearHypothesis(m, L, vcov. = vcovHC(m, "HC2"),
    # test = "Chisq") with L of unweighted marginal means: 14.305 for tension, 7.6082 for the interaction. Divided by c
    # = r + 2A - 6A / (r + 2), as of Johansen 1980 with A = sum(((V/n P)[j, j])^2 / (n - 1)), P = L' (L V/n L')^-1 L:
    # F = 6.9654021834 on 2 and 24.8460975354, p = 0.0039667908; and 3.704687706, p = 0.039075694
    wool, tension, interaction = computed(data.two_factors(data.WARP_BREAKS))[0].effects
    assert tension.statistic == pytest.approx(6.9654021834, abs=5e-10)
    assert tension.degrees_of_freedom == pytest.approx((2.0, 24.8460975354), abs=5e-9)
    assert tension.parts[0].p_value == pytest.approx(0.0039667908, abs=5e-10)
    assert interaction.statistic == pytest.approx(3.704687706, abs=5e-9)
    assert interaction.parts[0].p_value == pytest.approx(0.039075694, abs=5e-9)
    freedom = (1.81460513662838, 34.3270554031318)
    plain, together = parts(tension)
    assert plain == pytest.approx((8.49804664835801, *freedom, 0.00136487547801), rel=1e-9)
    assert together == pytest.approx(0.00221960778633, rel=1e-9)
    plain, together = parts(interaction)
    assert plain == pytest.approx((4.189068966851, *freedom, 0.0267589791828), rel=1e-9)
    assert together == pytest.approx(0.0321436829225, rel=1e-9)
    assert wool.statistic_name == "t"
    assert wool.degrees_of_freedom[0] == pytest.approx(29.0616443, abs=5e-7)


def test_anova_type_statistic_of_warp_breaks():
    # Brunner, Dette and Munk 1997, in R with T = L' (L L')^-1 L, V = diag(v / n), D = diag(diag(T)):
    # F = t(b) T b / tr(TV) = 8.4980466, tr(TV)^2 / tr(TVTV) = 1.7367162, tr(TV)^2 / tr(D^2 V^2 / (n - 1)) = 29.0616443
    tension = computed(data.two_factors(data.WARP_BREAKS), statistic=Statistic.ANOVA_TYPE)[0].effects[1]
    assert tension.statistic == pytest.approx(8.4980466, abs=5e-7)
    assert tension.degrees_of_freedom == pytest.approx((1.7367162, 29.0616443), abs=5e-7)


def test_trimmed_means_of_sleep():
    # WRS2::yuen and Wilcox 2012: h = n - 2 g with g = floor(0.2 n), d = (n - 1) sw^2 / (h (h - 1)) of each group
    low, high = (np.sort(values) for values in data.SLEEP.values())
    means = [values[2:8].mean() for values in (low, high)]
    squared = [9 * np.clip(values, values[2], values[7]).var(ddof=1) / (6 * 5) for values in (low, high)]
    test, (pair,) = computed(data.one_factor(data.SLEEP), estimand=Estimand.TRIMMED_MEAN)
    assert pair.difference == pytest.approx(means[0] - means[1])
    assert pair.statistic == pytest.approx((means[0] - means[1]) / np.sqrt(sum(squared)))
    freedom = sum(squared) ** 2 / sum(each**2 / 5 for each in squared)
    assert test.effects[0].degrees_of_freedom == pytest.approx((freedom,))


def test_blocks_of_ergo_stool():
    # nlme: anova(lme(effort ~ Type, random = ~ 1 | Subject)): F = 22.3556; car: summary(Anova(lm(wide ~ 1), idata,
    # idesign = ~ Type), multivariate = FALSE): GG eps 0.64592, p = 3.006e-05; HF eps 0.8489651, p = 2.483089e-06
    effect = computed(data.one_factor(data.ERGO_STOOL, in_blocks=True))[0].effects[0]
    assert effect.test == "Huynh-Feldt"
    assert effect.statistic == pytest.approx(22.3556, abs=5e-5)
    assert effect.degrees_of_freedom == pytest.approx((3 * 0.8489651, 24 * 0.8489651), abs=5e-6)
    assert effect.p_value == pytest.approx(2.483089e-06, abs=5e-13)


def test_few_blocks_of_ergo_stool():
    # The first subjects alone, by R: anova(lm(wide ~ 1), X = ~1, test = "Spherical"): of seven HF eps 0.9713924393,
    # p = 5.203349284e-05, of six HF eps 1.067 (at most 1), p = 0.0002276837746; five have fewer
    # degrees of freedom than two for each contrast less one, and so Greenhouse-Geisser: GG eps 0.5488, p = 0.0075
    for blocks, test, epsilon, p_value in (
        (7, "Huynh-Feldt", 0.9713924393, 5.203349284e-05),
        (6, "Huynh-Feldt", 1.0, 0.0002276837746),
        (5, "Greenhouse-Geisser", 0.548780487805, 0.007528696654),
    ):
        few = {name: values[:blocks] for name, values in data.ERGO_STOOL.items()}
        effect = computed(data.one_factor(few, in_blocks=True))[0].effects[0]
        assert effect.test == test
        assert effect.degrees_of_freedom == pytest.approx((3 * epsilon, 3 * (blocks - 1) * epsilon), rel=1e-8)
        assert effect.p_value == pytest.approx(p_value, rel=1e-8)


def test_mixed_model_of_incomplete_blocks():
    # lmerTest: anova(lmer(yield ~ N*P*K + (1|block), npk), ddf = "Kenward-Roger"), and aov(... + Error(block))
    test, pairs = computed(data.npk())
    effects = {each.label: each for each in test.effects}
    found = {label: (round(each.statistic, 3), each.degrees_of_freedom[1]) for label, each in effects.items()}
    assert test.method is TestMethod.MIXED_MODEL
    assert found == {
        "N": (12.259, 12),
        "P": (0.544, 12),
        "K": (6.166, 12),
        "N x P": (1.378, 12),
        "N x K": (2.146, 12),
        "P x K": (0.031, 12),
        "N x P x K": (0.483, 4),
    }
    assert effects["N"].p_value == pytest.approx(pairs[0].p_value) == pytest.approx(0.004372, abs=5e-7)
    assert effects["K"].p_value == pytest.approx(0.028795, abs=5e-6)
    assert effects["N x P x K"].p_value == pytest.approx(0.525236, abs=5e-5)


def test_mixed_model_of_a_block_that_lacks_a_treatment():
    # nlme: lme(effort ~ Type, random = ~ 1 | Subject): standard deviations 1.332465 (subjects) and 1.100295 (residual)
    model = fit_model(data.one_factor(data.ERGO_STOOL, in_blocks=True))
    assert model.spread == pytest.approx(1.100295, abs=5e-6)
    assert np.sqrt(model.fit.ratio) * model.spread == pytest.approx(1.332465, abs=5e-5)
    (effect,) = model.effects()
    assert effect.statistic == pytest.approx(22.3556, abs=5e-4)
    assert effect.freedom == (3.0, 24.0)


def test_a_mixed_model_of_large_values_that_hardly_differ_keeps_its_digits():
    measure = data.npk()
    tenths = np.round(measure.values * 10)
    plain, far = (fit_model(measure, response) for response in (tenths, 50 + tenths * 2.0**-30))
    for one, other in zip(plain.effects(), far.effects(), strict=True):
        assert other.statistic == pytest.approx(one.statistic, rel=1e-7)
    assert far.fit.ratio == pytest.approx(plain.fit.ratio, rel=1e-6)
    assert far.fit.beta[0] == pytest.approx(50 + plain.fit.beta[0] * 2.0**-30, rel=1e-14)


def test_errors_of_a_mixed_model_whose_blocks_lack_different_treatments():
    # nlme: lme(effort ~ Type, random = ~ 1 | Subject) without Type 1 of Subject 1, 2 of 2, 3 of 3 and 4 of 4:
    # F = 25.1455787, the error of T2 - T3 and of T1 - T4 is 0.517140711.
    rows = [(name, place, value) for name, of in data.ERGO_STOOL.items() for place, value in enumerate(of, 1)]
    held = [row for row in rows if row[:2] not in {(f"T{each}", each) for each in (1, 2, 3, 4)}]
    measure = data.split_plot([(f"subject {place}", "all", name, float(value)) for name, place, value in held])
    model = fit_model(replace(measure, factors=("B",)))
    (effect,) = model.effects()
    assert effect.statistic == pytest.approx(25.1455787, abs=5e-6)
    assert effect.freedom == (3.0, 20.0)
    for one, other in (("T2", "T3"), ("T1", "T4")):
        found = model.difference([({"B": one}, 1.0), ({"B": other}, -1.0)])
        assert float(found.error) == pytest.approx(0.517140711, abs=5e-8)


def test_blocks_that_do_not_differ_have_no_variance():
    # nlme ends at a standard deviation of blocks of 1e-5 and less, and at the F of least squares.
    random = np.random.default_rng(3)
    held = [(block, name) for block in range(7) for at, name in enumerate("xyz") if block % 3 != at]
    drawn = dict(zip(held, random.normal(size=len(held)), strict=True))
    rows = []
    for block, name in held:  # values of a block are alike by less than chance would have it
        mine = [value for (other, _), value in drawn.items() if other == block]
        rows.append((f"block {block}", "all", name, float(drawn[block, name] - np.mean(mine) + "xyz".index(name))))
    model = fit_model(replace(data.split_plot(rows), factors=("B",)))
    assert model.fit.ratio == 0
    groups = [[value for *_, name, value in rows if name == each] for each in "xyz"]
    (effect,) = model.effects()
    assert effect.statistic == pytest.approx(stats.f_oneway(*groups).statistic)
    assert effect.freedom == (2.0, 14 - 7 - 2)


def test_split_plot_of_higgins():
    # summary(aov(y ~ Moisture * Fertilizer + Error(Tray))): where blocks are balanced, the F of what is
    # compared within blocks is the classical one: Fertilizer and its interaction with Moisture
    moisture, fertilizer, interaction = computed(data.split_plot(data.HIGGINS_TABLE_5))[0].effects
    frame = data.split_plot(data.HIGGINS_TABLE_5).frame
    wide = frame.pivot_table(index=["A", " block"], columns="B", values=" value", observed=True)
    rest = wide.sub(wide.mean(axis=1), axis=0)
    within = rest - rest.groupby("A", observed=True).transform("mean")
    error = float((within**2).to_numpy().sum()) / 24
    treatment = float(12 * (rest.mean() ** 2).sum()) / 3
    assert fertilizer.statistic == pytest.approx(treatment / error)
    assert fertilizer.test == interaction.test == "Greenhouse-Geisser"
    assert moisture.test == "Welch-James and ANOVA-type, parametric bootstrap of blocks"
    assert moisture.p_value < 0.05


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


@pytest.mark.parametrize(
    ("runs", "alpha", "effect"),
    # power.t.test(n, sd = 1, sig.level, power = 0.8, strict = TRUE, tol = 1e-12) of R 4.2.2
    [(2, 0.05, 5.653489), (2, 0.01, 12.67843), (3, 0.001, 8.71518), (3, 0.0001, 15.59302), (5, 0.01, 2.744468)],
)
def test_the_detectable_effect_of_few_runs_is_that_of_r_however_large_it_is(runs, alpha, effect):
    assert _detectable(runs, 2, alpha, in_blocks=False) == pytest.approx(effect, rel=1e-6)


def test_a_detectable_effect_has_the_power_that_an_integral_has():
    effect = _detectable(2, 2, 0.001, in_blocks=False)  # power.t.test says 40.973, with which the power is 0.813
    t = stats.t.isf(0.0005, 2)

    def density(spread):
        return stats.norm.sf(t * spread - effect) * stats.chi.pdf(spread * 2**0.5, 2) * 2**0.5

    kink = effect / t
    parts = [integrate.quad(density, *ends, limit=500)[0] for ends in ((0, kink), (kink, 20))]
    assert sum(parts) == pytest.approx(0.8, abs=1e-7)
    assert _detectable(2, 2, 0.0001, in_blocks=False) is None  # 130 standard deviations
