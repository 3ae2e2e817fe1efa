"""The packages that a config file imports, where one of them is not there: the others are named at once."""

from __future__ import annotations

import importlib.util
from contextlib import suppress
from typing import TYPE_CHECKING

from robot_runner.dialects.recognition import is_earlier_import
from robot_runner.dialects.syntax import imports_of
from robot_runner.errors import Finding

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.dialects.recognition import Recognised

__all__ = ["check_packages"]


def check_packages(recognised: Recognised) -> Iterator[Finding]:
    """Yield what cannot be imported, each package with the first line that needs it; nothing is imported by asking."""
    looked_for: set[str] = set()
    for each in imports_of(recognised.tree):
        package = each.module.partition(".")[0]
        if each.is_guarded or is_earlier_import(each.module) or package in looked_for:
            continue
        looked_for.add(package)
        if not _is_there(package):
            yield Finding.error(
                f"{recognised.path}:{each.line}",
                f"there is no module {package!r}",
                f"Install the package that brings {package!r}, or mend the name.",
            )


def _is_there(package: str) -> bool:
    with suppress(ValueError):  # a module of the program's own, which has no origin
        return importlib.util.find_spec(package) is not None
    return True
