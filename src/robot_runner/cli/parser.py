"""The parser of a command, its errors for unknown words, and the arguments that several commands take."""

from __future__ import annotations

import argparse
import os
import textwrap
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any, NoReturn, Protocol

from robot_runner.core.errors import RobotRunnerError, did_you_mean, nearest
from robot_runner.core.words import enumerated


class UsageError(RobotRunnerError):
    """Words that the command line does not understand."""


class _Folding(argparse.RawDescriptionHelpFormatter):
    """Folds the paragraphs of a description to the terminal; indented lines, such as examples, stay as they are."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        del indent  # of groups, which have no description here
        paragraphs = text.strip().split("\n\n")
        return "\n\n".join(
            each if each.startswith(" ") else textwrap.fill(each, width, break_long_words=False, break_on_hyphens=False)
            for each in paragraphs
        )


class Parser(argparse.ArgumentParser):
    """The parser of one command: raises instead of exiting, and names the option that was meant.

    Attributes:
        documented: everything that the command takes, in order, as the documentation shows it.

    Example:
        >>> parser = Parser("check", "Say what is wrong.")
        >>> _ = parser.add_argument("--json", action="store_true")
        >>> parser.parse(["--json"]).json
        True
    """

    def __init__(self, command: str, description: str) -> None:
        self.documented: list[argparse.Action] = []
        super().__init__(
            prog=f"robot-runner {command}", description=description, allow_abbrev=False, formatter_class=_Folding
        )
        self.color = False  # Python 3.14 and later would write escape sequences, which are shown as text here

    def add_argument(
        self, *names: Any, completer: Callable[..., Iterable[str]] | None = None, **settings: Any
    ) -> argparse.Action:
        """Add an argument, and remember it for the documentation.

        `completer` is what a shell offers at TAB, as argcomplete calls it; files if it is left out.
        """
        action: Any = super().add_argument(*names, **settings)
        if completer is not None:
            action.completer = completer
        self.documented.append(action)
        return action  # type: ignore[no-any-return]

    def add_several(self, option: str, metavar: str, meaning: str, **settings: Any) -> None:
        """Add an option that may be given several times; it is parsed to a list, in order."""
        explained = f"{meaning}; may be given several times"
        self.add_argument(option, metavar=metavar, action="append", default=[], help=explained, **settings)

    def parse(self, words: Sequence[str]) -> argparse.Namespace:
        """Return the parsed words.

        Raises:
            UsageError: there is no such option, one lacks its value, or there are too many words.
            SystemExit: help was asked for, and printed.
        """
        arguments, unknown = self.parse_known_args(list(words))
        if not unknown:
            return arguments
        if unknown[0].startswith("-"):
            options = [name for action in self.documented for name in action.option_strings if name.startswith("--")]
            if "--" in words and unknown[0].partition("=")[0] in options:
                problem = f"{unknown[0]!r} stands behind '--', where nothing is an option"
                raise UsageError(problem, where=self.prog, fix="Leave '--' out, or put it behind all options.")
            raise unknown_option(unknown[0], options, where=self.prog)
        behind = zip(("", "", *words), ("", *words), words, strict=False)
        is_value = any(
            each == unknown[0] and (option == "--set" or pair.startswith("--set=")) for option, pair, each in behind
        )
        fix = "Write --set name=value without blanks, or put it in quotes." if is_value else self._help_fix
        raise UsageError(f"{unknown[0]!r} is one word too many", where=self.prog, fix=fix)

    def error(self, message: str) -> NoReturn:
        """Raise a complaint of argparse as a `UsageError`."""
        missing = message.removeprefix("the following arguments are required: ")
        are = "are" if ", " in missing else "is"
        problem = message if missing == message else f"{enumerated(missing.split(', '))} {are} missing"
        raise UsageError(problem, where=self.prog, fix=self._help_fix)

    @property
    def _help_fix(self) -> str:
        return f"See `{self.prog} --help`."


class CommandModule(Protocol):
    """The module of a command."""

    def add_arguments(self, parser: Parser) -> None:
        """Add the command's arguments."""

    def execute(self, arguments: argparse.Namespace) -> int:
        """Execute the command, and return the exit code."""


def parser_of(command: str, module: CommandModule) -> Parser:
    """Return the parser of a command, with the arguments that its module adds."""
    parser = Parser(command, module.__doc__ or "")
    module.add_arguments(parser)
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    return parser


#: Commands of the earlier tools, and what to do here.
_EARLIER_COMMANDS = {
    "config-create": "Write one with `robot-runner new experiment.py`.",
    "prepare": "Nothing has to be prepared. What is missing here, `robot-runner doctor` says.",
}


def unknown_command(word: str, known: Collection[str]) -> UsageError:
    """Return the error that names the command that was meant, or all of them."""
    if word in _EARLIER_COMMANDS:
        problem = f"{word!r} is a command of the earlier tools"
        return UsageError(problem, where="robot-runner", fix=_EARLIER_COMMANDS[word])
    near = f"{word}.py" if os.path.exists(f"{word}.py") else nearest(word, [*known, "--version"])  # noqa: PTH110 - false of any text
    fix = f"Did you mean {near!r}?" if near else f"Choose one of: {', '.join(known)}; or name a config file (.py)."
    return UsageError(f"there is no command {word!r}", where="robot-runner", fix=fix)


def unknown_option(word: str, known: Iterable[str], *, where: str) -> UsageError:
    """Return the error that names the option that was meant, or all of them."""
    name = word.partition("=")[0]
    return UsageError(f"there is no option {name!r}", where=where, fix=did_you_mean(name, known))


def add_config(parser: Parser) -> None:
    """Add the config file."""
    parser.add_argument("config", metavar="CONFIG", help="the Python file that describes the experiment")


def add_target(parser: Parser, *, is_the_only_one: bool = False) -> None:
    """Add an experiment, named by its folder or by its config file.

    With `is_the_only_one` it may be left out where there is only one experiment (`only_experiment`).
    """
    left_out = "; the only experiment here, or at most two folders below, where it is left out"
    parser.add_argument(
        "target",
        metavar="EXPERIMENT",
        nargs="?" if is_the_only_one else None,
        help=f"the folder of an experiment, or the config file that it comes from{left_out if is_the_only_one else ''}",
    )


def add_set(parser: Parser) -> None:
    """Add the option that replaces a value of the config."""
    meaning = "set a static parameter of the config, such as robot=simulated"
    parser.add_several("--set", "NAME=VALUE", meaning, completer=_assignments)


def _assignments(prefix: str, **_: Any) -> list[str]:
    from robot_runner.core.config.parameters import PARAMETERS  # noqa: PLC0415 - for who presses TAB alone
    from robot_runner.core.links.kinds import installed_links  # noqa: PLC0415 - as above

    links = [f"robot={link}" for link in installed_links()]
    return [each for each in [*links, *(f"{name}=" for name in PARAMETERS)] if each.startswith(prefix)]


#: How runs are named on the command line.
RUNS_HELP = "ids and treatments, such as r_1,r_2 or Task=Video,Speed=0.2"


def add_runs(parser: Parser) -> None:
    """Add the runs that are meant."""
    parser.add_argument("runs", metavar="RUNS", nargs="+", help=f"the runs: {RUNS_HELP}")


def add_json(parser: Parser) -> None:
    """Add the choice of JSON."""
    parser.add_argument("--json", action="store_true", help="print JSON, and nothing else, to stdout")
