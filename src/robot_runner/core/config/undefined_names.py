"""Warnings for names that functions of a config read, and that nothing defines: a run would fail of them."""

from __future__ import annotations

import builtins
import dis
import sys
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, ModuleType

from robot_runner.core.config.loader import LoadedConfig
from robot_runner.core.config.raised_errors import fix_of_undefined
from robot_runner.core.config.source import tree_of
from robot_runner.core.errors import Finding


def check_undefined_names(loaded: LoadedConfig) -> list[Finding]:
    """Return a warning for each name that a function of the config, or of a module beside it, would not find."""
    files = {str(each) for each in (loaded.source.path, *loaded.local_modules)}
    modules = [each for each in list(sys.modules.values()) if isinstance(each, ModuleType)]
    named = {str(vars(each).get("__file__")): each for each in modules}
    return [finding for file in sorted(files & named.keys()) for finding in _undefined_in(Path(file), named[file])]


def _undefined_in(path: Path, module: ModuleType) -> Iterator[Finding]:
    codes = list(_functions_of(compile(tree_of(path), str(path), "exec")))
    made = {each.argval for code in codes for each in dis.get_instructions(code) if each.opname == "STORE_GLOBAL"}
    known = {*vars(module), *dir(builtins), *made}
    local = {name for code in codes for name in code.co_varnames}
    for code in codes:
        if "NameError" in code.co_names:  # it looks whether there is one
            continue
        reader = code.co_qualname.partition(".<locals>")[0].rpartition(".")[2]
        lines: dict[str, int | None] = {}
        for each in dis.get_instructions(code):
            if each.opname == "LOAD_GLOBAL" and each.argval not in known and not each.argval.startswith("__"):
                lines.setdefault(each.argval, each.positions.lineno if each.positions else None)
        for name, line in lines.items():
            problem = f"nothing defines the name {name!r}, which {reader} reads"
            fix = fix_of_undefined(name, [*vars(module), *local])
            if name in {"self", "context"}:
                fix = f"Make it a parameter of {reader}."
            yield Finding.warning(f"{path}:{line or 0}", problem, fix)


def _functions_of(code: CodeType) -> Iterator[CodeType]:
    """Yield the code of all functions in some code, without annotations, which are evaluated only if asked for."""
    for each in code.co_consts:
        if isinstance(each, CodeType) and each.co_name != "__annotate__":
            yield each
            yield from _functions_of(each)
