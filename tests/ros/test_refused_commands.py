"""A command that is refused, as others have claimed the robot, leaves nothing on a real graph."""

from __future__ import annotations

from contextlib import ExitStack, closing
from typing import Any

import pytest
from tests.ros.real_graph import graph, over
from tests.ros.ros1_master import RUDE
from tests.waiting import wait_until

from robot_runner.core.errors import LinkError
from robot_runner.core.events.context import SystemClock
from robot_runner.core.links import commanded_topics
from robot_runner.core.links.robot_name import RobotName
from robot_runner.ros.graph_links import GRAPH_LINKS

__all__ = ["graph"]

pytestmark = [*map(pytest.mark.filterwarnings, RUDE)]

TWIST = "geometry_msgs/Twist"


def refuse(*_: object) -> None:
    raise LinkError("bob is in use", where="open_robot")


@pytest.mark.long
@over("dds", "ros1", "ros2")
def test_a_robot_of_others_is_sent_nothing_and_can_be_commanded_once_they_are_done(
    graph: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard: list[Any] = []

    def velocities() -> list[float]:
        return [each["linear"]["x"] for each in heard]

    with ExitStack() as closing_all:
        name = RobotName.parse(graph)
        mine, bob = (closing_all.enter_context(closing(GRAPH_LINKS[name.link].open(name, SystemClock()))) for _ in "ab")
        bob.subscribe("bob/cmd_vel", TWIST, heard.append)
        wait_until(lambda: mine.subscribers("bob/cmd_vel"))
        with monkeypatch.context() as claimed:
            claimed.setattr(commanded_topics, "claim_commanded", refuse)
            with pytest.raises(LinkError, match="bob is in use"):
                mine.publish("bob/cmd_vel", TWIST, {"linear": {"x": 0.2}})
        wait_until(lambda: not bob.publishers("bob/cmd_vel"), "the topic is not left")
        mine.publish("bob/cmd_vel", TWIST, {"linear": {"x": 0.3}})
        wait_until(lambda: heard)
        mine.close()
        wait_until(lambda: velocities()[-1] == 0.0, "it is not stopped")
        assert set(velocities()) == {0.3, 0.0}
        assert velocities()[0] == 0.3
