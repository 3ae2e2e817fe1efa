"""`manifest.json`: reading and writing it, and describing host, system, installed packages and programs for it."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from robot_runner.core.errors import StorageError
from robot_runner.core.secret_names import without_secrets
from robot_runner.core.storage.declared_shapes import finite
from robot_runner.core.storage.file_shapes import Manifest
from robot_runner.core.storage.guarded_files import (
    DamagedFileError,
    MissingFileError,
    read_declared,
    read_json,
    replace,
)
from robot_runner.core.words import counted

#: Keys whose values are compared with the config, and so are not masked: a treatment may be equal to a password.
_COMPARED = frozenset(
    {"experiment_name", "config", "design", "seed", "analysis", "registration", "repeat_until", "plugins"}
)
#: Version of the experiment folder's format; a newer one is refused by readers.
FORMAT = 1
_RESTORE = "Restore it from a backup."


def describe_host() -> dict[str, Any]:
    """Return system, processor, cores, memory (bytes) and frequency governor of this machine."""
    return {
        "system": platform.system(),
        "release": platform.release(),
        "machine": platform.machine(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "memory_bytes": _memory_bytes(),
        "governor": _governor(),
    }


def host_in_words(host: Mapping[str, Any]) -> str:
    """Return in words what measures of a machine depend on, by facts as `describe_host` returns them.

    Memory is left out: the number of bytes changes with each kernel.

    Example:
        >>> host_in_words({"processor": "Cortex-A72", "cores": 4, "system": "Linux", "release": "6.1"})
        'Cortex-A72, 4 cores, Linux 6.1'
    """
    cores, governor = host.get("cores"), host.get("governor")
    system = " ".join(str(host[part]) for part in ("system", "release") if host.get(part))
    parts = (
        str(host.get("processor") or host.get("machine") or ""),
        counted(cores, "core") if isinstance(cores, int) else "",
        system,
        f"governor {governor}" if governor else "",
    )
    return ", ".join(filter(None, parts))


def describe_software() -> dict[str, Any]:
    """Return the versions of Python, Robot Runner, the system, and of all packages of Python and of the system."""
    return {
        "python": platform.python_version(),
        "implementation": sys.implementation.name,
        "robot_runner": version("robot-runner"),
        "packages": installed_packages(),
        "system": describe_system(),
        "system_packages": installed_system_packages(),
    }


def write_manifest(path: Path, manifest: Mapping[str, Any]) -> None:
    """Write the manifest, whole or not at all; secrets of the environment are masked, except in `_COMPARED`.

    Raises:
        StorageError: the folder cannot be written.
    """
    hidden = {name: value if name in _COMPARED else without_secrets(value) for name, value in manifest.items()}
    replace(path, json.dumps(finite({"format": FORMAT, **hidden}), indent=2, ensure_ascii=False, default=str) + "\n")


def is_damaged(path: Path) -> bool:
    """Return whether an existing file can be the manifest of no version: it is empty, torn, or something else."""
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
        StorageError: there is none, it does not parse, its format is newer than this version knows, or its shape is
            not that of a manifest.
    """
    try:
        manifest: dict[str, Any] = read_declared(path, "manifest", Manifest, newest=FORMAT, fix=_RESTORE)
    except MissingFileError as error:
        fix = "Name the folder that holds manifest.json."
        raise StorageError("there is no experiment here", where=str(path.parent), fix=fix) from error
    return manifest


def last_execution(manifest: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the last execution in a manifest; empty where there was none."""
    found: Mapping[str, Any] = (manifest.get("executions") or [{}])[-1]
    return found


def installed_packages() -> dict[str, str]:
    """Return the versions of the packages of Python, by name."""
    # From the names of the folders; reading each package's metadata would take a hundred times longer.
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
    """Return the CPU frequency governor of Linux; several where cores differ."""
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


#: The installed packages of Debian and its derivatives (Ubuntu, Raspberry Pi OS): deb822 paragraphs.
_STATUS = Path("/var/lib/dpkg/status")
#: The states (dpkg(1)) of packages whose files are there: others than the first are those of packages that a running
#: or broken installation is yet to configure.
_IS_THERE = re.compile(rb"(?m)^Status: \S+ \S+ (installed|triggers-pending|triggers-awaited|half-configured|unpacked)$")
#: How much of a paragraph is searched for the fields that are needed, which come first.
_HEAD = 400
_DEADLINE_S = 20.0


def describe_system() -> dict[str, str]:
    """Return the name and release of this system, from its `os-release` file; nothing if it has none."""
    try:
        release = platform.freedesktop_os_release()
    except OSError:
        return {}
    named = {"id": "ID", "version": "VERSION_ID", "name": "PRETTY_NAME"}
    return {key: release[name] for key, name in named.items() if name in release}


def installed_system_packages(status: Path = _STATUS) -> dict[str, str]:
    """Return the versions of the system's packages, by name; nothing on a system that has no `dpkg`.

    Args:
        status: the database of `dpkg`; read directly, as starting `dpkg-query` takes ten times as long.
    """
    try:
        at = status.stat()
        return {**_system_packages(status, at.st_mtime_ns, at.st_size)}
    except OSError:
        return {}


@lru_cache(maxsize=1)
def _system_packages(status: Path, _changed: int, _size: int) -> dict[str, str]:
    """Read the database once for all experiments of this process, as long as it stays as it is."""
    found = {}
    for paragraph in status.read_bytes().split(b"\n\n"):
        if _IS_THERE.search(paragraph[:_HEAD]):
            name, version = (_field(paragraph, field) for field in (b"Package", b"Version"))
            if name and version:
                found[name] = version
    return dict(sorted(found.items()))


def _field(paragraph: bytes, name: bytes) -> str:
    _, found, rest = (b"\n" + paragraph).partition(b"\n" + name + b": ")
    return rest.partition(b"\n")[0].decode("utf-8", "replace") if found else ""


def described_programs(paths: Iterable[str]) -> dict[str, dict[str, str | None]]:
    """Return package, version and SHA-256 of each program, by its absolute path, without executing it."""
    real = {path: os.path.realpath(path) for path in paths}
    owners = _owners(set(real.values()))
    versions = installed_system_packages() if owners else {}
    return {
        path: {
            "package": owners.get(file),
            "version": versions.get(owners.get(file, "")),
            "sha256": _sha256(Path(file)),
        }
        for path, file in sorted(real.items())
    }


def _owners(files: set[str]) -> dict[str, str]:
    """Return the package of each file that `dpkg` knows."""
    # Packages from before the merger of /bin with /usr/bin list the shorter path.
    listed = {path: file for file in files for path in (file, file.removeprefix("/usr"))}
    if not listed:
        return {}
    try:
        told = subprocess.run(  # noqa: S603 - an argument list
            ["dpkg-query", "-S", *sorted(listed)],  # noqa: S607 - wherever it is
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=_DEADLINE_S,
            check=False,  # it fails where it does not know one of them
        ).stdout
    except (OSError, subprocess.TimeoutExpired):
        return {}
    found = {}
    for line in told.splitlines():
        owner, _, path = line.rpartition(": ")
        if path in listed and not owner.startswith("diversion "):
            found[listed[path]] = owner.partition(",")[0].partition(":")[0]
    return found


def _sha256(path: Path) -> str | None:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None
