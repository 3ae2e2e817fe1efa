"""The modules of the earlier tools that config files import: the home of each name here, and their importer.

To add a stand-in for another profiler, add a line to `PLUGINS` in `robot_runner.legacy.profilers.profiler_catalogue`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any

from robot_runner.core.errors import did_you_mean
from robot_runner.legacy.profilers.profiler_catalogue import PLUGIN_MODULES
from robot_runner.legacy.recognition import EARLIER_PACKAGES, is_earlier_import
from robot_runner.legacy.run_ids import clone_around
from robot_runner.legacy.stand_ins.machinery import ERRORS

Names = dict[str, str]


def _in(home: str, names: str) -> Names:
    """Return the homes of names, each as `home:name`; `Theirs=ours` for a name that differs here."""
    split = (name.partition("=") for name in names.split())
    return {theirs: f"{home}:{ours or theirs}" for theirs, _, ours in split}


_HERE = "robot_runner.legacy.stand_ins"
_MACHINERY = f"{_HERE}.machinery"
_FACTOR = _in(f"{_HERE}.models", "FactorModel")
_TABLE = _in(f"{_HERE}.models", "RunTableModel")
_OPERATION = _in("robot_runner.core.config.parameters", "OperationType")
_CONTROLLER = _in(f"{_HERE}.events", "EventSubscriptionController")
_ROBOT_EVENTS = _in(f"{_HERE}.events", "RobotRunnerEvents")
_EVENTS = _in(f"{_HERE}.events", "RunnerEvents")
_ROBOT_CONTEXT = _in(f"{_HERE}.events", "RobotRunnerContext=EarlierContext")
_CONTEXT = _in(f"{_HERE}.events", "RunnerContext=EarlierContext")
_TYPING = _in(_MACHINERY, "SupportsStr")
# `from ConfigValidator.Config.RunnerConfig import *` imported these as well.
_COMMON = _FACTOR | _TABLE | _OPERATION | _CONTROLLER | _in("typing", "Any Dict List Optional") | _in("pathlib", "Path")
_ROBOT_CONFIG = _in(f"{_HERE}.events", "RobotRunnerConfig") | _COMMON | _ROBOT_EVENTS | _ROBOT_CONTEXT
_CONFIG = (
    _in(f"{_HERE}.events", "RunnerConfig")
    | _COMMON
    | _EVENTS
    | _CONTEXT
    | _TYPING
    | _in("os.path", "dirname realpath")
    | _in(_MACHINERY, "output=OutputProcedure")
)
_ERRORS = {"BaseError": "BaseError"} | {module: f"BaseError {names}" for module, names in ERRORS.items()}
_MISC = {
    "BashHeaders": "BashHeaders",
    "DictConversion": "class_to_dict pop_from_each_dict_in_list",
    "PathValidation": (
        "is_path_exists_or_creatable_portable is_path_exists_or_creatable=is_path_exists_or_creatable_portable"
    ),
}
_ARCHITECTURE = {"Processify": "processify", "Singleton": "Singleton SingletonABCMeta=Singleton"}
_OUTPUT_MANAGERS = {name: name for name in ("BaseOutputManager", "CSVOutputManager", "JSONOutputManager")}


def _machinery(package: str, modules: Mapping[str, str]) -> dict[str, Names]:
    """Return the modules of a package whose names are in `stand_ins.machinery`."""
    return {f"{package}.{module}": _in(_MACHINERY, names) for module, names in modules.items()}


_OF_BOTH_TOOLS: dict[str, Names] = {
    "ConfigValidator.Config.Models.FactorModel": _FACTOR,
    "ConfigValidator.Config.Models.RunTableModel": _TABLE,
    "ConfigValidator.Config.Models.OperationType": _OPERATION,
    "ConfigValidator.Config.Models.RobotRunnerContext": _ROBOT_CONTEXT,
    "ConfigValidator.Config.Models.RunnerContext": _CONTEXT,
    **_machinery("ConfigValidator.Config.Models", {"Metadata": "Metadata"}),
    "ConfigValidator.Config.RobotRunnerConfig": _ROBOT_CONFIG,
    "ConfigValidator.Config.RunnerConfig": _CONFIG,
    **_machinery("ConfigValidator.Config.Validation", {"ConfigValidator": "ConfigValidator"}),
    **_machinery("ConfigValidator.CLIRegister", {"CLIRegister": "CLIRegister ConfigCreate Prepare Help"}),
    **_machinery("ConfigValidator.CustomErrors", _ERRORS),
    "EventManager.EventSubscriptionController": _CONTROLLER,
    "EventManager.Models.RobotRunnerEvents": _ROBOT_EVENTS,
    "EventManager.Models.RunnerEvents": _EVENTS,
    **_machinery("ExperimentOrchestrator.Architecture", _ARCHITECTURE),
    **_machinery("ExperimentOrchestrator.Experiment", {"ExperimentController": "ExperimentController"}),
    **_machinery(
        "ExperimentOrchestrator.Experiment.Run", {"IRunController": "IRunController", "RunController": "RunController"}
    ),
    **_machinery("ExperimentOrchestrator.Misc", _MISC),
    "ExtendedTyping.Typing": _TYPING,
    **_machinery("ProgressManager.Output", _OUTPUT_MANAGERS | {"OutputProcedure": "OutputProcedure"}),
    **_machinery("ProgressManager.RunTable.Models", {"RunProgress": "RunProgress"}),
    **_machinery("ProgressManager.RunTable", {"RunTableManager": "RunTableManager"}),
}
#: The first version of Robot Runner.
_OF_BACKBONE: dict[str, Names] = {
    **_machinery("Backbone.Architecture", _ARCHITECTURE),
    "Backbone.Config.Models.OperationType": _OPERATION,
    "Backbone.Config.Models.RobotRunnerContext": _ROBOT_CONTEXT,
    "Backbone.Config.RobotRunnerConfig": _ROBOT_CONFIG,
    **_machinery("Backbone.CustomErrors", _ERRORS),
    "Backbone.Events.EventSubscriptionController": _CONTROLLER,
    "Backbone.Events.Models.RobotRunnerEvents": _ROBOT_EVENTS,
    "Backbone.ExperimentOutput.Models.ExperimentFactorModel": _in(
        f"{_HERE}.models", "ExperimentFactorModel=FactorModel"
    ),
    "Backbone.ExperimentOutput.Models.ExperimentModel": _in(f"{_HERE}.models", "ExperimentModel=RunTableModel"),
    "Backbone.ExperimentOutput.Models.RunTableModel": _TABLE,
    **_machinery("Backbone.Misc", _MISC),
    **_machinery("Backbone.Procedures", {"OutputProcedure": "OutputProcedure"}),
    **_machinery("Backbone.Progress.Models", {"RunProgress": "RunProgress"}),
}

#: The names of each module, each with its home as `module:name`.
MODULES: Mapping[str, Mapping[str, str]] = MappingProxyType({**_OF_BOTH_TOOLS, **_OF_BACKBONE, **PLUGIN_MODULES})

#: The packages that hold them.
PACKAGES = frozenset(
    ".".join(module.split(".")[:length]) for module in MODULES for length in range(1, len(module.split(".")))
)


def names_in(module: str) -> list[str]:
    """Return the names and submodules of a module or package.

    Example:
        >>> names_in("ExtendedTyping.Typing")
        ['SupportsStr']
    """
    below = {
        each[len(module) + 1 :].partition(".")[0] for each in (*MODULES, *PACKAGES) if each.startswith(f"{module}.")
    }
    return sorted({*MODULES.get(module, ()), *below})


_LOWER_CASE_ROOT = "plugins"


class StandIns(MetaPathFinder, Loader):
    """The stand-in modules of one config file.

    Additional modules of a fork (`Plugins.Profilers.MyMeter`), and names that it added to a module of the tool, are
    found in the clone that contains the config file.
    """

    def __init__(self, config: Path) -> None:
        self._clone = clone_around(config)
        self._modules: dict[str, ModuleType] = {}
        self._asked: set[str] = set()
        self._depth = 0

    @contextmanager
    def present(self) -> Iterator[None]:
        """Make the modules importable; other modules with the same names are restored afterwards."""
        if self._depth:
            self._depth += 1
            try:
                yield
            finally:
                self._depth -= 1
            return
        others = _foreign_modules()
        sys.modules.update(self._modules)
        sys.meta_path.insert(0, self)
        self._depth = 1
        try:
            yield
        finally:
            self._depth = 0
            sys.meta_path.remove(self)
            # Called at every event of a run, so that only modules from this finder are visited.
            self._modules = {name: sys.modules.pop(name) for name in self._asked if name in sys.modules}
            sys.modules.update(others)

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, _target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the spec of a stand-in, or of an additional module of the fork.

        Raises:
            ModuleNotFoundError: neither tool has such a module.
        """
        if fullname == _LOWER_CASE_ROOT:
            own = PathFinder.find_spec(fullname)
            if own is not None:
                return own
        elif fullname not in PACKAGES and not is_earlier_import(fullname):
            return None
        self._asked.add(fullname)
        if fullname in MODULES:
            return ModuleSpec(fullname, self)
        if fullname in PACKAGES:
            return self._package(fullname)
        spec = PathFinder.find_spec(fullname, path or [])
        if spec is None:
            hint = did_you_mean(fullname, MODULES) if fullname.count(".") else ""
            problem = f"neither Robot Runner nor Experiment Runner ever had a module {fullname}. {hint}".strip()
            raise ModuleNotFoundError(problem, name=fullname)
        return spec

    def exec_module(self, module: ModuleType) -> None:
        """Set the names of a module."""
        for name, home in MODULES.get(module.__name__, {}).items():
            home_module, _, attribute = home.partition(":")
            setattr(module, name, getattr(import_module(home_module), attribute))
        file = self._clone.file_of(module.__name__)
        if module.__name__ in MODULES and file is not None:
            self._add_names_of_fork(module, file)

    @staticmethod
    def _add_names_of_fork(module: ModuleType, file: Path) -> None:
        """Get names that the stand-in lacks from the clone's version, which is executed at the first access."""
        loaded: list[ModuleType] = []

        def of_fork(name: str) -> Any:
            spec = spec_from_file_location(f"{module.__name__} of the clone", file)
            if name.startswith("__") or spec is None or spec.loader is None:
                raise AttributeError(f"module {module.__name__!r} has no attribute {name!r}", name=name, obj=module)
            if not loaded:
                loaded.append(module_from_spec(spec))
                module.__file__ = str(file)  # from now on it counts as the clone's own module, which packing includes
                spec.loader.exec_module(loaded[0])
            return getattr(loaded[0], name)

        vars(module)["__getattr__"] = of_fork

    def _package(self, fullname: str) -> ModuleSpec:
        spec = ModuleSpec(fullname, self, is_package=True)
        folders = [folder.joinpath(*fullname.split(".")) for folder in self._clone.folders]
        spec.submodule_search_locations = [str(folder) for folder in folders if folder.is_dir()]
        return spec


def _foreign_modules() -> dict[str, ModuleType]:
    """Remove and return the modules with names of the earlier tools' modules that are not stand-ins."""
    if sys.modules.keys().isdisjoint(EARLIER_PACKAGES):
        return {}
    return {name: sys.modules.pop(name) for name in list(sys.modules) if is_earlier_import(name)}
