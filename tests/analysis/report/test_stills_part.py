"""What lab cameras kept of the mission is a figure of the report."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest
from matplotlib.image import imsave

from robot_runner.analysis.figures.style import FigureFormat, figure_bytes
from robot_runner.analysis.report.blocks import Beside, Gallery, Table
from robot_runner.analysis.report.document import report_document
from robot_runner.analysis.report.material import Material
from robot_runner.analysis.report.mission_figures import stills_part
from robot_runner.analysis.results import load_results
from robot_runner.analysis.statistics.experiment_statistics import analyse
from robot_runner.core.storage.layout import ExperimentFolder

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from robot_runner.analysis.report.blocks import FigureBlock


def material_of(folder: Any) -> Material:
    results = load_results(folder.root)
    return Material(results, analyse(results))


def keep_stills(folder: Any, run_id: str, *, notes: object = None) -> Path:
    raw = ExperimentFolder(folder.root).run(run_id) / "LabCamera"
    raw.mkdir(parents=True)
    imsave(raw / "still-1.jpg", [[[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]] * 2)
    (raw / "still-2.jpg").write_bytes(b"damaged")
    listed = [{"label": name, "file": f"still-{place}.jpg"} for place, name in enumerate(("beginning", "end"), start=1)]
    (raw / "stills.json").write_text(json.dumps(listed if notes is None else notes), encoding="utf-8")
    return raw


def figures(folder: Any) -> list[FigureBlock]:
    besides = [block for part in stills_part(material_of(folder)) for block in part.blocks]
    assert all(isinstance(block, Beside) and isinstance(block.blocks[-1], Table) for block in besides)
    galleries = [block for beside in besides for block in beside.blocks if isinstance(block, Gallery)]
    return [figure for gallery in galleries for figure in gallery.figures]


def test_an_experiment_without_a_camera_has_no_such_part(two_tasks: Callable[..., Any]) -> None:
    assert figures(two_tasks()) == []


@pytest.mark.long
def test_runs_are_shown_beneath_each_other(two_tasks: Callable[..., Any]) -> None:
    folder = two_tasks()
    for run_id in ("r_1", "r_2"):
        keep_stills(folder, run_id)
    (figure,) = figures(folder)
    assert "all runs that are done" in figure.caption
    assert figure.has_photographs
    drawn = figure.draw()
    assert [len(axes.images) for axes in drawn.axes] == [1, 0, 1, 0]  # the second of each run is damaged
    assert drawn.axes[0].get_title(loc="left").startswith("r_1")
    assert figure_bytes(drawn, FigureFormat.SVG)
    assert any(made.name == "stills LabCamera" for made in report_document(material_of(folder), made="now").figures)


@pytest.mark.parametrize(
    "notes", [{}, 3, [1], [{}], [{"label": "x", "file": "../../../etc/passwd"}], [{"label": "x", "file": "gone.jpg"}]]
)
def test_notes_that_are_none_or_lead_elsewhere_are_passed_over(two_tasks: Callable[..., Any], notes: object) -> None:
    folder = two_tasks()
    keep_stills(folder, "r_1", notes=notes)
    assert figures(folder) == []
