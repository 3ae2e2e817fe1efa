"""Writing a text file atomically: a reader sees the old file or the new one, whatever fails in between."""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from pathlib import Path
from typing import TextIO

from robot_runner.core.storage.guarded_files import open_to_write

#: The permissions of a file outside an experiment, which the user's umask reduces.
_RIGHTS = 0o666


def write_beside_and_rename(path: Path, write: Callable[[TextIO], object], root: Path | None = None) -> None:
    """Write a text file (UTF-8) beside `path`, flush it to the disk, and rename it over `path`.

    Where anything fails, the file at `path` is intact and nothing is left beside it. Bytes of file names that are not
    text are written as escapes. `write` is called once with the open file, which does not translate line ends. `root`
    is the folder of the experiment to which the file belongs, in which no links are followed. Without it, the user
    named the file: a symbolic link at `path` stays, and its target is replaced.

    Raises:
        StorageError: it cannot be written.
    """
    # Not by `resolve`, which fails on a loop of links without naming it.
    target, mode = (path, 0) if root else (Path(os.path.realpath(path)), _RIGHTS)
    with open_to_write(target, root, mode=mode) as file:
        text = io.TextIOWrapper(file, encoding="utf-8", errors="backslashreplace", newline="")
        write(text)
        text.detach()  # flushes, and leaves the file open
