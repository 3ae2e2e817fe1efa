"""The averages of one effect over several experiments, how far these differ, and what a further one may find.

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
from typing import TYPE_CHECKING

import numpy as np
from scipy import optimize, stats
from statsmodels.stats.meta_analysis import combine_effects

from robot_runner.analysis.comparison.combined import Combined, Heterogeneity, Pooled
from robot_runner.analysis.statistics.descriptive import quiet
from robot_runner.analysis.statistics.tested import Interval

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

__all__ = ["combine"]

#: Statsmodels does not say when it stops before it has converged: each step doubles at least, so that these suffice
#: from the smallest floating-point number to the largest.
_STEPS, _CLOSE = 2500, 1e-9
_FEWEST_TO_PREDICT = 3


def combine(estimates: Sequence[float], errors: Sequence[float], freedom: Sequence[float], *, alpha: float) -> Combined:
    """Combine the estimates of one effect by two and more experiments.

    The average over all experiments that could be made (random effects) is that of Paule and Mandel with the interval
    of Hartung, Knapp, Sidik and Jonkman. The common effect takes all experiments to estimate one and the same; its
    standard error is Meier's, since weights are estimated, too.

    Args:
        estimates: one an experiment.
        errors: their standard errors, above 0.
        freedom: the degrees of freedom of these; infinite where they are known.
        alpha: the level of significance.
    """
    values, variances, freedoms = np.array(estimates), np.square(errors), np.array(freedom)
    with quiet():
        found = combine_effects(values, variances, method_re="pm", atol=_CLOSE, maxiter=_STEPS)
    shares = np.asarray(found.weights_rel_fe)
    inflation = 1 + 4 * float(np.sum(shares * (1 - shares) / freedoms))
    random_error = math.sqrt(max(0.0, float(found.var_hksj_re)))
    known, tau_squared = float(np.sum(shares**2 / freedoms)), float(found.tau2)
    return Combined(
        common=_pooled(
            float(found.mean_effect_fe),
            math.sqrt(inflation) * float(found.sd_eff_w_fe),
            1 / known if known else math.inf,
            alpha,
        ),
        random=_pooled(float(found.mean_effect_re), random_error, len(values) - 1, alpha),
        common_weights=tuple(map(float, shares)),
        random_weights=tuple(map(float, found.weights_rel_re)),
        heterogeneity=_heterogeneity(values, variances, freedoms, float(found.q), tau_squared, alpha),
        prediction=_prediction(float(found.mean_effect_re), float(found.sd_eff_w_re), tau_squared, len(values), alpha),
    )


def _pooled(estimate: float, error: float, freedom: float, alpha: float) -> Pooled:
    if not error > 0:
        return Pooled(estimate, error, freedom, None, None)
    reach = error * float(stats.t.ppf(1 - alpha / 2, freedom))
    interval = Interval(estimate - reach, estimate + reach, 1 - alpha, "t distribution")
    return Pooled(estimate, error, freedom, interval, float(2 * stats.t.sf(abs(estimate) / error, freedom)))


def _heterogeneity(
    values: Floats, variances: Floats, freedoms: Floats, q: float, tau_squared: float, alpha: float
) -> Heterogeneity:
    weights, count = 1 / variances, len(values)
    typical = (count - 1) * weights.sum() / (weights.sum() ** 2 - np.sum(weights**2))  # Higgins and Thompson 2002
    interval = _profile(values, variances, alpha)

    def share(variance: float) -> float:
        return float(100 * variance / (variance + typical))

    return Heterogeneity(
        q,
        count - 1,
        _welch_p_value(q, weights / weights.sum(), freedoms),
        tau_squared,
        interval,
        share(tau_squared),
        Interval(share(interval.low), share(interval.high), interval.level, interval.method),
    )


def _welch_p_value(q: float, shares: Floats, freedoms: Floats) -> float:
    """Return how probable so large a Q is where all experiments estimate the same: Welch's F (1951)."""
    count = len(shares)
    unknown = float(np.sum((1 - shares) ** 2 / freedoms))
    if unknown == 0:
        return float(stats.chi2.sf(q, count - 1))
    f_value = q / (count - 1) / (1 + 2 * (count - 2) / (count**2 - 1) * unknown)
    return float(stats.f.sf(f_value, count - 1, (count**2 - 1) / (3 * unknown)))


def _profile(values: Floats, variances: Floats, alpha: float) -> Interval:
    """Return the interval of tau squared in which Q, with weights of that tau, is neither too large nor too small."""
    spread = float(np.sum((values - values.mean()) ** 2))

    def q_of(tau_squared: float) -> float:
        weights = 1 / (variances + tau_squared)
        return float(np.sum(weights * (values - np.average(values, weights=weights)) ** 2))

    def end(share: float) -> float:
        wanted = float(stats.chi2.ppf(share, len(values) - 1))
        if q_of(0.0) <= wanted:
            return 0.0
        # Beyond spread / wanted even unweighted squares are too small.
        return float(optimize.brentq(lambda each: q_of(each) - wanted, 0.0, spread / wanted))

    return Interval(end(1 - alpha / 2), end(alpha / 2), 1 - alpha, "profile of Q")


def _prediction(mean: float, error: float, tau_squared: float, count: int, alpha: float) -> Interval | None:
    """Return where the effect in a further experiment is expected (Higgins et al. 2009)."""
    if count < _FEWEST_TO_PREDICT:
        return None
    reach = math.sqrt(tau_squared + error**2) * float(stats.t.ppf(1 - alpha / 2, count - 2))
    return Interval(mean - reach, mean + reach, 1 - alpha, "Higgins et al. 2009")
