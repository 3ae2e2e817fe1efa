"""Every module of the earlier tools that config files import, and where each of its names lives here.

To have another profiler stand in, add a line to `PLUGINS` in `robot_runner.legacy.profilers.profiler_catalogue`.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

from robot_runner.legacy.profilers.profiler_catalogue import PLUGIN_MODULES

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["MODULES", "PACKAGES", "names_in"]

_HERE = "robot_runner.legacy.stand_ins"
_CHOICES = "robot_runner.core.config.parameters"


def _in(home: str, *names: str, **renamed: str) -> dict[str, str]:
    """Return where names live: `home:name`, or `home:other` for what has another name here."""
    return {name: f"{home}:{name}" for name in names} | {name: f"{home}:{other}" for name, other in renamed.items()}


_FACTOR = _in(f"{_HERE}.models", "FactorModel")
_TABLE = _in(f"{_HERE}.models", "RunTableModel")
_OPERATION = _in(_CHOICES, "OperationType")
_CONTROLLER = _in(f"{_HERE}.events", "EventSubscriptionController")
_ROBOT_EVENTS = _in(f"{_HERE}.events", "RobotRunnerEvents")
_EVENTS = _in(f"{_HERE}.events", "RunnerEvents")
_ROBOT_CONTEXT = _in(f"{_HERE}.base_configs", RobotRunnerContext="EarlierContext")
_CONTEXT = _in(f"{_HERE}.base_configs", RunnerContext="EarlierContext")
_OUTPUT = _in(f"{_HERE}.machinery", "OutputProcedure")
_PROGRESS = _in(f"{_HERE}.machinery", "RunProgress")
_TYPING = _in(f"{_HERE}.machinery", "SupportsStr")
_HEADERS = _in(f"{_HERE}.machinery", "BashHeaders")
_BASE_ERROR = _in(f"{_HERE}.files", "BaseError")
_DICTS = _in(f"{_HERE}.machinery", "class_to_dict", "pop_from_each_dict_in_list")
_PATHS = _in(
    f"{_HERE}.files",
    "is_path_exists_or_creatable_portable",
    is_path_exists_or_creatable="is_path_exists_or_creatable_portable",
)
# A config that wrote `from ConfigValidator.Config.RunnerConfig import *` got these as well.
_COMMON = _FACTOR | _TABLE | _OPERATION | _CONTROLLER
_STANDARD = _in("typing", "Any", "Dict", "List", "Optional") | _in("pathlib", "Path")
_PATH_NAMES = _in("os.path", "dirname", "realpath") | {"output": f"{_HERE}.machinery:OutputProcedure"}

_MODELS = {
    "FactorModel": _FACTOR,
    "RunTableModel": _TABLE,
    "OperationType": _OPERATION,
    "RobotRunnerContext": _ROBOT_CONTEXT,
    "RunnerContext": _CONTEXT,
    "Metadata": _in(f"{_HERE}.files", "Metadata"),
}
_ERRORS = {
    "BaseError": _BASE_ERROR,
    "CLIErrors": _BASE_ERROR
    | _in(
        f"{_HERE}.files",
        "CommandNotRecognisedError",
        "InvalidUserSpecifiedPathError",
        "InvalidConfigTypeSpecifiedError",
    ),
    "ConfigErrors": _BASE_ERROR
    | _in(
        f"{_HERE}.files",
        "ConfigBaseError",
        "ConfigInvalidError",
        "ConfigInvalidClassNameError",
        "ConfigAttributeInvalidError",
        "ConfigROSMandatoryNotInstalledError",
        "ConfigRunTableCreationError",
    ),
    "ExperimentOutputErrors": _BASE_ERROR
    | _in(f"{_HERE}.files", "ExperimentOutputPathAlreadyExistsError", "ExperimentOutputFileDoesNotExistError"),
    "ProgressErrors": _BASE_ERROR | _in(f"{_HERE}.files", "ProgressBaseError", "AllRunsCompletedOnRestartError"),
}
_MISC = {"BashHeaders": _HEADERS, "DictConversion": _DICTS, "PathValidation": _PATHS}
_ARCHITECTURE = {
    "Processify": _in(f"{_HERE}.machinery", "processify"),
    "Singleton": _in(f"{_HERE}.machinery", "Singleton", "SingletonABCMeta"),
}
_ROBOT_CONFIG = _in(f"{_HERE}.base_configs", "RobotRunnerConfig") | _COMMON | _ROBOT_EVENTS | _ROBOT_CONTEXT | _STANDARD
_CONFIG = (
    _in(f"{_HERE}.base_configs", "RunnerConfig") | _COMMON | _EVENTS | _CONTEXT | _TYPING | _STANDARD | _PATH_NAMES
)


def _below(package: str, modules: Mapping[str, Mapping[str, str]]) -> dict[str, Mapping[str, str]]:
    return {f"{package}.{name}": names for name, names in modules.items()}


_OF_BOTH_TOOLS: dict[str, Mapping[str, str]] = {
    **_below("ConfigValidator.Config.Models", _MODELS),
    "ConfigValidator.Config.RobotRunnerConfig": _ROBOT_CONFIG,
    "ConfigValidator.Config.RunnerConfig": _CONFIG,
    "ConfigValidator.Config.Validation.ConfigValidator": _in(f"{_HERE}.machinery", "ConfigValidator"),
    "ConfigValidator.CLIRegister.CLIRegister": _in(
        f"{_HERE}.machinery", "CLIRegister", "ConfigCreate", "Prepare", "Help"
    ),
    **_below("ConfigValidator.CustomErrors", _ERRORS),
    "EventManager.EventSubscriptionController": _CONTROLLER,
    "EventManager.Models.RobotRunnerEvents": _ROBOT_EVENTS,
    "EventManager.Models.RunnerEvents": _EVENTS,
    **_below("ExperimentOrchestrator.Architecture", _ARCHITECTURE),
    "ExperimentOrchestrator.Experiment.ExperimentController": _in(f"{_HERE}.machinery", "ExperimentController"),
    "ExperimentOrchestrator.Experiment.Run.IRunController": _in(f"{_HERE}.machinery", "IRunController"),
    "ExperimentOrchestrator.Experiment.Run.RunController": _in(f"{_HERE}.machinery", "RunController"),
    **_below("ExperimentOrchestrator.Misc", _MISC),
    "ExtendedTyping.Typing": _TYPING,
    "ProgressManager.Output.BaseOutputManager": _in(f"{_HERE}.files", "BaseOutputManager"),
    "ProgressManager.Output.CSVOutputManager": _in(f"{_HERE}.files", "CSVOutputManager"),
    "ProgressManager.Output.JSONOutputManager": _in(f"{_HERE}.files", "JSONOutputManager"),
    "ProgressManager.Output.OutputProcedure": _OUTPUT,
    "ProgressManager.RunTable.Models.RunProgress": _PROGRESS,
    "ProgressManager.RunTable.RunTableManager": _in(f"{_HERE}.files", "RunTableManager"),
}
#: Robot Runner's first months.
_OF_BACKBONE: dict[str, Mapping[str, str]] = {
    **_below("Backbone.Architecture", _ARCHITECTURE),
    "Backbone.Config.Models.OperationType": _OPERATION,
    "Backbone.Config.Models.RobotRunnerContext": _ROBOT_CONTEXT,
    "Backbone.Config.RobotRunnerConfig": _ROBOT_CONFIG,
    **_below("Backbone.CustomErrors", _ERRORS),
    "Backbone.Events.EventSubscriptionController": _CONTROLLER,
    "Backbone.Events.Models.RobotRunnerEvents": _ROBOT_EVENTS,
    "Backbone.ExperimentOutput.Models.ExperimentFactorModel": _in(
        f"{_HERE}.models", ExperimentFactorModel="FactorModel"
    ),
    "Backbone.ExperimentOutput.Models.ExperimentModel": _in(f"{_HERE}.models", ExperimentModel="RunTableModel"),
    "Backbone.ExperimentOutput.Models.RunTableModel": _TABLE,
    **_below("Backbone.Misc", _MISC),
    "Backbone.Procedures.OutputProcedure": _OUTPUT,
    "Backbone.Progress.Models.RunProgress": _PROGRESS,
}

#: The names of each module, each with its home as `module:name`.
MODULES: Mapping[str, Mapping[str, str]] = MappingProxyType({**_OF_BOTH_TOOLS, **_OF_BACKBONE, **PLUGIN_MODULES})

#: The packages that hold them.
PACKAGES = frozenset(
    ".".join(module.split(".")[:length]) for module in MODULES for length in range(1, len(module.split(".")))
)


def names_in(module: str) -> list[str]:
    """Return what can be taken from a module or package: names, and the modules below it.

    Example:
        >>> names_in("ExtendedTyping.Typing")
        ['SupportsStr']
    """
    below = {
        each[len(module) + 1 :].partition(".")[0] for each in (*MODULES, *PACKAGES) if each.startswith(f"{module}.")
    }
    return sorted({*MODULES.get(module, ()), *below})
