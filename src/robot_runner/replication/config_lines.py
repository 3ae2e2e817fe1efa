"""Find the line of a factor, a plugin, a measure or a method in a config, without executing it."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robot_runner.core.config.source import name_of, tree_or_empty
from robot_runner.core.storage.guarded_files import read_text
from robot_runner.core.storage.layout import ExperimentFolder

#: Methods that name measures, but do not yield them.
_DECLARING = frozenset({"__init__", "create_run_table"})
#: Classes of factors: called directly or by a method, such as `Factor.revisions(...)`.
_FACTORS = frozenset({"Factor", "FactorModel"})


@dataclass(frozen=True, slots=True)
class _Source:
    name: str
    lines: tuple[str, ...]
    tree: ast.Module

    def nodes(self, matches: Callable[[ast.AST], bool]) -> list[ast.AST]:
        """Return the nodes that match, from the first line to the last."""
        found = [node for node in ast.walk(self.tree) if matches(node)]
        return sorted(found, key=lambda node: getattr(node, "lineno", 0))

    def line(self, node: ast.AST) -> str:
        number = getattr(node, "lineno", 1)
        return f"{self.name}:{number}  {self.lines[number - 1].strip()}"


def executed_config(files: ExperimentFolder, execution: Mapping[str, Any]) -> Path | None:
    """Return the folder with the config that an execution executed, which a later execution may have replaced.

    Args:
        files: the experiment's folder.
        execution: the manifest's entry; empty for a run that was not executed.

    Returns:
        None if the config was replaced, and the manifest does not tell when.
    """
    if not execution or not files.earlier_configs.is_dir():
        return files.config
    number = execution.get("config_number")
    if number is None:
        return None
    earlier = files.earlier_configs / str(number)
    return earlier if earlier.is_dir() else files.config


class ConfigLines:
    """The config file of an experiment and its local modules, read but not executed.

    A line is returned as its file, relative to the experiment's folder, its number, two blanks, and its text; it is
    empty if it is not found.

    Example:
        >>> from pathlib import Path
        >>> ConfigLines(Path("nowhere"), Path("nowhere/config"), {"file": "study.py"}).of_factor("Task")
        ''
    """

    def __init__(self, root: Path, folder: Path | None, config: Mapping[str, Any]) -> None:
        """Read a folder of configs; files that do not parse are skipped.

        Args:
            root: the experiment's folder.
            folder: the folder of the config and its local modules, in `root`; None if it is not known.
            config: the manifest's entry: the names of the config's file and class, if known.

        Raises:
            OSError: a file cannot be read.
        """
        first = folder / str(config.get("file")) if folder is not None else None
        sources = () if folder is None else _sources(root, folder)
        self._sources = tuple(sorted(sources, key=lambda source: root / source.name != first))
        self._methods = _methods_of(str(config.get("class")), self._sources)

    def of_factor(self, name: str) -> str:
        """Return the line that makes a factor."""
        made = self._first(lambda node: _is_factor(node, name))
        return made or self._first(lambda node: _is_constant(node, name))

    def of_plugin(self, name: str, kind: str) -> str:
        """Return the line that makes a plugin, or that imports it.

        Args:
            name: the plugin's.
            kind: the name of its class; empty if it is not known.
        """
        if not kind:
            return ""
        # A call without a constant name may make this plugin; a call with another name does not.
        named = self._first(lambda node: _called(node) == kind and _keyword(node, "name") == name)
        made = named or self._first(lambda node: _called(node) == kind and _keyword(node, "name") is None)
        return made or self._first(lambda node: _imports(node, kind))

    def of_measure(self, name: str) -> str:
        """Return the line that yields a measure, or that of the method that does."""
        usual = self._methods.get("populate_run_data")
        others = (method for called, method in self._methods.items() if called not in _DECLARING)
        within = (method for method in (usual, *others) if method is not None and _mentions(method[1], name))
        found = next(within, None) or self._function_that_yields(name) or usual
        # Columns are named above the callbacks that fill them.
        return found[0].line(found[1]) if found else self._first(lambda node: _is_constant(node, name), -1)

    def _function_that_yields(self, measure: str) -> tuple[_Source, ast.AST] | None:
        """Return the function, of any file, that publishes a measure or puts it into a mapping by its name."""
        every = ((source, node) for source in self._sources for node in source.nodes(_is_function))
        return next((each for each in every if any(_yields(node, measure) for node in ast.walk(each[1]))), None)

    def of_method(self, name: str) -> str:
        """Return the first line of a method of the config's class, its own or that of a local base class."""
        found = self._methods.get(name)
        return found[0].line(found[1]) if found else ""

    def _first(self, matches: Callable[[ast.AST], bool], place: int = 0) -> str:
        return next((source.line(found[place]) for source in self._sources if (found := source.nodes(matches))), "")


def _sources(root: Path, folder: Path) -> Iterator[_Source]:
    for path in sorted(folder.rglob("*.py")):
        text = read_text(path, root, errors="replace")
        yield _Source(path.relative_to(root).as_posix(), tuple(text.split("\n")), tree_or_empty(text))


def _methods_of(name: str, sources: tuple[_Source, ...]) -> dict[str, tuple[_Source, ast.FunctionDef]]:
    """Return the methods of a class, also those inherited from classes in these files."""
    classes: dict[str, tuple[_Source, ast.ClassDef]] = {}
    for source in sources:
        for node in ast.walk(source.tree):
            if isinstance(node, ast.ClassDef):
                classes.setdefault(node.name, (source, node))
    methods: dict[str, tuple[_Source, ast.FunctionDef]] = {}
    pending = [name]
    while pending:
        if found := classes.pop(pending.pop(0), None):  # each once: bases may form a cycle
            source, made = found
            pending[:0] = map(name_of, made.bases)
            methods = {node.name: (source, node) for node in made.body if isinstance(node, ast.FunctionDef)} | methods
    return methods


def _is_constant(node: ast.AST, value: str) -> bool:
    return isinstance(node, ast.Constant) and node.value == value


def _mentions(node: ast.AST, value: str) -> bool:
    return any(_is_constant(each, value) for each in ast.walk(node))


def _is_function(node: ast.AST) -> bool:
    return isinstance(node, ast.FunctionDef) and node.name not in _DECLARING


def _yields(node: ast.AST, measure: str) -> bool:
    match node:
        case ast.Dict(keys=names):
            return any(each is not None and _is_constant(each, measure) for each in names)
        case ast.Call(args=[name, *_]) if _called(node) == "publish":
            return _is_constant(name, measure)
        case ast.Subscript(slice=name, ctx=ast.Store()):
            return _is_constant(name, measure)
    return False


def _called(node: ast.AST) -> str:
    return name_of(node.func) if isinstance(node, ast.Call) else ""


def _keyword(node: ast.AST, name: str) -> object:
    words = node.keywords if isinstance(node, ast.Call) else []
    return next((each.value.value for each in words if each.arg == name and isinstance(each.value, ast.Constant)), None)


def _is_factor(node: ast.AST, name: str) -> bool:
    if not isinstance(node, ast.Call) or not {_called(node), name_of(getattr(node.func, "value", node))} & _FACTORS:
        return False
    first = node.args[0].value if node.args and isinstance(node.args[0], ast.Constant) else None
    return name in {first, _keyword(node, "name"), _keyword(node, "factor_name")}


def _imports(node: ast.AST, kind: str) -> bool:
    names = node.names if isinstance(node, ast.Import | ast.ImportFrom) else []
    return any(alias.name.rpartition(".")[2] == kind for alias in names)
