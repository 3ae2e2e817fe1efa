"""Numbers that plugins of a robot are given."""

from __future__ import annotations

import math

import pytest

from robot_runner.core.errors import PluginError
from robot_runner.plugins.profilers import RosBag, RosGraph, RosTopics, TopicLatency
from robot_runner.plugins.systems import ActionMission, BasicTurtlebot3, Simulation, TopicMission, Waypoints

GIVEN = {
    "speed": lambda value: BasicTurtlebot3(task="Video", task_factor=None, speed=value),
    "odometry_timeout_s": lambda value: BasicTurtlebot3(task="Video", task_factor=None, odometry_timeout_s=value),
    "connect_timeout_s": lambda value: Waypoints([(1.0, 0.0)], connect_timeout_s=value),
    "cancel_timeout_s": lambda value: ActionMission("dock", "nav2_msgs/Dock", cancel_timeout_s=value),
    "until": lambda value: TopicMission("lamp", "std_msgs/Bool", {}, until=value),
    "tolerance_m": lambda value: Simulation(tolerance_m=value),
    "rate_hz": lambda value: RosGraph(rate_hz=value),
    "rate": lambda value: RosTopics({"odom": value}),
    "timeout_s": lambda value: TopicLatency("scan", "obstacles", timeout_s=value),
    "patience": lambda value: RosBag(["odom"], patience=value),
}


@pytest.mark.parametrize("wrong", ["5", math.nan, math.inf, -1.0, True])
@pytest.mark.parametrize("parameter", GIVEN)
def test_what_is_no_number_is_refused_before_a_robot_moves_by_it(parameter, wrong):
    with pytest.raises(PluginError) as caught:
        GIVEN[parameter](wrong)
    assert f"{parameter} is {wrong!r}" in caught.value.problem
    assert f"Give {parameter} a number" in caught.value.fix
