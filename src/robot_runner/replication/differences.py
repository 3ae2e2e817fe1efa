"""Compare an experiment's environment with this machine, without executing any of its code."""

from __future__ import annotations

import platform
import shlex
import shutil
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from robot_runner.core.errors import Finding
from robot_runner.core.plugin import described_circumstances
from robot_runner.core.storage.manifest import describe_host, describe_system, described_programs
from robot_runner.replication.contents import WHEELS
from robot_runner.replication.distributions import (
    InstalledDistribution,
    canonical,
    distributions_in,
    installed_distributions,
    spec_of,
)
from robot_runner.replication.environment import importers, modules_to_install

_GIBIBYTE = 1 << 30
_SAME_MEMORY = 0.02  # the memory that the kernel reserves varies between boots
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
    """A fact or a package that differs between the experiment's environment and this machine.

    Attributes:
        what: the name of the fact or the package.
        original: its original value or version; `-` if there was none.
        here: its value or version here; `-` if there is none.
        is_package: whether it is a Python package.
        imported_by: the parts of the experiment that import the package: the robot's link, plugins, the config.
    """

    what: str
    original: str
    here: str
    is_package: bool = False
    imported_by: tuple[str, ...] = ()


def differing_environment(
    environment: Mapping[str, Any], *, robot: str | None, manifest: Mapping[str, Any] | None = None
) -> list[Difference]:
    """Compare an environment with this machine.

    Args:
        environment: the package's.
        robot: the robot's connection.
        manifest: the experiment's: the source of `imported_by` if the environment does not have it.
    """
    facts = [
        ("Robot", environment.get("robot"), robot),
        ("Python", environment.get("python"), platform.python_version()),
        *_host_facts(environment.get("host") or {}),
        *_release(environment.get("system")),
        *_programs(environment.get("programs")),
    ]
    differing = [Difference(what, _shown(there), _shown(here)) for what, there, here in facts if there != here]
    differing += _ros(environment.get("ros"), described_circumstances().get("ros"))
    return [*differing, *differing_packages(environment, installed_distributions(), manifest)]


def ranked(differing: Iterable[Difference]) -> tuple[list[Difference], list[Difference]]:
    """Return the differences that can matter, the most important first, and the packages that are not imported.

    The order: robot and Python, packages that the robot's link imports (the simulator), packages that plugins and
    config import, the machine.
    """
    telling = [each for each in differing if not each.is_package or each.imported_by]
    rest = [each for each in differing if each.is_package and not each.imported_by]
    return sorted(telling, key=_rank), sorted(rest, key=lambda each: each.what)


def _rank(difference: Difference) -> tuple[int, int, int, str]:
    if not difference.is_package:
        # Sorting is stable, so that the facts of the machine keep their order.
        return (0 if difference.what in {"Robot", "Python"} else 2, 0, 0, "")
    is_of_robot = any(name.startswith("robot ") for name in difference.imported_by)
    return 1, int(not is_of_robot), -len(difference.imported_by), difference.what


def differing_packages(
    environment: Mapping[str, Any],
    installed: Mapping[str, InstalledDistribution],
    manifest: Mapping[str, Any] | None = None,
) -> list[Difference]:
    """Compare the packages that an experiment needs with those that are installed.

    If the versions are equal, the fingerprints of the installed files are compared, if both are known.
    """
    differing = []
    known_importers = cache(lambda: importers(manifest or {}))  # slow, and rarely needed
    needed = {name: each for name, each in (environment.get("packages") or {}).items() if each.get("is_needed")}
    for name, recorded in needed.items():
        here, version, known = installed.get(name), str(recorded["version"]), recorded.get("fingerprint")
        shown = here.version if here else "-"
        if here and shown == version and known and not here.is_editable and here.fingerprint not in {known, None}:
            shown = f"{version}, with other files"
        if shown != version:
            by = _names(recorded.get("imported_by")) or known_importers().get(name, ())
            differing.append(Difference(name, version, shown, is_package=True, imported_by=by))
    return differing


def _names(recorded: object) -> tuple[str, ...]:
    """Return recorded names if they are a list: a package from elsewhere may hold any value."""
    return tuple(map(str, recorded)) if isinstance(recorded, list) else ()


def remaining_differences(folder: Path, environment: Mapping[str, Any]) -> list[Difference]:
    """Return the differences between the packages in a virtual environment and those that it was made from."""
    places = [str(path) for path in folder.glob("lib/python*/site-packages")]
    return differing_packages(environment, distributions_in(places))


def _host_facts(host: Mapping[str, Any]) -> Iterator[tuple[str, Any, Any]]:
    here = describe_host()
    for key, what in _HOST_FACTS.items():
        if key in host:
            yield what, host[key], here[key]
    there, ours = host.get("memory_bytes"), here["memory_bytes"]
    if there and ours and abs(there - ours) > _SAME_MEMORY * there:
        yield "Memory", f"{there / _GIBIBYTE:.1f} GiB", f"{ours / _GIBIBYTE:.1f} GiB"


def _release(there: object) -> Iterator[tuple[str, Any, Any]]:
    """Yield the release of the system, if it is known for both machines."""
    named = there.get("name") if isinstance(there, dict) else None
    ours = describe_system().get("name")
    if named and ours:
        yield "Release", named, ours


def _programs(there: object) -> Iterator[tuple[str, Any, Any]]:
    """Yield the called programs with their versions there and here.

    The recorded paths are not trusted: a program here is found by its name.
    """
    recorded = {
        Path(str(path)).name: each
        for path, each in (there.items() if isinstance(there, dict) else ())
        if isinstance(each, dict)
    }
    found = {name: shutil.which(name) for name in recorded}
    described = described_programs(path for path in found.values() if path)
    for name, each in recorded.items():
        here = described.get(found[name] or "", {})
        if each.get("sha256") != here.get("sha256"):
            yield f"Program {name}", _version(each), _version(here)


def _version(program: Mapping[str, Any]) -> str:
    digest = str(program.get("sha256") or "")[:12]
    return str(program.get("version") or (f"SHA-256 {digest}" if digest else "-"))


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


def missing_modules(root: Path, manifest: Mapping[str, Any]) -> list[Finding]:
    """Return errors for the plugins and modules that an unpacked experiment needs and that are not installed.

    A module that the config imports only in a `try` or an `if` is not one of them: it may do without.

    Raises:
        OSError: a file of the config cannot be read.
    """
    config = root / "config"
    local = {part.removesuffix(".py") for path in config.rglob("*.py") for part in path.relative_to(config).parts}
    findings, seen = [], set[str]()
    for plugin in manifest.get("plugins", ()):
        module, _, kind = str(plugin.get("class", "")).partition(":")
        top, package, release = module.partition(".")[0], plugin.get("package"), plugin.get("version")
        if top not in {*local, "robot_runner_config"} and spec_of(top) is None:
            fix = _installing(root, str(package), str(release)) if package else f"Install what brings {module}."
            problem = f"{kind}, of {package or module}, is not installed"
            findings.append(Finding.error(f"plugin {plugin.get('name')}", problem, fix))
        seen.add(top)
    for name in sorted(modules_to_install(config) - seen):
        if spec_of(name) is None:
            fix = "Install the package that brings it, or have the environment made: --environment venv"
            findings.append(Finding.error("config", f"the config imports {name}, which is not installed", fix))
    return findings


def _installing(root: Path, package: str, release: str) -> str:
    """Return how to install a package: what was made from a folder of the original's machine is in no index."""
    for wheel in sorted((root / WHEELS).glob("*.whl")):
        name, _, tags = wheel.name.partition("-")
        if (canonical(name), tags.partition("-")[0]) == (canonical(package), release):
            return f"Install it from the package: pip install {shlex.quote(str(wheel))}"
    return f"Install it: pip install {package}=={release}"
