"""Factors and measures that cannot keep their names, as the run table has columns of ours that are called so."""

from __future__ import annotations

import ast
from typing import TYPE_CHECKING

from robot_runner.core.errors import Finding
from robot_runner.core.events.manager import RobotRunnerEvents
from robot_runner.legacy.run_tables import named_columns
from robot_runner.legacy.syntax import nodes

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.legacy.conversion.earlier_imports import ConvertedImports
    from robot_runner.legacy.session import Session
    from robot_runner.legacy.syntax import Edits

_ROWS = ("run_variation", "execute_run")
_MODELS = ("RunTableModel", "Factor")


def rename_clashing(session: Session, tree: ast.Module, imports: ConvertedImports, edits: Edits) -> Iterator[Finding]:
    """Rename such columns where the run table is made, where a row is read, and where measures are returned."""
    model = session.models[-1] if session.models else None
    if model is None:
        return
    columns = [*(factor.factor_name for factor in model.get_factors()), *model.get_data_columns()]
    clashing = {name: ours for name, ours in named_columns(columns).by_column.items() if name != ours}
    for constant in _names_of_columns(session, tree, imports) if clashing else ():
        if constant.value in clashing:
            edits.replace(constant, repr(clashing[constant.value]))
    for name, ours in clashing.items():
        bare = str(name).strip()
        why = "no heading has blanks around it" if ours == bare else f"the run table has one of ours called {bare!r}"
        problem = f"the column {name!r} is called {ours!r} now: {why}"
        yield Finding.warning(session.path.name, problem, "Read it under this name in your analysis.")


def _names_of_columns(session: Session, tree: ast.Module, imports: ConvertedImports) -> Iterator[ast.Constant]:
    """Yield the texts of a config that name columns."""
    populating = {
        getattr(each.callback, "__name__", "")
        for each in session.subscriptions
        if each.event is RobotRunnerEvents.POPULATE_RUN_DATA
    }
    for call in nodes(tree, ast.Call):
        if isinstance(call.func, ast.Name) and imports.names.get(call.func.id) in _MODELS:
            yield from _texts_in(call)
    for function in nodes(tree, ast.FunctionDef):
        if function.name in populating:
            yield from _keys_in(function)
    for row in nodes(tree, ast.Subscript):
        if isinstance(row.value, ast.Attribute) and row.value.attr in _ROWS and isinstance(row.slice, ast.Constant):
            yield row.slice


def _texts_in(call: ast.Call) -> Iterator[ast.Constant]:
    """Yield the name of a factor, and those of the data columns."""
    for argument in (*call.args, *(keyword.value for keyword in call.keywords if keyword.arg != "treatments")):
        listed = argument.elts if isinstance(argument, ast.List | ast.Tuple) else [argument]
        is_second = argument in call.args[1:2]  # of a factor, the treatments
        yield from (each for each in listed if isinstance(each, ast.Constant) and not is_second)


def _keys_in(function: ast.FunctionDef) -> Iterator[ast.Constant]:
    """Yield the keys of what a callback returns: of mappings that it writes down, and of those that it fills."""
    for mapping in nodes(function, ast.Dict):
        yield from (key for key in mapping.keys if isinstance(key, ast.Constant))
    filled = set[str]()
    for node in ast.walk(function):
        match node:
            case ast.Assign(targets=[ast.Name(id=name)], value=ast.Dict()):
                filled.add(name)
            case ast.AnnAssign(target=ast.Name(id=name), value=ast.Dict()):
                filled.add(name)
            case _:
                pass
    for cell in nodes(function, ast.Subscript):
        is_read_again = isinstance(cell.value, ast.Name) and cell.value.id in filled
        if isinstance(cell.slice, ast.Constant) and (isinstance(cell.ctx, ast.Store) or is_read_again):
            yield cell.slice
