"""Print what lets bash, zsh or fish complete robot-runner: commands, options, config files, plugins.

Add one line to ~/.bashrc, to ~/.zshrc (after compinit), or to ~/.config/fish/config.fish:

    eval "$(robot-runner completion bash)"
    eval "$(robot-runner completion zsh)"
    robot-runner completion fish | source
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from robot_runner.cli.completing import shell_code

if TYPE_CHECKING:
    from argparse import Namespace

    from robot_runner.cli.parser import Parser


def add_arguments(parser: Parser) -> None:
    """Add what the command takes."""
    parser.add_argument("shell", metavar="SHELL", choices=["bash", "zsh", "fish"], help="bash, zsh or fish")


def execute(arguments: Namespace) -> int:
    """Print it."""
    sys.stdout.write(f"{shell_code(arguments.shell).strip()}\n")
    return 0
