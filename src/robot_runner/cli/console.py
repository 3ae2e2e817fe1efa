"""Consoles, plain and coloured; commands and paths to paste, facts in two columns, rows of a table."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import sys
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from rich.cells import cell_len, set_cell_size
from rich.console import Console, ConsoleOptions, RenderableType
from rich.control import Control
from rich.segment import ControlType, Segment
from rich.text import Text

from robot_runner.cli.byte_code import no_byte_code
from robot_runner.cli.harmless_stream import HarmlessStream, unguarded
from robot_runner.core.storage.declared_shapes import finite
from robot_runner.core.words import harmless, harmless_json, one_line

#: Wide enough that nothing is folded where the output is not a terminal.
_UNLIMITED = 100_000
_PROGRAM = "robot-runner"


class UserConsole(Console):
    """A rich console, coloured on a terminal, that shows text as it is: no markup, and no escape sequence but its own.

    Its `lines` are a stream for plain lines, which are made harmless, too.
    """

    def __init__(self, stream: TextIO) -> None:
        width = None if stream.isatty() else _UNLIMITED
        self.lines = HarmlessStream(stream)
        # Not through the stream that makes text harmless: it would show rich's colours as text.
        terminal = unguarded(stream)
        super().__init__(file=terminal, width=width, highlight=False, markup=False, emoji=False, soft_wrap=False)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterator[Segment]:
        """Yield the segments to write: everything that is printed passes through here."""
        for segment in super().render(renderable, options):
            if segment.control:
                yield segment
            else:
                # A link is an escape sequence, too, and its address is text from outside.
                style = segment.style.update_link(None) if segment.style and segment.style.link else segment.style
                yield segment._replace(text=harmless(segment.text), style=style)

    def tell(self, text: str, style: str = "") -> None:
        """Print a text; a long one is continued on the next line, and no word is broken."""
        for line in folded(text, self.width):
            self.print(Text(line, style=style), soft_wrap=True)

    def erase_line(self) -> None:
        """Erase the line that is being shown, and return to its beginning."""
        self.control(Control(ControlType.CARRIAGE_RETURN, (ControlType.ERASE_IN_LINE, 2)))

    def on_broken_pipe(self) -> None:
        """Leave it to the caller: a command may have more to do than to print.

        Raises:
            BrokenPipeError: the one that was raised.
        """
        raise  # noqa: PLE0704 - rich calls this while it handles the error


def output() -> UserConsole:
    """Return the console for results: stdout."""
    return UserConsole(sys.stdout)


def complaints() -> UserConsole:
    """Return the console for problems: stderr."""
    return UserConsole(sys.stderr)


def is_live_terminal(stream: TextIO) -> bool:
    """Whether a stream is a terminal on which lines can be redrawn."""
    return stream.isatty() and os.environ.get("TERM", "dumb") not in {"dumb", "unknown"}


def print_json(facts: Any) -> None:
    """Print facts as JSON, or a text that is JSON already; a number that JSON does not have becomes its name."""
    text = facts if isinstance(facts, str) else json.dumps(finite(facts), indent=2, ensure_ascii=False, default=str)
    print(harmless_json(text))


def shown_path(path: Path) -> str:
    """Return the shortest form of a path that works when it is pasted into a shell in the current folder.

    Example:
        >>> shown_path(Path.cwd() / "results")
        'results'
    """
    try:
        return str(path.relative_to(Path.cwd()))
    except (ValueError, OSError):
        return str(path)


def command_line(*words: str) -> str:
    """Return a command of Robot Runner that works when it is pasted into this shell, wherever the program is installed.

    Example:
        >>> command_line("check", "my study.py")
        "robot-runner check 'my study.py'"
    """
    program = Path(sys.argv[0])
    if program.parts[-2:] == ("robot_runner", "__main__.py"):  # as a queue executes it
        is_ours = is_on_path(Path(sys.executable).with_name(_PROGRAM))
        return shlex.join([_PROGRAM, *words] if is_ours else [sys.executable, "-m", "robot_runner", *words])
    is_found = program.name != _PROGRAM or is_on_path(program)
    return shlex.join([_PROGRAM if is_found else shown_path(program.absolute()), *words])


def is_on_path(program: Path) -> bool:
    """Whether a shell that is given the program's name finds this file."""
    found = shutil.which(_PROGRAM)
    return found is not None and Path(found).resolve() == program.resolve()


@contextmanager
def quiet_loading() -> Iterator[None]:
    """While a config is loaded, send output of its code to stderr, and write no byte code beside it."""
    with no_byte_code(), redirect_stdout(sys.stderr):
        yield


#: Of a folded text, in cells.
_NARROWEST = 20


def print_facts(console: UserConsole, facts: Iterable[tuple[str, str]], *, indent: int = 2) -> None:
    """Print facts, one a line; long ones are folded and indented, empty ones left out."""
    told = [(one_line(name), fact) for name, fact in facts if fact]
    names = max((len(name) for name, _ in told), default=0) + indent + 2
    for name, fact in told:
        print_folded(console, f"{' ' * indent}{name}".ljust(names), fact, style="bold")


def print_folded(console: UserConsole, head: str, text: str, *, style: str) -> None:
    """Print a text after a head in this style; the lines after the first are indented to its beginning."""
    first, *more = folded(text, console.width - len(head))
    console.print(Text(head, style=style).append(first, "not bold default"), soft_wrap=True)
    for line in more:
        console.print(Text(" " * len(head) + line), soft_wrap=True)


def folded(text: str, width: int) -> list[str]:
    """Return a text as lines of this width, indented alike; no word is broken: a path could not be pasted then.

    Example:
        >>> folded("  Press ENTER to go on", 20)
        ['  Press ENTER to go', '  on']
    """
    if len(text) <= width:
        return [text]
    indent = text[: len(text) - len(text.lstrip(" "))]
    width = max(_NARROWEST, width)
    return textwrap.wrap(text, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False) or [""]


_GAP = "  "
_WIDEST = 28
#: Of one treatment or measure in a sentence, in cells.
_LONGEST = 40


@dataclass(frozen=True, slots=True)
class Column:
    """One column of text.

    Attributes:
        width: in cells of a terminal.
        is_number: whether its cells stand to the right.

    Example:
        >>> aligned([Column("Task", 7), Column("Energy", 6, is_number=True)], ["Video", "877.1"])
        'Video     877.1'
    """

    heading: str
    width: int
    is_number: bool = False


def width_of(texts: Iterable[str]) -> int:
    """Return the width that a column needs for these texts, within reason."""
    return min(_WIDEST, max(map(cell_len, map(one_line, texts)), default=0))


def fitting(columns: Sequence[Column], width: int) -> int:
    """Return how many of the first columns fit beside each other; one at least."""
    used = 0
    for place, column in enumerate(columns):
        used += column.width + (len(_GAP) if place else 0)
        if used > width:
            return max(1, place)
    return len(columns)


def aligned(columns: Sequence[Column], cells: Sequence[str]) -> str:
    """Return a row as one line; a cell that is too long for its column ends in `…`."""
    parts = [_placed(column, one_line(cell)) for column, cell in zip(columns, cells, strict=False)]
    return _GAP.join(parts).rstrip()


def shortened(text: str, width: int = _LONGEST) -> str:
    """Return a text that takes at most so many cells of a terminal; its rest becomes `…`.

    Example:
        >>> shortened("a wide treatment", 7)
        'a wide…'
    """
    return text if cell_len(text) <= width else set_cell_size(text, width - 1) + "…"


def _placed(column: Column, cell: str) -> str:
    cell = shortened(cell, column.width)
    return f"{' ' * (column.width - cell_len(cell))}{cell}" if column.is_number else set_cell_size(cell, column.width)
