"""Puts the modules of the earlier tools in place while a config file is loaded and executed, and takes them away."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import module_from_spec, spec_from_file_location
from typing import TYPE_CHECKING, Any

from robot_runner.core.errors import did_you_mean
from robot_runner.legacy.recognition import is_earlier_import
from robot_runner.legacy.run_ids import clone_around
from robot_runner.legacy.stand_ins.catalogue import MODULES, PACKAGES

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path
    from types import ModuleType

__all__ = ["StandIns"]

_LOWER_CASE_ROOT = "plugins"


class StandIns(MetaPathFinder, Loader):
    """The stand-in modules of one config file.

    Modules of a fork's own (`Plugins.Profilers.MyMeter`) are found in the clone that the config file stands in, and so
    are names that a fork added to a module of the tool.
    """

    def __init__(self, config: Path) -> None:
        self._clone = clone_around(config)
        self._modules: dict[str, ModuleType] = {}
        self._depth = 0
        #: How many modules there were when ours had been taken away, if no others had their names: as long as it is so
        #: many, none of hundreds has to be looked at again, twice at each event.
        self._without_ours = -1

    @contextmanager
    def present(self) -> Iterator[None]:
        """Have the modules there; what else had their names comes back afterwards."""
        if self._depth:
            self._depth += 1
            try:
                yield
            finally:
                self._depth -= 1
            return
        others = {} if len(sys.modules) == self._without_ours else self._taken_away()
        sys.modules.update(self._modules)
        with_ours = len(sys.modules)
        sys.meta_path.insert(0, self)
        self._depth = 1
        try:
            yield
        finally:
            self._depth = 0
            sys.meta_path.remove(self)
            nothing_is_new = len(sys.modules) == with_ours and sys.modules.keys() >= self._modules.keys()
            self._modules = (
                {name: sys.modules.pop(name) for name in self._modules} if nothing_is_new else self._taken_away()
            )
            self._without_ours = -1 if others else len(sys.modules)
            sys.modules.update(others)

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Offer a stand-in, or a module of the fork's own.

        Raises:
            ModuleNotFoundError: neither tool ever had such a module.
        """
        del target
        if fullname in MODULES:
            return ModuleSpec(fullname, self)
        if fullname == _LOWER_CASE_ROOT:
            return PathFinder.find_spec(fullname) or self._package(fullname)
        if fullname in PACKAGES:
            return self._package(fullname)
        if not is_earlier_import(fullname):
            return None
        spec = PathFinder.find_spec(fullname, path or [])
        if spec is None:
            hint = did_you_mean(fullname, MODULES) if fullname.count(".") else ""
            raise ModuleNotFoundError(
                f"neither Robot Runner nor Experiment Runner ever had a module {fullname}. {hint}".strip(),
                name=fullname,
            )
        return spec

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        """Leave the making of the module to Python."""
        del spec
        return None

    def exec_module(self, module: ModuleType) -> None:
        """Fill a module with its names."""
        for name, home in MODULES.get(module.__name__, {}).items():
            home_module, _, attribute = home.partition(":")
            setattr(module, name, getattr(import_module(home_module), attribute))
        file = self._clone.file_of(module.__name__)
        if module.__name__ in MODULES and file is not None:
            self._add_names_of_fork(module, file)

    @staticmethod
    def _add_names_of_fork(module: ModuleType, file: Path) -> None:
        """Have what the stand-in lacks come from the clone's own version, which is executed when it is asked for."""
        loaded: list[ModuleType] = []

        def of_fork(name: str) -> Any:
            spec = spec_from_file_location(f"{module.__name__} of the clone", file)
            if name.startswith("__") or spec is None or spec.loader is None:
                raise AttributeError(f"module {module.__name__!r} has no attribute {name!r}", name=name, obj=module)
            if not loaded:
                loaded.append(module_from_spec(spec))
                spec.loader.exec_module(loaded[0])
            return getattr(loaded[0], name)

        vars(module)["__getattr__"] = of_fork

    def _package(self, fullname: str) -> ModuleSpec:
        spec = ModuleSpec(fullname, self, is_package=True)
        folders = [folder.joinpath(*fullname.split(".")) for folder in self._clone.folders]
        spec.submodule_search_locations = [str(folder) for folder in folders if folder.is_dir()]
        return spec

    def _taken_away(self) -> dict[str, ModuleType]:
        names = [name for name, module in sys.modules.items() if is_earlier_import(name) or self._is_own(module)]
        return {name: sys.modules.pop(name) for name in names}

    def _is_own(self, module: ModuleType | None) -> bool:
        return getattr(getattr(module, "__spec__", None), "loader", None) is self
