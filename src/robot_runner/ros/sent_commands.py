"""The recent commands of this process, to distinguish those of other nodes on the same topic."""

from __future__ import annotations

import math
import threading
import time
from collections import Counter, defaultdict, deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

#: How long a command may be on its way back to us, s: two hops of Wi-Fi that has to send again take tenths.
_ECHO = 5.0
#: A float32 comes back with seven digits of what was sent.
_PRECISION = 1e-6

#: By the full name of the topic: when each was sent, on the monotonic clock. All links of a process share it: a config
#: may drive the robot over a link of its own.
_sent: defaultdict[str, deque[tuple[float, Any]]] = defaultdict(deque)
_watched: Counter[str] = Counter()
_lock = threading.Lock()


def note_sent(topic: str, command: Any) -> None:
    """Note a command that is about to be sent on a topic: a velocity without its stamp, or a whole message.

    Example:
        >>> note_sent("/cmd_vel", {"linear": {"x": 0.2}})
        >>> is_from_here("/cmd_vel", {"linear": {"x": 0.2}}), is_from_here("/cmd_vel", {"linear": {"x": 0.3}})
        (True, False)
    """
    with _lock:
        _sent[topic].append((time.monotonic(), command))
        _lately_sent(topic)


def is_from_here(topic: str, command: Any) -> bool:
    """Whether a received command was sent by this process within the last seconds, or was its last on the topic."""
    with _lock:
        return any(_is_same(sent, command) for _, sent in _lately_sent(topic))


def _lately_sent(topic: str) -> deque[tuple[float, Any]]:
    """Drop commands that can no longer be on their way back, and return the others."""
    sent = _sent[topic]
    while len(sent) > 1 and sent[0][0] < time.monotonic() - _ECHO:  # the last one is kept: it is still in force
        sent.popleft()
    return sent


@contextmanager
def watched(topic: str) -> Iterator[None]:
    """Have each message that this process sends on a topic noted, for a while."""
    _watched[topic] += 1
    try:
        yield
    finally:
        _watched[topic] -= 1


def is_watched(topic: str) -> bool:
    """Whether messages of this topic have to be noted: they may be large, and most topics are not for commands."""
    return _watched[topic] > 0


def _is_same(sent: Any, heard: Any) -> bool:
    if isinstance(sent, float) and isinstance(heard, int | float):
        is_odd = math.isnan(sent) and math.isnan(heard)
        return is_odd or math.isclose(sent, heard, rel_tol=_PRECISION, abs_tol=_PRECISION**2)
    if isinstance(sent, Mapping):
        return isinstance(heard, Mapping) and all(_is_same(sent[name], heard.get(name)) for name in sent)
    if isinstance(sent, Sequence) and not isinstance(sent, str | bytes):
        return len(sent) == len(heard) and all(map(_is_same, sent, heard))
    return bool(sent == heard)
