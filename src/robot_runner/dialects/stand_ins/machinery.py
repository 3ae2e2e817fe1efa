"""Names of the earlier tools' own machinery that config files imported, mostly for a type hint."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, Protocol, TypeVar, runtime_checkable

from robot_runner.errors import ConfigError

__all__ = [
    "CLIRegister",
    "ConfigCreate",
    "ConfigValidator",
    "ExperimentController",
    "Help",
    "IRunController",
    "Prepare",
    "RunController",
    "Singleton",
    "SingletonABCMeta",
    "SupportsStr",
    "processify",
]

Function = TypeVar("Function", bound=Callable[..., Any])


@runtime_checkable
class SupportsStr(Protocol):
    """Anything that has a text."""

    def __str__(self) -> str: ...


class Singleton(type):
    """A class with this metaclass has one instance."""

    _instances: ClassVar[dict[type, Any]] = {}

    def __call__(cls, *args: Any, **kwargs: Any) -> Any:
        """Return the one instance; made when first asked for."""
        if cls not in cls._instances:
            cls._instances[cls] = super().__call__(*args, **kwargs)
        return cls._instances[cls]


SingletonABCMeta = Singleton


def processify(function: Function) -> Function:
    """Return the function: a run has a process of its own already."""
    return function


class _Machinery:
    def __init__(self, *_: object, **__: object) -> None:
        name = type(self).__name__
        raise ConfigError(
            f"{name} belonged to the earlier tool itself: Robot Runner executes the experiment in its own way",
            where=name,
            fix=f"Leave {name} out, and start the file with `robot-runner run`.",
        )


class ConfigValidator(_Machinery):
    """Validated configs."""


class ExperimentController(_Machinery):
    """Executed experiments."""


class IRunController(_Machinery):
    """Executed a run."""


class RunController(_Machinery):
    """Executed a run."""


class ConfigCreate(_Machinery):
    """A command."""


class Prepare(_Machinery):
    """A command."""


class Help(_Machinery):
    """A command."""


class CLIRegister(_Machinery):
    """The commands."""
