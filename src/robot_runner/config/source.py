"""A config file as text: read, parsed, and searched for the class that describes the experiment."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from typing import TYPE_CHECKING

from robot_runner.errors import ConfigError, nearest

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["CONFIG_CLASS", "ConfigSource", "read_source", "read_tree"]

CONFIG_CLASS = "RobotRunnerConfig"
_CONFIG_BASE = "ExperimentConfig"


@dataclass(frozen=True, slots=True)
class ConfigSource:
    """A config file that parses and has a config class.

    Attributes:
        path: absolute.
        class_name: the class that describes the experiment.
    """

    path: Path
    text: str
    class_name: str


def read_source(path: Path) -> ConfigSource:
    """Read and parse a config file; nothing of it is executed.

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
        return text, ast.parse(text, filename=str(path))
    except SyntaxError as error:
        raise ConfigError(
            f"it is not Python: {error.msg}: {(error.text or '').strip()!r}",
            where=f"{path}:{error.lineno or 0}",
            fix="Mend the syntax of this line (or of the one before it).",
        ) from error
    except ValueError as error:
        raise ConfigError(f"it is not Python: {error}", where=str(path), fix="Name a Python file.") from error


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise ConfigError("there is no such file", where=str(path), fix=_other_file(path)) from error
    except IsADirectoryError as error:
        raise ConfigError("it is a folder", where=str(path), fix="Name the config file in it.") from error
    except UnicodeDecodeError as error:
        raise ConfigError("it is not text in UTF-8", where=str(path), fix="Name a Python file.") from error
    except OSError as error:
        raise ConfigError(
            f"it cannot be read: {error.strerror}", where=str(path), fix="Mend its permissions."
        ) from error


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
    derived = [node.name for node in classes if any(_name_of(base) == _CONFIG_BASE for base in node.bases)]
    if len(derived) == 1:
        return derived[0]
    if derived:
        raise ConfigError(
            f"it has {len(derived)} config classes: {', '.join(derived)}",
            where=str(path),
            fix=f"Name the one that is to be executed {CONFIG_CLASS}.",
        )
    near = nearest(CONFIG_CLASS, names)
    raise ConfigError(
        f"it has no class named {CONFIG_CLASS}",
        where=str(path),
        fix=f"Rename the class {near} to {CONFIG_CLASS}."
        if near
        else f"Describe the experiment in a class {CONFIG_CLASS}.",
    )


def _name_of(base: ast.expr) -> str:
    match base:
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return name
        case _:
            return ""
