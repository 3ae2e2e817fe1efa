"""What is fixed for the analysis before the experiment: its measures, its level of significance, its hypotheses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import DesignError, Finding, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import Self

__all__ = ["AnalysisPlan", "Correction", "Hypothesis"]

_DEFAULT_ALPHA = 0.05
_KEYS = ("measures", "alpha", "correction", "hypotheses")


class Correction(Enum):
    """How p-values are adjusted where many comparisons are made.

    HOLM bounds the chance of any false discovery (Holm 1979), BENJAMINI_HOCHBERG the share of false ones among all
    discoveries (Benjamini and Hochberg 1995).
    """

    HOLM = "holm"
    BENJAMINI_HOCHBERG = "benjamini-hochberg"


@dataclass(frozen=True, slots=True, init=False)
class Hypothesis:
    """A statement that the experiment is to test: that factors have an effect on a measure.

    Attributes:
        statement: the hypothesis in words.
        measure: the measure that it is about.
        factors: the factor whose effect it claims; several for an interaction.

    Raises:
        DesignError: one of them is empty or of a wrong type.

    Example:
        >>> Hypothesis("The task affects the energy of a mission.", measure="Energy", factors="Task").factors
        ('Task',)
    """

    statement: str
    measure: str
    factors: tuple[str, ...]

    def __init__(self, statement: str, *, measure: str, factors: str | Sequence[str]) -> None:
        object.__setattr__(self, "statement", statement)
        object.__setattr__(self, "measure", measure)
        object.__setattr__(self, "factors", _names(factors))
        findings = [*_text_findings(self), *_names_findings(f"hypothesis {statement!r}", "factors", self.factors)]
        if not self.factors:
            findings.append(
                Finding.error(f"hypothesis {statement!r}", "the hypothesis names no factor", "Give factors=...")
            )
        if findings:
            raise DesignError.of_findings(findings)


@dataclass(frozen=True, slots=True, init=False)
class AnalysisPlan:
    """The choices of the analysis that are fixed before the experiment (pre-registered).

    It is validated with the config and kept in the manifest. Statistics then tell what was planned from what is
    exploratory.

    Attributes:
        measures: the measures that are analysed as planned; those of the hypotheses belong to them.
        alpha: the level of significance.
        correction: how p-values are adjusted where many comparisons are made.
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
    alpha: float
    correction: Correction
    hypotheses: tuple[Hypothesis, ...]

    def __init__(
        self,
        measures: str | Sequence[str] = (),
        *,
        alpha: float = _DEFAULT_ALPHA,
        correction: Correction = Correction.HOLM,
        hypotheses: Sequence[Hypothesis] = (),
    ) -> None:
        findings = [*_choice_findings(alpha, correction), *_hypotheses_findings(hypotheses)]
        findings += _names_findings("analysis", "measures", _names(measures))
        if not findings and not (measures or hypotheses):
            findings.append(Finding.error("analysis", "the plan names no measure", "Give measures=[...]."))
        if findings:
            raise DesignError.of_findings(findings)
        listed = (*_names(measures), *(hypothesis.measure for hypothesis in hypotheses))
        object.__setattr__(self, "measures", tuple(dict.fromkeys(listed)))
        object.__setattr__(self, "alpha", float(alpha))
        object.__setattr__(self, "correction", correction)
        object.__setattr__(self, "hypotheses", tuple(hypotheses))

    def findings(self, factors: Sequence[str], measures: Sequence[str]) -> Iterator[Finding]:
        """Say which names of the plan a design does not have.

        Args:
            factors: the factors of the design.
            measures: the measures that have a column in its run table.

        Yields:
            An error finding for each name.
        """
        for name in self.measures:
            if name not in measures:
                yield Finding.error("analysis", f"there is no measure {name!r}", did_you_mean(name, measures))
        for hypothesis in self.hypotheses:
            for name in hypothesis.factors:
                if name not in factors:
                    where = f"analysis, hypothesis {hypothesis.statement!r}"
                    yield Finding.error(where, f"there is no factor {name!r}", did_you_mean(name, factors))

    def as_mapping(self) -> dict[str, Any]:
        """Return the plan as plain data, for the manifest."""
        return {
            "measures": list(self.measures),
            "alpha": self.alpha,
            "correction": self.correction.value,
            "hypotheses": [
                {"statement": each.statement, "measure": each.measure, "factors": list(each.factors)}
                for each in self.hypotheses
            ],
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
                alpha=plain.get("alpha", _DEFAULT_ALPHA),
                correction=Correction(plain.get("correction", Correction.HOLM.value)),
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


def _choice_findings(alpha: object, correction: object) -> Iterator[Finding]:
    if not isinstance(alpha, int | float) or not 0 < alpha < 1:
        yield Finding.error("analysis", f"alpha is {alpha!r}", "Give a number between 0 and 1, such as 0.05.")
    if not isinstance(correction, Correction):
        names = ", ".join(f"Correction.{each.name}" for each in Correction)
        yield Finding.error("analysis", f"correction is {correction!r}", f"Give one of {names}.")


def _hypotheses_findings(hypotheses: object) -> Iterator[Finding]:
    if not isinstance(hypotheses, Sequence) or isinstance(hypotheses, str):
        yield Finding.error("analysis", f"hypotheses is {hypotheses!r}", "Give a list of Hypothesis(...).")
        return
    for each in hypotheses:
        if not isinstance(each, Hypothesis):
            fix = "Write Hypothesis(statement, measure=..., factors=...)."
            yield Finding.error("analysis", f"{each!r} is no hypothesis", fix)
