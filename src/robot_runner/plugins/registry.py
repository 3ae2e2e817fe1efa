"""Which plugins are installed: entry points of this and of other packages, found without importing them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from robot_runner.errors import PluginError, did_you_mean
from robot_runner.plugins.api.plugin import Plugin, Profiler, System

__all__ = ["GROUPS", "InstalledPlugin", "find_plugin", "installed_plugins"]

#: The entry-point group of each kind of plugin, and the class that a plugin of that kind derives from.
GROUPS: dict[str, type[Plugin]] = {"systems": System, "profilers": Profiler}


@dataclass(frozen=True, slots=True)
class InstalledPlugin:
    """A plugin as its package's entry point announces it; nothing is imported before `load`.

    Attributes:
        name: the entry point's name, such as `Ina219`.
        kind: `systems` or `profilers`.
        package: the distribution that brings it, and its version.
    """

    name: str
    kind: str
    package: str
    version: str
    entry_point: EntryPoint

    def load(self) -> type[Plugin]:
        """Import the plugin's class.

        Raises:
            PluginError: the import fails, or what it finds is no plugin of its kind.
        """
        where = f"plugin {self.name} ({self.entry_point.value}, of {self.package} {self.version})"
        try:
            found = self.entry_point.load()
        except Exception as error:
            raise PluginError(
                f"it cannot be imported: {type(error).__name__}: {error}",
                where=where,
                fix=f"Install or repair the package {self.package}.",
            ) from error
        expected = GROUPS[self.kind]
        if not (isinstance(found, type) and issubclass(found, expected)):
            raise PluginError(
                f"{found!r} is no {expected.__name__}",
                where=where,
                fix=f"Derive it from robot_runner.plugins.{expected.__name__}.",
            )
        return found


@cache
def installed_plugins(kind: str | None = None) -> tuple[InstalledPlugin, ...]:
    """Return what is installed, sorted by kind and name; `kind` keeps it to `systems` or `profilers`."""
    kinds = GROUPS if kind is None else (kind,)
    return tuple(
        _announced(entry_point, each)
        for each in kinds
        for entry_point in sorted(entry_points(group=f"robot_runner.{each}"), key=lambda point: point.name)
    )


def _announced(entry_point: EntryPoint, kind: str) -> InstalledPlugin:
    package = entry_point.dist
    return InstalledPlugin(
        name=entry_point.name,
        kind=kind,
        package=package.name if package else "unknown",
        version=package.version if package else "unknown",
        entry_point=entry_point,
    )


def find_plugin(kind: str, name: str) -> InstalledPlugin:
    """Return the installed plugin of this kind and name.

    Raises:
        PluginError: none has this name; the nearest is named.
    """
    known = installed_plugins(kind)
    for plugin in known:
        if plugin.name == name:
            return plugin
    raise PluginError(
        f"no plugin named {name!r} is installed",
        where=f"plugins.{kind}.{name}",
        fix=did_you_mean(name, [plugin.name for plugin in known]),
    )
