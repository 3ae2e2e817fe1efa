"""The result of comparing two experiments, and the bounds of equivalence: plain data."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.analysis.wording import labelled
from robot_runner.core.errors import AnalysisError
from robot_runner.core.words import combination_label, has_true_zero, listed

if TYPE_CHECKING:
    from robot_runner.analysis.statistics.tested import Interval, NotComputed

_PERCENT = 100.0


@dataclass(frozen=True, slots=True)
class Bound:
    """The largest difference that does not matter.

    Attributes:
        value: in the unit of the measure, or a percentage of the first experiment's mean.
        is_relative: whether it is a percentage.

    Raises:
        AnalysisError: the value is not a finite number above 0, or a percentage is not below 100.

    Example:
        >>> Bound.parse("5%")
        Bound(value=5.0, is_relative=True)
    """

    value: float
    is_relative: bool = False

    def __post_init__(self) -> None:
        is_sensible = math.isfinite(self.value) and self.value > 0
        if not is_sensible or (self.is_relative and self.value >= _PERCENT):
            raise AnalysisError(
                f"the bound is {self.value:g}{' %' if self.is_relative else ''}",
                where="bound",
                fix="Give a number above 0, or a percentage between 0 and 100: --bound 5%.",
            )

    @classmethod
    def parse(cls, text: str) -> Bound:
        """Read a bound, such as `10` or `5%`.

        Raises:
            AnalysisError: the text is not a number, or not a valid bound.
        """
        is_relative = text.strip().endswith("%")
        try:
            value = float(text.strip().removesuffix("%"))
        except ValueError as error:
            fix = "Give a number in the measure's unit, or a percentage: --bound 10, or --bound 5%."
            raise AnalysisError(f"{text!r} is not a bound", where="bound", fix=fix) from error
        return cls(value, is_relative)

    def in_units(self, mean: float) -> float:
        """Return the bound in the unit of the measure, given the first experiment's mean."""
        return abs(mean) * self.value / _PERCENT if self.is_relative else self.value

    def __str__(self) -> str:
        return f"{self.value:g} %" if self.is_relative else f"{self.value:g}"


def why_meaningless(bound: Bound | None, unit: str, *, are_answers: bool) -> str:
    """Return why a bound is meaningless for this unit, or for a measure of yes and no; empty where it is not.

    Example:
        >>> why_meaningless(Bound.parse("5%"), "degC", are_answers=False)
        'a percentage says nothing of values in degC, whose 0 is agreed upon: give it in degC.'
    """
    if bound is None:
        return ""
    if are_answers and not bound.is_relative and bound.value >= 1:
        return (
            "no proportions differ by more than 1, so that the bound says nothing: give one below 1, or a percentage."
        )
    if bound.is_relative and not has_true_zero(unit):
        return f"a percentage says nothing of values in {unit}, whose 0 is agreed upon: give it in {unit}."
    return ""


@dataclass(frozen=True, slots=True)
class Bounds:
    """Bounds of several measures.

    Attributes:
        general: the bound of measures without their own; None where those have no bound.
        own: the bounds of single measures, by name.

    Example:
        >>> str(Bounds.parse(["5%", "Energy=10"]).of("Energy"))
        '10'
    """

    general: Bound | None
    own: Mapping[str, Bound]

    @classmethod
    def parse(cls, texts: Iterable[str]) -> Bounds:
        """Read bounds, each as `5%` or `10`, or for one measure as `Energy=10`.

        Raises:
            AnalysisError: a text is not a bound, or a measure has two.
        """
        general, own = stated(texts, lambda text: ("", Bound.parse(text)), "bound", "bound")
        return cls(general.get(""), {name: bound for name, (_, bound) in own.items()})

    def of(self, measure: str) -> Bound | None:
        """Return the bound of a measure, if it has one."""
        return self.own.get(measure, self.general)


def stated(
    texts: Iterable[str], read: Callable[[str], tuple[str, Bound]], what: str, where: str
) -> tuple[dict[str, Bound], dict[str, tuple[str, Bound]]]:
    """Return the bounds of all measures, by unit, and those of single measures with their units, by name.

    Raises:
        AnalysisError: a measure has two.
    """
    general: dict[str, Bound] = {}
    own: dict[str, tuple[str, Bound]] = {}
    for text in texts:
        name, equals, value = text.rpartition("=")  # the bound is a number, so the name is everything before the last =
        unit, bound = read(value)
        if name in own or (not equals and unit in general):
            raise AnalysisError(f"{text!r} is a second {what}", where=where, fix="Leave one of them out.")
        if equals:
            own[name] = unit, bound
        else:
            general[unit] = bound
    return general, own


class Verdict(Enum):
    """The conclusion on a difference: no value differs, within the bound, significant, or neither of these."""

    IDENTICAL = "identical"
    EQUIVALENT = "equivalent"
    DIFFERENT = "different"
    UNDECIDED = "undecided"

    @classmethod
    def of_all(cls, verdicts: Sequence[Verdict]) -> Verdict:
        """Return the verdict of several together: different if one is, identical only if all are.

        Example:
            >>> Verdict.of_all([Verdict.EQUIVALENT, Verdict.IDENTICAL])
            <Verdict.EQUIVALENT: 'equivalent'>
        """
        weakest_first = (cls.DIFFERENT, cls.UNDECIDED, cls.EQUIVALENT, cls.IDENTICAL)
        return next((each for each in weakest_first if each in verdicts), cls.UNDECIDED)


@dataclass(frozen=True, slots=True)
class Side:
    """One of the two experiments.

    Attributes:
        name: its name in the comparison, where the two differ.
        experiment: its own name.
        runs: the number of runs that are done.
    """

    name: str
    experiment: str
    folder: Path
    runs: int


@dataclass(frozen=True, slots=True)
class PracticalEquivalence:
    """The posterior probability that a difference is too small to matter.

    The prior of each mean and standard deviation is the reference prior, 1 / standard deviation.

    Attributes:
        region: the half-width of the region around no difference, in the unit of the measure.
        below, within, above: the probabilities that the second mean lies there, summing up to 1.
        interval: the credible interval of the difference at 1 - alpha.
    """

    region: float
    below: float
    within: float
    above: float
    interval: Interval


@dataclass(frozen=True, slots=True)
class Difference:
    """The difference of one measure in one combination: second experiment minus first.

    Attributes:
        treatments: the combination, by factor; empty for all runs together.
        first_n, second_n: the number of runs with a value; for pairs, the number of pairs.
        difference: of the means, in the unit of the measure.
        interval: confidence interval of the difference at 1 - alpha.
        narrow_interval: at 1 - 2 alpha; if the bound is in the unit of the measure, the two are equivalent exactly
            where this interval lies within the bound.
        relative: the difference in percent of the first mean; None for units with an arbitrary zero, such as degC.
        p_value: of a t-test for no difference (Welch's, or of pairs); `adjusted_p_value` is adjusted by Holm for the
            number of combinations.
        bound: the largest difference that does not matter, in the unit of the measure; None where no bound was stated,
            or where it exceeds any difference of proportions.
        equivalence_p_value: the larger p-value of the two one-sided tests.
        not_computed: why nothing was tested; empty where something was, or where nothing differs.
        practical: the probabilities of a region of practical equivalence, where one was stated.
        unit: the name of the units (blocks, whole plots, subjects, robots) whose runs count together.
        first_units, second_units: the number of these units; None where runs are independent.
        first_error, second_error: the standard errors of the means, where runs count together.
    """

    treatments: Mapping[str, str]
    first_n: int
    second_n: int
    first_mean: float | None = None
    second_mean: float | None = None
    first_sd: float | None = None
    second_sd: float | None = None
    difference: float | None = None
    interval: Interval | None = None
    narrow_interval: Interval | None = None
    relative: float | None = None
    p_value: float | None = None
    adjusted_p_value: float | None = None
    bound: float | None = None
    equivalence_p_value: float | None = None
    verdict: Verdict = Verdict.UNDECIDED
    not_computed: str = ""
    practical: PracticalEquivalence | None = None
    unit: str = ""
    first_units: int | None = None
    second_units: int | None = None
    first_error: float | None = None
    second_error: float | None = None

    @property
    def label(self) -> str:
        """The combination in words."""
        return combination_label(self.treatments.values()) or "all runs"


@dataclass(frozen=True, slots=True)
class Agreement:
    """How far a run of the second experiment may lie from one of the first (Bland and Altman, 1986).

    Attributes:
        pairs: the values of the first and of the second experiment, by combination.
        are_natural: whether the pairs belong together (the same run, or paired by the user); otherwise runs of one
            combination were paired in the order of the run tables.
        bias: the mean difference, also of runs beyond those in pairs; combinations count by their pairs.
        lower, upper: limits of agreement: bias minus and plus 1.96 standard deviations of the differences; None for
            measures of yes and no.
        error: mean absolute percentage error in percent: of pairs if they are natural, else of the combinations' means;
            None where a value of the first is 0, and for units with an arbitrary zero.
    """

    pairs: Mapping[str, Sequence[tuple[float, float]]]
    are_natural: bool
    bias: float
    lower: float | None
    upper: float | None
    error: float | None


@dataclass(frozen=True, slots=True)
class MeasureComparison:
    """One measure of two experiments.

    Attributes:
        first_name, second_name: its name in each experiment.
        unit: its unit in the first experiment.
        first_origin, second_origin: where the values come from.
        region: of practical equivalence, as stated, in the unit of the measure.
        verdict: of all combinations together.
        not_computed: what could not be compared, with the reason.
        are_answers: whether its values are yes or no in both experiments, so that its means are proportions.
        procedure: the test of the difference, in words.
        largest: the largest difference, in words; empty where none is known.
    """

    first_name: str
    second_name: str
    unit: str
    first_origin: str | None
    second_origin: str | None
    bound: Bound | None
    differences: tuple[Difference, ...]
    agreement: Agreement | None
    verdict: Verdict
    conclusion: str
    not_computed: tuple[NotComputed, ...] = ()
    region: Bound | None = None
    are_answers: bool = False
    procedure: str = ""
    largest: str = ""

    @property
    def name(self) -> str:
        """The name of the measure; both names where they differ."""
        return self.first_name if self.first_name == self.second_name else f"{self.first_name} and {self.second_name}"

    @property
    def label(self) -> str:
        """The name with the unit."""
        return labelled(self.name, self.unit)


@dataclass(frozen=True, slots=True)
class Comparison:
    """Two experiments compared.

    Attributes:
        factors: the factors of both, by which runs are matched.
        differing: circumstances that differ: the circumstance, its value in the first and in the second.
        notes: notes for readers, such as combinations that only one experiment has.
        together: the units, such as days, whose runs count together.
        again: why the second experiment has the same runs as the first, so that agreement proves nothing; else empty.
    """

    first: Side
    second: Side
    alpha: float
    factors: tuple[str, ...]
    is_paired: bool
    measures: tuple[MeasureComparison, ...]
    differing: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...]
    together: tuple[str, ...] = ()
    again: str = ""

    def __repr__(self) -> str:
        """Return what a notebook shows: all numbers would fill pages."""
        verdicts = listed(f"{each.first_name} {each.verdict.value}" for each in self.measures)
        return f"<Comparison of {self.second.name} with {self.first.name}: {verdicts}>"

    @property
    def verdict(self) -> Verdict:
        """The verdict of all measures together."""
        return Verdict.of_all([measure.verdict for measure in self.measures])

    def measure(self, name: str) -> MeasureComparison:
        """Return the comparison of one measure, by its name in the first experiment.

        Raises:
            KeyError: the measure was not compared.
        """
        return {each.first_name: each for each in self.measures}[name]
