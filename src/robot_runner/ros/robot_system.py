"""What all systems that operate a robot on a graph have alike: what they claim, and that there must be a robot."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

from robot_runner.core.errors import Finding, PluginError
from robot_runner.core.links.connect import is_simulated, join_beforehand
from robot_runner.core.plugin import System
from robot_runner.ros.sent_messages import StandardTypes, misfits

if TYPE_CHECKING:
    from collections.abc import Iterable

    from robot_runner.core.events.context import RobotRunnerContext
    from robot_runner.core.plugin import Circumstances


def check_numbers(where: str, *, may_be_zero: bool = False, **parameters: object) -> None:
    """See that parameters are finite numbers above 0, or not below it.

    Raises:
        PluginError: one is not.

    Example:
        >>> check_numbers("Waypoints", speed=0.2, timeout_s=5)
        >>> check_numbers("Waypoints", speed="0.2")
        Traceback (most recent call last):
            ...
        robot_runner.core.errors.PluginError: Waypoints: speed is '0.2' → Give a number above 0.
    """
    for name, value in parameters.items():
        number = value if isinstance(value, int | float) and not isinstance(value, bool) else -1
        if not 0 <= number < math.inf or (number == 0 and not may_be_zero):
            fix = "Give a number from 0 up." if may_be_zero else "Give a number above 0."
            raise PluginError(f"{name} is {value!r}", where=where, fix=fix)


class RobotSystem(System):
    """A system that operates the experiment's robot, whichever it is."""

    #: What it does, for the finding that no robot is named.
    does: ClassVar[str] = "operates a robot"
    #: A robot that it can operate, for the same.
    for_example: ClassVar[str] = "simulated"
    #: Of its robot on the graph, where there are several.
    namespace: str = ""

    def claims(self, robot: str | None) -> Iterable[str]:
        """Return what a run needs for itself: nothing but the robot, which the experiment names."""
        del robot
        return ()

    def stand_by(self, context: RobotRunnerContext) -> None:
        """Join the graph, so that `make_safe` is heard at once."""
        join_beforehand(context, namespace=self.namespace)

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return what stands in the way: no robot; on the embedded one, messages that do not follow their types.

        On a graph they are compared with its own definitions, when it is looked at.
        """
        if is_simulated(circumstances.robot) and StandardTypes.is_known():
            for need in self.required_graph(circumstances):
                yield from misfits(StandardTypes(), need, f"plugin {self.name}")
        if circumstances.robot is None:
            yield Finding.error(
                f"plugin {self.name}",
                f"the plugin {self.does}, and the experiment names none",
                f"Name it in the config: robot = '{self.for_example}'. Or: --set robot={self.for_example}.",
            )
