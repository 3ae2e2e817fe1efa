"""The ROS message and service types: their fields, definitions and digests, and serialisation in both directions."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import LinkError, nearest
from robot_runner.core.links.robot import Encoding
from robot_runner.ros.action_types import is_action_part, whole_action
from robot_runner.ros.message_codec import FILLER, MessageCodec, NodeKind
from robot_runner.ros.shapes import ROS1_KINDS, Field, Shape, UpTo, plain_type
from robot_runner.ros.type_store import (
    LATEST,
    definition_text,
    filled_store,
    given_defaults,
    service_part,
    stored_name,
    type_hash,
    with_definition,
)

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

#: Type stores lose the defaults that definitions give: those of ROS 2's standard messages, as far as they are not zero.
#: That of a satellite fix came with Jazzy, and so did the constant for an unknown fix.
STANDARD_DEFAULTS = {("geometry_msgs/msg/Quaternion", "w"): 1.0}
_SATELLITE_FIX, _UNKNOWN_FIX = "sensor_msgs/msg/NavSatStatus", ("STATUS_UNKNOWN", "int8", -2)

_ROS1_STAMPS = {"builtin_interfaces/msg/Time": "time", "builtin_interfaces/msg/Duration": "duration"}


class TypeCatalogue:
    """The types of one distribution of ROS, with those that the user's files add.

    Each method that takes the name of a type raises a `LinkError` where there is none of this name.

    Example:
        >>> catalogue = TypeCatalogue.of(2)
        >>> catalogue.shape("geometry_msgs/Vector3").names
        ('x', 'y', 'z')
        >>> data = catalogue.serialise("std_msgs/String", {"data": "hi"}, Encoding.CDR)
        >>> catalogue.deserialise("std_msgs/String", data, Encoding.CDR)
        {'data': 'hi'}
    """

    def __init__(
        self, store: Typestore, generation: int, defaults: Mapping[tuple[str, str], Any] = MappingProxyType({})
    ) -> None:
        self._store = store
        self._defaults = {**(STANDARD_DEFAULTS if generation == 2 else {}), **defaults}  # noqa: PLR2004  # of ROS
        if _UNKNOWN_FIX in store.fielddefs.get(_SATELLITE_FIX, ((), ()))[0]:
            self._defaults[_SATELLITE_FIX, "status"] = _UNKNOWN_FIX[2]
        self._generation = generation
        self._codec = MessageCodec(store, signed_bytes=generation == 1)
        self._shapes: dict[str, Shape] = {}

    @classmethod
    def of(cls, generation: int, distro: str | None = None, extra: Sequence[Path] = ()) -> TypeCatalogue:
        """Return the catalogue of a distribution; it is made once.

        Args:
            generation: of ROS, 1 or 2.
            distro: such as `humble`; None is noetic or jazzy.
            extra: `.msg`, `.srv` and `.action` files, or folders that hold some.

        Raises:
            LinkError: `rosbags` is not installed, there is no such distribution, or a file cannot be used.
        """
        known = LATEST if generation == 2 and distro is None else distro  # noqa: PLR2004  # of ROS
        return _catalogue(generation, known, tuple(extra))

    def with_definition(self, message_type: str, text: str) -> TypeCatalogue:
        """Return a catalogue that knows one more type, by the text that `definition` returns where it is known."""
        store, defaults = with_definition(self._store, message_type, text)
        return TypeCatalogue(store, self._generation, {**self._defaults, **defaults})

    def shape(self, message_type: str) -> Shape:
        """Return the fields of a message type."""
        return self._shape(self._known(message_type))

    def request(self, service_type: str) -> Shape:
        """Return the fields of a service type's request."""
        return self._shape(self._known_service(service_type, "Request"))

    def response(self, service_type: str) -> Shape:
        """Return the fields of a service type's response."""
        return self._shape(self._known_service(service_type, "Response"))

    def definition(self, message_type: str) -> str:
        """Return the text of a definition, followed by those of the types of its fields, as bags store it."""
        return definition_text(self._store, self._known(message_type), self._generation)

    def digest(self, message_type: str) -> str:
        """Return the digest of a type's version: the md5 sum of ROS 1, the type hash (RIHS01) of ROS 2."""
        name = self._known(message_type)
        if self._generation == 1:
            return self._store.generate_msgdef(name, ros_version=1)[1]
        return type_hash(self._store, name)

    def serialise(self, message_type: str, message: Mapping[str, Any], encoding: Encoding) -> bytes:
        """Return the bytes of a complete message, as `shapes.completed` makes it; CDR is little endian.

        A request or response is of the type `std_srvs/Trigger_Request` or `…_Response`.

        Raises:
            LinkError: the message does not follow its definition.
        """
        name = self._known(message_type)
        try:
            made = self._codec.as_object(name, message)
            if encoding is Encoding.ROS1:
                return bytes(self._store.serialize_ros1(made, name))
            return bytes(self._store.serialize_cdr(made, name, little_endian=True))
        except (KeyError, TypeError, AttributeError, ValueError, OverflowError, struct.error) as error:
            problem = f"the message cannot be laid out as its definition says: {error}"
            raise LinkError(problem, where=message_type, fix="Give each field a value of its kind.") from error

    def deserialise(self, message_type: str, data: bytes | memoryview, encoding: Encoding) -> dict[str, Any]:
        """Return the message from its bytes; raise a `LinkError` if the bytes are not of this type."""
        name = self._known(message_type)
        read = self._store.deserialize_ros1 if encoding is Encoding.ROS1 else self._store.deserialize_cdr
        try:
            return self._codec.as_mapping(name, read(data, name))
        except (_serde_error(), AssertionError, IndexError, ValueError, struct.error) as error:
            fix = "Name the ROS distribution that sent it, or give its definition, in the options of the robot."
            if isinstance(error.__cause__, UnicodeDecodeError):
                fix = f"Have its node send texts in UTF-8, as ROS has them. Where it does: {fix}"
            problem = f"{len(data)} bytes are not a message of this type: {error}"
            raise LinkError(problem, where=message_type, fix=fix) from error

    def _shape(self, name: str) -> Shape:
        if name not in self._shapes:
            fields = [
                self._field(name, field, description)
                for field, description in self._store.fielddefs[name][1]
                if field != FILLER
            ]
            self._shapes[name] = Shape(plain_type(name), tuple(fields))
        return self._shapes[name]

    def _field(self, owner: str, name: str, description: Any) -> Field:
        kind, detail = description
        default = self._defaults.get((owner, name))
        if kind in {NodeKind.BASIC, NodeKind.TYPE}:
            return Field(name, self._kind(kind, detail), default=default, limit=_text_limit(kind, detail))
        (inner_kind, inner), number = detail
        count = number if kind == NodeKind.ARRAY else UpTo(number or None)
        return Field(name, self._kind(inner_kind, inner), count, default, _text_limit(inner_kind, inner))

    def _kind(self, kind: int, detail: Any) -> str | Shape:
        if kind == NodeKind.BASIC:
            basic: str = detail[0]
            return ROS1_KINDS.get(basic, basic) if self._generation == 1 else basic
        if self._generation == 1 and detail in _ROS1_STAMPS:
            return _ROS1_STAMPS[detail]
        return self._shape(detail)

    def _known(self, name: str) -> str:
        spelt = stored_name(name)
        if spelt in self._store.fielddefs:
            return spelt
        part = stored_name(name, "srv")  # a request or response
        if part in self._store.fielddefs:
            return part
        if is_action_part(name):
            raise _unknown(whole_action(name), "action", self._actions())
        raise _unknown(name, "message", [plain_type(known) for known in self._store.fielddefs if "/msg/" in known])

    def _known_service(self, name: str, part: str) -> str:
        spelt = service_part(plain_type(name), part)
        if spelt in self._store.fielddefs:
            return spelt
        if is_action_part(plain_type(name)):
            raise _unknown(whole_action(plain_type(name)), "action", self._actions())
        services = {plain_type(known).rpartition("_")[0] for known in self._store.fielddefs if "/srv/" in known}
        raise _unknown(name, "service", sorted(services))

    def _actions(self) -> list[str]:
        return sorted({whole_action(plain_type(known)) for known in self._store.fielddefs if "/action/" in known})


@lru_cache(maxsize=8)
def _catalogue(generation: int, distro: str | None, extra: tuple[Path, ...]) -> TypeCatalogue:
    return TypeCatalogue(filled_store(generation, distro, extra), generation, given_defaults(generation, extra))


def _text_limit(kind: int, detail: Any) -> int | None:
    return (detail[1] or None) if kind == NodeKind.BASIC else None


def _serde_error() -> type[Exception]:
    from rosbags.serde import SerdeError  # noqa: PLC0415  # an extra, loaded by now

    return SerdeError


def _unknown(name: str, kind: str, known: Sequence[str]) -> LinkError:
    near = nearest(name, known)
    suffix = {"message": "msg", "service": "srv"}.get(kind, kind)
    fix = (
        f"Did you mean {near!r}?" if near else f"Name the .{suffix} file that defines it in the robot's option types=."
    )
    return LinkError(f"there is no {kind} type {name!r}", where=name, fix=fix)
