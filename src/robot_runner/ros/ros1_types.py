"""Converts messages of ROS 1 to and from plain mappings; their types are the Python classes that ROS generates."""

from __future__ import annotations

import re
import shutil
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import lru_cache, partial
from importlib import import_module
from types import SimpleNamespace
from typing import Any

from robot_runner.core.errors import LinkError
from robot_runner.ros.generated_types import TypeKind, generated_class
from robot_runner.ros.shapes import BYTE_KINDS, ROS1_KINDS, UNBOUNDED, Field, Shape, plain_type

_FIELD = re.compile(r"([\w/]+)(\[(\d*)\])?")
_STAMPS = {"time": "Time", "duration": "Duration"}

_generating = threading.Lock()


def message_class(message_type: str) -> Any:
    """Return the class of a message type, such as `geometry_msgs/Twist`.

    Raises:
        LinkError: there is none, or its package is neither on Python's path nor among the types known without ROS.
    """
    try:
        return generated_class(message_type, TypeKind.MESSAGE, _is_type)
    except LinkError:
        made = _class_from_text(plain_type(message_type))
        if made is None:
            raise
        return made


@lru_cache
def _class_from_text(message_type: str) -> Any:
    """Return a class generated from a built-in definition, such as of actions; None where there is none."""
    try:
        from robot_runner.ros.type_catalogue import TypeCatalogue  # noqa: PLC0415  # it takes rosbags, an extra

        text = TypeCatalogue.of(1).definition(message_type)
    except (ImportError, LinkError):
        return None
    return _generated(message_type, text)


def _generated(message_type: str, text: str) -> Any:
    """Return the class that genpy generates from a definition.

    genpy imports each type from a temporary folder, which `atexit` removes; but the process of a run ends without that.
    As the folder is not needed once the type is imported, it is removed at once.
    """
    dynamic: Any = import_module("genpy.dynamic")
    folders: list[str] = []
    with _generating:
        at_exit, dynamic.atexit = dynamic.atexit, SimpleNamespace(register=lambda _, folder: folders.append(folder))
        try:
            made: Mapping[str, Any] = dynamic.generate_dynamic(message_type, text)
        finally:
            dynamic.atexit = at_exit
            for folder in folders:
                shutil.rmtree(folder, ignore_errors=True)
                with suppress(ValueError):
                    sys.path.remove(folder)
                sys.path_importer_cache.pop(folder, None)
    return made[message_type]


def service_class(service_type: str) -> Any:
    """Return the class of a service type, such as `std_srvs/Trigger`; raise a `LinkError` as `message_class` does."""
    return generated_class(service_type, TypeKind.SERVICE, _is_type)


def _is_type(found: Any, name: str) -> bool:
    return getattr(found, "_type", None) == name


@lru_cache
def shape_of(cls: Any) -> Shape:
    """Return the fields of the class of a message, request or response."""
    return Shape(cls._type, tuple(_field(*each) for each in zip(cls.__slots__, cls._slot_types, strict=True)))


def _field(name: str, written: str) -> Field:
    parts = _FIELD.fullmatch(written)
    kind, array, number = parts.groups() if parts else (written, None, None)
    count = None if not array else int(number) if number else UNBOUNDED
    return Field(name, shape_of(message_class(kind)) if "/" in kind else ROS1_KINDS.get(kind, kind), count)


def as_mapping(message: Any) -> dict[str, Any]:
    """Return a message of ROS as a plain mapping."""
    return {field.name: _plain(field, getattr(message, field.name)) for field in shape_of(message.__class__).fields}


def _plain(field: Field, value: Any) -> Any:
    kind = field.kind
    if field.count is None:
        if isinstance(kind, Shape):
            return as_mapping(value)
        return {"sec": value.secs, "nanosec": value.nsecs} if kind in _STAMPS else value
    if isinstance(kind, Shape):
        return [as_mapping(each) for each in value]
    if kind in BYTE_KINDS:
        return bytes(value)
    return [{"sec": each.secs, "nanosec": each.nsecs} for each in value] if kind in _STAMPS else list(value)


def as_message(cls: Any, complete: Mapping[str, Any]) -> Any:
    """Return a mapping with every field, such as `robot_runner.ros.shapes.completed` makes, as a message of ROS."""
    message = cls.__new__(cls)  # without `__init__`, which fills every field with a default first
    for name, convert in _conversions(cls):
        setattr(message, name, complete[name] if convert is None else convert(complete[name]))
    return message


@lru_cache
def _conversions(cls: Any) -> tuple[tuple[str, Callable[[Any], Any] | None], ...]:
    """Return each field with the function that converts its value for ROS, or None where no conversion is needed."""
    return tuple((field.name, _conversion(field)) for field in shape_of(cls).fields)


def _conversion(field: Field) -> Callable[[Any], Any] | None:
    kind = field.kind
    if isinstance(kind, Shape):
        convert: Callable[[Any], Any] = partial(as_message, message_class(kind.type_name))
    elif kind in _STAMPS:
        convert = partial(_stamp, getattr(import_module("genpy"), _STAMPS[kind]))
    else:
        return None
    return convert if field.count is None else lambda values: [convert(value) for value in values]


def _stamp(cls: Any, value: Mapping[str, int]) -> Any:
    return cls(value["sec"], value["nanosec"])


class Ros1Types:
    """The types of the packages on Python's path; each method raises a `LinkError` for an unknown type."""

    def shape(self, message_type: str) -> Shape:
        """Return the fields of a message type."""
        return shape_of(message_class(message_type))

    def request(self, service_type: str) -> Shape:
        """Return the fields of a service type's request."""
        cls = service_class(service_type)
        return shape_of(cls._request_class)

    def response(self, service_type: str) -> Shape:
        """Return the fields of a service type's response."""
        cls = service_class(service_type)
        return shape_of(cls._response_class)

    def definition(self, message_type: str) -> str:
        """Return the text of a type's definition, which the generated class contains."""
        cls = message_class(message_type)
        text: str = cls._full_text
        return text
