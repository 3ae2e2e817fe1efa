"""A pause between two runs: asked for from another terminal, and ended from there or by ENTER; nothing is ended."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from robot_runner.core.execution.notices import Paused
from robot_runner.core.execution.patience import Pause
from robot_runner.core.storage.lock import forget_pause, pause_is_requested

if TYPE_CHECKING:
    from collections.abc import Callable

    from robot_runner.core.execution.notices import Notice
    from robot_runner.core.execution.patience import Patience, Steps
    from robot_runner.core.execution.progress_manager import ProgressManager
    from robot_runner.core.execution.task import PendingRun
    from robot_runner.core.storage.layout import ExperimentFolder

__all__ = ["pause_where_requested"]

#: How often a second terminal is listened to, in seconds.
_LISTEN = 0.2


def pause_where_requested(
    folder: ExperimentFolder,
    run: PendingRun,
    progress: ProgressManager,
    notify: Callable[[Notice], None],
    patience: Patience,
    user_input: int | None,
) -> Steps[None]:
    """Wait, where `robot-runner pause` asked for it, until the request is taken back or the user interrupts.

    Args:
        folder: where the request lies.
        run: the run that follows.
        progress: takes down the pause, and brings the run table up to date before it.
        notify: tells the screens.
        patience: how to wait.
        user_input: where a line ends the pause, too; None where nobody sits.
    """
    if not pause_is_requested(folder.pause):
        return
    started = time.monotonic()
    progress.note("paused", flush=True, next_run=run.run_id)
    progress.bring_table_up_to_date()
    notify(Paused(folder.root, run.number, progress.run_count))
    while pause_is_requested(folder.pause) and not patience.interruption.is_requested:
        pause = Pause(_LISTEN, user_input)
        yield pause
        if pause.typed == b"":  # the end of the input
            user_input = None
        elif pause.typed is not None:
            forget_pause(folder.pause)
    progress.note("continued", after="pause", seconds=round(time.monotonic() - started, 3))
