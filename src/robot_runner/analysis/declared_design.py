"""The design of results from elsewhere, declared by the user, so that the analysis follows it."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Self

from robot_runner.core.errors import AnalysisError, Finding, did_you_mean
from robot_runner.core.words import enumerated

if TYPE_CHECKING:
    import pandas as pd

    from robot_runner.analysis.results import Results

    #: Takes the design, the runs, the factors that vary, and where the design was declared.
    _Check = Callable[["DeclaredDesign", pd.DataFrame, Sequence[str], str], Iterator[Finding]]


class _Kind(NamedTuple):
    """A kind of design: the parts that name columns, and which of them are required."""

    needed: tuple[str, ...] = ()
    possible: tuple[str, ...] = ()
    others: tuple[str, ...] = ()


#: The kinds that change the analysis; their parts have the names of `robot_runner.designs`.
_KINDS = {
    "blocks": _Kind(("blocks",)),
    "latin_square": _Kind(("rows", "columns"), ("square",)),
    "graeco_latin_square": _Kind(("rows", "columns"), ("greek", "square")),
    "crossover": _Kind(("unit", "period"), ("blocks",), ("washout",)),
    "split_plot": _Kind(("plot",), ("blocks",)),
    "fractional_factorial": _Kind((), ("blocks",)),
    "one_factor_at_a_time": _Kind((), ("blocks",), ("base",)),
    "response_surface": _Kind((), ("blocks",), ("ranges",)),
}
#: The names of the parts in the facts of a design; see `known_design`.
_FACTS = {
    "blocks": "block",
    "rows": "row",
    "columns": "column",
    "square": "square",
    "greek": "greek",
    "unit": "subject",
    "period": "period",
    "plot": "whole_plot",
}
#: The number of treatments of a factor that a polynomial of second degree needs.
_OF_A_CURVE = 3
#: The one part that may name several columns.
_SEVERAL = "blocks"
_PAIR = 2
_WORDS = {"yes": True, "true": True, "no": False, "false": False}


@dataclass(frozen=True, slots=True)
class DeclaredDesign:
    """The parts that columns of a run table have in a design which the table does not show.

    Attributes:
        kind: one of `blocks`, `latin_square`, `graeco_latin_square`, `crossover`, `split_plot`,
            `fractional_factorial`, `one_factor_at_a_time` and `response_surface`.
        columns: the columns of each part: `unit` and `period` of a crossover, the whole plots as `plot`, and so on.
        washout: whether the effect of one treatment is gone before the next; if so, the model of a crossover has no
            carry-over.
        base: the combination from which one factor at a time is changed.
        ranges: the treatments that are coded as -1 and 1, for the factors of a surface; by default a factor's smallest
            and largest.

    Example:
        >>> DeclaredDesign.of_mapping({"kind": "crossover", "unit": "Robot", "period": "Day"}).names
        ('Robot', 'Day')
    """

    kind: str
    columns: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: MappingProxyType({}))
    washout: bool = False
    base: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=lambda: MappingProxyType({}))

    @classmethod
    def of_mapping(cls, plain: Mapping[str, Any], where: str = "design") -> Self:
        """Return the design that plain data declare, such as a table of a TOML file.

        Raises:
            AnalysisError: the data are not a design; `findings` lists all problems.
        """
        kind = plain.get("kind")
        if kind not in _KINDS:
            fix = did_you_mean(str(kind), _KINDS)
            raise AnalysisError(f"there is no kind of design {kind!r}", where=where, fix=fix)
        parts = _KINDS[kind]
        findings = [
            Finding.error(where, f"a {design_in_words(kind)} has no {key!r}", did_you_mean(str(key), _entries(parts)))
            for key in plain
            if key not in _entries(parts)
        ]
        columns = {}
        for part in (*parts.needed, *parts.possible):
            given = plain.get(part, ())
            names = (given,) if isinstance(given, str) else tuple(given) if isinstance(given, list | tuple) else None
            if names is None or not all(isinstance(each, str) for each in names):
                findings.append(Finding.error(where, f"{part} is {given!r}", "Name a column, or a list of columns."))
            elif len(names) > 1 and part != _SEVERAL:
                findings.append(Finding.error(where, f"{part} is {enumerated(names)}", "Name one column."))
            elif names:
                columns[part] = names
            elif part in parts.needed:
                fix = f'Write {part} = "COLUMN".'
                findings.append(Finding.error(where, f"a {design_in_words(kind)} takes the column of its {part}", fix))
        for part in parts.others:
            findings += _other_findings(part, plain[part], where) if part in plain else ()
        AnalysisError.refuse(findings)
        ranges = {name: (float(low), float(high)) for name, (low, high) in plain.get("ranges", {}).items()}
        base = {name: str(text) for name, text in plain.get("base", {}).items()}
        return cls(kind, columns, plain.get("washout", False), base, ranges)

    @property
    def names(self) -> tuple[str, ...]:
        """The columns of the parts, which are not factors."""
        return tuple(dict.fromkeys(name for names in self.columns.values() for name in names))

    @property
    def in_words(self) -> str:
        """The usual name of the design, with its columns."""
        parts = [f"{part} {enumerated(names)}" for part, names in self.columns.items()]
        parts += ["washed out"] if self.washout else []
        words = ", ".join(parts)
        return f"{design_in_words(self.kind)} ({words})" if words else design_in_words(self.kind)

    def as_mapping(self) -> dict[str, Any]:
        """Return the design as plain data, for `of_mapping`."""
        columns = {part: names[0] if len(names) == 1 else list(names) for part, names in self.columns.items()}
        ranges = {name: list(ends) for name, ends in self.ranges.items()}
        others = {"washout": self.washout, "base": dict(self.base), "ranges": ranges}
        return {"kind": self.kind, **columns, **{name: value for name, value in others.items() if value}}

    def facts(self, whence: str, heading: Callable[[str], str] = str) -> dict[str, Any]:
        """Return the facts that one of our designs would have written into the manifest.

        It was declared in `whence`; `heading` returns the heading of a column in the run table.
        """
        found: dict[str, Any] = {
            _FACTS[part]: heading(names[0]) if len(names) == 1 else [heading(name) for name in names]
            for part, names in self.columns.items()
        }
        found |= {"model": "quadratic"} if self.kind == "response_surface" else {}
        found |= {"washout": self.washout} if self.kind == "crossover" else {}
        found |= {"base": {heading(name): text for name, text in self.base.items()}} if self.base else {}
        found |= {"ranges": {heading(name): list(ends) for name, ends in self.ranges.items()}} if self.ranges else {}
        return {
            "kind": self.kind,
            **found,
            "block_columns": [heading(name) for name in self.names],
            "declared": whence,
            "notes": [f"declared in {whence}, and not by what executed the runs: {self.in_words}"],
        }


def design_in_words(kind: str) -> str:
    """Return the usual name of a kind of design."""
    return kind.replace("_", " ").replace("graeco latin", "Graeco-Latin").replace("latin", "Latin")


def parse_design(text: str) -> DeclaredDesign:
    """Parse a design of the form `KIND:PART=COLUMN,...`.

    Raises:
        AnalysisError: the text is not a design.

    Example:
        >>> parse_design("split_plot:plot=Laying,blocks=Day").columns
        {'plot': ('Laying',), 'blocks': ('Day',)}
    """
    kind, _, rest = text.partition(":")
    entries: dict[str, Any] = {}
    for each in filter(None, rest.split(",")):
        part, equals, column = (piece.strip() for piece in each.partition("="))
        if not equals:
            fix = "Write KIND:PART=COLUMN,..., as in crossover:unit=Robot,period=Day,washout=yes."
            raise AnalysisError(f"{each!r} names no column", where=f"design {text}", fix=fix)
        if part == "washout":
            entries[part] = _WORDS.get(column.casefold(), column)
        else:
            entries.setdefault(part, []).append(column)
    return DeclaredDesign.of_mapping({"kind": kind.strip(), **entries}, f"design {text}")


def with_declared_design(results: Results, declared: DeclaredDesign, whence: str) -> Results:
    """Return results whose analysis follows a design that was declared in `whence`, such as a file.

    Raises:
        AnalysisError: the experiment has a design of its own, a column does not exist, or the runs do not have the
            structure of that design.
    """
    design = results.manifest.get("design") or {}
    own = (design.get("facts") or {}).get("kind", "full_factorial")
    if own != "full_factorial" and not design["facts"].get("declared"):
        problem = f"the experiment has a design of its own, a {design_in_words(str(own))}"
        raise AnalysisError(problem, where=whence, fix="Leave [design] out: the report follows that one.")
    allowed = [name for name in results.runs.columns if name in results.columns and name not in results.measures]
    AnalysisError.refuse(_unknown(declared, allowed, results, whence))
    factors = [name for name in results.factors if name not in declared.names]
    AnalysisError.refuse(structure_findings(declared, results.runs.astype("str"), factors, whence))
    manifest = {**results.manifest, "design": {**design, "facts": declared.facts(whence)}}
    return replace(results, manifest=manifest)


def _unknown(declared: DeclaredDesign, names: Sequence[str], results: Results, where: str) -> Iterator[Finding]:
    for name in declared.names:
        if name in results.measures:
            fix = f"Import the results again with the design, or with --factor {shlex.quote(name)}."
            yield Finding.error(where, f"{name!r} is a measure of these results, and no part of a design", fix)
        elif name not in names:
            yield Finding.error(where, f"there is no column {name!r}", did_you_mean(name, names))
    for name in (*declared.base, *declared.ranges):
        if name not in results.factors:
            yield Finding.error(where, f"there is no factor {name!r}", did_you_mean(name, results.factors))


def structure_findings(
    declared: DeclaredDesign, runs: pd.DataFrame, factors: Sequence[str], where: str
) -> Iterator[Finding]:
    """Yield why runs cannot come from a design of this kind."""
    varied = [name for name in factors if len(set(runs[name])) > 1]
    if not varied:
        fix = "Name a factor of two treatments and more: --factor."
        yield Finding.error(where, "no factor varies beside the columns of the design", fix)
        return
    for name in declared.names:
        if len(set(runs[name])) < _PAIR:
            yield Finding.error(where, f"{name} is the same in all runs", "Name the column that tells them apart.")
    if declared.kind in _STRUCTURES:
        yield from _STRUCTURES[declared.kind](declared, runs, varied, where)
    for name, text in declared.base.items():
        if name in runs and text not in set(runs[name]):
            fix = did_you_mean(text, dict.fromkeys(runs[name]))
            yield Finding.error(where, f"the base has {name} = {text!r}, which no run has", fix)


def _crossing(declared: DeclaredDesign, runs: pd.DataFrame, varied: Sequence[str], where: str) -> Iterator[Finding]:
    yield from _one_in_each("unit", "period")(declared, runs, varied, where)
    (unit,) = declared.columns["unit"]
    if (runs.groupby(unit)[list(varied)].nunique() < _PAIR).all(axis=None):
        fix = "Name as unit what had several treatments, one after another."
        yield Finding.error(where, f"each {unit} has one treatment: nothing is crossed over", fix)


def _one_in_each(*parts: str) -> _Check:
    """Return a check that finds a cell of these parts with several combinations."""

    def check(declared: DeclaredDesign, runs: pd.DataFrame, varied: Sequence[str], where: str) -> Iterator[Finding]:
        columns = [name for part in parts for name in declared.columns.get(part, ())]
        kinds = runs[[*columns, *varied]].drop_duplicates().groupby(columns, sort=False).size()
        if (kinds > 1).any():
            place = kinds.index[kinds > 1][0]
            cell = enumerated([f"{name} {text}" for name, text in zip(columns, place, strict=True)])
            problem = f"{cell} has {int(kinds[place])} combinations of {enumerated(varied)}, and should have one"
            yield Finding.error(where, problem, "Name the columns that tell them apart, or another kind of design.")

    return check


def _plots(declared: DeclaredDesign, runs: pd.DataFrame, varied: Sequence[str], where: str) -> Iterator[Finding]:
    plot = [*declared.columns["plot"], *declared.columns.get("blocks", ())]
    kinds = runs.groupby(plot)[list(varied)].nunique().max()
    if (kinds > 1).all():
        problem = f"no factor stays as it is for a whole plot ({enumerated(plot)})"
        yield Finding.error(
            where, problem, "Name the column of the whole plots, and blocks if their count starts again in each."
        )
    elif (kinds == 1).all():
        problem = f"no factor varies within a whole plot ({enumerated(plot)})"
        yield Finding.error(where, problem, "Name a column whose runs differ, or declare no design.")


def _curves(declared: DeclaredDesign, runs: pd.DataFrame, varied: Sequence[str], where: str) -> Iterator[Finding]:
    del declared
    from robot_runner.analysis.statistics.designed_columns import numbers_of_levels  # noqa: PLC0415 - slow

    curved = [
        name
        for name in varied
        if len(set(runs[name])) >= _OF_A_CURVE and numbers_of_levels(list(dict.fromkeys(runs[name]))) is not None
    ]
    if not curved:
        problem = f"no factor has {_OF_A_CURVE} numbers as treatments: there is no surface"
        yield Finding.error(where, problem, "Declare a fractional_factorial, or no design.")


#: The checks of the runs, for kinds of designs that have one.
_STRUCTURES: Mapping[str, _Check] = {
    "crossover": _crossing,
    "latin_square": _one_in_each("rows", "columns", "square"),
    "split_plot": _plots,
    "response_surface": _curves,
}


def _entries(parts: _Kind) -> tuple[str, ...]:
    return ("kind", *parts.needed, *parts.possible, *parts.others)


def _other_findings(part: str, given: Any, where: str) -> Iterator[Finding]:
    """Yield why a part that names no column is invalid."""
    if part == "washout" and not isinstance(given, bool):
        yield Finding.error(where, f"washout is {given!r}", "Write true or false.")
    if part == "base" and not (isinstance(given, dict) and given):
        fix = 'Name the treatment of each factor: base = {Task = "Idle"}.'
        yield Finding.error(where, f"base is {given!r}", fix)
    if part == "ranges":
        fix = "Write the two ends of each factor: ranges = {Speed = [0.1, 0.3]}."
        for name, ends in given.items() if isinstance(given, dict) else [("ranges", given)]:
            match ends:
                case [int() | float() as low, int() | float() as high] if high > low:
                    continue
            yield Finding.error(where, f"the range of {name} is {ends!r}", fix)
