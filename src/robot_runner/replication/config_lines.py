"""The line of a config on which a factor, a plugin, a measure or a method stands, found without executing it."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.core.storage.guarded_files import read_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path


@dataclass(frozen=True, slots=True)
class ConfigLine:
    """One line of a config.

    Attributes:
        place: the file, below the experiment's folder, and the line's number.
        text: the line.
    """

    place: str
    text: str


@dataclass(frozen=True, slots=True)
class _Source:
    name: str
    lines: tuple[str, ...]
    tree: ast.Module

    def nodes(self, matches: Callable[[ast.AST], bool]) -> list[ast.AST]:
        """Return the nodes that match, from the first line to the last."""
        found = [node for node in ast.walk(self.tree) if matches(node)]
        return sorted(found, key=lambda node: getattr(node, "lineno", 0))

    def line(self, node: ast.AST) -> ConfigLine:
        number = getattr(node, "lineno", 1)
        return ConfigLine(f"{self.name}:{number}", self.lines[number - 1].strip())


class ConfigLines:
    """The config file of an experiment and its local modules, read and not executed.

    Example:
        >>> from pathlib import Path
        >>> ConfigLines(Path("nowhere")).of_factor("Task") is None
        True
    """

    def __init__(self, root: Path) -> None:
        """Read what is in the folder `config` of an experiment's folder; what does not parse is left out.

        Raises:
            OSError: a file cannot be read.
        """
        self._sources = tuple(_sources(root))

    def of_factor(self, name: str) -> ConfigLine | None:
        """Return the line that makes a factor."""
        made = self._first(lambda node: _is_factor(node, name))
        return made or self._first(lambda node: _is_constant(node, name))

    def of_plugin(self, name: str, kind: str) -> ConfigLine | None:
        """Return the line that makes a plugin, or that imports it.

        Args:
            name: the plugin's.
            kind: the name of its class.
        """
        named = self._first(lambda node: _called(node) == kind and _keyword(node, "name") == name)
        made = named or self._first(lambda node: _called(node) == kind)
        return made or self._first(lambda node: _imports(node, kind))

    def of_measure(self, name: str) -> ConfigLine | None:
        """Return the line on which a config yields a measure, or the method that does."""
        within = self._first(lambda node: isinstance(node, ast.FunctionDef) and _yields(node, name))
        return within or self.of_method("populate_run_data") or self._last_mention(name)

    def of_method(self, name: str) -> ConfigLine | None:
        """Return the line on which a method begins."""
        return self._first(lambda node: isinstance(node, ast.FunctionDef) and node.name == name)

    def _last_mention(self, value: str) -> ConfigLine | None:
        """Return where a text stands last: columns are named above the callbacks that fill them."""
        found = (source.nodes(lambda node: _is_constant(node, value)) for source in self._sources)
        return next((source.line(nodes[-1]) for source, nodes in zip(self._sources, found, strict=True) if nodes), None)

    def _first(self, matches: Callable[[ast.AST], bool]) -> ConfigLine | None:
        return next((source.line(found[0]) for source in self._sources if (found := source.nodes(matches))), None)


def _sources(root: Path) -> Iterator[_Source]:
    for path in sorted((root / "config").rglob("*.py")):
        text = read_text(path, root, errors="replace")
        try:
            tree = ast.parse(text)
        except (SyntaxError, ValueError):
            continue
        yield _Source(path.relative_to(root).as_posix(), tuple(text.split("\n")), tree)


def _is_constant(node: ast.AST, value: str) -> bool:
    return isinstance(node, ast.Constant) and node.value == value


def _called(node: ast.AST) -> str:
    match node:
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)):
            return name
    return ""


def _keyword(node: ast.AST, name: str) -> object:
    words = node.keywords if isinstance(node, ast.Call) else []
    return next((each.value.value for each in words if each.arg == name and isinstance(each.value, ast.Constant)), None)


def _is_factor(node: ast.AST, name: str) -> bool:
    if not isinstance(node, ast.Call) or _called(node) not in {"Factor", "FactorModel"}:
        return False
    first = node.args[0].value if node.args and isinstance(node.args[0], ast.Constant) else None
    return name in {first, _keyword(node, "name"), _keyword(node, "factor_name")}


def _imports(node: ast.AST, kind: str) -> bool:
    names = node.names if isinstance(node, ast.Import | ast.ImportFrom) else []
    return any(alias.name.rpartition(".")[2] == kind for alias in names)


def _yields(function: ast.FunctionDef, name: str) -> bool:
    return function.name == "populate_run_data" and any(_is_constant(node, name) for node in ast.walk(function))
