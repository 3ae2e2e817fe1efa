"""What all systems that operate a robot on a graph have alike: what they claim, and that there must be a robot."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from robot_runner.core.errors import Finding
from robot_runner.core.plugin import System

if TYPE_CHECKING:
    from collections.abc import Iterable

    from robot_runner.core.plugin import Circumstances

__all__ = ["RobotSystem"]


class RobotSystem(System):
    """A system that operates the experiment's robot, whichever it is."""

    #: What it does, for the finding that no robot is named.
    does: ClassVar[str] = "operates a robot"
    #: A robot that it can operate, for the same.
    for_example: ClassVar[str] = "simulated"

    def claims(self, robot: str | None) -> Iterable[str]:
        """Return what a run needs for itself: nothing but the robot, which the experiment names."""
        del robot
        return ()

    def check(self, circumstances: Circumstances) -> Iterable[Finding]:
        """Return what stands in the way: no robot."""
        if circumstances.robot is None:
            yield Finding.error(
                f"plugin {self.name}",
                f"the plugin {self.does}, and the experiment names none",
                f"Name it in the config: robot = '{self.for_example}'. Or: --set robot={self.for_example}.",
            )
