"""The results of a meta-analysis, and the averages of one effect over experiments.

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
from robot_runner.analysis.statistics.contrasts import Contrast
from robot_runner.analysis.statistics.tested import Interval, NotComputed
from robot_runner.analysis.wording import labelled
from robot_runner.core.words import listed

if TYPE_CHECKING:
    from robot_runner.analysis.comparison.compared import Side
    from robot_runner.core.errors import Finding


@dataclass(frozen=True, slots=True)
class Pooled:
    """An average over experiments.

    Attributes:
        error: its standard error.
        freedom: the degrees of freedom of the error; infinite for a normal distribution.
        interval: at 1 - alpha; like the p-value, None where all experiments have exactly the same estimate.
        p_value: for an average of zero.
    """

    estimate: float
    error: float
    freedom: float
    interval: Interval | None
    p_value: float | None


@dataclass(frozen=True, slots=True)
class Heterogeneity:
    """How much experiments differ beyond the variation of their own runs.

    Attributes:
        q: Cochran's Q, with one degree of freedom less than there are experiments.
        p_value: for no heterogeneity, by Welch's F: Q itself assumes known standard errors, and has up to 17 % false
            positives where experiments have five runs a treatment.
        tau_squared: the variance between experiments (Paule and Mandel).
        tau_squared_interval: by the profile of Q.
        i_squared: the share of that variance in the total, in percent; its interval follows from that of tau squared.
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
    """One effect over all experiments that estimate it.

    Attributes:
        common: the effect if it is the same in all experiments (common or fixed effect).
        random: the average of effects that vary between experiments (random effects).
        common_weights, random_weights: the weight of each experiment, summing up to 1.
        prediction: the prediction interval of the effect in a further experiment; None for two experiments.
    """

    common: Pooled
    random: Pooled
    common_weights: tuple[float, ...]
    random_weights: tuple[float, ...]
    heterogeneity: Heterogeneity
    prediction: Interval | None


@dataclass(frozen=True, slots=True)
class EffectIn:
    """One experiment's estimate of an effect: a line of a forest plot.

    Attributes:
        experiment: its name in the meta-analysis.
        runs: the number of runs with a value, of the compared treatments.
        estimate: the difference of means (or the contrast), in the unit of the measure.
        error: its standard error, with `freedom` degrees of freedom (Welch, Satterthwaite).
        interval: at 1 - alpha.
        g: Hedges' g; None with a single degree of freedom.
        g_error: its standard error, at the average g of all experiments; within blocks at its own g.
        g_freedom: the degrees of freedom of `g_error`; infinite where the standard deviation has no more of them than
            the error of the difference.
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
        weights: the weight of each treatment's mean.
        statement: the hypothesis of a plan that names the contrast; empty for a pair.
        experiments: the estimates of the experiments that have the effect.
        difference: in the unit of the measure.
        standardised: Hedges' g; None where an experiment has none.
        adjusted_p_value: of the random-effects average, adjusted by Holm for the number of effects on this measure.
        is_significant: whether `adjusted_p_value` is below alpha; None where there is none.
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
        names: its name in each experiment that has it.
        unit: the unit to which all values were converted.
        origins: where the values come from, by experiment.
        is_primary: whether a plan names it among its primary measures.
        effects: one for each pair of treatments of each factor, then contrasts of hypotheses.
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
        experiments: in the given order.
        factors: the factors that at least two experiments vary.
        differing: circumstances that differ: the circumstance, then its value in each experiment.
        findings: notes on the matching for readers: names that differ, units that were converted.
    """

    experiments: tuple[Side, ...]
    alpha: float
    factors: tuple[str, ...]
    measures: tuple[CombinedMeasure, ...]
    differing: tuple[tuple[str, ...], ...]
    findings: tuple[Finding, ...]

    def __repr__(self) -> str:
        """Return what a notebook shows: all numbers would fill pages."""
        names = (listed(each.name for each in given) for given in (self.experiments, self.measures))
        return "<MetaAnalysis of {}: {}>".format(*names)

    def measure(self, name: str) -> CombinedMeasure:
        """Return the results of one measure.

        Raises:
            KeyError: the measure was not combined.
        """
        return {each.name: each for each in self.measures}[name]


_CLOSE = 1e-13
#: Estimates that are closer together than this share of their errors differ only by rounding.
_SAME = 1e-6
_PROFILE = "profile of Q"
_FEWEST_TO_PREDICT = 3


def combine(estimates: Sequence[float], errors: Sequence[float], freedom: Sequence[float], *, alpha: float) -> Combined:
    """Combine the estimates of one effect by two and more experiments.

    The average over a population of experiments (random effects) is that of Paule and Mandel with the interval of
    Hartung, Knapp, Sidik and Jonkman. The common effect assumes one effect in all experiments; its standard error is
    Meier's, because the weights are estimated, too. `combine_effects` of statsmodels gives the same results. It is not
    used because the variance between experiments is a root that its interval needs as well, and because its iteration,
    if it is to be more exact than by default, ends at 0 in one of eight cases. Errors are above 0; their degrees of
    freedom are infinite where they are known.
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
    """The spread of estimates: Q, with weights that include a variance between experiments."""

    values: Floats
    variances: Floats

    def q(self, tau_squared: float) -> float:
        weights = 1 / (self.variances + tau_squared)
        return float(np.sum(weights * (self.values - np.average(self.values, weights=weights)) ** 2))

    def at(self, wanted: float) -> float:
        """Return the variance between experiments for which Q has this value; 0 where Q is smaller without any."""
        if self.q(0.0) <= wanted:
            return 0.0
        # Beyond unit / wanted even unweighted squares are too small. The root is searched in a unit of its own size.
        unit = float(np.sum((self.values - self.values.mean()) ** 2))
        return unit * float(optimize.brentq(lambda each: self.q(unit * each) - wanted, 0.0, 2 / wanted, rtol=_CLOSE))


def _pooled(estimate: float, error: float, freedom: float, alpha: float) -> Pooled:
    if not error > 0:
        return Pooled(estimate, error, freedom, None, None)
    found = Contrast(*map(np.asarray, (estimate, error, freedom)))
    return Pooled(estimate, error, freedom, found.interval(alpha), float(found.p_value))


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
    """Return the probability of a Q at least this large if all experiments have the same effect: Welch's F (1951)."""
    count = len(shares)
    unknown = float(np.sum((1 - shares) ** 2 / freedoms))
    if unknown == 0:
        return float(stats.chi2.sf(q, count - 1))
    f_value = q / (count - 1) / (1 + 2 * (count - 2) / (count**2 - 1) * unknown)
    return float(stats.f.sf(f_value, count - 1, (count**2 - 1) / (3 * unknown)))


def _prediction(mean: float, error: float, tau_squared: float, count: int, alpha: float) -> Interval | None:
    """Return the prediction interval of the effect in a further experiment (Higgins et al. 2009)."""
    if count < _FEWEST_TO_PREDICT:
        return None
    reach = math.sqrt(tau_squared + error**2) * float(stats.t.ppf(1 - alpha / 2, count - 2))
    return Interval(mean - reach, mean + reach, 1 - alpha, "Higgins et al. 2009")
