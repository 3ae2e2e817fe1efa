"""The WebSocket of a rosbridge: JSON and CBOR frames, fragments, and messages in the spelling of the protocol."""

from __future__ import annotations

import atexit
import base64
import binascii
import json
import math
import socket
import ssl
import struct
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any
from weakref import WeakSet

from robot_runner.core.errors import LinkError
from robot_runner.ros.rosbridge_security import secure_socket, speaks_tls
from robot_runner.ros.shapes import BYTE_KINDS, STAMPS, UNBOUNDED, Field, Shape
from robot_runner.ros.undelivered import drop_undelivered

if TYPE_CHECKING:
    from cbor2 import CBORTag
    from websockets.sync.client import ClientConnection

    from robot_runner.ros.graph_addresses import RosbridgeAddress

#: The elements of a typed array by its tag; 4 more is little endian. Those of octets (64, 68) stay bytes.
_TYPED = MappingProxyType(
    dict(zip((65, 66, 67, 69, 70, 71), (">H", ">I", ">Q", "<H", "<I", "<Q"), strict=True))
    | dict(zip((72, 73, 74, 75, 77, 78, 79), (">b", ">h", ">i", ">q", "<h", "<i", "<q"), strict=True))
    | dict(zip((80, 81, 82, 84, 85, 86), (">e", ">f", ">d", "<e", "<f", "<d"), strict=True))
)


def read(data: bytes) -> Any:
    """Decode CBOR, in which a rosbridge sends what JSON cannot; typed arrays are lists, those of octets `bytes`.

    Raises:
        ValueError: the bytes are not CBOR.

    Example:
        >>> read(bytes.fromhex("a16161d84d4401000200"))
        {'a': [1, 2]}
    """
    from cbor2 import CBORDecodeError, loads  # noqa: PLC0415  # an extra, only where it is asked for

    try:
        return loads(data, tag_hook=_untagged)
    except CBORDecodeError as error:
        raise ValueError(f"{len(data)} bytes are not CBOR: {error}") from error


def _untagged(tagged: CBORTag, _is_immutable: bool) -> Any:
    layout = _TYPED.get(tagged.tag)
    return tagged.value if layout is None else _numbers(layout, tagged.value)


def _numbers(layout: str, data: bytes) -> list[Any]:
    count = len(data) // struct.calcsize(layout)
    return list(struct.unpack(f"{layout[0]}{count}{layout[1]}", data))


#: An operation in more fragments than this is a broken one, and would only fill the memory.
_MOST_FRAGMENTS = 100_000
#: The largest frame, bytes, and the most that fragments may hold together: an image of 4096 x 2160 pixels has 35 MB.
LARGEST_FRAME = 64 << 20
#: So many frames wait in the WebSocket before the server has to.
_MOST_FRAMES = 16
#: So many operations may be incomplete at a time; of a server that drops fragments, the oldest are forgotten.
_MOST_UNFINISHED = 100


def as_json(operation: dict[str, Any]) -> str:
    """Return an operation as it is sent. NaN and infinity are sent as Python writes them, which servers read."""
    return json.dumps(operation, separators=(",", ":"), ensure_ascii=False)


class FrameReader:
    r"""Reads frames, and keeps the fragments of operations that are not whole yet.

    Example:
        >>> reader = FrameReader()
        >>> reader.read('{"op": "fragment", "id": "a", "num": 1, "total": 2, "data": "status\\"}"}')
        >>> reader.read('{"op": "fragment", "id": "a", "num": 0, "total": 2, "data": "{\\"op\\": \\""}')
        {'op': 'status'}
    """

    def __init__(self) -> None:
        self._parts: dict[str, dict[int, str]] = {}
        self._held = 0

    def read(self, frame: str | bytes) -> dict[str, Any] | None:
        """Return the operation that the frame is, or completes; None if more fragments are to come.

        Raises:
            ValueError: it is not an operation of the protocol, or more fragments wait than the memory should hold.
        """
        try:
            operation = read(frame) if isinstance(frame, bytes) else json.loads(frame)
        except RecursionError as error:
            raise ValueError("an operation is nested too deeply") from error
        if not isinstance(operation, dict) or not isinstance(operation.get("op"), str):
            raise ValueError(f"{str(frame)[:80]!r} has no field 'op'")  # noqa: TRY004 - data, not an argument
        return self._whole(operation) if operation["op"] == "fragment" else operation

    def _whole(self, fragment: dict[str, Any]) -> dict[str, Any] | None:
        number, total = fragment.get("num"), fragment.get("total")
        text, name = fragment.get("data"), str(fragment.get("id"))
        if not isinstance(number, int) or not isinstance(total, int) or not isinstance(text, str):
            raise ValueError("a fragment lacks 'num', 'total' or 'data'")  # noqa: TRY004 - data, not an argument
        if not 0 <= number < total <= _MOST_FRAGMENTS:
            raise ValueError(f"fragment {number} of {total}")
        parts = self._parts.setdefault(name, {})
        self._held += len(text) - len(parts.get(number, ""))
        parts[number] = text
        if len(parts) < total:
            while len(self._parts) > _MOST_UNFINISHED or self._held > LARGEST_FRAME:
                self._forget(next(iter(self._parts)))
            return None
        self._forget(name)
        if any(index not in parts for index in range(total)):
            raise ValueError(f"fragments of {name!r:.80} do not agree how many they are")
        return self.read("".join(parts[index] for index in range(total)))

    def _forget(self, name: str) -> None:
        self._held -= sum(map(len, self._parts.pop(name).values()))


_FLOATS = frozenset({"float32", "float64"})
_NO_ELEMENTS = frozenset({*STAMPS, "string"})
#: JSON has no spelling for NaN and the infinities, and a server writes null for all three.
_NOT_A_NUMBER = math.nan


def to_protocol(shape: Shape, message: Mapping[str, Any]) -> dict[str, Any]:
    """Return a complete message in the protocol's form: bytes in base64, ROS 1 times as `secs` and `nsecs`."""
    return {field.name: _out(field, message[field.name]) for field in shape.fields}


def from_protocol(shape: Shape, message: object, *, where: str) -> dict[str, Any]:
    """Return a message of the protocol as a plain mapping; raise a `LinkError` if it is not a message of this type."""
    if not isinstance(message, Mapping):
        raise _other(shape, where, f"{message!r} is not a mapping")
    try:
        return {field.name: _in(field, message[field.name], where) for field in shape.fields}
    except (KeyError, TypeError, ValueError, AttributeError, binascii.Error) as error:
        raise _other(shape, where, f"{type(error).__name__} {error}") from error


def passes_as_cbor(shape: Shape) -> bool:
    """Whether a server of ROS 1 can write messages of this type as CBOR; of another type it sends none.

    It takes arrays of a fixed length, and those of texts and times, for messages: cbor_conversion.py of
    rosbridge_library 0.11.
    """
    return all(
        passes_as_cbor(field.kind)
        if isinstance(field.kind, Shape)
        else field.count is None or (field.count == UNBOUNDED and field.kind not in _NO_ELEMENTS)
        for field in shape.fields
    )


def _out(field: Field, value: Any) -> Any:
    if field.count is None:
        return _out_one(field.kind, value)
    if isinstance(value, bytes):
        return base64.b64encode(value).decode("ascii")
    return value if field.kind in _FLOATS else [_out_one(field.kind, each) for each in value]


def _out_one(kind: str | Shape, value: Any) -> Any:
    if isinstance(kind, Shape):
        return to_protocol(kind, value)
    return {"secs": value["sec"], "nsecs": value["nanosec"]} if kind in STAMPS else value


def _in(field: Field, value: Any, where: str) -> Any:
    if field.count is None:
        return _in_one(field.kind, value, where)
    if field.kind in BYTE_KINDS:
        return base64.b64decode(value) if isinstance(value, str) else bytes(value)
    return [_in_one(field.kind, each, where) for each in value]


def _in_one(kind: str | Shape, value: Any, where: str) -> Any:
    if isinstance(kind, Shape):
        return from_protocol(kind, value, where=where)
    if kind in STAMPS:
        seconds = value["secs"] if "secs" in value else value["sec"]
        return {"sec": int(seconds), "nanosec": int(value["nsecs"] if "nsecs" in value else value["nanosec"])}
    if kind in _FLOATS:
        return _NOT_A_NUMBER if value is None else float(value)
    return value


def _other(shape: Shape, where: str, why: str) -> LinkError:
    fix = "Name the robot's distribution, or give its definition: rosbridge://robot:9090?distro=…&types=…."
    return LinkError(f"the message is not a {shape.type_name}: {why}", where=where, fix=fix)


_CLOSE_TIMEOUT = 2.0
#: How long the network may take nothing of what is sent before the connection is given up, s: as a silent one is.
_SENDING = 5.0

#: For how long the system tries to deliver what was sent, s (Linux): longer than a session takes to give up.
_DELIVERING = 10.0


def deliver_late(connection: ClientConnection) -> None:
    """Have the system deliver what is sent, however long the network is away, also after this process was killed."""
    drop_undelivered(connection.socket, is_dropped=False)
    _deliver_for(connection, 0)  # as long as it usually does, which is minutes


def _deliver_for(connection: ClientConnection, seconds: float) -> None:
    if hasattr(socket, "TCP_USER_TIMEOUT"):
        with suppress(OSError):  # it was closed meanwhile
            connection.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(seconds * 1000))


#: What is connected now.
_connected: WeakSet[socket.socket] = WeakSet()


@atexit.register
def _deliver_all() -> None:
    """Have the system deliver what a program has sent that ends without closing its links."""
    for each in list(_connected):
        drop_undelivered(each, is_dropped=False)


def _prepared(connection: ClientConnection, closing: ExitStack) -> ClientConnection:
    """Have `closing` close a connection; only where this process is killed, the system drops what is undelivered."""
    _deliver_for(connection, _DELIVERING)
    drop_undelivered(connection.socket)
    _connected.add(connection.socket)
    closing.enter_context(connection)
    closing.callback(drop_undelivered, connection.socket, is_dropped=False)
    return connection


def _bounded(connection: ClientConnection) -> ClientConnection:
    """Set a timeout for sending: a send that hangs would block all later ones, the stop command among them."""
    seconds = struct.pack("ll", int(_SENDING), int(_SENDING % 1 * 1e6))
    with suppress(OSError):  # where times have another form (32 bits), sending has no bound
        connection.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, seconds)
    return connection


def connect(address: RosbridgeAddress, timeout: float, closing: ExitStack, *, where: str) -> ClientConnection:
    """Open the WebSocket of a rosbridge within a timeout (s), or raise a `LinkError`; `closing` closes it."""
    from websockets import exceptions  # noqa: PLC0415  # an extra, only where it is asked for
    from websockets.sync.client import connect as open_connection  # noqa: PLC0415

    security = address.security
    opened = partial(
        open_connection,
        address.uri.replace("wss://", "ws://", 1),
        additional_headers=security.headers(),
        open_timeout=timeout,
        close_timeout=_CLOSE_TIMEOUT,
        ping_interval=None,  # the session asks: it has something to say before it gives up
        compression=None,  # it would cost more on the robot than it saves on the network
        max_size=LARGEST_FRAME,
        max_queue=_MOST_FRAMES,
        proxy=None,
    )
    try:
        if not security.is_tls:
            return _prepared(_bounded(opened()), closing)
        # Our own socket: websockets would send our credentials before a certificate's fingerprint can be seen.
        secure = secure_socket(address.host, address.port, security, timeout, _SENDING, where=where)
        return _prepared(opened(sock=secure), closing)
    except (socket.gaierror, UnicodeError) as error:  # a part of the name is empty, or has more than 63 characters
        fix = "Correct the robot's address, or give it as a number."
        raise LinkError(f"the host {address.host!r} is not known", where=where, fix=fix) from error
    except TimeoutError as error:
        fix = "Check whether the robot is on and in this network, and whether a firewall drops the port."
        raise LinkError(f"nothing answers there within {timeout:g} s", where=where, fix=fix) from error
    except ssl.SSLError as error:
        raise _no_rosbridge(error, address, where) from error
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        fix = "Start it on the robot: roslaunch (ROS 2: ros2 launch) rosbridge_server, or correct the address."
        raise LinkError(f"the rosbridge cannot be reached: {reason}", where=where, fix=fix) from error
    except exceptions.InvalidStatus as error:
        raise _refusal(error.response.status_code, address, where) from error
    except (exceptions.InvalidHandshake, exceptions.InvalidURI, exceptions.ConnectionClosed, EOFError) as error:
        raise _no_rosbridge(error, address, where) from error


#: What HTTP servers and proxies answer without valid credentials (RFC 9110).
_UNAUTHORISED, _FORBIDDEN = 401, 403
#: How long a server that does not answer as one may take to show that it speaks TLS, s.
_TLS_SECONDS = 1.0


def _refusal(status: int, address: RosbridgeAddress, where: str) -> LinkError:
    if status not in {_UNAUTHORISED, _FORBIDDEN}:
        fix = "Name the port and the path of the rosbridge server: 9090, if not started elsewhere."
        return LinkError(f"what listens there is not a rosbridge: it answers HTTP {status}", where=where, fix=fix)
    if address.security.sends_secrets:
        fix = "Look at the variable or the file that the address names, and at the proxy's log."
        return LinkError(f"the server refuses our credentials (HTTP {status})", where=where, fix=fix)
    fix = "Name where they are: ?user=NAME&password_env=VARIABLE, or ?token_env=VARIABLE."
    return LinkError(f"the server asks for credentials (HTTP {status})", where=where, fix=fix)


def _no_rosbridge(error: Exception, address: RosbridgeAddress, where: str) -> LinkError:
    if not address.security.is_tls and speaks_tls(address.host, address.port, _TLS_SECONDS):
        fix = f"Write rosbridge+tls://{address.place}."
        return LinkError("the server speaks TLS, and the address is one without", where=where, fix=fix)
    hung_up = any(isinstance(each, send_errors()) for each in (error, error.__cause__, error.__context__))
    if address.security.is_tls and hung_up:
        # With TLS 1.3 a server sees a client's certificate after the handshake, and hangs up without an HTTP response.
        given = "and refuses ours" if address.security.cert else "and none is given"
        fix = "Name one that its authority has signed, with its key: ?cert=me.pem&key=me.key."
        problem = f"the server hangs up after the TLS handshake, as one does that asks for a certificate {given}"
        return LinkError(problem, where=where, fix=fix)
    fix = "Name the port of the rosbridge server: 9090, if not started elsewhere."
    return LinkError(f"what listens there is not a rosbridge: {error}", where=where, fix=fix)


def send_errors() -> tuple[type[Exception], ...]:
    """Return the exceptions of a lost connection."""
    from websockets.exceptions import ConnectionClosed  # noqa: PLC0415  # an extra, loaded by now

    return (ConnectionClosed, OSError, EOFError)
