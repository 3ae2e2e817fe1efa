"""Before anything is executed, nodes are asked whether their parameters can be set as each treatment wants them."""

from __future__ import annotations

from contextlib import ExitStack, closing

import pytest
from tests.long_cases import soak_but
from tests.ros.dds_domain import LOOPBACK, claim_domain

from robot_runner.core.config.preparation import prepare
from robot_runner.core.events.context import SystemClock
from robot_runner.ros import graph_look
from robot_runner.ros.link_opening import open_dds_link, open_rosbridge_link
from robot_runner.testing import LifecycleNode, ParameterNode, RosbridgeServer

HEAD = """\
from robot_runner import *
from robot_runner.plugins import treatment
from robot_runner.plugins.systems import Lifecycle, RosParameters


class RobotRunnerConfig(ExperimentConfig):
    experiment_name = "trial"
    results_output_path = "results"
"""
TABLE = """\
    def create_run_table(self):
        return RunTableModel([Factor("Speed", [0.5, 2.5]), Factor("Frame", ["map", 3])])
"""


@pytest.fixture
def found(write_config, monkeypatch):
    monkeypatch.setattr(graph_look, "_SECONDS", 60.0)  # on a busy machine, discovery alone takes long

    def check(robot, *plugins):
        config = write_config(f"plugins = [{', '.join(plugins)}]", head=HEAD, table=TABLE)
        return [f"{'! ' if each.is_error else ''}{each}" for each in prepare(config, {"robot": robot}).findings]

    return check


@pytest.mark.long
@pytest.mark.parametrize("way", soak_but({"dds"}, ["dds", "rosbridge"]))
def test_what_a_node_would_not_take_is_found_with_every_treatment(way, found, monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", LOOPBACK)
    with ExitStack() as stack:
        if way == "dds":
            robot = f"dds:domain={claim_domain()}"
            link = open_dds_link({"domain": robot.partition("=")[2]}, SystemClock())
        else:
            server = stack.enter_context(closing(RosbridgeServer(generation=2)))
            robot, link = server.url, open_rosbridge_link(server.url, SystemClock())
        stack.callback(link.close)
        ParameterNode(
            link, "/planner", {"speed": 0.2, "frame": "odom", "id": 1}, read_only=["id"], limits={"speed": (0, 1)}
        )
        LifecycleNode(link, "/slam")
        wanted = "{'planner': {'speed': treatment('Speed'), 'frame': treatment('Frame'), 'id': 2}}"
        told = found(robot, f"RosParameters({wanted})", "Lifecycle({'/slan': 'active'})")
        errors = [each for each in told if each.startswith("! ")]
        for part in (
            "/planner: speed: 2.5 is not within the limits that the node names, 0 to 1",
            "/planner: frame: the parameter is of the kind string, and 3 is of the kind integer",
            "/planner: id: the parameter is read-only",
            "Lifecycle: there is no service '/slan/change_state' → Start the node. Did you mean '/slam/change_state'?",
        ):
            assert [each for each in errors if part in each], (part, told)
        misspelt = "RosParameters({'planner': {'sped': treatment('Speed')}})"
        nobody = "RosParameters({'planer': {'speed': treatment('Speed')}}, name='second')"
        good = "RosParameters({'planner': {'speed': 0.5, 'frame': 'map'}}, name='third'), Lifecycle({'slam': 'active'})"
        found_now = "\n".join(found(robot, misspelt, nobody, good))
        assert "! plugin RosParameters: /planner: the node has no parameter 'sped' → Did you mean 'speed'?" in found_now
        assert "there is no node that has parameters: '/planer' → Did you mean '/planner'?" in found_now
        assert "plugin third" not in found_now
        assert "plugin Lifecycle" not in found_now


@pytest.mark.long
def test_a_parameter_that_nobody_has_set_is_doubted_on_ros_1(found):
    with closing(RosbridgeServer(generation=1)) as server:
        server.publish("/odom", "std_msgs/String", {"data": ""})
        with closing(open_rosbridge_link(server.url, SystemClock())) as link:
            link.parameter_server.set_parameter("/planner/speed", value=0.2)
        unset = "RosParameters({'planner': {'sped': 0.5}})"
        told = found(server.url, unset, "RosParameters({'planner': {'speed': 'x'}}, name='second')")
        error, doubt = sorted(each for each in told if "plugin " in each)
        assert doubt.startswith("plugin RosParameters: /planner/sped was not set before")
        assert error.startswith("! plugin second: /planner/speed: the parameter is of the kind double")
