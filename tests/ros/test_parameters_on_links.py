"""Parameters and life cycles of nodes, over every link: simulated, DDS, a rosbridge of either ROS, and real rospy."""

from __future__ import annotations

import time
from contextlib import ExitStack, closing, contextmanager
from functools import partial

import pytest
from tests.ros.dds_domain import LOOPBACK, claim_domain
from tests.ros.ros1_master import quiet_about_rospy

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.robot import Qos
from robot_runner.plugins import TransformBuffer
from robot_runner.ros.lifecycle import LifecycleState, bring_to, change_state, state_of
from robot_runner.ros.link_opening import open_dds_link, open_ros1_link, open_rosbridge_link
from robot_runner.ros.parameter_access import ParameterAccess, parameters_of
from robot_runner.ros.parameter_values import ParameterKind
from robot_runner.ros.ros1_master import Master
from robot_runner.simulator.simulated_link import SimulatedRobotLink
from robot_runner.simulator.simulated_turtlebot3 import Simulation
from robot_runner.testing import LifecycleNode, ParameterNode, RosbridgeServer

TRANSFORMS = "tf2_msgs/TFMessage"
_DOMAIN = claim_domain()
_EVERY_KIND = {
    "enabled": True,
    "count": 7,
    "speed": 0.25,
    "frame": "map",
    "raw": b"\x00\xff",
    "flags": [True, False],
    "ids": [1, -2],
    "gains": [0.5, 2.0],
    "names": ["a", "b"],
}
_OTHERS = {
    "enabled": False,
    "count": -(2**40),
    "speed": 1,  # a whole number for a double
    "frame": "ödom",
    "raw": b"",
    "flags": [],
    "ids": (3,),
    "gains": [1, 0.5],
    "names": [],
}
_AS_TAKEN = {**_OTHERS, "speed": 1.0, "ids": [3], "gains": [1.0, 0.5]}


def refused(attempt):
    with pytest.raises(LinkError) as caught:
        attempt()
    return caught.value


@contextmanager
def simulated(monkeypatch):
    simulation = Simulation(seed=1)
    yield lambda namespace="": SimulatedRobotLink(simulation, namespace=namespace)
    simulation.close()


@contextmanager
def dds(monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    monkeypatch.setattr("robot_runner.ros.dds_session.SETTLING", 0.25)
    monkeypatch.setattr("robot_runner.ros.dds_session.FINDING", 0.0)
    yield lambda namespace="": open_dds_link({"domain": str(_DOMAIN), "distro": "humble"}, SystemClock(), namespace)


@contextmanager
def rosbridge(monkeypatch):
    server = RosbridgeServer(generation=2)
    yield lambda namespace="": open_rosbridge_link(server.url, SystemClock(), namespace)
    server.close()


@pytest.fixture(params=[simulated, dds, rosbridge], ids=lambda each: each.__name__)
def two_links(request, monkeypatch):
    """Two links to one graph of ROS 2: for the node, and for who asks it; both in the namespace /alice."""
    with request.param(monkeypatch) as opener:
        robot, link = opener("alice"), opener("alice")
        yield robot, link
        link.close()
        robot.close()


def test_parameters_of_every_kind_are_listed_described_read_and_changed(two_links):
    robot, link = two_links
    node = ParameterNode(robot, "planner", _EVERY_KIND, read_only=["frame_0"], limits={"speed": (0.0, 2.0)})
    planner = parameters_of(link)
    assert isinstance(planner, ParameterAccess)
    assert planner.names("planner") == sorted(_EVERY_KIND)
    assert planner.values("/alice/planner", list(_EVERY_KIND)) == _EVERY_KIND
    described = planner.described("planner", ["speed", "names"])
    assert (described["speed"].kind, described["speed"].limits) == (ParameterKind.DOUBLE, (0.0, 2.0))
    assert described["names"].text == "names of planner"
    planner.change("planner", _OTHERS)
    assert node.values == _AS_TAKEN == planner.values("planner", list(_OTHERS))


@pytest.mark.parametrize("is_rclcpp", [True, False], ids=["rclcpp", "rclpy"])
def test_what_a_node_does_not_take_is_told_with_reason_and_nearest_name(two_links, is_rclcpp):
    robot, link = two_links

    def refuses(name, value):
        return "odd numbers only" if name == "count" and value % 2 == 0 else ""

    parameters = {"speed": 0.25, "count": 1, "frame": "map", "unset": None}
    options = {"read_only": ["frame"], "limits": {"speed": (0.0, 0.5)}, "refuses": refuses, "is_rclcpp": is_rclcpp}
    node = ParameterNode(robot, "planner", parameters, **options)
    planner = parameters_of(link, timeout=1.0)

    unknown = refused(lambda: planner.values("planner", ["sped", "count", "frme"]))
    assert "'sped'" in unknown.problem
    assert "'frme'" in unknown.problem
    assert "count" not in unknown.problem
    assert unknown.fix == "Did you mean 'speed'? Did you mean 'frame'?"
    error = refused(lambda: planner.change("planner", {"speed": 0.75, "count": 1.0, "frame": "odom"}))
    assert "0.75 is not within the limits that the node names, 0 to 0.5" in error.problem
    assert "count: the parameter is of the kind integer, and 1.0 is of the kind double" in error.problem
    assert "frame: the parameter is read-only" in error.problem
    assert "of the kind integer: 1." in error.fix
    assert not node.changes, "what is refused beforehand is not set in part"
    refusal = refused(lambda: planner.change("planner", {"count": 4, "speed": 0.5}))
    assert "odd numbers only" in refusal.problem
    assert "count" in refusal.where
    assert node.values["speed"] == 0.5, "what the node refuses leaves the others set"
    assert planner.values("planner", ["unset"]) == {"unset": None}
    planner.change("planner", {"unset": [1, 2]})
    assert node.values["unset"] == [1, 2]
    nobody = refused(lambda: planner.values("planer", ["speed"]))
    assert nobody.problem == "there is no node that has parameters: '/alice/planer'"
    assert nobody.fix == "Did you mean '/alice/planner'?"


def test_a_node_is_brought_through_its_life_cycle_in_the_right_order(two_links):
    robot, link = two_links
    node = LifecycleNode(robot, "slam")
    assert state_of(link, "slam") is LifecycleState.UNCONFIGURED
    bring_to(link, "slam", "active")
    assert (node.state, node.transitions) == (LifecycleState.ACTIVE, ["configure", "activate"])
    bring_to(link, "/alice/slam", "unconfigured")
    assert node.transitions[2:] == ["deactivate", "cleanup"]
    wrong = refused(lambda: change_state(link, "slam", "activate"))
    assert wrong.problem == "a node that is unconfigured has no transition 'activate'; it has configure and shutdown"
    node.refuses.add("activate")
    refusal = refused(lambda: bring_to(link, "slam", "active"))
    assert refusal.problem == "the node refuses the transition 'activate': it is inactive now"
    assert change_state(link, "slam", "shutdown") is LifecycleState.FINALIZED
    assert "finalized, from where no transition" in refused(lambda: bring_to(link, "slam", "active")).problem
    assert refused(lambda: state_of(link, "slan", timeout=1.0)).fix == "Did you mean '/alice/slam'?"


def _tell(robot, link):
    """Have one link tell of frames, and look them up over the other."""
    buffer, straight = TransformBuffer(), {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}

    def told(parent, child, x):
        transform = {"translation": {"x": x}, "rotation": straight}
        return {"transforms": [{"header": {"frame_id": parent}, "child_frame_id": child, "transform": transform}]}

    robot.publish("/tf_static", TRANSFORMS, told("base", "lidar", 0.25), qos=Qos.TRANSIENT_LOCAL)
    with ExitStack() as opened:
        buffer.subscribe(link, opened)
        deadline = time.monotonic() + 60
        while "map" not in buffer.frames or "lidar" not in buffer.frames:
            robot.publish("/tf", TRANSFORMS, told("map", "base", 1.0))
            assert time.monotonic() < deadline, buffer.frames
            time.sleep(0.02)
        assert buffer.look_up("map", "lidar").translation == (1.25, 0.0, 0.0)


def test_frames_are_looked_up_over_a_graph(two_links):
    if not isinstance(two_links[0], SimulatedRobotLink):  # whose robot tells of no frames
        _tell(*two_links)


# ROS 1, whose parameters are the master's.


@contextmanager
def rospy(master_uri, monkeypatch):
    link = open_ros1_link({"master": master_uri}, SystemClock(), "alice")
    yield link, Master(master_uri)
    link.close()


@contextmanager
def rosbridge1(master_uri, monkeypatch):
    server = RosbridgeServer(generation=1)
    link = open_rosbridge_link(server.url, SystemClock(), "alice")
    yield link, link.parameter_server
    link.close()
    server.close()


def _check_server(link, server):
    planner = parameters_of(link)
    server.set_parameter("/alice/planner/FollowPath/speed", value=0.25)
    server.set_parameter("/alice/planner/frame", value="map")
    assert planner.names("planner") == ["FollowPath/speed", "frame"]
    planner.change("planner", {"FollowPath/speed": 1, "gains": [0.5, 1], "enabled": True})
    expected = {"FollowPath/speed": 1.0, "gains": [0.5, 1.0], "enabled": True, "nothing": None}
    found = planner.values("/alice/planner", list(expected))
    assert found == expected
    assert type(found["FollowPath/speed"]) is float, "a node that asks for a float gets one"
    error = refused(lambda: planner.change("planner", {"frame": 3, "big": 2**40}))
    assert "kind string" in error.problem
    assert "32 bits" in error.problem
    assert "several parameters" in refused(lambda: planner.values("planner", ["FollowPath"])).problem
    planner.change("planner", {"gains": None, "enabled": None, "nothing": None})
    assert planner.names("planner") == ["FollowPath/speed", "frame"]
    doubts = planner.doubts("planner", ["fram"])
    assert next(fix for _, fix in doubts) == "Did you mean 'frame'?"
    with closing(link.offer("lamp", "std_srvs/Trigger", lambda _: {})):
        assert "is running already" in planner.doubts(link.nodes()[0], ["frame"])[1][0]
    parameters_of(link).change("/", {"use_sim_time": True})
    assert server.parameter("/use_sim_time") is True
    parameters_of(link).change("/", {"use_sim_time": None})
    assert "life cycle: it is ROS 2's" in refused(lambda: state_of(link, "planner")).problem


@quiet_about_rospy
def test_parameters_of_ros_1_are_those_of_the_master(master_uri, monkeypatch):
    with rospy(master_uri, monkeypatch) as (link, server), rospy(master_uri, monkeypatch) as (robot, _):
        _check_server(link, server)
        _tell(robot, link)


def test_parameters_of_ros_1_are_those_that_rosapi_tells(monkeypatch):
    with rosbridge1(None, monkeypatch) as (link, server):
        _check_server(link, server)
        _tell(link, link)
        broken = refused(partial(server.set_parameter, "/raw", value=b"ab"))
        assert "cannot pass through a rosbridge" in broken.problem


def test_a_running_node_of_ros_1_that_can_be_reconfigured_takes_what_is_set():
    with (
        closing(RosbridgeServer(generation=1)) as server,
        closing(open_rosbridge_link(server.url, SystemClock())) as link,
    ):
        there = link.parameter_server
        for name, value in {"speed": 0.25, "frame": "map", "ids": [1]}.items():
            there.set_parameter(f"/move_base/Planner/{name}", value=value)
        asked = []

        def take(request):
            asked.append(request["config"])
            clamped = {"name": "speed", "value": min(0.5, request["config"]["doubles"][0]["value"])}
            server._rosapi.parameters["/move_base/Planner/speed"] = clamped["value"]
            return {"config": {**request["config"], "doubles": [clamped]}}

        server.offer("/move_base/Planner/set_parameters", "dynamic_reconfigure/Reconfigure", take)
        base, names = parameters_of(link), ["Planner/speed", "Planner/frame"]
        assert base.doubts("/move_base", names) == []
        base.change("/move_base", {"Planner/speed": 1, "Planner/frame": "odom", "Planner/ids": [2]})
        assert asked[0]["doubles"] == [{"name": "speed", "value": 1.0}]
        assert asked[0]["strs"] == [{"name": "frame", "value": "odom"}]
        assert base.values("/move_base", names) == {"Planner/speed": 0.5, "Planner/frame": "odom"}, "what it really has"


def test_a_node_that_never_answers_is_told_in_time(two_links):
    robot, link = two_links
    if isinstance(link, SimulatedRobotLink):  # whose services answer at once
        return
    offers = [robot.offer("mute/list_parameters", "rcl_interfaces/ListParameters", lambda _: {})]

    def wait(_):
        SystemClock().sleep(1.5)
        return {}

    offers.append(robot.offer("mute/get_parameters", "rcl_interfaces/GetParameters", wait))
    error = refused(lambda: parameters_of(link, timeout=0.5).values("mute", ["speed"]))
    assert "0.5 s" in error.problem
