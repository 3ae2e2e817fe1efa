"""The time that a meter of this machine lives by."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.errors import Finding
from robot_runner.events.clock import SystemClock
from robot_runner.links.connect import is_simulated, lives_by_simulation

if TYPE_CHECKING:
    from collections.abc import Mapping

    from robot_runner.events.clock import Clock
    from robot_runner.events.context import RobotRunnerContext
    from robot_runner.plugins.api.plugin import Circumstances

__all__ = ["clock_details", "machine_clock", "simulation_findings"]


def machine_clock(context: RobotRunnerContext) -> Clock:
    """Return the clock of what is measured on this machine: the run's, unless that is the clock of a simulation.

    A simulated mission of 95 s takes a few real ones, and a watt is a joule in a real second.
    """
    return SystemClock() if lives_by_simulation(context) else context.clock


def clock_details(context: RobotRunnerContext) -> Mapping[str, str]:
    """Return, for `quality.json`, whose clock the times in the raw data are of."""
    return {"clock": "machine" if lives_by_simulation(context) else "run"}


def simulation_findings(name: str, circumstances: Circumstances) -> list[Finding]:
    """Return a warning where a plugin measures this machine while the robot is a simulated one."""
    if not is_simulated(circumstances.robot):
        return []
    problem = "the robot is simulated, and this plugin measures the machine that simulates it"
    return [Finding.warning(f"plugin {name}", problem, "Do not take its values for the robot's.")]
