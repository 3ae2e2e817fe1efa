"""Waypoints for robots that only know velocity."""

from __future__ import annotations

import csv
import math
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.core.errors import LinkError, PluginError
from robot_runner.plugins import Circumstances
from robot_runner.plugins.systems import Waypoints
from robot_runner.ros.turtlebot3.odometry import Odometer
from robot_runner.simulator.embedded_robot import run_simulation
from robot_runner.testing import FakeClock, FakeLinks, FakeRobotLink, SystemContract, make_context, rehearse

if TYPE_CHECKING:
    from pathlib import Path


class TestWaypoints(SystemContract):
    """A corner and back."""

    breaking_points = 4

    def make_plugin(self) -> Waypoints:
        return Waypoints([(0.5, 0.0), (0.5, 0.4, math.pi / 2)])


def test_a_square_ends_where_it_began_and_each_leg_is_measured(tmp_path: Path) -> None:
    square = Waypoints([(0.8, 0.0), (0.8, 0.8), (0.0, 0.8), (0.0, 0.0, 0.0)], speed=0.2, turn_rate=1.5)
    context = make_context(tmp_path, square, phases=["leg_2"])
    measured = rehearse(context, square)
    assert measured["Distance"] == pytest.approx(3.2, abs=0.1)
    assert measured["FinalError"] < 0.05
    assert measured["FinalYawError"] < 0.1
    assert sum(measured[f"Leg{number}"] for number in range(1, 5)) == pytest.approx(measured["Duration"])
    assert [phase.name for phase in context.phases] == ["leg_1", "leg_2", "leg_3", "leg_4"]
    with (tmp_path / "runs/r_1/Waypoints/trajectory.csv").open() as file:
        far = max(math.hypot(float(row["x_m"]), float(row["y_m"])) for row in csv.DictReader(file))
    assert far == pytest.approx(0.8 * math.sqrt(2), abs=0.05)
    context.resources.close()


@pytest.mark.parametrize(
    ("x", "yaw", "times"),
    [(0.06, None, 1), (0.06, None, 2), (0.1, None, 1), (0.3, None, 1), (0.0, 0.3, 1), (0.0, 0.6, 1), (0.3, 0.3, 1)],
)
def test_the_final_errors_are_those_of_the_robot_once_it_stands_still(
    tmp_path: Path, x: float, yaw: float, times: int
) -> None:
    ahead = Waypoints(times * [(x, 0.0) if yaw is None else (x, 0.0, yaw)])
    context = make_context(tmp_path, ahead)
    measured = rehearse(context, ahead)
    simulation = run_simulation(context)
    simulation.clock.sleep(1.0)
    pose = simulation.turtlebot3().topics["odom"].latest()["pose"]["pose"]
    place, turn = pose["position"], pose["orientation"]
    assert measured["FinalError"] == pytest.approx(math.hypot(place["x"] - x, place["y"]), abs=1e-3)
    if yaw is not None:
        turned = 2 * math.atan2(turn["z"], turn["w"])
        assert measured["FinalYawError"] == pytest.approx(abs(turned - yaw), abs=5e-3)
    context.resources.close()


def test_a_way_that_ends_with_any_yaw_has_no_measure_of_it(tmp_path: Path) -> None:
    ahead = Waypoints([(0.2, 0.0, 0.0), (0.3, 0.0)])
    assert [measure.name for measure in ahead.measures] == ["Duration", "Distance", "FinalError", "Leg1", "Leg2"]
    context = make_context(tmp_path, ahead)
    assert None not in rehearse(context, ahead).values()
    context.resources.close()


def test_waypoints_may_be_relative_to_where_the_robot_stands(tmp_path: Path) -> None:
    ahead = Waypoints([(0.3, 0.0)], relative_to="start")
    context = make_context(tmp_path, ahead)
    rehearse(context, ahead)
    again = rehearse(context, ahead)
    assert again["Distance"] == pytest.approx(0.3, abs=0.05)
    assert ahead.duration_s({}) == pytest.approx(again["Duration"], rel=0.1)
    context.resources.close()


def test_a_robot_that_does_not_move_fails_the_run_and_is_stopped(tmp_path: Path) -> None:
    clock = FakeClock()
    link = FakeRobotLink(clock)
    link.known_topics = {"cmd_vel": "geometry_msgs/Twist"}
    clock.every(0.05, lambda: link.deliver("odom", _odometry(clock.now())))
    blocked = Waypoints([(2.0, 0.0)])
    context = make_context(tmp_path, blocked, robot="dds", links=FakeLinks(robot=link), clock=clock)
    with pytest.raises(LinkError, match=r"does not move as it is commanded: it covered 0\.00 m"):
        rehearse(context, blocked)
    assert link.stands_still


@pytest.mark.parametrize("x", [math.nan, math.inf])
def test_a_robot_whose_pose_is_no_number_is_stopped_at_once(tmp_path: Path, x: float) -> None:
    clock = FakeClock()
    link = FakeRobotLink(clock)
    link.known_topics = {"cmd_vel": "geometry_msgs/Twist"}
    clock.every(0.05, lambda: link.deliver("odom", _odometry(clock.now(), 0.0 if clock.now() < 2.0 else x)))
    ahead = Waypoints([(2.0, 0.0)])
    context = make_context(tmp_path, ahead, robot="dds", links=FakeLinks(robot=link), clock=clock)
    with pytest.raises(LinkError, match="a pose that is not a number"):
        rehearse(context, ahead)
    assert link.stands_still
    assert clock.now() < 2.2


def test_a_robot_that_does_not_take_the_first_zero_is_made_safe_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = FakeRobotLink(FakeClock())
    ahead = Waypoints([(1.0, 0.0)])
    context = make_context(tmp_path, ahead, robot="dds", links=FakeLinks(robot=link))
    publish, refused = link.publish, []

    def flaky(topic: str, *given: Any, **more: Any) -> None:
        if not refused:
            refused.append(topic)
            raise LinkError("the robot could not be reached", where=topic)
        publish(topic, *given, **more)

    monkeypatch.setattr(link, "publish", flaky)
    with pytest.raises(LinkError, match="could not be reached"):
        ahead.make_safe(context)
    assert refused == ["cmd_vel"]
    assert link.publications  # the robot was told a second time
    assert link.stands_still


@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_a_way_that_is_made_of_noise_for_more_than_a_fifth_is_doubted(tmp_path: Path, noise: float) -> None:
    clock = FakeClock()
    link = FakeRobotLink(clock)
    link.known_topics = {"cmd_vel": "geometry_msgs/Twist"}
    x, side = 0.0, 1.0

    def tell() -> None:
        nonlocal x, side
        commands = [each.message for each in link.publications if each.topic == "cmd_vel"]
        x, side = x + 0.05 * (commands[-1]["linear"]["x"] if commands else 0.0), -side
        odometry = _odometry(clock.now(), x)
        odometry["pose"]["pose"]["position"]["y"] = noise * side
        link.deliver("odom", odometry)

    clock.every(0.05, tell)
    ahead = Waypoints([(1.0, 0.0)])
    context = make_context(tmp_path, ahead, robot="dds", links=FakeLinks(robot=link), clock=clock)
    measured = rehearse(context, ahead)
    doubts = [each.problem for each in context.broker.findings if "small steps to and fro" in each.problem]
    assert bool(doubts) == (measured["Distance"] > 1.2) == bool(noise)


def test_a_robot_that_tells_no_direction_is_not_driven(tmp_path: Path) -> None:
    clock = FakeClock()
    link = FakeRobotLink(clock)
    link.known_topics = {"cmd_vel": "geometry_msgs/Twist"}
    clock.every(0.05, lambda: link.deliver("odom", _odometry(clock.now(), w=0.0)))
    ahead = Waypoints([(0.0, 1.0)])
    context = make_context(tmp_path, ahead, robot="dds", links=FakeLinks(robot=link), clock=clock)
    with pytest.raises(LinkError, match="the odometry has no direction"):
        rehearse(context, ahead)
    assert clock.now() < 1.0
    commands = [each.message for each in link.publications if each.topic == "cmd_vel"]
    assert {(each["linear"]["x"], each["angular"]["z"]) for each in commands} == {(0.0, 0.0)}


@pytest.mark.parametrize("length", [0.5, 1.0, 2.0])
def test_the_heading_does_not_depend_on_the_length_of_the_quaternion(length: float) -> None:
    odometer = Odometer(FakeClock(), timeout=1.0, where="robot")
    odometer.take(_odometry(0.0, z=length * math.sin(0.6), w=length * math.cos(0.6)))
    assert odometer.pose().heading == pytest.approx(1.2)


def test_a_yaw_that_is_probably_in_degrees_is_warned_of() -> None:
    def fixes(yaw: float) -> list[str]:
        return [each.fix for each in Waypoints([(1.0, 0.0, yaw)]).check(Circumstances(robot="simulated"))]

    assert fixes(90) == ["Yaws are in rad: 90 degrees are 1.571."]
    assert fixes(-math.tau) == []


def _odometry(now: float, x: float = 0.0, *, z: float = 0.0, w: float = 1.0) -> dict[str, Any]:
    pose = {"position": {"x": x, "y": 0.0, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": z, "w": w}}
    return {"header": {"stamp": {"sec": int(now), "nanosec": int(now % 1 * 1e9)}}, "pose": {"pose": pose}}


def test_a_robot_that_does_not_speak_fails_in_its_deadline(tmp_path: Path) -> None:
    clock = FakeClock()
    link = FakeRobotLink(clock)
    silent = Waypoints([(1.0, 0.0)], connect_timeout_s=2.0, command_topic="base/cmd_vel")
    context = make_context(tmp_path, silent, links=FakeLinks(robot=link), clock=clock)
    with pytest.raises(LinkError, match=r"no odometry arrived for 2\.0 s"):
        rehearse(context, silent)
    assert clock.now() < 3.0
    assert {each.topic for each in link.publications} == {"base/cmd_vel", "robot_runner/heartbeat"}
    assert link.stands_still


@pytest.mark.parametrize("given", [[], "ab", [(1.0,)], [(1.0, "x")], [(1.0, math.nan)], [(True, 1.0)]])
def test_what_is_no_waypoint_is_refused(given: object) -> None:
    with pytest.raises(PluginError, match="waypoint"):
        Waypoints(given)  # type: ignore[arg-type]


@pytest.mark.parametrize(("parameter", "value"), [("speed", 0.0), ("tolerance_m", -1), ("relative_to", "map")])
def test_a_parameter_out_of_its_range_is_refused(parameter: str, value: object) -> None:
    with pytest.raises(PluginError, match=f"{parameter} is"):
        Waypoints([(1.0, 0.0)], **{parameter: value})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("waypoints", "more", "robot", "is_told"),
    [
        ([(1.0, 0.0)], {}, "ros2", True),
        ([(1.0, 0.0), (0.0, 0.0)], {}, "ros2", False),
        ([(1.0, 0.0)], {"relative_to": "start"}, "ros2", False),
        ([(1.0, 0.0)], {}, "simulated", False),
    ],
)
def test_a_way_that_ends_elsewhere_than_it_began_is_told_of_where_nobody_puts_the_robot_back(
    waypoints: Any, more: Any, robot: str, is_told: bool
) -> None:
    found = [each.problem for each in Waypoints(waypoints, **more).check(Circumstances(robot=robot))]
    assert any("from there the next run sets out" in each for each in found) is is_told
