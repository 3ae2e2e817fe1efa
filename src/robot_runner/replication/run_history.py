"""What the journal has of one run: its attempts, the events and measures of the last one, what looked odd."""

from __future__ import annotations

import ast
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from robot_runner.core.storage.journal import read_journal

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

__all__ = ["ConfigLine", "ConfigLines", "RunHistory", "read_run_history"]


# Where in a config something is said: the line on which a factor, a plugin or a measure stands.


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


_KINDS = ("attempt_started", "attempt_finished", "event", "finding", "clock")


@dataclass(slots=True)
class RunHistory:
    """One run as the journal tells it.

    Attributes:
        attempt: the number of the last attempt; 0 where there was none.
        started_at, finished_at: of the last attempt (UTC).
        measures: what it published: a mapping with `value`, `owner`, `origin` for each.
        clocks: when its events were emitted, s on the run's clock.
        doubts: what owners found odd about it.
        hosts: other computers that were measured, and how their clocks stood.
        failures: why earlier attempts failed, by number.
    """

    attempt: int = 0
    started_at: str | None = None
    finished_at: str | None = None
    measures: dict[str, dict[str, Any]] = field(default_factory=dict)
    clocks: dict[str, float] = field(default_factory=dict)
    doubts: dict[str, list[str]] = field(default_factory=dict)
    hosts: list[str] = field(default_factory=list)
    failures: dict[int, str] = field(default_factory=dict)

    def take(self, record: dict[str, Any]) -> None:
        """Take one record that is about the run."""
        match record["kind"]:
            case "attempt_started":
                self._begin(record)
            case "attempt_finished":
                self.finished_at = record["at"]
                self.measures = record["measures"]
                if record.get("failure"):
                    self.failures[self.attempt] = str(record["failure"])
            case "event" if isinstance(record.get("clock"), int | float):
                self.clocks[str(record["event"])] = float(record["clock"])
            case "finding":
                self.doubts.setdefault(str(record.get("owner")), []).append(str(record["problem"]))
            case "clock":
                offset = (record.get("before") or record.get("after") or {}).get("wall_offset")
                told = f", its clock {offset:+.6f} s to ours" if isinstance(offset, int | float) else ""
                self.hosts.append(f"{record.get('host')} (measured by {record.get('owner')}{told})")

    def _begin(self, record: dict[str, Any]) -> None:
        self.attempt, self.started_at, self.finished_at = int(record["attempt"]), record["at"], None
        self.measures, self.clocks, self.doubts, self.hosts = {}, {}, {}, []


def read_run_history(journal: Path, run_id: str) -> RunHistory:
    """Read what the journal has of a run; a journal that does not exist has nothing.

    Raises:
        StorageError: it cannot be read.
    """
    history = RunHistory()
    for record in read_journal(journal, kinds=_KINDS):
        if record.get("run") == run_id:
            history.take(record)
    return history
