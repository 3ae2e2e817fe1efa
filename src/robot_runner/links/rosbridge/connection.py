"""Opens the WebSocket of a rosbridge, and says why it cannot be opened."""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING

from robot_runner.errors import LinkError

if TYPE_CHECKING:
    from contextlib import ExitStack

    from websockets.sync.client import ClientConnection

    from robot_runner.links.rosbridge.address import RosbridgeAddress

__all__ = ["closed_reason", "connect", "send_errors"]

#: How long, s, the other side may be silent before it is asked whether it is there, and how long it may think about it.
_PING_INTERVAL, _PING_TIMEOUT = 3.0, 5.0
_CLOSE_TIMEOUT = 2.0


def connect(address: RosbridgeAddress, timeout: float, closing: ExitStack, *, where: str) -> ClientConnection:
    """Open the WebSocket.

    Args:
        address: of the rosbridge.
        timeout: how long it may take, s.
        closing: closes it.
        where: for the error.

    Raises:
        LinkError: it cannot be opened.
    """
    from websockets import exceptions  # noqa: PLC0415  # an extra, only where it is asked for
    from websockets.sync.client import connect as open_connection  # noqa: PLC0415

    try:
        return closing.enter_context(
            open_connection(
                address.uri,
                open_timeout=timeout,
                close_timeout=_CLOSE_TIMEOUT,
                ping_interval=_PING_INTERVAL,
                ping_timeout=_PING_TIMEOUT,
                compression=None,  # it would cost more on the robot than it saves on the network
                max_size=None,
                proxy=None,
            )
        )
    except socket.gaierror as error:
        fix = "Correct the robot's address, or give it as a number."
        raise LinkError(f"the host {address.host!r} is not known", where=where, fix=fix) from error
    except TimeoutError as error:
        fix = "Look whether the robot is on and in this network, and whether a firewall drops the port."
        raise LinkError(f"nothing answers there within {timeout:g} s", where=where, fix=fix) from error
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        fix = "Start it on the robot: roslaunch (ROS 2: ros2 launch) rosbridge_server, or correct the address."
        raise LinkError(f"it cannot be reached: {reason}", where=where, fix=fix) from error
    except (exceptions.InvalidHandshake, exceptions.InvalidURI, EOFError) as error:
        fix = "Name the port of the rosbridge server: 9090, if not started elsewhere."
        raise LinkError(f"what listens there is no rosbridge: {error}", where=where, fix=fix) from error


def send_errors() -> tuple[type[Exception], ...]:
    """Return what says that a connection is gone."""
    from websockets.exceptions import ConnectionClosed  # noqa: PLC0415  # an extra, loaded by now

    return (ConnectionClosed, OSError, EOFError)


def closed_reason(error: Exception) -> str:
    """Return why a connection is gone."""
    text = str(error)
    return "the robot does not answer any more" if "keepalive" in text else text
