"""The velocities that this process has commanded lately, so that those of others are told from them."""

from __future__ import annotations

import threading
import time
from collections import defaultdict, deque

__all__ = ["is_from_here", "note_velocity"]

#: How long a command may be on its way back to us, s: two hops of Wi-Fi that has to send again take tenths.
_ECHO = 5.0

Velocity = tuple[float, float]

#: By the full name of the topic: when each was sent, on the monotonic clock. All links of a process share it: a config
#: may drive the robot over a link of its own.
_sent: defaultdict[str, deque[tuple[float, Velocity]]] = defaultdict(deque)
_lock = threading.Lock()


def note_velocity(topic: str, velocity: Velocity) -> None:
    """Take a velocity, m/s and rad/s, that is about to be commanded on a topic.

    Example:
        >>> note_velocity("/cmd_vel", (0.2, 0.0))
        >>> is_from_here("/cmd_vel", (0.2, 0.0)), is_from_here("/cmd_vel", (0.3, 0.0))
        (True, False)
    """
    with _lock:
        sent = _sent[topic]
        sent.append((time.monotonic(), velocity))
        while len(sent) > 1 and sent[0][0] < time.monotonic() - _ECHO:  # the last one stays: it still holds
            sent.popleft()


def is_from_here(topic: str, velocity: Velocity) -> bool:
    """Whether a velocity that is heard on a topic was commanded by this process within the last seconds."""
    with _lock:
        return any(sent == velocity for _, sent in _sent[topic])
