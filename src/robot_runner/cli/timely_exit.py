"""Exits in time: threads and processes that a callback has left are named, and do not keep the program for ever.

Python waits for threads that are not daemons, for children of `multiprocessing`, and for functions registered with
`atexit`. It has no deadline and says nothing: a queue or a CI job would wait as well.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

from robot_runner.core.words import enumerated, shown_duration

#: After how long the program says what it waits for at its end, and how long after that it is ended, s.
TELL_AFTER, END_AFTER = 5.0, 600.0


def leave_in_time(code: int, tell_after: float = TELL_AFTER, end_after: float = END_AFTER) -> None:
    """Make sure that this process ends in time, with an exit code. Call it once all is done.

    After `tell_after` s it says what it waits for, and `end_after` s later it is ended.
    """
    # A daemon lives until Python has waited for everything else.
    with suppress(RuntimeError):  # no thread can be started, by the limits of this user: then it ends as Python does
        threading.Thread(target=_watch, args=(code, tell_after, end_after), name="leaving", daemon=True).start()


def _watch(code: int, tell_after: float, end_after: float) -> None:
    time.sleep(tell_after)
    most = shown_duration(end_after)
    with suppress(OSError, ValueError):
        sys.stderr.write(
            f"All is done, and the program waits for {enumerated(_awaited())}, for {most} at most.\n"
            "  fix: End in after_experiment what a callback has started, or make it a daemon.\n"
        )
        sys.stderr.flush()
    time.sleep(end_after)
    for child in _children():
        with suppress(OSError):
            child.kill()
    with suppress(OSError, ValueError):
        sys.stdout.flush()
    os._exit(code)


def _awaited() -> list[str]:
    """Return in words why the process is alive: threads and children, or else a function given to `atexit`."""
    main = threading.main_thread()
    threads = [f"thread {each.name!r}" for each in threading.enumerate() if not each.daemon and each is not main]
    children = [f"child process {each.pid} ({each.name})" for each in _children()]
    frame = sys._current_frames().get(main.ident or 0)  # noqa: SLF001 - the documented way to another thread's stack
    line = "" if frame is None else f" at {frame.f_code.co_filename}:{frame.f_lineno}"
    return [*threads, *children] or [f"a function that a callback registered with atexit{line}"]


def _children() -> Iterator[Any]:
    multiprocessing = sys.modules.get("multiprocessing")
    return iter(multiprocessing.active_children() if multiprocessing is not None else ())
