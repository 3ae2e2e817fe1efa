"""A few facts in two columns: what, and how it is."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

from rich.text import Text

if TYPE_CHECKING:
    from collections.abc import Iterable

    from robot_runner.cli.console import UserConsole

__all__ = ["print_facts", "print_folded"]

_NARROWEST = 20


def print_facts(console: UserConsole, facts: Iterable[tuple[str, str]], *, indent: int = 2) -> None:
    """Print facts beneath each other; long ones are folded beneath themselves, and empty ones left out."""
    told = [(name, fact) for name, fact in facts if fact]
    names = max((len(name) for name, _ in told), default=0) + indent + 2
    for name, fact in told:
        print_folded(console, f"{' ' * indent}{name}".ljust(names), fact, style="bold")


def print_folded(console: UserConsole, head: str, text: str, *, style: str) -> None:
    """Print a text after a head in this style; where it is folded, it goes on beneath itself."""
    # A path or a command that was broken could not be pasted.
    width = max(_NARROWEST, console.width - len(head))
    first, *more = textwrap.wrap(text, width, break_long_words=False, break_on_hyphens=False) or [""]
    console.print(Text(head, style=style).append(first, "not bold default"), soft_wrap=True)
    for line in more:
        console.print(Text(" " * len(head) + line), soft_wrap=True)
