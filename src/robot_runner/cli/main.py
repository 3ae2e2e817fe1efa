"""The program `robot-runner`."""

from __future__ import annotations

import os
import sys

from robot_runner.cli.commands import command_module, installed_commands, summary_of
from robot_runner.cli.guard import guarded

TYPE_CHECKING = False  # `typing` takes long to import, and `--help` is to be quick
if TYPE_CHECKING:
    from collections.abc import Sequence

#: Wide enough that nothing is folded where the output is not a terminal.
_UNLIMITED = 100_000


def main(argv: Sequence[str] | None = None) -> int:
    """Execute the command line, and return the exit code.

    0: all is done; 1: a run failed; 2: refused; 70: a fault of Robot Runner itself; 130: interrupted.

    Example:
        >>> main(["--help"])  # doctest: +ELLIPSIS
        Robot Runner executes measurement-based experiments on robotics software.
        ...
        0
    """
    words = list(sys.argv[1:] if argv is None else argv)
    code = guarded(lambda: _execute(words), show_traceback="--debug" in words)
    # Where a config was loaded, a thread or child process that it started may still be running.
    if argv is None and "robot_runner.core.config.loader" in sys.modules:
        from robot_runner.cli.timely_exit import leave_in_time  # noqa: PLC0415 - for a quick --help

        leave_in_time(code)
    return code


def _execute(words: list[str]) -> int:
    if "_ARGCOMPLETE" in os.environ:  # a shell asks what fits the line that is being typed
        from robot_runner.cli.commands.completion import complete  # noqa: PLC0415 - an extra

        complete()
    if words and words[0] == "help":
        words = [*words[1:], "--help"]
    if not words or words[0] in {"-h", "--help"}:  # answered before anything slow is imported
        print(overview())
        return 0
    if words[0] == "--version":
        print(f"robot-runner {_version()}")
        return 0
    command, rest = _command(words)
    point = installed_commands()[command]
    module = command_module(point)
    # The last thing that `main` needs, too: this package may be upgraded or gone by the end of an experiment.
    from robot_runner.cli import timely_exit  # noqa: F401, PLC0415 - for a quick --help
    from robot_runner.cli.parser import parser_of  # noqa: PLC0415 - for a quick --help

    try:
        arguments = point.called(lambda: parser_of(command, module)).parse(rest)
    except SystemExit as asked:  # argparse has printed the help that was asked for
        return int(asked.code or 0)
    return point.called(lambda: module.execute(arguments))


def overview() -> str:
    """Return the help of the program."""
    commands = installed_commands()
    width = max(map(len, commands), default=0)
    rows = [
        "Robot Runner executes measurement-based experiments on robotics software.",
        "",
        _row("robot-runner CONFIG.py       ", "execute the experiment that a file describes, or resume it"),
        _row("robot-runner COMMAND --help  ", "all about one command"),
        "",
        "Commands:",
        *(_row(name.ljust(width), summary_of(point)) for name, point in commands.items()),
        "",
        "Options:",
        "  -h, --help  Show this.",
        "  --version   Show the version.",
        "",
        "New here? `robot-runner demo` fills a run table in under a minute, on a simulated robot.",
    ]
    return "\n".join(line if line.startswith(" ") else "\n".join(_lines(line, _width())) for line in rows)


def _row(name: str, summary: str) -> str:
    """Return a command and its summary, which wraps beneath itself if the terminal is too narrow."""
    head = f"  {name}  "
    return head + f"\n{' ' * len(head)}".join(_lines(summary, _width() - len(head)))


def _lines(text: str, width: int) -> list[str]:
    # Like `textwrap.wrap`, whose import takes longer than printing this whole help.
    lines = [""]
    for word in text.split(" "):
        if lines[-1] and len(lines[-1]) + 1 + len(word) > width:
            lines.append(word)
        else:
            lines[-1] = f"{lines[-1]} {word}".lstrip()
    return lines


def _width() -> int:
    """Return how many cells a line of the terminal has; no limit where there is none."""
    try:
        return os.get_terminal_size(sys.stdout.fileno()).columns or _UNLIMITED
    except (OSError, ValueError):  # no terminal
        return _UNLIMITED


#: How similar a slip of the pen is to the option that was meant, of 1.
_SLIP = 0.8


def _command(words: list[str]) -> tuple[str, list[str]]:
    """Return the command and its words; a config file alone is executed.

    Raises:
        UsageError: there is no such command or option.
    """
    first = words[0]
    commands = installed_commands()
    if first in commands:
        return first, words[1:]
    from robot_runner.cli.parser import UsageError, unknown_command, unknown_option  # noqa: PLC0415 - for a quick --help
    from robot_runner.core.errors import nearest  # noqa: PLC0415 - as above

    if first.startswith("-"):
        own = ["--help", "--version"]
        is_own = nearest(first, own, _SLIP) is not None  # `--json` resembles `--version`, too
        if not is_own and any(each in commands or each.endswith(".py") for each in words[1:]):
            fix = "Put options behind the command or the config file."
            raise UsageError(f"{first!r} stands before what it is for", where="robot-runner", fix=fix)
        raise unknown_option(first, own, where="robot-runner")
    if first.endswith(".py") or "/" in first or os.path.exists(first):  # noqa: PTH110 - false of a name too long, too
        return "run", words
    raise unknown_command(first, commands)


def _version() -> str:
    from importlib.metadata import version  # noqa: PLC0415 - for a quick --help

    return version("robot-runner")
