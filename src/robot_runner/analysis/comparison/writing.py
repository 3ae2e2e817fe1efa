"""Writes the comparison of two experiments as a page, and as JSON."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from robot_runner.analysis.comparison.document import comparison_document
from robot_runner.analysis.figures.files import FigureFormat, figure_bytes
from robot_runner.analysis.report.html import html_of
from robot_runner.analysis.report.json_document import plain
from robot_runner.analysis.report.writing import made_by
from robot_runner.storage.safe_write import write_beside_and_rename

if TYPE_CHECKING:
    from pathlib import Path

    from robot_runner.analysis.comparison.outcome import Comparison

__all__ = ["json_of_comparison", "write_comparison"]

_FORMAT = 1


def write_comparison(comparison: Comparison, path: Path) -> None:
    """Write a comparison as one HTML file that needs nothing beside it.

    Raises:
        StorageError: it cannot be written.
    """
    document = comparison_document(comparison, made=made_by("Comparison", datetime.now(UTC)))
    drawings = {block.name: figure_bytes(block.draw(), FigureFormat.SVG) for block in document.figures}
    text = html_of(document, drawings)
    write_beside_and_rename(path, lambda file: file.write(text))


def json_of_comparison(comparison: Comparison) -> str:
    """Return a comparison as JSON; what is missing or could not be computed is null."""
    facts = {"format": _FORMAT, "verdict": comparison.verdict, **plain(comparison)}
    return json.dumps(plain(facts), indent=2, ensure_ascii=False, allow_nan=False)
