"""Whether a robot is a simulated one is asked after its mission: to ask takes time, which is not to be measured."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from tests.ros.missions.drive_action import ACTION, ACTION_TYPE, goal_at, offered

from robot_runner.plugins.systems import ActionMission, BasicTurtlebot3, TopicMission, Waypoints
from robot_runner.ros.missions import action_mission, topic_mission
from robot_runner.ros.turtlebot3 import steered_robot
from robot_runner.testing import make_context, rehearse

if TYPE_CHECKING:
    from pathlib import Path

SLOW = 2.0
MISSIONS = {
    "BasicTurtlebot3": lambda: BasicTurtlebot3(task="Video", sleep_s=0.1, drive_s=1, task_s=0.1, rotate_s=1.8),
    "Waypoints": lambda: Waypoints([(0.2, 0.0)]),
    "TopicMission": lambda: TopicMission("cmd_vel", "geometry_msgs/Twist", {"linear": {"x": 0.2}}, until=1.0),
    "ActionMission": lambda: ActionMission(ACTION, ACTION_TYPE, goal_at(0.2)),
}


@pytest.mark.parametrize("mission", MISSIONS)
def test_a_graph_that_takes_long_to_tell_whether_the_robot_is_simulated_lengthens_no_mission(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mission: str
) -> None:
    plugin = MISSIONS[mission]()
    context = make_context(tmp_path, plugin)
    if mission == "ActionMission":
        offered(context)
    asked: list[float] = []

    def ask(*_: Any) -> bool:
        asked.append(context.clock.now())
        context.clock.sleep(SLOW)
        return True

    for module in (steered_robot, topic_mission, action_mission):
        monkeypatch.setattr(module, "is_simulation", ask)
    rehearse(context, plugin)
    assert context.window is not None
    assert asked
    assert min(asked) >= context.window.end
    assert {each.origin.value for each in context.broker.measures.values()} == {"simulated"}
    context.resources.close()
