"""The import lines of the paper's Listing 1: `import plugins.profilers.Ina219` activates the plugin.

The modules exist only while a config file is loaded; a package named `plugins` beside the config file comes first.
"""

from __future__ import annotations

import sys
from contextlib import contextmanager
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from typing import TYPE_CHECKING

from robot_runner.plugins.registry import GROUPS, find_plugin

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from types import ModuleType

    from robot_runner.plugins.api.plugin import Plugin

__all__ = ["activating_imports"]

_ROOT = "plugins"


@contextmanager
def activating_imports() -> Iterator[list[type[Plugin]]]:
    """Let `import plugins.<kind>.<name>` import an installed plugin; yields the classes that were imported so."""
    activated: list[type[Plugin]] = []
    finder = _PluginFinder(activated)
    sys.meta_path.append(finder)
    try:
        yield activated
    finally:
        sys.meta_path.remove(finder)
        for name in [name for name, module in sys.modules.items() if _is_stand_in(module)]:
            del sys.modules[name]


def _is_stand_in(module: ModuleType | None) -> bool:
    spec = getattr(module, "__spec__", None)
    return isinstance(getattr(spec, "loader", None), _StandInLoader)


class _PluginFinder(MetaPathFinder):
    def __init__(self, activated: list[type[Plugin]]) -> None:
        self._activated = activated

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Offer `plugins`, `plugins.<kind>` and `plugins.<kind>.<name>`."""
        del path, target
        root, _, rest = fullname.partition(".")
        kind, _, name = rest.partition(".")
        if root != _ROOT or (kind and kind not in GROUPS) or "." in name:
            return None
        return ModuleSpec(fullname, _StandInLoader(self._activated, kind, name), is_package=not name)


class _StandInLoader(Loader):
    def __init__(self, activated: list[type[Plugin]], kind: str, name: str) -> None:
        self._activated = activated
        self._kind = kind
        self._name = name

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        """Leave the making of the module to Python."""
        del spec
        return None

    def exec_module(self, module: ModuleType) -> None:
        """Put the plugin's class into its module, and remember that it was asked for."""
        if not self._name:
            return
        plugin = find_plugin(self._kind, self._name).load()
        setattr(module, self._name, plugin)
        if plugin not in self._activated:
            self._activated.append(plugin)
