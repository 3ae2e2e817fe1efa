"""Which files of an experiment's folder go into its package, and which stay behind."""

from __future__ import annotations

import os
import re
import stat
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from robot_runner.core.errors import PackageError, did_you_mean
from robot_runner.core.storage.safe_write import storage_error
from robot_runner.replication.redaction import forbidden_name

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from robot_runner.core.storage.layout import ExperimentFolder

__all__ = [
    "ALL",
    "CONFIG_OWNER",
    "CONTAINERFILE",
    "CRATE",
    "DATA_PACKAGE",
    "DESCRIPTION",
    "ENVIRONMENT",
    "FORMAT",
    "GENERATED",
    "NONE",
    "README",
    "REQUIREMENTS",
    "SUMS",
    "WHEELS",
    "Contents",
    "LeftOut",
    "MediaType",
    "PackedFile",
    "choose_contents",
    "fault_of_name",
    "media_type_of",
    "run_owner",
]


# The names of a package's files: the only place that knows them, as `storage.layout` does for an experiment's.

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


# What kind of file each is: its media type, and where the format is described (PRONOM where it has an entry).

_PRONOM = "https://www.nationalarchives.gov.uk/PRONOM/"


@dataclass(frozen=True, slots=True)
class MediaType:
    """One kind of file.

    Attributes:
        name: the media type (RFC 6838).
        title: in words.
        page: where the format is described.

    Example:
        >>> media_type_of("runs/r_1/PsUtil/samples.csv").name
        'text/csv'
    """

    name: str
    title: str
    page: str


_ANY = MediaType("application/octet-stream", "Binary data", "https://www.rfc-editor.org/rfc/rfc2046#section-4.5.1")
_TEXT = MediaType("text/plain", "Plain text", f"{_PRONOM}x-fmt/111")
_BY_SUFFIX = {
    ".csv": MediaType("text/csv", "Comma separated values", f"{_PRONOM}x-fmt/18"),
    ".html": MediaType("text/html", "HTML 5", f"{_PRONOM}fmt/471"),
    ".json": MediaType("application/json", "JSON", f"{_PRONOM}fmt/817"),
    ".jsonl": MediaType("application/jsonl", "JSON lines", "https://jsonlines.org"),
    ".log": _TEXT,
    ".mcap": MediaType("application/octet-stream", "MCAP", "https://mcap.dev/spec"),
    ".md": MediaType("text/markdown", "Markdown", f"{_PRONOM}fmt/1149"),
    ".parquet": MediaType("application/vnd.apache.parquet", "Apache Parquet", f"{_PRONOM}fmt/1843"),
    ".pdf": MediaType("application/pdf", "PDF", f"{_PRONOM}fmt/276"),
    ".png": MediaType("image/png", "PNG", f"{_PRONOM}fmt/11"),
    ".py": MediaType("text/x-python", "Python", f"{_PRONOM}fmt/938"),
    ".svg": MediaType("image/svg+xml", "SVG", f"{_PRONOM}fmt/92"),
    ".txt": _TEXT,
    ".whl": MediaType("application/zip", "Python wheel", "https://peps.python.org/pep-0427/"),
    ".yaml": MediaType("application/yaml", "YAML", f"{_PRONOM}fmt/818"),
    ".yml": MediaType("application/yaml", "YAML", f"{_PRONOM}fmt/818"),
}
_BY_NAME = {"Containerfile": _TEXT, "SHA256SUMS": _TEXT}


def media_type_of(name: str) -> MediaType:
    """Return the kind of a file, by its name."""
    path = PurePosixPath(name)
    return _BY_NAME.get(path.name) or _BY_SUFFIX.get(path.suffix.casefold(), _ANY)


ALL, NONE = "all", "none"

#: Whose raw data are those that lie in a run's folder itself.
CONFIG_OWNER = "config"

_RUN_FILES = frozenset({"log.txt", "refused.jsonl"})
_PASSING = re.compile(r"\.lock|\.control|current_log\.txt|.*\.tmp|.*\.pyc|\.DS_Store|Thumbs\.db|.*~")
_PASSING_FOLDERS = frozenset({"__pycache__", ".git", ".ipynb_checkpoints", ".venv"})


@dataclass(frozen=True, slots=True)
class PackedFile:
    """A file of the experiment's folder that goes into the package.

    Attributes:
        name: in the package: its path below the folder, with `/`.
        size: in bytes, as it lies in the folder.
    """

    name: str
    path: Path
    size: int


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Something that does not go into the package, and why."""

    name: str
    why: str


@dataclass(frozen=True, slots=True)
class Contents:
    """What goes into a package and what does not, each sorted by name.

    Attributes:
        owners: the plugins that left raw data, `config` among them.
    """

    files: tuple[PackedFile, ...]
    left_out: tuple[LeftOut, ...]
    owners: tuple[str, ...]


def choose_contents(folder: ExperimentFolder, run_ids: Sequence[str], raw: Sequence[str] = (ALL,)) -> Contents:
    """Walk an experiment's folder; no link is followed.

    Args:
        folder: the experiment's folder.
        run_ids: its runs.
        raw: whose raw data to take: `all`, `none`, or names of plugins.

    Raises:
        PackageError: a plugin that is named left no raw data.
        StorageError: the folder cannot be read.
    """
    files: list[PackedFile] = []
    left_out: list[LeftOut] = []
    owners: dict[str, None] = {}
    runs = set(run_ids)
    untaken: dict[str, int] = {}
    for name, path, status in _walk(folder.root, left_out):
        owner = run_owner(folder, runs, name)
        if owner is not None:
            owners[owner] = None
        why = _reason(name, status)
        if why:
            left_out.append(LeftOut(name, why))
        elif why is None and owner is not None and not _is_wanted(owner, raw):
            untaken[owner] = untaken.get(owner, 0) + 1
        elif why is None:
            files.append(PackedFile(name, path, status.st_size))
    _refuse_unknown(raw, owners)
    left_out += [LeftOut(f"raw data of {owner}", f"not asked for ({count} files)") for owner, count in untaken.items()]
    return Contents(tuple(sorted(files, key=lambda file: file.name)), tuple(left_out), tuple(sorted(owners)))


def run_owner(folder: ExperimentFolder, runs: set[str], name: str) -> str | None:
    """Return whose raw data a file is, by its name below the experiment's folder; None where it is none."""
    parts = name.split("/")
    if parts[0] == folder.earlier_attempts.name and len(parts) > 3:  # noqa: PLR2004 - run, attempt, file
        parts = parts[2:]
    elif folder.runs_name and parts[0] == folder.runs_name and len(parts) > 2:  # noqa: PLR2004 - run, file
        parts = parts[1:]
    elif folder.runs_name or parts[0] not in runs:
        return None
    if len(parts) == 2:  # noqa: PLR2004 - a file in the run's folder itself
        return None if parts[1] in _RUN_FILES else CONFIG_OWNER
    return parts[1]


def _walk(root: Path, left_out: list[LeftOut]) -> Iterator[tuple[str, Path, os.stat_result]]:
    def fail(error: OSError) -> None:
        raise storage_error(root, "read", error) from error

    for folder, folders, names in _walked(root, fail):
        relative = folder.relative_to(root).as_posix()
        for name in list(folders):
            inner = name if relative == "." else f"{relative}/{name}"
            if name in _PASSING_FOLDERS or inner == WHEELS:
                folders.remove(name)
            elif (folder / name).is_symlink():
                folders.remove(name)
                left_out.append(LeftOut(inner, "it is a symbolic link"))
        folders.sort()
        for name in sorted(names):
            path = folder / name
            yield (name if relative == "." else f"{relative}/{name}"), path, path.lstat()


def _walked(root: Path, fail: Callable[[OSError], None]) -> Iterator[tuple[Path, list[str], list[str]]]:
    for folder, folders, names in os.walk(root, onerror=fail):
        yield Path(folder), folders, names


def _reason(name: str, status: os.stat_result) -> str | None:
    """Return why a file is left out; an empty text where nobody wants to know, None where it goes in."""
    last = name.rpartition("/")[2]
    if name in GENERATED or _PASSING.fullmatch(last):
        return ""
    if stat.S_ISLNK(status.st_mode):
        return "it is a symbolic link"
    if not stat.S_ISREG(status.st_mode):
        return "it is no regular file"
    if forbidden_name(last):
        return "files of this name hold keys or passwords"
    return fault_of_name(name)


def _is_wanted(owner: str, raw: Sequence[str]) -> bool:
    return ALL in raw or owner in raw


def _refuse_unknown(raw: Sequence[str], owners: dict[str, None]) -> None:
    for name in raw:
        if name not in {ALL, NONE, *owners}:
            fix = did_you_mean(name, [ALL, NONE, *owners])
            raise PackageError(f"no run has raw data of {name!r}", where="--raw", fix=fix)
