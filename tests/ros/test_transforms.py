"""Transforms are what SciPy computes, and what cannot be looked up is refused with figures and names."""

from __future__ import annotations

import math
from contextlib import ExitStack

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from robot_runner.core.errors import LinkError
from robot_runner.plugins import Transform, TransformBuffer
from robot_runner.testing import FakeClock, FakeRobotLink

STRAIGHT = (0.0, 0.0, 0.0, 1.0)
coordinates = st.floats(-100, 100)
vectors = st.tuples(coordinates, coordinates, coordinates)
rotations = (
    st.tuples(*[st.floats(-1, 1)] * 4)
    .filter(lambda each: math.hypot(*each) > 0.1)
    .map(lambda each: tuple(float(part) for part in np.array(each) / np.linalg.norm(each)))
)
poses = st.tuples(vectors, rotations)


def refused(attempt):
    with pytest.raises(LinkError) as caught:
        attempt()
    return caught.value


def matrix(pose):
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = Rotation.from_quat(pose[1]).as_matrix(), pose[0]
    return made


def between(first, second, share):
    """SciPy's own interpolation of two poses, as a matrix."""
    turned = Slerp([0, 1], Rotation.from_quat([first[1], second[1]]))(share)
    made = np.eye(4)
    made[:3, :3] = turned.as_matrix()
    made[:3, 3] = np.array(first[0]) + share * (np.array(second[0]) - np.array(first[0]))
    return made


def same(found, expected):
    assert np.allclose(matrix((found.translation, found.rotation)), expected, atol=1e-9 * (1 + np.abs(expected).max()))


@pytest.mark.long
@given(st.lists(poses, min_size=6, max_size=6), poses, st.floats(0, 1))
def test_what_is_looked_up_is_what_scipy_computes(pairs, camera, share):
    """map → odom → base → camera (static), and map → goal: looked up across, and back, between two stamps."""
    buffer = TransformBuffer()
    time = 10.0 + share
    for (parent, child), first, second in zip(
        (("map", "odom"), ("odom", "base"), ("map", "goal")), pairs[::2], pairs[1::2], strict=True
    ):
        buffer.add(parent, child, 10.0, *first)
        buffer.add(parent, child, 11.0, *second)
    buffer.add("base", "camera", 0.0, *camera, is_static=True)
    at = [between(first, second, time - 10.0) for first, second in zip(pairs[::2], pairs[1::2], strict=True)]
    in_map = at[0] @ at[1] @ matrix(camera)
    same(buffer.look_up("map", "camera", time), in_map)
    same(buffer.look_up("goal", "camera", time), np.linalg.inv(at[2]) @ in_map)
    same(buffer.look_up("camera", "goal", time), np.linalg.inv(in_map) @ at[2])
    found, point = buffer.look_up("goal", "camera", time), (0.5, -2.0, 3.0)
    expected = np.linalg.inv(at[2]) @ in_map @ np.array([*point, 1.0])
    assert np.allclose(found.apply(point), expected[:3], atol=1e-6)
    assert found.distance == pytest.approx(np.linalg.norm((np.linalg.inv(at[2]) @ in_map)[:3, 3]), abs=1e-9)
    same(buffer.look_up("base", "base", time), np.eye(4))
    assert not buffer.findings


@given(rotations)
def test_the_angle_about_z_is_that_of_the_turned_x_axis(rotation):
    x, y, _ = Rotation.from_quat(rotation).apply([1.0, 0.0, 0.0])
    if math.hypot(x, y) > 1e-3:  # straight up, there is none
        difference = Transform((0.0, 0.0, 0.0), rotation).yaw - math.atan2(y, x)
        assert abs(math.remainder(difference, math.tau)) < 1e-6


def test_the_last_common_time_is_taken_and_nothing_is_extrapolated():
    buffer = TransformBuffer()
    for time in (1.0, 2.0, 3.0):
        buffer.add("map", "odom", time, (time, 0.0, 0.0), STRAIGHT)
    for time in (1.5, 2.5):
        buffer.add("odom", "base", time, (0.0, time, 0.0), STRAIGHT)
    found = buffer.look_up("map", "base")
    assert (found.time, found.translation) == (2.5, (2.5, 2.5, 0.0))
    late = refused(lambda: buffer.look_up("map", "base", 2.75))
    assert late.problem == "'base' in 'odom' is known from 1.500 to 2.500 s, and 2.750 s is 0.250 s after that"
    early = refused(lambda: buffer.look_up("map", "base", 1.25))
    assert "1.250 s is 0.250 s before that" in early.problem
    assert "time=None" in early.fix
    buffer.add("base", "lidar", 0.0, (0.0, 0.0, 1.0), STRAIGHT, is_static=True)
    assert buffer.look_up("base", "lidar").time is None, "what always holds has no time"
    assert buffer.look_up("base", "lidar", 99.0).translation == (0.0, 0.0, 1.0)
    assert buffer.look_up("/map", "/odom", 3.0).translation == (3.0, 0.0, 0.0)


def test_what_is_older_than_the_horizon_goes():
    buffer = TransformBuffer(horizon=5.0)
    for time in range(20):
        buffer.add("map", "base", float(time), (float(time), 0.0, 0.0), STRAIGHT)
    buffer.add("map", "base", 18.5, (-1.0, 0.0, 0.0), STRAIGHT)  # it was overtaken, and is put where it belongs
    assert buffer.look_up("map", "base", 18.5).translation[0] == -1.0
    assert buffer.look_up("map", "base", 19.0).translation[0] == 19.0
    assert "known from 14.000 to 19.000 s" in refused(lambda: buffer.look_up("map", "base", 13.9)).problem


def test_unknown_and_unconnected_frames_are_named():
    buffer = TransformBuffer()
    assert "no frame has been published yet" in refused(lambda: buffer.look_up("map", "base_link")).fix
    buffer.add("odom", "base_link", 1.0, (0.0, 0.0, 0.0), STRAIGHT)
    buffer.add("map", "goal", 1.0, (0.0, 0.0, 0.0), STRAIGHT)
    error = refused(lambda: buffer.look_up("map", "base_lnik"))
    assert (error.problem, error.fix) == ("there is no frame 'base_lnik'", "Did you mean 'base_link'?")
    apart = refused(lambda: buffer.look_up("goal", "base_link"))
    assert apart.problem == "'base_link' and 'goal' are not connected: the one is below 'odom', the other below 'map'"
    assert "where 'odom' is in 'map'" in apart.fix
    assert "horizon is 0" in refused(lambda: TransformBuffer(horizon=0)).problem


def test_what_cannot_be_true_is_left_out_and_told_once():
    buffer = TransformBuffer()
    buffer.add("map", "odom", 1.0, (1.0, 0.0, 0.0), STRAIGHT)
    buffer.add("odom", "base", 1.0, (1.0, 0.0, 0.0), STRAIGHT)
    for _ in range(3):
        buffer.add("base", "map", 1.0, (0.0, 0.0, 0.0), STRAIGHT)
        buffer.add("base", "base", 1.0, (0.0, 0.0, 0.0), STRAIGHT)
        buffer.add("map", "odom", 2.0, (math.nan, 0.0, 0.0), STRAIGHT)
        buffer.add("map", "odom", 2.0, (5.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))
    assert buffer.look_up("map", "base").translation == (2.0, 0.0, 0.0)
    problems = [finding.problem for finding in buffer.findings]
    assert len(problems) == 4
    assert problems[0] == "'map' would be its own ancestor, as a child of 'base': that is left out"
    assert "has no name or no numbers" in problems[2]
    assert "not a unit quaternion" in problems[3]
    buffer.add("map", "base", 3.0, (7.0, 0.0, 0.0), STRAIGHT)
    assert buffer.look_up("map", "base").translation == (7.0, 0.0, 0.0)
    assert buffer.findings[-1].problem == "'base' has two parents, 'odom' and 'map': the last one published holds"


def test_a_simulation_that_was_reset_is_not_mixed_with_the_one_before():
    buffer = TransformBuffer()
    for time in (100.0, 101.0):
        buffer.add("map", "odom", time, (time, 0.0, 0.0), STRAIGHT)
        buffer.add("odom", "base", time, (0.0, 0.0, 0.0), STRAIGHT)
    buffer.add("base", "lidar", 0.0, (0.0, 0.0, 1.0), STRAIGHT, is_static=True)
    buffer.add("odom", "base", 0.5, (3.0, 0.0, 0.0), STRAIGHT)
    assert "the stamps of 'base' jump back from 101.000 to 0.500 s" in buffer.findings[0].problem
    assert buffer.look_up("odom", "lidar").translation == (3.0, 0.0, 1.0)
    assert not buffer.can_look_up("map", "base")
    assert buffer.can_look_up("odom", "lidar")
    assert "no frame 'map'" in refused(lambda: buffer.look_up("map", "base")).problem


def test_transforms_are_received_until_it_is_closed_and_awaited_in_time():
    clock = FakeClock()
    link, buffer = FakeRobotLink(clock), TransformBuffer()

    def message(parent, child, time, x):
        stamp = {"sec": int(time), "nanosec": round(time % 1 * 1e9)}
        transform = {"translation": {"x": x, "y": 0.0, "z": 0.0}, "rotation": dict(zip("xyzw", STRAIGHT, strict=True))}
        header = {"stamp": stamp, "frame_id": parent}
        return {"transforms": [{"header": header, "child_frame_id": child, "transform": transform}]}

    with ExitStack() as opened:
        buffer.subscribe(link, opened)
        link.deliver("/tf_static", message("base", "lidar", 0.0, 0.25))
        clock.at(2.0, lambda: link.deliver("/tf", message("map", "base", 4.5, 1.0)))
        assert buffer.wait_for("map", "lidar", clock).translation == (1.25, 0.0, 0.0)
        assert 2.0 <= clock.now() < 2.1
        late = refused(lambda: buffer.wait_for("map", "lidar", clock, 5.0, timeout=1.0))
        assert "0.500 s after that, 1 s after it was asked for" in late.problem
    assert link.topics_heard == set()
