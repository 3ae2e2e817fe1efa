"""What the simulated robot publishes on a real graph: only what somebody hears, and that at once."""

from __future__ import annotations

import time
from contextlib import closing

import pytest
from tests.ros.real_graph import graph, over
from tests.ros.ros1_master import RUDE

from robot_runner.core.events.context import SystemClock
from robot_runner.core.links.robot_name import RobotName
from robot_runner.ros.graph_links import GRAPH_LINKS
from robot_runner.simulator import sensors
from robot_runner.simulator.graph_robot import SimulatedPlace
from robot_runner.simulator.graph_simulation import on_graph

__all__ = ["graph"]

pytestmark = [*map(pytest.mark.filterwarnings, RUDE)]

PATIENCE = 60.0  # s


@over("dds", "ros1", "ros2")
def test_a_topic_that_nobody_hears_is_not_computed_and_whoever_subscribes_later_hears_it(
    graph: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, made, heard, make = RobotName.parse(graph), [], [], sensors.imu
    monkeypatch.setattr(sensors, "imu", lambda *readings: made.append(None) or make(*readings))
    with on_graph(SimulatedPlace(link=graph, namespace="/una")) as simulation:
        simulation.live(seconds=0.1)
        assert len(made) == 1, "of 20: the first one puts the topic on the graph"
        with closing(GRAPH_LINKS[name.link].open(name, SystemClock(), "/una")) as link:
            link.subscribe("imu", "sensor_msgs/Imu", heard.append)
            deadline = time.monotonic() + PATIENCE
            while len(heard) < 2 and time.monotonic() < deadline:
                simulation.live(seconds=0.05)
    assert len(heard) >= 2
