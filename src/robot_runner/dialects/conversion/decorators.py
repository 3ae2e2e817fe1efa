"""CodeCarbon's decorators: our profiler of the same name takes their place."""

from __future__ import annotations

import ast
from typing import TYPE_CHECKING

from robot_runner.dialects.profilers.catalogue import plugin_of
from robot_runner.dialects.syntax import imports_of
from robot_runner.errors import Finding

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.dialects.conversion.edits import Edits
    from robot_runner.dialects.conversion.imports import ConvertedImports

__all__ = ["convert_decorators"]

_PLUGIN = "CodeCarbon"
_HOME = "robot_runner.plugins.profilers"
_COUNTRY = "country_iso_code"
_COLUMNS = (
    "its columns are Emissions (kg), Energy (J), CPUEnergy (J) and MemoryEnergy (J) now; the earlier ones were in kWh"
)


def convert_decorators(
    where: str, tree: ast.Module, config: ast.ClassDef, imports: ConvertedImports, edits: Edits
) -> None:
    """Remove the decorators, from the tree as well, and have the config list the profiler."""
    names = {each.bound_as for each in imports_of(tree) if _is_decorating(each.module, each.name)}
    removed: list[ast.expr] = []
    for node in (config, *config.body):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found = [each for each in node.decorator_list if _root(each) in names]
            node.decorator_list = [each for each in node.decorator_list if each not in found]
            removed += found
    for decorator in removed:
        edits.remove_lines(decorator.lineno, decorator.end_lineno or decorator.lineno)
    if removed:
        imports.findings.append(_listed(where, config, list(_countries(removed)), imports, edits))


def _listed(
    where: str, config: ast.ClassDef, countries: list[ast.expr], imports: ConvertedImports, edits: Edits
) -> Finding:
    if not countries:
        return Finding.error(
            where, f"CodeCarbon's decorators do not say the {_COUNTRY}", f"Write it, as in {_COUNTRY}='NLD'."
        )
    first = config.body[0]
    country = edits.source(countries[0])
    edits.insert(edits.start_of(first), f"plugins = [{_PLUGIN}(country={country})]\n{' ' * first.col_offset}")
    imports.profilers.setdefault(_HOME, set()).add(_PLUGIN)
    return Finding.warning(
        where, f"CodeCarbon's decorators are a profiler now: {_COLUMNS}", "Read them in your analysis."
    )


def _countries(decorators: list[ast.expr]) -> Iterator[ast.expr]:
    for decorator in decorators:
        if isinstance(decorator, ast.Call):
            yield from (keyword.value for keyword in decorator.keywords if keyword.arg == _COUNTRY)


def _is_decorating(module: str, name: str) -> bool:
    plugin = plugin_of(f"{module}.{name}") or plugin_of(module)
    return plugin is not None and plugin.ours == _PLUGIN


def _root(decorator: ast.expr) -> str:
    """Return the name that a decorator begins with: `tracker` of `@tracker.start(country="NLD")`."""
    while isinstance(decorator, ast.Call | ast.Attribute):
        decorator = decorator.func if isinstance(decorator, ast.Call) else decorator.value
    return decorator.id if isinstance(decorator, ast.Name) else ""
