"""Replies of services as RTPS messages carry them, each with the request that it answers.

Source: OMG DDSI-RTPS 2.5, chapters 8.3 and 9.4; OMG DDS-RPC 1.0, 7.8.2, for the identity of the request.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import BinaryIO, NamedTuple

_PREFIX = slice(8, 20)  # of the sender's GUID, in the header of a message
_HEADER_BYTES = 20
_GUID_BYTES, _PREFIX_BYTES = 16, 12
_UNKNOWN, _ANY_READER = bytes(_PREFIX_BYTES), bytes(4)

# Kinds of submessages.
_HEARTBEAT, _INFO_SOURCE, _INFO_DESTINATION, _DATA, _DATA_FRAG = 0x07, 0x0C, 0x0E, 0x15, 0x16
#: Those without content may have the length 0, which otherwise means "up to the end of the message".
_WITHOUT_CONTENT = frozenset({0x01, 0x09})
_LITTLE_ENDIAN, _HAS_INLINE_QOS, _HAS_DATA = 0x01, 0x02, 0x04

#: `PID_RELATED_SAMPLE_IDENTITY` of DDS-RPC, and what Fast DDS wrote before it took that (fastdds: ParameterId_t).
_RELATED = frozenset({0x0083, 0x800F})
_SENTINEL = 0x0001
_IDENTITY_BYTES = 24

#: What is put together at a time is not larger, B: that much memory anybody in the network could make us use.
_LARGEST = 256 * 2**20
#: A fragment is not smaller, B; each is kept account of.
_SMALLEST_FRAGMENT = 256

#: A capture: https://wiki.wireshark.org/Development/LibpcapFileFormat, in this machine's order of bytes.
_CAPTURE_BYTES = 24
_CAPTURED = struct.Struct("=IIII")
_IP_AND_UDP_BYTES = 28


class RequestId(NamedTuple):
    """Identifies a request: by the GUID of its writer (16 bytes), and its number among the writer's, from 1."""

    client: bytes
    number: int


def captured_messages(capture: BinaryIO) -> Iterator[bytes]:
    """Read the UDP payloads of a capture of IPv4 packets without options, as Cyclone DDS writes it, until it ends."""
    capture.read(_CAPTURE_BYTES)
    while len(head := capture.read(_CAPTURED.size)) == _CAPTURED.size:
        packet = capture.read(_CAPTURED.unpack(head)[2])
        yield packet[_IP_AND_UDP_BYTES:]


@dataclass(slots=True)
class _Fragments:
    """A sample that comes in pieces, in any order, and some of them twice."""

    request: RequestId
    data: bytearray
    missing: set[int]


@dataclass(slots=True)
class RtpsReplies:
    """Finds the replies to requests of ours in RTPS messages.

    Args:
        is_awaited: whether a request is ours, and not answered yet.
        take: called with the request and the reply to it: CDR with its header of four bytes.
        meet: called with the GUIDs of a writer and of a reader here when the writer tells this one reader what it has
            sent; by then it sends the reader all that follows.
    """

    is_awaited: Callable[[RequestId], bool]
    take: Callable[[RequestId, bytes], None]
    meet: Callable[[bytes, bytes], None]
    _fragments: dict[tuple[bytes, bytes], _Fragments] = field(default_factory=dict)

    def read(self, message: bytes, receiver: bytes) -> None:
        """Read a message that came to the participant whose GUID begins with the 12 bytes `receiver`.

        What is not of RTPS, or cut short, is left out: anybody in the network may send it.
        """
        if message[:4] != b"RTPS" or len(message) < _HEADER_BYTES:
            return
        source, destination, at = message[_PREFIX], receiver, _HEADER_BYTES
        try:
            while at + 4 <= len(message):
                kind, flags = message[at], message[at + 1]
                order = "<" if flags & _LITTLE_ENDIAN else ">"
                length = struct.unpack_from(f"{order}H", message, at + 2)[0]
                is_last = length == 0 and kind not in _WITHOUT_CONTENT
                body = message[at + 4 : None if is_last else at + 4 + length]
                if len(body) < length:
                    return
                if kind == _INFO_SOURCE:
                    source = body[8:20]
                elif kind == _INFO_DESTINATION:
                    destination = receiver if body[:_PREFIX_BYTES] == _UNKNOWN else body[:_PREFIX_BYTES]
                elif kind == _HEARTBEAT and destination == receiver and body[:4] != _ANY_READER:
                    self.meet(source + body[4:8], destination + body[:4])
                elif kind == _DATA and flags & _HAS_INLINE_QOS and flags & _HAS_DATA:
                    self._read_data(body, order)
                elif kind == _DATA_FRAG and flags & _HAS_INLINE_QOS:
                    self._read_fragments(source, body, order)
                at = len(message) if is_last else at + 4 + length
        except struct.error:
            return

    def _read_data(self, body: bytes, order: str) -> None:
        request, at = _related(body, 4 + struct.unpack_from(f"{order}H", body, 2)[0], order)
        if request is not None and self.is_awaited(request):
            self.take(request, body[at:])

    def _read_fragments(self, source: bytes, body: bytes, order: str) -> None:
        request, at = _related(body, 4 + struct.unpack_from(f"{order}H", body, 2)[0], order)
        if request is None or not self.is_awaited(request):
            return
        first, count, size, whole = struct.unpack_from(f"{order}IHHI", body, 20)
        if not (0 < whole <= _LARGEST and size >= _SMALLEST_FRAGMENT and first and count):
            return
        key = source + body[8:12], body[12:20]  # the writer, and its number of the sample
        parts = self._fragments.get(key)
        if parts is None or len(parts.data) != whole:
            # Those whose caller has gone are not waited for any longer.
            self._fragments = {at: each for at, each in self._fragments.items() if self.is_awaited(each.request)}
            if whole + sum(len(each.data) for each in self._fragments.values()) > _LARGEST:
                return
            parts = _Fragments(request, bytearray(whole), set(range(1, -(-whole // size) + 1)))
            self._fragments[key] = parts
        begin = (first - 1) * size
        piece = body[at : at + min(count * size, whole - begin)]
        if begin < whole and len(piece) == min(count * size, whole - begin):
            parts.data[begin : begin + len(piece)] = piece
            parts.missing.difference_update(range(first, first + count))
        if not parts.missing:
            del self._fragments[key]
            self.take(request, bytes(parts.data))


def _related(body: bytes, at: int, order: str) -> tuple[RequestId | None, int]:
    """Return the request that a sample answers, and where its inline QoS ends."""
    request = None
    while True:
        parameter, length = struct.unpack_from(f"{order}HH", body, at)
        at += 4
        if parameter == _SENTINEL:
            return request, at
        if parameter in _RELATED and length >= _IDENTITY_BYTES:
            high, low = struct.unpack_from(f"{order}iI", body, at + _GUID_BYTES)
            request = RequestId(body[at : at + _GUID_BYTES], (high << 32) + low)
        at += length
