"""The design of an experiment for its analysis: which columns are blocks, and which effects can be estimated.

It is read from the facts that the design wrote into the manifest. Aliases are computed from the planned combinations of
the run table, so that they are right for imported tables, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self

from robot_runner.analysis.run_frame import treatment_texts
from robot_runner.analysis.statistics.aliasing import aliasing_of
from robot_runner.analysis.statistics.effect_coding import Conditions, Term
from robot_runner.analysis.statistics.nested_factors import IDLE, codes_of, factors_of
from robot_runner.analysis.wording import listed
from robot_runner.core.design.columns import RUN_ID

if TYPE_CHECKING:
    import pandas as pd

    from robot_runner.analysis.results import Results

#: Kinds of designs whose interactions are estimated, or have a known aliasing.
_WITH_INTERACTIONS = frozenset({"fractional_factorial", "split_plot", "full_factorial"})
#: Facts that name columns of blocks of some kind: the model adjusts for them, and they are not tested.
_BLOCK_ROLES = ("row", "column", "rows", "columns", "greek", "square", "block", "replicate", "subject", "period", "day")
_ONE_AT_A_TIME = "one_factor_at_a_time"


def role_column(name: str) -> str:
    """Return the column of a block of the design (a row, a period, a subject) in the data of each measure."""
    return f" role {name}"


def before_column(factor: str) -> str:
    """Return the column with the treatment of the previous period, in a crossover."""
    return f" before {factor}"


@dataclass(frozen=True, slots=True)
class KnownDesign:
    """The design of an experiment, beyond its factors and repetitions.

    Attributes:
        kind: its name in the manifest.
        blocks: columns that the model adjusts for without testing them: rows, columns, periods, subjects, replicates.
        subject, period: the columns of a crossover.
        carry_over: whether the model of a crossover has the effect of the previous treatment: no washout was planned.
        whole_plot: the column of the whole plots; the treatments of some factors change only between these.
        plot_columns: blocks within which the numbers of whole plots begin anew.
        model: `main` effects, those and `interactions` of two factors, or `quadratic` for a response surface.
        coding: the centre and half the range of each factor of a response surface.
        base: the base combination of a one-factor-at-a-time design.
        terms: the tested effects; empty if they depend on the runs with a value.
        aliases: the aliases of each tested effect.
        half_aliases: the tested effects that others are partially aliased with.
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
        """Return the design in a manifest; a full factorial if it has no facts.

        Facts that name other columns than those of the run table are ignored.
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
        return cls(
            kind=str(facts.get("kind", "")),
            blocks=tuple(name for name in dict.fromkeys(blocks) if name != whole_plot),
            subject=subject,
            period=period,
            carry_over=bool(subject and period) and not facts.get("washout"),
            whole_plot=whole_plot,
            model=str(facts.get("model", "")),
            coding=dict(_coded(facts.get("ranges"))),
            base={str(name): str(text) for name, text in base.items()} if isinstance(base, dict) else {},
        )

    def with_name(self, old: str, new: str) -> Self:
        """Return the same design with a factor or a treatment renamed."""

        def named(term: Iterable[str]) -> Term:
            return tuple(new if name == old else name for name in term)

        return replace(
            self,
            coding=dict(zip(named(self.coding), self.coding.values(), strict=True)),
            base=dict(zip(named(self.base), named(self.base.values()), strict=True)),
            terms=tuple(map(named, self.terms)),
            aliases={named(term): tuple(map(named, of)) for term, of in self.aliases.items()},
            half_aliases=frozenset(map(named, self.half_aliases)),
        )

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns of blocks and whole plots, which are not tested."""
        return (*self.blocks, *filter(None, [self.whole_plot]))

    @property
    def unit_columns(self) -> tuple[str, ...]:
        """The columns of the experimental unit of a run: its whole plot, subject or block."""
        if self.whole_plot:
            return (self.whole_plot, *self.plot_columns)
        return (self.subject,) if self.subject else self.blocks[:1]

    @property
    def is_plain(self) -> bool:
        """Whether combinations and complete blocks are all there is to the design, as for a full factorial."""
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
        """The most factors of effects that are estimated jointly if they are not orthogonal, as the design intends."""
        return 2 if self.model == "interactions" else 1

    @property
    def in_words(self) -> str:
        """The kind of the design in words."""
        return self.kind.replace("_", " ")

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for readers of the tests."""
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

#: The design of a manifest without facts.
PLAIN = KnownDesign()


def treatments_before(results: Results, known: KnownDesign, names: Sequence[str]) -> dict[str, pd.Series]:
    """Return each subject's planned treatment in the previous period; empty in the first period."""
    where, runs = [known.subject, known.period], results.all_runs
    periods = runs.drop_duplicates(where).sort_values(known.period, key=treatment_texts, kind="stable")
    texts = periods[list(names)].astype("str").set_axis(periods[RUN_ID])
    before = texts.groupby(periods[known.subject].astype("str").to_numpy()).shift().fillna("")
    first = runs.groupby(where, observed=True)[RUN_ID].transform("first").set_axis(runs[RUN_ID])
    own = results.done[RUN_ID].map(first)
    return {before_column(name): own.map(before[name]) for name in names}


def are_complete(known: KnownDesign, results: Results) -> bool:
    """Return whether a design has one kind of blocks, each with all combinations, as a factorial has."""
    if known.kind != "blocks" or len(known.blocks) != 1:
        return False
    names = [name for name in results.factors if name not in known.blocks]
    planned = results.all_runs[[*known.blocks, *names]].astype("str").drop_duplicates()
    held = planned.groupby(known.blocks[0]).size()
    return bool((held == len(planned[names].drop_duplicates())).all())


def with_structure(
    known: KnownDesign, results: Results, frame: pd.DataFrame, varied: Sequence[str], conditions: Conditions
) -> KnownDesign:
    """Return a design with the effects that its planned combinations can estimate, and its `plot_columns`."""
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
