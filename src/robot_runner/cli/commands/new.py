"""Write a commented config that runs as it is, or the package of a plugin of your own, with its tests.

The config describes a short experiment on the embedded robot, the plugin measures or drives something, to be changed:

    robot-runner new study.py
    robot-runner new --plugin profiler my_meter
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import sys
from argparse import Namespace
from keyword import iskeyword
from pathlib import Path

from robot_runner.cli.console import command_line, output, print_facts, quiet_loading
from robot_runner.cli.findings import show_findings
from robot_runner.cli.parser import Parser, UsageError
from robot_runner.cli.templating import template, write_new_file
from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import StorageError

#: The folder that each kind is written to where none is named.
_PLUGINS = {"profiler": "my_meter", "system": "my_robot"}


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "file",
        metavar="FILE",
        nargs="?",
        help="the file to write (experiment.py if it is left out), or the folder of the plugin (my_meter or my_robot); "
        "what is there is never overwritten",
    )
    parser.add_argument(
        "--plugin", metavar="KIND", choices=list(_PLUGINS), help="write a package with a plugin: profiler or system"
    )


def execute(arguments: Namespace) -> int:
    """Write the config, or the package."""
    if arguments.plugin is not None:
        return _write_plugin(arguments.file or _PLUGINS[arguments.plugin], arguments.plugin)
    name = arguments.file or "experiment.py"
    path = Path(name)
    if path.suffix != ".py":
        raise UsageError("a config is a Python file", where=name, fix=f"Name it {path.name or 'experiment'}.py.")
    text = template("new_config.py").replace("{file}", _in_text(path.name))
    write_new_file(path, text, instead="Choose another name: robot-runner new NAME.py")
    with quiet_loading():
        missing = [finding for finding in prepare(path).findings if finding.is_error]
    console = output()
    readiness = ". It cannot be executed here yet:" if missing else ", ready to be executed."
    console.tell(f"{name} is written: 6 runs on the embedded robot{readiness}")
    show_findings(missing)
    print_facts(
        console,
        [("Check", command_line("check", name)), ("Plan", command_line("plan", name)), ("Execute", command_line(name))],
    )
    return 0


def _in_text(name: str) -> str:
    """Return a file's name as a shell takes it, where a text of Python can hold it."""
    return "FILE.py" if {'"', "\\"} & {*name} or not name.isprintable() else shlex.quote(name)


def _write_plugin(name: str, kind: str) -> int:
    folder = Path(name)
    plugin = write_plugin_package(folder, kind)
    robot = ["--set", "robot=simulated"] if kind == "system" else []
    module = folder.name.replace("-", "_")
    pip = shlex.join([sys.executable, "-m", "pip", "install", "-e", f"{name}[test]"])
    test = shlex.join([sys.executable, "-m", "pytest", name])
    console = output()
    console.tell(f"{name} is written: the {kind} {plugin}, which works as it is, with its tests.")
    print_facts(
        console, [("Try", command_line("try", str(folder / f"{module}.py"), *robot)), ("Install", pip), ("Test", test)]
    )
    return 0


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
    """Write a package with a plugin (`profiler` or `system`) that works as it is, and its tests, into a new folder.

    Return the name of the plugin's class.

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
    if os.path.lexists(folder):
        fix = f"Choose another name: robot-runner new --plugin {kind} NAME"
        raise StorageError("there is a file or folder of this name already", where=str(folder), fix=fix)
    unfinished = folder.with_name(f".{folder.name}.{os.getpid()}.tmp")
    try:
        unfinished.mkdir(parents=True)
        for name, text in files.items():
            write_new_file(unfinished / name, _filled(text, words), instead="Choose another name.")
        unfinished.rename(folder)
    except OSError as error:
        fix = "Name one in a folder that can be written."
        raise StorageError(f"the folder cannot be made: {error.strerror}", where=str(folder), fix=fix) from error
    finally:  # where it is interrupted or fails, there is no part of a package that a second try would respect
        shutil.rmtree(unfinished, ignore_errors=True)
    return words["Class"]


def _filled(text: str, words: dict[str, str]) -> str:
    # Braces are Python's own in these texts, so that only the words themselves are replaced.
    return re.sub(r"\{(\w+)\}", lambda match: words.get(match[1], match[0]), text)
