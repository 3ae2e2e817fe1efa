"""The modules that a config imports: those written for the earlier tool have to be mended first."""

from __future__ import annotations

import ast
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.dialects.recognition import is_earlier_import
from robot_runner.dialects.syntax import imports_of
from robot_runner.errors import Finding

if TYPE_CHECKING:
    from collections.abc import Iterator

    from robot_runner.config.experiment import Experiment

__all__ = ["check_neighbours"]

_INSTALLED = frozenset({"dist-packages", "site-packages"})


def check_neighbours(experiment: Experiment, tree: ast.Module) -> Iterator[Finding]:
    """Say which modules that the config imports are written for the earlier tool themselves."""
    modules = {*experiment.local_modules, *_imported_files(tree)}
    for module in sorted(modules):
        for each in imports_of(ast.parse(module.read_text(encoding="utf-8"))):
            if is_earlier_import(each.module):
                yield Finding.error(
                    f"{module}:{each.line}",
                    f"the config imports this module, which imports {each.module} of the earlier tool",
                    "Write this line with robot_runner, or put what is needed into the config.",
                )
                break


def _imported_files(tree: ast.Module) -> Iterator[Path]:
    """Yield the files of what a config imports, wherever it put their folder on the path itself."""
    for each in imports_of(tree):
        file = Path(getattr(sys.modules.get(each.module), "__file__", None) or "")
        is_installed = each.module.partition(".")[0] in sys.stdlib_module_names or _INSTALLED & set(file.parts)
        if file.suffix == ".py" and not is_installed:
            yield file
