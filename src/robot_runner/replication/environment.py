"""The environment that an experiment was executed in, and what is needed to make it again.

What was installed when the experiment was executed is in its manifest: names and versions. Where the same versions
are installed while it is packed, more is known: where each came from, a fingerprint of its files, and for what was
installed from a local folder, its wheel. Nothing is looked up on a network here, so the hash of a file that came from
an index is not known, because installers do not keep it; `index_hashes` asks for it.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass, field
from importlib.metadata import packages_distributions
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import Finding
from robot_runner.replication.distributions import canonical, closure, installed_distributions
from robot_runner.replication.index_hashes import PLATFORMS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from robot_runner.replication.distributions import InstalledDistribution

__all__ = ["OUR_NAME", "PackageRecord", "RecordedEnvironment", "imported_names", "record_environment"]

OUR_NAME = "robot-runner"


@dataclass(frozen=True, slots=True)
class PackageRecord:
    """One installed package.

    Attributes:
        is_needed: whether the experiment needs it, itself or by way of others.
        source: `index` (or an installer that left no note), `local`, `url` or `version control`; None where the package
            is not installed in this version while packing, so that nothing but its version is known.
        requirement: what an installer is told.
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
        packages: what was installed, by canonical name.
        local: the distributions among those needed that only this machine has.
        findings: what cannot be told of it.
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
        return tuple(each for _, each in sorted(self.packages.items()) if each.is_needed)

    def requirements(self, wheels: Mapping[str, str]) -> str:
        """Return the text of a requirements file.

        Args:
            wheels: the hash of each wheel that the package holds, by the canonical name of its distribution.
        """
        # One hash makes pip ask for all of them.
        is_complete = bool(self.needed) and not self.without_hash(wheels)
        return "".join(f"{line}\n" for line in self._lines(wheels, is_complete=is_complete))

    def without_hash(self, wheels: Mapping[str, str]) -> tuple[PackageRecord, ...]:
        """Return the packages of whose files no hash is known, by name."""
        return tuple(each for each in self.needed if not self._hashes(each, wheels))

    def _hashes(self, record: PackageRecord, wheels: Mapping[str, str]) -> tuple[str, ...]:
        name = canonical(record.name)
        known = wheels.get(name) or record.sha256
        return (known,) if known else self.index_hashes.get(name, ())

    def as_mapping(self, wheels: Mapping[str, str]) -> dict[str, Any]:
        """Return everything as plain data."""
        software = self.manifest.get("software", {})
        return {
            "python": software.get("python"),
            "implementation": software.get("implementation"),
            "packages": {
                name: {
                    "name": each.name,
                    "version": each.version,
                    "is_needed": each.is_needed,
                    "source": each.source,
                    "sha256": wheels.get(name) or each.sha256,
                    "fingerprint": each.fingerprint,
                }
                for name, each in sorted(self.packages.items())
            },
            "robot": self.manifest.get("robot"),
            "ros": self.manifest.get("ros"),
            "host": self.manifest.get("host"),
            "clocks": self.manifest.get("clocks"),
        }

    def _lines(self, wheels: Mapping[str, str], *, is_complete: bool) -> Iterator[str]:
        yield f"# The packages that the experiment needs, as they were installed (Python {self.python})."
        if not is_complete:
            yield "# The hash of not every file is known, so that none can be demanded: those known are comments."
        if self.index_hashes:
            platforms = ", ".join(PLATFORMS)
            yield f"# The hashes are of the index's files for this Python, on: {platforms}."
        yield "# environment.json has a fingerprint of the installed files of each."
        if wheels:
            yield "# Some are in the folder wheels: pip install --find-links wheels -r requirements.txt"
        for each in self.needed:
            known = "".join(f" --hash=sha256:{digest}" for digest in self._hashes(each, wheels))
            yield f"{each.requirement}{'  #' if known and not is_complete else ''}{known}"


def record_environment(manifest: Mapping[str, Any], config: Path) -> RecordedEnvironment:
    """Return the environment of an experiment, from its manifest and from what is installed here.

    Args:
        manifest: the experiment's.
        config: the folder of its config file and local modules.
    """
    recorded = {canonical(name): str(release) for name, release in _recorded_packages(manifest)}
    installed = installed_distributions()
    here = {name: installed[name] for name in recorded if name in installed}
    same = {name: each for name, each in here.items() if each.version == recorded[name]}
    needed = closure(_roots(manifest, config)) & set(recorded)
    is_known = OUR_NAME in same
    if not is_known:  # packed elsewhere: what needs what cannot be told
        needed = set(recorded)
    packages = {
        name: _record(name, release, same.get(name), is_needed=name in needed) for name, release in recorded.items()
    }
    local = tuple(each for name, each in sorted(same.items()) if name in needed and each.is_local)
    return RecordedEnvironment(manifest, packages, local, tuple(_findings(recorded, same, needed)))


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


def _recorded_packages(manifest: Mapping[str, Any]) -> Iterable[tuple[str, Any]]:
    software = manifest.get("software", {})
    packages = dict(software.get("packages") or {})
    if software.get("robot_runner"):
        packages.setdefault(OUR_NAME, software["robot_runner"])
    return packages.items()


def _roots(manifest: Mapping[str, Any], config: Path) -> set[str]:
    owners = packages_distributions()
    plugins = {str(each["package"]) for each in manifest.get("plugins", ()) if each.get("package")}
    imported = {owner for name in imported_names(config) for owner in owners.get(name, ())}
    return {OUR_NAME, *plugins, *imported}


def _record(name: str, release: str, installed: InstalledDistribution | None, *, is_needed: bool) -> PackageRecord:
    pinned = f"{name}=={release}"
    if installed is None:
        return PackageRecord(name, release, is_needed, None, pinned)
    source, requirement = _source(installed, pinned)
    fingerprint = None if installed.is_editable else installed.fingerprint
    return PackageRecord(name, release, is_needed, source, requirement, installed.archive_sha256, fingerprint)


def _source(installed: InstalledDistribution, pinned: str) -> tuple[str, str]:
    direct = installed.direct_url
    if not direct:
        return "index", pinned
    if installed.is_local:
        return "local", pinned
    name = pinned.partition("==")[0]
    url = str(direct["url"])
    if "vcs_info" in direct:
        info = direct["vcs_info"]
        return "version control", f"{name} @ {info.get('vcs', 'git')}+{url}@{info.get('commit_id', '')}"
    return "url", f"{name} @ {url}"


def _findings(
    recorded: Mapping[str, str], same: Mapping[str, InstalledDistribution], needed: set[str]
) -> Iterator[Finding]:
    where = "environment"
    if not recorded:
        fix = "Write down in the citation or a README how they were made."
        yield Finding.warning(where, "the manifest does not say what was installed", fix)
        return
    unknown = sorted(needed - set(same))
    if OUR_NAME not in same:
        problem = "this is not the environment in which the experiment was executed: all that it had is listed"
        yield Finding.warning(
            where, problem, "Pack where it was executed, to have fingerprints and local packages too."
        )
    elif unknown:
        problem = f"another version is installed here than when it was executed: {', '.join(unknown)}"
        yield Finding.warning(where, problem, "Pack in the environment in which it was executed.")
