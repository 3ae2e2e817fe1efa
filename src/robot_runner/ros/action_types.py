"""What the types of an action are made of, in either generation of ROS, and the actions that are known without any ROS.

Sources of the definitions, whose fields are the same on the wire: `example_interfaces` and `nav2_msgs` (Apache 2.0),
`control_msgs`, `actionlib_tutorials`, `move_base_msgs` and `action_msgs` (BSD, Apache 2.0), as of each distribution's
branch. What ROS makes of an action: design.ros2.org/articles/actions.html, and `genaction.py` of actionlib_msgs.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from robot_runner.core.errors import LinkError
from robot_runner.ros.shapes import plain_type

#: What ROS 2 makes of an action beside its goal, result and feedback; no type of another kind has these endings,
#: because names of ROS 2 have no underscore.
_ROS2_PARTS = ("_Goal", "_Result", "_Feedback", "_SendGoal", "_GetResult", "_FeedbackMessage")
_HALVES = ("_Request", "_Response")
_SEPARATOR = re.compile(r"^[^\S\n]*---[^\S\n]*$", re.MULTILINE)
_UUID = "unique_identifier_msgs/UUID goal_id"


def split_definition(text: str) -> list[str]:
    r"""Return the messages of which the definition of a service or an action is made.

    Example:
        >>> split_definition("bool data\n---\nbool success")
        ['bool data', 'bool success']
    """
    return [piece.removeprefix("\n").removesuffix("\n") for piece in _SEPARATOR.split(text)]


def whole_action(part: str) -> str:
    """Return the action that a type of ROS 2 is a part of; the same name where it is of none.

    Example:
        >>> whole_action("nav2_msgs/NavigateToPose_SendGoal_Request"), whole_action("std_srvs/SetBool_Request")
        ('nav2_msgs/NavigateToPose', 'std_srvs/SetBool_Request')
    """
    bare = next((part.removesuffix(half) for half in _HALVES if part.endswith(half)), part)
    ends = ("_SendGoal", "_GetResult") if bare != part else _ROS2_PARTS
    return next((bare.removesuffix(end) for end in ends if bare.endswith(end)), part)


def is_action_part(name: str) -> bool:
    """Whether a type of ROS 2 is a part of an action.

    Example:
        >>> is_action_part("nav2_msgs/NavigateToPose_Goal"), is_action_part("nav_msgs/Odometry")
        (True, False)
    """
    return whole_action(name) != name


def action_parts(generation: int, name: str, text: str, *, where: str) -> dict[str, str]:
    r"""Return the definition of each message that ROS makes of an action, by its name as type stores spell it.

    Args:
        generation: of ROS, 1 or 2.
        name: of the action, such as `nav2_msgs/NavigateToPose`.
        text: its definition.
        where: the file that it comes from, for the error.

    Raises:
        LinkError: the definition has not three parts.

    Example:
        >>> parts = action_parts(2, "example_interfaces/Fibonacci", "int32 order\n---\n---\n", where="a file")
        >>> parts["example_interfaces/action/Fibonacci_Goal"].strip()
        'int32 order'
    """
    pieces = split_definition(text)
    if len(pieces) != 3:  # noqa: PLR2004  # goal, result and feedback
        raise LinkError(
            f"an action has two lines '---', not {len(pieces) - 1}",
            where=where,
            fix="Put '---' between goal and result, and between result and feedback.",
        )
    goal, result, feedback = pieces
    package, _, short = plain_type(name).partition("/")
    return (_parts1 if generation == 1 else _parts2)(package, short, goal, result, feedback)


def _parts1(package: str, short: str, goal: str, result: str, feedback: str) -> dict[str, str]:
    stem = f"{package}/msg/{short}"
    made = {"Goal": goal, "Result": result, "Feedback": feedback}
    heads = dict(zip(made, ("GoalID goal_id", "GoalStatus status", "GoalStatus status"), strict=True))
    return {f"{stem}{part}": text for part, text in made.items()} | {
        f"{stem}Action{part}": f"std_msgs/Header header\nactionlib_msgs/{head}\n{package}/{short}{part} {part.lower()}"
        for part, head in heads.items()
    }


def _parts2(package: str, short: str, goal: str, result: str, feedback: str) -> dict[str, str]:
    stem = f"{package}/action/{short}"
    return {
        f"{stem}_Goal": goal,
        f"{stem}_Result": result,
        f"{stem}_Feedback": feedback,
        f"{stem}_SendGoal_Request": f"{_UUID}\n{package}/{short}_Goal goal",
        f"{stem}_SendGoal_Response": "bool accepted\nbuiltin_interfaces/Time stamp",
        f"{stem}_GetResult_Request": _UUID,
        f"{stem}_GetResult_Response": f"int8 status\n{package}/{short}_Result result",
        f"{stem}_FeedbackMessage": f"{_UUID}\n{package}/{short}_Feedback feedback",
    }


_FIBONACCI = "int32 order\n---\nint32[] sequence\n---\nint32[] sequence\n"
#: Foxy's Nav2 does not tell it.
_ESTIMATE = "builtin_interfaces/Duration estimated_time_remaining\n"
_NAVIGATED = f"""geometry_msgs/PoseStamped current_pose
builtin_interfaces/Duration navigation_time
{_ESTIMATE}int16 number_of_recoveries
float32 distance_remaining
"""
#: What Nav2's results are made of: it changed with Iron, and with Jazzy.
_NAVIGATION_RESULTS = {"humble": "std_msgs/Empty result", "iron": "uint16 error_code"}
_LATEST_NAVIGATION_RESULT = "uint16 NONE=0\nuint16 error_code\nstring error_msg"
_TRAJECTORY_RESULT = """int32 SUCCESSFUL=0
int32 INVALID_GOAL=-1
int32 INVALID_JOINTS=-2
int32 OLD_HEADER_TIMESTAMP=-3
int32 PATH_TOLERANCE_VIOLATED=-4
int32 GOAL_TOLERANCE_VIOLATED=-5
int32 error_code
string error_string
"""
_TRAJECTORY_FEEDBACK = """std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint desired
trajectory_msgs/JointTrajectoryPoint actual
trajectory_msgs/JointTrajectoryPoint error
"""
_TRAJECTORY = f"""trajectory_msgs/JointTrajectory trajectory
control_msgs/JointTolerance[] path_tolerance
control_msgs/JointTolerance[] goal_tolerance
builtin_interfaces/Duration goal_time_tolerance
---
{_TRAJECTORY_RESULT}---
{_TRAJECTORY_FEEDBACK}"""
_MULTI_DOF_TRAJECTORY = f"""trajectory_msgs/JointTrajectory trajectory
trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory
control_msgs/JointTolerance[] path_tolerance
control_msgs/JointComponentTolerance[] component_path_tolerance
control_msgs/JointTolerance[] goal_tolerance
control_msgs/JointComponentTolerance[] component_goal_tolerance
builtin_interfaces/Duration goal_time_tolerance
---
{_TRAJECTORY_RESULT}---
{_TRAJECTORY_FEEDBACK}string[] multi_dof_joint_names
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_desired
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_actual
trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_error
"""
_COMPONENT_TOLERANCE = """uint16 X_AXIS=1
uint16 Y_AXIS=2
uint16 Z_AXIS=3
uint16 TRANSLATION=4
uint16 ROTATION=5
string joint_name
uint16 component
float64 position
float64 velocity
float64 acceleration
"""
_CANCEL_GOAL = """action_msgs/GoalInfo goal_info
---
int8 ERROR_NONE=0
int8 ERROR_REJECTED=1
int8 ERROR_UNKNOWN_GOAL_ID=2
int8 ERROR_GOAL_TERMINATED=3
int8 return_code
action_msgs/GoalInfo[] goals_canceling
"""
_TOLERANCE = "string name\nfloat64 position\nfloat64 velocity\nfloat64 acceleration\n"
_COMMON: Mapping[str, str] = {
    "control_msgs/JointTolerance.msg": _TOLERANCE,
    "example_interfaces/Fibonacci.action": _FIBONACCI,
}


def bundled_definitions(generation: int, distro: str) -> dict[str, str]:
    """Return the definitions that are known without any ROS, by name and suffix.

    Args:
        generation: of ROS, 1 or 2. ROS 1 has no Nav2; its actions are there for a simulated one.
        distro: the distribution's name.
    """
    result = _NAVIGATION_RESULTS["humble"] if distro in {"foxy", "galactic"} else _NAVIGATION_RESULTS.get(distro)
    navigated = _NAVIGATED.replace(_ESTIMATE, "") if distro == "foxy" else _NAVIGATED
    result = f"{result or _LATEST_NAVIGATION_RESULT}\n---\n{navigated}"
    found = {
        **_COMMON,
        "nav2_msgs/NavigateToPose.action": f"geometry_msgs/PoseStamped pose\nstring behavior_tree\n---\n{result}",
        "nav2_msgs/NavigateThroughPoses.action": "geometry_msgs/PoseStamped[] poses\nstring behavior_tree\n---\n"
        f"{result}int16 number_of_poses_remaining\n",
    }
    if generation == 1:
        return found | {
            "actionlib_tutorials/Fibonacci.action": _FIBONACCI,
            "move_base_msgs/MoveBase.action": "geometry_msgs/PoseStamped target_pose\n---\n---\n"
            "geometry_msgs/PoseStamped base_position\n",
            "control_msgs/FollowJointTrajectory.action": _TRAJECTORY,
        }
    is_old = distro == "foxy"
    return found | {
        "action_msgs/CancelGoal.srv": _CANCEL_GOAL,
        "control_msgs/JointComponentTolerance.msg": _COMPONENT_TOLERANCE,
        "control_msgs/FollowJointTrajectory.action": _TRAJECTORY if is_old else _MULTI_DOF_TRAJECTORY,
    }
