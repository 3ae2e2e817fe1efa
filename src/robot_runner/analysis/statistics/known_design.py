"""What the analysis knows of the design: which columns are factors and which are blocks, and what it can estimate.

It comes from the facts that the design wrote into the manifest; the aliases are computed from the combinations of the
run table, planned or done, so that they are right for a table that was made elsewhere, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from robot_runner.analysis.run_frame import treatment_texts
from robot_runner.analysis.statistics.aliasing import aliasing_of
from robot_runner.analysis.statistics.effect_coding import Conditions, Term
from robot_runner.analysis.statistics.nested_factors import IDLE, codes_of, factors_of
from robot_runner.analysis.wording import listed
from robot_runner.core.design.columns import RUN_ID

if TYPE_CHECKING:
    import pandas as pd

    from robot_runner.analysis.results import Results

#: Kinds whose interactions are estimated, or are aliased in a way that is known.
_WITH_INTERACTIONS = frozenset({"fractional_factorial", "split_plot", "full_factorial"})
#: Facts that name one column each, or several, which are blocks of some kind: taken out, and not tested.
_BLOCK_ROLES = ("row", "column", "rows", "columns", "greek", "square", "block", "replicate", "subject", "period", "day")
_ONE_AT_A_TIME = "one_factor_at_a_time"


def role_column(name: str) -> str:
    """Return the column that a block of the design (a row, a period, a subject) has in the data of each measure."""
    return f" role {name}"


def before_column(factor: str) -> str:
    """Return the column that has the treatment of the period before, in a crossover."""
    return f" before {factor}"


@dataclass(frozen=True, slots=True)
class KnownDesign:
    """The design of an experiment, beyond its factors and repetitions.

    Attributes:
        kind: as the manifest names it.
        blocks: columns whose effects are taken out and not tested: rows, columns, periods, subjects, replicates.
        subject, period: of a crossover.
        carry_over: whether the effect of the treatment before is in the model of a crossover: no washout was planned.
        whole_plot: the column of the whole plots; some treatments change from one to the next alone.
        plot_columns: blocks within which whole plots are numbered anew.
        model: `main` effects, those and `interactions` of two factors, or `quadratic` for a response surface.
        coding: the middle and half the range of factors of a response surface.
        base: the combination that one factor at a time departs from.
        terms: the effects that are tested; none where the values decide how many there can be.
        aliases: the effects that cannot be told apart from each tested one.
        half_aliases: the tested effects that others are mixed with in part.
    """

    kind: str = "full_factorial"
    blocks: tuple[str, ...] = ()
    subject: str = ""
    period: str = ""
    carry_over: bool = False
    whole_plot: str = ""
    plot_columns: tuple[str, ...] = ()
    model: str = ""
    coding: Mapping[str, tuple[float, float]] = field(default_factory=lambda: MappingProxyType({}))
    base: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    terms: tuple[Term, ...] = ()
    aliases: Mapping[Term, tuple[Term, ...]] = field(default_factory=lambda: MappingProxyType({}))
    half_aliases: frozenset[Term] = frozenset()

    @classmethod
    def of_manifest(cls, manifest: Mapping[str, Any], columns: Iterable[str]) -> KnownDesign:
        """Return the design that a manifest tells of; that of a full factorial where it tells nothing.

        Args:
            manifest: of the experiment.
            columns: of the run table; what names another column is passed over.
        """
        design = manifest.get("design")
        facts = design.get("facts") if isinstance(design, dict) else None
        if not isinstance(facts, dict):
            return PLAIN
        known = set(columns)
        blocks = [name for role in _BLOCK_ROLES for name in _names(facts.get(role)) if name in known]
        subject, period = (next((name for name in _names(facts.get(role)) if name in known), "") for role in _CROSSED)
        whole_plot = next((name for name in _names(facts.get("whole_plot")) if name in known), "")
        base = facts.get("base")
        is_crossover = bool(subject and period)
        return cls(
            kind=str(facts.get("kind", "")),
            blocks=tuple(name for name in dict.fromkeys(blocks) if name != whole_plot),
            subject=subject,
            period=period,
            carry_over=is_crossover and not facts.get("washout"),
            whole_plot=whole_plot,
            model=str(facts.get("model", "")),
            coding=dict(_coded(facts.get("ranges"))),
            base={str(name): str(text) for name, text in base.items()} if isinstance(base, dict) else {},
        )

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns that are no factors: nothing of them is tested."""
        return (*self.blocks, *filter(None, [self.whole_plot]))

    @property
    def unit_columns(self) -> tuple[str, ...]:
        """The columns that tell which runs vary together: those of one whole plot, subject or block."""
        if self.whole_plot:
            return (self.whole_plot, *self.plot_columns)
        return (self.subject,) if self.subject else self.blocks[:1]

    @property
    def is_plain(self) -> bool:
        """Whether the combinations and blocks tell everything, as of a full factorial."""
        return not (self.columns or self.terms or self.is_surface)

    @property
    def is_surface(self) -> bool:
        """Whether a quadratic surface is fitted."""
        return self.model == "quadratic"

    @property
    def is_one_at_a_time(self) -> bool:
        """Whether each factor is compared with the base alone."""
        return self.kind == _ONE_AT_A_TIME

    @property
    def has_interactions(self) -> bool:
        """Whether interactions are estimated."""
        return self.kind in _WITH_INTERACTIONS or bool(self.columns) or self.model == "interactions"

    @property
    def together(self) -> int:
        """Of how many factors effects are estimated together that are not orthogonal: the design is made for these."""
        return 2 if self.model == "interactions" else 1

    @property
    def in_words(self) -> str:
        """The kind of the design, as a reader knows it."""
        return self.kind.replace("_", " ")

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader of its tests has to know."""
        found = []
        if self.aliases:
            found.append(
                "Effects that are aliased cannot be told apart: what is found is their sum. It is taken for the first "
                "where interactions of several factors are smaller than effects of few."
            )
        if self.half_aliases:
            names = listed([" x ".join(each) for each in sorted(self.half_aliases)])
            found.append(f"Interactions that are not tested are mixed in part with {names}: they are taken to be none.")
        if self.is_one_at_a_time:
            found.append("Each factor is compared with the base alone: how factors act together is not known.")
        elif not (self.has_interactions or self.is_surface):
            found.append(
                f"Interactions are taken to be none: a design of this kind ({self.in_words}) does not tell them."
            )
        return tuple(found)


_CROSSED = ("subject", "period")

#: What is known where the manifest tells nothing.
PLAIN = KnownDesign()


def treatments_before(results: Results, known: KnownDesign, names: Sequence[str]) -> dict[str, pd.Series]:
    """Return the treatment that each subject had in the period before, as planned; nothing in its first period."""
    where, runs = [known.subject, known.period], results.all_runs
    periods = runs.drop_duplicates(where).sort_values(known.period, key=treatment_texts, kind="stable")
    texts = periods[list(names)].astype("str").set_axis(periods[RUN_ID])
    before = texts.groupby(periods[known.subject].astype("str").to_numpy()).shift().fillna("")
    first = runs.groupby(where, observed=True)[RUN_ID].transform("first").set_axis(runs[RUN_ID])
    own = results.done[RUN_ID].map(first)
    return {before_column(name): own.map(before[name]) for name in names}


def are_complete(known: KnownDesign, results: Results) -> bool:
    """Return whether the blocks of a design are of one kind and each hold all combinations, as those of a factorial."""
    if known.kind != "blocks" or len(known.blocks) != 1:
        return False
    names = [name for name in results.factors if name not in known.blocks]
    planned = results.all_runs[[*known.blocks, *names]].astype("str").drop_duplicates()
    held = planned.groupby(known.blocks[0]).size()
    return bool((held == len(planned[names].drop_duplicates())).all())


def with_structure(
    known: KnownDesign, results: Results, frame: pd.DataFrame, varied: Sequence[str], conditions: Conditions
) -> KnownDesign:
    """Return a design with the effects that its planned combinations can tell, and how whole plots are numbered."""
    if known == PLAIN or known.is_surface or not varied:
        return known
    planned = results.all_runs[list(varied)].astype("str").drop_duplicates()
    own = {name: {each: of for each, of in conditions.get(name, {}).items() if each in varied} for name in varied}
    levels = {name: [text for text in sorted(set(planned[name])) if not own[name] or text != IDLE] for name in varied}
    factors = factors_of(levels, {name: of for name, of in own.items() if of})
    only, together = not known.has_interactions, known.together
    found = aliasing_of(factors, codes_of(planned, factors), main_only=only, together=together)
    known = replace(known, terms=found.terms, aliases=found.aliases, half_aliases=found.mixed)
    if known.whole_plot:
        plots = frame.groupby(role_column(known.whole_plot), observed=True)
        numbered_anew = tuple(name for name in known.blocks if plots[role_column(name)].nunique().max() > 1)
        known = replace(known, plot_columns=numbered_anew)
    return known


def _names(fact: object) -> tuple[str, ...]:
    if isinstance(fact, str):
        return (fact,)
    return tuple(map(str, fact)) if isinstance(fact, list | tuple) else ()


def _coded(ranges: object) -> Iterator[tuple[str, tuple[float, float]]]:
    for name, ends in ranges.items() if isinstance(ranges, dict) else ():
        match ends:
            case [int() | float() as low, int() | float() as high] if high > low:
                yield str(name), ((low + high) / 2, (high - low) / 2)
