"""What is installed of the system beside Python: its release, its packages, and the programs that are in them."""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

__all__ = ["describe_system", "described_programs", "installed_system_packages"]

#: Where Debian and its descendants (Ubuntu, Raspberry Pi OS) note what is installed: deb822 paragraphs.
_STATUS = Path("/var/lib/dpkg/status")
#: A paragraph says in its first fields whether its package is installed.
_HEAD = 400
_DEADLINE_S = 20.0


def describe_system() -> dict[str, str]:
    """Return which system this is and of which release, as its `os-release` file says; nothing where it has none."""
    try:
        release = platform.freedesktop_os_release()
    except OSError:
        return {}
    named = {"id": "ID", "version": "VERSION_ID", "name": "PRETTY_NAME"}
    return {key: release[name] for key, name in named.items() if name in release}


def installed_system_packages(status: Path = _STATUS) -> dict[str, str]:
    """Return the versions of the system's packages, by name; nothing on a system that has no `dpkg`.

    Args:
        status: where `dpkg` notes what is installed; read here, as starting `dpkg-query` takes ten times as long.
    """
    try:
        paragraphs = status.read_bytes().split(b"\n\n")
    except OSError:
        return {}
    found = {}
    for paragraph in paragraphs:
        if b" installed\n" in paragraph[:_HEAD]:
            name, version = (_field(paragraph, field) for field in (b"Package", b"Version"))
            if name and version:
                found[name] = version
    return dict(sorted(found.items()))


def _field(paragraph: bytes, name: bytes) -> str:
    _, found, rest = (b"\n" + paragraph).partition(b"\n" + name + b": ")
    return rest.partition(b"\n")[0].decode("utf-8", "replace") if found else ""


def described_programs(paths: Iterable[str]) -> dict[str, dict[str, str | None]]:
    """Return what each program is: the package that it is of, its version, and the SHA-256 of its file.

    No program is executed for it: one that measures might begin to.

    Args:
        paths: absolute, as the programs were called.
    """
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
    # Packages that are older than the merger of /bin with /usr/bin list the shorter path.
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
