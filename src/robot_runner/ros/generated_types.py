"""Finds the Python classes that ROS generates for the types of a package, in either generation of ROS."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from functools import lru_cache
from importlib import import_module
from typing import Any

from robot_runner.core.errors import LinkError, did_you_mean
from robot_runner.ros.shapes import plain_type


class TypeKind(Enum):
    """A kind of type: its module in the package, its name in messages, and an example.

    Example:
        >>> TypeKind.SERVICE.module
        'srv'
    """

    MESSAGE = ("msg", "message", "geometry_msgs/Twist")
    SERVICE = ("srv", "service", "std_srvs/Trigger")
    ACTION = ("action", "action", "nav2_msgs/NavigateToPose")

    def __init__(self, module: str, word: str, example: str) -> None:
        self.module = module
        self.word = word
        self.example = example


@lru_cache
def generated_class(type_name: str, kind: TypeKind, is_type: Callable[[Any, str], bool]) -> Any:
    """Return the class of a type; raise a `LinkError` if there is none, or its package is not on Python's path."""
    name = plain_type(type_name)
    package, slash, short = name.partition("/")
    if not slash or not package or not short.isidentifier():
        problem = f"{name!r} cannot be the name of a {kind.word} type"
        raise LinkError(problem, where="robot", fix=f"Write it as in {kind.example}.")
    module = _module(package, kind, where=name)
    found = getattr(module, short, None)
    if not is_type(found, name):
        known = [each for each, held in vars(module).items() if is_type(held, f"{package}/{each}")]
        raise LinkError(f"{package!r} has no {kind.word} type {short!r}", where=name, fix=did_you_mean(short, known))
    return found


def _module(package: str, kind: TypeKind, *, where: str) -> Any:
    try:
        return import_module(f"{package}.{kind.module}")
    except ImportError as error:
        problem = f"the {kind.word}s of {package!r} cannot be imported ({error})"
        fix = "Correct the name, or install its package and source its setup file."
        raise LinkError(problem, where=where, fix=fix) from error
