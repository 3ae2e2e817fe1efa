"""What the syntax tree of a config file says, without anything of it being executed."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = [
    "ImportedName",
    "bound_names",
    "classes_of",
    "has_star_import",
    "imports_of",
    "names_of_types",
    "used_names",
    "walk_bodies",
]


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
    guarded = {id(node) for each in ast.walk(tree) if isinstance(each, ast.Try) for node in ast.walk(each)}
    found: list[ImportedName] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [
                ImportedName(
                    alias.name, "", alias.asname or alias.name.partition(".")[0], node.lineno, id(node) in guarded
                )
                for alias in node.names
            ]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found += [
                ImportedName(node.module, alias.name, alias.asname or alias.name, node.lineno, id(node) in guarded)
                for alias in node.names
            ]
    return tuple(sorted(found, key=lambda each: each.line))


def walk_bodies(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    """Yield the statements that are executed when a module or a class is made: also those in `if`, `try` and `with`."""
    for statement in body:
        yield statement
        for part in ("body", "orelse", "finalbody"):
            if not isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                yield from walk_bodies(getattr(statement, part, []))
        for handler in getattr(statement, "handlers", []):
            yield from walk_bodies(handler.body)


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
                names |= {each.id: node.lineno for target in targets for each in _targets(target)}
            case ast.AnnAssign(target=ast.Name(id=name)):
                names[name] = node.lineno
            case ast.Import(names=aliases) | ast.ImportFrom(names=aliases):
                names |= {alias.asname or alias.name.partition(".")[0]: node.lineno for alias in aliases}
            case _:
                pass
    return names


def has_star_import(tree: ast.Module) -> bool:
    """Return whether names come into the file that its text does not show."""
    return any(each.name == "*" for each in imports_of(tree))


def used_names(tree: ast.Module) -> set[str]:
    """Return the names that a file uses other than to say of what type something is."""
    annotations = {id(node) for node in _annotations(tree)}
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and id(node) not in annotations}


def names_of_types(tree: ast.Module) -> set[str]:
    """Return the names with which a file says of what type something is."""
    return {node.id for node in _annotations(tree) if isinstance(node, ast.Name)}


def _annotations(tree: ast.Module) -> Iterator[ast.AST]:
    for each in ast.walk(tree):
        for annotation in (getattr(each, "annotation", None), getattr(each, "returns", None)):
            if annotation is not None:
                yield from ast.walk(annotation)


def _targets(target: ast.expr) -> Iterator[ast.Name]:
    return (node for node in ast.walk(target) if isinstance(node, ast.Name))
