"""The analysis plan, fixed before the experiment: measures, estimand, tests, and exclusions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, Self

from robot_runner.core.design.columns import REPETITION
from robot_runner.core.design.hypothesis import Hypothesis, names_findings, names_of
from robot_runner.core.design.outliers import Doubtful, Outliers
from robot_runner.core.errors import DesignError, Finding, did_you_mean

#: Covariates that are not measures: the place in the order of execution (from 1), and the seconds since the first run.
ORDER, ELAPSED = "order", "elapsed"


class Correction(Enum):
    """How p-values are adjusted where many comparisons are made.

    HOLM bounds the family-wise error rate (Holm 1979), BENJAMINI_HOCHBERG the false discovery rate (Benjamini and
    Hochberg 1995).
    """

    HOLM = "holm"
    BENJAMINI_HOCHBERG = "benjamini-hochberg"


class Estimand(Enum):
    """The quantity that is estimated for each treatment, and compared.

    MEAN is what adds up, as for a bill of energy; TRIMMED_MEAN leaves out the fifth at either end (Yuen 1974), for runs
    without blocks; RANK is the probability that a run of one treatment has the larger value (Brunner, Dette and Munk
    1997).
    """

    MEAN = "mean"
    TRIMMED_MEAN = "trimmed mean"
    RANK = "rank"


class Statistic(Enum):
    """The test statistic for an effect of several degrees of freedom among independent runs.

    WELCH_JAMES weights differences by their precision (Welch 1951, Johansen 1980); ANOVA_TYPE does not, and has more
    power for few runs with equal spreads (Brunner, Dette and Munk 1997). COMBINED is a mean of both p-values, with
    nearly the power of the better one; for ranks it is ANOVA_TYPE.
    """

    COMBINED = "combined"
    WELCH_JAMES = "welch-james"
    ANOVA_TYPE = "anova-type"


class Family(Enum):
    """The tests among which errors are controlled together.

    PRIMARY is all effects of all planned measures, MEASURE those of one measure, HYPOTHESES what the hypotheses claim.
    All other effects are a family for each measure.
    """

    PRIMARY = "primary"
    MEASURE = "measure"
    HYPOTHESES = "hypotheses"


#: The choices that are members of an enumeration; each has the name of its class, in lower case.
_CHOICES: tuple[type[Enum], ...] = (Correction, Family, Estimand, Statistic, Doubtful)


@dataclass(frozen=True, slots=True, init=False)
class AnalysisPlan:
    """The choices of the analysis that are fixed before the experiment (pre-registered).

    It is validated with the config and kept in the manifest. Statistics then tell what was planned from what is
    exploratory.

    Attributes:
        measures: the primary measures; those of the hypotheses belong to them.
        secondary: measures that are planned as well, each with a family of tests of its own.
        alpha: the level of significance.
        correction: how p-values are adjusted where many comparisons are made.
        family: the tests among which errors are controlled together.
        estimand: what is estimated of each treatment, and compared.
        statistic: what tests an effect of several degrees of freedom.
        blocks: a factor, or the repetition, whose values are blocks; None for those that the order was randomised in.
        hypotheses: what the experiment is to test.
        outliers: by which rule values are left out; None for none.
        doubtful: what becomes of values that are doubtful.
        covariates: what else differs between runs, and is adjusted for: measures, or `order` (the place in the order of
            execution) and `elapsed` (seconds since the first run).

    Raises:
        DesignError: a choice is invalid; `findings` lists all problems.

    Example:
        >>> from robot_runner import Hypothesis
        >>> plan = AnalysisPlan(
        ...     measures=["Energy"],
        ...     hypotheses=[Hypothesis("The task affects the CPU.", measure="CPU", factors="Task")],
        ... )
        >>> plan.measures, plan.alpha
        (('Energy', 'CPU'), 0.05)
    """

    measures: tuple[str, ...]
    secondary: tuple[str, ...]
    alpha: float
    correction: Correction
    family: Family
    estimand: Estimand
    statistic: Statistic
    blocks: str | None
    hypotheses: tuple[Hypothesis, ...]
    outliers: Outliers | None
    doubtful: Doubtful
    covariates: tuple[str, ...]

    def __init__(  # noqa: PLR0913 - keywords, of which a plan gives two or three
        self,
        measures: str | Sequence[str] = (),
        *,
        secondary: str | Sequence[str] = (),
        alpha: float = 0.05,
        correction: Correction = Correction.HOLM,
        family: Family = Family.PRIMARY,
        estimand: Estimand = Estimand.MEAN,
        statistic: Statistic = Statistic.COMBINED,
        blocks: str | None = None,
        hypotheses: Sequence[Hypothesis] = (),
        outliers: Outliers | None = None,
        doubtful: Doubtful = Doubtful.KEEP,
        covariates: str | Sequence[str] = (),
    ) -> None:
        choices = {
            "correction": correction,
            "family": family,
            "estimand": estimand,
            "statistic": statistic,
            "doubtful": doubtful,
        }
        findings = [*_choice_findings(alpha, choices, blocks), *_hypotheses_findings(hypotheses)]
        for what, names in (("measures", measures), ("secondary", secondary), ("covariates", covariates)):
            findings += names_findings("analysis", what, names_of(names))
        if outliers is not None and not isinstance(outliers, Outliers):
            fix = "Write Outliers(interquartile_ranges=3), or another rule."
            findings.append(Finding.error("analysis", f"outliers is {outliers!r}", fix))
        if not findings and not (measures or hypotheses):
            findings.append(Finding.error("analysis", "the plan names no measure", "Give measures=[...]."))
        if not findings and family is Family.HYPOTHESES and not hypotheses:
            fix = "Give hypotheses=[...], or another family."
            findings.append(Finding.error("analysis", "the family is that of the hypotheses, and there are none", fix))
        DesignError.refuse(findings)
        primary = tuple(dict.fromkeys((*names_of(measures), *(hypothesis.measure for hypothesis in hypotheses))))
        DesignError.refuse(_covariate_findings(names_of(covariates), primary, estimand))
        object.__setattr__(self, "measures", primary)
        object.__setattr__(self, "secondary", tuple(name for name in names_of(secondary) if name not in primary))
        object.__setattr__(self, "alpha", float(alpha))
        for name, choice in choices.items():
            object.__setattr__(self, name, choice)
        object.__setattr__(self, "blocks", blocks)
        object.__setattr__(self, "hypotheses", tuple(hypotheses))
        object.__setattr__(self, "outliers", outliers)
        object.__setattr__(self, "covariates", tuple(dict.fromkeys(names_of(covariates))))

    def findings(self, factors: Sequence[str], measures: Sequence[str]) -> Iterator[Finding]:
        """Yield an error for each name of the plan that a design does not have.

        Args:
            factors: the factors of the design.
            measures: the measures that have a column in its run table.
        """
        for name in (*self.measures, *self.secondary):
            if name not in measures:
                yield Finding.error("analysis", f"there is no measure {name!r}", did_you_mean(name, measures))
        if self.blocks is not None and self.blocks not in (*factors, REPETITION):
            problem = f"there is no factor {self.blocks!r} whose treatments could be blocks"
            yield Finding.error("analysis", problem, did_you_mean(self.blocks, (*factors, REPETITION)))
        yield from self._unknown_of_runs(factors, measures)
        for hypothesis in self.hypotheses:
            for name in hypothesis.factors:
                if name not in factors:
                    where = f"analysis, hypothesis {hypothesis.statement!r}"
                    yield Finding.error(where, f"there is no factor {name!r}", did_you_mean(name, factors))

    def _unknown_of_runs(self, factors: Sequence[str], measures: Sequence[str]) -> Iterator[Finding]:
        for name in self.covariates:
            if name in factors:
                fix = "Name a measure, 'order' or 'elapsed': factors are compared anyway."
                yield Finding.error("analysis", f"the covariate {name!r} is a factor", fix)
            elif name not in (*measures, ORDER, ELAPSED):
                fix = did_you_mean(name, (*measures, ORDER, ELAPSED))
                yield Finding.error("analysis", f"there is no measure {name!r} that could be a covariate", fix)
        for name in self.outliers.bounds if self.outliers is not None else ():
            if name not in measures:
                problem = f"there is no measure {name!r} that could have bounds"
                yield Finding.error("analysis, outliers", problem, did_you_mean(name, measures))

    def as_mapping(self) -> dict[str, Any]:
        """Return the plan as plain data, for the manifest."""
        # Left out when not chosen, so that plans of earlier versions compare as equal.
        later = {
            "outliers": None if self.outliers is None else self.outliers.as_mapping(),
            "doubtful": None if self.doubtful is Doubtful.KEEP else self.doubtful.value,
            "covariates": list(self.covariates),
        }
        return {
            "measures": list(self.measures),
            "secondary": list(self.secondary),
            "alpha": self.alpha,
            "correction": self.correction.value,
            "family": self.family.value,
            "estimand": self.estimand.value,
            "statistic": self.statistic.value,
            "blocks": self.blocks,
            "hypotheses": [each.as_mapping() for each in self.hypotheses],
            **{name: value for name, value in later.items() if value},
        }

    @classmethod
    def of_mapping(cls, plain: Mapping[str, Any]) -> Self:
        """Return the plan that `as_mapping` made plain.

        Raises:
            DesignError: it is no such plan, or of a later version.
        """
        unknown = [str(key) for key in plain if key not in cls.__slots__]
        if unknown:
            problem = f"there is no choice {unknown[0]!r}"
            raise DesignError(problem, where="analysis", fix=did_you_mean(unknown[0], cls.__slots__))
        try:
            given: dict[str, Any] = {**plain}
            for kind in _CHOICES:
                if (name := kind.__name__.lower()) in given:
                    given[name] = kind(given[name])
            given["hypotheses"] = [Hypothesis(**each) for each in given.get("hypotheses", ())]
            if given.get("outliers") is not None:
                given["outliers"] = Outliers(**given["outliers"])
            return cls(**given)
        except (TypeError, ValueError) as error:
            fix = "Correct it."
            raise DesignError(f"the text is not an analysis plan: {error}", where="analysis", fix=fix) from error


def _choice_findings(alpha: object, choices: Mapping[str, object], blocks: object) -> Iterator[Finding]:
    if not isinstance(alpha, int | float) or not 0 < alpha < 0.5:  # noqa: PLR2004 - 1 - 2 alpha is a level of confidence
        yield Finding.error("analysis", f"alpha is {alpha!r}", "Give a number between 0 and 0.5, such as 0.05.")
    for kind in _CHOICES:
        given = choices[kind.__name__.lower()]
        if not isinstance(given, kind):
            names = ", ".join(f"{kind.__name__}.{each.name}" for each in kind)
            yield Finding.error("analysis", f"{kind.__name__.lower()} is {given!r}", f"Give one of {names}.")
    if blocks is not None and not isinstance(blocks, str):
        yield Finding.error("analysis", f"blocks is {blocks!r}", "Give the name of a factor, or 'Repetition'.")


def _hypotheses_findings(hypotheses: object) -> Iterator[Finding]:
    if not isinstance(hypotheses, Sequence) or isinstance(hypotheses, str):
        yield Finding.error("analysis", f"hypotheses is {hypotheses!r}", "Give a list of Hypothesis(...).")
        return
    for each in hypotheses:
        if not isinstance(each, Hypothesis):
            fix = "Write Hypothesis(statement, measure=..., factors=...)."
            yield Finding.error("analysis", f"{each!r} is not a hypothesis", fix)
    stated = [each.statement for each in hypotheses if isinstance(each, Hypothesis)]
    for statement in dict.fromkeys(each for each in stated if stated.count(each) > 1):
        fix = "Say in each what it is about: by its statement the report tells one from the other."
        yield Finding.error("analysis", f"{stated.count(statement)} hypotheses state {statement!r}", fix)


def _covariate_findings(covariates: Sequence[str], primary: Sequence[str], estimand: Estimand) -> Iterator[Finding]:
    for name in covariates:
        if name in primary:
            fix = "Name it in `secondary` where it is of interest itself."
            yield Finding.error("analysis", f"{name!r} is a primary measure and a covariate", fix)
    if covariates and estimand is Estimand.TRIMMED_MEAN:
        fix = "Take Estimand.MEAN or Estimand.RANK."
        yield Finding.error("analysis", "trimmed means are not adjusted for covariates", fix)
