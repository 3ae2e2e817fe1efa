"""Print what lets bash, zsh or fish complete robot-runner: commands, options, config files, plugins.

Add one line to ~/.bashrc, to ~/.zshrc (after compinit), or to ~/.config/fish/config.fish:

    eval "$(robot-runner completion bash)"
    eval "$(robot-runner completion zsh)"
    robot-runner completion fish | source
"""

from __future__ import annotations

import os
import sys
from argparse import Namespace
from collections.abc import Sequence
from typing import Any

from robot_runner.cli.commands import command_module, installed_commands, summary_of
from robot_runner.cli.parser import Parser, UsageError, parser_of


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    parser.add_argument("shell", metavar="SHELL", choices=["bash", "zsh", "fish"], help="bash, zsh or fish")


def execute(arguments: Namespace) -> int:
    """Print it."""
    sys.stdout.write(f"{shell_code(arguments.shell).strip()}\n")
    return 0


# What a shell offers at TAB, by argcomplete: the shell calls the program itself, with `_ARGCOMPLETE` set. Only the
# module of the command that stands in the line is imported: a TAB costs about what `--help` of that command costs.

#: How argcomplete is told where the words of the parser begin: after the program, or after program and command.
_START = "_ARGCOMPLETE"
_CONFIG = "run"


def complete() -> None:
    """Write the completions of the line that is being typed to the shell, and end the process."""
    argcomplete = _library()
    from argcomplete.lexers import split_line  # noqa: PLC0415 - an extra

    _, _, _, words, _ = split_line(os.environ["COMP_LINE"], int(os.environ["COMP_POINT"]))
    argcomplete.autocomplete(_parser_for(words[1:]), always_complete_options="long")


def shell_code(shell: str) -> str:
    """Return the code by which a shell completes `robot-runner`, to be executed once.

    Raises:
        UsageError: argcomplete is not installed.
    """
    return str(_library().shellcode(["robot-runner"], shell=shell))


def _library() -> Any:
    try:
        import argcomplete  # noqa: PLC0415 - an extra
    except ImportError as error:
        fix = "Install it: pip install 'robot-runner[completion]'."
        raise UsageError("argcomplete cannot be imported", where="completion", fix=fix) from error
    return argcomplete


def _parser_for(words: Sequence[str]) -> Parser:
    """Return the parser of the command that the line names; before it names one, the parser of all."""
    commands = installed_commands()
    if words and words[0] in commands:
        os.environ[_START] = "2"
        return parser_of(words[0], command_module(commands[words[0]]))
    if words:  # a config file alone is executed
        return parser_of(_CONFIG, command_module(commands[_CONFIG]))
    parser = Parser("", "")
    action: Any = parser.add_argument("command")
    parser.add_argument("--version", action="store_true", help="show the version")
    action.completer = _commands_and_configs
    return parser


def _commands_and_configs(prefix: str, **_: Any) -> dict[str, str]:
    from argcomplete.completers import FilesCompleter  # noqa: PLC0415 - an extra

    commands = {name: summary_of(point) for name, point in installed_commands().items() if name.startswith(prefix)}
    return commands | dict.fromkeys(FilesCompleter(("py",))(prefix), "a config file, or a folder")
