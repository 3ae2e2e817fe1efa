"""The plugins of the earlier tools that a config file uses: what each needs, and whether it is there."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robot_runner.config.source import read_tree
from robot_runner.dialects.profilers.catalogue import EarlierPlugin, plugin_of
from robot_runner.dialects.syntax import imports_of, used_names
from robot_runner.errors import ConfigError, Finding

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

__all__ = ["check_plugins", "is_robot_operated"]


def check_plugins(files: Iterable[Path]) -> list[Finding]:
    """Return what stands in the way of the plugins that files use.

    Args:
        files: the config file, and the modules beside it that it imports.
    """
    return list(dict.fromkeys(finding for where, plugin in _used_plugins(files) for finding in _missing(where, plugin)))


def is_robot_operated(files: Iterable[Path]) -> bool:
    """Return whether files use a plugin that operates a robot."""
    return any(plugin.operates_robot for _, plugin in _used_plugins(files))


def _used_plugins(files: Iterable[Path]) -> Iterator[tuple[str, EarlierPlugin]]:
    for file in files:
        try:
            _, tree = read_tree(file)
        except ConfigError:  # a neighbour that Python could read in another way
            continue
        used = used_names(tree)
        for each in imports_of(tree):
            plugin = plugin_of(f"{each.module}.{each.name}") or plugin_of(each.module)
            if plugin is not None and plugin.names and not each.is_guarded and each.bound_as in used:
                yield f"{file}:{each.line}", plugin


def _missing(where: str, plugin: EarlierPlugin) -> Iterator[Finding]:
    ours = f"our {plugin.ours}, which `robot-runner plugins` describes." if plugin.ours else ""
    instead = f" Or take {ours}" if ours else ""
    for need in plugin.needs:
        if not need.is_there():
            yield Finding.error(where, f"{plugin.name} needs {need.what}, which is not here", need.fix + instead)
    if plugin.note:
        yield Finding.warning(where, plugin.note, f"Take {ours}" if ours else "")
