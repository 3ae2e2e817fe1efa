"""Every example in a docstring works as it is printed."""

from __future__ import annotations

import doctest
import importlib
from collections.abc import Iterable
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[2] / "src"
MODULES = sorted(
    ".".join(path.relative_to(SOURCE).with_suffix("").parts).removesuffix(".__init__")
    for path in SOURCE.rglob("*.py")
    if path.stem != "__main__" and path.parent.name != "in_children"  # these act as soon as they are imported
)
#: The packages whose names are public: their examples are read, and pasted, without the module around them.
DOORS = [f"robot_runner{each}" for each in ("", ".adaptive", ".analysis", ".designs", ".plugins", ".testing")] + [
    f"robot_runner.plugins.{each}" for each in ("profilers", "systems")
]


@pytest.mark.parametrize("name", MODULES)
def test_examples_in_docstrings_work(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    if name.startswith("robot_runner.ros.ros2_"):
        pytest.importorskip("rclpy", reason="rclpy comes with a sourced ROS 2 alone")
    module = importlib.import_module(name)
    _work(doctest.DocTestFinder(exclude_empty=True).find(module))


@pytest.mark.long
@pytest.mark.parametrize("door", DOORS)
def test_examples_of_public_names_work_where_nothing_else_was_imported(
    door: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    module = importlib.import_module(door)
    finder = doctest.DocTestFinder(exclude_empty=True)
    public = {name: getattr(module, name) for name in dir(module)}
    _work(
        each
        for name, one in public.items()
        if callable(one)
        for each in finder.find(one, name, module=False, globs={name: one})
    )


def _work(tests: Iterable[doctest.DocTest]) -> None:
    report: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    for found in tests:
        if found.examples:  # each `run` asks the system for the date of every file that was read for a traceback
            runner.run(found, out=report.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(report)


def test_modules_are_found() -> None:
    assert "robot_runner.core.events.measure" in MODULES
