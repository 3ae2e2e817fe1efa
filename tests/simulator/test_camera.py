"""The camera sees what stands before it, only while somebody looks; a machine that cannot render says so."""

from __future__ import annotations

import ctypes.util
import time
from contextlib import closing

import numpy as np
import pytest
from tests.ros.ros1_master import quiet_about_rospy

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.robot import Encoding
from robot_runner.ros.link_opening import open_ros1_link
from robot_runner.simulator import camera as camera_module
from robot_runner.simulator.graph_robot import GraphRobot, SimulatedPlace
from robot_runner.simulator.rooms import Cylinder, Room
from robot_runner.simulator.simulated_turtlebot3 import Simulation
from robot_runner.simulator.turtlebot3_parameters import Turtlebot3Parameters
from robot_runner.testing import FakeClock, FakeRobotLink

needs_rendering = pytest.mark.skipif(
    ctypes.util.find_library("EGL") is None and ctypes.util.find_library("OSMesa") is None,
    reason="neither EGL nor OSMesa is installed (Debian: apt install libegl1 libgl1-mesa-dri)",
)
SMALL = Turtlebot3Parameters(camera_width=64, camera_height=48)


@pytest.fixture
def simulation():
    made = Simulation(seed=1, parameters=SMALL, room=Room((Cylinder(0.6, 0.0, 0.1),)))
    yield made
    made.close()


def pixels(image):
    assert (image["encoding"], image["step"]) == ("rgb8", 3 * image["width"])
    return np.frombuffer(image["data"], dtype=np.uint8).reshape(image["height"], image["width"], 3).astype(int)


@pytest.mark.long
@needs_rendering
def test_a_picture_shows_what_stands_before_the_robot_and_comes_nearer(simulation):
    robot, images = simulation.turtlebot3(), []
    listening = robot.topics["camera/image_raw"].listen(images.append)
    simulation.clock.sleep(1.0)
    assert len(images) == 5
    robot.drive(0.2, 0.0)
    simulation.clock.sleep(1.5)
    listening.close()
    before, after = pixels(images[0]), pixels(images[-1])
    row = 18  # above the floor's horizon, where only the cylinder stands
    widths = [np.ptp(np.flatnonzero(each[row].sum(axis=1) > 60)) for each in (before, after)]
    assert 8 < widths[0] < widths[1], widths
    middle = np.flatnonzero(before[row].sum(axis=1) > 60).mean()
    assert middle == pytest.approx(31.5, abs=2.0), "it is straight ahead"
    simulation.clock.sleep(1.0)
    assert len(images) == 12, "pictures are made though nobody looks"


@needs_rendering
def test_its_information_is_that_of_a_pinhole(simulation):
    infos = []
    simulation.turtlebot3().topics["camera/camera_info"].listen(infos.append)
    simulation.clock.sleep(0.5)
    focal, _, centre = infos[0]["k"][:3]
    assert centre == 32.0
    assert 2 * np.degrees(np.arctan(centre / focal)) == pytest.approx(62.2)


@pytest.mark.long
@needs_rendering
@pytest.mark.parametrize("is_shared", [False, True])  # as of a client of the server of our rosbridge
def test_on_a_graph_it_renders_only_while_somebody_else_looks(simulation, is_shared):
    link = FakeRobotLink(FakeClock(), is_simulated=True)
    robot = GraphRobot(link, simulation, SimulatedPlace(link="dds", has_camera=True))
    of_camera = lambda: [each for each in link.publications if each.topic == "camera/image_raw"]  # noqa: E731
    assert len(of_camera()) == 1
    link.known_subscribers["/camera/image_raw"] = []
    robot.watch_camera()
    simulation.clock.sleep(1.0)
    assert len(of_camera()) == 1
    link.known_subscribers["/camera/image_raw"] = link.nodes() and [_viewer(is_shared=is_shared)]
    robot.watch_camera()
    simulation.clock.sleep(1.0)
    assert len(of_camera()) == 6
    link.known_subscribers["/camera/image_raw"] = []
    robot.watch_camera()
    simulation.clock.sleep(1.0)
    assert len(of_camera()) == 6
    assert link.encoding is Encoding.CDR
    assert "k" in next(each.message for each in link.publications if each.topic == "camera/camera_info")
    robot.close()


@needs_rendering
@quiet_about_rospy
def test_on_ros1_its_information_has_the_matrices_in_capitals(simulation, master_uri):
    # A node of ROS itself reads it by the class that sensor_msgs brings, where that is installed.
    options = {"master": master_uri}
    with (
        closing(open_ros1_link(options, SystemClock(), "")) as its,
        closing(open_ros1_link(options, SystemClock(), "")) as own,
    ):
        infos = []
        own.subscribe("camera/camera_info", "sensor_msgs/CameraInfo", infos.append)
        robot = GraphRobot(its, simulation, SimulatedPlace(link="ros1", has_camera=True))
        deadline = time.monotonic() + 30.0
        while not infos and time.monotonic() < deadline:
            robot.watch_camera()
            simulation.clock.sleep(0.5)
            time.sleep(0.05)
        robot.close()
        (focal, _, centre), width = infos[0]["K"][:3], infos[0]["width"]
        assert (centre, width) == (32.0, 64)
        assert 2 * np.degrees(np.arctan(centre / focal)) == pytest.approx(62.2)
        assert len(infos[0]["P"]) == 12
        assert len(infos[0]["R"]) == 9
        assert "k" not in infos[0]
        with pytest.raises(LinkError, match=r"no field 'k' → Did you mean 'K'\?"):
            own.publish("other_info", "sensor_msgs/CameraInfo", {"k": [0.0] * 9})


def _viewer(*, is_shared):
    from robot_runner.core.links.robot import GraphEndpoint

    return GraphEndpoint("/rviz", "sensor_msgs/Image", is_own=is_shared, is_shared=is_shared)


def test_a_machine_that_cannot_render_says_why_to_who_subscribes(simulation, monkeypatch):
    monkeypatch.setattr(camera_module, "_WAYS", ("nothing_of_the_kind",))
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    with pytest.raises(LinkError, match="cannot be rendered on this machine") as raised:
        simulation.turtlebot3().topics["camera/image_raw"].listen(print)
    assert "libegl1" in raised.value.fix


@pytest.mark.parametrize("figures", [{"camera_rate": 100}, {"camera_width": 5000}, {"camera_height": 0}])
def test_pictures_are_bounded(figures):
    with pytest.raises(LinkError, match=r"Give a (whole )?number from"):
        Turtlebot3Parameters(**figures)
