"""What is fixed for the analysis before the experiment: measures, what is estimated, the tests, and the hypotheses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any

from robot_runner.core.design.columns import REPETITION
from robot_runner.core.errors import DesignError, Finding, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import Self

__all__ = ["AnalysisPlan", "Correction", "Estimand", "Family", "Hypothesis", "Statistic"]

_DEFAULT_ALPHA = 0.05
_KEYS = ("measures", "secondary", "alpha", "correction", "family", "estimand", "statistic", "blocks", "hypotheses")
#: Weights of a contrast that sum up to less are a sum of zero but for rounding.
_ROUNDING = 1e-9


class Correction(Enum):
    """How p-values are adjusted where many comparisons are made.

    HOLM bounds the chance of any false discovery (Holm 1979), BENJAMINI_HOCHBERG the share of false ones among all
    discoveries (Benjamini and Hochberg 1995).
    """

    HOLM = "holm"
    BENJAMINI_HOCHBERG = "benjamini-hochberg"


class Estimand(Enum):
    """What is estimated of each treatment, and compared.

    MEAN is what sums up to a bill of energy; TRIMMED_MEAN leaves out the fifth at either end (Yuen 1974), of runs that
    belong to no blocks; RANK asks how probably a run of one treatment has the larger value (Brunner, Dette and Munk
    1997).
    """

    MEAN = "mean"
    TRIMMED_MEAN = "trimmed mean"
    RANK = "rank"


class Statistic(Enum):
    """What tests an effect of several degrees of freedom among runs of their own.

    WELCH_JAMES weighs differences by how well they are known (Welch 1951, Johansen 1980); ANOVA_TYPE does not, and
    finds more where few runs have equal spreads (Brunner, Dette and Munk 1997). COMBINED is a mean of both p-values,
    and hardly finds less than the better one.
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


@dataclass(frozen=True, slots=True, init=False)
class Hypothesis:
    """A statement that the experiment is to test.

    It claims that factors have an effect on a measure; with a contrast, that a weighted sum of the means of a factor's
    treatments is not zero; with a bound, that a difference of two means is smaller than it (equivalence).

    Attributes:
        statement: the hypothesis in words.
        measure: the measure that it is about.
        factors: the factor whose effect it claims; several for an interaction.
        contrast: the weight of each treatment, of one factor; the weights sum up to zero. Others have none.
        within: the bound of equivalence, in the measure's unit; without a contrast the factor has two treatments.

    Raises:
        DesignError: one of them is empty or of a wrong type.

    Example:
        >>> Hypothesis("The task affects the energy of a mission.", measure="Energy", factors="Task").factors
        ('Task',)
        >>> Hypothesis("Video costs no more than 5 J.", measure="Energy", factors="Task",
        ...            contrast={"Video": 1, "Idle": -1}, within=5).within
        5.0
    """

    statement: str
    measure: str
    factors: tuple[str, ...]
    contrast: Mapping[str, float] | None
    within: float | None

    def __init__(
        self,
        statement: str,
        *,
        measure: str,
        factors: str | Sequence[str],
        contrast: Mapping[str, float] | None = None,
        within: float | None = None,
    ) -> None:
        object.__setattr__(self, "statement", statement)
        object.__setattr__(self, "measure", measure)
        object.__setattr__(self, "factors", _names(factors))
        where = f"hypothesis {statement!r}"
        findings = [*_text_findings(self), *_names_findings(where, "factors", self.factors)]
        findings += _contrast_findings(where, self.factors, contrast, within)
        if not self.factors:
            findings.append(Finding.error(where, "the hypothesis names no factor", "Give factors=..."))
        if findings:
            raise DesignError.of_findings(findings)
        weights = None if contrast is None else {str(name): float(weight) for name, weight in contrast.items()}
        object.__setattr__(self, "contrast", weights)
        object.__setattr__(self, "within", None if within is None else float(within))

    def as_mapping(self) -> dict[str, Any]:
        """Return the hypothesis as plain data; what it does not have is left out."""
        plain: dict[str, Any] = {
            "statement": self.statement,
            "measure": self.measure,
            "factors": list(self.factors),
            "contrast": None if self.contrast is None else dict(self.contrast),
            "within": self.within,
        }
        return {name: value for name, value in plain.items() if value is not None}


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

    Raises:
        DesignError: a choice cannot be; `findings` lists everything that was found.

    Example:
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

    def __init__(  # noqa: PLR0913 - keywords, of which a plan gives two or three
        self,
        measures: str | Sequence[str] = (),
        *,
        secondary: str | Sequence[str] = (),
        alpha: float = _DEFAULT_ALPHA,
        correction: Correction = Correction.HOLM,
        family: Family = Family.PRIMARY,
        estimand: Estimand = Estimand.MEAN,
        statistic: Statistic = Statistic.COMBINED,
        blocks: str | None = None,
        hypotheses: Sequence[Hypothesis] = (),
    ) -> None:
        choices = {"correction": correction, "family": family, "estimand": estimand, "statistic": statistic}
        findings = [*_choice_findings(alpha, choices, blocks), *_hypotheses_findings(hypotheses)]
        findings += _names_findings("analysis", "measures", _names(measures))
        findings += _names_findings("analysis", "secondary", _names(secondary))
        if not findings and not (measures or hypotheses):
            findings.append(Finding.error("analysis", "the plan names no measure", "Give measures=[...]."))
        if not findings and family is Family.HYPOTHESES and not hypotheses:
            fix = "Give hypotheses=[...], or another family."
            findings.append(Finding.error("analysis", "the family is that of the hypotheses, and there are none", fix))
        if findings:
            raise DesignError.of_findings(findings)
        primary = tuple(dict.fromkeys((*_names(measures), *(hypothesis.measure for hypothesis in hypotheses))))
        object.__setattr__(self, "measures", primary)
        object.__setattr__(self, "secondary", tuple(name for name in _names(secondary) if name not in primary))
        object.__setattr__(self, "alpha", float(alpha))
        for name, choice in choices.items():
            object.__setattr__(self, name, choice)
        object.__setattr__(self, "blocks", blocks)
        object.__setattr__(self, "hypotheses", tuple(hypotheses))

    def findings(self, factors: Sequence[str], measures: Sequence[str]) -> Iterator[Finding]:
        """Say which names of the plan a design does not have.

        Args:
            factors: the factors of the design.
            measures: the measures that have a column in its run table.

        Yields:
            An error finding for each name.
        """
        for name in (*self.measures, *self.secondary):
            if name not in measures:
                yield Finding.error("analysis", f"there is no measure {name!r}", did_you_mean(name, measures))
        if self.blocks is not None and self.blocks not in (*factors, REPETITION):
            problem = f"there is no factor {self.blocks!r} whose treatments could be blocks"
            yield Finding.error("analysis", problem, did_you_mean(self.blocks, (*factors, REPETITION)))
        for hypothesis in self.hypotheses:
            for name in hypothesis.factors:
                if name not in factors:
                    where = f"analysis, hypothesis {hypothesis.statement!r}"
                    yield Finding.error(where, f"there is no factor {name!r}", did_you_mean(name, factors))

    def as_mapping(self) -> dict[str, Any]:
        """Return the plan as plain data, for the manifest."""
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
        }

    @classmethod
    def of_mapping(cls, plain: Mapping[str, Any]) -> Self:
        """Return the plan that `as_mapping` made plain.

        Raises:
            DesignError: it is no such plan.
        """
        unknown = [str(key) for key in plain if key not in _KEYS]
        if unknown:
            problem = f"there is no choice {unknown[0]!r}"
            raise DesignError(problem, where="analysis", fix=did_you_mean(unknown[0], _KEYS))
        try:
            return cls(
                plain.get("measures", ()),
                secondary=plain.get("secondary", ()),
                alpha=plain.get("alpha", _DEFAULT_ALPHA),
                correction=Correction(plain.get("correction", Correction.HOLM.value)),
                family=Family(plain.get("family", Family.PRIMARY.value)),
                estimand=Estimand(plain.get("estimand", Estimand.MEAN.value)),
                statistic=Statistic(plain.get("statistic", Statistic.COMBINED.value)),
                blocks=plain.get("blocks"),
                hypotheses=[Hypothesis(**each) for each in plain.get("hypotheses", ())],
            )
        except (TypeError, ValueError) as error:
            raise DesignError(f"the text is no analysis plan: {error}", where="analysis", fix="Mend it.") from error


def _names(given: object) -> tuple[Any, ...]:
    if isinstance(given, str):
        return (given,)
    return tuple(given) if isinstance(given, Sequence) else (given,)


def _text_findings(hypothesis: Hypothesis) -> Iterator[Finding]:
    for name in ("statement", "measure"):
        value = getattr(hypothesis, name)
        if not isinstance(value, str) or not value.strip():
            yield Finding.error(f"hypothesis {hypothesis.statement!r}", f"{name} is {value!r}", "Give a text.")


def _names_findings(where: str, what: str, names: tuple[Any, ...]) -> Iterator[Finding]:
    for name in names:
        if not isinstance(name, str):
            problem = f"{what} has {name!r}, of type {type(name).__name__}"
            yield Finding.error(where, problem, "Give names, such as 'Energy'.")


def _contrast_findings(where: str, factors: tuple[Any, ...], contrast: object, within: object) -> Iterator[Finding]:
    if within is not None and not (_is_number(within) and within > 0):  # type: ignore[operator]
        yield Finding.error(where, f"within is {within!r}", "Give a bound above 0, in the measure's unit.")
    if (contrast is not None or within is not None) and len(factors) > 1:
        yield Finding.error(where, "a contrast or a bound is of one factor, and several are named", "Name one factor.")
    if contrast is None:
        return
    if not isinstance(contrast, Mapping) or not all(map(_is_number, contrast.values())):
        fix = "Give the weight of each treatment, such as {'Video': 1, 'Idle': -1}."
        yield Finding.error(where, f"contrast is {contrast!r}", fix)
    elif len(contrast) < 2 or not any(contrast.values()) or abs(sum(contrast.values())) > _ROUNDING:  # noqa: PLR2004
        fix = "Give two and more weights that sum up to 0."
        yield Finding.error(where, f"the weights of the contrast are {dict(contrast)!r}", fix)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _choice_findings(alpha: object, choices: Mapping[str, object], blocks: object) -> Iterator[Finding]:
    if not isinstance(alpha, int | float) or not 0 < alpha < 1:
        yield Finding.error("analysis", f"alpha is {alpha!r}", "Give a number between 0 and 1, such as 0.05.")
    for kind in (Correction, Family, Estimand, Statistic):
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
            yield Finding.error("analysis", f"{each!r} is no hypothesis", fix)
