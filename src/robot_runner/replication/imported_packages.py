"""Which packages an experiment imports: its config, its plugins and its robot; found without executing anything."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib.metadata import packages_distributions
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from robot_runner.core.config.source import parsed
from robot_runner.core.entry_points import entry_points
from robot_runner.core.storage.guarded_files import read_bytes
from robot_runner.core.storage.input_files import copies_in
from robot_runner.replication.distributions import canonical

_LINKS = "links"
#: What the program is made of whatever is measured: which robot and plugins there are, says nothing of it.
_FRAME = ("robot_runner.core", "robot_runner.cli", "robot_runner.plugins", "robot_runner.testing")
#: Which distributions bring each top-level module.
_owners = cache(packages_distributions)


def importers(manifest: Mapping[str, Any], config: Path | None = None) -> dict[str, tuple[str, ...]]:
    """Return who of an experiment imports each package, by its canonical name; only what is installed here is known.

    Args:
        manifest: the experiment's; its plugins and its robot are looked at.
        config: the folder of the config file and its local modules, where that is at hand.

    Raises:
        OSError: a file of the config cannot be read.
    """
    found: dict[str, list[str]] = {}
    for who, modules in _parts(manifest, config):
        for name in sorted(modules.difference(sys.stdlib_module_names)):
            for owner in owners_of(name):
                found.setdefault(canonical(owner), []).append(who)
    return {name: tuple(dict.fromkeys(names)) for name, names in found.items()}


def _parts(manifest: Mapping[str, Any], config: Path | None) -> Iterator[tuple[str, set[str]]]:
    robot = str(manifest.get("robot") or "").partition(":")[0]
    for link in entry_points(_LINKS):
        if link.name == robot:
            yield f"robot {robot}", _reached(link.module)
    for plugin in manifest.get("plugins") or ():
        yield str(plugin.get("name")), _reached(str(plugin.get("class", "")).partition(":")[0])
    if config is not None:
        yield "config", imported_names(config)


def owners_of(module: str) -> list[str]:
    """Return the distributions that bring a top-level module; its own name, where it is imported from a folder."""
    return _owners().get(module) or [module]


def imported_names(folder: Path) -> set[str]:
    """Return the top-level modules that the Python files in a folder of configs import, found without executing them.

    What lies there as the experiment reads it, such as a script under test, may be for another Python.

    Raises:
        OSError: a file cannot be read.
        StorageError: the index of the files that the experiment reads cannot be read.
    """
    found: set[str] = set()
    read = copies_in(folder)
    for path in sorted(each for each in folder.rglob("*.py") if each.absolute() not in read):
        found.update(name.partition(".")[0] for name in _imports(read_bytes(path), ""))
    return found


@cache
def _reached(module: str) -> set[str]:
    """Return the top-level modules that a module imports, itself or by way of others of its own package."""
    top = module.partition(".")[0]
    found, pending, seen = {top}, [module], set()
    while pending:
        name = pending.pop()
        path = None if name in seen else _file_of(name)
        seen.add(name)
        if path is None:
            continue
        try:
            content = path.read_bytes()
        except OSError:
            continue
        package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        for imported in _imports(content, package):
            first = imported.partition(".")[0]
            if first != top:
                found.add(first)
            elif not imported.startswith(_FRAME):
                pending.append(imported)
    return found


def _file_of(module: str) -> Path | None:
    """Return the file of a module or, where it names something inside one, of that; nothing is imported."""
    top, *rest = module.split(".")
    try:
        spec = find_spec(top)
    except (ImportError, ValueError):
        return None
    for folder in spec.submodule_search_locations or () if spec else ():
        place = Path(folder)
        for part in rest:
            if not (place / part).is_dir():
                file = place / f"{part}.py"
                return file if file.is_file() else place / "__init__.py"
            place /= part
        return place / "__init__.py"
    return Path(spec.origin) if spec and not rest and spec.origin and spec.has_location else None


def _imports(content: bytes, package: str) -> Iterable[str]:
    """Yield the full names of what a file imports, also where a function does; nothing of a file that is no Python."""
    try:
        tree = parsed(content)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return
    for node in _statements(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and (not node.level or package):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            module = ".".join([*above, *([node.module] if node.module else [])])
            yield from (f"{module}.{alias.name}" for alias in node.names)


def _statements(tree: ast.Module) -> Iterator[ast.AST]:
    """Yield all statements, however deep: a tenth of what `ast.walk` yields, since no expression imports anything."""
    pending: list[ast.AST] = [tree]
    while pending:
        node = pending.pop()
        yield node
        for part in ("body", "orelse", "finalbody", "handlers", "cases"):
            pending += getattr(node, part, ())
