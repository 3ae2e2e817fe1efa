"""Whether what a built-in profiler reads from can be reached, before anything is executed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.errors import Finding
from robot_runner.links.connect import SIMULATED

if TYPE_CHECKING:
    from robot_runner.plugins.api.plugin import Circumstances

__all__ = ["reach_findings"]

_FIX = f"Name it in the config: robot = {SIMULATED!r}. Or: --set robot={SIMULATED}."


def reach_findings(
    name: str, circumstances: Circumstances, *, kind: str, parameter: str, device: str | None
) -> list[Finding]:
    """Return what stands in the way of reading from a robot's own device, or from the `device` that was named.

    Args:
        name: the plugin's.
        circumstances: of the experiment.
        kind: what the device is, in words.
        parameter: the plugin's parameter that names the device.
        device: what that parameter is; None for the robot's own.
    """
    where = f"plugin {name}"
    if device is not None:
        problem = f"{parameter} is {device!r}, and this version reaches only the {kind} of the simulated robot"
        return [Finding.error(where, problem, f"Leave {parameter} out, and use --set robot={SIMULATED}.")]
    if circumstances.robot is None:
        return [Finding.error(where, f"it reads the robot's {kind}, and the experiment names no robot", _FIX)]
    return []
