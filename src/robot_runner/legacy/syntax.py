"""Queries on the syntax tree of a config file, and edits of its text at nodes of the tree."""

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
    """Yield the uses of attributes of names (`context.run_nr`): the node of the name, and that of the attribute."""
    for node in nodes(tree, ast.Attribute):
        if isinstance(node.value, ast.Name) and node.value.id in owners:
            yield node.value, node


@dataclass(frozen=True, slots=True)
class ImportedName:
    """One name in an import statement.

    Attributes:
        module: the full name of the module, such as `EventManager.Models.RunnerEvents`.
        name: the imported name; empty if the module itself is imported.
        bound_as: its name in the file.
        is_guarded: whether the statement is in a `try`, so that the file may work without it.
    """

    module: str
    name: str
    bound_as: str
    line: int
    is_guarded: bool = False


def imports_of(tree: ast.Module) -> tuple[ImportedName, ...]:
    """Return all imports of a file, also nested ones; relative imports are left out."""
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
    """Yield the statements in the body of a module or a class, also those in `if`, `try` and the like."""
    for statement in body:
        yield statement
        for part in ("body", "orelse", "finalbody"):
            if not isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                yield from walk_bodies(getattr(statement, part, []))
        for branch in (*getattr(statement, "handlers", ()), *getattr(statement, "cases", ())):
            yield from walk_bodies(branch.body)


def classes_of(tree: ast.Module) -> dict[str, ast.ClassDef]:
    """Return the classes of a module by name; of two with the same name, the later one."""
    return {node.name: node for node in walk_bodies(tree.body) if isinstance(node, ast.ClassDef)}


def bound_names(body: list[ast.stmt]) -> dict[str, int]:
    """Return the names that the body of a module or a class binds, each with the line of its last binding."""
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
    """Return whether a file has a star import, so that its text does not show all names."""
    return any(each.name == "*" for each in imports_of(tree))


def used_names(tree: ast.Module) -> set[str]:
    """Return the names that a file uses, except those in annotations."""
    annotations = {id(node) for node in _annotations(tree)}
    return {node.id for node in nodes(tree, ast.Name) if id(node) not in annotations}


def names_of_types(tree: ast.Module) -> set[str]:
    """Return the names in a file's annotations."""
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
    """Collects edits and applies them at once; edits inside a replaced part are dropped.

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
        """Replace a node by `text`."""
        self._edits.append(_Edit(self.start_of(node), self.end_of(node), text))

    def replace_span(self, start: int, end: int, text: str) -> None:
        """Replace a span of bytes by `text`."""
        self._edits.append(_Edit(start, end, text))

    def insert(self, position: int, text: str) -> None:
        """Insert `text` before the byte at `position`."""
        self._edits.append(_Edit(position, position, text))

    def remove_paragraph(self, first: int, last: int) -> None:
        """Remove whole lines, and a blank line after them."""
        following = self._bytes[self._line_starts[last] :].partition(b"\n")[0]
        self.remove_lines(first, last if following.strip() else min(last + 1, len(self._line_starts) - 1))

    def remove_lines(self, first: int, last: int) -> None:
        """Remove whole lines, counted from 1."""
        self._edits.append(_Edit(self._line_starts[first - 1], self._line_starts[last], ""))

    def source(self, node: ast.AST) -> str:
        """Return the original text of a node."""
        return self._bytes[self.start_of(node) : self.end_of(node)].decode()

    def edited(self, node: ast.AST) -> str:
        """Return the text of a node with the edits inside it so far."""
        start, end = self.start_of(node), self.end_of(node)
        inside = [edit for edit in self._edits if start <= edit.start and edit.end <= end]
        return _applied(self._bytes[start:end], [_Edit(e.start - start, e.end - start, e.text) for e in inside])

    def start_of(self, node: ast.AST) -> int:
        """Return the start of a node, in bytes; a class or function starts with its first decorator."""
        first = min([node, *getattr(node, "decorator_list", [])], key=lambda each: each.lineno)
        return self._position(first.lineno, first.col_offset) - (first is not node)

    def end_of(self, node: ast.AST) -> int:
        """Return the end of a node, in bytes."""
        return self._position(node.end_lineno, node.end_col_offset)  # type: ignore[attr-defined]

    def line_start(self, line: int) -> int:
        """Return the start of a line, in bytes; lines are counted from 1."""
        return self._line_starts[min(line, len(self._line_starts)) - 1]

    def find(self, text: str, after: int) -> int:
        """Return the position of the first `text` after a position, in bytes."""
        return self._bytes.index(text.encode(), after)

    def applied(self) -> str:
        """Return the edited text."""
        return _applied(self._bytes, self._edits)

    def _position(self, line: int, column: int) -> int:
        return self._line_starts[line - 1] + column


def _applied(text: bytes, edits: list[_Edit]) -> str:
    # At one position, insertions come first, then the widest edit, which replaces those inside it.
    ordered = sorted(dict.fromkeys(edits), key=lambda edit: (edit.start, edit.end > edit.start, -edit.end))
    pieces, position = [], 0
    for edit in ordered:
        if edit.start < position:
            continue
        pieces += [text[position : edit.start], edit.text.encode()]
        position = edit.end
    return b"".join([*pieces, text[position:]]).decode()
