"""The checks of this package that are announced by entry points: for each experiment, whatever its robot.

They are loaded at each start of the program: so what only a robot of ROS needs is imported where there is one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from robot_runner.core.links.connect import is_simulated

if TYPE_CHECKING:
    from robot_runner.core.config.parameters import Parameters
    from robot_runner.core.errors import Finding
    from robot_runner.core.plugin import Plugin


def check_ros(where: str, parameters: Parameters, plugins: Sequence[Plugin]) -> Iterator[Finding]:
    """Yield what is missing of the ROS that an experiment needs; the embedded robot needs none."""
    if is_simulated(parameters.robot) or (parameters.robot is None and parameters.required_ros_version is None):
        return
    from robot_runner.ros.required_ros import ros_findings  # noqa: PLC0415 - as said above

    yield from ros_findings(where, parameters, plugins)


def check_left_settings(where: str, parameters: Parameters, plugins: Sequence[Plugin]) -> Iterator[Finding]:
    """Yield that nodes of the robot still have settings of a killed run; the embedded robot ends with its run."""
    if parameters.robot is None or is_simulated(parameters.robot):
        return
    from robot_runner.ros.restored_settings import left_findings  # noqa: PLC0415 - as said above

    yield from left_findings(where, parameters.robot, plugins)
