"""The Jupyter notebook that computes every number of a report again."""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Any

from robot_runner.analysis.recomputing.literals import Code, python_literal, rendered
from robot_runner.analysis.recomputing.procedures import procedures
from robot_runner.analysis.recomputing.study_facts import LEVEL

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from robot_runner.analysis.recomputing.study_facts import Compared, Reported, StudyFacts

__all__ = ["cells_of", "notebook"]

_CELL = re.compile(r"^# %%( \[markdown\])?\n", re.MULTILINE)
_BLANK_LINES = re.compile(r"\n{4,}")


def notebook(study: StudyFacts) -> str:
    """Return the notebook, as nbformat 4.5 has it: https://nbformat.readthedocs.io/en/latest/format_description.html."""
    cells = [_cell(place, kind, source) for place, (kind, source) in enumerate(cells_of(study), start=1)]
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    content = {
        "cells": cells,
        "metadata": {"kernelspec": kernel, "language_info": {"name": "python"}},
        "nbformat": 4,
        "nbformat_minor": 5,
    }
    return json.dumps(content, indent=1, ensure_ascii=False) + "\n"


def cells_of(study: StudyFacts) -> list[tuple[str, str]]:
    """Return the kind of each cell, `code` or `markdown`, and what it holds."""
    text = rendered(
        "notebook.py.j2",
        study=study,
        table=_table,
        mapping=_mapping,
        levels=_levels,
        level=lambda measure: Code("" if measure.level == LEVEL else f", level={python_literal(measure.level)}"),
        tolerance=lambda kind: Code(", tolerance=1e-4" if kind == "mixed" else ""),
        **procedures("None", "lambda groups, contrasts: {}"),
        terms=lambda it: Code(f"[{', '.join(_names(effect.factors) for effect in it.effects)}]"),
    )
    _, *parts = _CELL.split(text)
    found = [("markdown" if mark else "code", source) for mark, source in zip(parts[::2], parts[1::2], strict=True)]
    return [(kind, _BLANK_LINES.sub("\n\n\n", source).strip()) for kind, source in found if source.strip()]


def _cell(place: int, kind: str, source: str) -> dict[str, Any]:
    cell: dict[str, Any] = {
        "cell_type": kind,
        "id": f"cell-{place}",
        "metadata": {},
        "source": source.splitlines(keepends=True),
    }
    return cell | ({"execution_count": None, "outputs": []} if kind == "code" else {})


def _table(reported: Reported) -> Code:
    rows = [f"    ({', '.join(map(python_literal, (label, *numbers)))}),\n" for label, numbers in reported.rows]
    return Code(f"reported(\n    {python_literal(reported.columns)},\n{''.join(rows)})")


def _mapping(of: Mapping[str, object]) -> Code:
    return Code(f"{{{', '.join(f'{python_literal(key)}: {python_literal(value)}' for key, value in of.items())}}}")


def _levels(names: Iterable[str], it: Compared) -> Code:
    """Return the treatments of some factors, by factor."""
    return _mapping({name: levels for name, levels in it.factors if name in set(names)})


def _names(factors: Sequence[str]) -> str:
    return f"({', '.join(map(python_literal, factors))},)"
