"""Where in a config something is said: the line on which a factor, a plugin or a measure stands."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

__all__ = ["ConfigLine", "ConfigLines"]


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
        return self._first(lambda node: _is_call_with(node, ("Factor", "FactorModel"), name)) or self._constant(name)

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

    def _constant(self, value: str) -> ConfigLine | None:
        return self._first(lambda node: isinstance(node, ast.Constant) and node.value == value)

    def _last_mention(self, value: str) -> ConfigLine | None:
        """Return where a text stands last: columns are named above the callbacks that fill them."""
        for source in self._sources:
            found = [node for node in ast.walk(source.tree) if isinstance(node, ast.Constant) and node.value == value]
            if found:
                return source.line(max(found, key=lambda node: node.lineno))
        return None

    def _first(self, is_it: Callable[[ast.AST], bool]) -> ConfigLine | None:
        for source in self._sources:
            found = [node for node in ast.walk(source.tree) if is_it(node)]
            if found:
                return source.line(min(found, key=lambda node: getattr(node, "lineno", 0)))
        return None


def _sources(root: Path) -> Iterator[_Source]:
    for path in sorted((root / "config").rglob("*.py")):
        text = path.read_text(encoding="utf-8", errors="replace")
        try:
            tree = ast.parse(text)
        except (SyntaxError, ValueError):
            continue
        yield _Source(path.relative_to(root).as_posix(), tuple(text.split("\n")), tree)


def _called(node: ast.AST) -> str:
    if not isinstance(node, ast.Call):
        return ""
    function = node.func
    if isinstance(function, ast.Name):
        return function.id
    return function.attr if isinstance(function, ast.Attribute) else ""


def _keyword(node: ast.AST, name: str) -> object:
    words = node.keywords if isinstance(node, ast.Call) else []
    return next((each.value.value for each in words if each.arg == name and isinstance(each.value, ast.Constant)), None)


def _is_call_with(node: ast.AST, kinds: tuple[str, ...], name: str) -> bool:
    if not isinstance(node, ast.Call) or _called(node) not in kinds:
        return False
    first = node.args[0].value if node.args and isinstance(node.args[0], ast.Constant) else None
    return name in {first, _keyword(node, "name"), _keyword(node, "factor_name")}


def _imports(node: ast.AST, kind: str) -> bool:
    if not isinstance(node, ast.Import | ast.ImportFrom):
        return False
    return any(alias.name.rpartition(".")[2] == kind for alias in node.names)


def _yields(function: ast.FunctionDef, name: str) -> bool:
    return function.name == "populate_run_data" and any(
        isinstance(node, ast.Constant) and node.value == name for node in ast.walk(function)
    )
