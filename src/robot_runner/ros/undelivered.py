"""Decides what becomes of data that the system has not delivered yet when a connection over TCP is closed."""

from __future__ import annotations

import socket
import struct
from contextlib import suppress
from typing import Any


def drop_undelivered(connection: Any, *, is_dropped: bool = True) -> None:
    """Have the system drop what is not delivered when a socket is closed, also as its process is killed; or not.

    Otherwise it would go on delivering for minutes: a robot that was stopped meanwhile would drive again, and a setting
    that was put back would change. So `is_dropped` is false only once everything was answered, or for what should be
    delivered however late. None, and a socket that was closed, is left alone.
    """
    with suppress(AttributeError, OSError):
        # Without time to linger, a connection is reset as it is closed.
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", is_dropped, 0))
