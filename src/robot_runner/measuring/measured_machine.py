"""What profilers of a machine need: its clock, whether it is the robot's, and whether it can be reached."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from robot_runner.core.errors import Finding
from robot_runner.core.events.context import Clock, RobotRunnerContext, SystemClock
from robot_runner.core.links.connect import SIMULATED, is_simulated, lives_by_simulation
from robot_runner.core.links.declared_host import LOCAL
from robot_runner.core.links.ssh_command import ssh_findings
from robot_runner.core.plugin import Plugin

_INSTALL = "Install it: pip install 'robot-runner[psutil]'."
_NAME_ONE = f"Name it: host='localhost' for this machine, or host='user@robot'. Or: --set robot={SIMULATED}."


@dataclass(frozen=True, slots=True)
class Computer:
    """A computer that a profiler measures, and how it is reached.

    Attributes:
        host: `localhost` for this machine, or as ssh takes it.
        ssh_config: a file to use instead of the user's ssh config.
        form: how it is sampled over ssh, as in `connect_host`.
        subjects: selectors of the processes to be measured (`process_selector`).
    """

    host: str = LOCAL
    ssh_config: Path | None = None
    form: str | None = None
    subjects: tuple[str, ...] = ()


#: The computer of profilers that read counters of the machine on which they are executed.
THIS_MACHINE = Computer()


@runtime_checkable
class MeasuresComputer(Protocol):
    """A profiler whose measures depend on everything that is executed on a computer."""

    @property
    def measured_computer(self) -> Computer | None:
        """The computer; None for one that is simulated."""


def concerned(plugins: Iterable[Plugin]) -> list[tuple[str, Computer]]:
    """Return which plugin measures which computer; where a factor sets a parameter, that may change in each run."""
    measured = [(plugin.name, plugin.measured_computer) for plugin in plugins if isinstance(plugin, MeasuresComputer)]
    return [(name, computer) for name, computer in measured if computer is not None]


def machine_clock(context: RobotRunnerContext) -> Clock:
    """Return the clock of what is measured on this machine: the run's, unless that is the clock of a simulation.

    A simulated mission of 95 s takes a few real ones, and a watt is a joule in a real second.
    """
    return SystemClock() if lives_by_simulation(context) else context.clock


def clock_details(context: RobotRunnerContext) -> Mapping[str, str]:
    """Return, for `quality.json`, which clock the times in the raw data are of."""
    return {"clock": "machine" if lives_by_simulation(context) else "run"}


def simulation_findings(plugin: str, robot: str | None) -> list[Finding]:
    """Return a warning where a plugin of this name measures this machine while the robot is a simulated one."""
    if not is_simulated(robot):
        return []
    problem = "the robot is simulated, and this plugin measures the machine that simulates it"
    return [Finding.warning(f"plugin {plugin}", problem, "Do not take its values for the robot's.")]


def host_findings(
    plugin: str, robot: str | None, *, host: str | None, ssh_config: Path | None, has_selection: bool
) -> list[Finding]:
    """Return what prevents the sampling of a computer.

    Args:
        plugin: the name of the plugin.
        robot: how the experiment's robot is reached.
        host: the computer; None for the on-board one of a simulated robot.
        ssh_config: a file to use instead of the user's ssh config.
        has_selection: whether single processes or cores are to be measured.

    Example:
        >>> host_findings("PsUtil", "simulated", host=None, ssh_config=None, has_selection=False)
        []
    """
    where = f"plugin {plugin}"
    if host is None and not is_simulated(robot):
        return [Finding.error(where, "the plugin measures a computer, and none is named", _NAME_ONE)]
    if host is None:
        problem = "the computer of a simulated robot does not report single processes or cores"
        return [Finding.error(where, problem, "Leave processes and cores out.")] if has_selection else []
    findings = simulation_findings(plugin, robot)
    if host != LOCAL:
        return [*findings, *ssh_findings(where, host, config=ssh_config)]
    if importlib.util.find_spec("psutil") is None:
        findings.append(Finding.error(where, "psutil, which samples this machine, cannot be imported", _INSTALL))
    return findings
