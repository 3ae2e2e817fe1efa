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
from robot_runner.core.storage.guarded_files import DamagedFileError, MissingFileError, read_json, replace

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["FORMAT", "describe_host", "describe_software", "is_damaged", "read_manifest", "write_manifest"]

#: Version of the experiment folder's format; a newer one is refused by readers.
FORMAT = 1


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
    """Return the versions of Python, of Robot Runner, and of every installed package."""
    return {
        "python": platform.python_version(),
        "implementation": sys.implementation.name,
        "robot_runner": version("robot-runner"),
        "packages": _packages(),
    }


def write_manifest(path: Path, manifest: Mapping[str, Any]) -> None:
    """Write the manifest, whole or not at all.

    Raises:
        StorageError: the folder cannot be written.
    """
    text = json.dumps({"format": FORMAT, **manifest}, indent=2, ensure_ascii=False, default=str) + "\n"
    replace(path, text)


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
        StorageError: there is none, it does not parse, or its format is newer than this version knows.
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
        raise StorageError("the file is no manifest of an experiment", where=str(path), fix="Restore it from a backup.")
    if manifest["format"] > FORMAT:
        raise StorageError(
            f"the manifest has format {manifest['format']}, newer than {FORMAT}, which this version knows",
            where=str(path),
            fix="Update robot-runner.",
        )
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
