"""Show experiments in a browser while they are executed, also on a phone: see how far they are, answer, pause, stop.

The page works from the folder alone: when it ends, experiments go on as before. Open it by one of the links that are
printed.
"""

from __future__ import annotations

import os
import sys
from argparse import Namespace
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from rich.text import Text

from robot_runner.cli.console import output, print_facts, shown_path
from robot_runner.core.errors import StorageError, did_you_mean
from robot_runner.core.execution.processes import use_no_streams

if TYPE_CHECKING:
    from robot_runner.cli.parser import Parser
    from robot_runner.page.serving import Serving

PORT = 8642
_MOST_NAMES = 20
_NOT_ENCRYPTED = "the network can read along, keys included: use one that you trust, or an SSH tunnel"


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "folder",
        metavar="FOLDER",
        nargs="?",
        default=".",
        help="the folder of an experiment, or one with experiments below it; the present one where it is left out",
    )
    parser.add_argument(
        "--host",
        metavar="ADDRESS",
        default="127.0.0.1",
        help="where to listen: 0.0.0.0 for phones in the same network; 127.0.0.1, this machine alone, if left out",
    )
    parser.add_argument("--port", metavar="PORT", default=str(PORT), help=f"the port; {PORT} if left out")
    parser.add_argument(
        "--name",
        metavar="NAME",
        action="append",
        default=[],
        help="a further name by which browsers reach this machine; may be given several times",
    )
    parser.add_argument("--read-only", action="store_true", help="let everybody look, and nobody act")
    parser.add_argument(
        "--new-links", action="store_true", help="make all links and logins void that were given before"
    )
    parser.add_argument(
        "--until-closed", action="store_true", help="end once the standard input is closed, as `run --page` has it"
    )


def execute(arguments: Namespace) -> int:
    """Serve the page until Ctrl-C."""
    folder = _folder(arguments.folder, may_be_missing=arguments.until_closed)
    # Imported here, so that help and errors of other commands do without the extra.
    from robot_runner.page.serving import Serving  # noqa: PLC0415

    serving = Serving.opened(
        folder,
        arguments.host,
        arguments.port,
        names=arguments.name,
        is_read_only=arguments.read_only,
        has_new_links=arguments.new_links,
        is_one=arguments.until_closed,
    )
    _tell(serving, arguments)
    until_closed = None
    if arguments.until_closed:
        until_closed = os.fdopen(os.dup(0), "rb", buffering=0)
        use_no_streams()  # who started it reads no further
    with suppress(KeyboardInterrupt):
        serving.serve(until_closed)
    return 0


def _tell(serving: Serving, arguments: Namespace) -> None:
    """Print the links; after that, nothing more is printed."""
    from robot_runner.page.page_access import Role  # noqa: PLC0415

    best = Role.LOOKS if serving.is_read_only else Role.ACTS
    console, is_beyond = output(), serving.is_beyond_here
    elsewhere = serving.link(best, from_elsewhere=True)
    console.print(Text("Live page", style="bold"), Text(f"of {shown_path(serving.folder)}"))
    print_facts(
        console,
        [
            ("Here", serving.link(best)),
            ("Phone", elsewhere if is_beyond else ""),
            ("To look", serving.link(Role.LOOKS, from_elsewhere=is_beyond) if best is Role.ACTS else ""),
            ("Note", _NOT_ENCRYPTED if is_beyond else ""),
            ("End", "" if arguments.until_closed else "Ctrl-C; experiments go on"),
        ],
    )
    if is_beyond and sys.stdout.isatty():
        console.print(Text(serving.code(elsewhere)))
    sys.stdout.flush()


def _folder(given: str, *, may_be_missing: bool) -> Path:
    folder = Path(given).expanduser().resolve()
    if folder.is_dir() or may_be_missing:
        return folder
    if folder.exists():
        fix = "Name the folder of an experiment, or one above it."
        raise StorageError("this is not a folder", where=given, fix=fix)
    names = [each.name for each in folder.parent.iterdir() if each.is_dir()] if folder.parent.is_dir() else []
    fix = did_you_mean(folder.name, names) if 0 < len(names) < _MOST_NAMES else "Name a folder that is there."
    raise StorageError("there is no such folder", where=given, fix=fix)
