"""What the planned runs of a design can tell, and how its blocks lie: from the run table, done, excluded or not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.analysis.run_frame import treatment_texts
from robot_runner.analysis.statistics.aliasing import aliasing_of
from robot_runner.analysis.statistics.known_design import PLAIN, KnownDesign, before_column, role_column
from robot_runner.analysis.statistics.nested_factors import IDLE, Conditions, NestedFactors, codes_of
from robot_runner.core.design.columns import RUN_ID

if TYPE_CHECKING:
    import pandas as pd

    from robot_runner.analysis.results import Results


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
    own = {name: conditions[name] for name in varied if set(conditions.get(name, ())) & set(varied)}
    codes = {name: np.unique(planned[name], return_inverse=True)[1] for name in varied}
    nested = None
    if own:
        levels = {
            name: [text for text in sorted(set(planned[name])) if name not in own or text != IDLE] for name in varied
        }
        nested = NestedFactors(
            levels, {name: {p: of for p, of in each.items() if p in varied} for name, each in own.items()}
        )
        codes = codes_of(planned, nested)
    only, together = not known.has_interactions, known.together
    known = known.with_aliasing(aliasing_of(codes, main_only=only, together=together, nested=nested))
    if known.whole_plot:
        plots = frame.groupby(role_column(known.whole_plot), observed=True)
        numbered_anew = tuple(name for name in known.blocks if plots[role_column(name)].nunique().max() > 1)
        known = known.with_plot_columns(numbered_anew)
    return known
