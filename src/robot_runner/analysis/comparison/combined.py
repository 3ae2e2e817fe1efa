"""What several experiments say together of the effects of treatments: plain data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robot_runner.analysis.comparison.compared import Side
    from robot_runner.analysis.statistics.tested import Interval, NotComputed
    from robot_runner.core.errors import Finding

__all__ = ["Combined", "CombinedEffect", "CombinedMeasure", "EffectIn", "Heterogeneity", "MetaAnalysis", "Pooled"]


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
        g: Hedges' g; `g_error` its standard error; None with a single degree of freedom.
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


@dataclass(frozen=True, slots=True)
class CombinedEffect:
    """A difference of two treatments, or a contrast of several, over all experiments.

    Attributes:
        factor: whose treatments are compared.
        weights: the weight of each treatment's mean.
        statement: the hypothesis of a plan that names the contrast; empty for a pair.
        experiments: those that tell of it.
        difference: in the unit of the measure; None where fewer than two experiments tell of it.
        standardised: Hedges' g; None where an experiment has none.
        adjusted_p_value: of the random-effects average, after Holm, for the number of effects on this measure.
        is_significant: whether it is below alpha; None where there is none.
        conclusion: in plain sentences.
    """

    factor: str
    weights: Mapping[str, float]
    statement: str
    experiments: tuple[EffectIn, ...]
    difference: Combined | None = None
    standardised: Combined | None = None
    adjusted_p_value: float | None = None
    is_significant: bool | None = None
    conclusion: str = ""

    @property
    def label(self) -> str:
        """The effect in words, as in `Video less Network`, or the hypothesis."""
        return self.statement or " less ".join(self.weights)


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
        return f"{self.name} ({self.unit})" if self.unit not in {"", "1"} else self.name


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
