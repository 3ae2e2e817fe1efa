"""A report as JSON, for programs: everything with its full precision, nothing drawn."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from robot_runner.analysis.report.sections.design import order_in_words
from robot_runner.analysis.report.sections.threats import threats_of

if TYPE_CHECKING:
    from robot_runner.analysis.report.material import Material

__all__ = ["json_of_report", "plain"]

_FORMAT = 1


def json_of_report(material: Material, *, made: str) -> str:
    """Return the report of an experiment as JSON; a value that is missing or could not be computed is null."""
    results = material.results
    document = {
        "format": _FORMAT,
        "made": made,
        "experiment": results.name,
        "is_running": results.is_running,
        "design": {
            "factors": {name: list(map(str, results.runs[name].cat.categories)) for name in results.factors},
            "repetition": results.repetition,
            "order": order_in_words(material),
            "seed": results.seed,
            "robot": material.manifest("robot"),
            "deviations": material.manifest("deviations", default={}),
        },
        "circumstances": {key: material.manifest(key) for key in ("config", "host", "executions", "plugins")},
        "versions": {key: material.manifest("software", key) for key in ("robot_runner", "python")},
        "columns": {name: column for name, column in results.columns.items() if name in results.measures},
        "runs": results.runs.to_dict("records"),
        "quality": material.qualities,
        "statistics": material.statistics,
        "threats": threats_of(material),
    }
    return json.dumps(plain(document), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def plain(value: Any) -> Any:
    """Return a value as JSON has it: what is not finite or missing is None, what it does not know is text.

    Example:
        >>> plain({"mean": float("nan"), "n": 5})
        {'mean': None, 'n': 5}
    """
    if is_dataclass(value) and not isinstance(value, type):
        return {each.name: plain(getattr(value, each.name)) for each in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(each) for each in value]
    return _plain_cell(value)


def _plain_cell(value: Any) -> Any:
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, pd.Timestamp):
        return value.isoformat().replace("+00:00", "Z")
    cell = value.item() if isinstance(value, np.generic) else value
    if cell is None or cell is pd.NA or cell is pd.NaT or (isinstance(cell, float) and not math.isfinite(cell)):
        return None
    return cell if isinstance(cell, bool | int | float | str) else str(cell)
