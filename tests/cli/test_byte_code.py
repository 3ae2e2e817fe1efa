"""Byte code is kept of what is installed, which every start would compile anew, and of nothing that a user wrote."""

from __future__ import annotations

import site
import sys
from importlib.machinery import SourceFileLoader
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.conftest import HEAD

from robot_runner.cli import console
from robot_runner.cli.byte_code import no_byte_code

if TYPE_CHECKING:
    from collections.abc import Callable


def kept(folder: Path) -> set[str]:
    return {path.name.partition(".")[0] for path in folder.rglob("*.pyc")}


def loader(name: str, folder: Path) -> object:
    """Return what would import a module of this folder."""
    specs = (finder.find_spec(name, [str(folder)], None) for finder in sys.meta_path)
    return next(spec.loader for spec in specs if spec)


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of installed packages, in which nothing has been compiled yet."""
    folder = tmp_path / "site-packages"
    folder.mkdir()
    monkeypatch.setattr(site, "getsitepackages", lambda: [str(folder)])
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    return folder


@pytest.mark.parametrize("command", ["check", "run"])
def test_installed_packages_that_a_config_imports_first_are_kept_compiled_but_not_its_author_s_modules(
    command: str, packages: Path, robot_runner: Callable[..., object], write_config: Callable[..., Path]
) -> None:
    names = [f"{kind}_for_{command}" for kind in ("installed", "written")]
    config = write_config(head=f"import {', '.join(names)}\n{HEAD}")
    for name, folder in zip(names, [packages, config.parent], strict=True):
        (folder / f"{name}.py").write_text("ANSWER = 42\n", encoding="utf-8")
    assert robot_runner(command, config).code == 0
    assert kept(config.parent) == {names[0]}


def test_our_own_modules_are_installed_wherever_they_lie(packages: Path) -> None:
    (packages.parent / "written.py").touch()
    with no_byte_code():
        ours, written = loader("main", Path(console.__file__).parent), loader("written", packages.parent)
    assert type(ours) is SourceFileLoader
    assert type(written) is not SourceFileLoader


def test_modules_are_found_as_ever_afterwards(packages: Path) -> None:
    finders = list(sys.meta_path)
    sys.path.insert(0, str(packages.parent))
    (packages.parent / "written_by_a_user.py").write_text("ANSWER = 42\n", encoding="utf-8")
    (packages.parent / "imported_later.py").write_text("ANSWER = 42\n", encoding="utf-8")
    with no_byte_code():
        import written_by_a_user
    import imported_later

    assert (written_by_a_user.ANSWER, imported_later.ANSWER) == (42, 42)
    assert sys.meta_path == finders
    assert kept(packages.parent) == {"imported_later"}
