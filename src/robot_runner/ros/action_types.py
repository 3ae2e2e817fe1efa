"""The types that ROS derives from an action (design.ros2.org/articles/actions.html, actionlib_msgs' `genaction.py`)."""

from __future__ import annotations

import re

from robot_runner.core.errors import LinkError
from robot_runner.ros.shapes import plain_type

#: The endings of the types that ROS 2 derives from an action; no other type has these, as names of ROS 2 have no
#: underscore.
_ROS2_PARTS = ("_Goal", "_Result", "_Feedback", "_SendGoal", "_GetResult", "_FeedbackMessage")
_HALVES = ("_Request", "_Response")
_SEPARATOR = re.compile(r"^[^\S\n]*---[^\S\n]*$", re.MULTILINE)
_CAPITALISED_WORD, _WORD_AFTER_LETTERS = re.compile("(.)([A-Z][a-z]+)"), re.compile("([a-z0-9])([A-Z])")
_UUID = "unique_identifier_msgs/UUID goal_id"


def split_definition(text: str) -> list[str]:
    r"""Return the message definitions in the definition of a service or an action.

    Example:
        >>> split_definition("bool data\n---\nbool success")
        ['bool data', 'bool success']
    """
    return [piece.removeprefix("\n").removesuffix("\n") for piece in _SEPARATOR.split(text)]


def whole_action(part: str) -> str:
    """Return the action of which a type of ROS 2 is a part; the same name where there is none.

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


def python_name(part: str) -> str:
    """Return the name of a part of an action by which Python imports it: where rosidl writes the class.

    The module is that of the action; only some parts can be imported from the package of all actions.
    Source: `convert_camel_case_to_lower_case_underscore` of rosidl_pycommon.

    Example:
        >>> python_name("nav2_msgs/NavigateToPose_FeedbackMessage")
        'nav2_msgs/action._navigate_to_pose/NavigateToPose_FeedbackMessage'
    """
    package, _, action = whole_action(part).partition("/")
    module = _WORD_AFTER_LETTERS.sub(r"\1_\2", _CAPITALISED_WORD.sub(r"\1_\2", action)).lower()
    return f"{package}/action._{module}/{part.partition('/')[2]}"


def action_parts(generation: int, name: str, text: str, *, where: str) -> dict[str, str]:
    r"""Return the definition of each message that ROS 1 or 2 derives from an action, by its name in type stores.

    The action is given by its name, such as `nav2_msgs/NavigateToPose`, and its definition; `where` is its file.

    Raises:
        LinkError: the definition does not have three parts.

    Example:
        >>> parts = action_parts(2, "example_interfaces/Fibonacci", "int32 order\n---\n---\n", where="a file")
        >>> parts["example_interfaces/action/Fibonacci_Goal"].strip()
        'int32 order'
    """
    pieces = split_definition(text)
    if len(pieces) != 3:  # noqa: PLR2004  # goal, result and feedback
        fix = "Put '---' between goal and result, and between result and feedback."
        raise LinkError(f"an action has two lines '---', not {len(pieces) - 1}", where=where, fix=fix)
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
