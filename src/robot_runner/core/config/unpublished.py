"""Finding measures that the config declares and that nothing in its code publishes: their cells would stay empty."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterator
from types import CodeType

from robot_runner.core.config.loader import LoadedConfig
from robot_runner.core.config.source import DESIGN_METHODS, tree_of
from robot_runner.core.errors import Finding, nearest
from robot_runner.core.events.manager import EventManager, RobotRunnerEvents
from robot_runner.core.events.measure import CONFIG_OWNER, MeasureColumns

_POPULATE = RobotRunnerEvents.POPULATE_RUN_DATA


def check_published(loaded: LoadedConfig, events: EventManager, columns: MeasureColumns) -> list[Finding]:
    """Return a warning for each measure of the config that its code does not publish.

    None where reading cannot tell, as where a name is computed, a context is passed on, or a callback is not beside
    the config; and none where the code publishes nothing at all: that is only planned so far.
    """
    trees = {str(path): tree_of(path) for path in (loaded.source.path, *loaded.local_modules)}
    own = [each for event in RobotRunnerEvents for each in events.subscribers(event) if each.owner == CONFIG_OWNER]
    codes = [getattr(each.callback, "__code__", None) for each in own]
    if any(code is None or code.co_filename not in trees or code.co_name == "<lambda>" for code in codes):
        return []
    returning = {code.co_name for code, each in zip(codes, own, strict=True) if code and each.event is _POPULATE}
    contexts = {name for code in codes if code for name in _taken_by(code)} - {"self"}
    nodes = [node for tree in trees.values() for node in _without_run_tables(tree)]
    looked_into = {id(each.value) for each in nodes if isinstance(each, ast.Attribute)}
    called = {id(each.func) for each in nodes if isinstance(each, ast.Call)}
    whole = [each for each in nodes if id(each) not in looked_into | called]
    published = [name for node in nodes for name in _published_by(node, returning)]
    published += [None for each in whole if _may_publish(each, contexts)]
    if not published or None in published:
        return []
    spelt = {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    known = {*filter(None, published), *(each.name for each in columns.declared if each.owner != CONFIG_OWNER)}
    known -= set(columns.names)
    return [
        Finding.warning("data_columns", f"nothing publishes {column.name!r}: it stays empty", _fix(column.name, known))
        for column in columns.in_table
        if column.owner == CONFIG_OWNER and not column.tells_of and column.name not in spelt
    ]


def _fix(name: str, known: set[str]) -> str:
    near = nearest(name, known)
    meant = "" if near is None else f"Did you mean {near!r}? "
    return f"{meant}Return it from populate_run_data, or leave it out of data_columns."


def _without_run_tables(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield all nodes but those of the methods that declare the names."""
    yield tree
    for each in ast.iter_child_nodes(tree):
        if not (isinstance(each, ast.FunctionDef) and each.name in DESIGN_METHODS):
            yield from _without_run_tables(each)


def _taken_by(code: CodeType) -> Iterator[str]:
    """Yield the names of what a callback takes; a decorator's often takes a context by `*args`."""
    names, others, _ = inspect.getargs(code)
    yield from names
    if others is not None:
        yield others


def _published_by(node: ast.AST, returning: set[str]) -> Iterator[str | None]:
    """Yield the names of measures that a node may publish; None for names that are not spelt in it."""
    match node:
        case ast.Call(func=ast.Attribute(attr="publish"), args=[ast.Constant(value=str(name)), _]):
            yield name
        case ast.Call(func=ast.Attribute(attr="publish"), args=args) if len(args) <= 2:  # noqa: PLR2004 - no message
            yield None
        case ast.FunctionDef(name=function) if function in returning:
            returned = [each.value for each in ast.walk(node) if isinstance(each, ast.Return)]
            yield from (name for value in returned for name in _returned(value))
        case _:
            pass


def _may_publish(value: ast.AST, contexts: set[str]) -> bool:
    """Return whether a value that is passed on, or kept, is a context, or its method."""
    match value:
        case ast.Name(id=name, ctx=ast.Load()):
            return name in contexts
        case _:
            return isinstance(value, ast.Attribute) and value.attr == "publish"


def _returned(value: ast.expr | None) -> Iterator[str | None]:
    match value:
        case None | ast.Constant(value=None):
            pass
        case ast.Dict(keys=keys):
            values = (key.value if isinstance(key, ast.Constant) else None for key in keys)
            yield from (value if isinstance(value, str) else None for value in values)
        case _:
            yield None
