"""Reading and parsing a config file, finding its config class, and the plugins that its imports activate.

The paper's `import plugins.profilers.Ina219` activates a plugin: such modules exist only while a config file is loaded,
and a package named `plugins` beside the config file comes first.
"""

from __future__ import annotations

import ast
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import decode_source
from pathlib import Path
from types import ModuleType

from robot_runner.core.errors import ConfigError, nearest
from robot_runner.core.plugin import GROUPS, Plugin, find_plugin
from robot_runner.core.storage.system_refusals import storage_error
from robot_runner.core.words import listed

CONFIG_CLASS = "RobotRunnerConfig"
_CONFIG_BASE = "ExperimentConfig"
#: The method of a config that makes its design; that of the earlier tools, too.
DESIGN_METHODS = frozenset({"create_run_table", "create_run_table_model"})


@dataclass(frozen=True, slots=True)
class ConfigSource:
    """A config file that parses, by its absolute path, and has a class that describes the experiment."""

    path: Path
    text: str
    class_name: str


def read_source(path: Path) -> ConfigSource:
    """Read and parse a config file without executing it.

    Raises:
        ConfigError: there is no such file, it cannot be read or parsed, or it has no config class.
    """
    text, tree = read_tree(path)
    return ConfigSource(path.resolve(), text, _config_class(path, tree))


def read_tree(path: Path) -> tuple[str, ast.Module]:
    """Return the text of a Python file and its syntax tree.

    Raises:
        ConfigError: there is no such file, or it cannot be read or parsed.
    """
    text = _read(path)
    try:
        return text, parsed(text, str(path))
    except SyntaxError as error:
        problem = f"the file is not Python: {error.msg}: {(error.text or '').strip()!r}"
        fix = "Correct the syntax of this line (or of the one before it)."
        raise ConfigError(problem, where=f"{path}:{error.lineno or 0}", fix=fix) from error
    except ValueError as error:
        raise ConfigError(f"the file is not Python: {error}", where=str(path), fix="Name a Python file.") from error


def parsed(code: str | bytes, name: str = "<unknown>") -> ast.Module:
    """Return the syntax tree of Python code as `ast.parse`, without its warnings, which come when it is executed.

    Raises:
        SyntaxError: it is not Python.
        ValueError: it has a null byte, or is of no encoding.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return ast.parse(code, filename=name)


def tree_or_empty(code: str | bytes) -> ast.Module:
    """Return the syntax tree of code that is not executed here; an empty one where it is not Python."""
    try:
        return parsed(code)
    except (SyntaxError, ValueError, RecursionError, MemoryError):  # the last two: nested too deeply
        return ast.Module([], [])


def tree_of(path: Path) -> ast.Module:
    """Return the syntax tree of an imported module; an empty one where it is not Python source."""
    try:
        return read_tree(path)[1]
    except ConfigError:
        return ast.Module([], [])


def _read(path: Path) -> str:
    try:
        if path.exists() and not path.is_file() and not path.is_dir():  # a pipe would be waited for without end
            raise ConfigError("the path names no regular file", where=str(path), fix="Name a Python file.")
        text = decode_source(path.read_bytes())
    except FileNotFoundError as error:
        raise ConfigError("there is no such file", where=str(path), fix=_other_file(path)) from error
    except IsADirectoryError as error:
        problem = "the path names a folder, not a config file"
        raise ConfigError(problem, where=str(path), fix=_config_of(path)) from error
    except (UnicodeDecodeError, SyntaxError) as error:
        fix = "Name a Python file, saved as UTF-8."
        raise ConfigError("the file is not text in UTF-8, nor as it declares", where=str(path), fix=fix) from error
    except OSError as error:
        refusal = storage_error(path, "read", error)
        raise ConfigError(refusal.problem, where=refusal.where, fix=refusal.fix) from error
    if path.suffix == ".py":
        return text
    by_run = f"Have the notebook execute it by run_experiment, or save its code as {path.stem}.py."
    fix = by_run if path.suffix == ".ipynb" else "Give it a name that ends in .py."
    raise ConfigError("a config is a Python file, and this is none by its name", where=str(path), fix=fix)


def _config_of(folder: Path) -> str:
    names = sorted(each.name for each in folder.glob("*.py"))
    if names:
        return f"Name the config file in it: {listed(names)}."
    return "Name the config file that results are made by, which ends in .py; imported results have none."


def _other_file(path: Path) -> str:
    names = [each.name for each in path.parent.glob("*.py")] if path.parent.is_dir() else []
    near = nearest(path.name, names)
    if near:
        return f"Did you mean {path.parent / near}?"
    return "Name an existing file, or make one with `robot-runner new`."


def _config_class(path: Path, tree: ast.Module) -> str:
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
    names = [node.name for node in classes]
    if CONFIG_CLASS in names:
        return CONFIG_CLASS
    bases = {node.name: set(map(name_of, node.bases)) for node in classes}
    derived = {_CONFIG_BASE}
    for name in names:
        derived |= {name} if bases[name] & derived else set()
    others = [bases[each] for each in derived & bases.keys()]
    last = [name for name in names if name in derived and not any(name in each for each in others)]
    if len(last) == 1:
        return last[0]
    if last:
        fix = f"Name the one that is to be executed {CONFIG_CLASS}."
        raise ConfigError(f"the file has {len(last)} config classes: {', '.join(last)}", where=str(path), fix=fix)
    fix = f"Describe the experiment in a class {CONFIG_CLASS}."
    if len(names) == 1 and nearest(CONFIG_CLASS, names) is None and not bases[names[0]]:
        fix = f"Rename the class {names[0]} to {CONFIG_CLASS}, or derive it: class {names[0]}({_CONFIG_BASE})."
    elif names:
        fix = f"Rename the class {nearest(CONFIG_CLASS, names) or names[-1]} to {CONFIG_CLASS}."
    raise ConfigError(f"the file has no class named {CONFIG_CLASS}", where=str(path), fix=fix)


def name_of(node: ast.AST | None) -> str:
    """Return a name, or the last part of a dotted one; empty for any other code."""
    match node:
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return name
        case _:
            return ""


_ROOT = "plugins"


@contextmanager
def activating_imports() -> Iterator[list[type[Plugin]]]:
    """Let `import plugins.<kind>.<name>` import an installed plugin; yields the classes that were imported so."""
    stand_ins = _StandIns()
    sys.meta_path.append(stand_ins)
    try:
        yield stand_ins.activated
    finally:
        sys.meta_path.remove(stand_ins)
        specs = {name: getattr(module, "__spec__", None) for name, module in sys.modules.items()}
        for name in [name for name, spec in specs.items() if isinstance(getattr(spec, "loader", None), _StandIns)]:
            del sys.modules[name]


class _StandIns(MetaPathFinder, Loader):
    """Stands in for the modules `plugins`, `plugins.<kind>` and `plugins.<kind>.<name>`; the last one is a plugin."""

    def __init__(self) -> None:
        self.activated: list[type[Plugin]] = []

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Offer such a module."""
        del path, target
        root, kind, name = _parts_of(fullname)
        if root != _ROOT or (kind and kind not in GROUPS) or "." in name:
            return None
        return ModuleSpec(fullname, self, is_package=not name)

    def exec_module(self, module: ModuleType) -> None:
        """Put the plugin's class into its module, and activate it."""
        _, kind, name = _parts_of(module.__name__)
        if not name:
            return
        plugin = find_plugin(kind, name)
        setattr(module, name, plugin)
        if plugin not in self.activated:
            self.activated.append(plugin)


def _parts_of(module: str) -> tuple[str, str, str]:
    root, _, rest = module.partition(".")
    kind, _, name = rest.partition(".")
    return root, kind, name
