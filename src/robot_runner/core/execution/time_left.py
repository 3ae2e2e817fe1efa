"""How long the runs that are left will take: one estimate, for whoever waits beside the robot."""

from __future__ import annotations

from statistics import fmean
from typing import TYPE_CHECKING

from robot_runner.core.storage.journal import read_journal

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["seconds_left"]


def seconds_left(journal: Path, runs_left: int, rest_s: float) -> float | None:
    """Return how long the runs that are left will take, if they go on as those that are done did, in s.

    The time that a person takes between two runs is not part of it.

    Args:
        journal: of the experiment, earlier sessions included.
        runs_left: how many runs are to come.
        rest_s: how long the robot rests between two runs.

    Returns:
        the mean over the attempts that ended well, times the runs, and the rests between them; None where no attempt
        has ended well.
    """
    ends = {
        (record["run"], record["attempt"]): record["seconds"]
        for record in read_journal(journal, kinds={"attempt_finished"})
        if record["status"] == "done" and record["seconds"] is not None
    }
    if not ends or runs_left < 1:
        return None
    return fmean(ends.values()) * runs_left + rest_s * (runs_left - 1)
