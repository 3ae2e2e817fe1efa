"""The facts of a study for a recomputation, besides the numbers of its run table, as plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robot_runner.analysis.recomputing.designed_facts import Designed, SurfaceFacts
    from robot_runner.analysis.recomputing.reported import Number, Reported
    from robot_runner.analysis.statistics.tested import AssumptionCheck
    from robot_runner.core.design.hypothesis import Hypothesis


@dataclass(frozen=True, slots=True)
class FactorColumn:
    """A factor: its treatments in their order, with their spellings in the file and in the report."""

    name: str
    texts: tuple[str, ...]
    labels: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class TableSource:
    """The facts for reading the run table.

    Attributes:
        path, checksum: relative to the folder of the script, and MD5, to detect changes of the table.
        delimiter: between cells; with a semicolon, the decimal separator is a comma.
        renamed: columns whose headings differ from their names: the position from 1, and the name.
        done: the status texts of runs that are done.
        missing, yes: the texts of missing values, and those of yes, as they stand in the file.
        has_exclusions, has_warm_ups: whether there is a column of the reasons of exclusions, and one of warm-up runs.
        batch, confirming: the column of batches, and those that confirm the results of a search: only they are used.
        run_ids: the used runs, if the columns do not determine them.
        stamp: the column of the time stamps for the order of execution; empty for the order of the table.
        places: the place of each run in that order, if the column does not determine it.
    """

    path: str
    checksum: str
    delimiter: str
    renamed: tuple[tuple[int, str], ...]
    done: tuple[str, ...]
    missing: tuple[str, ...]
    yes: tuple[str, ...]
    has_exclusions: bool
    has_warm_ups: bool
    batch: str
    confirming: tuple[str, ...]
    run_ids: tuple[str, ...]
    stamp: str
    places: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class TestedEffect:
    """An effect, and the procedures of its test and its check.

    Attributes:
        key: its unique name in the study.
        test, check: names of procedures; empty if there is none.
        drawn: the p-value of the report, if it is simulated.
        check_is_drawn: whether that of the check is simulated.
        levels: the treatments of its factors where all of them apply; empty without conditional factors.
    """

    key: str
    label: str
    factors: tuple[str, ...]
    test: str
    check: str
    drawn: Number
    check_is_drawn: bool
    levels: tuple[tuple[str, tuple[str, ...]], ...] = ()


@dataclass(frozen=True, slots=True)
class Paired:
    """All pairs of the treatments of one factor, or of the combinations of several.

    Attributes:
        others: the other factors, whose combinations are compared separately.
        chosen: the numbers of the compared pairs, from 1; empty if all are compared.
        exact: the numbers, from 1, and treatments of the pairs of proportions that have the exact test.
    """

    key: str
    factors: tuple[str, ...]
    others: tuple[str, ...]
    reported: Reported
    adjusted: Reported
    chosen: tuple[int, ...]
    exact: tuple[tuple[int, str, str], ...]


@dataclass(frozen=True, slots=True)
class Contrasted:
    """The contrast of a hypothesis.

    Attributes:
        key, weights: its unique name in the study, and the weights by treatment.
        others, most: of proportions, the other factors, and as how many runs those of a treatment count at the most.
    """

    key: str
    hypothesis: Hypothesis
    factor: str
    weights: Mapping[str, float]
    level: float
    others: tuple[str, ...] = ()
    most: float | None = None


@dataclass(frozen=True, slots=True)
class Compared:
    """The comparisons of a measure.

    Attributes:
        kind: `runs` (independent ones), `blocks`, a `linear` or a `mixed` model; for special designs `strata`,
            `surface`, or `lenth` for unreplicated fractions.
        factors: the compared factors, with their treatments as in the report.
        between: for `blocks`, the factors that differ between them.
        estimand: `mean`, `trimmed mean` or `rank`.
        has_check: whether there is a check of ranks or means.
        is_extended: whether runs are compared within batches.
        dropped: runs that cannot be compared within batches.
        left_out: runs of incomplete blocks.
        effects, tested: the tested effects, and their table in the report; likewise pairs and contrasts.
        of: the kind of check: `ranks` or `means`.
        d_name: the name of standardised differences.
        is_uniform: whether all combinations vary.
        terms: for an incomplete factorial, the estimated effects, each as whether it includes each factor.
        nested: the conditions of conditional factors: the treatments of parents, by factor.
        units: for `strata`, the columns of blocks within which repeated runs of a combination are averaged.
        responses: for `strata`, the factors to whose effects each unit tells its response.
        has_plots: whether there is a stratum of whole plots.
        surface: the polynomial of a `surface`.
    """

    kind: str
    factors: tuple[tuple[str, tuple[str, ...]], ...]
    between: tuple[str, ...]
    estimand: str
    is_extended: bool
    dropped: tuple[str, ...]
    left_out: tuple[str, ...]
    effects: tuple[TestedEffect, ...]
    tested: Reported
    pairs: tuple[Paired, ...]
    contrasts: tuple[Contrasted, ...]
    contrasted: Reported
    of: str
    d_name: str
    has_check: bool
    is_uniform: bool
    terms: tuple[tuple[bool, ...], ...] = ()
    nested: tuple[tuple[str, tuple[tuple[str, tuple[str, ...]], ...]], ...] = ()
    units: tuple[str, ...] = ()
    responses: tuple[str, ...] = ()
    has_plots: bool = False
    surface: SurfaceFacts | None = None

    @property
    def is_reduced(self) -> bool:
        """Whether repeated runs of a combination within blocks are averaged."""
        return self.kind == "mixed" or bool(self.units)

    @property
    def names(self) -> tuple[str, ...]:
        """The compared factors."""
        return tuple(name for name, _ in self.factors)

    @property
    def within(self) -> tuple[str, ...]:
        """The factors that differ within blocks."""
        return tuple(name for name in self.names if name not in self.between)

    @property
    def is_plain(self) -> bool:
        """Whether R and scipy have functions for the comparison: independent runs of one factor."""
        of_runs = self.kind == "runs" and len(self.factors) == 1 and not self.is_extended
        return of_runs and self.is_uniform and self.estimand != "trimmed mean"


@dataclass(frozen=True, slots=True)
class Answered:
    """A yes-or-no measure.

    Attributes:
        is_blocked, is_extended: whether runs are compared within blocks, and within batches.
        effects: of each tested factor its name, the other factors, its key, and its p-value if that is simulated.
        treatments: the pairs of each factor; the rest is as in `Compared`.
    """

    is_blocked: bool
    is_extended: bool
    effects: tuple[tuple[str, tuple[str, ...], str, float | None], ...]
    tested: Reported
    pairs: tuple[Paired, ...]
    treatments: tuple[tuple[tuple[str, str], ...], ...]
    contrasts: tuple[Contrasted, ...]
    contrasted: Reported


@dataclass(frozen=True, slots=True)
class MeasureFacts:
    """A measure, in the planned analysis or in a sensitivity analysis.

    Attributes:
        key: its unique name: the measure and the analysis.
        left_out: the runs whose values are left out.
        distributed: the checks of distribution assumptions; `distribution` is the table of their results.
        compared: the comparisons; None if there are none, or if scripts do not support them.
        effect_keys, contrast_keys: the unique name of each test in the study, by factors and by statement.
        taken: p-values of tests that are not recomputed, by their keys.
        skipped: how many numbers of the report are not recomputed.
        level: of the interval of a mean: above 0.95 if runs were added until it was narrow.
    """

    key: str
    name: str
    label: str
    factors: tuple[str, ...]
    left_out: tuple[str, ...]
    described: tuple[tuple[tuple[str, ...], Reported], ...]
    is_extended: bool
    distributed: tuple[AssumptionCheck, ...]
    distribution: Reported
    quantiles: Reported
    drift: Reported
    power: Reported
    compared: Compared | None
    effect_keys: Mapping[tuple[str, ...], str]
    contrast_keys: Mapping[str, str]
    taken: Mapping[str, float]
    skipped: int
    level: float
    answered: Answered | None = None
    designed: Designed | None = None

    @property
    def covariates(self) -> tuple[str, ...]:
        """The covariates that residuals are adjusted for: measures or `order`."""
        return () if self.designed is None else self.designed.covariates

    @property
    def pairs(self) -> tuple[Paired, ...]:
        """All pairwise comparisons."""
        return tuple(each for of in (self.compared, self.answered) if of is not None for each in of.pairs)


@dataclass(frozen=True, slots=True)
class Adjustment:
    """A family of tests by their keys, and the tests whose results the report shows."""

    name: str
    keys: tuple[str, ...]
    shown: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class StudyFacts:
    """The context of the templates.

    Attributes:
        made: when and by which version the script was made.
        factors: all factors of the runs that are done.
        varied: those with two or more treatments.
        numbers: the columns that are read as numbers.
        block: the column of the blocks; empty without blocks.
        blocks_are_of_batches: whether the numbers of blocks begin anew in each batch.
        units: without blocks, the columns of the experimental unit of a run; empty for independent runs.
        batch: the column of the batches; empty without batches.
        correlated: the pairs of correlated measures, each with its factors.
        without_within: the number of pairs whose correlation within treatments scripts do not support.
        correlated_designs: for a special design, the correlated measures with their factors and models.
        correlated_without: the correlated measures with values that are left out, with the runs of these.
        possible: the number of possible combinations; None without conditional factors.
    """

    name: str
    made: str
    alpha: float
    correction: str
    source: TableSource
    factors: tuple[FactorColumn, ...]
    varied: tuple[str, ...]
    numbers: tuple[str, ...]
    block: str
    blocks_are_of_batches: bool
    units: tuple[str, ...]
    batch: str
    design: Reported
    measures: tuple[MeasureFacts, ...]
    families: tuple[Adjustment, ...]
    adjusted: Reported
    correlated: tuple[tuple[tuple[str, tuple[str, ...]], ...], ...]
    correlations: Reported
    without_within: int
    correlated_designs: tuple[tuple[str, tuple[str, ...], Designed], ...]
    correlated_without: tuple[tuple[str, tuple[str, ...]], ...] = ()
    conditional: tuple[str, ...] = ()
    possible: int | None = None

    def is_conditional(self, factors: Sequence[str]) -> bool:
        """Return whether a factor is conditional."""
        return len(factors) == 1 and factors[0] in self.conditional

    @property
    def skipped(self) -> int:
        """How many numbers of the report are not recomputed."""
        return sum(measure.skipped for measure in self.measures) + self.without_within

    @property
    def has_units(self) -> bool:
        """Whether several runs may share an experimental unit."""
        return bool(self.block or self.units)

    @property
    def compared(self) -> tuple[Compared, ...]:
        """The comparisons of each tested measure."""
        return tuple(each.compared for each in self.measures if each.compared is not None)

    def uses(self, *procedures: str) -> bool:
        """Return whether some test uses one of these procedures."""
        used = {name for each in self.compared for effect in each.effects for name in (effect.test, effect.check)}
        return not used.isdisjoint(procedures)

    @property
    def draws(self) -> bool:
        """Whether some p-value is simulated."""
        return any(each.drawn is not None or each.check_is_drawn for of in self.compared for each in of.effects)

    def has(self, *kinds: str) -> bool:
        """Return whether some comparison is of one of these kinds."""
        return any(each.kind in kinds for each in self.compared)

    @property
    def has_reduced(self) -> bool:
        """Whether repeated runs of some measure are averaged."""
        return any(each.kind == "blocks" or each.is_reduced for each in self.compared)

    @property
    def has_designs(self) -> bool:
        """Whether some measure has the model of a special design."""
        return any(each.designed is not None for each in self.measures)

    @property
    def has_plots(self) -> bool:
        """Whether some measure has a stratum of whole plots."""
        return any(each.has_plots for each in self.compared)

    @property
    def has_powers(self) -> bool:
        """Whether some measure has a response surface."""
        return any(each.designed is not None and each.designed.powers for each in self.measures)

    @property
    def has_before(self) -> bool:
        """Whether the model of some measure has carry-over."""
        return any(each.designed is not None and each.designed.before is not None for each in self.measures)

    @property
    def has_gaps(self) -> bool:
        """Whether some measure has an incomplete factorial."""
        return any(each.terms for each in self.compared)

    @property
    def has_nested(self) -> bool:
        """Whether some comparison has conditional factors."""
        return any(each.nested for each in self.compared)

    @property
    def has_trimmed(self) -> bool:
        """Whether trimmed means are compared."""
        return any(each.estimand == "trimmed mean" for each in self.compared)

    @property
    def reported(self) -> tuple[Reported, ...]:
        """All tables of the report for comparison."""
        found = [self.design, self.adjusted, self.correlations]
        for measure in self.measures:
            found += [of for _, of in measure.described]
            found += [measure.distribution, measure.quantiles, measure.drift, measure.power]
            if measure.compared is not None:
                found += [measure.compared.tested, measure.compared.contrasted]
                if (surface := measure.compared.surface) is not None:
                    found += [surface.reported, surface.whole]
            found += [] if measure.answered is None else [measure.answered.tested, measure.answered.contrasted]
            found += [each for pair in measure.pairs for each in (pair.reported, pair.adjusted)]
        return tuple(found)
