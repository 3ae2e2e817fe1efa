"""Write a commented config that runs as it is, or the package of a plugin of your own, with its tests.

The config describes a short experiment on the embedded robot, the plugin measures or drives something, to be changed:

    robot-runner new study.py
    robot-runner new --plugin profiler my_meter
"""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.cli.console import command_line, output, print_facts
from robot_runner.cli.parser import UsageError
from robot_runner.cli.plugin_package import write_plugin_package
from robot_runner.cli.templating import template, write_new_file

if TYPE_CHECKING:
    from argparse import Namespace

    from robot_runner.cli.parser import Parser

#: The folder that each kind is written to where none is named.
_PLUGINS = {"profiler": "my_meter", "system": "my_robot"}


def add_arguments(parser: Parser) -> None:
    """Add what the command takes."""
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
        raise UsageError("a config is a Python file", where=name, fix=f"Name it {path.name}.py.")
    text = template("new_config.py").replace("{file}", _in_text(path.name))
    write_new_file(path, text, instead="Choose another name: robot-runner new NAME.py")
    console = output()
    console.tell(f"{name} is written: 6 runs on the embedded robot, ready to be executed.")
    print_facts(
        console,
        [
            ("Check", command_line("check", name)),
            ("Plan", command_line("plan", name)),
            ("Execute", command_line(name)),
        ],
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
        console,
        [
            ("Try", command_line("try", str(folder / f"{module}.py"), *robot)),
            ("Install", pip),
            ("Test", test),
        ],
    )
    return 0
