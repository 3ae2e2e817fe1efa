"""Rooms of one's own: what stands there by the file is hit by rays and robots; all that is wrong in it is said."""

from __future__ import annotations

import math
import os

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_runner.core.errors import LinkError
from robot_runner.simulator.embedded_robot import simulation_options
from robot_runner.simulator.model import burger_model
from robot_runner.simulator.room_file import read_room
from robot_runner.simulator.rooms import Cylinder, Pose, Room, Wall, ray_distances
from robot_runner.simulator.simulated_turtlebot3 import Simulation
from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters

ROOM = """
[[wall]]
from = [-1.0, 1.0]
to = [3.0, 2.0]
[[box]]
at = [1.5, -0.8]
size = [0.6, 0.3]
yaw = 0.7
[[cylinder]]
at = [1.0, 0.0]
radius = 0.2
[[box]]
at = [0.5, 0.0]
size = [0.1, 0.1]
height = 0.12
"""
TWO = """
[[robot]]
namespace = "alice"
at = [0.0, 0.0]
[[robot]]
namespace = "/bob"
at = [1.0, 0.0]
yaw = 3.141592653589793
"""


@pytest.fixture
def room(tmp_path):
    path = tmp_path / "room.toml"
    path.write_text(ROOM, "utf-8")
    return read_room(path)


def distance(obstacles, angle):
    return float(ray_distances(obstacles, 0.0, 0.0, np.array([angle]))[0])


def test_rays_meet_cylinders_and_turned_boxes():
    assert distance((Cylinder(1.0, 0.0, 0.2),), 0.0) == pytest.approx(0.8)
    assert distance((Cylinder(-1.0, 0.0, 0.2),), 0.0) == math.inf
    assert distance((Wall(1.0, 0.0, 0.1, 0.1, math.pi / 4),), 0.0) == pytest.approx(1 - 0.1 * math.sqrt(2))


def test_clearance_is_the_way_to_the_nearest_outside(room):
    assert room.clearance(1.0, -0.3) == pytest.approx(0.1)
    assert Room((Wall(1.0, 0.0, 0.1, 0.1, math.pi / 4),)).clearance(0, 0) == pytest.approx(1 - 0.1 * math.sqrt(2))
    assert room.clearance(1.5, -0.8) == 0
    assert Room(()).clearance(0, 0) == math.inf


OBSTACLES = (Wall(1.0, 1.0, 0.3, 0.1, 0.7), Cylinder(-0.8, 0.3, 0.2), Wall(0.0, -1.2, 2.0, 0.05, -0.3))


def standing():
    model = mujoco.MjModel.from_xml_string(burger_model(Turtlebot3Parameters(), (0.033, 0.033), obstacles=OBSTACLES))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


STANDING = standing()


@given(angle=st.floats(-math.pi, math.pi))
def test_what_rays_meet_is_what_the_physics_has(angle):
    model, data = STANDING
    direction = np.array([math.cos(angle), math.sin(angle), 0.0])
    truth = mujoco.mj_ray(model, data, np.array([0.0, 0.0, 0.4]), direction, None, 1, -1, np.zeros(1, dtype=np.int32))
    assert distance(OBSTACLES, angle) == pytest.approx(math.inf if truth < 0 else truth, rel=1e-6)


def test_a_robot_sees_what_stands_in_its_room_and_is_stopped_by_it(room):
    simulation = Simulation(seed=1, room=room, parameters=Turtlebot3Parameters(scan_deviation=0))
    robot, scans = simulation.turtlebot3(), []
    robot.topics["scan"].listen(scans.append)
    simulation.clock.sleep(0.5)
    # The low box half a metre ahead is below the scanner's level, and stops the robot all the same.
    assert scans[-1]["ranges"][0] == pytest.approx(0.8 + 0.032, abs=0.002)
    robot.drive(0.2, 0.0)
    simulation.clock.sleep(8.0)
    assert robot.pose.x < 0.45


def test_robots_of_one_room_see_and_hit_each_other(tmp_path):
    path = tmp_path / "two.toml"
    path.write_text(TWO, "utf-8")
    options = simulation_options({"room": str(path), "scan_deviation": "0"})
    simulation = options.simulation(seed=3)
    alice, bob = simulation.turtlebot3("alice"), simulation.turtlebot3("/bob")
    scans = []
    alice.topics["scan"].listen(scans.append)
    simulation.clock.sleep(0.5)
    front = 1.0 + 2 * 0.032 - 0.138 / 2  # both scanners and bodies are 32 mm behind the axle; bob looks at alice
    assert scans[-1]["ranges"][0] == pytest.approx(front, abs=0.003)
    alice.drive(0.2, 0.0)
    simulation.clock.sleep(8.0)
    assert alice.pose.x > 0.8
    assert bob.pose.x > 1.01, "it was not pushed"
    assert bob.pose.x - alice.pose.x > 0.05
    with pytest.raises(LinkError, match="no robot '/alise' starts in the room"):
        simulation.turtlebot3("alise")
    again = options.simulation(seed=3)
    again.turtlebot3("bob").topics["imu"].listen(lambda message: None)
    again.clock.sleep(0.5)
    again.turtlebot3("alice").drive(0.2, 0.0)
    again.clock.sleep(8.0)
    assert again.turtlebot3("alice").pose == alice.pose, "who is asked for first changed the world"


@pytest.mark.parametrize(("height", "is_seen"), [(0.192, True), (0.15, False)])
def test_a_robot_sees_another_that_reaches_the_height_of_its_scanner(height, is_seen):
    room = Room((), {"/a": Pose(0.0, 0.0, 0.0), "/b": Pose(1.0, 0.0, 0.0)})
    simulation = Simulation(1, parameters=Turtlebot3Parameters(body_height=height), room=room)
    ahead = simulation.turtlebot3("/a").topics["scan"].latest()["ranges"][0]
    assert (ahead < math.inf) == is_seen


def test_the_battery_of_each_robot_of_a_room_is_looked_at_whoever_is_asked():
    room = Room((), {"/a": Pose(0.0, 0.0, 0.0), "/b": Pose(1.0, 0.0, 0.0)})
    simulation = Simulation(seed=1, room=room, parameters=Turtlebot3Parameters(initial_charge=0.5))
    a, b = simulation.turtlebot3("a"), simulation.turtlebot3("b")
    b.drive(0.0, 1.0)
    for _ in range(60):
        simulation.clock.sleep(1.0)
        assert a.pose.x == pytest.approx(0.0, abs=0.01)  # only a is asked
    assert b.cut_off is not None
    assert b.cut_off.time < 60


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("[[wal]]\nfrom = [0, 0]", "is nothing that a room has"),
        ("[[wall]]\nfrom = [1, 0]\nto = [1, 0]", "ends where it begins"),
        ("[[box]]\nat = [1, 2]\nsize = [0, 1]", "size is"),
        ("[[box]]\nat = [1, nan]\nsize = [1, 1]", "at is"),
        ("[[cylinder]]\nat = [1, 2]\nradius = -1", "radius is -1"),
        (f"[[cylinder]]\nat = [2, 2]\nradius = 1{400 * '0'}", "radius is 1"),
        ("[[robot]]\nat = [1e20, 0]", "at is .1e.20"),
        ("[[cylinder]]\nat = [2, 2]\nradius = 0.1\nheigth = 2", "heigth is not known"),
        ("[[cylinder]]\nat = [0.1, 0]\nradius = 0.1", "within or at an obstacle"),
        ("[[robot]]\nat = [0, 0]\nnamespace = 'a b'", "namespace"),
        ("[[robot]]\nat = [0, 0]\n[[robot]]\nat = [1, 0]", "starts twice"),
        ("[[robot]]\nat = [0, 0]\n[[robot]]\nat = [0.1, 0]\nnamespace = 'b'", "within each other"),
        ("box = 3", "is 3, not a table"),
        ("[[box", "is not TOML"),
        pytest.param(f"box = {'9' * 5000}", "is not TOML", id="5000 digits"),
        pytest.param(f"box = {'[' * 3000}", "is not TOML", id="deep brackets"),
    ],
)
def test_what_is_no_room_is_refused_with_a_fix(tmp_path, text, problem):
    path = tmp_path / "room.toml"
    path.write_text(text, "utf-8")
    with pytest.raises(LinkError, match=problem) as raised:
        read_room(path)
    assert raised.value.fix


def test_all_that_is_wrong_is_said_at_once(tmp_path):
    path = tmp_path / "room.toml"
    path.write_text("[[box]]\nat = 1\nsize = 2\n[[cylinder]]\nradius = 0", "utf-8")
    with pytest.raises(LinkError) as raised:
        read_room(path)
    assert len(raised.value.findings) == 4
    with pytest.raises(LinkError, match="there is no such room"):
        read_room(tmp_path / "none.toml")


def test_a_named_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "room.toml")
    with pytest.raises(LinkError, match="the room is not a regular file"):
        read_room(tmp_path / "room.toml")
