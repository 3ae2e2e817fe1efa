"""What is to be replicated: a package, zipped or unpacked, or an experiment's folder that nobody sealed."""

from __future__ import annotations

import hashlib
import os
import shutil
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import Finding, PackageError
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.storage.safe_write import storage_error
from robot_runner.replication.contents import DESCRIPTION, SUMS
from robot_runner.replication.distributions import canonical
from robot_runner.replication.opening import open_package
from robot_runner.replication.verification import refuse_faults, verify_package

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from robot_runner.replication.opening import OpenPackage
    from robot_runner.replication.sealing import Progress

__all__ = ["Source", "find_source", "unpack"]


# A verified package unpacked into a folder, and nowhere else.

_SPARE = 64 << 20


def unpack(package: OpenPackage, target: Path, progress: Callable[[int, int], None] = lambda _, __: None) -> None:
    """Write the files of a package below `target`, which is made; one that was unpacked there before is left as it is.

    Args:
        package: opened, and found to be intact.
        target: the folder. What is half unpacked stands beside it under another name.
        progress: is told how many bytes are written, of how many.

    Raises:
        PackageError: another package is there, or there is no room.
        StorageError: it cannot be written.
    """
    if target.exists():
        _refuse_other(package, target)
        return
    beside = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        _refuse_without_room(package, target.parent)
        beside.mkdir()
        try:
            _write(package, beside, progress)
            beside.rename(target)
        finally:
            if beside.exists():
                shutil.rmtree(beside)
    except OSError as error:
        raise storage_error(target, "written", error) from error


def _write(package: OpenPackage, folder: Path, progress: Callable[[int, int], None]) -> None:
    total, done = sum(package.sizes.values()), 0
    for name in package.sizes:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("xb") as file:
            for block in package.blocks(name):
                file.write(block)
                done += len(block)
                progress(done, total)


def _refuse_other(package: OpenPackage, target: Path) -> None:
    """Both have the checksums of all their files: the same checksums, the same package."""
    sums = target / SUMS
    ours = hashlib.sha256(b"".join(package.blocks(SUMS))).digest()
    try:
        is_same = sums.is_file() and hashlib.sha256(sums.read_bytes()).digest() == ours
    except OSError as error:
        raise storage_error(sums, "read", error) from error
    if not is_same:
        fix = "Name another folder with --to."
        raise PackageError("another package is unpacked here", where=str(target), fix=fix)


def _refuse_without_room(package: OpenPackage, folder: Path) -> None:
    needed, free = sum(package.sizes.values()), shutil.disk_usage(folder).free
    if needed + _SPARE > free:
        problem = f"it would take {needed:,} bytes, and {free:,} are free"
        raise PackageError(problem, where=str(folder), fix="Make room, or name a folder on another disk with --to.")


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
