"""Whoever steers, measures or judges by what a robot publishes waits for no callback of a config."""

from __future__ import annotations

from contextlib import ExitStack, suppress
from typing import TYPE_CHECKING, Any

import pytest

from robot_runner.conditions.topic_messages import topic_below
from robot_runner.core.errors import LinkError
from robot_runner.plugins.profilers import Battery
from robot_runner.plugins.systems import ActionMission, BasicTurtlebot3
from robot_runner.testing import FakeClock, FakeLinks, FakeRobotLink, make_context

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from robot_runner.core.events.context import RobotRunnerContext

_NAVIGATE = "navigate_to_pose", "nav2_msgs/NavigateToPose"


class Noted(FakeRobotLink):
    """A robot that notes which topics are subscribed, and whether by prompt callbacks."""

    def __init__(self) -> None:
        super().__init__(FakeClock())
        self.subscribed: dict[str, bool] = {}

    def subscribe(self, topic: str, *args: Any, is_prompt: bool = False, **more: Any) -> Any:
        self.subscribed[topic] = is_prompt
        return super().subscribe(topic, *args, is_prompt=is_prompt, **more)


def begin(system: Any) -> Callable[[RobotRunnerContext], object]:
    def start_run(context: RobotRunnerContext) -> None:
        with suppress(LinkError):  # nothing is published
            system.start_run(context)

    return start_run


@pytest.mark.parametrize(
    ("listen", "topics"),
    [
        (Battery().start_measurement, {"battery_state"}),
        (begin(BasicTurtlebot3(task="Video", task_factor=None)), {"odom"}),
        (begin(ActionMission(*_NAVIGATE, scan="scan")), {"scan"}),
        (begin(ActionMission(*_NAVIGATE, path_frames=("map", "base_link"))), {"/tf", "/tf_static"}),
        (lambda context: topic_below("depth", "std_msgs/Float32", "data", 1).watch(context, ExitStack()), {"depth"}),
    ],
    ids=["battery", "odometry that steers", "obstacles of a mission", "transforms", "condition"],
)
def test_a_plugin_waits_for_no_callback_of_the_config(
    tmp_path: Path, listen: Callable[[RobotRunnerContext], object], topics: set[str]
) -> None:
    link = Noted()
    listen(make_context(tmp_path, robot="ros2", links=FakeLinks(robot=link)))
    assert link.subscribed == dict.fromkeys(topics, True)
