"""What tests of profilers share: runs that are rehearsed, and what was found in them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.core.events.context import SystemClock
from robot_runner.plugins import Circumstances
from robot_runner.testing import make_context, rehearse

if TYPE_CHECKING:
    from pathlib import Path

    from robot_runner.core.errors import Finding
    from robot_runner.core.events.context import RobotRunnerContext
    from robot_runner.plugins import Plugin
    from robot_runner.testing import FakeClock


class InRealTime:
    """Of a contract suite: runs go by this machine's clock, as a program that is started does."""

    def make_context(self, folder: Path, plugin: Plugin, *, run_seed: int = 1) -> RobotRunnerContext:
        return make_context(folder, plugin, robot=None, clock=SystemClock(), run_seed=run_seed)


def measured(folder: Path, plugin: Plugin, clock: FakeClock, seconds: float) -> RobotRunnerContext:
    """Return the context of a run whose mission took so long."""
    context = make_context(folder, plugin, robot=None, clock=clock)
    rehearse(context, plugin, mission=lambda: clock.sleep(seconds))
    return context


def problems(context: RobotRunnerContext) -> list[str]:
    return [finding.problem for finding in context.broker.findings]


def only_finding(plugin: Plugin) -> Finding:
    (finding,) = plugin.check(Circumstances())
    assert finding.is_error
    return finding
