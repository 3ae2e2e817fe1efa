"""The types of the robot behind a rosbridge: from the catalogue, and those that it lacks from the robot itself."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from robot_runner.errors import LinkError
from robot_runner.links.robot import Encoding
from robot_runner.links.shapes import UNBOUNDED, Field, Shape, plain_type
from robot_runner.links.type_catalogue import TypeCatalogue
from robot_runner.links.type_store import ROS2_DISTROS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from robot_runner.links.rosbridge.address import RosbridgeAddress
    from robot_runner.links.rosbridge.rosapi import Rosapi

__all__ = ["RobotTypes"]

#: What rosapi calls some kinds of field in ROS 2.
_KINDS = MappingProxyType({"boolean": "bool", "float": "float32", "double": "float64", "octet": "byte"})
_STAMPS = frozenset({"time", "duration"})


class RobotTypes:
    """What the types of one robot are made of.

    Args:
        rosapi: of the robot.
        address: of the robot, which may say more.

    Attributes:
        generation: of the robot's ROS, 1 or 2.

    Raises:
        LinkError: the robot does not tell its generation, or a type definition cannot be used.
    """

    def __init__(self, rosapi: Rosapi, address: RosbridgeAddress) -> None:
        self._rosapi = rosapi
        self.generation, distro = (address.generation, address.distro)
        if self.generation is None:
            self.generation, distro = rosapi.version()
        known = distro if self.generation == 1 or distro in ROS2_DISTROS else None
        self._catalogue = TypeCatalogue.of(self.generation, None if self.generation == 1 else known, address.types)
        self._told: dict[tuple[str, str], Shape] = {}

    @property
    def encoding(self) -> Encoding:
        """How the bytes of messages are laid out."""
        return Encoding.ROS1 if self.generation == 1 else Encoding.CDR

    def wire_name(self, type_name: str, kind: str = "msg") -> str:
        """Return a type's name as the robot's generation spells it; `kind` is `msg` or `srv`."""
        name = plain_type(type_name)
        return name if self.generation == 1 else name.replace("/", f"/{kind}/", 1)

    def is_known_here(self, message_type: str) -> bool:
        """Whether bytes of this type can be read here."""
        try:
            self._catalogue.shape(message_type)
        except LinkError:
            return False
        return True

    def shape(self, message_type: str) -> Shape:
        """Return what a message type is made of.

        Raises:
            LinkError: neither the catalogue nor the robot knows it.
        """
        return self._shape(self._catalogue.shape, message_type, "message_details", "msg")

    def request(self, service_type: str) -> Shape:
        """Return what the request of a service type is made of; raises as `shape`."""
        return self._shape(self._catalogue.request, service_type, "service_request_details", "srv")

    def response(self, service_type: str) -> Shape:
        """Return what the response of a service type is made of; raises as `shape`."""
        return self._shape(self._catalogue.response, service_type, "service_response_details", "srv")

    def definition(self, message_type: str) -> str:
        """Return the text of a type's definition, with those that it is made of.

        Raises:
            LinkError: neither the catalogue nor a topic of the robot has it.
        """
        try:
            return self._catalogue.definition(message_type)
        except LinkError:
            text = self._rosapi.raw_definitions().get(plain_type(message_type))
            if not text:
                raise
            return text

    def serialise(self, message_type: str, message: Mapping[str, Any]) -> bytes:
        """Return the bytes of a complete message; raises a `LinkError` where the catalogue lacks its type."""
        return self._catalogue.serialise(message_type, message, self.encoding)

    def deserialise(self, message_type: str, data: bytes) -> dict[str, Any]:
        """Return the message that these bytes are; raises a `LinkError` where they are none."""
        return self._catalogue.deserialise(message_type, data, self.encoding)

    def _shape(self, look_up: Callable[[str], Shape], name: str, question: str, kind: str) -> Shape:
        told = self._told.get((question, name))
        if told is not None:
            return told
        try:
            return look_up(name)
        except LinkError:
            definitions = self._rosapi.details(question, self.wire_name(name, kind))
            if not definitions:
                raise
            return self._told.setdefault((question, name), _assembled(name, definitions))


def _assembled(name: str, definitions: Sequence[Mapping[str, Any]]) -> Shape:
    """Return the shape that a type and those that it is made of are told to be; the first is the type itself."""
    by_name = {plain_type(each["type"]): each for each in definitions}
    shapes: dict[str, Shape] = {}

    def shape(own: str, told: Mapping[str, Any], under: frozenset[str]) -> Shape:
        if own not in shapes:
            columns = zip(told["fieldnames"], told["fieldtypes"], told["fieldarraylen"], strict=True)
            shapes[own] = Shape(own, tuple(field(*column, under | {own}) for column in columns))
        return shapes[own]

    def field(label: str, told: str, count: int, under: frozenset[str]) -> Field:
        kind = _KINDS.get(told, plain_type(told))
        length = None if count < 0 else count or UNBOUNDED
        if kind in _STAMPS or kind not in by_name or kind in under:
            return Field(label, kind, length)
        return Field(label, shape(kind, by_name[kind], under), length)

    return shape(plain_type(name), definitions[0], frozenset())
