"""List the installed plugins, with their measures and parameters.

Each plugin says what it measures, what it needs, and what it can be given. Plugins of other packages are found through
their entry points, as our own are.
"""

from __future__ import annotations

import inspect
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

from rich.text import Text

from robot_runner.cli.console import UserConsole, output, print_facts, print_folded, print_json, quiet_loading
from robot_runner.cli.findings import as_json, print_findings
from robot_runner.cli.parser import Parser, add_json
from robot_runner.core.entry_points import EntryPoint
from robot_runner.core.errors import Finding, PluginError
from robot_runner.core.events.measure import Measure
from robot_runner.core.late_annotations import OPEN_KINDS, parameters_of
from robot_runner.core.plugin import GROUPS, installed_plugins, load_plugin


@dataclass(frozen=True, slots=True)
class _Described:
    """A plugin, and why it cannot be imported, or is not found by its name."""

    installed: EntryPoint
    summary: str = ""
    measures: Sequence[Measure] = ()
    needs: str = ""
    parameters: Sequence[str] = ()
    finding: Finding | None = None


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add_json(parser)


def execute(arguments: Namespace) -> int:
    """Print everything that is installed."""
    with quiet_loading():
        found: dict[tuple[str, str], EntryPoint] = {}  # by the name of each, as `find_plugin` does
        plugins = [_described(each, found.setdefault((each.kind, each.name), each)) for each in installed_plugins()]
    if arguments.json:
        print_json(_as_json(plugins))
    else:
        _print(output(), plugins)
    return 0


def _described(installed: EntryPoint, found: EntryPoint) -> _Described:
    try:
        plugin = load_plugin(installed)
        return _Described(
            installed,
            summary=(inspect.getdoc(plugin) or "").partition("\n\n")[0].replace("\n", " "),
            measures=tuple(plugin.measures),
            needs=plugin.needs,
            parameters=tuple(map(_written, parameters_of(plugin).values())),
            finding=None if found is installed else _hidden(installed, found),
        )
    except PluginError as error:
        return _Described(installed, finding=error.as_finding())
    except Exception as error:  # noqa: BLE001 - a stranger's class may raise anything when it is looked at
        problem = f"the plugin cannot be described: {type(error).__name__}: {error}"
        fix = f"Update or remove the package {installed.package}."
        finding = Finding.error(f"plugin {installed.name}", problem, fix)
        return _Described(installed, finding=finding)


def _hidden(installed: EntryPoint, found: EntryPoint) -> Finding:
    fix = f"Import it by its module, try it as {installed.value}, or have its author rename the entry point."
    return Finding.warning(installed.where, f"by this name, that of {found.package} is found", fix)


def _written(parameter: inspect.Parameter) -> str:
    # As it would be typed into a config: the kinds and the annotations say more than a user asks for.
    if parameter.kind in OPEN_KINDS:
        return str(parameter.replace(annotation=parameter.empty))
    default = parameter.default
    if default is parameter.empty:
        return parameter.name
    return f"{parameter.name}={default.name if isinstance(default, Enum) else repr(default)}"


def _print(console: UserConsole, plugins: Sequence[_Described]) -> None:
    for kind in GROUPS:
        console.print(kind.capitalize(), style="bold underline")
        of_kind = [plugin for plugin in plugins if plugin.installed.kind == kind]
        if not of_kind:
            console.print("  none is installed")
        for plugin in of_kind:
            _print_plugin(console, plugin)
        console.print()
    console.print("In a config:  from robot_runner.plugins.profilers import PsUtil;  plugins = [PsUtil(rate_hz=5)]")


def _print_plugin(console: UserConsole, plugin: _Described) -> None:
    installed = plugin.installed
    console.print(
        Text("  ")
        .append(installed.name, style="bold")
        .append(f"  {installed.package} {installed.version}", style="dim")
    )
    if plugin.finding:
        print_findings(console, [plugin.finding])
    if plugin.finding and plugin.finding.is_error:
        return
    print_folded(console, "    ", plugin.summary, style="")
    facts = [("Measures" if not place else "", _measure(each)) for place, each in enumerate(plugin.measures)]
    facts += [("Needs", plugin.needs), ("Parameters", ", ".join(plugin.parameters))]
    print_facts(console, facts, indent=4)


def _measure(measure: Measure) -> str:
    unit = f" ({measure.unit})" if measure.unit else ""
    return f"{measure.name}{unit}: {measure.description}" if measure.description else f"{measure.name}{unit}"


def _as_json(plugins: Sequence[_Described]) -> dict[str, list[dict[str, Any]]]:
    return {kind: [_plugin_as_json(plugin) for plugin in plugins if plugin.installed.kind == kind] for kind in GROUPS}


def _plugin_as_json(plugin: _Described) -> dict[str, Any]:
    installed = plugin.installed
    return {
        "name": installed.name,
        "package": installed.package,
        "version": installed.version,
        "class": installed.value,
        "summary": plugin.summary,
        "measures": [
            {"name": measure.name, "unit": measure.unit, "description": measure.description}
            for measure in plugin.measures
        ],
        "needs": plugin.needs,
        "parameters": list(plugin.parameters),
        "findings": as_json([plugin.finding]) if plugin.finding else [],
    }
