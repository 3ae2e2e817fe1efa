"""The nodes for ROS 2 against a stand-in of the part of rclpy that they use; real ROS 2 is on few machines."""

from __future__ import annotations

import sys
import time
from enum import Enum
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import ClassVar

import pytest

SHELL = Path(__file__).parents[3] / "robot" / "robot_runner_ros2"
LOGIC = Path(__file__).parents[3] / "robot" / "robot_runner_onboard" / "src"


class Vector:
    def __init__(self):
        self.x = self.y = self.z = 0.0


class Twist:
    def __init__(self):
        self.linear, self.angular = Vector(), Vector()


class TwistStamped:
    def __init__(self):
        self.header, self.twist = SimpleNamespace(stamp=None), Twist()


class Node:
    """What a node asked for; parameters are those of the test, else their defaults."""

    overrides: ClassVar[dict[str, object]] = {}

    def __init__(self, name):
        self.name, self.services, self.heard_by, self.timers, self.said, self.logged = name, {}, {}, [], [], []
        self.listeners, self.closed = [], []
        self._publishers = []  # rclpy's own

    def declare_parameter(self, name, value):
        return SimpleNamespace(value=self.overrides.get(name, value))

    def create_service(self, kind, name, answer):
        self.services[name] = answer

    def create_subscription(self, kind, name, hear, qos):
        self.heard_by[name] = (kind, hear)

    def create_publisher(self, kind, name, qos):
        self._publishers.append(SimpleNamespace(publish=self.said.append))
        return self._publishers[-1]

    def destroy_publisher(self, publisher):
        self.closed.append(publisher)

    def destroy_subscription(self, subscription):
        self.closed.append(subscription)

    def create_timer(self, period, look, clock):
        self.timers.append((period, look, clock))

    def resolve_topic_name(self, name):
        return f"/alice/{name}"

    def get_subscriptions_info_by_topic(self, name):
        assert name == "/alice/cmd_vel"
        return self.listeners

    def get_name(self):
        return self.name

    def get_namespace(self):
        return "/alice"

    def get_clock(self):
        return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: "now"))

    def get_logger(self):
        return SimpleNamespace(
            **dict.fromkeys(("info", "warning", "error"), self.logged.append),
        )

    def destroy_node(self):
        self.logged.append("destroyed")


def module(name, **members):
    made = ModuleType(name)
    vars(made).update(members)
    return made


@pytest.fixture(autouse=True)
def ros2(monkeypatch):
    steady = Enum("ClockType", ["STEADY_TIME"])
    reliability = Enum("ReliabilityPolicy", ["BEST_EFFORT"])
    stand_ins = [
        module("rclpy", init=lambda: None, spin=lambda node: None, try_shutdown=lambda: None),
        module("rclpy.node", Node=Node),
        module("rclpy.clock", Clock=lambda clock_type: clock_type, ClockType=steady),
        module("rclpy.executors", ExternalShutdownException=type("ExternalShutdownException", (Exception,), {})),
        module("rclpy.qos", QoSProfile=lambda **settings: settings, ReliabilityPolicy=reliability),
        module("geometry_msgs"),
        module("geometry_msgs.msg", Twist=Twist, TwistStamped=TwistStamped),
        module("std_msgs"),
        module("std_msgs.msg", UInt32=SimpleNamespace),
        module("std_srvs"),
        module("std_srvs.srv", Trigger=SimpleNamespace),
    ]
    for each in stand_ins:
        monkeypatch.setitem(sys.modules, each.__name__, each)
    for name in [name for name in sys.modules if name.startswith("robot_runner_ros2")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(str(SHELL))
    monkeypatch.setenv("PYTHONPATH", str(LOGIC))
    monkeypatch.setattr(Node, "overrides", {})
    yield
    for name in [name for name in sys.modules if name.startswith("robot_runner_ros2")]:
        del sys.modules[name]


def task_node():
    from robot_runner_ros2.task_node import _TaskNode

    return _TaskNode()


def watchdog_node():
    from robot_runner_ros2.watchdog_node import _WatchdogNode

    return _WatchdogNode()


def answer_of(node, service):
    response = node.services[service](SimpleNamespace(), SimpleNamespace())
    return response.success, response.message


def test_the_tasks_are_services_and_end_with_the_node():
    node = task_node()
    assert {"task/stop", "task/computation/start", "task/video/stop", "task/network/start"} <= set(node.services)
    assert answer_of(node, "task/computation/start") == (True, "computation started")
    assert answer_of(node, "task/video/start") == (False, "computation is running already")
    worker = node._desk.worker_pid
    node.destroy_node()
    assert node._desk.worker_pid is None
    assert worker is not None
    assert node.logged[-1] == "destroyed"


def test_parameters_have_dots_where_ros_1_has_slashes():
    Node.overrides = {"network.address": "ftp://server"}
    success, message = answer_of(task_node(), "task/network/start")
    assert not success
    assert "'ftp://server'" in message


def robot_hears(node, kind):
    """Have a robot, and no other, hear commands of this type."""
    robot = ("turtlebot3_node", f"geometry_msgs/msg/{kind.__name__}")
    own = [(node.name, f"geometry_msgs/msg/{served.__name__}") for served in node._served]
    node.listeners = [
        SimpleNamespace(node_name=name, node_namespace="/alice", topic_type=type_name)
        for name, type_name in [robot, *own]
    ]
    node.timers[1][1]()


@pytest.mark.parametrize("kind", [Twist, TwistStamped])
def test_the_watchdog_stops_a_robot_whose_run_falls_silent(kind):
    Node.overrides = {"heartbeat_timeout": 0.05}
    node = watchdog_node()
    robot_hears(node, kind)
    (_, look, clock), _ = node.timers
    assert clock.name == "STEADY_TIME"
    heard, hear = node.heard_by["cmd_vel"]
    assert heard is kind
    hear(kind())
    look()
    assert node.said == []
    node.heard_by["robot_runner/heartbeat"][1](SimpleNamespace(data=1))
    time.sleep(0.06)
    look()
    look()
    assert [type(command) for command in node.said] == [kind] * 2
    assert len([line for line in node.logged if "fallen silent" in line]) == 1
    assert answer_of(node, "robot_runner/watchdog/release")[0]
    look()
    assert len(node.said) == 2


def test_the_watchdog_stops_a_robot_that_came_back_and_hears_the_other_type():
    Node.overrides = {"heartbeat_timeout": 0.05}
    node = watchdog_node()
    node.timers[1][1]()
    assert "cmd_vel" not in node.heard_by  # its own type would keep others from using the robot's
    for kind in (Twist, TwistStamped, TwistStamped):
        robot_hears(node, kind)
    node.heard_by["robot_runner/heartbeat"][1](SimpleNamespace(data=1))
    time.sleep(0.06)
    node.timers[0][1]()
    assert [type(command) for command in node.said] == [TwistStamped]
    assert len(node.closed) == 2  # what it published and heard in the former type


def test_the_watchdog_sees_commands_that_stay_away_while_the_robot_moves():
    Node.overrides = {"heartbeat_timeout": 0.0, "command_timeout": 0.05}
    node = watchdog_node()
    robot_hears(node, TwistStamped)
    command = TwistStamped()
    command.twist.angular.z = 0.5
    node.heard_by["cmd_vel"][1](command)
    time.sleep(0.06)
    node.timers[0][1]()
    assert [type(said) for said in node.said] == [TwistStamped]


@pytest.mark.parametrize("name", ["task_node", "watchdog_node"])
def test_a_node_lives_until_ros_ends_it_and_is_closed(name, monkeypatch):
    spun = []
    monkeypatch.setattr(sys.modules["rclpy"], "spin", spun.append)
    __import__(f"robot_runner_ros2.{name}")
    sys.modules[f"robot_runner_ros2.{name}"].main()
    assert spun[0].logged[-1] == "destroyed"
