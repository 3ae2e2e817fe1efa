"""Rooms: walls, boxes and cylinders on a plane, the starts of robots, and the lengths of rays."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from robot_runner.simulator.turtlebot3_parameters import Floats

WALL_HEIGHT = 0.5


@dataclass(frozen=True, slots=True)
class Pose:
    """A true pose in the room: metres and radians (-pi..pi)."""

    x: float
    y: float
    yaw: float


@dataclass(frozen=True, slots=True)
class Wall:
    """An upright box: its centre, half its sides and its height in metres, turned by `yaw` radians."""

    x: float
    y: float
    half_x: float
    half_y: float
    yaw: float = 0.0
    height: float = WALL_HEIGHT

    def distance(self, x: float, y: float) -> float:
        """Return how far (m) a point is from its outside; 0 within it."""
        along = math.cos(self.yaw) * (x - self.x) + math.sin(self.yaw) * (y - self.y)
        across = math.cos(self.yaw) * (y - self.y) - math.sin(self.yaw) * (x - self.x)
        return math.hypot(max(abs(along) - self.half_x, 0.0), max(abs(across) - self.half_y, 0.0))


@dataclass(frozen=True, slots=True)
class Cylinder:
    """An upright cylinder: its centre, radius and height in metres."""

    x: float
    y: float
    radius: float
    height: float = WALL_HEIGHT

    def distance(self, x: float, y: float) -> float:
        """Return how far (m) a point is from its outside; 0 within it."""
        return max(math.hypot(x - self.x, y - self.y) - self.radius, 0.0)


Obstacle = Wall | Cylinder

#: A room of 5.5 m x 4 m with a pillar; the robot starts at the origin and looks along x.
ARENA = (
    Wall(4.05, 0.0, 0.05, 2.1),
    Wall(-1.55, 0.0, 0.05, 2.1),
    Wall(1.25, 2.05, 2.85, 0.05),
    Wall(1.25, -2.05, 2.85, 0.05),
    Wall(1.0, -1.2, 0.15, 0.15),
)
#: The default start of a robot.
ORIGIN = Pose(0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Room:
    """The obstacles of a room, and the starts of its robots.

    Attributes:
        obstacles: all of them, including the walls around.
        robots: the start of each robot, by namespace (empty, or `/alice`). Two or more are in one world, where they
            see and hit each other. If empty, each requested robot starts at the origin of its own copy of the room.

    Example:
        >>> Room((Cylinder(1.0, 0.0, 0.1),)).clearance(0.0, 0.0)
        0.9
    """

    obstacles: tuple[Obstacle, ...] = ARENA
    robots: Mapping[str, Pose] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def is_shared(self) -> bool:
        """Whether its robots are in one world."""
        return len(self.robots) > 1

    def start(self, namespace: str) -> Pose:
        """Return the start of the robot of a namespace."""
        return self.robots.get(namespace, ORIGIN)

    def below(self, namespace: str) -> Room:
        """Return the same room with its robots below a namespace."""
        return Room(self.obstacles, MappingProxyType({f"{namespace}{name}": at for name, at in self.robots.items()}))

    def clearance(self, x: float, y: float) -> float:
        """Return the distance (m) of a point from the nearest obstacle; 0 within one, infinite if there is none."""
        return min((each.distance(x, y) for each in self.obstacles), default=math.inf)


#: The default room of the embedded robot.
DEFAULT_ROOM = Room()


def ray_distances(obstacles: Sequence[Obstacle], x: float, y: float, angles: Floats) -> Floats:
    """Return the length (m) of each ray from a point to the first obstacle; infinite if it meets none.

    A ray that begins within an obstacle ignores it.
    """
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    walls = [each for each in obstacles if isinstance(each, Wall)]
    cylinders = [each for each in obstacles if isinstance(each, Cylinder)]
    nearest = np.full(len(angles), np.inf)
    if walls:
        nearest = np.minimum(nearest, _to_walls(walls, x, y, directions))
    if cylinders:
        nearest = np.minimum(nearest, _to_cylinders(cylinders, x, y, directions))
    return nearest


def _to_walls(walls: Sequence[Wall], x: float, y: float, directions: Floats) -> Floats:
    """Return the distances to upright boxes.

    Slab method, in each box's own axes: a ray is inside a box while it is between both pairs of parallel sides
    (Kay and Kajiya, Ray Tracing Complex Scenes, SIGGRAPH 1986).
    """
    turns = np.array([wall.yaw for wall in walls])
    centres = _turned(np.array([(wall.x - x, wall.y - y) for wall in walls]), turns)
    halves = np.array([(wall.half_x, wall.half_y) for wall in walls])
    own = _turned(directions[:, np.newaxis, :], turns)
    # A ray along an axis never enters or never leaves the sides along that axis: infinities are intended.
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        one_side = (centres - halves) / own
        other_side = (centres + halves) / own
    entry = np.minimum(one_side, other_side).max(axis=2)
    leaving = np.maximum(one_side, other_side).min(axis=2)
    hits = np.where((entry <= leaving) & (entry >= 0), entry, np.inf)
    nearest: Floats = hits.min(axis=1)
    return nearest


def _turned(vectors: Floats, turns: Floats) -> Floats:
    """Return vectors (… x 2) in the axes of boxes that are turned by `turns` radians."""
    cosines, sines = np.cos(turns), np.sin(turns)
    x, y = vectors[..., 0], vectors[..., 1]
    return np.stack([x * cosines + y * sines, y * cosines - x * sines], axis=-1)


def _to_cylinders(cylinders: Sequence[Cylinder], x: float, y: float, directions: Floats) -> Floats:
    """Return the distances to upright cylinders: to the first intersection of a ray and a circle."""
    centres = np.array([(each.x - x, each.y - y) for each in cylinders])
    radii = np.array([each.radius for each in cylinders])
    along = directions @ centres.T
    beside = (centres**2).sum(axis=1) - along**2
    with np.errstate(invalid="ignore"):
        entry = along - np.sqrt(radii**2 - beside)  # NaN if the ray misses
    hits = np.where(entry >= 0, entry, np.inf)
    nearest: Floats = hits.min(axis=1)
    return nearest
