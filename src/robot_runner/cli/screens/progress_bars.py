"""How far work that takes its time has come: a bar on a terminal, now and then a plain line elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from robot_runner.cli.console import complaints, is_live_terminal

if TYPE_CHECKING:
    from rich.progress import Progress

_BETWEEN_LINES_S = 5.0
_MEBIBYTE = 1 << 20


@contextmanager
def byte_progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """Yield what is told how many bytes are done, of how many; shown on stderr as `what`, such as `packing`."""
    if not is_live_terminal(sys.stderr):
        told = _Lines()
        yield lambda done, total: told.tell(
            f"{what}: {100 * done / max(1, total):.0f} % of {total / _MEBIBYTE:,.0f} MiB"
        )
        return
    from rich.progress import DownloadColumn, TransferSpeedColumn  # noqa: PLC0415 - slow, and not for every command

    with _bar(DownloadColumn(), TransferSpeedColumn()) as progress:
        task = progress.add_task(what, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


@contextmanager
def step_progress() -> Iterator[Callable[[str, int, int], None]]:
    """Yield what is told what is being done, such as `figures`, how many of them are, and of how many; on stderr."""
    if not is_live_terminal(sys.stderr):
        told = _Lines()
        yield lambda what, done, total: told.tell(f"{what}: {done:,} of {total:,}")
        return
    from rich.progress import MofNCompleteColumn  # noqa: PLC0415 - as above

    with _bar(MofNCompleteColumn()) as progress:
        task = progress.add_task("", total=None, visible=False)

        def tell(what: str, done: int, total: int) -> None:
            if progress.tasks[task].description != what:
                progress.reset(task)
            progress.update(task, description=what, completed=done, total=total, visible=True)

        yield tell


def _bar(*columns: object) -> Progress:
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn  # noqa: PLC0415 - as above

    every = (TextColumn("{task.description}"), BarColumn(), *columns, TimeRemainingColumn())
    return Progress(*every, console=complaints(), transient=True)  # type: ignore[arg-type]


class _Lines:
    """Prints a line now and then: a log is not to be full of them."""

    def __init__(self) -> None:
        self._told = time.monotonic()

    def tell(self, line: str) -> None:
        """Print it, unless another one has just been printed."""
        if time.monotonic() - self._told > _BETWEEN_LINES_S:
            self._told = time.monotonic()
            print(line, file=sys.stderr, flush=True)
