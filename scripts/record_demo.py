"""Draw the last screen of a command as SVG: `record_demo.py picture.svg -- command ...`.

The command is executed in a pseudo-terminal, so it shows what it shows to a person.
"""

from __future__ import annotations

import argparse
import io
import itertools
import os
import re
import shutil
import sys
import tempfile
from pathlib import Path

import pexpect
import pyte
from rich.console import Console
from rich.style import Style
from rich.text import Text

_COLUMNS = 110
_LINES = 60
_DEADLINE = 600  # seconds
# A terminal's sixteen colours as pyte names them, where rich has another word for the same.
_RICH_COLOURS = {"brown": "yellow", "brightbrown": "bright_yellow"}


def main() -> int:
    """Record the command; return its exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", type=Path, help="the SVG file to write")
    parser.add_argument("command", nargs=argparse.REMAINDER, help="what to execute, after --")
    chosen = parser.parse_args()
    command = [word for word in chosen.command if word != "--"]
    if not command:
        parser.error("name the command to execute, after --")
    screen = pyte.Screen(_COLUMNS, _LINES)
    with tempfile.TemporaryDirectory() as folder:  # what an earlier demo left is not in the picture
        code = _play(command, screen, folder)
    lines = [_line(screen, row) for row in range(_LINES)]
    while lines and not lines[-1].plain.strip():
        lines.pop()
    title = " ".join([Path(command[0]).name, *command[1:]])
    chosen.picture.parent.mkdir(parents=True, exist_ok=True)
    chosen.picture.write_text(_drawn(lines, title), encoding="utf-8")
    print(f"{chosen.picture}: {len(lines)} lines of `{title}`, which ended with exit code {code}")
    return code


def _play(command: list[str], screen: pyte.Screen, folder: str) -> int:
    stream = pyte.Stream(screen)
    environment = {**os.environ, "TERM": "xterm-256color", "COLORTERM": "truecolor"}
    child = pexpect.spawn(
        str(Path(shutil.which(command[0]) or command[0]).absolute()),
        command[1:],
        cwd=folder,
        dimensions=(_LINES, _COLUMNS),
        encoding="utf-8",
        env=environment,
        timeout=_DEADLINE,
    )
    while (index := child.expect([r".+", pexpect.EOF, pexpect.TIMEOUT])) == 0:
        stream.feed(child.match.group())
    child.close(force=True)
    if index == 2:  # noqa: PLR2004 - the third of the patterns above
        print(f"It was not done after {_DEADLINE} s; the picture shows what there was.", file=sys.stderr)
        return 1
    return child.exitstatus or 0


def _line(screen: pyte.Screen, row: int) -> Text:
    line = Text(no_wrap=True)
    cells = [screen.buffer[row][column] for column in range(_COLUMNS)]
    for style, alike in itertools.groupby(cells, key=_style):
        line.append("".join(cell.data for cell in alike), style)
    line.rstrip()
    return line


def _style(cell: pyte.screens.Char) -> Style:
    return Style(
        color=_colour(cell.fg),
        bgcolor=_colour(cell.bg),
        bold=cell.bold,
        italic=cell.italics,
        underline=cell.underscore,
        reverse=cell.reverse,
    )


def _colour(name: str) -> str | None:
    if name == "default":
        return None
    if len(name) == len("rrggbb") and all(digit in "0123456789abcdef" for digit in name):
        return f"#{name}"
    name = _RICH_COLOURS.get(name, name)
    return name.replace("bright", "bright_") if name.startswith("bright") and "_" not in name else name


def _drawn(lines: list[Text], title: str) -> str:
    console = Console(width=_COLUMNS, record=True, file=io.StringIO(), force_terminal=True)
    for line in lines:
        console.print(line, highlight=False)
    # Whoever opens the picture need not fetch a font: a monospaced one of theirs does as well.
    return re.sub(r"@font-face \{.*?\}\s*", "", console.export_svg(title=title), flags=re.DOTALL)


if __name__ == "__main__":
    sys.exit(main())
