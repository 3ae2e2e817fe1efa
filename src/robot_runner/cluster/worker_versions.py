"""Which versions a worker has, compared with those of the machine that starts the experiment, when the worker joins.

Policy: a worker is used where these are equal: Python's implementation and its first two numbers; Robot Runner's
version and its source (two checkouts of one version differ); and the version of each package that announces anything
to Robot Runner (a plugin, a link), or that the values of simulated runs come from. Anything else may differ, as it does
between the computers of one lab. The manifest has the versions of the machine that starts the experiment.
"""

from __future__ import annotations

import hashlib
import platform
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, distributions, version
from pathlib import Path
from typing import Any

from robot_runner.core.errors import Finding

_GROUPS = "robot_runner."
#: The physics of the embedded simulation, and what it computes with: its last digit may differ between versions.
_BEHIND_SIMULATED_VALUES = ("mujoco", "numpy")


@cache
def described_versions() -> dict[str, Any]:
    """Return the versions of this machine that matter for runs, as plain data."""
    return {
        "python": ".".join(platform.python_version_tuple()[:2]),
        "implementation": sys.implementation.name,
        "robot_runner": version("robot-runner"),
        "source": _digest_of_source(),
        "packages": dict(sorted(_packages())),
    }


def compared(here: Mapping[str, Any], there: Mapping[str, Any], worker: str) -> list[Finding]:
    """Return a finding for each difference that keeps a worker from being used.

    `here` is what `described_versions` returns where the experiment is started, `there` what it returns on the
    `worker` of this name.

    Example:
        >>> here = {"python": "3.11", "packages": {"numpy": "2.1"}}
        >>> [each.problem for each in compared(here, {"python": "3.13", "packages": {}}, "node7")]
        ['Python is 3.13 on the worker, and 3.11 here', 'numpy is not installed on the worker, and 2.1 here']
    """
    where = f"worker {worker}"
    names = {"python": "Python", "implementation": "Python's implementation", "robot_runner": "Robot Runner"}
    pairs = [(name, here.get(key), there.get(key)) for key, name in names.items()]
    packages, others = here.get("packages", {}), there.get("packages", {})
    pairs += [(name, packages.get(name), others.get(name)) for name in sorted({*packages, *others})]
    findings = [
        Finding.warning(where, f"{name} is {_shown(is_there)} on the worker, and {_shown(is_here)} here", _FIX)
        for name, is_here, is_there in pairs
        if is_here != is_there
    ]
    if not findings and here.get("source") != there.get("source"):
        problem = "the worker has the same version of Robot Runner with another source"
        findings = [Finding.warning(where, problem, _FIX)]
    return findings


_FIX = "Install the same there, and start the worker again; it executes no runs like this."


def _shown(value: str | None) -> str:
    return "not installed" if value is None else value


def _packages() -> Iterator[tuple[str, str]]:
    for each in distributions():
        if each.name != "robot-runner" and any(point.group.startswith(_GROUPS) for point in each.entry_points):
            yield each.name, each.version
    for name in _BEHIND_SIMULATED_VALUES:
        try:
            yield name, version(name)
        except PackageNotFoundError:  # then nothing is simulated here
            continue


def _digest_of_source() -> str:
    root = Path(__file__).parents[1]  # all of Robot Runner
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()
