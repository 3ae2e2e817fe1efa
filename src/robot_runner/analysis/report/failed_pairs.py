"""Which pairs of treatments runs failed with: what a covering array is executed for."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

from robot_runner.analysis.report.blocks import Block, Paragraph, Part, Tone
from robot_runner.analysis.report.tables import build_table, number, text
from robot_runner.core.design.columns import STATUS
from robot_runner.core.storage.cells import RunStatus

if TYPE_CHECKING:
    from collections.abc import Iterator

    import pandas as pd

    from robot_runner.analysis.report.material import Material

__all__ = ["FailedPair", "failed_pair_parts", "failed_pairs"]

#: More rows are not read; those in which all runs failed come first.
_MOST = 20


class FailedPair(NamedTuple):
    """A pair of treatments, and how many of its runs failed."""

    pair: str
    runs: int
    failed: int


def failed_pairs(runs: pd.DataFrame, factors: tuple[str, ...]) -> list[FailedPair]:
    """Return the pairs of treatments that runs failed with, those of which most failed first.

    Args:
        runs: that are done or failed.
        factors: whose treatments are paired.
    """
    texts = runs[list(factors)].astype("str")
    has_failed = (runs[STATUS].astype("str") == RunStatus.FAILED.value).to_numpy()
    found = []
    for one, other in combinations(factors, 2):
        held: dict[tuple[str, str], list[bool]] = {}
        for pair, is_failed in zip(zip(texts[one], texts[other], strict=True), has_failed, strict=True):
            held.setdefault(pair, []).append(bool(is_failed))
        found += [
            FailedPair(f"{one} = {a}, {other} = {b}", len(each), sum(each))
            for (a, b), each in held.items()
            if any(each)
        ]
    return sorted(found, key=lambda each: (-each.failed / each.runs, -each.failed, each.pair))


def failed_pair_parts(material: Material) -> Iterator[Block]:
    """Yield the part, where the design is a screening and runs failed."""
    if material.statistics.design.kind != "covering_array" or not material.counts[RunStatus.FAILED]:
        return
    ended = material.runs[material.runs[STATUS].astype("str").isin([RunStatus.DONE.value, RunStatus.FAILED.value])]
    found = failed_pairs(ended, material.statistics.design.factors)
    fields = (text("Treatments", "pair"), number("Runs", "runs"), number("Failed", "failed"))
    shown = f", of {len(found):,} the {_MOST} that failed most" if len(found) > _MOST else ""
    caption = f"The pairs of treatments that runs failed with{shown}."
    words = (
        "Each pair of treatments was executed at least once. A pair all of whose runs failed may be the cause; others "
        "go along with it. Repeat the first ones by themselves."
    )
    table = build_table("failed pairs", caption, found[:_MOST], fields)
    yield Part("outcome-pairs", "Failures by pairs of treatments", (Paragraph(words, Tone.NOTE), table))
