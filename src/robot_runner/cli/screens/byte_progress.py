"""How far a file or folder is read or written: a bar on a terminal, now and then a plain line elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from robot_runner.cli.console import complaints, is_live_terminal

_BETWEEN_LINES_S = 5.0
_MEBIBYTE = 1 << 20


@contextmanager
def byte_progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """Yield what is told how many bytes are done, of how many; shown on stderr as `what`, such as `packing`."""
    if is_live_terminal(sys.stderr):
        with _bar(what) as report:
            yield report
    else:
        yield _lines(what)


@contextmanager
def _bar(what: str) -> Iterator[Callable[[int, int], None]]:
    from rich.progress import (  # noqa: PLC0415 - slow, and not for every command
        BarColumn,
        DownloadColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
        TransferSpeedColumn,
    )

    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=complaints(), transient=True) as progress:
        task = progress.add_task(what, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


def _lines(what: str) -> Callable[[int, int], None]:
    told = time.monotonic()

    def report(done: int, total: int) -> None:
        nonlocal told
        if time.monotonic() - told > _BETWEEN_LINES_S:
            told = time.monotonic()
            share = f"{100 * done / max(1, total):.0f} % of {total / _MEBIBYTE:,.0f} MiB"
            print(f"{what}: {share}", file=sys.stderr, flush=True)

    return report
