"""Set up this machine for measuring, or restore its previous settings.

Without options it shows how the machine is set up. Settings stay until `robot-runner tune --restore`, which also
restores what a killed experiment left. To have an experiment set up its machine and restore it automatically, list the
plugin Tune in its config.
"""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from robot_runner.cli.parser import Parser, UsageError
from robot_runner.core.errors import ConfigError, ExecutionError
from robot_runner.meters.machine.tuning import Machine, Wishes


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--governor", metavar="NAME", help="who chooses the frequency of the processor")
    parser.add_argument("--turbo", choices=("on", "off"), help="whether it may exceed its nominal frequency")
    parser.add_argument("--drop-caches", action="store_true", help="have the kernel forget what it keeps of files")
    parser.add_argument("--restore", action="store_true", help="put the machine back as it was")
    parser.add_argument(
        "--root",
        metavar="FOLDER",
        type=Path,
        default=Path("/"),
        help="a folder with a copy of proc and sys, to try it on",
    )


def execute(arguments: Namespace) -> int:
    """Show, set or restore the setup of this machine."""
    machine = Machine(arguments.root)
    turbo = None if arguments.turbo is None else arguments.turbo == "on"
    wishes = Wishes(arguments.governor, turbo, drops_caches=arguments.drop_caches)
    if arguments.restore:
        if wishes != Wishes():
            raise UsageError("--restore and settings cannot go together")
        _restore(machine)
    elif wishes != Wishes():
        _set(machine, wishes)
    for name, value in machine.describe().items():
        print(f"{name}: {value}")
    return 0


def _set(machine: Machine, wishes: Wishes) -> None:
    ConfigError.refuse(finding for finding in machine.findings("this machine", wishes) if finding.is_error)
    if wishes.governor is not None or wishes.turbo is not None:
        machine.apply(wishes, owner=None)
    if wishes.drops_caches:
        machine.drop_caches()


def _restore(machine: Machine) -> None:
    if machine.in_use_by is not None:
        fix = "Wait until it has ended: it puts the machine back itself."
        raise ExecutionError("an experiment that goes on has set the machine up", where=str(machine.state), fix=fix)
    problems = machine.restore()
    if problems:
        raise ExecutionError("; ".join(problems), where="this machine", fix="Set it by hand.")
