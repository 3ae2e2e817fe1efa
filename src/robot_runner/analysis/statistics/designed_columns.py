"""The columns of a design's model as they are, of any rank: to see what is left beside effects and blocks."""

from __future__ import annotations

from itertools import combinations_with_replacement
from typing import TYPE_CHECKING

import numpy as np

from robot_runner.analysis.statistics.effect_coding import coded_columns

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pandas as pd
    from numpy.typing import NDArray

    from robot_runner.analysis.statistics.known_design import KnownDesign

    Floats = NDArray[np.float64]


def numbers_of_levels(levels: Sequence[str]) -> list[float] | None:
    """Return treatments as numbers; None where one is none.

    Example:
        >>> numbers_of_levels(["0.1", "0.2"]), numbers_of_levels(["slow", "fast"])
        ([0.1, 0.2], None)
    """
    try:
        found = [float(level) for level in levels]
    except ValueError:
        return None
    return found if np.isfinite(found).all() else None


def designed_columns(
    frame: pd.DataFrame, factors: Mapping[str, Sequence[str]], blocks: Sequence[str], known: KnownDesign
) -> Floats:
    """Return the columns of a constant, of effects and of blocks, (runs, columns).

    Args:
        frame: the runs; factors and blocks are texts.
        factors: the treatments of each factor.
        blocks: the columns that are blocks, whole plots among them.
        known: the design.
    """
    codes = {
        name: frame[name].astype(str).map({text: place for place, text in enumerate(levels)}).to_numpy(int)
        for name, levels in factors.items()
    }
    sizes = {name: len(levels) for name, levels in factors.items()}
    numbers = {name: numbers_of_levels(levels) for name, levels in factors.items()}
    parts: list[Floats] = [np.ones((len(frame), 1))]
    for name in blocks:
        _, code = np.unique(frame[name].astype(str), return_inverse=True)
        parts.append(np.eye(int(code.max()) + 1)[code])
    numeric = {name: np.array(each)[codes[name]] for name, each in numbers.items() if each is not None}
    if known.is_surface:
        scaled = {name: (each - each.mean()) / max(float(np.ptp(each)), 1e-300) for name, each in numeric.items()}
        parts += [each[:, None] for each in scaled.values()]
        pairs = list(combinations_with_replacement(scaled, 2))
        if 1 + len(scaled) + len(pairs) < len(frame):
            parts += [(scaled[one] * scaled[other])[:, None] for one, other in pairs]
    terms = known.terms or tuple((name,) for name in factors if not (known.is_surface and name in numeric))
    told = [coded_columns(codes, sizes, term) for term in terms if set(term) <= set(factors)]
    main = [each for each, term in zip(told, terms, strict=False) if len(term) == 1]
    return np.column_stack(parts + (told if sum(each.shape[1] for each in told) < len(frame) / 2 else main))
