"""The errors that config files of the earlier tools raised or caught."""

from __future__ import annotations

__all__ = [
    "AllRunsCompletedOnRestartError",
    "BaseError",
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
    "ProgressBaseError",
]


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
