"""Checks of the arguments of a design: factors, repetitions, columns, order."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from math import log10, prod

from robot_runner.core.design.asking import AdaptiveDesign
from robot_runner.core.design.columns import REPETITION, WARM_UP, column_name, name_findings
from robot_runner.core.design.design import CombinationDesign, Design, FullFactorial
from robot_runner.core.design.factor import Factor, factor_name
from robot_runner.core.design.full_factorial import condition_findings
from robot_runner.core.design.numeric_range import is_whole
from robot_runner.core.design.warm_up import warm_up_of
from robot_runner.core.errors import DesignError, Finding, did_you_mean

#: Whether a run table lists the runs of a design that is too large.
_ARE_LISTED: ContextVar[bool] = ContextVar("_ARE_LISTED", default=False)


@contextmanager
def listed_elsewhere() -> Iterator[None]:
    """Accept designs with too many runs for a while, as a table lists those to be executed (`RunTableModel.take_runs`).

    A context variable, as the config makes its model itself.
    """
    token = _ARE_LISTED.set(True)
    try:
        yield
    finally:
        _ARE_LISTED.reset(token)


#: More runs are taken for a mistake: at one second a run they would take four months.
MAX_RUNS = 10_000_000
#: Larger numbers are shown as a power of ten: Python refuses to write numbers of thousands of digits.
_READABLE = 10**18


def design_findings(
    factors: object,
    repetitions: object,
    data_columns: object,
    shuffle: object,
    seed: object,
    blocks: object,
    warm_up: object = None,
    design: object = None,
) -> Iterator[Finding]:
    """Yield an error for each problem of a design, exclusions aside."""
    known = tuple(factor for factor in factors if isinstance(factor, Factor)) if isinstance(factors, Sequence) else ()
    repeated = repetitions if isinstance(repetitions, int) else 1
    yield from _factor_findings(factors)
    yield from _repetition_findings(repetitions, known)
    yield from _data_column_findings(data_columns, known, repeated)
    yield from _warm_up_findings(warm_up, known, data_columns)
    if not isinstance(shuffle, bool):
        problem = f"{shuffle!r} is of type {type(shuffle).__name__}"
        yield Finding.error("shuffle", problem, "Give True or False.")
    yield from order_findings(seed, blocks, known, repeated)
    if design is None or isinstance(design, FullFactorial):
        if not _ARE_LISTED.get():
            yield from size_findings(known, repeated)
    elif isinstance(design, type) or not isinstance(design, Design | CombinationDesign):
        fix = "Give a design of robot_runner.designs, such as CoveringArray(strength=2), or leave it out."
        yield Finding.error("design", f"{design!r} is of type {type(design).__name__}", fix)
    elif known:
        if blocks is not None and not isinstance(design, CombinationDesign):
            problem = f"blocks={factor_name(blocks)!r}, and the design makes blocks of its own"
            yield Finding.error("blocks", problem, "Leave blocks out.")
        yield from design.findings(known)
        if isinstance(design, AdaptiveDesign):
            yield from design.repetition_findings(known, max(repeated, 1))


def _factor_findings(factors: object) -> Iterator[Finding]:
    kind = type(factors).__name__
    if not isinstance(factors, Sequence):
        yield Finding.error("factors", f"{factors!r} is of type {kind}", "Give a list of Factor(...).")
        return
    if not factors:
        yield Finding.error("factors", "there are none", "Give at least one Factor(...).")
    seen: set[str] = set()
    for place, factor in enumerate(factors):
        if not isinstance(factor, Factor):
            problem = f"{factor!r} is of type {type(factor).__name__}"
            yield Finding.error(f"factors[{place}]", problem, "Give a Factor(name, treatments).")
        elif factor.name in seen:
            yield Finding.error(f"factors[{place}]", f"factor {factor.name!r} is given twice", "Rename or remove it.")
        else:
            seen.add(factor.name)
    yield from condition_findings([factor for factor in factors if isinstance(factor, Factor)])


def _repetition_findings(repetitions: object, factors: Sequence[Factor]) -> Iterator[Finding]:
    if not is_whole(repetitions):
        problem = f"{repetitions!r} is of type {type(repetitions).__name__}"
        yield Finding.error("repetitions", problem, "Give a whole number from 1.")
    elif repetitions < 1:
        yield Finding.error("repetitions", f"{repetitions} is less than 1", "Give a whole number from 1.")
    else:
        for factor in factors:
            yield from name_findings(factor.name, kind="factor", repetitions=repetitions)


def _data_column_findings(columns: object, factors: Sequence[Factor], repetitions: int) -> Iterator[Finding]:
    if columns is None:
        return
    if not isinstance(columns, Sequence) or isinstance(columns, str | bytes):
        problem = f"{columns!r} is of type {type(columns).__name__}"
        yield Finding.error("data_columns", problem, "Give a list of names, or leave it out for all measures.")
        return
    names_of_factors = {factor.name for factor in factors}
    seen = set()
    for place, column in enumerate(columns):
        where = f"data_columns[{place}]"
        name = column_name(column)
        yield from name_findings(name, kind="data column", repetitions=repetitions)
        if not isinstance(name, str):
            continue
        if name in seen:
            yield Finding.error(where, f"column {name!r} is given twice", "Remove one.")
        if name in names_of_factors:
            yield Finding.error(where, f"{name!r} is the name of a factor", "Rename the factor or the measure.")
        seen.add(name)


def _warm_up_findings(given: object, factors: Sequence[Factor], columns: object) -> Iterator[Finding]:
    try:
        warm_up = warm_up_of(given)
    except DesignError as error:
        yield from error.findings
        return
    if warm_up is None:
        return
    yield from warm_up.unknown_factor(factors)
    names = [*(factor.name for factor in factors), *(columns if isinstance(columns, Sequence) else ())]
    for name in map(column_name, names):
        if isinstance(name, str) and name.casefold() == WARM_UP.casefold():
            yield from name_findings(name, kind="column", warms_up=True)


#: Longer seeds could not be read back from the journal.
_SEED_BITS = 1024


def is_seed(value: object) -> bool:
    """Return whether a value is a valid seed: not negative, as Python takes -1 for 1."""
    return is_whole(value) and 0 <= value < 1 << _SEED_BITS


def order_findings(seed: object, blocks: object, factors: Sequence[Factor], repetitions: int) -> Iterator[Finding]:
    """Yield an error for each problem of seed and blocks."""
    if seed is not None and not is_seed(seed):
        problem = f"{seed!r} is of type {type(seed).__name__}"
        if is_whole(seed):
            problem = f"the seed has {seed.bit_length():,} bits" if seed > 0 else f"the seed is {seed}"
        yield Finding.error("seed", problem, "Give a whole number from 0, or leave it out.")
    if blocks is None:
        return
    known = [factor.name for factor in factors]
    if repetitions > 1:
        known.append(REPETITION)
    name = factor_name(blocks)
    if name not in known:
        fix = "Give repetitions=2 or more, or name a factor." if name == REPETITION else did_you_mean(str(name), known)
        yield Finding.error("blocks", f"there is nothing called {name!r} to make blocks of", fix)


def size_findings(factors: Sequence[Factor], repetitions: int) -> Iterator[Finding]:
    """Yield an error if a design has too many runs."""
    runs = prod(len(factor.treatments) for factor in factors) * repetitions
    if runs > MAX_RUNS:
        shown = f"{runs:,}" if runs < _READABLE else f"10^{log10(runs):.0f}"
        problem = f"the design has {shown} runs before exclusions; {MAX_RUNS:,} is the most"
        yield Finding.error("factors", problem, "Give fewer treatments or repetitions.")
