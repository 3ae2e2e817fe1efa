"""What config files of the earlier tools read results with. The run table has one writer, which is not here."""

from __future__ import annotations

import csv
import os
from pathlib import Path
from typing import Any, NoReturn

from robot_runner.core.errors import StorageError
from robot_runner.legacy.stand_ins.machinery import RunProgress

__all__ = [
    "AllRunsCompletedOnRestartError",
    "BaseError",
    "BaseOutputManager",
    "CSVOutputManager",
    "CommandNotRecognisedError",
    "ConfigAttributeInvalidError",
    "ConfigBaseError",
    "ConfigInvalidClassNameError",
    "ConfigInvalidError",
    "ConfigROSMandatoryNotInstalledError",
    "ConfigRunTableCreationError",
    "ExperimentOutputFileDoesNotExistError",
    "ExperimentOutputPathAlreadyExistsError",
    "InvalidConfigTypeSpecifiedError",
    "InvalidUserSpecifiedPathError",
    "JSONOutputManager",
    "Metadata",
    "ProgressBaseError",
    "RunTableManager",
    "is_path_exists_or_creatable_portable",
]


# The errors that config files of the earlier tools raised or caught.


class BaseError(Exception):
    """What every error of the earlier tools was."""

    def __init__(self, message: object = "", *details: object) -> None:
        super().__init__(" ".join(str(part) for part in (message, *details) if part != ""))


class ConfigBaseError(BaseError):
    """A config that is not as it should be."""


class ConfigInvalidError(ConfigBaseError):
    """A config that is not valid."""


class ConfigInvalidClassNameError(ConfigBaseError):
    """A config without its class."""


class ConfigAttributeInvalidError(ConfigBaseError):
    """An attribute that is not what it should be."""


class ConfigROSMandatoryNotInstalledError(ConfigBaseError):
    """A ROS that is missing."""


class ConfigRunTableCreationError(ConfigBaseError):
    """A run table that cannot be made."""


class CommandNotRecognisedError(BaseError):
    """A command that is not known."""


class InvalidUserSpecifiedPathError(BaseError):
    """A path that cannot be."""


class InvalidConfigTypeSpecifiedError(BaseError):
    """A kind of config that is not known."""


class ExperimentOutputPathAlreadyExistsError(BaseError):
    """A results folder that holds another experiment."""


class ExperimentOutputFileDoesNotExistError(BaseError):
    """A run table that is not there."""


class ProgressBaseError(BaseError):
    """Something about how far an experiment has come."""


class AllRunsCompletedOnRestartError(ProgressBaseError):
    """Nothing that is left to do."""


class BaseOutputManager:
    """Knows the experiment's folder."""

    def __init__(self, experiment_path: Path | str | None = None) -> None:
        self._experiment_path = experiment_path

    def set_experiment_output_path(self, experiment_output_path: Path | str) -> None:
        """Take the experiment's folder."""
        self._experiment_path = experiment_output_path


class CSVOutputManager(BaseOutputManager):
    """Reads the run table of an experiment."""

    def read_run_table(self) -> list[dict[str, Any]]:
        """Return the rows: whole numbers as such, `__done` as a `RunProgress`, all else as text.

        Raises:
            ExperimentOutputFileDoesNotExistError: it cannot be read.
        """
        try:
            with (Path(self._experiment_path or "") / "run_table.csv").open(encoding="utf-8", newline="") as file:
                return [{name: _value(name, text) for name, text in row.items()} for row in csv.DictReader(file)]
        except (OSError, ValueError, KeyError) as error:
            raise ExperimentOutputFileDoesNotExistError(str(error)) from error

    def read_run_table_from_csv(self) -> list[dict[str, Any]]:
        """Return the rows; the name of Robot Runner."""
        return self.read_run_table()

    def write_run_table(self, *_: object) -> NoReturn:
        """Refuse to write.

        Raises:
            StorageError: always.
        """
        raise _one_writer()

    def write_run_table_to_csv(self, *_: object) -> NoReturn:
        """Refuse to write.

        Raises:
            StorageError: always.
        """
        raise _one_writer()

    def update_row_data(self, *_: object) -> NoReturn:
        """Refuse to write.

        Raises:
            StorageError: always.
        """
        raise _one_writer()


class JSONOutputManager(BaseOutputManager):
    """Kept a checksum of the config; the manifest and the kept config tell more."""

    def read_metadata(self) -> Metadata:
        """Return an empty checksum."""
        return Metadata(b"")

    def write_metadata(self, metadata: object) -> None:
        """Do nothing: the manifest is written by Robot Runner."""


class Metadata:
    """A checksum of a config."""

    def __init__(self, md5sum: bytes) -> None:
        self.md5sum = md5sum


class RunTableManager:
    """Compared tables; Robot Runner does so itself."""

    @staticmethod
    def are_config_and_restart_csv_equal(config: object) -> bool:
        """Return that they are: a difference would have refused the experiment."""
        del config
        return True


def is_path_exists_or_creatable_portable(pathname: str) -> bool:
    """Return whether a path is there, or could be made."""
    path = Path(pathname).expanduser().absolute()
    if path.exists():
        return True
    parent = next(each for each in path.parents if each.exists())
    return os.access(parent, os.W_OK)


def _value(name: str, text: str | None) -> Any:
    if name == "__done":
        return RunProgress[text or ""]
    return int(text) if text is not None and text.isnumeric() else text


def _one_writer() -> StorageError:
    return StorageError(
        "a config cannot write the run table: it has one writer",
        where="CSVOutputManager",
        fix="Return the values from populate_run_data.",
    )
