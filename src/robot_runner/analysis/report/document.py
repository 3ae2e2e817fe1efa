"""The report of an experiment as a document of sections, and as JSON with full precision for programs."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from robot_runner.analysis.report.blocks import Badge, Document, Tone
from robot_runner.analysis.report.design_section import description_section, design_section, order_in_words, shown_stamp
from robot_runner.analysis.report.measure_figures import figures_section
from robot_runner.analysis.report.outcome_section import outcome_section
from robot_runner.analysis.report.summary_section import replication_section, summary_section
from robot_runner.analysis.report.tests_section import tests_section
from robot_runner.analysis.report.threats_section import threats_of, threats_section
from robot_runner.analysis.wording import listed
from robot_runner.core.secret_names import shown_settings
from robot_runner.core.words import counted

if TYPE_CHECKING:
    from robot_runner.analysis.report.material import Material

_FORMAT = 1


def json_of_report(material: Material, *, made: str) -> str:
    """Return the report of an experiment as JSON; missing and not computed values are null."""
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
            "deviations": shown_settings(material.manifest("deviations", default={})),
            "batches": material.manifest("design", "batches", default=[]),
            "warm_ups": results.warm_ups,
        },
        "circumstances": {key: material.manifest(key) for key in ("config", "host", "executions", "plugins")},
        "versions": {key: material.manifest("software", key) for key in ("robot_runner", "python")},
        "columns": {name: column for name, column in results.columns.items() if name in results.measures},
        "runs": results.runs.to_dict("records"),
        "excluded": material.excluded.to_dict("records"),
        "quality": material.qualities,
        "doubtful_values": material.doubted.to_dict("records"),
        "statistics": material.statistics,
        "precision": tuple(material.precisions.values()),
        "registration": material.registered.as_mapping() if material.registered is not None else None,
        "threats": threats_of(material),
    }
    return json.dumps(plain(document), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def plain(value: Any) -> Any:
    """Return a value for JSON: None for a missing or infinite one, a text for a type that JSON does not have.

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


def report_document(material: Material, *, made: str) -> Document:
    """Return the report of an experiment; its figures are not drawn yet."""
    threats = threats_of(material)
    return Document(
        kicker="Experiment report",
        title=material.results.name,
        subtitle=" · ".join(_subtitle(material)),
        badges=tuple(_badges(material)),
        sections=(
            summary_section(material, threats),
            design_section(material),
            outcome_section(material),
            description_section(material),
            figures_section(material),
            tests_section(material),
            threats_section(material, threats),
            replication_section(material),
        ),
        made=made,
    )


def _subtitle(material: Material) -> Iterator[str]:
    yield counted(len(material.runs), "run")
    if material.results.factors:
        noun = "factor" if len(material.results.factors) == 1 else "factors"
        yield f"{noun}: {listed(material.results.factors)}"
    executions = material.manifest("executions", default=[])
    if executions:
        yield shown_stamp(executions[0].get("started_at", ""))[:10]


def _badges(material: Material) -> Iterator[Badge]:
    robot = str(material.manifest("robot", default=""))
    if robot.partition(":")[0] == "simulated":
        yield Badge("simulated robot", Tone.WARNING, "Nothing in this report was measured on a real robot.")
    elif {"simulated", "estimated"} & material.origins.keys():
        yield Badge("some values not measured", Tone.WARNING, "Some measures are simulated or estimated.")
    if len(material.doubted):
        doubt = f"{counted(len(material.doubted), 'value')} doubtful or missing"
        yield Badge(doubt, Tone.WARNING, "Reasons, and what stands without them, are in this report.")
    if material.results.is_running:
        yield Badge("still being executed", Tone.WARNING)
