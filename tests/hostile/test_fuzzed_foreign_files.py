"""Each reader of a file that others write returns a value or one of our errors, whatever bytes the file holds."""

from __future__ import annotations

import random
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.hostile.damaged_bytes import EXAMPLES, damaged, read_or_refused
from tests.meters.scripted_meter import recording
from tests.ros.recordings import scans_of_ros1, scans_of_ros2

from robot_runner.analysis.importing.foreign_table import read_foreign_table
from robot_runner.analysis.importing.units import split_heading
from robot_runner.analysis.plan_file import read_plan
from robot_runner.meters.ina219.card import read_card
from robot_runner.ros.recorded_bag import RecordedBag
from robot_runner.ros.type_catalogue import TypeCatalogue
from robot_runner.simulator.room_file import read_room

_TABLE = "Run;Speed [m/s^2];Energy (kWh);Time_ms\n1;2,5;0,001;10\n2;3,5;;#N/A\n".encode("utf-16")
_ROOM = b"""
[[wall]]
from = [0, 0]
to = [4.0, 0]
[[cylinder]]
at = [1, 1]
radius = 0.2
[[robot]]
at = [2, 2]
yaw = 1.5
"""
_PLAN = b"""
measures = ["Energy"]
covariates = ["Voltage"]
blocks = "Day"
"""
_DEFINITION = b"float32 speed 0.25  # m/s\nuint8 MODE=3\nint32[] list [1, -2]\nstring tag 'abc'\nHeader header\n"


def _bag(path: Path) -> None:
    with RecordedBag(path) as bag:
        list(bag.messages(bag.chosen(None), bag.encoding))
        list(bag.stamps())


def _table(path: Path) -> None:
    for heading in read_foreign_table(path).headings:
        split_heading(heading)


def _definition(path: Path) -> None:
    TypeCatalogue.of(2, "jazzy", (path,))


def _bag_of_ros1(folder: Path) -> bytes:
    return scans_of_ros1(folder / "hall.bag").read_bytes()


def _bag_of_ros2(folder: Path, *, sqlite: bool) -> bytes:
    (file,) = scans_of_ros2(folder / "hall", sqlite=sqlite).glob("hall*.db3" if sqlite else "hall*.mcap")
    return file.read_bytes()


#: The file's name, how an intact one is made, and how it is read.
READERS: dict[str, tuple[str, Callable[[Path], bytes], Callable[[Path], Any]]] = {
    "bag of ROS 1": ("hall.bag", _bag_of_ros1, _bag),
    "MCAP": ("hall.mcap", lambda folder: _bag_of_ros2(folder, sqlite=False), _bag),
    "SQLite bag": ("hall.db3", lambda folder: _bag_of_ros2(folder, sqlite=True), _bag),
    "definition": ("my_robot/msg/Goal.msg", lambda _: _DEFINITION, _definition),
    "table": ("table.csv", lambda _: _TABLE, _table),
    "plan": ("plan.toml", lambda _: _PLAN, read_plan),
    "room": ("room.toml", lambda _: _ROOM, read_room),
    "card": ("card.bin", lambda _: recording(100) + bytes(512), read_card),
}

_intact: dict[str, tuple[Path, bytes]] = {}


@pytest.mark.long
@pytest.mark.parametrize("name", READERS)
@settings(suppress_health_check=list(HealthCheck), max_examples=EXAMPLES)
@given(seed=st.integers(0, 2**32))
def test_whatever_a_file_of_others_holds_it_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, name: str, seed: int
) -> None:
    relative, make, read = READERS[name]
    if name not in _intact:
        folder = tmp_path_factory.mktemp("foreign")
        (folder / relative).parent.mkdir(parents=True, exist_ok=True)
        _intact[name] = folder / relative, make(tmp_path_factory.mktemp("made"))
    path, whole = _intact[name]
    path.write_bytes(damaged(whole, random.Random(seed)))  # noqa: S311 - chance, and no secret
    read_or_refused(partial(read, path))


@pytest.mark.long
@pytest.mark.parametrize("name", READERS)
def test_the_files_of_others_are_in_order_before_they_are_damaged(tmp_path: Path, name: str) -> None:
    """Else each would be refused at once, and nothing behind it were searched."""
    relative, make, read = READERS[name]
    (tmp_path / relative).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / relative).write_bytes(make(tmp_path))
    read(tmp_path / relative)
