"""By what a simulated robot on a real graph is told from a real one, so that its values are labelled."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.links.graph_names import full_name

if TYPE_CHECKING:
    from robot_runner.links.robot import RobotLink

__all__ = ["SIMULATION_TOPIC", "is_simulation"]

#: Published once, by who puts a simulated robot on a graph, in the robot's namespace.
SIMULATION_TOPIC = "robot_runner/simulation"
_CLOCK = "/clock"


def is_simulation(link: RobotLink, namespace: str = "") -> bool:
    """Whether there is a simulated robot behind a link: the embedded one, or one on a graph that shows a sign of it.

    The signs are the mark of `robot-runner simulate`, and a `/clock`: a graph with real robots needs none.

    Raises:
        LinkError: the graph cannot be reached.

    Example:
        >>> from robot_runner.testing import FakeClock, FakeRobotLink
        >>> is_simulation(FakeRobotLink(FakeClock(), is_simulated=True))
        True
    """
    if link.is_simulated:
        return True
    topics = link.topics()
    return _CLOCK in topics or full_name(namespace, SIMULATION_TOPIC) in topics
