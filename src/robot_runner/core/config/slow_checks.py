"""Telling which check of a stranger takes long, or hangs, while it is waited for."""

from __future__ import annotations

import logging
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_log = logging.getLogger(__name__)

#: After how long a check is told, s: most take less than a second, and few look for a device in the network.
PATIENCE = 10.0


@contextmanager
def told_if_slow(what: str) -> Iterator[None]:
    """Log a warning with a name for what is executed, once that has taken long.

    Only in the main thread, and where nobody else uses the alarm, or blocks it: the orchestrator starts no threads.
    """
    is_main = threading.current_thread() is threading.main_thread()
    is_used = signal.getitimer(signal.ITIMER_REAL)[0] or signal.getsignal(signal.SIGALRM) is None
    if not is_main or is_used or signal.SIGALRM in signal.pthread_sigmask(signal.SIG_BLOCK, ()):
        yield
        return

    def tell(number: int, frame: object) -> None:
        del number, frame
        is_ended = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # elsewhere, as at a robot, only noted
        hint = "; Ctrl-C ends it" if is_ended else ""
        _log.warning("%s has taken %g s so far, and is waited for%s", what, PATIENCE, hint)

    earlier = signal.signal(signal.SIGALRM, tell)
    signal.setitimer(signal.ITIMER_REAL, PATIENCE)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, earlier)
