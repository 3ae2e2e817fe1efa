"""The graph and the processes of its nodes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time

import pytest
from tests.measuring.busy_core import busy_core

from robot_runner.core.errors import PluginError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.events.measure import Origin
from robot_runner.measuring.device_clock import ClockOffset, ClockRecord
from robot_runner.measuring.host import SamplingReport
from robot_runner.plugins import Circumstances
from robot_runner.ros.ros_graph import RosGraph
from robot_runner.testing import FakeLinks, FakeRobotLink, ProfilerContract, make_context, rehearse

TICK = 1 / os.sysconf("SC_CLK_TCK")


class TestRosGraphOfTheSimulatedRobot(ProfilerContract):
    def make_plugin(self):
        return RosGraph()


@pytest.fixture
def measure(tmp_path):
    def execute(plugin, mission=lambda: time.sleep(1.0)):
        clock = SystemClock()
        robot = FakeRobotLink(clock)
        robot.known_topics |= {"odom": "nav_msgs/Odometry", "scan": "sensor_msgs/LaserScan"}
        context = make_context(tmp_path, plugin, links=FakeLinks(robot=robot), clock=clock)
        rehearse(context, plugin, mission=mission)
        context.resources.close()
        return context

    return execute


def test_nodes_and_topics_are_counted_and_kept(measure):
    context = measure(RosGraph(), lambda: None)
    assert context.measures == {"Nodes": 1, "Topics": 2}
    graph = json.loads((context.raw_data_folder / "graph.json").read_text())
    assert graph["start"] == graph["stop"]
    assert graph["stop"]["topics"] == {"/odom": "nav_msgs/Odometry", "/scan": "sensor_msgs/LaserScan"}


def test_topics_that_ros_2_hides_are_kept_and_not_counted_as_a_rosbridge_does_not_list_them(tmp_path):
    robot, plugin = FakeRobotLink(SystemClock()), RosGraph()
    robot.known_topics |= {"odom": "nav_msgs/Odometry", "dock/_action/status": "action_msgs/GoalStatusArray"}
    context = make_context(tmp_path, plugin, links=FakeLinks(robot=robot))
    rehearse(context, plugin)
    assert context.measures["Topics"] == 1
    graph = json.loads((context.raw_data_folder / "graph.json").read_text())
    assert "/dock/_action/status" in graph["stop"]["topics"]


def test_a_node_is_found_by_the_name_that_it_was_given(measure):
    program = "import time; print('ready', flush=True); time.sleep(60)"
    command = [sys.executable, "-c", program, "--ros-args", "-r", "__node:=fake_robot"]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as node:
        assert node.stdout.readline() == b"ready\n"  # else what Python's start takes counts as the node's
        context = measure(RosGraph(["/fake_robot"], rate_hz=20.0))
        node.terminate()
    assert context.measures["CPU_fake_robot"] == pytest.approx(0.0, abs=5.0)
    assert 0.0 < context.measures["Memory_fake_robot"] < 5.0
    assert {each.origin for each in context.broker.measures.values()} == {Origin.MEASURED}
    assert (context.raw_data_folder / "samples.csv").exists()


@pytest.mark.long
def test_a_process_can_be_named_for_a_node(measure):
    with busy_core() as busy:
        shares = []

        def mission():
            begun, used = time.monotonic(), busy.cpu_seconds
            time.sleep(1.0)
            shares.append((busy.cpu_seconds - used) / (time.monotonic() - begun) / os.cpu_count() * 100)

        for _ in range(10):  # while the machine is too busy for most readings there is no value
            context = measure(RosGraph({"/fake_robot": f"pid:{busy.pid}"}, rate_hz=10.0), mission)
            if context.measures["CPU_fake_robot"] is not None:
                break
    # The kernel counts ticks; a reading that comes late is a mean over a span that lies partly outside the mission.
    gap = json.loads((context.raw_data_folder / "quality.json").read_text())["samples"]["largest_gap"]
    share = shares[-1]  # it has the core for itself only if that is free
    assert context.measures["CPU_fake_robot"] == pytest.approx(share, abs=(2 * TICK + gap) * 100 / os.cpu_count())


def test_a_node_that_is_not_there_yields_no_value_and_a_warning(measure):
    context = measure(RosGraph(["/camera"], rate_hz=20.0))
    assert context.measures["CPU_camera"] is None
    problems = [finding.problem for finding in context.broker.findings]
    assert "node /camera is not on the graph" in problems
    assert "no process node:/camera was seen; new ones are looked for every 0.05 s" in problems


@pytest.mark.parametrize(
    ("chosen", "is_told"), [(["/talker"], True), (["/alice/talker"], False), ({"/talker": "talker_node"}, False)]
)
def test_a_node_that_others_are_called_like_in_their_namespaces_has_doubtful_values(
    measure, monkeypatch, chosen, is_told
):
    monkeypatch.setattr(FakeRobotLink, "nodes", lambda _: ["/alice/talker", "/stalker", "/talker"])
    context = measure(RosGraph(chosen), lambda: None)
    problem = "/talker cannot be told from /alice/talker: its CPU and memory are those of all"
    assert (problem in [finding.problem for finding in context.broker.findings]) is is_told


class OtherComputer:
    """A computer with a clock of its own, on which no process is found."""

    is_simulated = False

    def sample_utilisation(self, rate):
        return self.sample_processes(rate, ())

    def sample_processes(self, rate, processes, *, is_streamed=False):
        return self

    def stop(self):
        return ()

    def report(self):
        before = ClockOffset(at=1.0, steady=500.0, wall_offset=2.0, round_trip=0.1, uncertainty=0.05, exchanges=8)
        return SamplingReport(rate=10.0, clock=ClockRecord("pi@robot", before))

    def close(self):
        pass


def test_the_clock_of_another_computer_is_kept_in_the_journal(measure, monkeypatch):
    monkeypatch.setattr("robot_runner.ros.ros_graph.connect_host", lambda *_, **__: OtherComputer())
    context = measure(RosGraph(["/camera"], host="pi@robot"), lambda: None)
    (clock,) = (fields for kind, fields in context.broker.records if kind == "clock")
    assert (clock["host"], clock["before"]["wall_offset"], clock["after"]) == ("pi@robot", 2.0, None)


def test_a_node_without_a_slash_is_that_of_the_run_s_robot_and_no_other(tmp_path):
    command = [sys.executable, "-c", "import time; time.sleep(60)", "--ros-args", "-r", "__node:=talker", "-r"]
    clock = SystemClock()
    values = {}
    with subprocess.Popen([*command, "__ns:=/bob"]) as node:
        for robot in ("alice", "bob"):
            plugin = RosGraph(["talker"], rate_hz=20.0)
            links = FakeLinks(robot=FakeRobotLink(clock))
            context = make_context(tmp_path / robot, plugin, robot=f"ros2://{robot}", links=links, clock=clock)
            rehearse(context, plugin, mission=lambda: time.sleep(0.3))
            problems = [finding.problem for finding in context.broker.findings]
            assert f"node /{robot}/talker is not on the graph" in problems, "the fake knows neither"
            values[robot] = context.measures["Memory_talker"]
            context.resources.close()
        node.terminate()
    assert values["alice"] is None
    assert values["bob"] > 0.0


def test_nodes_of_a_simulated_robot_have_no_processes():
    (finding,) = RosGraph(["/turtlebot3_node"]).check(Circumstances("simulated"))
    assert finding.is_error
    assert finding.fix == "Leave nodes out."


def test_without_a_robot_the_check_says_how_to_name_one():
    (finding,) = RosGraph().check(Circumstances())
    assert "--set robot=simulated" in finding.fix


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ({"nodes": "/talker"}, "nodes is '/talker'"),
        ({"nodes": ["~/talker"]}, "'~/talker' cannot be the name"),
        ({"nodes": ["/a/b", "/a_b"]}, "share a column"),
        ({"nodes": {"/a": ""}}, "selects no process"),
        ({"rate_hz": 0.0}, "rate_hz is 0"),
    ],
)
def test_arguments_that_cannot_be_are_refused(arguments, problem):
    with pytest.raises(PluginError, match=problem):
        RosGraph(**arguments)
