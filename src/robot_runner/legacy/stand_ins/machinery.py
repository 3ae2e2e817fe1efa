"""Internal names of the earlier tools that config files import, mostly for type hints, printing or reading."""

from __future__ import annotations

import csv
import inspect
import os
import sys
from collections.abc import Callable, Mapping
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, NoReturn, Protocol, TypeVar, runtime_checkable

from robot_runner.core.errors import ConfigError, StorageError

Function = TypeVar("Function", bound=Callable[..., Any])


class BaseError(Exception):
    """The base class of every error of the earlier tools."""

    def __init__(self, message: object = "", *details: object) -> None:
        super().__init__(" ".join(str(part) for part in (message, *details) if part != ""))


#: Errors that configs raised and caught, by module; each derives from its module's base error, or from `BaseError`.
ERRORS = {
    "CLIErrors": "CommandNotRecognisedError InvalidUserSpecifiedPathError InvalidConfigTypeSpecifiedError",
    "ConfigErrors": (
        "ConfigBaseError ConfigInvalidError ConfigInvalidClassNameError ConfigAttributeInvalidError "
        "ConfigROSMandatoryNotInstalledError ConfigRunTableCreationError"
    ),
    "ExperimentOutputErrors": "ExperimentOutputPathAlreadyExistsError ExperimentOutputFileDoesNotExistError",
    "ProgressErrors": "ProgressBaseError AllRunsCompletedOnRestartError",
}
#: Classes that validated configs and executed experiments: they can be imported, but not used.
_REFUSED = "CLIRegister ConfigCreate ConfigValidator ExperimentController Help IRunController Prepare RunController"


class _Machinery:
    def __init__(self, *_: object, **__: object) -> None:
        name = type(self).__name__
        problem = f"{name} belonged to the earlier tool itself: Robot Runner executes the experiment in its own way"
        raise ConfigError(problem, where=name, fix=f"Leave {name} out, and start the file with `robot-runner run`.")


@cache
def __getattr__(name: str) -> type:
    """Return a class with only a name and a base class."""
    if name in _REFUSED.split():
        return type(name, (_Machinery,), {"__module__": __name__})
    for names in map(str.split, ERRORS.values()):
        if name in names:
            base = BaseError if name == names[0] or "Base" not in names[0] else __getattr__(names[0])
            return type(name, (base,), {"__module__": __name__})
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}", name=name)


class BashHeaders:
    """The escape codes for colours of a terminal."""

    HEADER = "\033[95m"
    OKBLUE = "\033[94m"
    OKGREEN = "\033[92m"
    WARNING = "\033[93m"
    FAIL = "\033[91m"
    ENDC = "\033[0m"
    BOLD = "\033[1m"
    UNDERLINE = "\033[4m"


class OutputProcedure:
    """Prints lines, without colours, which are useless in a run's log."""

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
        """Ask a question until the answer is yes or no; an empty answer means the default, if there is one."""
        answers = {"y": True, "ye": True, "yes": True, "n": False, "no": False}
        if default is not None:
            answers[""] = answers[default]
        choice = None
        while choice not in answers:
            sys.stdout.write(f"{question} [y/n] ")
            sys.stdout.flush()
            line = sys.stdin.readline()
            if not line:
                raise EOFError(f"no answer to: {question}")
            choice = line.strip().lower()
        return answers[choice]


def class_to_dict(obj: object) -> dict[str, Any]:
    """Return the attributes of an object except its methods."""
    names = [name for name in dir(obj) if not name.startswith("__")]
    return {name: getattr(obj, name) for name in names if not inspect.ismethod(getattr(obj, name))}


def pop_from_each_dict_in_list(
    list_of_dicts: list[dict[Any, Any]], to_be_popped_key: Any, default: Any = None
) -> list[dict[Any, Any]]:
    """Remove a key from each mapping of a list."""
    for each in list_of_dicts:
        each.pop(to_be_popped_key, default)
    return list_of_dicts


class RunProgress(Enum):
    """The progress of a run (`__done`), by its name in the file."""

    TODO = 1
    DONE = 2
    KILLED = 3


@runtime_checkable
class SupportsStr(Protocol):
    """Any object with a text."""

    def __str__(self) -> str: ...


class Singleton(type):
    """A class with this metaclass has one instance."""

    _instances: ClassVar[dict[type, Any]] = {}

    def __call__(cls, *args: Any, **kwargs: Any) -> Any:
        """Return the only instance, which is made at the first call."""
        if cls not in cls._instances:
            cls._instances[cls] = super().__call__(*args, **kwargs)
        return cls._instances[cls]


def processify(function: Function) -> Function:
    """Return the function unchanged: a run has its own process already."""
    return function


def is_path_exists_or_creatable_portable(pathname: str) -> bool:
    """Return whether a path exists or can be created."""
    path = Path(pathname).expanduser().absolute()
    return path.exists() or os.access(next(each for each in path.parents if each.exists()), os.W_OK)


class BaseOutputManager:
    """Knows the experiment's folder."""

    def __init__(self, experiment_path: Path | str | None = None) -> None:
        self._experiment_path = experiment_path

    def set_experiment_output_path(self, experiment_output_path: Path | str) -> None:
        """Set the experiment's folder."""
        self._experiment_path = experiment_output_path


class CSVOutputManager(BaseOutputManager):
    """Reads the run table of an experiment, but does not write it: only the progress manager does."""

    def read_run_table(self) -> list[dict[str, Any]]:
        """Return the rows: integers as int, `__done` as a `RunProgress`, other cells as text.

        Raises:
            ExperimentOutputFileDoesNotExistError: the table cannot be read.
        """
        try:
            with (Path(self._experiment_path or "") / "run_table.csv").open(encoding="utf-8", newline="") as file:
                return [{name: _cell(name, text) for name, text in row.items()} for row in csv.DictReader(file)]
        except (OSError, ValueError, KeyError) as error:
            raise __getattr__("ExperimentOutputFileDoesNotExistError")(str(error)) from error

    def write_run_table(self, *_: object) -> NoReturn:
        """Refuse to write.

        Raises:
            StorageError: always.
        """
        fix = "Return the values from populate_run_data."
        raise StorageError("a config cannot write the run table: it has one writer", where="CSVOutputManager", fix=fix)

    read_run_table_from_csv = read_run_table
    write_run_table_to_csv = write_run_table
    update_row_data = write_run_table


def _cell(name: str, text: str | None) -> Any:
    if name == "__done":
        return RunProgress[text or ""]
    return int(text) if text is not None and text.isnumeric() else text


class JSONOutputManager(BaseOutputManager):
    """Kept a checksum of the config; here the manifest and the copy of the config replace it."""

    def read_metadata(self) -> Metadata:
        """Return an empty checksum."""
        return Metadata(b"")

    def write_metadata(self, metadata: object) -> None:
        """Do nothing: Robot Runner writes the manifest."""


class Metadata:
    """A checksum of a config."""

    def __init__(self, md5sum: bytes) -> None:
        self.md5sum = md5sum


class RunTableManager:
    """Compared run tables; Robot Runner does this itself."""

    @staticmethod
    def are_config_and_restart_csv_equal(config: object) -> bool:
        """Return True: with a difference, the experiment would have been refused."""
        del config
        return True
