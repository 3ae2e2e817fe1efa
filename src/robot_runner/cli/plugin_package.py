"""The package of a plugin that a user begins: its code, its tests, and what announces it."""

from __future__ import annotations

import re
import sys
from keyword import iskeyword
from typing import TYPE_CHECKING

from robot_runner.cli.parser import UsageError
from robot_runner.cli.templating import template, write_new_file
from robot_runner.core.errors import StorageError

if TYPE_CHECKING:
    from pathlib import Path

#: What the tests of each kind need beside pytest.
_EXTRAS = {"profiler": "", "system": "[sim]"}

_PYPROJECT = """\
[build-system]
requires = ["hatchling"]
build-backend = "hatchling.build"

[project]
name = "{project}"
version = "0.1.0"
description = "A {kind} of Robot Runner."
requires-python = ">=3.11"
dependencies = ["robot-runner"]

[project.optional-dependencies]
test = ["pytest", "robot-runner{extra}"]

# By this Robot Runner finds it, without importing it: `robot-runner plugins` lists it once it is installed.
[project.entry-points."robot_runner.{kind}s"]
{Class} = "{module}:{Class}"

[tool.hatch.build.targets.wheel]
include = ["{module}.py"]
"""
_README = """\
# {Class}

A {kind} of Robot Runner.

    pip install -e '.[test]'        install it, with what its tests need
    pytest                          test it
    robot-runner try {Class}{tried}

In a config:

    from {module} import {Class}

    plugins = [{Class}()]
"""
_NAME = re.compile(r"[a-z][a-z0-9]*(?:[_-][a-z0-9]+)*")


def write_plugin_package(folder: Path, kind: str) -> str:
    """Write a package with one plugin that works as it is, and its tests.

    Args:
        folder: where to; its name is that of the package. It must not exist.
        kind: `profiler` or `system`.

    Returns:
        The name of the plugin's class.

    Raises:
        UsageError: the folder's name cannot be that of a package.
        StorageError: it is there already, or cannot be written.
    """
    if not _NAME.fullmatch(folder.name):
        fix = f"Use lower-case letters, digits and '_', as in my_{'meter' if kind == 'profiler' else 'robot'}."
        raise UsageError("the folder's name is to be that of a Python package", where=str(folder), fix=fix)
    module = folder.name.replace("-", "_")
    if iskeyword(module) or module in sys.stdlib_module_names:
        problem = f"{module!r} is a word or a module of Python itself, and no module beside it can be imported by it"
        raise UsageError(problem, where=str(folder), fix=f"Choose another name, such as my_{module}.")
    words = {
        "Class": "".join(part.capitalize() for part in module.split("_")),
        "extra": _EXTRAS[kind],
        "kind": kind,
        "module": module,
        "project": module.replace("_", "-"),
        "title": folder.name,
        "tried": " --set robot=simulated" if kind == "system" else "",
    }
    files = {
        "pyproject.toml": _PYPROJECT,
        "README.md": _README,
        f"{module}.py": template(f"{kind}_plugin.txt"),
        f"test_{module}.py": template(f"{kind}_plugin_test.txt"),
    }
    try:
        folder.mkdir(parents=True)
    except FileExistsError as error:
        fix = f"Choose another name: robot-runner new --plugin {kind} NAME"
        raise StorageError("there is a file or folder of this name already", where=str(folder), fix=fix) from error
    except OSError as error:
        fix = "Name one in a folder that can be written."
        raise StorageError(f"the folder cannot be made: {error.strerror}", where=str(folder), fix=fix) from error
    for name, text in files.items():
        write_new_file(folder / name, _filled(text, words), instead="Choose another name.")
    return words["Class"]


def _filled(text: str, words: dict[str, str]) -> str:
    # Braces are Python's own in these texts, so that only the words themselves are replaced.
    return re.sub(r"\{(\w+)\}", lambda match: words.get(match[1], match[0]), text)
