"""Makes the DDS types of messages at run time, whose samples go through as the bytes that they are on the wire."""

from __future__ import annotations

import types
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from cyclonedds.idl import IdlStruct
from cyclonedds.idl import types as idl

from robot_runner.links.dds.names import wire_type_name
from robot_runner.links.message_codec import FILLER
from robot_runner.links.shapes import Shape

if TYPE_CHECKING:
    from robot_runner.links.shapes import Field

__all__ = ["HEADER_BYTES", "RawSample", "WireType", "service_wire_type", "topic_wire_type"]

WireType = type[Any]

#: CDR begins with two bytes for the encoding and two for options.
HEADER_BYTES = 4

_PRIMITIVES: dict[str, Any] = {
    "bool": bool,
    "byte": idl.byte,
    "char": idl.uint8,  # ROS 2 means an unsigned octet by it
    "string": str,
    "wstring": str,
    "float32": idl.float32,
    "float64": idl.float64,
    **{f"{sign}int{bits}": getattr(idl, f"{sign}int{bits}") for sign in ("", "u") for bits in (8, 16, 32, 64)},
}

# They are indexed like generic types, and are none.
_ARRAY: Any = idl.array
_SEQUENCE: Any = idl.sequence
_BOUNDED_STRING: Any = idl.bounded_str

#: How rmw_cyclonedds leads requests and replies in: who asked, and which of its questions it is.
_SERVICE_HEADER = {"guid": idl.uint64, "seq": idl.int64}


class RawSample:
    """A sample as its bytes, with the information that comes with it.

    Attributes:
        data: CDR, with its header of four bytes.
        sample_info: set by the reader.
    """

    __slots__ = ("data", "sample_info")

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.sample_info: Any = None


@lru_cache(maxsize=512)
def topic_wire_type(shape: Shape) -> WireType:
    """Return the DDS type of a message type; its instances are made of a sample's bytes."""
    return _structure(shape, wire_type_name(shape.type_name), {})


@lru_cache(maxsize=128)
def service_wire_type(shape: Shape) -> WireType:
    """Return the DDS type of a request or response, whose bytes begin with the header of services."""
    return _structure(shape, wire_type_name(shape.type_name, "srv"), _SERVICE_HEADER)


def _structure(shape: Shape, type_name: str, leading: dict[str, Any]) -> WireType:
    members = leading | {field.name: _member(field) for field in shape.fields}
    if not shape.fields:
        members[FILLER] = idl.uint8

    def body(namespace: dict[str, Any]) -> None:
        namespace["__annotations__"].update(members)
        # The bytes come from a compiled serialiser of the type catalogue: that of cyclonedds walks the type for each
        # sample, several times slower, and would decode what is to be recorded as it is.
        namespace["__init__"] = _keep
        namespace["serialize"] = _bytes_of
        namespace["deserialize"] = staticmethod(RawSample)
        namespace["deserialize_key"] = staticmethod(RawSample)

    name = type_name.rpartition("::")[2]
    return types.new_class(name, (IdlStruct,), {"typename": type_name.replace("::", ".")}, body)


def _keep(self: Any, data: bytes) -> None:
    self.data = data


def _bytes_of(self: Any, **_: Any) -> bytes:
    data: bytes = self.data
    return data


def _member(field: Field) -> Any:
    one: Any = _one(field)
    if field.count is None:
        return one
    if isinstance(field.count, int):
        return _ARRAY[one, field.count]
    return _SEQUENCE[one] if field.count.limit is None else _SEQUENCE[one, field.count.limit]


def _one(field: Field) -> Any:
    if isinstance(field.kind, Shape):
        return topic_wire_type(field.kind)
    if field.limit is not None:
        return _BOUNDED_STRING[field.limit]
    return _PRIMITIVES[field.kind]
