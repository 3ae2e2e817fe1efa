"""Write a commented config that runs as it is.

It describes a short experiment on the embedded robot, to be changed.
"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.cli.console import output, print_facts
from robot_runner.cli.parser import UsageError
from robot_runner.cli.templating import template, write_new_file

if TYPE_CHECKING:
    from argparse import Namespace

    from robot_runner.cli.parser import Parser

__all__ = ["add_arguments", "execute"]


def add_arguments(parser: Parser) -> None:
    """Add what the command takes."""
    parser.add_argument(
        "file",
        metavar="FILE",
        nargs="?",
        default="experiment.py",
        help="the file to write (experiment.py if it is left out); an existing file is never overwritten",
    )


def execute(arguments: Namespace) -> int:
    """Write the config."""
    path = Path(arguments.file)
    if path.suffix != ".py":
        raise UsageError("a config is a Python file", where=arguments.file, fix=f"Name it {path.name}.py.")
    name = shlex.quote(arguments.file)
    text = template("new").replace("{file}", path.name)
    write_new_file(path, text, instead="Choose another name: robot-runner new NAME.py")
    console = output()
    console.tell(f"{arguments.file} is written: 6 runs on the embedded robot, ready to be executed.")
    print_facts(
        console,
        [
            ("Check", f"robot-runner check {name}"),
            ("Plan", f"robot-runner plan {name}"),
            ("Execute", f"robot-runner {name}"),
        ],
    )
    return 0
