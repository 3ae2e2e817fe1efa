"""What keeps factors, repetitions, columns and order from making a design: each check lists all that it finds."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import prod
from typing import TYPE_CHECKING

from robot_runner.design.columns import REPETITION, name_findings
from robot_runner.design.factor import Factor
from robot_runner.errors import Finding, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["MAX_RUNS", "design_findings", "order_findings"]

#: More runs than this are taken for a slip: at one second a run they would take four months.
MAX_RUNS = 10_000_000


def design_findings(
    factors: object, repetitions: object, data_columns: object, shuffle: object, seed: object, blocks: object
) -> Iterator[Finding]:
    """Say everything that is wrong with a design, its exclusions left aside.

    Args:
        factors: what is to be a sequence of factors.
        repetitions: what is to be how often each combination is executed.
        data_columns: what is to be the names of the measures' columns, or None.
        shuffle: what is to be whether the order is randomised.
        seed: what is to be the seed, or None.
        blocks: what is to be what runs are kept together by, or None.

    Yields:
        An error finding for each problem.
    """
    known = tuple(factor for factor in factors if isinstance(factor, Factor)) if isinstance(factors, Sequence) else ()
    repeated = repetitions if isinstance(repetitions, int) else 1
    yield from _factor_findings(factors)
    yield from _repetition_findings(repetitions, known)
    yield from _data_column_findings(data_columns, known, repeated)
    if not isinstance(shuffle, bool):
        problem = f"it is {shuffle!r}, which is of type {type(shuffle).__name__}"
        yield Finding.error("shuffle", problem, "Give True or False.")
    yield from order_findings(seed, blocks, known, repeated)
    yield from _size_findings(known, repeated)


def _factor_findings(factors: object) -> Iterator[Finding]:
    kind = type(factors).__name__
    if not isinstance(factors, Sequence):
        yield Finding.error("factors", f"it is {factors!r}, which is of type {kind}", "Give a list of Factor(...).")
        return
    if not factors:
        yield Finding.error("factors", "there are none", "Give at least one Factor(...).")
    seen: set[str] = set()
    for place, factor in enumerate(factors):
        if not isinstance(factor, Factor):
            problem = f"it is {factor!r}, which is of type {type(factor).__name__}"
            yield Finding.error(f"factors[{place}]", problem, "Give a Factor(name, treatments).")
        elif factor.name in seen:
            yield Finding.error(f"factors[{place}]", f"factor {factor.name!r} is given twice", "Rename or remove it.")
        else:
            seen.add(factor.name)


def _repetition_findings(repetitions: object, factors: Sequence[Factor]) -> Iterator[Finding]:
    if isinstance(repetitions, bool) or not isinstance(repetitions, int):
        problem = f"it is {repetitions!r}, which is of type {type(repetitions).__name__}"
        yield Finding.error("repetitions", problem, "Give a whole number from 1.")
    elif repetitions < 1:
        yield Finding.error("repetitions", f"it is {repetitions}", "Give a whole number from 1.")
    else:
        for factor in factors:
            yield from name_findings(factor.name, kind="factor", repetitions=repetitions)


def _data_column_findings(columns: object, factors: Sequence[Factor], repetitions: int) -> Iterator[Finding]:
    if columns is None:
        return
    if not isinstance(columns, Sequence) or isinstance(columns, str | bytes):
        problem = f"it is {columns!r}, which is of type {type(columns).__name__}"
        yield Finding.error("data_columns", problem, "Give a list of names, or leave it out for all measures.")
        return
    names_of_factors = {factor.name for factor in factors}
    seen = set()
    for place, name in enumerate(columns):
        where = f"data_columns[{place}]"
        yield from name_findings(name, kind="data column", repetitions=repetitions)
        if not isinstance(name, str):
            continue
        if name in seen:
            yield Finding.error(where, f"column {name!r} is given twice", "Remove one.")
        if name in names_of_factors:
            yield Finding.error(where, f"{name!r} is the name of a factor", "Rename the factor or the measure.")
        seen.add(name)


def order_findings(seed: object, blocks: object, factors: Sequence[Factor], repetitions: int) -> Iterator[Finding]:
    """Say what is wrong with the seed and the blocks."""
    is_seed = seed is None or (isinstance(seed, int) and not isinstance(seed, bool) and seed >= 0)
    if not is_seed:  # random.Random takes -1 for 1, so that two seeds would give one order
        problem = f"it is {seed!r}, which is of type {type(seed).__name__}"
        yield Finding.error("seed", problem, "Give a whole number from 0, or leave it out.")
    if blocks is None:
        return
    known = [factor.name for factor in factors]
    if repetitions > 1:
        known.append(REPETITION)
    name = blocks.name if isinstance(blocks, Factor) else blocks
    if name not in known:
        yield Finding.error("blocks", f"there is nothing called {name!r} to make blocks of", _blocks_fix(name, known))


def _size_findings(factors: Sequence[Factor], repetitions: int) -> Iterator[Finding]:
    runs = prod(len(factor.treatments) for factor in factors) * repetitions
    if runs > MAX_RUNS:
        problem = f"the design has {runs:,} runs before exclusions; {MAX_RUNS:,} is the most"
        yield Finding.error("factors", problem, "Give fewer treatments or repetitions.")


def _blocks_fix(name: object, known: Iterable[str]) -> str:
    if name == REPETITION:
        return "Give repetitions=2 or more, or name a factor."
    return did_you_mean(str(name), known)
