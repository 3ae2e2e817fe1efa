"""A robot that is reached outside of a run: by a node of one's own, or in a notebook."""

from __future__ import annotations

from contextlib import closing, contextmanager
from typing import TYPE_CHECKING

from robot_runner.core.events.resources import Resources
from robot_runner.core.links.connect import resolved_robot
from robot_runner.core.links.graph_names import namespace_prefix

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.core.events.context import Clock
    from robot_runner.core.links.robot import RobotLink

__all__ = ["open_robot"]


@contextmanager
def open_robot(robot: str, *, namespace: str = "", seed: int = 1) -> Iterator[tuple[RobotLink, Clock]]:
    """Reach a robot outside of a run, as a node of your own does, and leave it when the block ends.

    Args:
        robot: as `robot` in a config has it, such as `dds:domain=7,clock=graph`.
        namespace: which robot, where there are several.
        seed: of a simulated one.

    Yields:
        the link, and the clock that the robot lives by.

    Raises:
        LinkError: it cannot be reached.

    Example:
        >>> with open_robot("simulated") as (link, clock):
        ...     link.wait_for("odom", "nav_msgs/Odometry")["child_frame_id"]
        'base_footprint'
    """
    kind, name = resolved_robot(robot)
    with closing(Resources()) as resources:
        clock = kind.open_clock(name, resources=resources, seed=seed)
        within = f"{namespace_prefix(name.namespace)}{namespace_prefix(namespace)}" if name.namespace else namespace
        link = kind.open_robot(name, resources=resources, clock=clock, seed=seed, namespace=within)
        resources.open("robot", lambda: link)
        yield link, clock
