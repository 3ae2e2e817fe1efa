"""What a recomputation has to know of a study beside the numbers of its run table, as plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robot_runner.analysis.recomputing.designed_facts import Designed, SurfaceFacts
    from robot_runner.analysis.recomputing.reported import Number, Reported
    from robot_runner.analysis.statistics.tested import AssumptionCheck

#: Of the interval of a mean.
LEVEL = 0.95


@dataclass(frozen=True, slots=True)
class FactorColumn:
    """A factor: its treatments in their order, as the file spells them, and as the report does."""

    name: str
    texts: tuple[str, ...]
    labels: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class TableSource:
    """How the run table is read.

    Attributes:
        path: from the folder of the script.
        checksum: MD5, so that a table that was changed since is noticed.
        delimiter: what stands between its cells; decimals have a comma where that is a semicolon.
        renamed: columns that are headed by something else than their names: place from 1, and the name.
        done: the words for runs that are done.
        has_exclusions: whether there is a column that says why a run is left out.
        has_warm_ups: whether there is a column that says which runs only warm up.
        batch, confirming: the column of batches, and those that confirm what a search found: no others count.
        run_ids: the runs that count, where the columns do not tell.
        stamp: the column of the time stamp that tells the order of execution; empty for the order of the table.
        places: the place of each run in that order, where the column does not tell.
    """

    path: str
    checksum: str
    delimiter: str
    renamed: tuple[tuple[int, str], ...]
    done: tuple[str, ...]
    has_exclusions: bool
    has_warm_ups: bool
    batch: str
    confirming: tuple[str, ...]
    run_ids: tuple[str, ...]
    stamp: str
    places: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class TestedEffect:
    """An effect, and the procedures that it is tested by.

    Attributes:
        key: names it among all effects of the study.
        test, check: names of procedures; empty where there is none.
        drawn: the p-value of the report, where it comes from a bootstrap.
        check_is_drawn: whether that of the check does.
        levels: the treatments of its factors where all of them apply; of designs with conditional factors alone.
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
        others: the factors in which runs are alike that are compared.
        chosen: which of all pairs, from 1; none where the report has all of them.
    """

    key: str
    factors: tuple[str, ...]
    others: tuple[str, ...]
    reported: Reported
    adjusted: Reported
    chosen: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Contrasted:
    """A contrast that a hypothesis names.

    Attributes:
        key: names it among all tests of the study.
        weights: by treatment of the factor.
        within: the bound of equivalence; None where there is none.
    """

    key: str
    statement: str
    factor: str
    weights: Mapping[str, float]
    within: float | None
    level: float


@dataclass(frozen=True, slots=True)
class Compared:
    """What is compared of a measure, and how.

    Attributes:
        kind: `runs` of their own, `blocks`, a `linear` model, or a `mixed` one; of designs of their own `strata`, a
            `surface`, or `lenth` for effects of single runs.
        factors: those that are compared, with their treatments, as the report spells them.
        between: of `blocks`, the factors that differ between them.
        estimand: `mean`, `trimmed mean` or `rank`.
        has_check: whether the other of ranks and means is tested beside.
        is_extended: whether runs are compared within batches.
        dropped: runs that cannot be compared within batches.
        left_out: runs of blocks that lack something.
        effects, tested: what is tested, and as the report has it; so are pairs and contrasts.
        of: what the check is of: `ranks` or `means`.
        d_name: what differences in standard deviations are called.
        is_uniform: whether all combinations vary.
        terms: where some combinations have no run, the effects that are estimated, each as whether a factor is in it.
        nested: where factors apply that do not apply everywhere: the treatments of others, by factor.
        units: of `strata`, the columns in which runs of a combination are alike that are reduced to their mean.
        has_plots: whether what differs between whole plots is compared with how these vary.
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
    has_plots: bool = False
    surface: SurfaceFacts | None = None

    @property
    def is_reduced(self) -> bool:
        """Whether runs of a combination are reduced to their mean, in each block or in what else is alike."""
        return self.kind == "mixed" or bool(self.units)

    @property
    def names(self) -> tuple[str, ...]:
        """The factors that are compared."""
        return tuple(name for name, _ in self.factors)

    @property
    def within(self) -> tuple[str, ...]:
        """The factors that differ within blocks."""
        return tuple(name for name in self.names if name not in self.between)

    @property
    def is_plain(self) -> bool:
        """Whether they are runs of their own of one factor, whose means R and scipy compare by functions of theirs."""
        of_runs = self.kind == "runs" and len(self.factors) == 1 and not self.is_extended
        return of_runs and self.is_uniform and self.estimand != "trimmed mean"


@dataclass(frozen=True, slots=True)
class Answered:
    """A measure that is yes or no.

    Attributes:
        is_blocked, is_extended: whether runs are compared within blocks, and within batches.
        effects: of each factor that is tested: its name, the other factors, its key, and its p-value where that is
            drawn at random.
        tested, pairs: as the report has them.
        treatments: the pairs of each factor.
    """

    is_blocked: bool
    is_extended: bool
    effects: tuple[tuple[str, tuple[str, ...], str, float | None], ...]
    tested: Reported
    pairs: tuple[Paired, ...]
    treatments: tuple[tuple[tuple[str, str], ...], ...]


@dataclass(frozen=True, slots=True)
class MeasureFacts:
    """A measure, as planned or with one choice made otherwise.

    Attributes:
        key: names it: the measure, and whether doubtful runs are left out.
        factors: those that its runs differ in.
        left_out: the runs whose values are left out.
        distributed: the checks of how values are distributed; `distribution` is what they found.
        compared: what is compared; None where nothing is, or by a procedure that is not known here.
        effect_keys, contrast_keys: what names each test among all of the study: by factors, and by statement.
        taken: p-values of tests that are not computed again, by their keys.
        skipped: how many numbers of the report are not computed again.
        level: of the interval of a mean: higher than 0.95 where runs were added until it was narrow.
        answered: what is computed of a measure that is yes or no.
        designed: the model of a design of its own.
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
        """What is taken out of its values, measures or `order`."""
        return () if self.designed is None else self.designed.covariates

    @property
    def pairs(self) -> tuple[Paired, ...]:
        """What is compared pair by pair."""
        return tuple(each for of in (self.compared, self.answered) if of is not None for each in of.pairs)


@dataclass(frozen=True, slots=True)
class Adjustment:
    """Tests among which errors are controlled together, by their keys; and those whose result the report shows."""

    name: str
    keys: tuple[str, ...]
    shown: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class StudyFacts:
    """Everything that the templates are filled with.

    Attributes:
        made: when and by what.
        factors: all factors of the runs that are done.
        varied: those of them with two treatments and more.
        numbers: the measures.
        block: the column of the blocks; empty where there are none.
        blocks_are_of_batches: whether blocks are counted anew in each batch.
        units: where there are no blocks, the columns that tell which runs vary together; none where all stand alone.
        batch: the column of the batches; empty where there are none.
        families: the tests among which errors are controlled together.
        adjusted: p-values after adjustment.
        correlated: the measures that are correlated, two by two, each with its factors.
        without_within: of how many pairs the scripts do not know what is correlated within treatments.
        correlated_designs: of a design of its own, those measures with their factors and models.
        correlated_without: those of them some of whose values are left out, with the runs of these.
        conditional: the factors that apply to some runs only.
        possible: how many combinations there can be, where there are such.
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
        """Return whether the groups of a factor are of some runs only."""
        return len(factors) == 1 and factors[0] in self.conditional

    @property
    def skipped(self) -> int:
        """How many numbers of the report are not computed again."""
        return sum(measure.skipped for measure in self.measures) + self.without_within

    @property
    def has_units(self) -> bool:
        """Whether several runs may vary together."""
        return bool(self.block or self.units)

    @property
    def compared(self) -> tuple[Compared, ...]:
        """What is compared of each measure that is tested."""
        return tuple(each.compared for each in self.measures if each.compared is not None)

    def uses(self, *procedures: str) -> bool:
        """Return whether some test is carried out by one of these procedures."""
        used = {name for each in self.compared for effect in each.effects for name in (effect.test, effect.check)}
        return not used.isdisjoint(procedures)

    @property
    def draws(self) -> bool:
        """Whether some p-value comes from a bootstrap."""
        effects = [effect for each in self.compared for effect in each.effects]
        return any(effect.drawn is not None or effect.check_is_drawn for effect in effects)

    def has(self, *kinds: str) -> bool:
        """Return whether some measure is compared as one of these kinds."""
        return any(each.kind in kinds for each in self.compared)

    @property
    def has_reduced(self) -> bool:
        """Whether runs of some measure are reduced to means: in blocks, or where else they are alike."""
        return any(each.kind == "blocks" or each.is_reduced for each in self.compared)

    @property
    def has_designs(self) -> bool:
        """Whether some measure has the model of a design of its own."""
        return any(each.designed is not None for each in self.measures)

    @property
    def has_plots(self) -> bool:
        """Whether some measure is compared between whole plots and within them."""
        return any(each.has_plots for each in self.compared)

    @property
    def has_powers(self) -> bool:
        """Whether some measure has a response surface."""
        return any(each.designed is not None and each.designed.powers for each in self.measures)

    @property
    def has_before(self) -> bool:
        """Whether the treatment before is in the model of some measure."""
        return any(each.designed is not None and each.designed.before is not None for each in self.measures)

    @property
    def has_gaps(self) -> bool:
        """Whether some combinations have no run, though their effects are estimated."""
        return any(each.terms for each in self.compared)

    @property
    def has_nested(self) -> bool:
        """Whether some measure is compared whose factors apply to some runs only."""
        return any(each.nested for each in self.compared)

    @property
    def has_trimmed(self) -> bool:
        """Whether trimmed means are compared."""
        return any(each.estimand == "trimmed mean" for each in self.compared)

    @property
    def reported(self) -> tuple[Reported, ...]:
        """All tables of the report that are compared with."""
        found = [self.design, self.adjusted, self.correlations]
        for measure in self.measures:
            found += [of for _, of in measure.described]
            found += [measure.distribution, measure.quantiles, measure.drift, measure.power]
            if measure.compared is not None:
                found += [measure.compared.tested, measure.compared.contrasted]
                if (surface := measure.compared.surface) is not None:
                    found += [surface.reported, surface.whole]
            if measure.answered is not None:
                found.append(measure.answered.tested)
            found += [each for pair in measure.pairs for each in (pair.reported, pair.adjusted)]
        return tuple(found)
