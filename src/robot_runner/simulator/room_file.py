"""Reads a room from a TOML file: walls, boxes, cylinders, and the starts of robots."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from robot_runner.core.errors import Finding, LinkError, did_you_mean
from robot_runner.core.links.graph_names import namespace_prefix
from robot_runner.simulator.rooms import WALL_HEIGHT, Cylinder, Obstacle, Pose, Room, Wall

#: The largest file, bytes; a room of a thousand walls has 100 kB.
_LARGEST = 4 * 1024 * 1024
_THICKNESS = 0.1
#: The largest coordinate (m): no room is larger, and the physics is still precise enough there.
_FARTHEST = 1e6
#: A radius (m) around the axle with the whole body: 101 mm behind, 89 mm to the sides (ROBOTIS' URDF).
_ROBOT_RADIUS = 0.14
_GUIDE = "Look at docs/simulator-rooms.md for what a room is made of."


def read_room(path: Path) -> Room:
    """Return the room that a TOML file describes.

    Raises:
        LinkError: the file cannot be read, or describes no room; `findings` lists all problems.
    """
    try:
        if path.stat().st_size > _LARGEST:
            raise LinkError("the file is longer than any room", where=str(path), fix=_GUIDE)
        if not path.is_file():  # opening a named pipe would block until somebody writes
            raise LinkError("the room is not a regular file", where=str(path), fix="Make it a file that can be read.")
        described = tomllib.loads(path.read_text("utf-8"))
    except FileNotFoundError as error:
        fix = f"Give the path of a file, from {Path.cwd()} on."
        raise LinkError("there is no such room", where=str(path), fix=fix) from error
    except OSError as error:
        problem = f"the room cannot be read: {error.strerror}"
        raise LinkError(problem, where=str(path), fix="Make it a file that can be read.") from error
    except UnicodeDecodeError as error:
        raise LinkError("the room is not UTF-8 text", where=str(path), fix="Save it as UTF-8.") from error
    except (ValueError, RecursionError) as error:  # also of numbers with thousands of digits, and deep brackets
        raise LinkError(f"the room is not TOML: {error}", where=str(path), fix=_GUIDE) from error
    return room_of(described, where=str(path))


def room_of(described: Mapping[str, Any], *, where: str) -> Room:
    """Return the room of plain data; raise a `LinkError` if the data describe no room; `findings` lists all problems.

    Example:
        >>> room = room_of({"cylinder": [{"at": [1.0, 0.0], "radius": 0.1}]}, where="room.toml")
        >>> room.obstacles
        (Cylinder(x=1.0, y=0.0, radius=0.1, height=0.5),)
    """
    reading = _Reading(where)
    for unknown in described.keys() - _TABLES.keys():
        reading.refuse(f"[[{unknown}]]", "is nothing that a room has", did_you_mean(unknown, _TABLES))
    made: dict[str, list[Any]] = {kind: reading.tables(described, kind, make) for kind, make in _TABLES.items()}
    obstacles: tuple[Obstacle, ...] = (*made["wall"], *made["box"], *made["cylinder"])
    robots: dict[str, Pose] = {}
    for namespace, pose in made["robot"]:
        if namespace in robots:
            reading.refuse("[[robot]]", f"{namespace or '/'} starts twice", "Give each robot a namespace of its own.")
        robots[namespace] = pose
    room = Room(obstacles, MappingProxyType(robots))
    _check_starts(room, reading)
    LinkError.refuse(reading.findings)
    return room


def _check_starts(room: Room, reading: _Reading) -> None:
    starts = dict(room.robots) or {"": room.start("")}
    for namespace, pose in starts.items():
        if room.clearance(pose.x, pose.y) < _ROBOT_RADIUS:
            problem = f"robot {namespace or '/'} would start at ({pose.x:g}, {pose.y:g}), within or at an obstacle"
            fix = f"Leave {_ROBOT_RADIUS:g} m around it free, or let it start elsewhere: [[robot]] at = [x, y]."
            reading.refuse("[[robot]]", problem, fix)
        for other, its in room.robots.items():
            if other > namespace and math.hypot(its.x - pose.x, its.y - pose.y) < 2 * _ROBOT_RADIUS:
                problem = f"robots {namespace or '/'} and {other} would start within each other"
                reading.refuse("[[robot]]", problem, f"Leave {2 * _ROBOT_RADIUS:g} m between them.")


@dataclass(slots=True)
class _Reading:
    """Collects findings while tables are read."""

    where: str
    findings: list[Finding] = field(default_factory=list)

    def refuse(self, what: str, problem: str, fix: str) -> None:
        self.findings.append(Finding.error(self.where, f"{what} {problem}", fix))

    def tables(self, described: Mapping[str, Any], kind: str, make: Callable[[_Table], Any]) -> list[Any]:
        given = described.get(kind, [])
        tables = given if isinstance(given, list) else [given]
        made = []
        for number, each in enumerate(tables, start=1):
            what = f"[[{kind}]] {number}"
            if not isinstance(each, dict):
                self.refuse(what, f"is {each!r}, not a table", f"Write [[{kind}]] above its lines.")
                continue
            known = len(self.findings)
            table = _Table(self, what, dict(each))
            thing = make(table)
            table.close()
            if len(self.findings) == known:
                made.append(thing)
        return made


@dataclass(slots=True)
class _Table:
    """One table, whose keys are taken one by one; keys that are left at the end are unknown."""

    reading: _Reading
    what: str
    left: dict[str, Any]
    known: list[str] = field(default_factory=list)

    def number(self, key: str, default: float | None = None, *, is_length: bool = False) -> float:
        value = self._taken(key, default)
        if not _is_number(value) or (is_length and value <= 0):
            self._refuse_value(key, value, "a length above 0, in metres" if is_length else "a number")
            return math.nan
        return float(value)

    def pair(self, key: str, *, is_length: bool = False) -> tuple[float, float]:
        value = self._taken(key, None)
        is_pair = isinstance(value, list) and list(map(_is_number, value)) == [True, True]
        if not is_pair or (is_length and min(value) <= 0):
            self._refuse_value(key, value, "two lengths above 0: [1.0, 0.5]" if is_length else "[x, y] in metres")
            return math.nan, math.nan
        return float(value[0]), float(value[1])

    def namespace(self) -> str:
        value = self._taken("namespace", "")
        if not isinstance(value, str):
            self._refuse_value("namespace", value, 'the name of a robot, such as "/alice"')
            return ""
        try:
            return namespace_prefix(value)
        except LinkError as error:
            self.reading.refuse(self.what, f"has no namespace of a robot: {error.problem}", error.fix)
            return ""

    def close(self) -> None:
        for key in self.left:
            self.reading.refuse(f"{self.what}: {key}", "is not known", did_you_mean(key, self.known))

    def _taken(self, key: str, default: object) -> Any:
        self.known.append(key)
        return self.left.pop(key, default)

    def _refuse_value(self, key: str, value: object, meant: str) -> None:
        problem = "is missing" if value is None else f"is {value!r}"
        self.reading.refuse(f"{self.what}: {key}", problem, f"Give {meant}.")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _FARTHEST


def _wall(table: _Table) -> Wall:
    (x, y), (to_x, to_y) = table.pair("from"), table.pair("to")
    thickness = table.number("thickness", _THICKNESS, is_length=True)
    height = table.number("height", WALL_HEIGHT, is_length=True)
    length = math.hypot(to_x - x, to_y - y)
    if length == 0:
        table.reading.refuse(table.what, "ends where it begins", "Give two places for from and to.")
    # Half a thickness longer at both ends, so that walls leave no gap in a corner.
    half = (length + thickness) / 2
    return Wall((x + to_x) / 2, (y + to_y) / 2, half, thickness / 2, math.atan2(to_y - y, to_x - x), height)


def _box(table: _Table) -> Wall:
    (x, y), (length, width) = table.pair("at"), table.pair("size", is_length=True)
    yaw, height = table.number("yaw", 0.0), table.number("height", WALL_HEIGHT, is_length=True)
    return Wall(x, y, length / 2, width / 2, yaw, height)


def _cylinder(table: _Table) -> Cylinder:
    x, y = table.pair("at")
    radius, height = table.number("radius", is_length=True), table.number("height", WALL_HEIGHT, is_length=True)
    return Cylinder(x, y, radius, height)


def _robot(table: _Table) -> tuple[str, Pose]:
    x, y = table.pair("at")
    return table.namespace(), Pose(x, y, table.number("yaw", 0.0))


_TABLES: Mapping[str, Callable[[_Table], Any]] = MappingProxyType(
    {"wall": _wall, "box": _box, "cylinder": _cylinder, "robot": _robot}
)
