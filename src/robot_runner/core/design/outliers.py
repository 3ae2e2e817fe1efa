"""Rules of an analysis plan on which values are left out: outliers, and doubtful values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from robot_runner.core.design.numeric_range import is_number
from robot_runner.core.errors import DesignError, Finding
from robot_runner.core.words import exact

_ENDS = 2
_WHERE = "analysis, outliers"


class Doubtful(Enum):
    """How the analysis handles doubtful values.

    KEEP analyses them with all others, LEAVE_OUT does not; both results are shown either way. REFUSE draws no
    conclusion on a measure that has any.
    """

    KEEP = "keep"
    LEAVE_OUT = "leave out"
    REFUSE = "refuse"


@dataclass(frozen=True, slots=True, init=False)
class Outliers:
    """The rule by which values are left out as outliers, for each measure separately.

    Nothing is deleted, and the result with all runs is shown beside the planned one.

    Attributes:
        interquartile_ranges: a value is an outlier if it is so many interquartile ranges beyond the quartiles of its
            combination (Tukey, Exploratory Data Analysis, 1977: 1.5, or 3 for far out).
        median_deviations: a value is an outlier if it is so many median absolute deviations, scaled to be standard
            deviations of normal values, from the median of its combination (Leys et al., Detecting outliers: do not use
            standard deviation around the mean, 2013: 2.5, or 3 to be conservative).
        bounds: the lowest and the highest plausible value, in the measure's unit, by measure; None for no bound.

    Raises:
        DesignError: there is no rule, or both rules of spread.

    Example:
        >>> Outliers(median_deviations=3, bounds={"Energy": (0, None)}).in_words("Energy", "J")
        'more than 3 median absolute deviations from the median of its combination, or below 0 J'
    """

    interquartile_ranges: float | None
    median_deviations: float | None
    bounds: Mapping[str, tuple[float | None, float | None]]

    def __init__(
        self,
        *,
        interquartile_ranges: float | None = None,
        median_deviations: float | None = None,
        bounds: Mapping[str, Sequence[float | None]] | None = None,
    ) -> None:
        findings = [*_spread_findings(interquartile_ranges, median_deviations), *_bounds_findings(bounds)]
        if not findings and interquartile_ranges is median_deviations is None and not bounds:
            fix = "Give interquartile_ranges=3, median_deviations=3, or bounds={measure: (low, high)}."
            findings.append(Finding.error(_WHERE, "there is no rule", fix))
        DesignError.refuse(findings)
        object.__setattr__(self, "interquartile_ranges", _float(interquartile_ranges))
        object.__setattr__(self, "median_deviations", _float(median_deviations))
        pairs = {name: (_float(low), _float(high)) for name, (low, high) in (bounds or {}).items()}
        object.__setattr__(self, "bounds", pairs)

    def in_words(self, measure: str, unit: str = "") -> str:
        """Return in words which values of a measure the rule leaves out; empty where it has no rule for it."""
        parts = []
        if self.interquartile_ranges is not None:
            of = "interquartile ranges beyond the quartiles of its combination"
            parts.append(f"more than {exact(self.interquartile_ranges)} {of}")
        if self.median_deviations is not None:
            of = "median absolute deviations from the median of its combination"
            parts.append(f"more than {exact(self.median_deviations)} {of}")
        low, high = self.bounds.get(measure, (None, None))
        ends = ((word, end) for word, end in (("below", low), ("above", high)) if end is not None)
        return ", or ".join([*parts, *(f"{word} {exact(end)} {unit}".rstrip() for word, end in ends)])

    def as_mapping(self) -> dict[str, Any]:
        """Return the rule as plain data, without what is None."""
        plain: dict[str, Any] = {
            "interquartile_ranges": self.interquartile_ranges,
            "median_deviations": self.median_deviations,
            "bounds": {name: list(ends) for name, ends in self.bounds.items()} or None,
        }
        return {name: value for name, value in plain.items() if value is not None}


def _float(value: float | None) -> float | None:
    return None if value is None else float(value)


def _spread_findings(ranges: object, deviations: object) -> Iterator[Finding]:
    for name, value in (("interquartile_ranges", ranges), ("median_deviations", deviations)):
        if value is not None and not (is_number(value) and value > 0):
            yield Finding.error(_WHERE, f"{name} is {value!r}", "Give a number above 0, such as 3.")
    if ranges is not None and deviations is not None:
        yield Finding.error(_WHERE, "there are two rules of spread", "Give interquartile_ranges or median_deviations.")


def _bounds_findings(bounds: object) -> Iterator[Finding]:
    fix = "Give the lowest and the highest plausible value, such as {'Energy': (0, 5000)}; None for no bound."
    if bounds is None:
        return
    if not isinstance(bounds, Mapping) or not all(isinstance(name, str) for name in bounds):
        yield Finding.error(_WHERE, f"bounds is {bounds!r}", fix)
        return
    for name, ends in bounds.items():
        pair = tuple(ends) if isinstance(ends, list | tuple) else ()
        given = [end for end in pair if end is not None]
        if len(pair) != _ENDS or not given or not all(map(is_number, given)) or given != sorted(set(given)):
            yield Finding.error(_WHERE, f"the bounds of {name} are {ends!r}", fix)
