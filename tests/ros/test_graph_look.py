"""Before anything is executed, the graph is seen to have the robot that the plugins need: on each link, in time."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import time
from contextlib import closing

import pytest
from tests.ros.dds_domain import LOOPBACK, claim_domain
from tests.ros.ros1_master import quiet_about_rospy

from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.graph_names import GraphNeed
from robot_runner.core.links.robot_name import RobotName
from robot_runner.ros import graph_look
from robot_runner.ros.graph_links import GRAPH_LINKS
from robot_runner.ros.turtlebot3.steered_robot import Task, TaskServices
from robot_runner.testing import FakeClock, FakeRobotLink, ParameterNode, RosbridgeServer

TRIGGER = "std_srvs/Trigger"
HEAD = """\
from robot_runner import *
from robot_runner.plugins import treatment
from robot_runner.plugins import GraphNeed, System
from robot_runner.plugins.systems import ActionMission, BasicTurtlebot3, TopicMission


class Gripper(System):
    namespace = "arm"

    def required_graph(self, circumstances):
        yield GraphNeed.service("close", "std_srvs/Trigger", fix="Start the gripper.")
        yield GraphNeed.action("/pick", "example_interfaces/Fibonacci")
        yield GraphNeed.action("place", "example_interfaces/Fibonacci")


class Bringup(System):
    starts_nodes = True


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"
"""


def findings(write_config, robot, *plugins):
    """Return what `check` finds, errors with a mark before them."""
    config = write_config(f"plugins = [{', '.join(plugins or ['BasicTurtlebot3()'])}]", head=HEAD)
    found = prepare(config, {"robot": robot}).findings
    return [f"{'! ' if each.is_error else ''}{each}" for each in found]


@pytest.fixture(autouse=True)
def _busy_machine(monkeypatch):
    monkeypatch.setattr(graph_look, "_SECONDS", 60.0)


def be_a_robot(link, *, services):
    link.publish("odom", "nav_msgs/Odometry", {})
    link.subscribe("cmd_vel", "geometry_msgs/Twist", lambda _: None)
    link.offer_action("pick", "example_interfaces/Fibonacci", lambda _: {})
    for name, kind in services.items():
        link.offer(name, kind, lambda _: {})


def test_what_a_plugin_needs_may_name_its_types_as_ros_2_does():
    link = FakeRobotLink(FakeClock())
    link.known_topics |= {"/odom": "nav_msgs/Odometry", "/cmd_vel": "geometry_msgs/Twist"}
    link.offer("dock", TRIGGER, lambda _: {})
    needs = [
        GraphNeed.published("/odom", "nav_msgs/msg/Odometry"),
        GraphNeed.subscribed("/cmd_vel", "geometry_msgs/msg/Twist"),
        GraphNeed.service("/dock", "std_srvs/srv/Trigger"),
    ]
    assert [found for need in needs for found in graph_look.need_findings(link, need, "plugin")] == []
    wrong = GraphNeed.service("/dock", "std_srvs/srv/Empty")
    (finding,) = graph_look.need_findings(link, wrong, "plugin")
    assert finding.problem == "the service '/dock' is of the type std_srvs/Trigger, not std_srvs/Empty"


def test_a_robot_that_offers_an_action_and_nothing_else_is_on_the_graph():
    link = FakeRobotLink(FakeClock())
    link.known_topics = {}
    needs = {"plugin": [GraphNeed.action("/pick", "example_interfaces/Fibonacci")]}
    (absent,) = graph_look._findings(link, needs)
    assert "no robot is on the graph" in absent.problem
    link.offer_action("pick", "example_interfaces/Fibonacci", lambda _: {})
    assert list(graph_look._findings(link, needs)) == []


def test_a_node_that_is_not_there_yet_is_not_waited_for_at_each_question():
    waited = {}

    class Link(FakeRobotLink):
        def call(self, service, *words, timeout=5.0, **more):
            waited.setdefault(service.split("/")[1], timeout)
            return super().call(service, *words, timeout=timeout, **more)

    link = Link(FakeClock())
    ParameterNode(link, "/base", {"gain": 1.0})
    for node in ("/base", "/planner"):
        list(graph_look.need_findings(link, GraphNeed.parameters(node, {"gain": 2.0}), "plugin"))
    assert waited == {"base": graph_look._PARAMETER_SECONDS, "planner": graph_look._PERIOD}


@pytest.mark.parametrize("needs", [{}, {"plugin": [GraphNeed.published("/scan", "sensor_msgs/LaserScan")]}])
def test_a_robot_is_given_the_time_to_be_discovered_also_where_plugins_need_nothing_of_it(needs):
    link = FakeRobotLink(FakeClock())
    seen = iter([{}, {"/rosout": "rcl_interfaces/Log"}])
    link.topics = lambda: next(seen, {"/scan": "sensor_msgs/LaserScan"})
    assert graph_look._patiently(link, needs, 60.0) == []


LOOKING = """
import sys
from pathlib import Path
from types import SimpleNamespace
from robot_runner.ros import graph_look

class Silent:
    def topics(self):
        print("looks", flush=True)
        return {}

    def close(self):
        Path(sys.argv[1]).touch()

silent = SimpleNamespace(follows_graph_clock=lambda _: False, open=lambda *_: Silent())
graph_look.GRAPH_LINKS, graph_look._DISCOVERY = {"ros2": silent}, {"ros2": 600.0}
graph_look._main()
"""


def test_who_looks_for_too_long_leaves_the_graph_as_fast_dds_would_leave_its_shared_memory(tmp_path, monkeypatch):
    monkeypatch.setattr(graph_look, "_LEAVING", 60.0)
    left = tmp_path / "left"
    line = [sys.executable, "-c", LOOKING, str(left)]
    with subprocess.Popen(line, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as looking:
        with looking.stdin as question:
            json.dump({"robot": {"link": "ros2", "options": {}, "address": None}, "needs": {}}, question)
        looking.stdin = None
        assert looking.stdout.readline() == "looks\n"
        (found,) = graph_look._answer(looking, deadline=0.0)
    assert "does not answer within" in found.problem
    assert left.exists()


class GraphLook:
    @pytest.fixture
    def robot(self):
        raise NotImplementedError

    @pytest.mark.long
    def test_the_robot_its_services_and_their_types_are_seen_before_anything_is_executed(self, robot, write_config):
        (alone,) = findings(write_config, robot)
        assert alone.startswith("! robot: no robot is on the graph")
        assert "the plugins need /odom, /cmd_vel, /task/video/start" in alone
        (later,) = findings(write_config, robot, "Bringup()", "BasicTurtlebot3()")
        assert later.startswith("robot: ")
        assert "unless plugin Bringup will start it" in later
        services = {f"task/{task}/{what}": TRIGGER for task in ("video", "network") for what in ("start", "stop")}
        name = RobotName.parse(robot)
        with closing(GRAPH_LINKS[name.link].open(name, SystemClock())) as link:
            be_a_robot(link, services=services | {"task/video/stop": "std_srvs/Empty"})
            found = findings(write_config, robot, "BasicTurtlebot3()", "Gripper()")
            assert len(found) == 4
            assert found[0].startswith(
                "! plugin BasicTurtlebot3: the service '/task/video/stop' is of the type std_srvs/E"
            )
            assert found[1].startswith(
                "! plugin BasicTurtlebot3: there is no service '/task/stop' → Start the robot's task"
            )
            assert found[2].startswith("! plugin Gripper: there is no service '/arm/close' → Start the gripper.")
            assert found[3].startswith("! plugin Gripper: there is no action '/arm/place' ")
            with pytest.raises(LinkError, match="'/task/video/stop' is of the type std_srvs/Empty"):
                TaskServices(link).check(Task.VIDEO, FakeClock(), where="test")  # as a run does before it drives
            link.offer("task/stop", TRIGGER, lambda _: {})
            assert findings(write_config, robot, "BasicTurtlebot3(task_factor=None, task='Network')") == []

    @pytest.mark.long
    def test_goals_and_messages_are_compared_with_their_definitions_even_if_their_node_is_started_later(
        self, robot, write_config
    ):
        missions = (
            "Bringup()",
            "ActionMission('pick', 'example_interfaces/Fibonacci', {'ordr': 3}, name='misspelt')",
            "ActionMission('pick', 'example_interfaces/Fibonacci', {'order': treatment('Task')}, name='bound')",
            "TopicMission('cmd_vel', 'geometry_msgs/msg/Twist', {'linear': {'x': 'fast'}}, until=1.0)",
            "TopicMission('cmd_vel', 'geometry_msgs/Twist', {}, until=1.0, afterwards={'angle': {}}, name='after')",
            "TopicMission('lamp', 'std_msgs/Strin', {'data': 'on'}, until=1.0, name='lamp')",
        )
        name = RobotName.parse(robot)
        with closing(GRAPH_LINKS[name.link].open(name, SystemClock())) as link:
            be_a_robot(link, services={})
            link.subscribe("lamp", "std_msgs/String", lambda _: None)
            found = findings(write_config, robot, *missions)
        told = [each.removeprefix("! plugin ") for each in found if each.startswith("! ")]
        assert len(told) == 6, found
        assert told[0].startswith("misspelt, goal of /pick (")
        assert "the message has no field 'ordr' → Did you mean 'order'?" in told[0]
        assert told[1].startswith("bound, goal of /pick")
        assert "field 'order' is 'Video' → Give a whole number" in told[1]
        assert told[3].startswith("TopicMission, message of /cmd_vel")
        assert "field 'linear.x' is 'fast' → Give a finite number." in told[3]
        assert "has no field 'angle' → Did you mean 'angular'?" in told[4]
        assert told[5].startswith("lamp, message of std_msgs/Strin: ")
        assert "→ Did you mean '" in told[5]


@quiet_about_rospy
class TestOnRos1(GraphLook):
    @pytest.fixture
    def robot(self, master_uri):
        return f"ros1:master={master_uri}"


class TestOverDds(GraphLook):
    @pytest.fixture
    def robot(self, monkeypatch):
        monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
        return f"dds:domain={claim_domain()},distro=humble"

    def test_a_second_robot_a_rival_and_a_wrong_type_are_seen(self, robot, write_config):
        name = RobotName.parse(robot)
        with (
            closing(GRAPH_LINKS["dds"].open(name, SystemClock())) as one,
            closing(GRAPH_LINKS["dds"].open(name, SystemClock())) as other,
        ):
            for link in (one, other):
                link.publish("odom", "nav_msgs/Odometry", {})
            one.subscribe("cmd_vel", "geometry_msgs/Twist", lambda _: None)
            other.publish("cmd_vel", "geometry_msgs/Twist", {})
            other.subscribe("scan", "std_msgs/String", lambda _: None)
            found = graph_look.look_at(
                name,
                {
                    "mission": [
                        GraphNeed.published("/odom", "nav_msgs/Odometry", is_sole=True),
                        GraphNeed.subscribed("/cmd_vel", "geometry_msgs/Twist", is_sole=True),
                        GraphNeed.subscribed("/scan", "sensor_msgs/LaserScan"),
                    ]
                },
            )
        told = " | ".join(map(str, found))
        assert "publish '/odom', so that it is not known where the robot is" in told
        assert "could command the robot, too, on '/cmd_vel'" in told
        assert "subscribes '/scan' as std_msgs/String, not sensor_msgs/LaserScan" in told
        assert len(found) == 3

    def test_a_graph_that_is_to_live_by_a_clock_that_nobody_publishes(self, robot, write_config):
        name = RobotName.parse(f"{robot},clock=graph")
        with closing(GRAPH_LINKS["dds"].open(name, SystemClock())) as link:
            link.publish("odom", "nav_msgs/Odometry", {})
            (finding,) = graph_look.look_at(name, {})
        assert "no node publishes '/clock'" in finding.problem
        assert "leave clock=graph out of robot = 'dds:…'" in finding.fix


class TestOverRosbridge(GraphLook):
    @pytest.fixture
    def robot(self):
        with closing(RosbridgeServer()) as server:
            yield server.url

    def test_what_cannot_be_looked_at_is_said_with_its_reason(self, write_config):
        with closing(RosbridgeServer(has_rosapi=False)) as server:
            (finding,) = findings(write_config, f"{server.url}?ros=1")
        assert finding.startswith("robot: whether the robot is on the graph was not seen: the graph cannot be listed")

    @pytest.mark.long
    def test_a_robot_that_cannot_be_reached_is_refused_and_one_that_is_silent_is_not_awaited(
        self, write_config, monkeypatch
    ):
        with closing(socket.create_server(("127.0.0.1", 0))) as silent:  # takes connections, and says nothing
            port = silent.getsockname()[1]
            monkeypatch.setattr(graph_look, "_SECONDS", 1.0)
            begun = time.monotonic()
            (late,) = findings(write_config, f"rosbridge://127.0.0.1:{port}")
            assert time.monotonic() - begun < 30.0
        assert late.startswith(
            "robot: whether the robot is on the graph was not seen: the graph does not answer within 1 s"
        )
        monkeypatch.setattr(graph_look, "_SECONDS", 60.0)
        (refused,) = findings(write_config, f"rosbridge://127.0.0.1:{port}")
        assert refused.startswith(
            f"! rosbridge at 127.0.0.1:{port}: the rosbridge cannot be reached: connection refused"
        )
