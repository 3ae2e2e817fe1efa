"""Waiting for what other threads and processes do: always with a deadline, so that a fault costs a minute at most."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["PATIENCE", "wait_until"]

#: Far longer than anything takes here on a busy machine, s.
PATIENCE = 60.0


def wait_until(holds: Callable[[], Any], what: str = "it never came", *, seconds: float = PATIENCE) -> Any:
    """Wait until something holds, and return it; `what` says what was awaited where it never does."""
    deadline = time.monotonic() + seconds
    while not (found := holds()):
        assert time.monotonic() < deadline, f"not within {seconds:g} s: {what}"
        time.sleep(0.02)
    return found
