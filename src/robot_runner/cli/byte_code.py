"""Byte code is kept of what is installed, and not written beside what a user wrote."""

from __future__ import annotations

import os
import site
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import ModuleType


class _UnkeptSource(SourceFileLoader):
    """Imports a module from its source as ever, but writes nothing."""

    def set_data(self, path: str, data: object, *, _mode: int = 0) -> None:
        """Write nothing: the import system would have written byte code beside the source."""


class _KeepsInstalledOnly:
    """Finds modules as Python does; those of a user's own are imported without leaving byte code."""

    def __init__(self) -> None:
        folders = [Path(os.__file__).parent, Path(__file__).parents[1]]
        folders += map(Path, [*site.getsitepackages(), site.getusersitepackages()])
        self._installed = tuple(f"{folder}{os.sep}" for folder in folders)

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return where a module is and who imports it, as the finder of `sys.path` does."""
        spec = PathFinder.find_spec(name, path, target)
        if spec and type(spec.loader) is SourceFileLoader and not spec.loader.path.startswith(self._installed):
            spec.loader = _UnkeptSource(spec.loader.name, spec.loader.path)
        return spec


@contextmanager
def no_byte_code() -> Iterator[None]:
    """While a config is looked at, no byte code is written beside the modules of its author.

    That of our own modules and of installed packages is kept as ever: a config is often the first to import them, and
    each start would compile them anew.
    """
    finder = _KeepsInstalledOnly()
    usual = sys.meta_path.index(PathFinder) if PathFinder in sys.meta_path else len(sys.meta_path)
    sys.meta_path.insert(usual, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)
