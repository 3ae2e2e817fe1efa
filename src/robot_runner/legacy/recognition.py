"""Recognise from its syntax tree for which tool a config file was written."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.core.config.source import CONFIG_CLASS, read_tree
from robot_runner.core.errors import ConfigError, Finding, nearest
from robot_runner.legacy.syntax import ImportedName, bound_names, classes_of, has_star_import, imports_of

if TYPE_CHECKING:
    import ast


class Dialect(Enum):
    """The earlier tools whose config files can be loaded; the value is the tool's name."""

    ROBOT_RUNNER = "Robot Runner"
    EXPERIMENT_RUNNER = "Experiment Runner"

    @property
    def class_name(self) -> str:
        """The tool's name of the config class."""
        return CONFIG_CLASS if self is Dialect.ROBOT_RUNNER else "RunnerConfig"


@dataclass(frozen=True, slots=True)
class Recognised:
    """A config file of an earlier tool.

    Attributes:
        path: the absolute path.
        tree: its syntax tree.
    """

    dialect: Dialect
    path: Path
    text: str
    tree: ast.Module


#: Packages of the earlier tools (`Backbone` in the first version of Robot Runner).
_ROOTS = "Backbone ConfigValidator EventManager ExperimentOrchestrator ExtendedTyping Plugins ProgressManager"
_EARLIER_ROOTS = frozenset(_ROOTS.split())
#: Some commits of Robot Runner have `plugins` in lower case, but capitals in the subfolders.
_EARLIER_PREFIXES = ("plugins.Profilers", "plugins.Systems")
#: If any module of the earlier tools is imported, one of these is in `sys.modules`.
EARLIER_PACKAGES = (*sorted(_EARLIER_ROOTS), *_EARLIER_PREFIXES)
_OWN_PREFIXES = ("plugins.systems", "plugins.profilers", "robot_runner")

_OF_ROBOT_RUNNER = frozenset({"RobotRunnerConfig", "RobotRunnerContext", "RobotRunnerEvents"})
_OF_EXPERIMENT_RUNNER = frozenset({"RunnerConfig", "RunnerContext", "RunnerEvents"})
_MOST_PARENTS = 4


def recognise(path: Path) -> Recognised | None:
    """Return the earlier tool's dialect and syntax tree of a config file, or None if it is one of our own.

    Raises:
        ConfigError: the file cannot be read or parsed, mixes the spellings of several tools, or lacks the config class
            of the tool that it imports.
    """
    text, tree = read_tree(path)
    dialect = _Reading(path.resolve(), tree).dialect()
    return None if dialect is None else Recognised(dialect, path.resolve(), text, tree)


def is_earlier_import(module: str) -> bool:
    """Return whether a module belongs to the earlier tools.

    Example:
        >>> is_earlier_import("EventManager.Models.RunnerEvents"), is_earlier_import("plugins.profilers.PsUtil")
        (True, False)
    """
    return module.partition(".")[0] in _EARLIER_ROOTS or _begins_with(module, _EARLIER_PREFIXES)


class _Reading:
    def __init__(self, path: Path, tree: ast.Module, depth: int = 0) -> None:
        self._path = path
        self._tree = tree
        self._depth = depth
        self._imports = imports_of(tree)
        self._earlier = [each for each in self._imports if is_earlier_import(each.module)]
        self._own = [each for each in self._imports if _begins_with(each.module, _OWN_PREFIXES)]
        self._bound = bound_names(tree.body)

    def dialect(self) -> Dialect | None:
        """Return the tool, or None for our own dialect."""
        if self._own and self._earlier:
            raise self._mixed_with_own()
        if self._own:
            return None
        tools = self._tools()
        if len(tools) > 1:
            raise self._mixed(tools)
        if self._earlier:
            return self._with_class(tools)
        return self._without_imports()

    def _tools(self) -> dict[Dialect, list[tuple[int, str]]]:
        """Return the evidence for each tool: a line number and a description."""
        tools: defaultdict[Dialect, list[tuple[int, str]]] = defaultdict(list)
        for each in self._earlier:
            parts = {each.name, each.module.rpartition(".")[2]}
            if parts & _OF_ROBOT_RUNNER:
                tools[Dialect.ROBOT_RUNNER].append((each.line, f"imports {each.name or each.module}"))
            elif parts & _OF_EXPERIMENT_RUNNER or each.module.startswith("ExtendedTyping"):
                tools[Dialect.EXPERIMENT_RUNNER].append((each.line, f"imports {each.name or each.module}"))
        classes = classes_of(self._tree)
        for dialect in Dialect:
            if dialect.class_name in classes and (self._earlier or dialect is Dialect.EXPERIMENT_RUNNER):
                tools[dialect].append((classes[dialect.class_name].lineno, f"has the class {dialect.class_name}"))
        return tools

    def _with_class(self, tools: dict[Dialect, list[tuple[int, str]]]) -> Dialect:
        named = (each for each in Dialect if each.class_name in self._bound)
        dialect = next(iter(tools), None) or next(named, Dialect.EXPERIMENT_RUNNER)
        if dialect.class_name not in self._bound and not has_star_import(self._tree):
            raise self._no_class(dialect)
        return dialect

    def _without_imports(self) -> Dialect | None:
        """Recognise a file without imports of a tool: by the config class's name, or by a module that it imports."""
        if Dialect.EXPERIMENT_RUNNER.class_name in self._bound:
            return Dialect.EXPERIMENT_RUNNER
        config = classes_of(self._tree).get(CONFIG_CLASS)
        names = bound_names(config.body) if config else {}
        if CONFIG_CLASS not in self._bound or "experiment_name" in names:
            return None
        is_earlier = "name" in names or any(self._neighbours_are_earlier())
        return Dialect.ROBOT_RUNNER if is_earlier else None

    def _neighbours_are_earlier(self) -> Iterator[bool]:
        for each in self._imports if self._depth < _MOST_PARENTS else ():
            neighbour = self._path.parent.joinpath(*each.module.split(".")).with_suffix(".py")
            if neighbour.is_file() and neighbour != self._path:
                try:
                    _, tree = read_tree(neighbour)
                    yield _Reading(neighbour, tree, self._depth + 1).dialect() is not None
                except ConfigError:  # importing the neighbour will raise it
                    continue

    def _mixed_with_own(self) -> ConfigError:
        own, earlier = self._own[0], self._earlier[0]
        return ConfigError(
            f"the file mixes two dialects: this line imports {_shown(earlier)} of an earlier tool, "
            f"and line {own.line} imports {_shown(own)}",
            where=f"{self._path}:{earlier.line}",
            fix=f"Keep to one: remove line {own.line}, or write everything with robot_runner "
            f"(`robot-runner convert` does so).",
        )

    def _mixed(self, tools: dict[Dialect, list[tuple[int, str]]]) -> ConfigError:
        # The config class decides; without one, the tool with more evidence.
        wanted = next(
            (each for each in tools if each.class_name in classes_of(self._tree)),
            max(tools, key=lambda each: len(tools[each])),
        )
        other = next(each for each in tools if each is not wanted)
        spoken = tools[wanted][-1]
        findings = [
            Finding.error(
                f"{self._path}:{line}",
                f"the file mixes two tools: this line {what}, which is {other.value}'s, "
                f"and line {spoken[0]} {spoken[1]}, which is {wanted.value}'s",
                _counterpart(what, wanted),
            )
            for line, what in tools[other]
        ]
        return ConfigError.of_findings(findings)

    def _no_class(self, dialect: Dialect) -> ConfigError:
        classes = classes_of(self._tree)
        near = nearest(dialect.class_name, classes)
        line = f":{classes[near].lineno}" if near else ""
        return ConfigError(
            f"the file imports {_shown(self._earlier[0])} of {dialect.value}, and has no class named "
            f"{dialect.class_name}",
            where=f"{self._path}{line}",
            fix=f"Rename the class {near} to {dialect.class_name}."
            if near
            else f"Describe the experiment in a class {dialect.class_name}.",
        )


def _begins_with(module: str, prefixes: Sequence[str]) -> bool:
    return any(module == prefix or module.startswith(f"{prefix}.") for prefix in prefixes)


def _shown(imported: ImportedName) -> str:
    return f"{imported.module}.{imported.name}" if imported.name else imported.module


def _counterpart(what: str, wanted: Dialect) -> str:
    name = what.rpartition(" ")[2].rpartition(".")[2]
    kind = next((kind for kind in ("Config", "Context", "Events") if name.endswith(kind)), "")
    prefix = "RobotRunner" if wanted is Dialect.ROBOT_RUNNER else "Runner"
    return f"Did you mean {prefix + kind!r}?" if kind else f"Leave it out: {wanted.value} has no such thing."
