"""Whether processes of an experiment are alive whose orchestrator is gone."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from robot_runner.core.errors import StorageError
from robot_runner.core.execution.left_processes import (
    go_on_elsewhere,
    is_alive,
    is_subject_left,
    left_processes,
    marked_folders,
)
from robot_runner.core.execution.standby_lock import is_at_work
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.lock import holder_of


def goes_on(root: Path, *, counts_orphans: bool = True) -> bool:
    """Return whether processes of an experiment are alive whose orchestrator is gone.

    Such are a run, here or on another machine; a probe, gate or reboot; software under test; and a standby. With
    `counts_orphans`, programs count that a run left without a keeper.
    """
    with suppress(OSError, StorageError, ValueError):  # a folder that cannot be read counts as one without any
        folder = ExperimentFolder.found_at(root)
        if holder_of(folder.lock):
            return False
        marked = marked_folders(folder)
        is_here = any(is_alive(each) or is_at_work(each) for each in marked)
        is_left = counts_orphans and any(map(left_processes, marked))
        return is_here or is_left or is_subject_left(folder) or go_on_elsewhere(folder)
    return False
