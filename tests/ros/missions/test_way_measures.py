"""What is measured of a robot's way beside an action: by odometry or tf, and by the laser scanner."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.core.errors import LinkError, PluginError
from robot_runner.core.links.graph_names import GraphPart
from robot_runner.core.links.robot import GraphEndpoint
from robot_runner.core.plugin import Circumstances
from robot_runner.plugins.systems import ActionMission
from robot_runner.ros.missions.way_measures import WayMeasures
from robot_runner.ros.turtlebot3.odometry import ODOMETRY
from robot_runner.testing import FakeClock, FakeLinks, FakeRobotLink, make_context

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from robot_runner.core.errors import Finding


def _transform(parent: str, child: str, x: float, time: float) -> dict[str, Any]:
    header = {"frame_id": parent, "stamp": {"sec": int(time), "nanosec": round(time % 1 * 1e9)}}
    moved, turned = {"x": x, "y": 0.0, "z": 0.0}, {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    return {"header": header, "child_frame_id": child, "transform": {"translation": moved, "rotation": turned}}


def _context(folder: Path, clock: FakeClock, link: FakeRobotLink) -> Any:
    mission = ActionMission("go", "nav2_msgs/NavigateToPose", odometry="odom", scan="scan", name="Go")
    return make_context(folder, mission, robot="dds", links=FakeLinks(robot=link), clock=clock)


def test_the_way_by_tf_is_that_of_the_robot_in_the_map(tmp_path: Path) -> None:
    clock = FakeClock()
    link = FakeRobotLink(clock)
    clock.at(0.1, lambda: link.deliver("/tf", {"transforms": [_transform("map", "odom", 0.0, 0.1)]}))

    def tell() -> None:
        now = clock.now()
        both = [_transform("map", "odom", 0.1, now), _transform("odom", "base_link", 0.2 * now, now)]
        link.deliver("/tf", {"transforms": both})

    clock.every(0.2, tell)
    way = WayMeasures(None, None, ("map", "base_link"), where="Go")
    way.begin(link, context := _context(tmp_path, clock, link), timeout=5.0)
    clock.sleep(0.1)
    way.begin_mission()
    clock.sleep(5.0)
    assert way.end_mission(context) == {"PathLength": pytest.approx(1.0, abs=0.05)}
    assert "base_link in map" in way.measures[0].description
    unknown = WayMeasures(None, None, ("map", "base_lnk"), where="Go")
    with pytest.raises(LinkError, match="base_lnk"):
        unknown.begin(link, context, timeout=1.0)


def test_the_way_by_tf_may_be_told_in_the_namespace_of_the_robot(tmp_path: Path) -> None:
    clock = FakeClock()
    link = FakeRobotLink(clock)
    goal = {"pose": {"header": {"frame_id": "map"}}}
    mission = ActionMission(
        "go", "nav2_msgs/NavigateToPose", goal, path_frames=("map", "base_link"), tf_topic="tf", namespace="alice"
    )
    needs = mission.required_graph(Circumstances("dds"))
    assert [each.name for each in needs if each.part is GraphPart.PUBLISHED] == ["tf"]
    way = WayMeasures(None, None, ("map", "lidar"), where="Go", tf_topic="tf")
    clock.every(
        0.2, lambda: link.deliver("tf", {"transforms": [_transform("map", "base", 0.2 * clock.now(), clock.now())]})
    )
    clock.at(0.1, lambda: link.deliver("tf_static", {"transforms": [_transform("base", "lidar", 0.1, 0.0)]}))
    way.begin(link, context := _context(tmp_path, clock, link), timeout=5.0)
    way.begin_mission()
    clock.sleep(5.0)
    assert way.end_mission(context) == {"PathLength": pytest.approx(1.0, abs=0.05)}


def _scanning(tmp_path: Path) -> tuple[WayMeasures, FakeRobotLink, Any]:
    """Return what measures the closest obstacle of a mission that has begun."""
    clock = FakeClock()
    link = FakeRobotLink(clock)
    way = WayMeasures(None, "scan", None, where="Go")
    way.begin(link, context := _context(tmp_path, clock, link), timeout=1.0)
    way.begin_mission()
    return way, link, context


def test_ranges_that_say_nothing_are_no_obstacles_and_silence_is_doubted(tmp_path: Path) -> None:
    way, link, context = _scanning(tmp_path)
    ranges = [0.01, math.nan, math.inf, 0.8, 3.6, 0.5]
    link.deliver("scan", {"range_min": 0.12, "range_max": 3.5, "ranges": ranges})
    assert way.end_mission(context) == {"ClosestObstacle": 0.5}
    way.begin_mission()
    assert way.end_mission(context) == {"ClosestObstacle": None}
    assert "no laser scan came on 'scan'" in context.broker.findings[-1].problem


def test_a_scanner_without_a_greatest_range_sees_no_obstacle_at_infinity(tmp_path: Path) -> None:
    way, link, context = _scanning(tmp_path)
    link.deliver("scan", {"range_min": 0.12, "range_max": math.inf, "ranges": [math.inf, math.inf]})
    assert way.end_mission(context) == {"ClosestObstacle": None}


@pytest.mark.parametrize("silent_from", [0.0, 4.0, 12.0])
def test_a_scanner_that_was_silent_for_a_part_of_the_mission_makes_the_closest_obstacle_doubtful(
    tmp_path: Path, silent_from: float
) -> None:
    clock = FakeClock()
    link = FakeRobotLink(clock)
    scan = {"range_min": 0.12, "range_max": 3.5, "ranges": [0.5]}
    clock.every(0.2, lambda: None if silent_from < clock.now() < silent_from + 3.0 else link.deliver("scan", scan))
    way = WayMeasures(None, "scan", None, where="Go")
    way.begin(link, context := _context(tmp_path, clock, link), timeout=1.0)
    way.begin_mission()
    clock.sleep(15.0)
    assert way.end_mission(context) == {"ClosestObstacle": 0.5}
    (doubt,) = context.broker.findings
    assert "no laser scan came on 'scan' for 3.0 s of the mission" in doubt.problem


def test_a_range_of_zero_is_no_obstacle_though_the_scanner_names_no_least_range(tmp_path: Path) -> None:
    way, link, context = _scanning(tmp_path)  # as drivers that have 0 for no echo
    link.deliver("scan", {"range_min": 0.0, "range_max": 12.0, "ranges": [0.0, 0.7, 0.0]})
    assert way.end_mission(context) == {"ClosestObstacle": 0.7}


def test_an_obstacle_that_was_too_near_to_measure_makes_the_closest_one_doubtful(tmp_path: Path) -> None:
    way, link, context = _scanning(tmp_path)
    for ranges in ([0.8, 0.5], [0.8, -math.inf]):
        link.deliver("scan", {"range_min": 0.12, "range_max": 3.5, "ranges": ranges})
    assert way.end_mission(context) == {"ClosestObstacle": 0.5}
    (doubt,) = context.broker.findings
    assert "1 of 2 laser scans saw something too near to measure" in doubt.problem


def test_a_way_by_tf_that_nobody_tells_any_more_is_doubted(tmp_path: Path) -> None:
    clock = FakeClock()
    link = FakeRobotLink(clock)

    def tell() -> None:
        now = clock.now()
        if now < 2.0:  # localisation dies
            link.deliver("/tf", {"transforms": [_transform("map", "odom", 0.0, now)]})
        link.deliver("/tf", {"transforms": [_transform("odom", "base_link", 0.2 * now, now)]})

    clock.every(0.2, tell)
    way = WayMeasures(None, None, ("map", "base_link"), where="Go")
    way.begin(link, context := _context(tmp_path, clock, link), timeout=5.0)
    way.begin_mission()
    clock.sleep(6.0)
    way.end_mission(context)
    (doubt,) = context.broker.findings
    assert "where 'base_link' is in 'map' was not reported for 4." in doubt.problem


def test_a_way_by_odometry_that_falls_silent_is_doubted(tmp_path: Path) -> None:
    clock = FakeClock()
    link = FakeRobotLink(clock)
    pose = {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}

    def tell() -> None:
        stamp = {"sec": int(clock.now()), "nanosec": round(clock.now() % 1 * 1e9)}
        if clock.now() < 2.0:
            link.deliver("odom", {"header": {"stamp": stamp}, "pose": {"pose": pose}})

    clock.every(0.05, tell)
    way = WayMeasures("odom", None, None, where="Go")
    way.begin(link, context := _context(tmp_path, clock, link), timeout=5.0)
    way.begin_mission()
    clock.sleep(5.0)
    way.end_mission(context)
    (doubt,) = context.broker.findings
    assert "no odometry arrived for 3" in doubt.problem


def test_a_way_by_odometry_that_tells_no_direction_is_measured(tmp_path: Path) -> None:
    clock = FakeClock()
    link = FakeRobotLink(clock)

    def tell() -> None:  # as a tracker does that sees one marker
        place, turned = {"x": 0.5 * clock.now(), "y": 0.0, "z": 0.0}, dict.fromkeys("xyzw", 0.0)
        stamp = {"sec": int(clock.now()), "nanosec": round(clock.now() % 1 * 1e9)}
        link.deliver("odom", {"header": {"stamp": stamp}, "pose": {"pose": {"position": place, "orientation": turned}}})

    clock.every(0.05, tell)
    way = WayMeasures("odom", None, None, where="Go")
    way.begin(link, context := _context(tmp_path, clock, link), timeout=5.0)
    way.begin_mission()
    clock.sleep(4.0)
    assert way.end_mission(context) == {"PathLength": pytest.approx(2.0, abs=0.06)}
    assert not context.broker.findings


def _flying(tmp_path: Path, *, by_tf: bool, starts_anew: bool) -> tuple[float | None, Sequence[Finding]]:
    """Return the way of a robot that rises by 0.3 m/s and flies ahead by 0.4 m/s for 8 s, and what is doubted."""
    clock = FakeClock()
    link = FakeRobotLink(clock)

    def tell() -> None:
        time = clock.now() - (5.0 if starts_anew and clock.now() > 5.0 else 0.0)
        place = {"x": 0.4 * time, "y": 0.0, "z": 0.3 * time}
        told = _transform("odom", "base_link", 0.0, time)
        turned, told["transform"]["translation"] = told["transform"]["rotation"], place
        link.deliver("/tf", {"transforms": [told]})
        link.deliver("odom", {**told, "pose": {"pose": {"position": place, "orientation": turned}}})

    clock.every(0.1, tell)
    way = WayMeasures(*((None, None, ("odom", "base_link")) if by_tf else ("odom", None, None)), where="Go")
    way.begin(link, context := _context(tmp_path, clock, link), timeout=5.0)
    way.begin_mission()
    clock.sleep(8.0)
    return way.end_mission(context)["PathLength"], context.broker.findings


@pytest.mark.parametrize("by_tf", [False, True])
def test_the_way_of_a_robot_that_flies_counts_its_height(tmp_path: Path, by_tf: bool) -> None:
    length, findings = _flying(tmp_path, by_tf=by_tf, starts_anew=False)
    assert length == pytest.approx(4.0, abs=0.06)
    assert not findings


@pytest.mark.parametrize("by_tf", [False, True])
def test_a_way_is_doubted_where_its_time_goes_back_as_by_a_reset_or_a_bag_that_loops(
    tmp_path: Path, by_tf: bool
) -> None:
    _, (doubt,) = _flying(tmp_path, by_tf=by_tf, starts_anew=True)
    assert "went back by 4.9 s during the mission" in doubt.problem


def _way_of(
    tmp_path: Path,
    place: Callable[[float], float],
    *,
    by_tf: bool = False,
    is_told: Callable[[float], bool] = lambda time: True,
    speed: float = 0.0,
) -> tuple[Any, Sequence[Finding]]:
    """Return the way of a robot that is at `place(time)` on the x axis, told 50 times a second, and what is doubted.

    `speed` is what its odometry tells as its velocity, m/s.
    """
    clock = FakeClock()
    link = FakeRobotLink(clock)

    def tell() -> None:
        told = _transform("odom", "base_link", x := place(clock.now()), clock.now())
        pose = {"position": {"x": x, "y": 0.0, "z": 0.0}, "orientation": told["transform"]["rotation"]}
        if not is_told(clock.now()):
            return
        link.deliver("/tf", {"transforms": [told]})
        twist = {"linear": {"x": speed, "y": 0.0, "z": 0.0}, "angular": dict.fromkeys("xyz", 0.0)}
        link.deliver("odom", {**told, "pose": {"pose": pose}, "twist": {"twist": twist}})

    clock.every(0.02, tell)
    way = WayMeasures(*((None, None, ("odom", "base_link")) if by_tf else ("odom", None, None)), where="Go")
    way.begin(link, context := _context(tmp_path, clock, link), timeout=5.0)
    way.begin_mission()
    clock.sleep(20.0)
    return way.end_mission(context)["PathLength"], context.broker.findings


@pytest.mark.parametrize("by_tf", [False, True])
def test_a_way_that_is_the_noise_of_a_standing_robot_is_doubted(tmp_path: Path, by_tf: bool) -> None:
    length, (doubt,) = _way_of(tmp_path, lambda time: 0.001 * math.sin(997.0 * time), by_tf=by_tf)
    assert length > 0.5
    assert f"{length:.2f} m are made of small steps to and fro: without them the way is 0.00 m" in doubt.problem


@pytest.mark.parametrize("by_tf", [False, True])
@pytest.mark.parametrize("width", [0.4, 1.5])
def test_a_way_that_goes_to_and_fro_all_the_time_is_doubted_however_wide(
    tmp_path: Path, by_tf: bool, width: float
) -> None:
    # As by a place from satellites, or two robots that tell the same frames, one after the other.
    length, (doubt,) = _way_of(tmp_path, lambda time: width * (round(time * 50) % 2), by_tf=by_tf)
    assert length == pytest.approx(1000 * width, rel=0.01)
    assert f"{length:.2f} m are made of steps to and fro: by two places a second the way is " in doubt.problem


def test_a_way_of_which_two_parents_tell_is_doubted(tmp_path: Path) -> None:
    clock = FakeClock()
    link = FakeRobotLink(clock)

    def tell() -> None:
        for parent in ("odom", "wheels"):
            link.deliver("/tf", {"transforms": [_transform(parent, "base_link", 0.2 * clock.now(), clock.now())]})
        link.deliver("/tf", {"transforms": [_transform("map", "odom", 0.0, clock.now())]})
        link.deliver("/tf", {"transforms": [_transform("map", "wheels", 0.0, clock.now())]})

    clock.every(0.1, tell)
    way = WayMeasures(None, None, ("map", "base_link"), where="Go")
    way.begin(link, context := _context(tmp_path, clock, link), timeout=5.0)
    way.begin_mission()
    clock.sleep(5.0)
    way.end_mission(context)
    assert any("'base_link' has two parents" in each.problem for each in context.broker.findings)


@pytest.mark.parametrize("by_tf", [False, True])
def test_a_way_with_little_noise_is_not_doubted(tmp_path: Path, by_tf: bool) -> None:
    length, findings = _way_of(tmp_path, lambda time: 0.2 * time + 0.0001 * math.sin(997.0 * time), by_tf=by_tf)
    assert length == pytest.approx(4.0, rel=0.01)
    assert not findings


@pytest.mark.parametrize("by_tf", [False, True])
def test_a_way_of_which_a_part_was_not_told_is_doubted(tmp_path: Path, by_tf: bool) -> None:
    length, (doubt,) = _way_of(  # to and fro, 0.4 m each second
        tmp_path, lambda time: 0.2 * math.sin(math.pi * time), by_tf=by_tf, is_told=lambda time: not 5.0 < time < 9.5
    )
    assert length == pytest.approx(6.4, abs=0.02)  # where the robot drove 8 m
    assert "was not reported for 4." in doubt.problem
    assert "in which it changed by 0.20 m" in doubt.problem


def test_odometry_that_waited_in_the_network_has_missed_nothing(tmp_path: Path) -> None:
    clock = FakeClock()
    link = FakeRobotLink(clock)
    waiting: list[float] = []

    def tell() -> None:
        waiting.append(clock.now())
        while waiting and not 5.0 < clock.now() < 9.5:
            told = _transform("odom", "base_link", 0.0, time := waiting.pop(0))
            pose = {"position": {"x": 0.5 * time, "y": 0.0, "z": 0.0}, "orientation": told["transform"]["rotation"]}
            link.deliver("odom", {**told, "pose": {"pose": pose}})

    clock.every(0.1, tell)
    way = WayMeasures("odom", None, None, where="Go")
    way.begin(link, context := _context(tmp_path, clock, link), timeout=5.0)
    way.begin_mission()
    clock.sleep(20.0)
    assert way.end_mission(context)["PathLength"] == pytest.approx(10.0, abs=0.1)
    assert not context.broker.findings


@pytest.mark.parametrize("by_tf", [False, True])
def test_a_way_of_a_robot_that_stood_while_nothing_was_told_is_not_doubted(tmp_path: Path, by_tf: bool) -> None:
    length, findings = _way_of(
        tmp_path, lambda time: 0.2 * min(time, 5.0), by_tf=by_tf, is_told=lambda time: not 5.1 < time < 9.5
    )
    assert length == pytest.approx(1.0, abs=0.02)
    assert not findings


def test_a_way_by_odometry_that_jumped_further_than_anything_drives_is_doubted(tmp_path: Path) -> None:
    length, (doubt,) = _way_of(tmp_path, lambda time: 0.2 * time + (3.0 if time > 5.0 else 0.0))
    assert length == pytest.approx(7.0, abs=0.1)
    assert "jumped by 3.00 m within 0.02 s" in doubt.problem


def test_a_way_by_odometry_that_was_set_again_is_doubted_by_the_speed_that_it_tells(tmp_path: Path) -> None:
    length, (doubt,) = _way_of(tmp_path, lambda time: 0.2 * time - (1.0 if time > 5.0 else 0.0), speed=0.2)
    assert length == pytest.approx(5.0, abs=0.1)
    assert "jumped by 1.00 m within 0.02 s" in doubt.problem


def test_a_robot_that_tells_less_speed_than_it_has_is_not_said_to_jump(tmp_path: Path) -> None:
    _, findings = _way_of(tmp_path, lambda time: 2.0 * time, speed=0.5)
    assert not findings
    _, findings = _way_of(tmp_path, lambda time: float(time // 5.0), speed=0.001)  # noise of a filter
    assert not findings


@pytest.mark.parametrize("frames", ["map", ("map",), ("map", ""), ("map", "odom", "base_link")])
def test_frames_that_are_no_pair_are_refused(frames: Any) -> None:
    with pytest.raises(PluginError, match="path_frames is"):
        WayMeasures(None, None, frames, where="Go")
    with pytest.raises(PluginError, match="at the same time"):
        WayMeasures("odom", None, ("map", "base_link"), where="Go")


def test_a_way_by_the_odometry_of_several_nodes_is_doubted(tmp_path: Path) -> None:
    clock = FakeClock()
    link = FakeRobotLink(clock)
    link.known_topics = {"odom": ODOMETRY}
    pose = {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    still = {"linear": {"x": 0.0}, "angular": {"z": 0.0}}

    def tell() -> None:
        stamp = {"sec": int(clock.now()), "nanosec": round(clock.now() % 1 * 1e9)}
        link.deliver("odom", {"header": {"stamp": stamp}, "pose": {"pose": pose}, "twist": {"twist": still}})

    clock.every(0.05, tell)
    way = WayMeasures("odom", None, None, where="Go")
    assert [need.is_sole for need in way.required()] == [True]
    way.begin(link, context := _context(tmp_path, clock, link), timeout=5.0)
    way.begin_mission()
    clock.sleep(1.0)
    assert not context.broker.findings
    link.known_publishers["odom"] = [GraphEndpoint(node, ODOMETRY) for node in ("/robot", "/ekf")]
    way.end_mission(context)
    (doubt,) = context.broker.findings
    assert "/ekf and /robot publish 'odom'" in doubt.problem
