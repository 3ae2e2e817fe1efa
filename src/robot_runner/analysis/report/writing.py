"""Writes the report of an experiment: one document, and its tables and figures as files beside it."""

from __future__ import annotations

import os
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import Enum
from importlib.metadata import version
from typing import TYPE_CHECKING

from robot_runner.analysis.figures.pdf_worker import PdfWorker
from robot_runner.analysis.figures.style import FigureFormat, figure_bytes
from robot_runner.analysis.report.document import json_of_report, report_document
from robot_runner.analysis.report.html import html_of
from robot_runner.analysis.report.markdown import csv_of, latex_of, markdown_of
from robot_runner.analysis.report.material import Material
from robot_runner.analysis.report.names import SafeNames
from robot_runner.analysis.results import Results, load_results
from robot_runner.analysis.statistics.experiment import analyse
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.safe_write import storage_error, write_beside_and_rename

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.figure import Figure

    from robot_runner.analysis.report.blocks import Document

__all__ = ["ReportFormat", "WrittenReport", "made_by", "write_document", "write_report"]


class ReportFormat(Enum):
    """What a report is written as."""

    HTML = "html"
    MARKDOWN = "md"
    JSON = "json"


@dataclass(frozen=True, slots=True)
class WrittenReport:
    """What was written.

    Attributes:
        document: the report itself.
        tables: CSV and LaTeX files.
        figures: SVG, PDF and PNG files.
    """

    document: Path
    tables: tuple[Path, ...] = ()
    figures: tuple[Path, ...] = ()


def write_report(
    experiment: Results | Path | str,
    kind: ReportFormat = ReportFormat.HTML,
    *,
    output: Path | None = None,
    figures: Sequence[FigureFormat] = tuple(FigureFormat),
    measures: Sequence[str] | None = None,
    alpha: float | None = None,
) -> WrittenReport:
    """Write the report of an experiment.

    Args:
        experiment: its results or its folder.
        kind: HTML is one file that needs nothing beside it; Markdown refers to files of figures; JSON has none.
        output: the folder to write into; None is `report/` in the experiment's folder.
        figures: which files are made of each figure; Markdown needs SVG.
        measures: which measures are analysed; None for all.
        alpha: the level of significance; None for the one that was fixed beforehand, or 0.05.

    Raises:
        StorageError: there is no experiment, or the folder cannot be written.
        AnalysisError: there is no such measure.
    """
    with ExitStack() as closing:
        # It is started first, so that it is ready when the first figure is.
        worker = closing.enter_context(PdfWorker()) if _is_worth_a_worker(kind, figures) else None
        results = experiment if isinstance(experiment, Results) else load_results(experiment)
        material = Material(results, analyse(results, measures=measures, alpha=alpha))
        return _write_report(material, kind, output, figures, worker)


def _is_worth_a_worker(kind: ReportFormat, figures: Sequence[FigureFormat]) -> bool:
    return kind is not ReportFormat.JSON and FigureFormat.PDF in figures and (os.cpu_count() or 1) > 1


def _write_report(
    material: Material,
    kind: ReportFormat,
    output: Path | None,
    figures: Sequence[FigureFormat],
    worker: PdfWorker | None,
) -> WrittenReport:
    folder = ExperimentFolder(material.results.folder).report if output is None else output
    made = made_by("Report", datetime.now(UTC))
    if kind is ReportFormat.JSON:
        path = folder / "report.json"
        _make(folder)
        write_beside_and_rename(path, lambda file: file.write(json_of_report(material, made=made)))
        return WrittenReport(path)
    return write_document(report_document(material, made=made), kind, folder, "report", figures, worker)


def made_by(what: str, moment: datetime) -> str:
    """Return the line that says when and by what a document was made."""
    return f"{what} made by Robot Runner {version('robot-runner')} on {moment:%Y-%m-%d at %H:%M} UTC."


def write_document(
    document: Document,
    kind: ReportFormat,
    folder: Path,
    name: str,
    formats: Sequence[FigureFormat],
    worker: PdfWorker | None = None,
) -> WrittenReport:
    """Write a document as HTML or Markdown, with its tables and figures in `tables/` and `figures/`.

    Args:
        document: what is written.
        kind: HTML or Markdown.
        folder: where to; it is made if need be.
        name: of the document's file, without its ending.
        formats: which files are made of each figure.
        worker: makes the PDF files meanwhile; None makes them here.

    Raises:
        StorageError: the folder cannot be written.
    """
    names = SafeNames()
    drawings, figures = _Figures(folder / "figures", names, tuple(formats), worker).write(document, kind)
    tables = _write_tables(document, folder / "tables")
    path = folder / f"{name}.{kind.value}"
    _make(folder)
    if kind is ReportFormat.MARKDOWN:
        text = markdown_of(document, lambda figure: f"figures/{names(figure)}.svg")
    else:
        text = html_of(document, drawings)
    write_beside_and_rename(path, lambda file: file.write(text))
    return WrittenReport(path, tables, figures)


@dataclass(frozen=True, slots=True)
class _Figures:
    """Writes the figures of a document."""

    folder: Path
    names: SafeNames
    formats: tuple[FigureFormat, ...]
    worker: PdfWorker | None

    def write(self, document: Document, kind: ReportFormat) -> tuple[dict[str, bytes], tuple[Path, ...]]:
        """Write all figures; return them as SVG by their names, and the files."""
        formats = [each for each in FigureFormat if each in self.formats]
        if kind is ReportFormat.MARKDOWN and FigureFormat.SVG not in formats:  # the document refers to them
            formats.insert(0, FigureFormat.SVG)
        if formats and document.figures:
            _make(self.folder)
        drawings: dict[str, bytes] = {}
        paths: list[Path] = []
        for block in document.figures:
            figure = block.draw()
            drawings[block.name] = figure_bytes(figure, FigureFormat.SVG)
            paths += [self._write(block.name, figure, drawings[block.name], each) for each in formats]
        return drawings, tuple(paths)

    def _write(self, name: str, figure: Figure, svg: bytes, kind: FigureFormat) -> Path:
        path = self.folder / f"{self.names(name)}.{kind.value}"
        if kind is FigureFormat.PDF and self.worker is not None:
            self.worker.write(figure, path)
        else:
            _write(path, svg if kind is FigureFormat.SVG else figure_bytes(figure, kind))
        return path


def _write_tables(document: Document, folder: Path) -> tuple[Path, ...]:
    names = SafeNames()
    if document.tables:
        _make(folder)
    paths = []
    for table in document.tables:
        for ending, text in (("csv", csv_of(table)), ("tex", latex_of(table))):
            path = folder / f"{names(table.name)}.{ending}"
            _write(path, text.encode("utf-8"))
            paths.append(path)
    return tuple(paths)


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise storage_error(folder, "made", error) from error


def _write(path: Path, data: bytes) -> None:
    try:
        path.write_bytes(data)
    except OSError as error:
        raise storage_error(path, "written", error) from error
