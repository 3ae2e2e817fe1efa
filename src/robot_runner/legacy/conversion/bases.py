"""Convert the files of a config's base classes first, and record the names that they pass on."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import resolve_name
from pathlib import Path

from robot_runner.core.config.source import read_tree
from robot_runner.core.errors import ConfigError
from robot_runner.core.events.manager import EVENTS_BY_CALLBACK
from robot_runner.legacy.conversion.earlier_imports import ConvertedFile
from robot_runner.legacy.recognition import is_earlier_import
from robot_runner.legacy.syntax import ImportedName, attributes_of, bound_names, imports_of, nodes

_INSTALLED = frozenset({"dist-packages", "site-packages"})


def _is_installed(file: Path) -> bool:
    return bool(_INSTALLED & set(file.parts))


def file_of_module(name: str) -> Path | None:
    """Return the Python file of an imported module, or None."""
    file = Path(getattr(sys.modules.get(name), "__file__", None) or "")
    return file.resolve() if file.suffix == ".py" else None


def imported_files(tree: ast.Module) -> Iterator[Path]:
    """Yield the files of a config's imports that are neither installed nor in the standard library."""
    for each in imports_of(tree):
        file = file_of_module(each.module)
        is_standard = each.module.partition(".")[0] in sys.stdlib_module_names
        if file is not None and not is_standard and not _is_installed(file):
            yield file


@contextmanager
def load_apart() -> Iterator[None]:
    """Afterwards remove the modules that were imported from folders added to the path meanwhile.

    A converted file may have the same name as its original, or as a file of another study.
    """
    folders, modules = list(sys.path), set(sys.modules)
    try:
        yield
    finally:
        added = {Path(folder).resolve() for folder in sys.path if folder not in folders}
        sys.path[:] = folders
        # A package without a file of its own has folders, which it looks up in its parent: see all, then forget.
        for name in [name for name in set(sys.modules) - modules if _is_from(added, sys.modules[name])]:
            del sys.modules[name]


def _is_from(folders: set[Path], module: object) -> bool:
    places = [getattr(module, "__file__", None), *getattr(module, "__path__", ())]
    files = [Path(place).resolve() for place in places if place]
    return any(folders & {file, *file.parents} and not _is_installed(file) for file in files)


def base_files(config: Path, config_class: type) -> dict[Path, type]:
    """Return the files of a config's base classes, the farthest first, each with its class.

    Classes without a relation to the earlier tool, and those in the config's own file, are left out.
    """
    found: dict[Path, type] = {}
    for each in config_class.__mro__[1:]:
        file = _file_of(each)
        files = filter(None, map(_file_of, each.__mro__))
        is_earlier = any(earlier_import_in(parent) is not None for parent in files)
        if file is not None and file != config and is_earlier:
            found.setdefault(file, each)
    return dict(reversed(found.items()))


def _file_of(config_class: type) -> Path | None:
    file = None if is_earlier_import(config_class.__module__) else file_of_module(config_class.__module__)
    return None if file is None or _is_installed(file) else file


def earlier_import_in(file: Path) -> ImportedName | None:
    """Return a file's first import of a module of the earlier tool, or None."""
    try:
        imports = imports_of(read_tree(file)[1])
    except ConfigError:  # compiled, or in another encoding: Python can import it nevertheless
        return None
    return next((each for each in imports if is_earlier_import(each.module)), None)


def name_whole_modules(tree: ast.Module, base_class: type) -> None:
    """Make a file's relative imports absolute, in the tree alone."""
    package = getattr(sys.modules.get(base_class.__module__), "__package__", None)
    for node in nodes(tree, ast.ImportFrom):
        if node.level and package:
            node.module = resolve_name("." * node.level + (node.module or ""), package)
            node.level = 0


@dataclass(frozen=True, slots=True)
class BaseFile:
    """A converted file with a base class of another config.

    Attributes:
        new: the path of the new file.
        is_beside: whether it is written beside its original, and not beside the derived config.
        renamed: the new names of its classes, also of those that it imports from other converted files.
        gained: the earlier tool's names in it: module and name, by the name in the file.
    """

    new: Path
    is_beside: bool
    renamed: dict[str, str]
    gained: dict[str, tuple[str, str]]

    def module(self, old: str) -> str:
        """Return the new name of its module in an import that named it `old`."""
        package = old.rpartition(".")[0] if self.is_beside else ""
        return f"{package}.{self.new.stem}".lstrip(".")


@dataclass(slots=True)
class Inherited:
    """The members that a config inherits from the converted files of its base classes.

    Attributes:
        files: the converted files, by their originals.
        methods: the new names of their methods, by their old names.
        heard: the callbacks among them that are subscribed to an event by their name.
    """

    files: dict[Path, BaseFile] = field(default_factory=dict)
    methods: dict[str, str] = field(default_factory=dict)
    heard: set[str] = field(default_factory=set)

    @classmethod
    def of_base(cls, original: Path, base: BaseFile, config: ast.ClassDef, renamed: dict[str, str]) -> Inherited:
        """Return the members of one converted file: `config` is its original class, `renamed` has new names."""
        methods = {name: renamed.get(name, name) for name in bound_names(config.body)}
        heard = set(methods.values()) & set(EVENTS_BY_CALLBACK)
        if "continue_experiment" in heard:
            heard.add("before_experiment")  # which starts the first run by itself
        return cls({original: base}, methods, heard)

    @classmethod
    def together(cls, parts: Iterable[Inherited]) -> Inherited:
        """Return the members of several files, the farthest first."""
        inherited = cls()
        for part in parts:
            inherited.files |= part.files
            inherited.methods |= part.methods
            inherited.heard |= part.heard
        return inherited

    def gained_by(self, tree: ast.Module) -> dict[str, tuple[str, str]]:
        """Return the earlier tool's names in a file: from its own imports, and through these files."""
        gained: dict[str, tuple[str, str]] = {}
        for each in imports_of(tree):
            base = self.file_of(each.module)
            if is_earlier_import(each.module) and each.name not in {"", "*"}:
                gained[each.bound_as] = each.module, each.name
            elif base is not None and each.name == "*":
                gained |= base.gained
            elif base is not None and each.name in base.gained:
                gained[each.bound_as] = base.gained[each.name]
        return gained

    def file_of(self, module: str) -> BaseFile | None:
        """Return the converted file of a module, or None."""
        return self.files.get(file_of_module(module) or Path())


def convert_base_imports(converted: ConvertedFile, inherited: Inherited) -> list[int]:
    """Make a config import the converted files of its base classes; returns the lines of these imports.

    The config itself imports the names that it had from the earlier tool through these files.
    """
    lines = []
    for node in nodes(converted.tree, ast.ImportFrom):
        module = node.module or ""
        base = inherited.file_of(module)
        statements = [] if base is None else [_names_of_base(node, base, converted)]
        if base is None and any(inherited.file_of(f"{module}.{alias.name}") for alias in node.names):
            statements = [_module_of_package(node, alias, inherited, converted) for alias in node.names]
        if statements:
            lines.append(node.lineno)
            converted.edits.replace(node, f"\n{' ' * node.col_offset}".join(filter(None, statements)) or "pass")
    for imported in nodes(converted.tree, ast.Import):
        for alias in imported.names:
            base = inherited.file_of(alias.name)
            if base is not None:
                lines.append(imported.lineno)
                converted.edits.replace(alias, _module_of_base(imported, alias, base, converted))
    return lines


def _names_of_base(node: ast.ImportFrom, base: BaseFile, converted: ConvertedFile) -> str:
    """Return the import of the names that the converted file still has; the others come from robot_runner."""
    kept = []
    for alias in node.names:
        if alias.name == "*":
            kept.append("*")
            converted.names |= base.renamed
            converted.classes |= base.renamed.keys()
            for bound in base.gained:
                _take_gained(node, base, bound, bound, converted)
        elif alias.name in base.gained:
            _take_gained(node, base, alias.name, alias.asname or alias.name, converted)
        else:
            name = base.renamed.get(alias.name, alias.name)
            kept.append(f"{name} as {alias.asname}" if alias.asname else name)
            if alias.asname is None:
                converted.names[alias.name] = name
            if alias.name in base.renamed:
                converted.classes.add(alias.asname or alias.name)
    return f"from {base.module(node.module or '')} import {', '.join(kept)}" if kept else ""


def _take_gained(node: ast.ImportFrom, base: BaseFile, there: str, bound: str, converted: ConvertedFile) -> None:
    module, name = base.gained[there]
    converted.take(node.lineno, module, ast.alias(name, None if bound == name else bound))


def _module_of_package(node: ast.ImportFrom, alias: ast.alias, inherited: Inherited, converted: ConvertedFile) -> str:
    """Return the import of one module of a package (`from studies import base`)."""
    module = f"{node.module}.{alias.name}"
    base = inherited.file_of(module)
    bound = alias.asname or alias.name
    if base is None:
        return f"from {node.module} import {alias.name}" + (f" as {bound}" if alias.asname else "")
    _refuse_gained(node, bound, base, converted)
    return f"import {base.module(module)} as {bound}"


def _module_of_base(node: ast.Import, alias: ast.alias, base: BaseFile, converted: ConvertedFile) -> str:
    if "." in alias.name and alias.asname is None:
        problem = f"the config derives from a class of {alias.name}, which it imports as a whole"
        converted.refuse_whole_module(node.lineno, problem)
        return alias.name
    bound = alias.asname or alias.name
    _refuse_gained(node, bound, base, converted)
    return f"{base.module(alias.name)} as {bound}"


def _refuse_gained(node: ast.stmt, bound: str, base: BaseFile, converted: ConvertedFile) -> None:
    """Rename classes that are attributes of a module, and refuse the earlier tool's names there."""
    for _, each in attributes_of(converted.tree, {bound}):
        if each.attr in base.renamed:
            converted.edits.replace(each, f"{bound}.{base.renamed[each.attr]}")
            converted.classes.add(f"{bound}.{each.attr}")
        elif each.attr in base.gained:
            problem = f"{each.attr} of the earlier tool is used as {bound}.{each.attr}"
            converted.refuse_whole_module(node.lineno, problem)
