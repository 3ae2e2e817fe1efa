"""The text of message definitions, as the packages of a sourced ROS 2 have it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.errors import LinkError
from robot_runner.links.ros2.message_types import message_class, shape_of
from robot_runner.links.shapes import Shape

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["definition_of"]

_SEPARATOR = "=" * 80


def definition_of(message_type: str) -> str:
    """Return the text of a type's definition, with those that it is made of after it, as bags store it.

    Raises:
        LinkError: there is no such type, or its package has no text of it.
    """
    shape = shape_of(message_class(message_type))
    within = (f"{_SEPARATOR}\nMSG: {name}\n{_text(name)}" for name in dict.fromkeys(_within(shape)))
    return "\n".join([_text(shape.type_name), *within])


def _within(shape: Shape) -> Iterator[str]:
    for field in shape.fields:
        if isinstance(field.kind, Shape):
            yield field.kind.type_name
            yield from _within(field.kind)


def _text(type_name: str) -> str:
    from ament_index_python.packages import (  # noqa: PLC0415  # comes with a sourced ROS 2
        PackageNotFoundError,
        get_package_share_directory,
    )

    package, _, name = type_name.partition("/")
    try:
        return (Path(get_package_share_directory(package)) / "msg" / f"{name}.msg").read_text(encoding="utf-8")
    except (PackageNotFoundError, OSError) as error:
        raise LinkError(
            f"the package {package!r} has no text of the definition: {error}",
            where=type_name,
            fix="Install the package with its share folder.",
        ) from error
