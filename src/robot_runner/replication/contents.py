"""The files of a package: their names, kinds and descriptions, and which of an experiment's folder go into it."""

from __future__ import annotations

import os
import re
import stat
from collections import Counter
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from robot_runner.core.errors import PackageError, did_you_mean
from robot_runner.core.events.measure import CONFIG_OWNER
from robot_runner.core.storage.input_files import read_index, shown_input
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.system_refusals import storage_error
from robot_runner.core.words import one_line

#: Version of the package's format; readers refuse a newer one.
FORMAT = 1

CRATE = "ro-crate-metadata.json"
DESCRIPTION = "package.json"
SUMS = "SHA256SUMS"
README = "README.md"
CONTAINERFILE = "Containerfile"
LICENCE = "LICENSE"
CITATION, ZENODO = "CITATION.cff", ".zenodo.json"
BADGES = "BADGES.md"
DATA_PACKAGE = "datapackage.json"
ENVIRONMENT = "environment/environment.json"
REQUIREMENTS = "environment/requirements.txt"
WHEELS = "environment/wheels"
MANIFEST, TABLE, SCHEMA = "manifest.json", "run_table.csv", "run_table.schema.json"
REGISTRATION = "registration.json"

#: Generated files; files of these names in an experiment's folder are left out. A licence's text there is packed.
GENERATED = frozenset(
    {CRATE, DESCRIPTION, SUMS, README, CONTAINERFILE, DATA_PACKAGE, ENVIRONMENT, REQUIREMENTS, CITATION, ZENODO, BADGES}
)

#: Files of these names hold secrets and nothing else.
_FORBIDDEN = re.compile(
    r"(?i)\.env(\..*)?|id_(rsa|dsa|ecdsa|ed25519)(_sk)?|known_hosts(\.old)?|authorized_keys"
    r"|.*\.(pem|key|p12|pfx|kdbx|ppk|jks|keystore|keytab|ovpn)|ssh_host_.*_key(\.pub)?"
    r"|\.(netrc|pypirc|npmrc|pgpass|htpasswd|git-credentials|my\.cnf|vault_pass.*)"
)

#: Descriptions of the files of a package, in the reader's order.
DESCRIBED = {
    TABLE: "all runs in their order: status, time stamps of the events, treatments, measures",
    SCHEMA: "type, unit, meaning and owner of each column of the run table (Table Schema)",
    "runs/": "the raw data and the log of each run",
    "revisions/": "the commits that were compared, as repositories, and what was printed while they were built",
    "subjects/": "the output of software under test that went on through all runs",
    "config/": "the config, the local modules that it imports and the files that it reads, as executed",
    "earlier_configs/": "the config as it was executed before it was changed, numbered in order",
    "earlier_attempts/": "the raw data and the log of attempts that were executed again",
    "report/": "the report, with its tables and figures, and what computes its numbers again",
    MANIFEST: "the circumstances: host, versions, seed, what was set by hand",
    REGISTRATION: "what was registered before the first run: plan, design, seed, power, with a checksum",
    "journal.jsonl": "the history of the experiment, one record a line",
    REQUIREMENTS: "the Python packages that the experiment needs",
    ENVIRONMENT: "the environment: all Python packages with versions and fingerprints, host, ROS",
    CONTAINERFILE: "the recipe of a container image",
    DATA_PACKAGE: "a description of the run table (Frictionless Data Package)",
    README: "how to replicate the experiment, and what is in the package",
    LICENCE: "under which terms it may be used",
    CITATION: "how to cite it (Citation File Format), which GitHub and reference managers read",
    ZENODO: "what Zenodo asks of an upload",
    BADGES: "what the package has of what ACM's artifact badges ask for",
    DESCRIPTION: "how the package was made, and what is not in it",
    CRATE: "a description of everything (RO-Crate)",
    SUMS: "the SHA-256 of each file; `sha256sum -c SHA256SUMS` checks them without Robot Runner",
}


def config_of(manifest: Mapping[str, Any]) -> str:
    """Return the name of an experiment's config in a package."""
    return f"config/{(manifest.get('config') or {}).get('file')}"


_DRIVE = re.compile(r"[A-Za-z]:")
#: A path has at most 4096 bytes on Linux, and a name 255, both in UTF-8.
_DEEPEST, _LONGEST_PART, _LONGEST = 60, 240, 3500


def fault_of_name(name: str) -> str | None:
    r"""Return what is wrong with the name of a file in a package, or None.

    Example:
        >>> fault_of_name("runs/r_1/log.txt")
        >>> fault_of_name("../.bashrc"), fault_of_name("/etc/passwd")
        ("the file's name leaves the folder", "the file's name is absolute")
    """
    if not name or not name.isprintable() or "\\" in name:
        return "the file's name has characters that no name in a package may have"
    if name.startswith("/") or _DRIVE.match(name):
        return "the file's name is absolute"
    parts = name.split("/")
    longest = max(len(part.encode()) for part in parts)
    if len(parts) > _DEEPEST or longest > _LONGEST_PART or len(name.encode()) > _LONGEST:
        return "the file's name is longer, or in more folders, than a disk takes"
    if ".." in parts:
        return "the file's name leaves the folder"
    if "" in parts or "." in parts:
        return "the file's name is not in its shortest form"
    return None


#: PRONOM, the registry of file formats of the UK's National Archives.
_PRONOM = "https://www.nationalarchives.gov.uk/PRONOM/"


class MediaType(NamedTuple):
    """One kind of file: its media type (RFC 6838), its title in words, and the page that describes the format."""

    name: str
    title: str
    page: str


_BINARY = "application/octet-stream"
_ANY = MediaType(_BINARY, "Binary data", "https://www.rfc-editor.org/rfc/rfc2046#section-4.5.1")
_TEXT = MediaType("text/plain", "Plain text", f"{_PRONOM}x-fmt/111")
_YAML = MediaType("application/yaml", "YAML", f"{_PRONOM}fmt/818")
_BY_SUFFIX = {
    ".cff": MediaType("application/yaml", "Citation File Format", "https://citation-file-format.github.io"),
    ".csv": MediaType("text/csv", "Comma separated values", f"{_PRONOM}x-fmt/18"),
    ".html": MediaType("text/html", "HTML 5", f"{_PRONOM}fmt/471"),
    ".ipynb": MediaType("application/x-ipynb+json", "Jupyter notebook", "https://nbformat.readthedocs.io"),
    ".jpg": MediaType("image/jpeg", "JPEG", "https://www.w3.org/Graphics/JPEG/"),
    ".json": MediaType("application/json", "JSON", f"{_PRONOM}fmt/817"),
    ".jsonl": MediaType("application/jsonl", "JSON lines", "https://jsonlines.org"),
    ".log": _TEXT,
    ".mcap": MediaType(_BINARY, "MCAP", "https://mcap.dev/spec"),
    ".md": MediaType("text/markdown", "Markdown", f"{_PRONOM}fmt/1149"),
    ".parquet": MediaType("application/vnd.apache.parquet", "Apache Parquet", f"{_PRONOM}fmt/1843"),
    ".pdf": MediaType("application/pdf", "PDF", f"{_PRONOM}fmt/276"),
    ".png": MediaType("image/png", "PNG", f"{_PRONOM}fmt/11"),
    ".py": MediaType("text/x-python", "Python", f"{_PRONOM}fmt/938"),
    ".r": MediaType("text/x-r", "R", "https://www.r-project.org"),
    ".svg": MediaType("image/svg+xml", "SVG", f"{_PRONOM}fmt/92"),
    ".tex": MediaType("application/x-tex", "LaTeX", "https://www.latex-project.org"),
    ".txt": _TEXT,
    ".whl": MediaType("application/zip", "Python wheel", "https://peps.python.org/pep-0427/"),
    ".xlsx": MediaType(
        "application/vnd.openxmlformats-officedocument.spreadsheetml.sheet",
        "Office Open XML workbook",
        f"{_PRONOM}fmt/214",
    ),
    ".yaml": _YAML,
    ".yml": _YAML,
}


def media_type_of(name: str) -> MediaType:
    """Return the kind of a file, by its name.

    Example:
        >>> media_type_of("runs/r_1/PsUtil/samples.csv").name
        'text/csv'
    """
    otherwise = _TEXT if name in {CONTAINERFILE, SUMS, LICENCE} else _ANY
    return _BY_SUFFIX.get(PurePosixPath(name).suffix.casefold(), otherwise)


def folder_of(name: str, run_folders: Container[str]) -> str:
    """Return the described folder of a file: its run's folder, or else its top-level folder; it ends with `/`.

    Example:
        >>> folder_of("runs/r_1/PsUtil/samples.csv", {"runs/r_1/"}), folder_of("runs/note.txt", set())
        ('runs/r_1/', 'runs/')
    """
    parts = name.split("/")
    run = "/".join(parts[:2]) + "/"
    return run if len(parts) > 2 and run in run_folders else f"{parts[0]}/"  # noqa: PLR2004 - folder, run, file


def folders_of(names: Iterable[str], run_folders: Container[str]) -> set[str]:
    """Return the folders that a package describes: top-level folders and run folders; they end with `/`."""
    inside = [name for name in names if "/" in name]
    return {f"{name.partition('/')[0]}/" for name in inside} | {folder_of(name, run_folders) for name in inside}


ALL, NONE = "all", "none"


_RUN_FILES = frozenset({"log.txt", "refused.jsonl"})
#: Transient files of an execution: locks, requests, partly written files. The patterns do not match other files.
_TRANSIENT = re.compile(
    r"\.(?:lock|control|pause|stop|outliving|(?:alive|standing_by|to_make_safe)(?:_\d+)?|probe(?:-[0-9a-f]{16}){1,2})"
    r"|current_log(?:_\d+)?\.txt|\..*\.tmp"
)
#: Files that file managers leave in folders.
DESKTOP_FILES = frozenset({".DS_Store", "Thumbs.db"})
_BYTE_CODE = "__pycache__"
#: Partial copies of repositories and configs from a killed execution, and files of executions beside its runs.
_HALF_MADE = re.compile(r"\.(?:.*\.git|config)\.tmp|\.aside-[a-z0-9_]{8}")
_WORKING_FOLDERS = frozenset({".git", ".ipynb_checkpoints", ".venv"})


@dataclass(frozen=True, slots=True)
class PackedFile:
    """A file of the experiment's folder that goes into the package.

    Attributes:
        name: in the package: its path below the folder, with `/`.
        size: of the original file, bytes.
    """

    name: str
    path: Path
    size: int


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A file or folder that is left out of the package, and why; both are printable."""

    name: str
    why: str


@dataclass(frozen=True, slots=True)
class Contents:
    """The files of a package, sorted by name, and those that are left out."""

    files: tuple[PackedFile, ...]
    left_out: tuple[LeftOut, ...]


def choose_contents(folder: ExperimentFolder, run_ids: Sequence[str], raw: Sequence[str] = (ALL,)) -> Contents:
    """Walk an experiment's folder; no link is followed.

    Args:
        folder: the experiment's folder.
        run_ids: its runs.
        raw: the plugins whose raw data is packed: `all`, `none`, or their names.

    Raises:
        PackageError: a named plugin has no raw data.
        StorageError: the folder cannot be read.
    """
    files: list[PackedFile] = []
    left_out: list[LeftOut] = []
    runs, counts, unwanted = set(run_ids), Counter[str](), Counter[str]()
    is_package = (folder.root / DESCRIPTION).exists()
    for name, path, status in _walk(folder.root):
        owner = _run_owner(folder, runs, name)
        counts.update([owner] if owner else ())
        if path.name in DESKTOP_FILES or _TRANSIENT.fullmatch(path.name) or (is_package and name in GENERATED):
            continue
        if why := _fault(name, status):
            left_out.append(LeftOut(one_line(name), why))
        elif owner and not {ALL, owner} & set(raw):
            unwanted[owner] += 1
        else:
            files.append(PackedFile(name, path, status.st_size))
    for name in raw:
        if name not in (known := [ALL, NONE, *counts]):
            raise PackageError(f"no run has raw data of {name!r}", where="--raw", fix=did_you_mean(name, known))
    left_out += [
        LeftOut(each["at"], f"a file that the experiment reads, too large for a package: {shown_input(each)}")
        for each in read_index(folder.config)
        if each["kept"] is None
    ]
    left_out += [LeftOut(f"raw data of {owner}", f"not asked for ({count} files)") for owner, count in unwanted.items()]
    return Contents(tuple(sorted(files, key=lambda file: file.name)), tuple(left_out))


def _run_owner(folder: ExperimentFolder, runs: set[str], name: str) -> str | None:
    """Return the plugin whose raw data a file is, by its path in the experiment's folder; None for other files."""
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


def _walk(root: Path) -> Iterator[tuple[str, Path, os.stat_result]]:
    """Yield the relative name, the path and the status of each file, link, and skipped folder."""

    def fail(error: OSError) -> None:
        raise storage_error(root, "read", error) from error

    for folder, folders, names in os.walk(root, onerror=fail):
        wanted = sorted(each for each in folders if each != _BYTE_CODE and not _HALF_MADE.fullmatch(each))
        closed = [name for name in wanted if name in _WORKING_FOLDERS or Path(folder, name).is_symlink()]
        folders[:] = [name for name in wanted if name not in closed and Path(folder, name) != root / WHEELS]
        for path in sorted(Path(folder, name) for name in (*names, *closed)):
            yield path.relative_to(root).as_posix(), path, path.lstat()


def _fault(name: str, status: os.stat_result) -> str | None:
    """Return why a file cannot go into a package."""
    if stat.S_ISLNK(status.st_mode):
        return "a symbolic link"
    if stat.S_ISDIR(status.st_mode):
        return "a folder that a version control, a notebook or an environment works in"
    if not stat.S_ISREG(status.st_mode):
        return "not a regular file"
    if name in GENERATED:
        return "the package has a file of its own there; rename it, and it is packed"
    if _FORBIDDEN.fullmatch(name.rpartition("/")[2]):
        return "files of this name hold keys or passwords"
    return fault_of_name(name)
