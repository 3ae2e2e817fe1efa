"""Whether a computer can be sampled, before anything is executed."""

from __future__ import annotations

import importlib.util
from typing import TYPE_CHECKING

from robot_runner.errors import Finding
from robot_runner.links.connect import SIMULATED, is_simulated
from robot_runner.links.host import LOCAL
from robot_runner.links.ssh_command import ssh_findings
from robot_runner.plugins.profilers.machine import simulation_findings

if TYPE_CHECKING:
    from pathlib import Path

    from robot_runner.plugins.api.plugin import Circumstances

__all__ = ["host_findings"]

_INSTALL = "Install it: pip install 'robot-runner[psutil]'."
_NAME_ONE = f"Name it: host='localhost' for this machine, or host='user@robot'. Or: --set robot={SIMULATED}."


def host_findings(
    plugin: str, circumstances: Circumstances, *, host: str | None, ssh_config: Path | None, has_selection: bool
) -> list[Finding]:
    """Return what stands in the way of sampling a computer.

    Args:
        plugin: the name of the plugin that asks.
        circumstances: of the experiment.
        host: the computer; None for the on-board one of a simulated robot.
        ssh_config: a file to take the place of the user's ssh config.
        has_selection: whether single processes or cores are asked for.

    Example:
        >>> from robot_runner.plugins.api.plugin import Circumstances
        >>> host_findings("PsUtil", Circumstances("simulated"), host=None, ssh_config=None, has_selection=False)
        []
    """
    where = f"plugin {plugin}"
    if host is None:
        return _on_board(where, circumstances, has_selection=has_selection)
    findings = simulation_findings(plugin, circumstances)
    if host != LOCAL:
        return [*findings, *ssh_findings(where, host, config=ssh_config)]
    if importlib.util.find_spec("psutil") is None:
        findings.append(Finding.error(where, "psutil, which samples this machine, cannot be imported", _INSTALL))
    return findings


def _on_board(where: str, circumstances: Circumstances, *, has_selection: bool) -> list[Finding]:
    if not is_simulated(circumstances.robot):
        return [Finding.error(where, "it measures a computer, and none is named", _NAME_ONE)]
    if has_selection:
        problem = "the computer of a simulated robot does not tell of single processes or cores"
        return [Finding.error(where, problem, "Leave processes and cores out.")]
    return []
