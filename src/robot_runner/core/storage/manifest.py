"""The circumstances of an experiment: host, versions, seed, and what was set by hand."""

from __future__ import annotations

import json
import os
import platform
import sys
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import StorageError
from robot_runner.core.secret_names import without_environment_secrets
from robot_runner.core.storage.declared_shapes import shape_findings
from robot_runner.core.storage.file_shapes import Manifest
from robot_runner.core.storage.guarded_files import DamagedFileError, MissingFileError, read_json, replace
from robot_runner.core.storage.system_packages import describe_system, installed_system_packages

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["FORMAT", "describe_host", "describe_software", "is_damaged", "read_manifest", "write_manifest"]

#: What is compared with the config, or reproduces it: a treatment may be called as a password is.
_COMPARED = frozenset(
    {"experiment_name", "config", "design", "seed", "analysis", "registration", "repeat_until", "plugins"}
)
#: Version of the experiment folder's format; a newer one is refused by readers.
FORMAT = 1
_RESTORE = "Restore it from a backup."


def describe_host() -> dict[str, Any]:
    """Return what this machine is: system, processor, cores, memory (bytes), and how its frequency is governed."""
    return {
        "system": platform.system(),
        "release": platform.release(),
        "machine": platform.machine(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "memory_bytes": _memory_bytes(),
        "governor": _governor(),
    }


def describe_software() -> dict[str, Any]:
    """Return the versions of Python, Robot Runner and the system, and of every package of Python and of the system."""
    return {
        "python": platform.python_version(),
        "implementation": sys.implementation.name,
        "robot_runner": version("robot-runner"),
        "packages": _packages(),
        "system": describe_system(),
        "system_packages": installed_system_packages(),
    }


def write_manifest(path: Path, manifest: Mapping[str, Any]) -> None:
    """Write the manifest, whole or not at all; secrets of the environment are hidden, but for what resuming compares.

    Raises:
        StorageError: the folder cannot be written.
    """
    hidden = {name: value if name in _COMPARED else _without_secrets(value) for name, value in manifest.items()}
    text = json.dumps({"format": FORMAT, **hidden}, indent=2, ensure_ascii=False, default=str) + "\n"
    replace(path, text)


def _without_secrets(value: Any) -> Any:
    match value:
        case str():
            return without_environment_secrets(value)
        case dict():
            return {name: _without_secrets(each) for name, each in value.items()}
        case list() | tuple():
            return [_without_secrets(each) for each in value]
    return value


def is_damaged(path: Path) -> bool:
    """Return whether a file that is there cannot be any version's manifest: empty, torn, or something else."""
    try:
        manifest = read_json(path)
    except DamagedFileError:
        return True
    except StorageError:
        return False
    return not isinstance(manifest, dict) or not isinstance(manifest.get("format"), int)


def read_manifest(path: Path) -> dict[str, Any]:
    """Return the manifest of an experiment folder.

    Raises:
        StorageError: there is none, it does not parse, its format is newer than this version knows, or it is not as a
            manifest is.
    """
    try:
        manifest = read_json(path)
    except MissingFileError as error:
        raise StorageError(
            "there is no experiment here", where=str(path.parent), fix="Name the folder that holds manifest.json."
        ) from error
    except DamagedFileError as error:
        raise StorageError(f"the manifest cannot be read: {error.problem}", where=error.where, fix=error.fix) from error
    if not isinstance(manifest, dict) or not isinstance(manifest.get("format"), int):
        raise StorageError("the file is no manifest of an experiment", where=str(path), fix=_RESTORE)
    if manifest["format"] > FORMAT:
        raise StorageError(
            f"the manifest has format {manifest['format']}, newer than {FORMAT}, which this version knows",
            where=str(path),
            fix="Update robot-runner.",
        )
    if findings := shape_findings(str(path), "manifest of an experiment", manifest, Manifest, _RESTORE):
        raise StorageError.of_findings(findings)
    return manifest


def _packages() -> dict[str, str]:
    # The names of the folders tell name and version; reading each package's metadata would take a hundred times longer.
    found: dict[str, str] = {}
    for folder in reversed([Path(entry or ".") for entry in sys.path]):
        for info in folder.glob("*.dist-info"):
            name, _, release = info.name.removesuffix(".dist-info").partition("-")
            found[name] = release
    return dict(sorted(found.items(), key=lambda item: item[0].lower()))


def _processor() -> str:
    # platform.processor() is empty on Linux; a Raspberry Pi names its board instead of its processor.
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    named = {name.strip(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
    return named.get("model name") or named.get("Model") or platform.processor()


def _governor() -> str | None:
    """Return the policy by which Linux sets the processor's frequency; several where its cores differ."""
    found = set()
    for path in Path("/sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor"):
        with suppress(OSError):
            found.add(path.read_text(encoding="ascii").strip())
    return ", ".join(sorted(found)) or None


def _memory_bytes() -> int | None:
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (ValueError, OSError):
        return None
