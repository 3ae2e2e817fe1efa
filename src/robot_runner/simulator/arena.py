"""The room in which the robot drives, and what a ray of its laser scanner hits there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import numpy.typing as npt

__all__ = ["ARENA", "WALL_HEIGHT", "Wall", "ray_distances"]

WALL_HEIGHT = 0.5


@dataclass(frozen=True, slots=True)
class Wall:
    """An upright box whose sides are parallel to the axes: its centre and the halves of its sides, in metres."""

    x: float
    y: float
    half_x: float
    half_y: float


#: A room of 5.5 m x 4 m with a pillar; the robot starts at the origin and looks along x.
ARENA = (
    Wall(4.05, 0.0, 0.05, 2.1),
    Wall(-1.55, 0.0, 0.05, 2.1),
    Wall(1.25, 2.05, 2.85, 0.05),
    Wall(1.25, -2.05, 2.85, 0.05),
    Wall(1.0, -1.2, 0.15, 0.15),
)


def ray_distances(
    walls: tuple[Wall, ...], x: float, y: float, angles: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Return how far (m) each ray from a point goes to the first wall; infinite where it meets none.

    Slab method: a ray is inside a box while it is between both pairs of parallel sides
    (Kay and Kajiya, Ray Tracing Complex Scenes, SIGGRAPH 1986).
    """
    centres = np.array([(wall.x - x, wall.y - y) for wall in walls])
    halves = np.array([(wall.half_x, wall.half_y) for wall in walls])
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)[:, np.newaxis, :]
    # A ray along an axis never enters or never leaves the sides along that axis: infinities are meant.
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        one_side = (centres - halves) / directions
        other_side = (centres + halves) / directions
    entry = np.minimum(one_side, other_side).max(axis=2)
    leaving = np.maximum(one_side, other_side).min(axis=2)
    hits = np.where((entry <= leaving) & (entry >= 0), entry, np.inf)
    nearest: npt.NDArray[np.float64] = hits.min(axis=1)
    return nearest
