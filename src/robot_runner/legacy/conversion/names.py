"""The names of a config: imports, static parameters, run tables and factors in our spelling."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from robot_runner.core.errors import Finding
from robot_runner.legacy.earlier_exclusions import EarlierFactor, NamedExclusion, named_exclusions
from robot_runner.legacy.profilers.profiler_catalogue import plugin_of
from robot_runner.legacy.recognition import is_earlier_import
from robot_runner.legacy.run_ids import clone_around
from robot_runner.legacy.stand_ins.modules import MODULES
from robot_runner.legacy.syntax import Edits, names_of_types, nodes, used_names, walk_bodies

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from robot_runner.legacy.session import Session

__all__ = ["ONLY_FACTOR", "ConvertedImports", "convert_imports", "convert_parameters", "convert_run_tables"]

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
#: What a name becomes that stands in annotations only, and has no counterpart.
_ANYTHING = "object"
#: The modules of the earlier tools' profilers that need nothing of the tools around them.
_KEPT_HOMES = ("command_line", "data_source", "nvidia", "pico")
#: The door by which a converted config imports from them.
_KEPT = "robot_runner.plugins.earlier"


@dataclass(slots=True)
class ConvertedImports:
    """What the imports of a file become.

    Attributes:
        names: the new name of each name that the file imports.
        outputs: the names under which the file prints.
        events: the names under which it has the events.
        ours: what the converted file imports from `robot_runner`.
        profilers: what it imports from modules of profilers, by module.
        beside: modules of the clone's own that are to be written beside the converted file, by their files' names.
        findings: what has no counterpart.
    """

    names: dict[str, str] = field(default_factory=dict)
    outputs: set[str] = field(default_factory=set)
    events: set[str] = field(default_factory=set)
    ours: set[str] = field(default_factory=set)
    profilers: dict[str, set[str]] = field(default_factory=dict)
    beside: dict[str, str] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)

    def lines(self) -> str:
        """Return the import lines that take the place of the earlier tool's."""
        ours = sorted(self.ours, key=str.casefold)
        block = f"from robot_runner import {', '.join(ours)}\n"
        if len(block) > _WIDTH:
            block = "\n".join(["from robot_runner import (", *(f"    {name}," for name in ours), ")\n"])
        others = [f"from {home} import {', '.join(sorted(names))}\n" for home, names in sorted(self.profilers.items())]
        return (block if ours else "") + "".join(others)


def convert_imports(path: Path, tree: ast.Module, converted: ConvertedImports, edits: Edits) -> None:
    """Remove the earlier tool's import lines; the new ones are put in place by `ConvertedImports.lines`."""
    used, types = used_names(tree), names_of_types(tree)
    for node in nodes(tree, ast.ImportFrom):
        if not node.module or not is_earlier_import(node.module):
            continue
        for alias in node.names:
            bound = alias.asname or alias.name
            if alias.name == "*" or bound in used or (bound in types and alias.name in _OURS):
                if not _take_from_clone(converted, path, node.module, alias):
                    _take(converted, f"{path}:{node.lineno}", node.module, alias.name, bound)
            elif bound in types:
                converted.names[bound] = _ANYTHING
        edits.remove_lines(node.lineno, node.end_lineno or node.lineno)
    converted.findings += [
        Finding.error(
            f"{path}:{node.lineno}",
            "a module of the earlier tool is imported as a whole",
            "Import its names: from ... import ...",
        )
        for node in nodes(tree, ast.Import)
        if any(is_earlier_import(alias.name) for alias in node.names)
    ]


def _take(converted: ConvertedImports, where: str, module: str, name: str, bound: str) -> None:
    if plugin_of(f"{module}.{name}") is not None:
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


def _take_from_clone(converted: ConvertedImports, config: Path, module: str, alias: ast.alias) -> bool:
    """Have a plugin of the clone's own stand beside the config; returns whether that can be.

    It cannot where the tool itself had such a module, or where the plugin imports more of the tool than profilers that
    are kept.
    """
    file = clone_around(config).file_of(module)
    if file is None or module in MODULES or alias.name == "*":
        return False
    try:
        text = _converted_module(file)
    except (SyntaxError, ValueError, OSError):
        return False
    if text is None:
        return False
    converted.beside[file.name] = text
    named = alias.name if alias.asname is None else f"{alias.name} as {alias.asname}"
    converted.profilers.setdefault(file.stem, set()).add(named)
    return True


def _converted_module(file: Path) -> str | None:
    """Return the text of a clone's own module with public imports, or None where it needs the tool."""
    text = file.read_text(encoding="utf-8")
    tree, edits = ast.parse(text), Edits(text)
    if any(is_earlier_import(alias.name) for node in nodes(tree, ast.Import) for alias in node.names):
        return None
    for node in nodes(tree, ast.ImportFrom):
        if node.module is None or not is_earlier_import(node.module):
            continue
        if not all(is_kept(node.module, alias.name) for alias in node.names):
            return None
        names = ", ".join(f"{alias.name} as {alias.asname}" if alias.asname else alias.name for alias in node.names)
        edits.replace(node, f"from {_KEPT} import {names}")
    return edits.applied()


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
    plugin = plugin_of(f"{module}.{name}")
    ours = plugin.ours if plugin is not None else ""
    attribute = MODULES.get(module, {}).get(name, "").partition(":")[2]
    if not is_kept(module, name):
        instead = f"List our {ours} in `plugins` instead." if ours else "Measure by hand."
        yield Finding.error(where, f"{name} cannot be used outside a config of the earlier tool", instead)
        return
    imported = attribute if attribute == bound else f"{attribute} as {bound}"
    converted.profilers.setdefault(_KEPT, set()).add(imported)
    if ours:
        yield Finding.warning(
            where,
            f"{name} is kept as it was, with its own calls",
            f"List our {ours} in `plugins` instead: it starts, stops and publishes by itself.",
        )


def is_kept(module: str, name: str) -> bool:
    """Whether a name of an earlier tool's module works without the tool: `robot_runner.plugins.earlier` has it."""
    return MODULES.get(module, {}).get(name, "").partition(":")[0].rpartition(".")[2] in _KEPT_HOMES


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
    if any(node.attr == "experiment_path" for node in nodes(config, ast.Attribute)):
        edits.insert(edits.end_of(config), f"\n{_PATH_PROPERTY}")


def _rename_reads_of_name(statement: ast.stmt, edits: Edits) -> None:
    """Rename `name` where the body of the class goes on to use it; in a method it is another name."""
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return
    for expression in ast.iter_child_nodes(statement):
        for node in nodes(expression, ast.Name) if isinstance(expression, ast.expr) else ():
            if node.id == "name" and isinstance(node.ctx, ast.Load):
                edits.replace(node, "experiment_name")


def _begin_in_current_folder(statement: ast.stmt, edits: Edits) -> None:
    """Have a relative path begin where it did: ours begin where the config file is."""
    value = getattr(statement, "value", None)
    if value is not None:
        edits.insert(edits.start_of(value), "Path.cwd() / (")
        edits.insert(edits.end_of(value), ")")


def _targets(statement: ast.stmt) -> Iterator[ast.Name]:
    targets = statement.targets if isinstance(statement, ast.Assign) else []
    if isinstance(statement, ast.AnnAssign):
        targets = [statement.target]
    yield from (target for target in targets if isinstance(target, ast.Name))


#: Stands where nothing is varied: ours vary at least one thing.
ONLY_FACTOR = "setup"
_ONLY_TREATMENT = "as it is"
_KEYWORDS = {
    "exclude_variations": "exclude_combinations",
    "num_repetitions": "repetitions",
    "iterations": "repetitions",
    "randomize_order": "shuffle",
    "treatments": "factors",
}
_IN_PLACE = "num_of_repetitions"
#: Calls of a model or a factor that are attributes here, or that return the model itself.
_CALLS = {
    "get_factors": ".factors",
    "get_data_columns": ".data_columns",
    "get_factor_name": ".name",
    "get_treatments": ".treatments",
    "get_experiment_run_table": "",
    "generate_experiment_run_table": "",
}


def convert_run_tables(session: Session, tree: ast.Module, imports: ConvertedImports, edits: Edits) -> None:
    """Convert every call that makes a run table or asks one."""
    for call in nodes(tree, ast.Call):
        match call.func:
            case ast.Name(id=name) if imports.names.get(name) == "RunTableModel":
                _convert_model(session, call, edits)
                if _vary(call, edits):
                    imports.ours.add("Factor")
            case ast.Attribute(value=owner, attr=name) if name in _CALLS and not call.args and not call.keywords:
                edits.replace_span(edits.end_of(owner), edits.end_of(call), _CALLS[name])
            case _:
                pass
    for node in nodes(tree, ast.Attribute):
        if node.attr == "factor_name":
            edits.replace_span(edits.end_of(node.value), edits.end_of(node), ".name")


def _convert_model(session: Session, call: ast.Call, edits: Edits) -> None:
    for argument in call.args[2:]:
        edits.insert(edits.start_of(argument), f"{_keyword_of(argument)}=")
    exclusions = call.args[1] if len(call.args) > 1 else None
    for keyword in call.keywords:
        if keyword.arg == _IN_PLACE:
            _convert_repetitions_in_place(call, keyword, edits)
        elif keyword.arg in _KEYWORDS:
            start = edits.start_of(keyword)
            edits.replace_span(start, start + len(keyword.arg), _KEYWORDS[keyword.arg])
        if keyword.arg in {"exclude_variations", "exclude_combinations"}:
            exclusions = keyword.value
    if exclusions is not None:
        _convert_exclusions(session, exclusions, edits)


def _factors_of(call: ast.Call) -> ast.expr | None:
    named = (each.value for each in call.keywords if each.arg in {"factors", "treatments"})
    return next(named, call.args[0] if call.args else None)


def _vary(call: ast.Call, edits: Edits) -> bool:
    """Give a model without factors one that has one treatment; returns whether it was done."""
    factors = _factors_of(call)
    only = f'[Factor("{ONLY_FACTOR}", ["{_ONLY_TREATMENT}"])]'
    if factors is None:
        edits.insert(edits.find("(", edits.end_of(call.func)) + 1, f"factors={only}, ")
    elif isinstance(factors, ast.List) and not factors.elts:
        edits.replace(factors, only)
    else:
        return False
    return True


def _keyword_of(argument: ast.expr) -> str:
    match argument:
        case ast.Constant(value=bool()):
            return "shuffle"
        case ast.Constant(value=int()):
            return "repetitions"
        case _:
            return "data_columns"


def _convert_repetitions_in_place(call: ast.Call, keyword: ast.keyword, edits: Edits) -> None:
    """Make a factor of repetitions that stand together: it changes fastest, and has the fork's column."""
    factors = _factors_of(call)
    if isinstance(factors, ast.List) and factors.elts:
        count = edits.source(keyword.value)
        edits.insert(edits.end_of(factors.elts[-1]), f', Factor("repetition", range(1, {count} + 1))')
    edits.replace(keyword, "repetitions=1")


def _convert_exclusions(session: Session, exclusions: ast.expr, edits: Edits) -> None:
    """Name the factors of sets of values, and leave out what names no treatment: ours are refused for that."""
    if isinstance(exclusions, ast.Constant) and exclusions.value is None:
        edits.replace(exclusions, "[]")
    model = session.models[-1] if session.models else None
    if not isinstance(exclusions, ast.List) or model is None:
        return
    given = list(model.exclusions or ())
    if len(given) != len(exclusions.elts):
        return  # the list is not the one that was given to the model
    factors = model.get_factors()
    named = [named_exclusions(session, factors, [each])[0] for each in given]
    for element, value, exclusion in zip(exclusions.elts, given, named, strict=True):
        if not isinstance(value, Mapping) or exclusion.has_unknown:
            edits.replace(element, _in_our_words(exclusion, factors))
    _leave_out(exclusions, [each.names_nothing for each in named], edits)


def _leave_out(exclusions: ast.List, is_idle: Sequence[bool], edits: Edits) -> None:
    """Remove elements of a list, each with the comma and the comment after it."""
    elements = exclusions.elts
    if not any(is_idle):
        return
    if all(is_idle):
        edits.replace(exclusions, "[]")
        return
    last = max(place for place, idle in enumerate(is_idle) if not idle)
    for place in range(last):
        if is_idle[place]:
            edits.replace_span(edits.start_of(elements[place]), edits.start_of(elements[place + 1]), "")
    if last < len(elements) - 1:
        edits.replace_span(edits.end_of(elements[last]), edits.end_of(elements[-1]), "")


def _in_our_words(named: NamedExclusion, factors: Sequence[EarlierFactor]) -> str:
    if named.treatments is not None:
        parts = [f"{factors[place].factor_name!r}: {list(values)!r}" for place, values in named.treatments.items()]
        return "{" + ", ".join(parts) + "}"
    values = "{" + ", ".join(map(repr, named.values)) + "}" if named.values else "set()"
    return f"lambda combination: {values} <= set(combination.values())"
