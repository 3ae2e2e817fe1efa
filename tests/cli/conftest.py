from __future__ import annotations

from typing import TYPE_CHECKING

from tests.core.execution.conftest import execute

from robot_runner.core.errors import StorageError

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["execute", "refuse_as_full"]


def refuse_as_full(path: Path, *_: object) -> None:
    """Stand for what writes a file, on a full disk."""
    raise StorageError("cannot be written: the disk is full", where=str(path), fix="Make room.")
