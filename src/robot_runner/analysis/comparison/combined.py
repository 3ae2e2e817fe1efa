"""What several experiments say together of the effects of treatments, and how the averages of one effect are made.

Sources: Paule and Mandel, Consensus values and weighting factors (Journal of Research of the National Bureau of
Standards 87, 1982); Hartung and Knapp, On tests of the overall treatment effect in meta-analysis with normally
distributed responses (Statistics in Medicine 20, 2001); Sidik and Jonkman, A simple confidence interval for
meta-analysis (Statistics in Medicine 21, 2002); Meier, Variance of a weighted mean (Biometrics 9, 1953); Welch, On the
comparison of several mean values (Biometrika 38, 1951), for heterogeneity Kulinskaya, Dollinger, Knight and Gao, A
Welch-type test for homogeneity of contrasts under heteroscedasticity (Statistics in Medicine 23, 2004); Higgins and
Thompson, Quantifying heterogeneity in a meta-analysis (Statistics in Medicine 21, 2002); Viechtbauer, Confidence
intervals for the amount of heterogeneity in meta-analysis (Statistics in Medicine 26, 2007); Higgins, Thompson and
Spiegelhalter, A re-evaluation of random-effects meta-analysis (Journal of the Royal Statistical Society A 172, 2009).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import optimize, stats

from robot_runner.analysis.arrays import Floats
from robot_runner.analysis.statistics.tested import Interval, NotComputed
from robot_runner.analysis.wording import labelled

if TYPE_CHECKING:
    from robot_runner.analysis.comparison.compared import Side
    from robot_runner.core.errors import Finding


@dataclass(frozen=True, slots=True)
class Pooled:
    """An average over experiments.

    Attributes:
        error: its standard error.
        freedom: the degrees of freedom of that; infinite for a normal distribution.
        interval: at 1 - alpha; None, as the p-value, where all experiments found exactly the same.
        p_value: that the average is zero.
    """

    estimate: float
    error: float
    freedom: float
    interval: Interval | None
    p_value: float | None


@dataclass(frozen=True, slots=True)
class Heterogeneity:
    """How far experiments differ beyond what their own runs explain.

    Attributes:
        q: Cochran's Q, with one degree of freedom less than there are experiments.
        p_value: that they do not, by Welch's F: Q alone takes standard errors to be known, and errs in up to 17 %
            where experiments have five runs a treatment.
        tau_squared: the variance between experiments (Paule and Mandel).
        tau_squared_interval: by the profile of Q.
        i_squared: the share of that variance in all of it, in percent; its interval is that of tau squared.
    """

    q: float
    freedom: int
    p_value: float
    tau_squared: float
    tau_squared_interval: Interval
    i_squared: float
    i_squared_interval: Interval


@dataclass(frozen=True, slots=True)
class Combined:
    """One effect over all experiments that tell of it.

    Attributes:
        common: where all experiments estimate one and the same effect (also called fixed effect).
        random: the average of the effects that experiments of this kind have (random effects).
        common_weights, random_weights: the share of each experiment, summing up to 1.
        prediction: where the effect in a further experiment is expected; None for two experiments.
    """

    common: Pooled
    random: Pooled
    common_weights: tuple[float, ...]
    random_weights: tuple[float, ...]
    heterogeneity: Heterogeneity
    prediction: Interval | None


@dataclass(frozen=True, slots=True)
class EffectIn:
    """What one experiment says of an effect: a line of a forest plot.

    Attributes:
        experiment: its name among those that are combined.
        runs: with a value, of the treatments that are compared.
        estimate: the difference of means (or the contrast), in the unit of the measure.
        error: its standard error, with `freedom` degrees of freedom (Welch, Satterthwaite).
        interval: at 1 - alpha.
        g: Hedges' g; None with a single degree of freedom.
        g_error: its standard error, at the average g of all; within blocks at its own.
        g_freedom: the degrees of freedom of that; infinite where the standard deviation is known no better than the
            error of the difference is.
    """

    experiment: str
    runs: int
    estimate: float
    error: float
    freedom: float
    interval: Interval
    p_value: float
    g: float | None
    g_error: float | None
    g_freedom: float


@dataclass(frozen=True, slots=True)
class CombinedEffect:
    """A difference of two treatments, or a contrast of several, over all experiments.

    Attributes:
        factor: whose treatments are compared.
        weights: the weight of each treatment's mean.
        statement: the hypothesis of a plan that names the contrast; empty for a pair.
        experiments: those that tell of it.
        difference: in the unit of the measure.
        standardised: Hedges' g; None where an experiment has none.
        adjusted_p_value: of the random-effects average, after Holm, for the number of effects on this measure.
        is_significant: whether it is below alpha; None where there is none.
        conclusion: in plain sentences.
    """

    factor: str
    weights: Mapping[str, float]
    statement: str
    experiments: tuple[EffectIn, ...]
    difference: Combined
    standardised: Combined | None
    adjusted_p_value: float | None = None
    is_significant: bool | None = None
    conclusion: str = ""

    @property
    def label(self) -> str:
        """The effect in words, as in `Video less Network`, or the hypothesis."""
        return label_of_effect(self.weights, self.statement)


def label_of_effect(weights: Mapping[str, float], statement: str) -> str:
    """Return an effect in words, as in `Video less Network`, or the hypothesis that names it."""
    return statement or " less ".join(weights)


@dataclass(frozen=True, slots=True)
class CombinedMeasure:
    """One measure of several experiments.

    Attributes:
        names: what each experiment that has it calls it.
        unit: that all values were converted to.
        origins: where the values come from, by experiment.
        is_primary: whether a plan names it among its primary measures.
        effects: one a pair of treatments of each factor, then contrasts of hypotheses.
        not_computed: what could not be combined and why.
    """

    name: str
    names: Mapping[str, str]
    unit: str
    origins: Mapping[str, str | None]
    is_primary: bool
    effects: tuple[CombinedEffect, ...]
    not_computed: tuple[NotComputed, ...] = ()

    @property
    def label(self) -> str:
        """The name with the unit."""
        return labelled(self.name, self.unit)


@dataclass(frozen=True, slots=True)
class MetaAnalysis:
    """Several experiments combined.

    Attributes:
        experiments: in the order in which they were given.
        alpha: the level of significance.
        factors: those that two and more of them vary.
        differing: circumstances that differ: what, then how it is in each.
        findings: what a reader has to know of the matching: names that differ, units that were converted.
    """

    experiments: tuple[Side, ...]
    alpha: float
    factors: tuple[str, ...]
    measures: tuple[CombinedMeasure, ...]
    differing: tuple[tuple[str, ...], ...]
    findings: tuple[Finding, ...]

    def measure(self, name: str) -> CombinedMeasure:
        """Return what was found of one measure.

        Raises:
            KeyError: it was not combined.
        """
        return {each.name: each for each in self.measures}[name]


_CLOSE = 1e-13
#: Estimates that lie closer together than this share of their errors are the same but for rounding.
_SAME = 1e-6
_PROFILE = "profile of Q"
_FEWEST_TO_PREDICT = 3


def combine(estimates: Sequence[float], errors: Sequence[float], freedom: Sequence[float], *, alpha: float) -> Combined:
    """Combine the estimates of one effect by two and more experiments.

    The average over all experiments that could be made (random effects) is that of Paule and Mandel with the interval
    of Hartung, Knapp, Sidik and Jonkman. The common effect takes all experiments to estimate one and the same; its
    standard error is Meier's, since weights are estimated, too. `combine_effects` of statsmodels finds the same; it is
    not used, since the variance between experiments is a root that its interval needs as well, and since the iteration
    there, where it is to be more exact than by default, ends at 0 in one of eight cases.

    Args:
        estimates: one an experiment.
        errors: their standard errors, above 0.
        freedom: the degrees of freedom of these; infinite where they are known.
        alpha: the level of significance.
    """
    values, variances, freedoms = np.array(estimates), np.square(errors), np.array(freedom)
    spread = _Spread(values, variances)
    tau_squared, count = spread.at(len(values) - 1), len(values)
    common, random = (np.average(values, weights=1 / (variances + each)) for each in (0.0, tau_squared))
    common_weights, random_weights = (
        weights / weights.sum() for weights in (1 / variances, 1 / (variances + tau_squared))
    )
    unknown = common_weights / freedoms
    common_error = math.sqrt((1 + 4 * np.sum(unknown * (1 - common_weights))) / np.sum(1 / variances))
    known = float(np.sum(unknown * common_weights))
    random_error = math.sqrt(np.sum(random_weights * (values - random) ** 2) / (count - 1))
    if random_error <= _SAME / math.sqrt(np.sum(1 / variances)):
        random_error = 0.0
    wald_error = math.sqrt(1 / np.sum(1 / (variances + tau_squared)))
    return Combined(
        common=_pooled(float(common), common_error, 1 / known if known else math.inf, alpha),
        random=_pooled(float(random), random_error, count - 1, alpha),
        common_weights=tuple(map(float, common_weights)),
        random_weights=tuple(map(float, random_weights)),
        heterogeneity=_heterogeneity(spread, freedoms, tau_squared, alpha),
        prediction=_prediction(float(random), wald_error, tau_squared, count, alpha),
    )


class _Spread(NamedTuple):
    """How far estimates lie apart, as Q with weights that allow for a variance between experiments."""

    values: Floats
    variances: Floats

    def q(self, tau_squared: float) -> float:
        weights = 1 / (self.variances + tau_squared)
        return float(np.sum(weights * (self.values - np.average(self.values, weights=weights)) ** 2))

    def at(self, wanted: float) -> float:
        """Return the variance between experiments of which Q is so much; 0 where it is less already."""
        if self.q(0.0) <= wanted:
            return 0.0
        # Beyond unit / wanted even unweighted squares are too small. The root is sought in a unit of its own size.
        unit = float(np.sum((self.values - self.values.mean()) ** 2))
        return unit * float(optimize.brentq(lambda each: self.q(unit * each) - wanted, 0.0, 2 / wanted, rtol=_CLOSE))


def _pooled(estimate: float, error: float, freedom: float, alpha: float) -> Pooled:
    if not error > 0:
        return Pooled(estimate, error, freedom, None, None)
    reach = error * float(stats.t.ppf(1 - alpha / 2, freedom))
    interval = Interval(estimate - reach, estimate + reach, 1 - alpha, "t distribution")
    return Pooled(estimate, error, freedom, interval, float(2 * stats.t.sf(abs(estimate) / error, freedom)))


def _heterogeneity(spread: _Spread, freedoms: Floats, tau_squared: float, alpha: float) -> Heterogeneity:
    weights, freedom = 1 / spread.variances, len(spread.values) - 1
    typical = freedom * weights.sum() / (weights.sum() ** 2 - np.sum(weights**2))  # Higgins and Thompson 2002
    low, high = (spread.at(float(stats.chi2.ppf(share, freedom))) for share in (1 - alpha / 2, alpha / 2))

    def share(variance: float) -> float:
        return float(100 * variance / (variance + typical))

    return Heterogeneity(
        q=spread.q(0.0),
        freedom=freedom,
        p_value=_welch_p_value(spread.q(0.0), weights / weights.sum(), freedoms),
        tau_squared=tau_squared,
        tau_squared_interval=Interval(low, high, 1 - alpha, _PROFILE),
        i_squared=share(tau_squared),
        i_squared_interval=Interval(share(low), share(high), 1 - alpha, _PROFILE),
    )


def _welch_p_value(q: float, shares: Floats, freedoms: Floats) -> float:
    """Return how probable so large a Q is where all experiments estimate the same: Welch's F (1951)."""
    count = len(shares)
    unknown = float(np.sum((1 - shares) ** 2 / freedoms))
    if unknown == 0:
        return float(stats.chi2.sf(q, count - 1))
    f_value = q / (count - 1) / (1 + 2 * (count - 2) / (count**2 - 1) * unknown)
    return float(stats.f.sf(f_value, count - 1, (count**2 - 1) / (3 * unknown)))


def _prediction(mean: float, error: float, tau_squared: float, count: int, alpha: float) -> Interval | None:
    """Return where the effect in a further experiment is expected (Higgins et al. 2009)."""
    if count < _FEWEST_TO_PREDICT:
        return None
    reach = math.sqrt(tau_squared + error**2) * float(stats.t.ppf(1 - alpha / 2, count - 2))
    return Interval(mean - reach, mean + reach, 1 - alpha, "Higgins et al. 2009")
