"""The commands that are installed: the core's, those of the rooms beside it, and those of other packages, all alike.

Each is a module, announced in the group `robot_runner.commands` and imported when its command is called. Its docstring
is the command's help, `add_arguments(parser)` says what it takes, and `execute(arguments)` returns the exit code.
"""

from __future__ import annotations

import sys

from robot_runner.core.entry_points import EntryPoint, entry_points

TYPE_CHECKING = False  # `typing` takes long to import, and `--help` is to be quick
if TYPE_CHECKING:
    from importlib.machinery import ModuleSpec
    from typing import Any

    from robot_runner.cli.parser import CommandModule

__all__ = ["command_module", "installed_commands", "summary_of"]

#: The core's own commands, in the order in which a user meets them.
_CORE = (
    *("demo", "new", "check", "plan", "smoke", "run", "status", "queue"),
    *("pause", "continue", "extend", "exclude", "include", "plugins", "try", "doctor", "completion"),
)
_QUOTES = '"""'
_ONLY_AST = 0x400  # ast.PyCF_ONLY_AST


def installed_commands() -> dict[str, EntryPoint]:
    """Return the commands by name: the core's, then those of each room together, then those of other packages."""
    found: dict[str, EntryPoint] = {}
    for point in entry_points("commands"):
        found.setdefault(point.name, point)  # no package can take the name of a command of ours
    core = [name for name in _CORE if name in found]
    others = sorted(found.keys() - _CORE, key=lambda name: (not found[name].is_own, found[name].value))
    return {name: found[name] for name in (*core, *others)}


def command_module(point: EntryPoint) -> CommandModule:
    """Import the module of a command.

    Raises:
        PluginError: it cannot be imported, or lacks a function that a command has.
    """
    module: CommandModule = point.load()
    for function in ("add_arguments", "execute"):
        if not callable(getattr(module, function, None)):
            raise point.refusal(f"has no function {function}")
    return module


def summary_of(point: EntryPoint) -> str:
    """Return what a command does: the first line of its module's docstring, which is read and not imported."""
    try:
        line = _first_line(_source_of(point.module))
    except (OSError, ImportError, SyntaxError, ValueError) as error:
        line = f"cannot be used ({type(error).__name__}: {error}); install or repair the package {point.package}"
    return line if line.isprintable() else ascii(line)


def _source_of(module: str) -> str:
    """Return the text of a module; neither it nor a package that it is in is imported.

    Raises:
        OSError, ImportError, ValueError: it is not there, or cannot be read.
    """
    top, *rest = module.split(".")
    spec = getattr(sys.modules.get(top), "__spec__", None) or _found(top)
    if not rest:
        return _read(spec.loader, spec.origin or "")
    for folder in spec.submodule_search_locations or ():
        stem = "/".join([folder, *rest])
        for path in (f"{stem}.py", f"{stem}/__init__.py"):
            try:
                return _read(spec.loader, path)
            except OSError:
                continue
    raise ModuleNotFoundError(f"there is no module {module}")


def _found(top: str) -> ModuleSpec:
    for finder in sys.meta_path:
        spec = finder.find_spec(top, None)
        if spec is not None:
            return spec
    raise ModuleNotFoundError(f"there is no module {top}")


def _read(loader: Any, path: str) -> str:
    if hasattr(loader, "get_data"):  # of a zip file, too
        return str(loader.get_data(path), "utf-8")
    with open(path, encoding="utf-8") as file:  # noqa: PTH123 - `pathlib` takes too long to import
        return file.read()


def _first_line(source: str) -> str:
    if source.startswith(_QUOTES):
        line = source.removeprefix(_QUOTES).partition("\n")[0].partition(_QUOTES)[0].strip()
        if line and "\\" not in line:
            return line
    # Spelt otherwise, so it takes Python to read it; the flag is that of `ast.parse`, whose module is slow to import.
    tree = compile(source, "command", "exec", _ONLY_AST, dont_inherit=True)
    first = getattr(tree.body[0], "value", None) if tree.body else None
    text = getattr(first, "value", None)
    return text.strip().partition("\n")[0] if isinstance(text, str) else ""
