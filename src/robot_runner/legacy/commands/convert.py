"""Write a config of an earlier tool in our own spelling.

The earlier tools are Experiment Runner and the first versions of Robot Runner. The old file stays as it is. The new one
is loaded, and its run table compared with that of the old one.

Exit code 0: both plan the same runs; 2: the old file is refused, or the new one has to be mended by hand.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.cli.console import command_line, output, print_facts, quiet_loading, shown_path
from robot_runner.cli.findings import print_findings, show_findings
from robot_runner.cli.guard import REFUSED
from robot_runner.cli.parser import UsageError, add_config
from robot_runner.cli.templating import write_new_file
from robot_runner.core.words import counted
from robot_runner.legacy.conversion.converting import check_conversion, convert

if TYPE_CHECKING:
    from argparse import Namespace

    from robot_runner.cli.parser import Parser

__all__ = ["add_arguments", "execute"]


def add_arguments(parser: Parser) -> None:
    """Add what the command takes."""
    add_config(parser)
    parser.add_argument(
        "--out",
        metavar="FILE",
        help="the file to write (beside the old one, with _converted in its name, if left out); never overwritten",
    )


def execute(arguments: Namespace) -> int:
    """Write the config in our own spelling."""
    old = Path(arguments.config)
    new = Path(arguments.out) if arguments.out else old.with_name(f"{old.stem}_converted.py")
    if new.suffix != ".py":
        raise UsageError("a config is a Python file", where=str(new), fix=f"Name it {new.name}.py.")
    with quiet_loading():
        conversion = convert(old)
        write_new_file(new, conversion.text, instead="Choose another name: --out NAME.py")
        for name, text in conversion.beside.items():
            write_new_file(new.with_name(name), text, instead="Convert into a folder of its own: --out FOLDER/NAME.py")
        findings = check_conversion(conversion, new)
    console = output()
    if any(finding.is_error for finding in findings):
        show_findings(findings)
        console.tell(f"{shown_path(new)} is written, and has to be mended by hand.")
        return REFUSED
    print_findings(console, (*conversion.findings, *findings))
    runs = counted(len(conversion.before.model.plan()), "run")
    console.tell(f"{shown_path(new)} is written: it plans the same {runs}.")
    print_facts(
        console,
        [
            ("Beside it", ", ".join(conversion.beside)),
            ("Check", command_line("check", str(new))),
            ("Execute", command_line(str(new))),
        ],
    )
    return 0
