"""Modules of which a program has another version in memory than their files hold now."""

from __future__ import annotations

import ast
import os
import sys
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from enum import Enum
from functools import lru_cache
from inspect import unwrap
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

from robot_runner.core.config.source import read_tree, tree_or_empty
from robot_runner.core.errors import ConfigError

#: Other callable objects, such as mocks, may claim to wrap anything.
_FUNCTIONS: tuple[type, ...] = (FunctionType, staticmethod, classmethod, type(lru_cache(len)))


def stale_names(files: Collection[Path]) -> dict[Path, str]:
    """Return, of each file whose module is not in memory as it is written now, a name that differs.

    Compared are functions and methods by their code, and the plain values of modules and classes. A file that cannot be
    parsed any more is passed over.
    """
    paths = {os.path.realpath(each): each for each in files}
    names = {each.name for each in map(Path, paths)}  # as looking for links of thousands of modules takes a while
    found: dict[Path, str] = {}
    for module in [each for each in sys.modules.values() if isinstance(each, ModuleType)]:
        file = str(vars(module).get("__file__"))
        path = paths.get(os.path.realpath(file)) if Path(file).name in names else None
        if path is not None and (name := _stale_name(vars(module), path)):
            found[path] = name
    return found


def holds_values_of(text: str, kind: type) -> bool:
    """Return whether a source defines a class with the plain values that this one has."""
    bodies = [
        each.body for each in tree_or_empty(text).body if isinstance(each, ast.ClassDef) and each.name == kind.__name__
    ]
    return bool(bodies) and next(_changed_values(vars(kind), bodies[-1]), None) is None


def _stale_name(names: Mapping[str, Any], path: Path) -> str | None:
    try:
        _, tree = read_tree(path)
        written = {_content(each) for each in _nested(compile(tree, str(path), "exec", dont_inherit=True))}
    except (ConfigError, SyntaxError, ValueError):
        return None
    codes = (code for code in _codes(names, names["__name__"]) if Path(code.co_filename).name == path.name)
    changed = (code.co_qualname for code in codes if not _is_rewritten(code) and _content(code) not in written)
    return next(changed, None) or next(_changed_values(names, tree.body), None)


def _nested(code: CodeType) -> Iterator[CodeType]:
    yield code
    for each in code.co_consts:
        if isinstance(each, CodeType):
            yield from _nested(each)


def _content(code: CodeType) -> tuple[object, ...]:
    """Return what a code object does: equality of code objects counts line numbers, which comments move."""
    values = [_content(each) if isinstance(each, CodeType) else (type(each), each) for each in code.co_consts]
    return code.co_qualname, code.co_code, code.co_names, code.co_varnames, tuple(values)


def _is_rewritten(code: CodeType) -> bool:
    """Return whether pytest has rewritten an assertion in it, by names that no file can have."""
    return any(name.startswith("@") for each in _nested(code) for name in each.co_names)


def _codes(names: Mapping[str, Any], module: str, within: str = "") -> Iterator[CodeType]:
    for value in list(names.values()):
        if isinstance(value, type):
            if value.__module__ == module and value.__qualname__.startswith(within):  # no class that names itself
                yield from _codes(vars(value), module, f"{value.__qualname__}.")
            continue
        function: Any = value.fget if isinstance(value, property) else value
        function = unwrap(function) if type(function) in _FUNCTIONS else None
        code = getattr(function, "__code__", None)
        if isinstance(code, CodeType) and function.__module__ == module:  # not one that was imported
            yield code


def _changed_values(names: Mapping[str, Any], body: Sequence[ast.stmt]) -> Iterator[str]:
    """Yield names whose values are not those written; one that is assigned several times may have any of them."""
    stored = Counter(name for statement in body for node in ast.walk(statement) for name in _names_stored(node))
    for statement in body:
        match statement:
            case ast.ClassDef(name=name, body=inner) if isinstance(names.get(name), type):
                yield from _changed_values(vars(names[name]), inner)
            case ast.Assign(targets=[ast.Name(id=name)], value=ast.Constant(value=value)) if stored[name] == 1:
                held = names.get(name)
                if isinstance(held, Enum):  # whose type may have converted the value
                    is_changed = bool(held.value != value)
                else:
                    is_changed = (type(held), held) != (type(value), value)
                if is_changed:
                    yield name


def _names_stored(node: ast.AST) -> Iterator[str]:
    """Yield the name that is assigned or imported, also one of a class, as a counter of its objects is."""
    match node:
        case ast.Name(id=name, ctx=ast.Store()):
            yield name
        case ast.Attribute(attr=name, ctx=ast.Store(), value=of) if not (isinstance(of, ast.Name) and of.id == "self"):
            yield name
        case ast.alias(name=name, asname=other):
            yield other or name
