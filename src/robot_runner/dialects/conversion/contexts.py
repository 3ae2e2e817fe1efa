"""What callbacks read from their context and write into it."""

from __future__ import annotations

import ast
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from robot_runner.dialects.conversion.edits import Edits

__all__ = ["convert_contexts"]

_ROWS = frozenset({"run_variation", "execute_run"})
_ATTRIBUTES = {"run_nr": "run_number", "run_dir": "run_folder"}
_RUN_ID = "__run_id"


def convert_contexts(functions: Collection[ast.FunctionDef], edits: Edits, columns: Collection[str]) -> None:
    """Convert the functions that have a parameter `context`.

    Args:
        functions: all functions of the file.
        edits: takes the changes.
        columns: the measures' columns.
    """
    for function in functions:
        if any(argument.arg == "context" for argument in function.args.args):
            _Function(function, edits, columns).convert()


class _Function:
    def __init__(self, function: ast.FunctionDef, edits: Edits, columns: Collection[str]) -> None:
        self._function = function
        self._edits = edits
        self._columns = columns
        self._rows = set(self._row_variables())

    def convert(self) -> None:
        """Convert every use of the context, and of a variable that holds the row."""
        for node in ast.walk(self._function):
            match node:
                case ast.Assign(targets=[ast.Subscript(value=row, slice=ast.Constant(value=str(key)))]) if (
                    self._is_row(row) and key in self._columns
                ):
                    start, end = self._edits.start_of(node), self._edits.start_of(node.value)
                    self._edits.replace_span(start, end, f"context.publish({key!r}, ")
                    self._edits.insert(self._edits.end_of(node.value), ")")
                case ast.Subscript(value=row, slice=ast.Constant(value=str(key))) if self._is_row_or_variable(row):
                    self._convert_cell(node, row, key)
                case ast.Attribute(value=ast.Name(id="context"), attr=name) if name in _ATTRIBUTES:
                    self._edits.replace(node, f"context.{_ATTRIBUTES[name]}")
                case ast.Attribute() if self._is_row(node):
                    self._edits.replace(node, "dict(context.combination)")
                case ast.Return(value=ast.Name(id=name)) if name in self._rows:
                    self._edits.replace(
                        node,
                        f"return {{name: value for name, value in {name}.items() if name not in context.combination}}",
                    )
                case _:
                    pass

    def _convert_cell(self, node: ast.Subscript, row: ast.expr, key: str) -> None:
        if key == _RUN_ID:
            self._edits.replace(node, "context.run_id")
        elif self._is_row(row):
            self._edits.replace(row, "context.combination")

    def _row_variables(self) -> Iterator[str]:
        for node in ast.walk(self._function):
            match node:
                case ast.Assign(targets=[ast.Name(id=name)], value=value) if self._is_row(value):
                    yield name
                case _:
                    pass

    def _is_row(self, node: ast.expr) -> bool:
        match node:
            case ast.Attribute(value=ast.Name(id="context"), attr=name):
                return name in _ROWS
            case _:
                return False

    def _is_row_or_variable(self, node: ast.expr) -> bool:
        return self._is_row(node) or (isinstance(node, ast.Name) and node.id in self._rows)
