"""Rules of the house that no linter knows, or that must hold even where a linter was silenced."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "robot_runner"
MODULES = sorted(SOURCE.rglob("*.py"))
LONGEST = 400
DRAWERS = {"utils", "util", "misc", "common", "helpers"}


def _talks_to_the_terminal(node: ast.AST) -> bool:
    """Whether it prints, asks or exits; printing into a stream that it was given (a run's log) is another thing."""
    if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Name):
        return False
    to_a_stream = any(keyword.arg == "file" for keyword in node.keywords)
    return node.func.id in {"input", "exit", "quit"} or (node.func.id == "print" and not to_a_stream)


def test_modules_are_found() -> None:
    assert SOURCE / "core" / "errors.py" in MODULES


def _broken(rule: Callable[[Path], bool]) -> list[str]:
    """The modules that break a rule; all of them, as a case for each would be most of the suite's tests."""
    return [module.relative_to(SOURCE).as_posix() for module in MODULES if rule(module)]


def _tree(module: Path) -> ast.Module:
    return ast.parse(module.read_bytes())


def test_no_module_is_long() -> None:
    assert _broken(lambda module: len(module.read_text(encoding="utf-8").splitlines()) > LONGEST) == []


def test_only_the_command_line_and_commands_of_rooms_print_or_exit() -> None:
    def talks(module: Path) -> bool:
        if module.is_relative_to(SOURCE / "cli") or module.parent.name == "commands":
            return False
        return any(map(_talks_to_the_terminal, ast.walk(_tree(module))))

    assert _broken(talks) == []


def test_a_print_is_noticed() -> None:
    tree = ast.parse("print('x')\nprint('x', file=log)\nlog.print('x')")
    assert [node.lineno for node in ast.walk(tree) if _talks_to_the_terminal(node)] == [1]


def test_no_except_is_bare() -> None:
    def has_bare(module: Path) -> bool:
        return any(isinstance(node, ast.ExceptHandler) and node.type is None for node in ast.walk(_tree(module)))

    assert _broken(has_bare) == []


def test_no_module_is_a_drawer() -> None:
    assert _broken(lambda module: bool(DRAWERS & set(module.relative_to(SOURCE).with_suffix("").parts))) == []


def test_a_file_name_means_one_thing() -> None:
    names = Counter(module.name for module in MODULES if module.name != "__init__.py")
    assert [name for name, count in names.items() if count > 1] == []


def test_no_program_of_ours_that_is_started_imports_from_the_folder_that_it_is_started_in() -> None:
    # A user's random.py, types.py or queue.py beside a study would stand in for Python's own, unless -P is given.
    def is_unsafe(module: Path) -> bool:
        lists = (node.elts for node in ast.walk(_tree(module)) if isinstance(node, ast.List))
        words = ([each.value if isinstance(each, ast.Constant) else None for each in elements] for elements in lists)
        of_others = {"pip", "pytest", "venv"}
        return any(
            "-m" in each and "-P" not in each and not of_others & set(each[each.index("-m") + 1 :]) for each in words
        )

    # What a user is told to type is no program that we start.
    assert [name for name in _broken(is_unsafe) if name != "cli/console.py"] == []
