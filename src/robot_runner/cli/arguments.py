"""Arguments that several commands take."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robot_runner.cli.parser import Parser

__all__ = ["add_config", "add_json", "add_set", "add_target"]


def add_config(parser: Parser) -> None:
    """Add the config file."""
    parser.add_argument("config", metavar="CONFIG", help="the Python file that describes the experiment")


def add_target(parser: Parser) -> None:
    """Add an experiment, named by its folder or by its config file."""
    parser.add_argument(
        "target", metavar="EXPERIMENT", help="the folder of an experiment, or the config file that it comes from"
    )


def add_set(parser: Parser) -> None:
    """Add what takes the place of a value in the config."""
    parser.add_argument(
        "--set",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        help="set a static parameter of the config, such as robot=simulated; may be given several times",
    )


def add_json(parser: Parser) -> None:
    """Add the choice of JSON."""
    parser.add_argument("--json", action="store_true", help="print JSON, and nothing else, to stdout")
