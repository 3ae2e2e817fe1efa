"""Convert the imports of a config from the earlier tool's modules to ours."""

from __future__ import annotations

import ast
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from robot_runner.core.config.source import parsed
from robot_runner.core.errors import Finding
from robot_runner.legacy.profilers.profiler_catalogue import plugin_of
from robot_runner.legacy.recognition import is_earlier_import
from robot_runner.legacy.run_ids import clone_around
from robot_runner.legacy.stand_ins.machinery import OutputProcedure
from robot_runner.legacy.stand_ins.modules import MODULES
from robot_runner.legacy.syntax import Edits, attributes_of, imports_of, names_of_types, nodes, used_names

_WIDTH = 120
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
#: Replaces a name without a counterpart that occurs only in annotations.
_ANYTHING = "object"
#: The modules of the earlier tools' profilers that do not need the rest of the tools.
_KEPT_HOMES = ("command_line", "data_source", "nvidia", "pico")
#: The public module from which converted configs import these profilers.
_KEPT = "robot_runner.plugins.earlier"


@dataclass(slots=True)
class ConvertedFile:
    """A file that is being converted.

    Attributes:
        path: the original file.
        tree: its syntax tree.
        edits: the edits of its text.
        names: the new name of each name that the file imports.
        outputs: its names of the tool's class for printing.
        events: its names of the class of events.
        classes: its names of converted config classes of other files, such as `base.Common`.
        ours: the names that the converted file imports from `robot_runner`.
        profilers: the names that it imports from modules of profilers, by module.
        beside: the texts of the clone's own modules to write beside the converted file, by the names of their files.
        findings: on names and statements without a counterpart.
    """

    path: Path
    tree: ast.Module
    edits: Edits
    names: dict[str, str] = field(default_factory=dict)
    outputs: set[str] = field(default_factory=set)
    events: set[str] = field(default_factory=set)
    classes: set[str] = field(default_factory=set)
    ours: set[str] = field(default_factory=set)
    profilers: dict[str, set[str]] = field(default_factory=dict)
    beside: dict[str, str] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)

    def import_lines(self) -> str:
        """Return the import lines that replace the earlier tool's."""
        ours = sorted(self.ours, key=str.casefold)
        block = f"from robot_runner import {', '.join(ours)}\n"
        if len(block) > _WIDTH:
            block = "\n".join(["from robot_runner import (", *(f"    {name}," for name in ours), ")\n"])
        others = [f"from {home} import {', '.join(sorted(names))}\n" for home, names in sorted(self.profilers.items())]
        return (block if ours else "") + "".join(others)

    def text_with_imports(self, lines: list[int]) -> str:
        """Return the edited text, with the new imports at the first of these lines."""
        self.edits.insert(self.edits.line_start(min(lines, default=1)), self.import_lines())
        return self.edits.applied()

    def refuse(self, line: int, problem: str, fix: str) -> None:
        """Add an error for a line."""
        self.findings.append(Finding.error(f"{self.path}:{line}", problem, fix))

    def refuse_whole_module(self, line: int, problem: str) -> None:
        """Add an error for an import of a whole module."""
        self.refuse(line, problem, "Import its names: from ... import ...")

    def take(self, line: int, module: str, alias: ast.alias) -> None:
        """Convert an imported name of one of the tool's modules; an unused one is removed."""
        bound = alias.asname or alias.name
        types = names_of_types(self.tree)
        if alias.name == "*" or bound in used_names(self.tree) or (bound in types and alias.name in _OURS):
            if not _take_from_clone(self, module, alias):
                _take(self, line, module, alias.name, bound)
        elif bound in types:
            self.names[bound] = _ANYTHING


def convert_imports(converted: ConvertedFile) -> list[int]:
    """Remove the earlier tool's import lines; `ConvertedFile.import_lines` has the new ones.

    Returns the numbers of the removed lines.
    """
    lines = []
    for node in nodes(converted.tree, ast.ImportFrom):
        if not node.module or not is_earlier_import(node.module):
            continue
        for alias in node.names:
            converted.take(node.lineno, node.module, alias)
        converted.edits.remove_lines(node.lineno, node.end_lineno or node.lineno)
        lines.append(node.lineno)
    for imported in nodes(converted.tree, ast.Import):
        if any(is_earlier_import(alias.name) for alias in imported.names):
            converted.refuse_whole_module(imported.lineno, "a module of the earlier tool is imported as a whole")
    return lines


def _take(converted: ConvertedFile, line: int, module: str, name: str, bound: str) -> None:
    if plugin_of(f"{module}.{name}") is not None:
        _take_profiler(converted, line, module, name, bound)
    elif name == _OUTPUT:
        converted.outputs.add(bound)
    elif name in _OURS:
        converted.names[bound] = _OURS[name]
        converted.ours.add(_OURS[name])
        if _OURS[name] == "RobotRunnerEvents":
            converted.events.add(bound)
    else:
        converted.refuse(line, *_without_counterpart(module, name))


def _take_from_clone(converted: ConvertedFile, module: str, alias: ast.alias) -> bool:
    """Keep a plugin of the clone as a module beside the config; returns whether that is possible.

    It is not if the tool itself had such a module, or if the plugin imports more of the tool than the profilers that
    are kept.
    """
    file = clone_around(converted.path).file_of(module)
    if file is None or module in MODULES or alias.name == "*":
        return False
    text = _converted_module(file, converted.beside)
    if text is None:
        return False
    converted.beside[file.name] = text
    named = alias.name if alias.asname is None else f"{alias.name} as {alias.asname}"
    converted.profilers.setdefault(file.stem, set()).add(named)
    return True


def modules_beside(config: Path, imported: Iterable[Path]) -> dict[str, str]:
    """Return the texts of a config's modules beside its clone's `__main__.py`, by the names of their files.

    Modules that need more of the tool than the kept profilers and its printing are left out.
    """
    entries = [folder.resolve() for folder in clone_around(config).entries if folder.resolve() != config.parent]
    beside: dict[str, str] = {}
    left = [file for file in imported if file.parent in entries]
    while left:
        file = left.pop()
        text = _converted_module(file, beside) if file.name not in beside else None
        if text is not None:
            beside[file.name] = text
            names = {each.module.partition(".")[0] for each in imports_of(parsed(text))}
            left += [each for name in names if (each := file.with_name(f"{name}.py")).is_file()]
    return beside


def _converted_module(file: Path, beside: dict[str, str]) -> str | None:
    """Return the text of a clone's own module with public imports, or None if it needs the tool.

    The modules of the clone that this one needs are added to `beside`.
    """
    try:
        text = file.read_text(encoding="utf-8")
        converted = ConvertedFile(file, parsed(text), Edits(text))
    except (SyntaxError, ValueError, OSError):
        return None
    lines = convert_imports(converted)
    convert_names(converted)
    if converted.ours or any(finding.is_error for finding in converted.findings):
        return None
    beside |= converted.beside
    return converted.text_with_imports(lines)


#: Events with another name here.
_RENAMED_EVENTS = {
    "INTERACT": "LAUNCH_MISSION",
    "DURING_RUN": "LAUNCH_MISSION",
    "SIGNAL_SEMI_CONTINUE": "CONTINUE",
    "VALIDATE_EXPERIMENT": "BEFORE_EXPERIMENT",
}


def convert_names(converted: ConvertedFile) -> None:
    """Rename the earlier tool's names in a file, and replace the tool's printing by `print`."""
    tree, edits = converted.tree, converted.edits
    prints = set()
    for call in nodes(tree, ast.Call):
        match call.func:
            case ast.Attribute(value=ast.Name(id=name), attr=called) if (
                name in converted.outputs and called.startswith("console_log") and call.args
            ):
                end = edits.end_of(call.args[0])
                edits.replace_span(edits.start_of(call), edits.start_of(call.args[0]), "print(")
                edits.replace_span(end, edits.end_of(call), ")")
                prints.add(call.func)
    for owner, used in attributes_of(tree, converted.outputs):
        if used not in prints and hasattr(OutputProcedure, used.attr):
            fix = "Write this part by hand (`input` asks the user), then convert the file."
            converted.refuse(used.lineno, f"{owner.id}.{used.attr} has no counterpart here", fix)
    for _, event in attributes_of(tree, converted.events):
        if event.attr in _RENAMED_EVENTS:
            edits.replace(event, f"RobotRunnerEvents.{_RENAMED_EVENTS[event.attr]}")
    for node in nodes(tree, ast.Name):
        if converted.names.get(node.id, node.id) != node.id:
            edits.replace(node, converted.names[node.id])


def _without_counterpart(module: str, name: str) -> tuple[str, str]:
    if name == "*":
        return "everything of a module is imported", "Import the names that are used, then convert the file."
    if name in MODULES.get(module, ()):
        return f"{name} has no counterpart here", "Write this part by hand, then convert the file."
    return (
        f"{module} is a module of the clone that the config stands in",
        "Put it beside the config under a name of its own, then convert the file.",
    )


def _take_profiler(converted: ConvertedFile, line: int, module: str, name: str, bound: str) -> None:
    plugin = plugin_of(f"{module}.{name}")
    ours = plugin.ours if plugin is not None else ""
    home, _, attribute = MODULES.get(module, {}).get(name, "").partition(":")
    if home.rpartition(".")[2] not in _KEPT_HOMES:  # which work without the tool
        instead = f"List our {ours} in `plugins` instead." if ours else "Measure by hand."
        converted.refuse(line, f"{name} cannot be used outside a config of the earlier tool", instead)
        return
    imported = attribute if attribute == bound else f"{attribute} as {bound}"
    converted.profilers.setdefault(_KEPT, set()).add(imported)
    if ours:
        problem = f"{name} is kept as it was, with its own calls"
        fix = f"List our {ours} in `plugins` instead: it starts, stops and publishes by itself."
        converted.findings.append(Finding.warning(f"{converted.path}:{line}", problem, fix))
