"""Definitions of actions: files of the user, those that are known without ROS, and the classes of a sourced ROS 2."""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace

import pytest

from robot_runner.core.errors import LinkError
from robot_runner.core.links.robot import Encoding
from robot_runner.ros.ros1_actions import ros1_action_types
from robot_runner.ros.ros2_actions import ros2_action_types
from robot_runner.ros.shapes import completed
from robot_runner.ros.type_catalogue import TypeCatalogue


def dig(folder, text):
    (folder / "garden_msgs" / "action").mkdir(parents=True)
    file = folder / "garden_msgs" / "action" / "Dig.action"
    file.write_text(text, encoding="utf-8")
    (folder / "garden_msgs" / "msg").mkdir()
    (folder / "garden_msgs" / "msg" / "Hole.msg").write_text("float32 depth\n", encoding="utf-8")
    return folder


def test_an_action_file_is_read_for_both_generations(tmp_path):
    folder = dig(tmp_path, "# where\nHole[] holes\n---\nuint8 DONE=1\nuint8 code\n---\n# nothing is told\n")
    for generation, types in ((1, ros1_action_types), (2, ros2_action_types)):
        found = types(TypeCatalogue.of(generation, None, [folder]), "garden_msgs/Dig")
        assert found.goal.names == ("holes",)
        assert found.result.names == ("code",)
        assert found.feedback.names == ()
        assert completed(found.goal, {"holes": [{"depth": 1}]}, where="goal") == {"holes": [{"depth": 1.0}]}


def test_bytes_of_an_action_are_those_of_ros(tmp_path):
    del tmp_path
    request = {"goal_id": {"uuid": bytes(range(16))}, "goal": {"order": 7}}
    data = TypeCatalogue.of(2).serialise("example_interfaces/Fibonacci_SendGoal_Request", request, Encoding.CDR)
    assert data == bytes.fromhex("00010000") + bytes(range(16)) + (7).to_bytes(4, "little")


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("int32 order\n---\nint32 result\n", "an action has two lines '---', not 1"),
        ("int32 order\n", "not 0"),
        ("int32\n---\n---\n", "cannot be read"),
        ("Spade spade\n---\n---\n", "'garden_msgs/msg/Spade', which is not known"),
    ],
)
def test_a_wrong_action_file_is_named_with_its_fault(tmp_path, text, problem):
    with pytest.raises(LinkError) as refused:
        TypeCatalogue.of(2, None, [dig(tmp_path, text)])
    assert problem in refused.value.problem
    assert "Dig" in refused.value.where


@pytest.mark.parametrize(
    ("distro", "result"),
    [("humble", ("result",)), ("iron", ("error_code",)), ("jazzy", ("error_code", "error_msg"))],
)
def test_the_actions_of_nav2_are_those_of_the_distribution(distro, result):
    for action in ("NavigateToPose", "NavigateThroughPoses"):
        assert ros2_action_types(TypeCatalogue.of(2, distro), f"nav2_msgs/{action}").result.names == result


def test_digests_of_ros_1_are_those_of_its_own_packages():
    # As rosmsg md5 tells them on Noetic.
    known = TypeCatalogue.of(1)
    assert known.digest("move_base_msgs/MoveBaseActionGoal") == "660d6895a1b9a16dce51fbdd9a64a56b"
    assert known.digest("control_msgs/FollowJointTrajectoryActionGoal") == "cff5c1d533bf2f82dd0138d57f4304bb"
    assert known.digest("actionlib_tutorials/FibonacciActionGoal") == "006871c7fa1d0e3d5fe2226bf17b2a94"


def test_an_unknown_action_is_refused_with_the_nearest():
    with pytest.raises(LinkError, match="there is no action type 'nav2_msgs/NavigateToPos'") as refused:
        ros2_action_types(TypeCatalogue.of(2), "nav2_msgs/NavigateToPos")
    assert refused.value.fix == "Did you mean 'nav2_msgs/NavigateToPose'?"


def generated(name, **fields):
    """Return a class as ROS 2 generates one: fields with their kinds, by name."""

    def fill(self):
        vars(self).update(dict.fromkeys(fields, 0))

    kinds = tuple(SimpleNamespace(typename=kind) for kind in fields.values())
    members = {"SLOT_TYPES": kinds, "get_fields_and_field_types": classmethod(lambda _: dict(fields)), "__init__": fill}
    return type(name, (), {**members, "__module__": "garden_msgs.action._dig"})


@pytest.mark.long
def test_the_classes_of_an_action_of_a_sourced_ros_2_are_found(monkeypatch):
    from robot_runner.ros.ros2_types import Ros2Types, message_class, service_class

    goal, result = generated("Dig_Goal", depth="double"), generated("Dig_Result", code="uint8")
    service = SimpleNamespace(Request=generated("Dig_SendGoal_Request", flag="boolean"), Response=None)
    module = ModuleType("garden_msgs.action")
    module.Dig = SimpleNamespace(
        Goal=goal, Result=result, Impl=SimpleNamespace(SendGoalService=service, FeedbackMessage=generated("M"))
    )
    monkeypatch.setitem(sys.modules, "garden_msgs", ModuleType("garden_msgs"))
    monkeypatch.setitem(sys.modules, "garden_msgs.action", module)
    assert message_class("garden_msgs/action/Dig_Goal") is goal
    assert service_class("garden_msgs/Dig_SendGoal") is service
    assert Ros2Types().shape("garden_msgs/Dig_Goal").fields[0].kind == "float64"
    assert Ros2Types().request("garden_msgs/Dig_SendGoal").names == ("flag",)
    with pytest.raises(LinkError, match="'garden_msgs' has no action type 'Dug'") as refused:
        message_class("garden_msgs/Dug_Goal")
    assert refused.value.fix == "Did you mean 'Dig'?"
