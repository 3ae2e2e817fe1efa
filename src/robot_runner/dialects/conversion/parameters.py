"""Static parameters: what an earlier tool called them, and where its relative paths began."""

from __future__ import annotations

import ast
from typing import TYPE_CHECKING

from robot_runner.dialects.syntax import walk_bodies

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from robot_runner.dialects.conversion.edits import Edits

__all__ = ["convert_parameters"]

_PATH_PROPERTY = '''
    @property
    def experiment_path(self) -> Path:
        """Where everything of this experiment is kept; callbacks also have it as context.experiment_folder."""
        return Path(__file__).parent / Path(self.results_output_path).expanduser() / self.experiment_name'''


def convert_parameters(config: ast.ClassDef, results: Path, edits: Edits) -> None:
    """Rename the static parameters of a config class, wherever its body uses them.

    Args:
        config: the class.
        results: where the earlier tool kept results.
        edits: takes the changes.
    """
    for statement in walk_bodies(config.body):
        _rename_reads_of_name(statement, edits)
        for target in _targets(statement):
            if target.id == "name":
                edits.replace(target, "experiment_name")
            elif target.id == "experiment_path":
                edits.remove_lines(statement.lineno, statement.end_lineno or statement.lineno)
            elif target.id == "results_output_path" and not results.expanduser().is_absolute():
                _begin_in_current_folder(statement, edits)
    if any(isinstance(node, ast.Attribute) and node.attr == "experiment_path" for node in ast.walk(config)):
        edits.insert(edits.end_of(config), f"\n{_PATH_PROPERTY}")


def _rename_reads_of_name(statement: ast.stmt, edits: Edits) -> None:
    """Rename `name` where the body of the class goes on to use it; in a method it is another name."""
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return
    expressions = (each for each in ast.iter_child_nodes(statement) if isinstance(each, ast.expr))
    for node in (node for expression in expressions for node in ast.walk(expression)):
        match node:
            case ast.Name(id="name", ctx=ast.Load()):
                edits.replace(node, "experiment_name")
            case _:
                pass


def _begin_in_current_folder(statement: ast.stmt, edits: Edits) -> None:
    """Have a relative path begin where it did: ours begin where the config file is."""
    value = getattr(statement, "value", None)
    if value is not None:
        edits.insert(edits.start_of(value), "Path.cwd() / (")
        edits.insert(edits.end_of(value), ")")


def _targets(statement: ast.stmt) -> Iterator[ast.Name]:
    match statement:
        case ast.Assign(targets=targets):
            yield from (target for target in targets if isinstance(target, ast.Name))
        case ast.AnnAssign(target=ast.Name() as target):
            yield target
        case _:
            pass
