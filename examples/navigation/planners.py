"""Two planners for a robot with a laser scanner: one looks no further than its scan, the other keeps a map.

A planner is asked ten times a second where to steer for, and answers with a point near the robot, or None where it
knows no way on.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass

#: Half the width of the robot and some room, m.
CLEARANCE = 0.17
#: What is less far ahead is beside the robot, m: it may turn away from it.
BESIDE = 0.06
#: How far ahead of the robot the point to steer for is, m.
LOOK_AHEAD = 0.35


@dataclass(frozen=True)
class Place:
    """Where the robot is: m, m, rad."""

    x: float
    y: float
    heading: float = 0.0

    def to(self, other: Place) -> float:
        """Return how far another place is, m."""
        return math.dist((self.x, self.y), (other.x, other.y))


class Straight:
    """Goes straight to the goal, and round what the scan shows in the way: it forgets what it does not see."""

    def __init__(self) -> None:
        self.side = 0.0

    def next_point(self, here: Place, goal: Place, obstacles: list[tuple[float, float]]) -> Place | None:
        """Return the nearest direction to the goal's in which there is room."""
        bearing = math.atan2(goal.y - here.y, goal.x - here.x)
        ahead = min(2 * LOOK_AHEAD, here.to(goal))
        turns = [math.radians(degrees) for degrees in range(0, 121, 10)]
        for turn in turns:
            for side in (self.side, -self.side) if self.side else (1.0, -1.0):
                if self._is_free(here, bearing + side * turn, ahead, obstacles):
                    self.side = side if turn else 0.0  # once it goes left round something, it goes on to
                    return _ahead(here, bearing + side * turn, min(LOOK_AHEAD, ahead))
        return None

    def _is_free(self, here: Place, heading: float, ahead: float, obstacles: list[tuple[float, float]]) -> bool:
        cos, sin = math.cos(heading), math.sin(heading)
        for x, y in obstacles:
            along = (x - here.x) * cos + (y - here.y) * sin
            across = (y - here.y) * cos - (x - here.x) * sin
            if BESIDE < along < ahead and abs(across) < CLEARANCE:
                return False
        return True


class AStar:
    """Keeps a map of all that it has seen, and plans the shortest way over it (Hart, Nilsson and Raphael, 1968)."""

    cell = 0.05
    #: A cell next to an obstacle costs so much more: a way of some room is better than the shortest.
    margin_cost = 3.0
    #: No way that costs more than so many cells is looked for.
    longest = 400.0

    def __init__(self) -> None:
        self.occupied: set[tuple[int, int]] = set()
        self.blocked: set[tuple[int, int]] = set()
        self.tight: set[tuple[int, int]] = set()
        self.way: list[tuple[int, int]] = []

    def next_point(self, here: Place, goal: Place, obstacles: list[tuple[float, float]]) -> Place | None:
        """Return the point of the shortest way that lies a little ahead."""
        self._note(obstacles)
        if not self.way or not self.blocked.isdisjoint(self.way[1:]):
            self.way = self._plan(self._cell_of(here.x, here.y), self._cell_of(goal.x, goal.y))
        if not self.way:
            return None
        places = [Place(column * self.cell, row * self.cell) for column, row in self.way]
        nearest = min(range(len(places)), key=lambda number: here.to(places[number]))
        return next((place for place in places[nearest:] if here.to(place) >= LOOK_AHEAD), goal)

    def _note(self, obstacles: list[tuple[float, float]]) -> None:
        seen = {self._cell_of(x, y) for x, y in obstacles} - self.occupied
        self.occupied |= seen
        self.blocked |= self._widened(seen, CLEARANCE)
        self.tight |= self._widened(seen, CLEARANCE + 0.1)

    def _cell_of(self, x: float, y: float) -> tuple[int, int]:
        return round(x / self.cell), round(y / self.cell)

    def _widened(self, cells: set[tuple[int, int]], metres: float) -> set[tuple[int, int]]:
        steps = range(-math.ceil(metres / self.cell), math.ceil(metres / self.cell) + 1)
        near = [(dx, dy) for dx in steps for dy in steps if math.hypot(dx, dy) * self.cell <= metres]
        return {(column + dx, row + dy) for column, row in cells for dx, dy in near}

    def _plan(self, start: tuple[int, int], goal: tuple[int, int]) -> list[tuple[int, int]]:
        """Return the cells from start to goal, the cheapest way; none where there is no way."""
        best, came_from = {start: 0.0}, {start: start}
        queue = [(math.dist(start, goal), start)]
        while queue:
            _, here = heapq.heappop(queue)
            if here == goal:
                return self._way(came_from, goal)
            for dx in (-1, 0, 1):
                for dy in (-1, 0, 1):
                    there = (here[0] + dx, here[1] + dy)
                    cost = best[here] + math.hypot(dx, dy) * (self.margin_cost if there in self.tight else 1.0)
                    if there not in self.blocked and cost < min(best.get(there, math.inf), self.longest):
                        best[there], came_from[there] = cost, here
                        heapq.heappush(queue, (cost + math.dist(there, goal), there))
        return []

    def _way(self, came_from: dict[tuple[int, int], tuple[int, int]], goal: tuple[int, int]) -> list[tuple[int, int]]:
        way = [goal]
        while came_from[way[-1]] != way[-1]:
            way.append(came_from[way[-1]])
        return way[::-1]


def _ahead(here: Place, heading: float, metres: float) -> Place:
    return Place(here.x + metres * math.cos(heading), here.y + metres * math.sin(heading))


PLANNERS = {"straight": Straight, "astar": AStar}
