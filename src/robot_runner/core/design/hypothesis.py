"""Hypotheses: an effect, a contrast of means, their equivalence or non-inferiority."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from robot_runner.core.design.numeric_range import is_number
from robot_runner.core.errors import DesignError, Finding, did_you_mean

#: Weights of a contrast whose sum is smaller count as summing up to zero (rounding).
_ROUNDING = 1e-9
_OF_A_BOUND = 2


@dataclass(frozen=True, slots=True, init=False)
class Hypothesis:
    """A statement that the experiment is to test.

    It claims that factors have an effect on a measure; with a contrast, that a weighted sum of the means of a factor's
    treatments is not zero; with a bound, that a difference of two means is smaller than it in size (equivalence), or
    that the weighted sum is smaller than it (non-inferiority, and with the bound 0 a direction).

    Attributes:
        statement: the hypothesis in words.
        measure: the measure that it is about.
        factors: the factor whose effect it claims; several for an interaction.
        contrast: the weight of each treatment, of one factor; the weights sum up to zero. Others have none.
        within: the bound of equivalence, in the measure's unit (percentage points of what is yes or no); without a
            contrast the factor has two treatments.
        below: the bound that the contrast is smaller than, in the same unit; it may be 0 or negative.

    Raises:
        DesignError: an attribute is empty or of a wrong type.

    Example:
        >>> Hypothesis("The task affects the energy of a mission.", measure="Energy", factors="Task").factors
        ('Task',)
        >>> Hypothesis("Video costs no more than 5 J.", measure="Energy", factors="Task",
        ...            contrast={"Video": 1, "Idle": -1}, below=5).below
        5.0
    """

    statement: str
    measure: str
    factors: tuple[str, ...]
    contrast: Mapping[str, float] | None
    within: float | None
    below: float | None

    def __init__(
        self,
        statement: str,
        *,
        measure: str,
        factors: str | Sequence[str],
        contrast: Mapping[str, float] | None = None,
        within: float | None = None,
        below: float | None = None,
    ) -> None:
        where, named = f"hypothesis {statement!r}", names_of(factors)
        findings = [*_text_findings(where, statement=statement, measure=measure)]
        findings += [*names_findings(where, "factors", named), *_bound_findings(where, contrast, within, below)]
        findings += _contrast_findings(where, named, contrast, within)
        if not named:
            findings.append(Finding.error(where, "the hypothesis names no factor", "Give factors=..."))
        DesignError.refuse(findings)
        weights = None if contrast is None else {str(name): float(weight) for name, weight in contrast.items()}
        bounds = {
            "within": None if within is None else float(within),
            "below": None if below is None else float(below),
        }
        given = {"statement": statement, "measure": measure, "factors": named, "contrast": weights, **bounds}
        for name, value in given.items():
            object.__setattr__(self, name, value)

    @property
    def is_contrast(self) -> bool:
        """Whether it claims something of a weighted sum of means; else that its factors have an effect."""
        return self.contrast is not None or self.within is not None

    @property
    def has_bound(self) -> bool:
        """Whether it claims that a weighted sum of means lies on one side of a bound, or within it."""
        return self.within is not None or self.below is not None

    def treatment_findings(self, treatments: Mapping[str, Sequence[str]]) -> Iterator[Finding]:
        """Yield a problem for each contrast, or bound, that a design's treatments, by factor, leave untested.

        Nothing is said of factors whose treatments are not given.
        """
        where, factor = f"analysis, hypothesis {self.statement!r}", self.factors[0]
        known = treatments.get(factor)
        if known is None:
            return
        for text in self.contrast or ():
            if text not in known:
                problem = f"{text!r}, in the contrast, is not a treatment of {factor!r}"
                yield Finding.error(where, problem, did_you_mean(text, known))
        if self.within is not None and self.contrast is None and len(known) != _OF_A_BOUND:
            problem = f"the bound is of two treatments, and {factor!r} has {len(known)}, so that it cannot be tested"
            yield Finding.warning(where, problem, f"Name two, as in contrast={{{known[0]!r}: 1, {known[-1]!r}: -1}}.")

    def as_mapping(self) -> dict[str, Any]:
        """Return the hypothesis as plain data, without attributes that are None."""
        plain: dict[str, Any] = {
            "statement": self.statement,
            "measure": self.measure,
            "factors": list(self.factors),
            "contrast": None if self.contrast is None else dict(self.contrast),
            "within": self.within,
            "below": self.below,
        }
        return {name: value for name, value in plain.items() if value is not None}


def names_of(given: object) -> tuple[Any, ...]:
    """Return one name or several as a tuple; elements are checked by `names_findings`."""
    if isinstance(given, str):
        return (given,)
    return tuple(given) if isinstance(given, Sequence) else (given,)


def names_findings(where: str, what: str, names: tuple[Any, ...]) -> Iterator[Finding]:
    """Yield an error for each name that is not text."""
    for name in names:
        if not isinstance(name, str):
            problem = f"{what} has {name!r}, of type {type(name).__name__}"
            yield Finding.error(where, problem, "Give names, such as 'Energy'.")


def _text_findings(where: str, **texts: object) -> Iterator[Finding]:
    for name, value in texts.items():
        if not isinstance(value, str) or not value.strip():
            yield Finding.error(where, f"{name} is {value!r}", "Give a text.")


def _bound_findings(where: str, contrast: object, within: object, below: object) -> Iterator[Finding]:
    if within is not None and not (is_number(within) and within > 0):
        yield Finding.error(where, f"within is {within!r}", "Give a bound above 0, in the measure's unit.")
    if below is not None and not is_number(below):
        yield Finding.error(where, f"below is {below!r}", "Give a bound in the measure's unit.")
    elif below is not None and contrast is None:
        fix = "Give the weight of each treatment, such as contrast={'Video': 1, 'Idle': -1}."
        yield Finding.error(where, f"nothing says which difference is to be below {below!r}", fix)
    if within is not None and below is not None:
        yield Finding.error(where, "both within and below are given", "Give one of them, or two hypotheses.")


def _contrast_findings(where: str, factors: tuple[Any, ...], contrast: object, within: object) -> Iterator[Finding]:
    if (contrast is not None or within is not None) and len(factors) > 1:
        yield Finding.error(where, "a contrast or a bound is of one factor, and several are named", "Name one factor.")
    if contrast is None:
        return
    if not isinstance(contrast, Mapping) or not all(map(is_number, contrast.values())):
        fix = "Give the weight of each treatment, such as {'Video': 1, 'Idle': -1}."
        yield Finding.error(where, f"contrast is {contrast!r}", fix)
    elif len(contrast) < 2 or not any(contrast.values()) or abs(sum(contrast.values())) > _ROUNDING:  # noqa: PLR2004
        fix = "Give two and more weights that sum up to 0."
        yield Finding.error(where, f"the weights of the contrast are {dict(contrast)!r}", fix)
    elif len(set(map(str, contrast))) < len(contrast):
        problem = f"a treatment has two weights in the contrast {dict(contrast)!r}"
        yield Finding.error(where, problem, "Write each treatment once, as in the run table.")
