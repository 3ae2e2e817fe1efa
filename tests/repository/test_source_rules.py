"""Rules of the house that no linter knows, or that must hold even where a linter was silenced."""

from __future__ import annotations

import ast
from collections import Counter
from functools import cache
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


def _is_bare(node: ast.AST) -> bool:
    return isinstance(node, ast.ExceptHandler) and node.type is None


def _starts_unsafely(node: ast.AST) -> bool:
    """Whether it lists the words of a command that imports from the folder that it is started in."""
    if not isinstance(node, ast.List):
        return False
    words = [each.value if isinstance(each, ast.Constant) else None for each in node.elts]
    of_others = {"pip", "pytest", "venv"}
    return "-m" in words and "-P" not in words and not of_others & set(words[words.index("-m") + 1 :])


@cache
def _breaches(module: Path) -> set[Callable[[ast.AST], bool]]:
    """Which rules any of its nodes breaks; each module is parsed once for all of them."""
    nodes = list(ast.walk(ast.parse(module.read_bytes())))
    return {rule for rule in (_talks_to_the_terminal, _is_bare, _starts_unsafely) if any(map(rule, nodes))}


def test_no_module_is_long() -> None:
    assert _broken(lambda module: len(module.read_text(encoding="utf-8").splitlines()) > LONGEST) == []


def test_only_the_command_line_and_commands_of_rooms_print_or_exit() -> None:
    def talks(module: Path) -> bool:
        if module.is_relative_to(SOURCE / "cli") or module.parent.name == "commands":
            return False
        return _talks_to_the_terminal in _breaches(module)

    assert _broken(talks) == []


def test_a_print_is_noticed() -> None:
    tree = ast.parse("print('x')\nprint('x', file=log)\nlog.print('x')")
    assert [node.lineno for node in ast.walk(tree) if _talks_to_the_terminal(node)] == [1]


def test_no_except_is_bare() -> None:
    assert _broken(lambda module: _is_bare in _breaches(module)) == []


def test_no_module_is_a_drawer() -> None:
    assert _broken(lambda module: bool(DRAWERS & set(module.relative_to(SOURCE).with_suffix("").parts))) == []


def test_a_file_name_means_one_thing() -> None:
    names = Counter(module.name for module in MODULES if module.name != "__init__.py")
    assert [name for name, count in names.items() if count > 1] == []


def test_no_program_of_ours_that_is_started_imports_from_the_folder_that_it_is_started_in() -> None:
    # A user's random.py, types.py or queue.py beside a study would stand in for Python's own, unless -P is given.
    # What a user is told to type is no program that we start.
    assert [
        name for name in _broken(lambda module: _starts_unsafely in _breaches(module)) if name != "cli/console.py"
    ] == []
