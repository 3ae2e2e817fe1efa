"""Say everything that is wrong with a config, and touch nothing.

Each finding has its place and its fix. Exit code 0: the config can be executed; 2: it is refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.cli.console import UserConsole, output, print_facts, print_json, quiet_loading, shown_path
from robot_runner.cli.design_words import columns_as_json, design_as_json, in_words, measures_in_words, order_in_words
from robot_runner.cli.findings import as_json, print_findings, tally
from robot_runner.cli.guard import REFUSED
from robot_runner.cli.parser import add_config, add_json, add_set
from robot_runner.core.config.dialects import prepare
from robot_runner.core.config.loader import parse_assignments

if TYPE_CHECKING:
    from argparse import Namespace

    from robot_runner.cli.parser import Parser
    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.config.preparation import Preparation

__all__ = ["add_arguments", "execute"]


def add_arguments(parser: Parser) -> None:
    """Add what the command takes."""
    add_config(parser)
    add_set(parser)
    add_json(parser)


def execute(arguments: Namespace) -> int:
    """Print all findings, and what is fine."""
    with quiet_loading():
        preparation = prepare(Path(arguments.config), parse_assignments(arguments.set))
    if arguments.json:
        print_json(_as_json(arguments.config, preparation))
    else:
        _print(output(), arguments.config, preparation)
    return 0 if preparation.experiment else REFUSED


def _print(console: UserConsole, config: str, preparation: Preparation) -> None:
    print_findings(console, preparation.findings)
    experiment = preparation.experiment
    if experiment is None:
        console.print(f"{config} is refused: {tally(preparation.findings)}.", style="bold", soft_wrap=True)
        return
    doubts = f", with {tally(preparation.findings)}" if preparation.findings else ""
    console.print(f"{config} can be executed{doubts}.", style="bold", soft_wrap=True)
    print_facts(
        console,
        [
            ("Experiment", experiment.parameters.experiment_name),
            ("Runs", in_words(experiment.model)),
            ("Order", order_in_words(experiment.model)),
            ("Plugins", ", ".join(plugin.name for plugin in experiment.plugins) or "none"),
            ("Measures", measures_in_words(experiment.columns)),
            ("Robot", experiment.parameters.robot or "none"),
            ("Mode", experiment.parameters.operation_type.name),
            ("Results", shown_path(experiment.folder.root)),
            ("Set", ", ".join(f"{name}={value}" for name, value in experiment.overrides.items())),
        ],
    )


def _as_json(config: str, preparation: Preparation) -> dict[str, Any]:
    experiment = preparation.experiment
    return {
        "config": config,
        "is_executable": experiment is not None,
        "findings": as_json(preparation.findings),
        "experiment": _experiment_as_json(experiment) if experiment else None,
    }


def _experiment_as_json(experiment: Experiment) -> dict[str, Any]:
    return {
        "name": experiment.parameters.experiment_name,
        "folder": str(experiment.folder.root),
        "robot": experiment.parameters.robot,
        "operation_type": experiment.parameters.operation_type.value,
        "plugins": [{"name": plugin.name, "class": type(plugin).__name__} for plugin in experiment.plugins],
        "measures": columns_as_json(experiment.columns),
        "set": dict(experiment.overrides),
        **design_as_json(experiment.model),
    }
