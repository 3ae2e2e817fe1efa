"""The tests live in a tree that mirrors what they test."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[2]
TESTS = ROOT / "tests"
FILES = sorted(TESTS.rglob("*.py"))
#: Tests of the repository, of whole processes, and of all commands on hostile folders and packages.
WHOLE = {"repository", "process", "hostile"}


def _mirrors_something(folder: Path) -> bool:
    """Whether there is a package or folder of this name, or the tests are of the whole."""
    relative = folder.relative_to(TESTS)
    in_source = (ROOT / "src" / "robot_runner" / relative).is_dir()
    return in_source or (ROOT / relative).is_dir() or relative.as_posix() in WHOLE


def test_each_folder_of_tests_mirrors_a_folder_of_the_source() -> None:
    assert [str(folder) for folder in {path.parent for path in FILES} if not _mirrors_something(folder)] == []


def test_no_two_test_files_have_one_name() -> None:
    names = Counter(path.name for path in FILES if path.name != "conftest.py")
    assert [name for name, count in names.items() if count > 1] == []


def test_tests_are_no_packages() -> None:
    assert list(TESTS.rglob("__init__.py")) == []
