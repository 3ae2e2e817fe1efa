"""Converts messages of ROS 2 to and from plain mappings; their types are the Python classes that ROS generates."""

from __future__ import annotations

import os
import sys
from array import array
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from robot_runner.core.errors import LinkError
from robot_runner.ros.action_types import action_parts, whole_action
from robot_runner.ros.generated_types import TypeKind, generated_class
from robot_runner.ros.shapes import BYTE_KINDS, IDL_KINDS, UNBOUNDED, Field, Shape, UpTo, plain_type
from robot_runner.ros.type_store import stored_name

_OCTET = "byte"
#: The attributes of an action's class with the types that its definition does not contain.
_ACTION_STEPS = MappingProxyType(
    {
        "FeedbackMessage": "Impl.FeedbackMessage",
        "SendGoal": "Impl.SendGoalService",
        "GetResult": "Impl.GetResultService",
    }
)
#: The line between the definitions of two types in a bag.
_SEPARATOR = "=" * 80


def message_class(message_type: str) -> Any:
    """Return the class of a message type, such as `geometry_msgs/Twist`.

    Raises:
        LinkError: there is none, or its package is not in the sourced ROS.
    """
    part = _action_part(message_type)
    return generated_class(message_type, TypeKind.MESSAGE, _is_message) if part is None else part


def service_class(service_type: str) -> Any:
    """Return the class of a service type, such as `std_srvs/Trigger`; raise a `LinkError` as `message_class` does."""
    part = _action_part(service_type)
    return generated_class(service_type, TypeKind.SERVICE, _is_service) if part is None else part


def _action_part(type_name: str) -> Any:
    """Return the class of a message or service that ROS 2 derives from an action, or None for any other."""
    name = plain_type(type_name)
    action = whole_action(name)
    if action == name:
        return None
    found = generated_class(action, TypeKind.ACTION, _is_action)
    part, *half = name.removeprefix(f"{action}_").split("_")  # `half`: the request or response of a service
    for step in (*_ACTION_STEPS.get(part, part).split("."), *half):
        found = getattr(found, step)
    return found


def _is_message(found: Any, _name: str) -> bool:
    return hasattr(found, "get_fields_and_field_types")


def _is_action(found: Any, _name: str) -> bool:
    return hasattr(found, "Goal") and hasattr(found, "Impl")


def _is_service(found: Any, _name: str) -> bool:
    return hasattr(found, "Request")


@lru_cache
def shape_of(cls: Any) -> Shape:
    """Return the fields of the class of a message, request or response."""
    example = cls()
    names = cls.get_fields_and_field_types()
    fields = (_field(name, kind, getattr(example, name)) for name, kind in zip(names, cls.SLOT_TYPES, strict=True))
    return Shape(f"{cls.__module__.partition('.')[0]}/{cls.__name__}", tuple(fields))


def _field(name: str, written: Any, example: Any) -> Field:
    element = getattr(written, "value_type", None)
    kind = _kind(written if element is None else element)
    limit = getattr(written if element is None else element, "maximum_size", None)
    default = None if isinstance(kind, Shape) else _taken(Field(name, kind, _count(written)), example)
    if isinstance(default, list):
        default = tuple(default)  # shapes are keys
    return Field(name, kind, _count(written), default or None, limit)


def _count(written: Any) -> int | UpTo | None:
    if not hasattr(written, "value_type"):
        return None
    if (size := getattr(written, "size", None)) is not None:
        return int(size)
    limit = getattr(written, "maximum_size", None)
    return UNBOUNDED if limit is None else UpTo(int(limit))


def _kind(written: Any) -> str | Shape:
    if hasattr(written, "namespaces"):
        return shape_of(message_class(f"{written.namespaces[0]}/{written.name}"))
    if hasattr(written, "typename"):
        name: str = written.typename
        return IDL_KINDS.get(name, name)
    return "wstring" if "WString" in type(written).__name__ else "string"


def as_mapping(message: Any) -> dict[str, Any]:
    """Return a message of ROS as a plain mapping."""
    cls: Any = type(message)
    return {field.name: _taken(field, getattr(message, field.name)) for field in shape_of(cls).fields}


def _taken(field: Field, value: Any) -> Any:
    kind = field.kind
    if field.count is None:
        if isinstance(kind, Shape):
            return as_mapping(value)
        return value[0] if kind == _OCTET else value
    if isinstance(kind, Shape):
        return [as_mapping(each) for each in value]
    if kind in BYTE_KINDS:
        return b"".join(value) if kind == _OCTET else bytes(value)
    return value.tolist() if hasattr(value, "tolist") else list(value)  # arrays of NumPy and of the standard library


def as_message(cls: Any, complete: Mapping[str, Any]) -> Any:
    """Return a mapping with every field, such as `robot_runner.ros.shapes.completed` makes, as a message of ROS."""
    message = cls()
    for field in shape_of(cls).fields:
        setattr(message, field.name, _given(field, complete[field.name]))
    return message


def _given(field: Field, value: Any) -> Any:
    kind = field.kind
    if isinstance(kind, Shape):
        cls = message_class(kind.type_name)
        return as_message(cls, value) if field.count is None else [as_message(cls, each) for each in value]
    if kind == _OCTET:
        return bytes([value]) if field.count is None else [bytes([each]) for each in value]
    if kind in BYTE_KINDS and isinstance(field.count, UpTo):
        return array("B", value)  # ROS accepts an array as it is, but checks each element of anything else
    return list(value) if field.count is not None else value


class Ros2Types:
    """The types of the sourced ROS 2; each method raises a `LinkError` for an unknown type."""

    def shape(self, message_type: str) -> Shape:
        """Return the fields of a message type."""
        return shape_of(message_class(message_type))

    def request(self, service_type: str) -> Shape:
        """Return the fields of a service type's request."""
        return shape_of(service_class(service_type).Request)

    def response(self, service_type: str) -> Shape:
        """Return the fields of a service type's response."""
        return shape_of(service_class(service_type).Response)

    def definition(self, message_type: str) -> str:
        """Return the text of a type's definition, followed by those of the types of its fields, as bags store it.

        Raises:
            LinkError: there is no such type, or its package does not contain the definition.
        """
        shape = self.shape(message_type)
        within = (f"{_SEPARATOR}\nMSG: {name}\n{_text(name)}" for name in dict.fromkeys(_within(shape)))
        return "\n".join([_text(shape.type_name), *within])


def _within(shape: Shape) -> Iterator[str]:
    for field in shape.fields:
        if isinstance(field.kind, Shape):
            yield field.kind.type_name
            yield from _within(field.kind)


def _text(type_name: str) -> str:
    whole = whole_action(type_name)
    package, _, name = whole.partition("/")
    folder = "msg" if whole == type_name else "action"
    try:
        text = (_share_folder(package) / folder / f"{name}.{folder}").read_text(encoding="utf-8")
    except (LookupError, OSError) as error:
        problem = f"the package {package!r} has no text of the definition: {error}"
        raise LinkError(problem, where=type_name, fix="Install the package with its share folder.") from error
    return text if whole == type_name else action_parts(2, whole, text, where=whole)[stored_name(type_name)]


def _share_folder(package: str) -> Path:
    """Return the folder of a package's definitions; a ROS 2 installed by pip is found without being sourced.

    Where no sourced ROS 2 has it, that is a `LookupError`.
    """
    if not os.environ.get("AMENT_PREFIX_PATH"):
        return Path(sys.prefix, "share", package)
    from ament_index_python.packages import get_package_share_directory  # noqa: PLC0415  # comes with a sourced ROS 2

    return Path(get_package_share_directory(package))
