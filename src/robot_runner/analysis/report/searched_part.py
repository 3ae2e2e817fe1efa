"""What a design tried that decides on its runs, in the order in which it tried it: exploratory, and not tested."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pandas as pd

from robot_runner.analysis.report.blocks import Part
from robot_runner.analysis.report.tables import build_table, number, text
from robot_runner.core.design.columns import STATUS
from robot_runner.core.storage.cells import RunStatus

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.analysis.report.material import Material

__all__ = ["searched_part"]

_NOTE = (
    "Means of the runs of the search, in the order in which combinations came up. They are exploratory: the best of "
    "many looks better than it is."
)


def searched_part(material: Material) -> Iterator[Part]:
    """Yield what was tried, where the design decided on its runs."""
    results = material.results.with_exploration
    measures = list((material.manifest("design", "parameters", "directions", default={}) or {}).keys())
    if not results.is_adaptive or not all(name in results.runs for name in measures):
        return
    runs = results.runs
    if results.batch is not None:
        runs = runs[~runs[results.batch].isin(results.confirming_batches)]
    factors = list(results.factors)
    tried = [_tried(treatments, own, measures) for treatments, own in runs.groupby(factors, observed=True, sort=False)]
    tried.sort(key=lambda each: each["place"])
    columns = [text(name, _reader("treatments", place)) for place, name in enumerate(factors)]
    columns += [number("Runs done", lambda each: each["done"])]
    columns += [number(results.label(name), _reader("means", place)) for place, name in enumerate(measures)]
    table = build_table("searched", "What was tried in search of the best.", tried, columns, _NOTE)
    yield Part("design-searched", "What was tried", (table,), is_folded=len(tried) > _FEW)


#: So many rows are shown without being asked for.
_FEW = 30


def _tried(treatments: tuple[Any, ...], runs: pd.DataFrame, measures: list[str]) -> dict[str, Any]:
    done = runs[runs[STATUS] == RunStatus.DONE.value]
    means = [pd.to_numeric(done[name], errors="coerce").mean() for name in measures]
    return {
        "treatments": [str(each) for each in treatments],
        "done": len(done),
        "means": [None if pd.isna(mean) else float(mean) for mean in means],
        "place": runs.index[0],
    }


def _reader(part: str, place: int) -> Any:
    return lambda each: each[part][place]
