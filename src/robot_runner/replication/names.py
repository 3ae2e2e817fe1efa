"""The names of a package's files: the only place that knows them, as `storage.layout` does for an experiment's."""

from __future__ import annotations

import re

__all__ = [
    "CONTAINERFILE",
    "CRATE",
    "DATA_PACKAGE",
    "DESCRIPTION",
    "ENVIRONMENT",
    "FORMAT",
    "GENERATED",
    "README",
    "REQUIREMENTS",
    "SUMS",
    "WHEELS",
    "fault_of_name",
]

#: Version of the package's format; a newer one is refused by readers.
FORMAT = 1

CRATE = "ro-crate-metadata.json"
DESCRIPTION = "package.json"
SUMS = "SHA256SUMS"
README = "README.md"
CONTAINERFILE = "Containerfile"
DATA_PACKAGE = "datapackage.json"
ENVIRONMENT = "environment/environment.json"
REQUIREMENTS = "environment/requirements.txt"
WHEELS = "environment/wheels"

#: What packing makes anew; files of these names in an experiment's folder are not taken.
GENERATED = frozenset({CRATE, DESCRIPTION, SUMS, README, CONTAINERFILE, DATA_PACKAGE, ENVIRONMENT, REQUIREMENTS})

_DRIVE = re.compile(r"[A-Za-z]:")


def fault_of_name(name: str) -> str | None:
    r"""Return what is wrong with the name of a file in a package, or None.

    Example:
        >>> fault_of_name("runs/r_1/log.txt")
        >>> fault_of_name("../.bashrc"), fault_of_name("/etc/passwd")
        ('it leaves the folder', 'it is absolute')
    """
    if not name or not name.isprintable() or "\\" in name:
        return "it has characters that no name in a package may have"
    if name.startswith("/") or _DRIVE.match(name):
        return "it is absolute"
    parts = name.split("/")
    if ".." in parts:
        return "it leaves the folder"
    if "" in parts or "." in parts:
        return "it is not in its shortest form"
    return None
