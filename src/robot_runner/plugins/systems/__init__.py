"""The built-in plugins that operate a robot."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robot_runner.ros.turtlebot3.basic_turtlebot3 import BasicTurtlebot3

__all__ = [
    "BasicTurtlebot3",
]

_HOMES = {
    "BasicTurtlebot3": "robot_runner.ros.turtlebot3.basic_turtlebot3",
}


def __getattr__(name: str) -> object:
    """Import a name when it is first asked for, so that importing one of the submodules stays cheap."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = getattr(import_module(_HOMES[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return __all__
