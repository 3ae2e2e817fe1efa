"""The plugins of the earlier tools that a config file uses: what each needs, and whether it is there."""

from __future__ import annotations

import ast
from typing import TYPE_CHECKING

from robot_runner.config.source import read_tree
from robot_runner.dialects.profilers.catalogue import EarlierPlugin, plugin_of
from robot_runner.dialects.syntax import imports_of
from robot_runner.errors import ConfigError, Finding

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

__all__ = ["check_plugins"]


def check_plugins(files: Iterable[Path], robot: str | None) -> list[Finding]:
    """Return what stands in the way of the plugins that files use.

    Args:
        files: the config file, and the modules beside it that it imports.
        robot: how the robot is to be reached, or None.
    """
    findings: list[Finding] = []
    for file in files:
        try:
            _, tree = read_tree(file)
        except ConfigError:  # a neighbour that Python could read in another way
            continue
        used = _used_names(tree)
        for each in imports_of(tree):
            plugin = plugin_of(f"{each.module}.{each.name}") or plugin_of(each.module)
            if plugin is not None and plugin.names and not each.is_guarded and each.bound_as in used:
                findings += _missing(f"{file}:{each.line}", plugin, robot)
    return list(dict.fromkeys(findings))


def _missing(where: str, plugin: EarlierPlugin, robot: str | None) -> Iterator[Finding]:
    ours = f"our {plugin.ours}, which `robot-runner plugins` describes." if plugin.ours else ""
    instead = f" Or take {ours}" if ours else ""
    for need in plugin.needs:
        if not need.is_there():
            yield Finding.error(where, f"{plugin.name} needs {need.what}, which is not here", need.fix + instead)
    if plugin.operates_robot and robot is None:
        yield Finding.error(
            where,
            f"{plugin.name} operates a robot, and the experiment names none",
            "Name it: --set robot=simulated (or how yours is reached).",
        )
    if plugin.note:
        yield Finding.warning(where, plugin.note, f"Take {ours}" if ours else "")


def _used_names(tree: ast.Module) -> set[str]:
    """Return the names that a file uses other than to say of what type something is."""
    annotations = {
        id(node)
        for each in ast.walk(tree)
        for annotation in (getattr(each, "annotation", None), getattr(each, "returns", None))
        if annotation is not None
        for node in ast.walk(annotation)
    }
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and id(node) not in annotations}
