"""The way that the robot took is kept, at most ten times a second."""

from __future__ import annotations

import csv

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.plugins.systems import BasicTurtlebot3
from robot_runner.ros.turtlebot3.odometry import Pose, Trajectory
from robot_runner.testing import FakeClock, FakeLinks, FakeTurtlebot3Link, make_context, rehearse

SHORT = {"sleep_s": 0.5, "drive_s": 2.0, "task_s": 1.0, "rotate_s": 4.0}


def rows_of(path) -> list[dict[str, float]]:
    with path.open(newline="") as file:
        return [{name: float(text) for name, text in row.items()} for row in csv.DictReader(file)]


def test_the_way_of_a_mission_is_kept(tmp_path):
    clock = FakeClock(1000.0)
    plugin = BasicTurtlebot3(**SHORT)
    links = FakeLinks(robot=FakeTurtlebot3Link(clock))
    context = make_context(tmp_path, plugin, links=links, clock=clock, combination={"Task": "Video"})
    rehearse(context, plugin)
    rows = rows_of(context.raw_data_folder / "trajectory.csv")
    times = [row["time_s"] for row in rows]
    assert times == sorted(times)
    assert times[-1] - times[0] == pytest.approx(14.0, abs=0.2)
    assert 100 <= len(rows) <= 141
    assert max(row["x_m"] for row in rows) == pytest.approx(0.26, abs=0.01)
    assert rows[-1]["x_m"] == pytest.approx(0.0, abs=0.01)


def test_the_way_of_a_mission_that_breaks_off_is_kept_so_far(tmp_path):
    clock = FakeClock(0.0)
    robot = FakeTurtlebot3Link(clock)
    plugin = BasicTurtlebot3(**SHORT)
    context = make_context(tmp_path, plugin, links=FakeLinks(robot=robot), clock=clock, combination={"Task": "Video"})

    def fail(task):
        raise LinkError("gone", where="robot", fix="Find it.")

    plugin.start_run(context)
    plugin.started(plugin._robot).tasks.start = fail
    context.times.begin()
    with pytest.raises(LinkError):
        plugin.launch_mission(context)
    assert max(row["x_m"] for row in rows_of(context.raw_data_folder / "trajectory.csv")) > 0.2


def test_poses_that_come_faster_are_thinned_out(tmp_path):
    way = Trajectory()
    for step in range(301):
        way.add(step / 30.0, Pose(0.0, 0.0, 0.0))
    assert len(way) == 101


def test_a_way_without_poses_is_an_empty_file(tmp_path):
    Trajectory().write(tmp_path / "trajectory.csv")
    assert (tmp_path / "trajectory.csv").read_text() == "time_s,x_m,y_m,heading_rad\n"
