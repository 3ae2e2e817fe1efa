"""The environment that an experiment was executed in: recorded, and made again in a folder of its own.

What was installed when the experiment was executed is in its manifest: names and versions. Where the same versions
are installed while it is packed, more is known: where each came from, a fingerprint of its files, and for what was
installed from a local folder, its wheel. Nothing is looked up on a network here, so the hash of a file that came from
an index is not known, because installers do not keep it; `index_hashes` asks for it.
"""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import packages_distributions
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import Finding, PackageError
from robot_runner.core.storage.safe_write import storage_error
from robot_runner.replication.contents import REQUIREMENTS, WHEELS
from robot_runner.replication.distributions import canonical, closure, installed_distributions

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from robot_runner.replication.distributions import InstalledDistribution

__all__ = [
    "PLATFORMS",
    "PackageRecord",
    "RecordedEnvironment",
    "imported_names",
    "make_environment",
    "record_environment",
]

_OUR_NAME = "robot-runner"
_DEADLINE_S = 3600.0
_SHOWN_LINES = 8
_GLIBC = ("manylinux2014", *(f"manylinux_2_{minor}" for minor in (17, 24, 26, 27, 28, 31, 34, 35, 36)))
#: Where else an experiment is replicated, as pip calls it: the oldest first, whose files fit most machines.
PLATFORMS: Mapping[str, tuple[str, ...]] = {
    "Linux on x86-64": tuple(f"{each}_x86_64" for each in _GLIBC),
    "Linux on aarch64": tuple(f"{each}_aarch64" for each in _GLIBC),
    "macOS on arm64": ("macosx_14_0_arm64",),
}
#: Which distributions bring each top-level module.
_owners = cache(packages_distributions)


@dataclass(frozen=True, slots=True)
class PackageRecord:
    """One installed package.

    Attributes:
        is_needed: whether the experiment needs it, itself or by way of others.
        source: `index` (or an installer that left no note), `local`, `url` or `version control`; None where the package
            is not installed in this version while packing, so that nothing but its version is known.
        requirement: the line for an installer.
        sha256: of the file that it is installed from, where that is known.
        fingerprint: of its installed files; None where that is not known.
    """

    name: str
    version: str
    is_needed: bool
    source: str | None
    requirement: str
    sha256: str | None = None
    fingerprint: str | None = None


@dataclass(frozen=True, slots=True)
class RecordedEnvironment:
    """What an experiment was executed in.

    Attributes:
        packages: what was installed, by canonical name, sorted.
        local: the distributions among those needed that only this machine has.
        findings: what is not known of it.
        index_hashes: of the files that a package index has, by canonical name; empty where none was asked.
    """

    manifest: Mapping[str, Any]
    packages: Mapping[str, PackageRecord]
    local: tuple[InstalledDistribution, ...] = ()
    findings: tuple[Finding, ...] = field(default=())
    index_hashes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def python(self) -> str:
        """The version of Python."""
        return str(self.manifest.get("software", {}).get("python", ""))

    @property
    def needed(self) -> tuple[PackageRecord, ...]:
        """The packages that the experiment needs, by name."""
        return tuple(each for each in self.packages.values() if each.is_needed)

    def without_hash(self, wheels: Mapping[str, str]) -> tuple[PackageRecord, ...]:
        """Return the packages of whose files no hash is known, by name."""
        return tuple(each for each in self.needed if not self._hashes(each, wheels))

    def _hashes(self, record: PackageRecord, wheels: Mapping[str, str]) -> tuple[str, ...]:
        name = canonical(record.name)
        known = wheels.get(name) or record.sha256
        return (known,) if known else self.index_hashes.get(name, ())

    def requirements(self, wheels: Mapping[str, str]) -> str:
        """Return the text of a requirements file.

        Args:
            wheels: the hash of each wheel that the package holds, by the canonical name of its distribution.
        """
        return "".join(f"{line}\n" for line in self._lines(wheels))

    def _lines(self, wheels: Mapping[str, str]) -> Iterator[str]:
        # One hash makes pip demand a hash of every package.
        is_complete = bool(self.needed) and not self.without_hash(wheels)
        yield f"# The packages that the experiment needs, as they were installed (Python {self.python})."
        if not is_complete:
            yield "# Not every file's hash is known, so that none can be demanded: those known are comments."
        if self.index_hashes:
            yield f"# The hashes are of the index's files for this Python, on: {', '.join(PLATFORMS)}."
        yield "# environment.json has a fingerprint of the installed files of each."
        if wheels:
            yield "# Some are in the folder wheels: pip install --find-links wheels -r requirements.txt"
        for each in self.needed:
            known = "".join(f" --hash=sha256:{digest}" for digest in self._hashes(each, wheels))
            yield f"{each.requirement}{'  #' if known and not is_complete else ''}{known}"

    def as_mapping(self, wheels: Mapping[str, str]) -> dict[str, Any]:
        """Return everything as plain data."""
        software = self.manifest.get("software", {})
        packages = {
            name: {
                "name": each.name,
                "version": each.version,
                "is_needed": each.is_needed,
                "source": each.source,
                "sha256": wheels.get(name) or each.sha256,
                "fingerprint": each.fingerprint,
            }
            for name, each in self.packages.items()
        }
        known = {name: self.manifest.get(name) for name in ("robot", "ros", "host", "clocks")}
        return {
            "python": software.get("python"),
            "implementation": software.get("implementation"),
            "packages": packages,
            **known,
        }


def record_environment(manifest: Mapping[str, Any], config: Path) -> RecordedEnvironment:
    """Return the environment of an experiment, from its manifest and from what is installed here.

    Args:
        manifest: the experiment's.
        config: the folder of its config file and local modules.
    """
    software = manifest.get("software", {})
    packages = dict(software.get("packages") or {})
    if software.get("robot_runner"):
        packages.setdefault(_OUR_NAME, software["robot_runner"])
    recorded = dict(sorted((canonical(name), str(release)) for name, release in packages.items()))
    installed = installed_distributions()
    same = {
        name: installed[name] for name in recorded if name in installed and installed[name].version == recorded[name]
    }
    # Packed elsewhere, nothing tells which package needs which.
    needed = closure(_roots(manifest, config)) & set(recorded) if _OUR_NAME in same else set(recorded)
    records = {
        name: _record(f"{name}=={release}", same.get(name), name in needed) for name, release in recorded.items()
    }
    local = tuple(each for name, each in same.items() if name in needed and each.is_local)
    return RecordedEnvironment(manifest, records, local, tuple(_findings(recorded, same, needed)))


def imported_names(folder: Path) -> set[str]:
    """Return the top-level modules that the Python files in a folder import, found without executing them.

    Raises:
        OSError: a file cannot be read.
    """
    found: set[str] = set()
    for path in sorted(folder.rglob("*.py")):
        try:
            tree = ast.parse(path.read_bytes())
        except (SyntaxError, ValueError):
            continue
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                found.update(alias.name.partition(".")[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                found.add(node.module.partition(".")[0])
    return found


def _roots(manifest: Mapping[str, Any], config: Path) -> set[str]:
    owners = _owners()
    plugins = {str(each["package"]) for each in manifest.get("plugins", ()) if each.get("package")}
    return {_OUR_NAME, *plugins, *(owner for name in imported_names(config) for owner in owners.get(name, ()))}


def _record(pinned: str, installed: InstalledDistribution | None, is_needed: bool) -> PackageRecord:
    name, _, release = pinned.partition("==")
    if installed is None:
        return PackageRecord(name, release, is_needed, None, pinned)
    source, requirement = _source(installed, pinned)
    fingerprint = None if installed.is_editable else installed.fingerprint
    return PackageRecord(name, release, is_needed, source, requirement, installed.archive_sha256, fingerprint)


def _source(installed: InstalledDistribution, pinned: str) -> tuple[str, str]:
    direct = installed.direct_url
    if not direct or installed.is_local:
        return "local" if direct else "index", pinned
    name, url = pinned.partition("==")[0], str(direct["url"])
    if "vcs_info" in direct:
        info = direct["vcs_info"]
        return "version control", f"{name} @ {info.get('vcs', 'git')}+{url}@{info.get('commit_id', '')}"
    return "url", f"{name} @ {url}"


def _findings(
    recorded: Mapping[str, str], same: Mapping[str, InstalledDistribution], needed: set[str]
) -> Iterator[Finding]:
    unknown = sorted(needed - set(same))
    if not recorded:
        problem = "the manifest does not say what was installed"
        fix = "Write down in the citation or a README how the results were made."
    elif _OUR_NAME not in same:
        problem = "this is not the environment in which the experiment was executed: all that it had is listed"
        fix = "Pack where it was executed, to have fingerprints and local packages too."
    elif unknown:
        problem = f"another version is installed here than when it was executed: {', '.join(unknown)}"
        fix = "Pack in the environment in which it was executed."
    else:
        return
    yield Finding.warning("environment", problem, fix)


def make_environment(root: Path, folder: Path, environment: Mapping[str, Any]) -> Path:
    """Make a virtual environment and install what a package needs; one that is complete is used as it is.

    What the package brings as wheels is taken from it; pip gets the rest from wherever it is set up to, and demands the
    hashes where the package has them of all files.

    Args:
        root: the unpacked package.
        folder: where the environment is to be.
        environment: as the package has it; its Python is taken where it is installed here under its usual name.

    Returns:
        The program `robot-runner` in it.

    Raises:
        PackageError: the environment cannot be made; shows the last lines that pip wrote.
        StorageError: the folder cannot be written.
    """
    python, done = folder / "bin" / "python", folder / "complete"
    log = folder.with_name(f"{folder.name}.log")
    # Pip works on other environments, too: to put one into each would take the longest of all.
    has_pip = find_spec("pip") is not None
    pip = [sys.executable, "-m", "pip", "--python", str(python)] if has_pip else [str(python), "-m", "pip"]
    wheels = ["--find-links", str(root / WHEELS)] if (root / WHEELS).is_dir() else []
    try:
        if not done.exists():
            folder.parent.mkdir(parents=True, exist_ok=True)
            log.unlink(missing_ok=True)
            _call([_python(environment), "-m", "venv", "--clear", *["--without-pip"] * has_pip, str(folder)], log)
            quietly = ["--no-input", "--disable-pip-version-check"]
            _call([*pip, "install", *quietly, *wheels, "-r", str(root / REQUIREMENTS)], log)
            done.touch()
    except OSError as error:
        raise storage_error(folder, "made", error) from error
    return folder / "bin" / "robot-runner"


def _python(environment: Mapping[str, Any]) -> str:
    wanted = ".".join(str(environment.get("python") or "").split(".")[:2])
    if wanted == f"{sys.version_info.major}.{sys.version_info.minor}":
        return sys.executable
    return shutil.which(f"python{wanted}") or sys.executable


def _call(words: Sequence[str], log: Path) -> None:
    with log.open("ab") as output:
        try:
            finished = subprocess.run(  # noqa: S603 - words of our own
                words,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                timeout=_DEADLINE_S,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            problem = f"{Path(words[0]).name} took longer than {_DEADLINE_S:.0f} s"
            raise PackageError(problem, where=str(log), fix="Look at what it wrote there.") from error
    if finished.returncode:
        lines = log.read_text(encoding="utf-8", errors="replace").splitlines()[-_SHOWN_LINES:]
        raise PackageError(
            f"the environment cannot be made: {' / '.join(line.strip() for line in lines if line.strip())}",
            where=str(log),
            fix="Mend what is said there, or take your own environment: --environment here. The first lines of "
            f"{REQUIREMENTS} say for which Python and platforms its hashes are.",
        )
