"""What is to be replicated: a package, zipped or unpacked, or an experiment's folder that nobody sealed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from robot_runner.errors import Finding, PackageError
from robot_runner.replication.distributions import canonical
from robot_runner.replication.names import DESCRIPTION
from robot_runner.replication.opening import open_package
from robot_runner.replication.unpacking import unpack
from robot_runner.replication.verification import refuse_faults, verify_package
from robot_runner.storage.layout import ExperimentFolder
from robot_runner.storage.manifest import read_manifest

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from robot_runner.replication.sealing import Progress

__all__ = ["Source", "find_source"]

_UNPACKED = "package"


@dataclass(frozen=True, slots=True)
class Source:
    """Something that can be executed again.

    Attributes:
        path: the zip file or the folder.
        is_sealed: whether it has checksums, which were found to be right.
        experiment: the experiment's name.
        environment: as the package has it, or as the manifest tells.
        findings: what was said of it that is no fault.
    """

    path: Path
    is_sealed: bool
    experiment: str
    manifest: Mapping[str, Any]
    description: Mapping[str, Any]
    environment: Mapping[str, Any]
    findings: tuple[Finding, ...]

    def refuse_target(self, target: Path) -> None:
        """Let only a folder pass that is not part of what is replicated.

        Raises:
            PackageError: it is.
        """
        root = self.path.resolve()
        if target == root or root in target.parents:
            fix = "Name a folder outside of it with --to."
            raise PackageError("a replication cannot be written into its original", where=str(target), fix=fix)
        if target.exists() and not target.is_dir():
            raise PackageError("it is no folder", where=str(target), fix="Name another one with --to.")

    def unpacked_below(self, target: Path, progress: Progress) -> Path:
        """Return the folder that holds the original; a zip file is unpacked below `target`.

        Raises:
            PackageError: another package is there, what is there was altered, or there is no room.
            StorageError: it cannot be written.
        """
        if self.path.is_dir():
            return self.path.resolve()
        root = target / _UNPACKED
        was_there = root.exists()
        with open_package(self.path) as package:
            unpack(package, root, progress)
        if was_there:
            with open_package(root) as package:
                refuse_faults(verify_package(package, progress))
        return root


def find_source(path: Path, progress: Progress) -> Source:
    """Open and verify what is to be replicated; nothing is written, and nothing of it is executed.

    Raises:
        PackageError: it is not intact, or is nothing that can be replicated.
        StorageError: it cannot be read.
    """
    if path.is_dir() and not (path / DESCRIPTION).exists():
        return _unsealed(path)
    with open_package(path) as package:
        verification = verify_package(package, progress)
    refuse_faults(verification)
    return Source(
        path,
        is_sealed=True,
        experiment=verification.experiment,
        manifest=verification.manifest,
        description=verification.description,
        environment=verification.environment or _environment(verification.manifest),
        findings=verification.findings,
    )


def _unsealed(path: Path) -> Source:
    manifest = read_manifest(ExperimentFolder.found_at(path).manifest)
    problem = "it is an experiment's folder and no package: nothing tells whether it was altered"
    finding = Finding.warning(str(path), problem, "Seal it: robot-runner pack")
    name = str(manifest.get("experiment_name", path.name))
    return Source(
        path,
        is_sealed=False,
        experiment=name,
        manifest=manifest,
        description={},
        environment=_environment(manifest),
        findings=(finding,),
    )


def _environment(manifest: Mapping[str, Any]) -> dict[str, Any]:
    software = manifest.get("software") or {}
    return {
        "python": software.get("python"),
        "robot": manifest.get("robot"),
        "ros": manifest.get("ros"),
        "host": manifest.get("host"),
        "packages": {
            canonical(name): {"name": name, "version": release, "is_needed": True}
            for name, release in (software.get("packages") or {}).items()
        },
    }
