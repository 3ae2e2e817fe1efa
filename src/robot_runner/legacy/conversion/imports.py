"""Static parameters: what an earlier tool called them, and where its relative paths began."""

from __future__ import annotations

import ast
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from robot_runner.core.errors import Finding
from robot_runner.legacy.profilers.profiler_catalogue import plugin_of
from robot_runner.legacy.recognition import is_earlier_import
from robot_runner.legacy.stand_ins.modules import MODULES
from robot_runner.legacy.syntax import names_of_types, used_names, walk_bodies

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from robot_runner.legacy.conversion.edits import Edits

__all__ = ["ConvertedImports", "convert_imports", "convert_parameters"]


# The import lines: what an earlier tool's names are called here, and which have no name here.

_OUTPUT = "OutputProcedure"
_OURS = {
    "EventSubscriptionController": "EventSubscriptionController",
    "ExperimentFactorModel": "Factor",
    "ExperimentModel": "RunTableModel",
    "FactorModel": "Factor",
    "OperationType": "OperationType",
    "RobotRunnerConfig": "ExperimentConfig",
    "RobotRunnerContext": "RobotRunnerContext",
    "RobotRunnerEvents": "RobotRunnerEvents",
    "RunTableModel": "RunTableModel",
    "RunnerConfig": "ExperimentConfig",
    "RunnerContext": "RobotRunnerContext",
    "RunnerEvents": "RobotRunnerEvents",
    "BaseError": "RobotRunnerError",
}
#: What a name becomes that says of what type something is, and has no counterpart.
_ANYTHING = "object"
#: The modules of the earlier tools' profilers that need nothing of the tools around them.
_KEPT_HOMES = ("command_line", "property_lists", "data_source", "nvidia", "nvidia_names", "pico")


@dataclass(slots=True)
class ConvertedImports:
    """What the imports of a file become.

    Attributes:
        names: what a name of the file is called afterwards.
        outputs: the names under which the file prints.
        events: the names under which it has the events.
        findings: what has no counterpart.
    """

    names: dict[str, str] = field(default_factory=dict)
    outputs: set[str] = field(default_factory=set)
    events: set[str] = field(default_factory=set)
    ours: set[str] = field(default_factory=set)
    profilers: dict[str, set[str]] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)

    def lines(self) -> str:
        """Return the import lines that take the place of the earlier tool's."""
        ours = ", ".join(sorted(self.ours, key=str.casefold))
        block = f"from robot_runner import {ours}\n"
        if len(block) > _WIDTH:
            block = (
                "from robot_runner import (\n"
                + "".join(f"    {name},\n" for name in sorted(self.ours, key=str.casefold))
                + ")\n"
            )
        others = [f"from {home} import {', '.join(sorted(names))}\n" for home, names in sorted(self.profilers.items())]
        return (block if ours else "") + "".join(others)


_WIDTH = 120


def convert_imports(path: Path, tree: ast.Module, converted: ConvertedImports, edits: Edits) -> None:
    """Remove the earlier tool's import lines; the new ones are put in place by `ConvertedImports.lines`."""
    used, types = used_names(tree), names_of_types(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and is_earlier_import(node.module):
            for alias in node.names:
                bound = alias.asname or alias.name
                if alias.name == "*" or bound in used or (bound in types and alias.name in _OURS):
                    _take(converted, f"{path}:{node.lineno}", node.module, alias.name, bound)
                elif bound in types:
                    converted.names[bound] = _ANYTHING
            edits.remove_lines(node.lineno, node.end_lineno or node.lineno)
        elif isinstance(node, ast.Import) and any(is_earlier_import(alias.name) for alias in node.names):
            converted.findings.append(
                Finding.error(
                    f"{path}:{node.lineno}",
                    "a module of the earlier tool is imported as a whole",
                    "Import its names: from ... import ...",
                )
            )


def _take(converted: ConvertedImports, where: str, module: str, name: str, bound: str) -> None:
    if plugin_of(module) is not None or plugin_of(f"{module}.{name}") is not None:
        converted.findings += _take_profiler(converted, where, module, name, bound)
    elif name == _OUTPUT:
        converted.outputs.add(bound)
    elif name in _OURS:
        converted.names[bound] = _OURS[name]
        converted.ours.add(_OURS[name])
        if _OURS[name] == "RobotRunnerEvents":
            converted.events.add(bound)
    else:
        converted.findings.append(Finding.error(where, *_without_counterpart(module, name)))


def _without_counterpart(module: str, name: str) -> tuple[str, str]:
    if name == "*":
        return "everything of a module is imported", "Import the names that are used, then convert the file."
    if name in MODULES.get(module, ()):
        return f"{name} has no counterpart here", "Write this part by hand, then convert the file."
    return (
        f"{module} is a module of the clone that the config stands in",
        "Put it beside the config under a name of its own, then convert the file.",
    )


def _take_profiler(converted: ConvertedImports, where: str, module: str, name: str, bound: str) -> Iterator[Finding]:
    plugin = plugin_of(f"{module}.{name}") or plugin_of(module)
    home, _, attribute = MODULES.get(module, {}).get(name, "").partition(":")
    if home.rpartition(".")[2] in _KEPT_HOMES:
        imported = attribute if attribute == bound else f"{attribute} as {bound}"
        converted.profilers.setdefault(home, set()).add(imported)
        ours = plugin.ours if plugin is not None else ""
        if ours:
            yield Finding.warning(
                where,
                f"{name} is kept as it was, with its own calls",
                f"List our {ours} in `plugins` instead: it starts, stops and publishes by itself.",
            )
        return
    instead = (
        f"List our {plugin.ours} in `plugins` instead" if plugin is not None and plugin.ours else "Measure by hand"
    )
    yield Finding.error(where, f"{name} cannot be used outside a config of the earlier tool", f"{instead}.")


_PATH_PROPERTY = '''
    @property
    def experiment_path(self) -> Path:
        """Where everything of this experiment is kept; callbacks also have it as context.experiment_folder."""
        return Path(__file__).parent / Path(self.results_output_path).expanduser() / self.experiment_name'''


def convert_parameters(config: ast.ClassDef, results: Path, edits: Edits) -> None:
    """Rename the static parameters of a config class, wherever its body uses them.

    Args:
        config: the class.
        results: where the earlier tool kept results.
        edits: takes the changes.
    """
    for statement in walk_bodies(config.body):
        _rename_reads_of_name(statement, edits)
        for target in _targets(statement):
            if target.id == "name":
                edits.replace(target, "experiment_name")
            elif target.id == "experiment_path":
                edits.remove_lines(statement.lineno, statement.end_lineno or statement.lineno)
            elif target.id == "results_output_path" and not results.expanduser().is_absolute():
                _begin_in_current_folder(statement, edits)
    if any(isinstance(node, ast.Attribute) and node.attr == "experiment_path" for node in ast.walk(config)):
        edits.insert(edits.end_of(config), f"\n{_PATH_PROPERTY}")


def _rename_reads_of_name(statement: ast.stmt, edits: Edits) -> None:
    """Rename `name` where the body of the class goes on to use it; in a method it is another name."""
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return
    expressions = (each for each in ast.iter_child_nodes(statement) if isinstance(each, ast.expr))
    for node in (node for expression in expressions for node in ast.walk(expression)):
        match node:
            case ast.Name(id="name", ctx=ast.Load()):
                edits.replace(node, "experiment_name")
            case _:
                pass


def _begin_in_current_folder(statement: ast.stmt, edits: Edits) -> None:
    """Have a relative path begin where it did: ours begin where the config file is."""
    value = getattr(statement, "value", None)
    if value is not None:
        edits.insert(edits.start_of(value), "Path.cwd() / (")
        edits.insert(edits.end_of(value), ")")


def _targets(statement: ast.stmt) -> Iterator[ast.Name]:
    match statement:
        case ast.Assign(targets=targets):
            yield from (target for target in targets if isinstance(target, ast.Name))
        case ast.AnnAssign(target=ast.Name() as target):
            yield target
        case _:
            pass
