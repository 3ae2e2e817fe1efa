"""A verified package unpacked into a folder, and nowhere else."""

from __future__ import annotations

import hashlib
import os
import shutil
from typing import TYPE_CHECKING

from robot_runner.errors import PackageError
from robot_runner.replication.names import SUMS
from robot_runner.storage.safe_write import storage_error

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from robot_runner.replication.opening import OpenPackage

__all__ = ["unpack"]

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
