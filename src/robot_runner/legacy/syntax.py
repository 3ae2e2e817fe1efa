"""A config file's syntax tree: what it tells without anything being executed, and changes to the text at its nodes."""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import TypeVar

N = TypeVar("N", bound=ast.AST)


def nodes(tree: ast.AST, kind: type[N]) -> Iterator[N]:
    """Yield the nodes of a kind, from the outer ones to the inner ones."""
    return (node for node in ast.walk(tree) if isinstance(node, kind))


def attributes_of(tree: ast.AST, owners: Collection[str]) -> Iterator[tuple[ast.Name, ast.Attribute]]:
    """Yield where an attribute of a name is used (`context.run_nr`), with the node of the name."""
    for node in nodes(tree, ast.Attribute):
        if isinstance(node.value, ast.Name) and node.value.id in owners:
            yield node.value, node


@dataclass(frozen=True, slots=True)
class ImportedName:
    """One name that an import statement asks for.

    Attributes:
        module: the module in full, such as `EventManager.Models.RunnerEvents`.
        name: what is taken from it; empty where the module itself is imported.
        bound_as: the name that it has in the file.
        is_guarded: whether the file goes on without it (it stands in a `try`).
    """

    module: str
    name: str
    bound_as: str
    line: int
    is_guarded: bool = False


def imports_of(tree: ast.Module) -> tuple[ImportedName, ...]:
    """Return everything that a file imports, wherever the statement stands; relative imports are left out."""
    guarded = {id(node) for each in nodes(tree, ast.Try) for node in ast.walk(each)}
    found: list[ImportedName] = []
    for node in ast.walk(tree):
        is_guarded = id(node) in guarded
        if isinstance(node, ast.Import):
            for alias in node.names:
                bound = alias.asname or alias.name.partition(".")[0]
                found.append(ImportedName(alias.name, "", bound, node.lineno, is_guarded))
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            for alias in node.names:
                bound = alias.asname or alias.name
                found.append(ImportedName(node.module, alias.name, bound, node.lineno, is_guarded))
    return tuple(sorted(found, key=lambda each: each.line))


def walk_bodies(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    """Yield the statements that are executed when a module or a class is made: also those in `if`, `try`, ..."""
    for statement in body:
        yield statement
        for part in ("body", "orelse", "finalbody"):
            if not isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                yield from walk_bodies(getattr(statement, part, []))
        for branch in (*getattr(statement, "handlers", ()), *getattr(statement, "cases", ())):
            yield from walk_bodies(branch.body)


def classes_of(tree: ast.Module) -> dict[str, ast.ClassDef]:
    """Return the classes of a module by name; of two with one name the later counts."""
    return {node.name: node for node in walk_bodies(tree.body) if isinstance(node, ast.ClassDef)}


def bound_names(body: list[ast.stmt]) -> dict[str, int]:
    """Return the names that a module or a class body binds, each with the line where it does so last."""
    names: dict[str, int] = {}
    for node in walk_bodies(body):
        match node:
            case ast.ClassDef(name=name) | ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                names[name] = node.lineno
            case ast.Assign(targets=targets):
                names |= {each.id: node.lineno for target in targets for each in nodes(target, ast.Name)}
            case ast.AnnAssign(target=ast.Name(id=name)):
                names[name] = node.lineno
            case ast.Import(names=aliases) | ast.ImportFrom(names=aliases):
                names |= {alias.asname or alias.name.partition(".")[0]: node.lineno for alias in aliases}
    return names


def has_star_import(tree: ast.Module) -> bool:
    """Return whether names come into the file that its text does not show."""
    return any(each.name == "*" for each in imports_of(tree))


def used_names(tree: ast.Module) -> set[str]:
    """Return the names that a file uses, apart from those in annotations."""
    annotations = {id(node) for node in _annotations(tree)}
    return {node.id for node in nodes(tree, ast.Name) if id(node) not in annotations}


def names_of_types(tree: ast.Module) -> set[str]:
    """Return the names that stand in a file's annotations."""
    return {node.id for node in _annotations(tree) if isinstance(node, ast.Name)}


def _annotations(tree: ast.Module) -> Iterator[ast.AST]:
    for each in ast.walk(tree):
        for annotation in (getattr(each, "annotation", None), getattr(each, "returns", None)):
            if annotation is not None:
                yield from ast.walk(annotation)


@dataclass(frozen=True, slots=True, order=True)
class _Edit:
    start: int
    end: int
    text: str


class Edits:
    """Gathers changes and applies them all at once; a change inside a part that is replaced as a whole is dropped.

    Example:
        >>> import ast
        >>> tree = ast.parse("a + b  # kept")
        >>> edits = Edits("a + b  # kept")
        >>> edits.replace(tree.body[0].value.right, "c")
        >>> edits.applied()
        'a + c  # kept'
    """

    def __init__(self, text: str) -> None:
        self._bytes = text.encode()
        starts = [0]
        for line in self._bytes.splitlines(keepends=True):
            starts.append(starts[-1] + len(line))
        self._line_starts = starts
        self._edits: list[_Edit] = []

    def replace(self, node: ast.AST, text: str) -> None:
        """Put `text` in the place of a node."""
        self._edits.append(_Edit(self.start_of(node), self.end_of(node), text))

    def replace_span(self, start: int, end: int, text: str) -> None:
        """Put `text` in the place of some bytes."""
        self._edits.append(_Edit(start, end, text))

    def insert(self, position: int, text: str) -> None:
        """Put `text` before the byte at `position`."""
        self._edits.append(_Edit(position, position, text))

    def remove_paragraph(self, first: int, last: int) -> None:
        """Remove whole lines, and the blank one after them."""
        following = self._bytes[self._line_starts[last] :].partition(b"\n")[0]
        self.remove_lines(first, last if following.strip() else min(last + 1, len(self._line_starts) - 1))

    def remove_lines(self, first: int, last: int) -> None:
        """Remove whole lines, counted from 1."""
        self._edits.append(_Edit(self._line_starts[first - 1], self._line_starts[last], ""))

    def source(self, node: ast.AST) -> str:
        """Return the text of a node as it was."""
        return self._bytes[self.start_of(node) : self.end_of(node)].decode()

    def edited(self, node: ast.AST) -> str:
        """Return the text of a node with the changes so far that lie inside it."""
        start, end = self.start_of(node), self.end_of(node)
        inside = [edit for edit in self._edits if start <= edit.start and edit.end <= end]
        return _applied(self._bytes[start:end], [_Edit(e.start - start, e.end - start, e.text) for e in inside])

    def start_of(self, node: ast.AST) -> int:
        """Return where a node begins, in bytes; a class or function begins with its first decorator."""
        first = min([node, *getattr(node, "decorator_list", [])], key=lambda each: each.lineno)
        return self._position(first.lineno, first.col_offset) - (first is not node)

    def end_of(self, node: ast.AST) -> int:
        """Return where a node ends, in bytes."""
        return self._position(node.end_lineno, node.end_col_offset)  # type: ignore[attr-defined]

    def line_start(self, line: int) -> int:
        """Return where a line begins, in bytes; lines are counted from 1."""
        return self._line_starts[min(line, len(self._line_starts)) - 1]

    def find(self, text: str, after: int) -> int:
        """Return where `text` stands first after a position, in bytes."""
        return self._bytes.index(text.encode(), after)

    def applied(self) -> str:
        """Return the text with all changes."""
        return _applied(self._bytes, self._edits)

    def _position(self, line: int, column: int) -> int:
        return self._line_starts[line - 1] + column


def _applied(text: bytes, edits: list[_Edit]) -> str:
    # What is put before a place comes first, then the widest change there: it stands for those inside it.
    ordered = sorted(dict.fromkeys(edits), key=lambda edit: (edit.start, edit.end > edit.start, -edit.end))
    pieces, position = [], 0
    for edit in ordered:
        if edit.start < position:
            continue
        pieces += [text[position : edit.start], edit.text.encode()]
        position = edit.end
    return b"".join([*pieces, text[position:]]).decode()
