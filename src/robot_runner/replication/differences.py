"""What differs between the environment of a package and this machine."""

from __future__ import annotations

import platform
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from robot_runner.links.ros_packages import describe_ros
from robot_runner.replication.distributions import installed_distributions
from robot_runner.storage.manifest import describe_host

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from robot_runner.replication.distributions import InstalledDistribution

__all__ = ["Difference", "differing_environment", "differing_packages"]

_GIBIBYTE = 1 << 30
_SAME_MEMORY = 0.02  # what the kernel keeps for itself differs from boot to boot
_HOST_FACTS = {
    "processor": "Processor",
    "machine": "Architecture",
    "cores": "Cores",
    "system": "System",
    "release": "Kernel",
    "governor": "Governor",
}


@dataclass(frozen=True, slots=True)
class Difference:
    """Something that the package was executed with otherwise than here.

    Attributes:
        what: a fact, or a package.
        original: as it was; `-` where there was none.
        here: as it is; `-` where there is none.
        is_package: whether it is about a Python package.
    """

    what: str
    original: str
    here: str
    is_package: bool = False


def differing_environment(environment: Mapping[str, Any], *, robot: str | None) -> list[Difference]:
    """Compare an environment with this machine.

    Args:
        environment: as the package has it.
        robot: how the robot is to be reached.
    """
    facts = [
        ("Robot", environment.get("robot"), robot),
        ("Python", environment.get("python"), platform.python_version()),
        *_host_facts(environment.get("host") or {}),
    ]
    differing = [Difference(what, _shown(there), _shown(here)) for what, there, here in facts if there != here]
    differing += _ros(environment.get("ros"), describe_ros())
    return [*differing, *differing_packages(environment, installed_distributions())]


def differing_packages(
    environment: Mapping[str, Any], installed: Mapping[str, InstalledDistribution]
) -> list[Difference]:
    """Compare the packages that an experiment needs with those that are installed.

    Where the version is the same, the fingerprints of the installed files are compared, if both are known.
    """
    differing = []
    for name, recorded in (environment.get("packages") or {}).items():
        if not recorded.get("is_needed"):
            continue
        here = installed.get(name)
        if here is None:
            differing.append(Difference(name, str(recorded["version"]), "-", is_package=True))
        elif here.version != recorded["version"]:
            differing.append(Difference(name, str(recorded["version"]), here.version, is_package=True))
        elif not here.is_editable and (known := recorded.get("fingerprint")) and here.fingerprint not in {known, None}:
            version = str(recorded["version"])
            differing.append(Difference(name, version, f"{version}, with other files", is_package=True))
    return differing


def _host_facts(host: Mapping[str, Any]) -> Iterator[tuple[str, Any, Any]]:
    here = describe_host()
    for key, what in _HOST_FACTS.items():
        if key in host:
            yield what, host[key], here[key]
    there, ours = host.get("memory_bytes"), here["memory_bytes"]
    if there and ours and abs(there - ours) > _SAME_MEMORY * there:
        yield "Memory", f"{there / _GIBIBYTE:.1f} GiB", f"{ours / _GIBIBYTE:.1f} GiB"


def _ros(there: Mapping[str, Any] | None, here: Mapping[str, Any] | None) -> Iterator[Difference]:
    named = [f"{ros['version']} {ros.get('distro') or ''}".strip() if ros else "-" for ros in (there, here)]
    if named[0] != named[1]:
        yield Difference("ROS", named[0], named[1])
        return
    original, ours = ((ros or {}).get("packages") or {} for ros in (there, here))
    for name in sorted(original):
        if original[name] != ours.get(name):
            yield Difference(f"ROS package {name}", original[name], ours.get(name, "-"))


def _shown(value: object) -> str:
    return "-" if value in (None, "") else str(value)
