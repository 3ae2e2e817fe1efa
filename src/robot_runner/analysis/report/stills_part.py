"""What lab cameras saw: a figure of stills for each camera."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.analysis.figures.stills import RunStills, draw_stills
from robot_runner.analysis.report.blocks import Beside, FigureBlock, Gallery, Part
from robot_runner.analysis.report.means_table import means_table
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.errors import StorageError
from robot_runner.core.storage.guarded_files import read_json, require_file
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.words import counted

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from robot_runner.analysis.report.material import Material

__all__ = ["stills_part"]

#: What a camera notes beside its stills: `runs/<run id>/<plugin>/stills.json`.
_FILE = "stills.json"
#: More rows would be too small to see anything.
_MOST_RUNS = 8
_MOST_STILLS = 8


def stills_part(material: Material) -> Iterator[Part]:
    """Yield a part with a figure for each camera that kept stills of runs which are done."""
    folder = ExperimentFolder(material.results.folder)
    cameras: dict[str, list[RunStills]] = {}
    for run_id in map(str, material.done[RUN_ID]):
        for path in sorted(folder.run(run_id).glob(f"*/{_FILE}")):
            stills = _stills(path, folder.root)
            if stills:
                name = f"{run_id}, {material.labels[run_id]}"
                cameras.setdefault(path.parent.name, []).append(RunStills(name, stills))
    if cameras:
        figures = tuple(_figure(camera, runs) for camera, runs in cameras.items())
        beside = Beside((Gallery(figures), *means_table(material, "means beside stills")))
        yield Part("stills", "What the camera saw", (beside,))


def _figure(camera: str, runs: Sequence[RunStills]) -> FigureBlock:
    shown = runs[:: -(-len(runs) // _MOST_RUNS)]
    which = "all runs that are done" if len(shown) == len(runs) else f"{len(shown)} of {counted(len(runs), 'run')}"
    return FigureBlock(
        f"stills {camera}",
        f"Stills of the mission ({camera}), {which}. The videos are beside the raw data of each run.",
        f"Stills of {counted(len(shown), 'run')}.",
        lambda: draw_stills(shown),
        is_wide=True,
        has_photographs=True,
    )


def _stills(path: Path, root: Path) -> tuple[tuple[str, Path], ...]:
    """Return what each still shows, and its file; what is no such note, or leads elsewhere, is passed over."""
    try:
        listed = read_json(path, root)
    except StorageError:
        return ()
    notes = [note for note in listed if isinstance(note, dict)] if isinstance(listed, list) else []
    found = ((str(note.get("label")), path.parent / str(note.get("file"))) for note in notes)
    return tuple((label, file) for label, file in found if file.parent == path.parent and _is_file(file, root))[
        :_MOST_STILLS
    ]


def _is_file(path: Path, root: Path) -> bool:
    try:
        require_file(path, root)
    except StorageError:
        return False
    return True
