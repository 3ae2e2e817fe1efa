"""Write the report of an experiment: one document, and its tables and figures as files beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import Enum
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.analysis.figures.style import FigureFormat, figure_bytes
from robot_runner.analysis.report.document import json_of_report, report_document
from robot_runner.analysis.report.material import Material
from robot_runner.analysis.report.rendering import SafeNames, TableFiles, files_of_tables, html_of, markdown_of
from robot_runner.analysis.results import Results, results_of
from robot_runner.analysis.statistics.experiment_statistics import OnStep, analyse, unheard
from robot_runner.core.storage.guarded_files import make_folder, replace
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.safe_write import write_beside_and_rename
from robot_runner.core.storage.system_refusals import storage_errors

if TYPE_CHECKING:
    from robot_runner.analysis.report.blocks import Document
    from robot_runner.core.design.analysis_plan import AnalysisPlan


class ReportFormat(Enum):
    """The formats of a report."""

    HTML = "html"
    MARKDOWN = "md"
    JSON = "json"


@dataclass(frozen=True, slots=True)
class WrittenReport:
    """The written files: the document, its tables (CSV, LaTeX) and its figures (SVG, PDF, PNG)."""

    document: Path
    tables: tuple[Path, ...] = ()
    figures: tuple[Path, ...] = ()


def write_report(
    experiment: Results | Path | str,
    kind: ReportFormat = ReportFormat.HTML,
    *,
    output: Path | None = None,
    figures: Sequence[FigureFormat] = tuple(FigureFormat),
    measures: str | Sequence[str] | None = None,
    alpha: float | None = None,
    plan: AnalysisPlan | None = None,
    on_step: OnStep = unheard,
) -> WrittenReport:
    """Write the report of an experiment.

    Args:
        experiment: its results or its folder.
        kind: HTML is one self-contained file; Markdown refers to files of figures; JSON has no figures.
        output: the folder to write into; None for `report/` in the experiment's folder.
        figures: the file formats of each figure; Markdown needs SVG.
        measures: the measures to analyse; None for all.
        alpha: the level of significance; None for the planned one, or 0.05.
        plan: the plan to follow in the place of the experiment's; everything is exploratory then.
        on_step: is called with the current step, such as `figures`, the number done, and the total.

    Raises:
        StorageError: there is no experiment, or the folder cannot be written.
        AnalysisError: there is no such measure.
    """
    results = results_of(experiment).confirming
    statistics = analyse(results, measures=measures, alpha=alpha, plan=plan, on_step=on_step)
    material = Material(results, statistics)
    place = _Place(*report_folder(results.folder, output))
    made = made_by("Report", datetime.now(UTC))
    if kind is ReportFormat.JSON:
        return WrittenReport(place.write("report.json", json_of_report(material, made=made).encode()))
    return _write_document(report_document(material, made=made), kind, place, figures, on_step)


def report_folder(experiment: Path, output: Path | None) -> tuple[Path, Path]:
    """Return the root below which links are not followed, and the folder for the report.

    Raises:
        StorageError: the folder cannot be made.
    """
    if output is not None:
        with storage_errors(output, "made"):
            output.mkdir(parents=True, exist_ok=True)
        return output, output
    return experiment, ExperimentFolder(experiment).report


@dataclass(frozen=True, slots=True)
class _Place:
    """The target of a document's files: in `folder`, never through a link below `root`.

    The document is written last, and only it is synced to the disk: its figures and tables are many, and can be made
    again.
    """

    root: Path
    folder: Path

    def write(self, name: str, content: bytes, *, is_part: bool = False) -> Path:
        path = self.folder / name
        make_folder(path.parent, self.root)
        replace(path, content, self.root, is_lasting=not is_part)
        return path


def write_page(document: Document, path: Path) -> None:
    """Write a document as one self-contained HTML file.

    Raises:
        StorageError: the file cannot be written.
    """
    drawings = {block.name: figure_bytes(block.draw(), FigureFormat.SVG) for block in document.figures}
    text = html_of(document, drawings, files_of_tables(document))
    write_beside_and_rename(path, lambda file: file.write(text))


def write_parts(document: Document, folder: Path) -> tuple[Path, ...]:
    """Write each figure of a document (SVG, PDF, PNG) into `figures/` and each table (CSV, LaTeX) into `tables/`.

    Raises:
        StorageError: a file cannot be written.
    """
    place = _Place(*report_folder(folder, folder))
    figures, _ = _write_figures(document, place, SafeNames(), tuple(FigureFormat))
    return (*figures, *_write_tables(files_of_tables(document), place))


def made_by(what: str, moment: datetime) -> str:
    """Return the line with the date and the program that made a document."""
    return f"{what} made by Robot Runner {version('robot-runner')} on {moment:%Y-%m-%d at %H:%M} UTC."


def _write_document(
    document: Document,
    kind: ReportFormat,
    place: _Place,
    formats: Sequence[FigureFormat],
    on_step: OnStep,
) -> WrittenReport:
    """Write a document as HTML or Markdown, with its tables and figures in `tables/` and `figures/`."""
    needed = {FigureFormat.SVG} if kind is ReportFormat.MARKDOWN else set()  # the document refers to them
    kinds = [each for each in FigureFormat if each in needed.union(formats)]
    names = SafeNames()
    figures, drawings = _write_figures(document, place, names, kinds, on_step)
    files = files_of_tables(document, on_step)
    tables = _write_tables(files, place)
    if kind is ReportFormat.MARKDOWN:
        text = markdown_of(document, lambda name: f"figures/{names(name)}.svg")
    else:
        text = html_of(document, drawings, files)
    return WrittenReport(place.write(f"report.{kind.value}", text.encode()), tables, figures)


def _write_figures(
    document: Document,
    place: _Place,
    names: SafeNames,
    kinds: Sequence[FigureFormat],
    on_step: OnStep = unheard,
) -> tuple[tuple[Path, ...], dict[str, bytes]]:
    """Write each figure in these formats; return the files, and all figures as SVG."""
    files, drawings = [], {}
    for number, block in enumerate(document.figures):
        on_step("figures", number, len(document.figures))
        figure = block.draw()
        drawings[block.name] = figure_bytes(figure, FigureFormat.SVG)
        for kind in kinds:
            content = drawings[block.name] if kind is FigureFormat.SVG else figure_bytes(figure, kind)
            files.append(place.write(f"figures/{names(block.name)}.{kind.value}", content, is_part=True))
    return tuple(files), drawings


def _write_tables(tables: Mapping[str, TableFiles], place: _Place) -> tuple[Path, ...]:
    return tuple(
        place.write(f"tables/{name}", content, is_part=True)
        for each in tables.values()
        for name, content in each.contents
    )
