"""Say what is installed here, which extras, links, meters and devices can be used, and how to get the others.

Nothing is changed, and nothing moves. Exit code 0: whatever is here can be used; 1: something that is here cannot, such
as a serial line that belongs to a group which is not yours.
"""

from __future__ import annotations

from dataclasses import asdict
from itertools import groupby
from typing import TYPE_CHECKING

from rich.text import Text

from robot_runner.cli.console import output, print_folded, print_json
from robot_runner.cli.diagnosing import ABSENT, BROKEN, READY, asked, questions
from robot_runner.cli.guard import SOME_FAILED
from robot_runner.cli.parser import add_json
from robot_runner.core.words import one_line

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Sequence

    from robot_runner.cli.console import UserConsole
    from robot_runner.cli.diagnosing import Diagnosis
    from robot_runner.cli.parser import Parser

#: All of it together, s: a driver that is well answers in a moment.
_DEADLINE_S = 20.0
_MARKS = {READY: ("✓", "green"), ABSENT: ("○", "dim"), BROKEN: ("✗", "bold red")}


def add_arguments(parser: Parser) -> None:
    """Add what the command takes."""
    add_json(parser)


def execute(arguments: Namespace) -> int:
    """Ask about everything, and tell it."""
    found = list(asked(questions(), deadline_s=_DEADLINE_S))
    if arguments.json:
        print_json({"found": [asdict(each) for each in found]})
    else:
        _print(output(), found)
    return SOME_FAILED if any(each.state == BROKEN for each in found) else 0


def _print(console: UserConsole, found: Sequence[Diagnosis]) -> None:
    for area, several in groupby(found, key=lambda each: each.area):
        console.print(Text(area, style="bold underline"))
        told = list(several)
        width = max(len(each.name) for each in told)
        for each in told:
            mark, style = _MARKS[each.state]
            print_folded(console, f"  {mark} {each.name.ljust(width)}  ", one_line(each.detail), style=style)
            if each.fix:
                print_folded(console, " " * (width + 6), one_line(each.fix), style="")
    broken = [each.name for each in found if each.state == BROKEN]
    verdict = f"To be mended: {', '.join(broken)}." if broken else "Whatever is here can be used."
    console.tell(verdict, style="bold red" if broken else "bold green")
