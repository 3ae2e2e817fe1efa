"""Calls services of ROS 1 with a deadline, which rospy's own proxy lacks.

Source of the protocol: wiki.ros.org/ROS/TCPROS and wiki.ros.org/ROS/Connection Header.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from typing import Any
from urllib.parse import urlsplit

from robot_runner.core.errors import LinkError
from robot_runner.ros.graph_transport import service_timeout, wrong_service_type
from robot_runner.ros.undelivered import drop_undelivered

_LENGTH = struct.Struct("<I")
_CALLER = "/robot_runner"
#: The words by which errors of rospy and roscpp show that a service has another type.
_SIGNS_OF_ANOTHER_TYPE = ("md5sum", "datatype")


class _Connection:
    """A connection to a service that raises once its deadline has passed."""

    def __init__(self, uri: str, timeout: float) -> None:
        parts = urlsplit(uri)
        self._deadline = time.monotonic() + timeout
        self._socket = socket.create_connection((parts.hostname or "", parts.port or 0), timeout=timeout)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        drop_undelivered(self._socket)  # a request that was given up must not take effect later

    def send(self, data: bytes) -> None:
        self._keep_deadline()
        self._socket.sendall(_LENGTH.pack(len(data)) + data)

    def block(self) -> bytes:
        return self.exactly(_LENGTH.unpack(self.exactly(_LENGTH.size))[0])

    def exactly(self, count: int) -> bytes:
        data = bytearray()
        while len(data) < count:
            self._keep_deadline()
            piece = self._socket.recv(count - len(data))
            if not piece:
                raise ConnectionResetError("the service closed the connection")
            data += piece
        return bytes(data)

    def note_answer(self) -> None:
        """Note that nothing is to be dropped any more."""
        drop_undelivered(self._socket, is_dropped=False)

    def close(self) -> None:
        self._socket.close()

    def _keep_deadline(self) -> None:
        left = self._deadline - time.monotonic()
        if left <= 0:
            raise TimeoutError
        self._socket.settimeout(left)


def call_service(name: str, uri: str, cls: Any, request: Any, *, timeout: float) -> Any:
    """Call a service of a class of types, at the URI from the master, and return its response.

    Raises:
        LinkError: it cannot be reached, has another type, refuses, or does not answer in time.
    """
    buffer = BytesIO()
    request.serialize(buffer)
    with _connected(name, uri, timeout) as connection:
        refused = _greet(connection, {"service": name, "type": cls._type, "md5sum": cls._md5sum}).get("error")
        if refused is not None:
            raise _refused(name, uri, cls._type, refused)
        connection.send(buffer.getvalue())
        is_good = connection.exactly(1) == b"\x01"
        answer = connection.block()
    if not is_good:
        text = answer.decode(errors="replace")
        raise LinkError(f"the service failed: {text}", where=name, fix="Look at the log of its node.")
    try:
        return cls._response_class().deserialize(answer)
    except Exception as error:  # genpy's own
        problem = f"the response is not valid for {cls._type}: {error}"
        raise LinkError(problem, where=name, fix="Look at the log of its node.") from error


def service_type(name: str, uri: str, *, timeout: float) -> str:
    """Return the type of a service; raise a `LinkError` if it cannot be reached or does not answer in time."""
    with _connected(name, uri, timeout) as connection:
        return _greet(connection, {"service": name, "md5sum": "*", "probe": "1"}).get("type", "")


@contextmanager
def _connected(name: str, uri: str, timeout: float) -> Iterator[_Connection]:
    connection = None
    try:
        connection = _Connection(uri, timeout)
        yield connection
        connection.note_answer()
    except TimeoutError as error:
        raise service_timeout(name, timeout) from error
    except (OSError, struct.error, ValueError) as error:  # what the master has as its address may be none
        fix = "Restart its node."
        raise LinkError(f"the service cannot be reached at {uri}: {error}", where=name, fix=fix) from error
    finally:
        if connection is not None:
            connection.close()


def _greet(connection: _Connection, fields: Mapping[str, str]) -> dict[str, str]:
    header = [f"{name}={value}".encode() for name, value in {"callerid": _CALLER, **fields}.items()]
    connection.send(b"".join(_LENGTH.pack(len(field)) + field for field in header))
    return _fields(connection.block())


def _fields(data: bytes) -> dict[str, str]:
    found, at = {}, 0
    while at < len(data):
        (length,) = _LENGTH.unpack_from(data, at)
        at += _LENGTH.size
        name, _, value = data[at : at + length].decode(errors="replace").partition("=")
        found[name] = value
        at += length
    return found


def _refused(name: str, uri: str, wanted: str, refused: str) -> LinkError:
    if not any(sign in refused for sign in _SIGNS_OF_ANOTHER_TYPE):
        return LinkError(f"the service refuses: {refused}", where=name, fix="Look at the log of its node.")
    true = service_type(name, uri, timeout=1.0)
    if true == wanted:
        problem = f"the service's node has another version of {wanted}"
        return LinkError(problem, where=name, fix="Install the same version of its package on both machines.")
    return wrong_service_type(name, true, wanted)
