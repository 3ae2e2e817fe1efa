"""Converts messages between plain mappings and objects of a `rosbags` type store; converters are made once a type."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

    Converter = Callable[[Any], Any]

#: The field of a type without fields in ROS 2, such as one of constants only: IDL allows no empty structure.
FILLER = "structure_needs_at_least_one_member"

#: Arrays of these are `bytes` in a mapping, as in the client libraries of ROS.
OCTETS = frozenset({"uint8", "byte", "char", "octet"})


class NodeKind:
    """The kinds of fields in a type store: the numbers of `rosbags.interfaces.Nodetype`."""

    BASIC = 1
    TYPE = 2
    ARRAY = 3
    SEQUENCE = 4


class MessageCodec:
    """Converters for the types of one store, each made at the first use of its type.

    Example:
        >>> from rosbags.typesys import Stores, get_typestore
        >>> codec = MessageCodec(get_typestore(Stores.ROS2_JAZZY))
        >>> point = codec.as_object("geometry_msgs/msg/Point", {"x": 1.0, "y": 2.0, "z": 0.0})
        >>> codec.as_mapping("geometry_msgs/msg/Point", point)
        {'x': 1.0, 'y': 2.0, 'z': 0.0}
    """

    def __init__(self, store: Typestore, *, signed_bytes: bool = False) -> None:
        """Make a codec for objects of this type store, without converters.

        With `signed_bytes` a `byte` is an int8, as in ROS 1 and in type stores, and not an octet, as in ROS 2.
        """
        self._store = store
        self._octets = OCTETS - {"byte"} if signed_bytes else OCTETS
        self._signed_alone = frozenset() if signed_bytes else frozenset({"byte"})
        self._reader: Callable[[str], Converter] = cache(self._new_reader)
        self._maker: Callable[[str], Converter] = cache(self._new_maker)

    def as_mapping(self, name: str, message: object) -> dict[str, Any]:
        """Return a message object of the store as a mapping; arrays are lists, those of octets `bytes`."""
        mapping: dict[str, Any] = self._reader(name)(message)
        return mapping

    def as_object(self, name: str, message: Mapping[str, Any]) -> object:
        """Return a complete mapping as an object of the store, ready to be serialised."""
        return self._maker(name)(message)

    def _fields(self, name: str) -> list[tuple[str, str, Any]]:
        """Return name, Python attribute and description of each field."""
        attributes = self._store.get_msgdef(name).fields
        fields = self._store.fielddefs[name][1]
        pairs = zip(fields, attributes, strict=True)
        return [(field, attribute, description) for (field, description), (attribute, _) in pairs if field != FILLER]

    def _new_reader(self, name: str) -> Converter:
        parts = [(field, attribute, self._field_reader(kind)) for field, attribute, kind in self._fields(name)]
        plain = [(field, attribute) for field, attribute, convert in parts if convert is None]
        if len(plain) == len(parts):
            return lambda message: {field: getattr(message, attribute) for field, attribute in plain}
        converted = [(field, attribute, convert or _same) for field, attribute, convert in parts]
        return lambda message: {field: convert(getattr(message, attribute)) for field, attribute, convert in converted}

    def _field_reader(self, description: Any) -> Converter | None:
        kind, detail = description
        if kind == NodeKind.BASIC:
            return _octet_of if detail[0] in self._signed_alone else None
        if kind == NodeKind.TYPE:
            return self._reader(detail)
        (kind, inner), _ = detail
        if kind == NodeKind.TYPE:
            convert = self._reader(inner)
            return lambda items: [convert(item) for item in items]
        if inner[0] == "string":
            return list
        return bytes if inner[0] in self._octets else _list_of

    def _new_maker(self, name: str) -> Converter:
        parts = [(field, self._field_maker(kind) or _same) for field, _, kind in self._fields(name)]
        make: Callable[..., object] = self._store.types[name]
        return lambda message: make(*[convert(message[field]) for field, convert in parts])

    def _field_maker(self, description: Any) -> Converter | None:
        kind, detail = description
        if kind == NodeKind.BASIC:
            return _signed_of if detail[0] in self._signed_alone else None
        if kind == NodeKind.TYPE:
            return self._maker(detail)
        (kind, inner), _ = detail
        if kind == NodeKind.TYPE:
            convert = self._maker(inner)
            return lambda items: [convert(item) for item in items]
        if inner[0] == "string":
            return None
        return _array_maker("uint8" if inner[0] in self._octets else inner[0])


def _array_maker(element: str) -> Converter:
    import numpy as np  # noqa: PLC0415  # comes with rosbags, an extra

    def make(items: Any) -> Any:
        if isinstance(items, bytes | bytearray | memoryview):
            return np.frombuffer(items, dtype=np.uint8)
        return np.array(items, dtype=element)

    return make


def _same(value: object) -> object:
    return value


def _signed_of(octet: int) -> int:
    return octet - 256 if octet > 127 else octet  # noqa: PLR2004  # two's complement


def _octet_of(number: int) -> int:
    return number & 0xFF


def _list_of(array: Any) -> list[Any]:
    items: list[Any] = array.tolist()
    return items
