"""Text to disk so that a reader sees the old file or the new one, whole, whatever fails in between."""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from pathlib import Path
from typing import TextIO

from robot_runner.core.storage.guarded_files import open_to_write

#: The permissions of a file that belongs to no experiment: what the user's umask leaves of them.
_RIGHTS = 0o666


def write_beside_and_rename(path: Path, write: Callable[[TextIO], object], root: Path | None = None) -> None:
    """Write a text file (UTF-8) beside `path`, flush it to the disk, and rename it over `path`.

    Where anything fails, what stood at `path` is intact and nothing is left beside it. Names of files that are no text
    have their bytes written as escapes.

    Args:
        path: the file to make or to replace; its folder exists.
        write: called once with the open file; lines end as they are written.
        root: the experiment's folder that the file belongs to, in which no links are followed. Without it, the user
            named the file: a symbolic link at `path` stays, and what it points to is replaced.

    Raises:
        StorageError: it cannot be written.
    """
    # Not by `resolve`, which fails on a loop of links before it can be named.
    target, mode = (path, 0) if root else (Path(os.path.realpath(path)), _RIGHTS)
    with open_to_write(target, root, mode=mode) as file:
        text = io.TextIOWrapper(file, encoding="utf-8", errors="backslashreplace", newline="")
        write(text)
        text.detach()  # flushes, and leaves the file open
