"""Print what lets bash or zsh complete robot-runner: commands, options, config files, plugins.

Add one line to ~/.bashrc or ~/.zshrc, after compinit in the latter:

    eval "$(robot-runner completion bash)"
    eval "$(robot-runner completion zsh)"
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from robot_runner.cli.completing import shell_code

if TYPE_CHECKING:
    from argparse import Namespace

    from robot_runner.cli.parser import Parser

__all__ = ["add_arguments", "execute"]


def add_arguments(parser: Parser) -> None:
    """Add what the command takes."""
    parser.add_argument("shell", metavar="SHELL", choices=["bash", "zsh"], help="bash or zsh")


def execute(arguments: Namespace) -> int:
    """Print it."""
    sys.stdout.write(f"{shell_code(arguments.shell).strip()}\n")
    return 0
