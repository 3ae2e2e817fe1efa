"""Names of the earlier tools' own machinery that config files imported, mostly for a type hint."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from enum import Enum
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TypeVar, runtime_checkable

from robot_runner.core.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = [
    "BashHeaders",
    "CLIRegister",
    "ConfigCreate",
    "ConfigValidator",
    "ExperimentController",
    "Help",
    "IRunController",
    "OutputProcedure",
    "Prepare",
    "RunController",
    "RunProgress",
    "Singleton",
    "SingletonABCMeta",
    "SupportsStr",
    "class_to_dict",
    "pop_from_each_dict_in_list",
    "processify",
]


# What config files of the earlier tools printed with: here it goes where everything else goes that is printed.


class BashHeaders:
    """The codes that colour a terminal."""

    HEADER = "\033[95m"
    OKBLUE = "\033[94m"
    OKGREEN = "\033[92m"
    WARNING = "\033[93m"
    FAIL = "\033[91m"
    ENDC = "\033[0m"
    BOLD = "\033[1m"
    UNDERLINE = "\033[4m"


class OutputProcedure:
    """Prints lines; without colours, which mean nothing in a run's log."""

    robot_runner = "[ROBOT_RUNNER]: "
    runner = "[EXPERIMENT_RUNNER]: "

    @staticmethod
    def console_log(txt: Any, empty_line: bool = False) -> None:
        """Print a line."""
        if empty_line:
            sys.stdout.write("\n")
        sys.stdout.write(f"{txt}\n")

    console_log_OK = console_log  # noqa: N815 - its name
    console_log_WARNING = console_log  # noqa: N815 - its name
    console_log_FAIL = console_log  # noqa: N815 - its name
    console_log_bold = console_log
    console_log_animated = console_log

    @staticmethod
    def console_log_tabulate_dict(d: Mapping[Any, Any]) -> None:
        """Print keys and values, a line each."""
        width = max((len(str(key)) for key in d), default=0)
        for key, value in d.items():
            sys.stdout.write(f"{key!s:{width}}  {value}\n")

    @staticmethod
    def console_log_tabulate_class(obj: object) -> None:
        """Print the attributes of an object, a line each."""
        OutputProcedure.console_log_tabulate_dict(class_to_dict(obj))

    @staticmethod
    def query_yes_no(question: str, default: str | None = "yes") -> bool:
        """Ask a question until the answer is yes or no; an empty answer is the default, where there is one."""
        answers = {"y": True, "ye": True, "yes": True, "n": False, "no": False}
        if default is not None:
            answers[""] = answers[default]
        choice = None
        while choice not in answers:
            sys.stdout.write(f"{question} [y/n] ")
            sys.stdout.flush()
            line = sys.stdin.readline()
            if not line:
                raise EOFError(f"nobody answers: {question}")
            choice = line.strip().lower()
        return answers[choice]


def class_to_dict(obj: object) -> dict[str, Any]:
    """Return the attributes of an object that are no methods."""
    return {
        name: getattr(obj, name)
        for name in dir(obj)
        if not name.startswith("__") and not inspect.ismethod(getattr(obj, name))
    }


def pop_from_each_dict_in_list(
    list_of_dicts: list[dict[Any, Any]], to_be_popped_key: Any, default: Any = None
) -> list[dict[Any, Any]]:
    """Remove a key from each mapping of a list."""
    for each in list_of_dicts:
        each.pop(to_be_popped_key, default)
    return list_of_dicts


# How far a run had come in the earlier tools.


class RunProgress(Enum):
    """The `__done` of a row; its name is what stood in the file."""

    TODO = 1
    DONE = 2
    KILLED = 3


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
