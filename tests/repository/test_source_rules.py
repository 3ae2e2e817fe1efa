"""Rules of the house that no linter knows, or that must hold even where a linter was silenced."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "robot_runner"
MODULES = sorted(SOURCE.rglob("*.py"))
LONGEST = 400
DRAWERS = {"utils", "util", "misc", "common", "helpers"}

each_module = pytest.mark.parametrize("module", MODULES, ids=lambda path: path.relative_to(SOURCE).as_posix())


def _talks_to_the_terminal(node: ast.AST) -> bool:
    """Whether it prints, asks or exits; printing into a stream that it was given (a run's log) is another thing."""
    if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Name):
        return False
    to_a_stream = any(keyword.arg == "file" for keyword in node.keywords)
    return node.func.id in {"input", "exit", "quit"} or (node.func.id == "print" and not to_a_stream)


def test_modules_are_found() -> None:
    assert SOURCE / "core" / "errors.py" in MODULES


@each_module
def test_no_module_is_long(module: Path) -> None:
    assert len(module.read_text(encoding="utf-8").splitlines()) <= LONGEST


@each_module
def test_only_the_command_line_prints_or_exits(module: Path) -> None:
    if module.is_relative_to(SOURCE / "cli") or module.parent.name == "commands":
        return
    talking = filter(_talks_to_the_terminal, ast.walk(ast.parse(module.read_bytes())))
    assert [node.lineno for node in talking] == []


def test_a_print_is_noticed() -> None:
    tree = ast.parse("print('x')\nprint('x', file=log)\nlog.print('x')")
    assert [node.lineno for node in ast.walk(tree) if _talks_to_the_terminal(node)] == [1]


@each_module
def test_no_except_is_bare(module: Path) -> None:
    handlers = [node for node in ast.walk(ast.parse(module.read_bytes())) if isinstance(node, ast.ExceptHandler)]
    assert [handler.lineno for handler in handlers if handler.type is None] == []


@each_module
def test_no_module_is_a_drawer(module: Path) -> None:
    assert not DRAWERS & set(module.relative_to(SOURCE).with_suffix("").parts)
