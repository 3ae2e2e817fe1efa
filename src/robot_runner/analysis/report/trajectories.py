"""The ways that robots took, where a system kept them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.analysis.figures.trajectory import Way, draw_trajectories
from robot_runner.analysis.report.blocks import FigureBlock, Gallery, Part
from robot_runner.analysis.report.sample_columns import is_way
from robot_runner.analysis.wording import counted
from robot_runner.design.columns import RUN_ID

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.analysis.report.material import Material
    from robot_runner.analysis.sample_files import SampleFile

__all__ = ["trajectory_part"]

#: More ways than that hide each other.
_MOST = 60


def trajectory_part(material: Material) -> Iterator[Part]:
    """Yield a part with a figure for each robot whose way was kept."""
    figures = []
    for file in material.results.sample_files:
        runs = [run_id for run_id in material.done[RUN_ID] if run_id in file.paths]
        if is_way(file.columns) and runs:
            figures.append(_figure(material, file, runs))
    if figures:
        yield Part("trajectory", "The way of the robot", (Gallery(tuple(figures)),))


def _figure(material: Material, file: SampleFile, runs: list[str]) -> FigureBlock:
    shown = runs[:: -(-len(runs) // _MOST)]
    samples = material.results.samples(
        file.plugin, file=file.name, runs=shown, columns=["x_m", "y_m"], with_factors=False, with_phases=False
    )
    ways = [
        Way(material.labels[str(run_id)], way["x_m"].to_numpy(dtype="float64"), way["y_m"].to_numpy(dtype="float64"))
        for run_id, way in samples.groupby("run_id", observed=True)
    ]
    whose = "all runs that are done" if len(shown) == len(runs) else f"{len(shown)} of {counted(len(runs), 'run')}"
    return FigureBlock(
        f"trajectory {file.plugin}",
        f"The way of the robot ({file.plugin}) by its odometry, {whose}. Circle: beginning; cross: end.",
        f"{counted(len(ways), 'way')} seen from above.",
        lambda: draw_trajectories(ways, order=material.order),
    )
