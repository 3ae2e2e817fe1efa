"""Say everything that is wrong with a config, and touch nothing; with --probe, try its profilers for a moment.

Each finding has its place and its fix. Exit code 0: the config can be executed; 2: it is refused.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from robot_runner.cli.console import UserConsole, output, print_facts, print_json, quiet_loading, shown_path
from robot_runner.cli.design_words import (
    columns_as_json,
    design_as_json,
    in_words,
    measures_in_words,
    order_in_words,
    warm_ups_in_words,
)
from robot_runner.cli.findings import as_json, print_findings, tally
from robot_runner.cli.guard import REFUSED
from robot_runner.cli.parser import Parser, add_config, add_json, add_set
from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.loader import parse_assignments
from robot_runner.core.config.preparation import Preparation, prepare
from robot_runner.core.design.batches import as_configured
from robot_runner.core.design.precision import rule_in_words
from robot_runner.core.errors import Finding, errors_first
from robot_runner.core.execution.before_first_run import folder_findings
from robot_runner.core.execution.probe import Probe, probe_experiment
from robot_runner.core.secret_names import shown_settings
from robot_runner.core.words import shown_value


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add_config(parser)
    add_set(parser)
    parser.add_argument(
        "--probe", action="store_true", help="also try each profiler for a moment; what moves is not touched"
    )
    add_json(parser)


def execute(arguments: Namespace) -> int:
    """Print all findings, and what is fine."""
    with quiet_loading():
        preparation = prepare(Path(arguments.config), parse_assignments(arguments.set))
        probe = probe_experiment(preparation.experiment) if arguments.probe and preparation.experiment else None
        if preparation.experiment is not None:
            of_probe = () if probe is None else probe.findings
            preparation = _judged(preparation, (*folder_findings(preparation.experiment), *of_probe))
    if arguments.json:
        print_json(_as_json(arguments.config, preparation, probe))
    else:
        _print(output(), arguments.config, preparation, probe)
    return 0 if preparation.experiment else REFUSED


def _judged(preparation: Preparation, found: Iterable[Finding]) -> Preparation:
    """Return the preparation with the findings on its folder and by the probe; an error refuses it."""
    findings = errors_first([*preparation.findings, *found])
    is_refused = any(finding.is_error for finding in findings)
    return Preparation(None if is_refused else preparation.experiment, tuple(findings))


def _print(console: UserConsole, config: str, preparation: Preparation, probe: Probe | None) -> None:
    print_findings(console, preparation.findings)
    experiment = preparation.experiment
    if experiment is None:
        console.tell(f"{config} is refused: {tally(preparation.findings)}.", style="bold")
        return
    found, files = experiment.registration, experiment.folder
    table = files.run_table if files.run_table.exists() and not files.manifest.exists() else None
    doubts = f", with {tally(preparation.findings)}" if preparation.findings else ""
    console.tell(f"{config} can be executed{doubts}.", style="bold")
    print_facts(
        console,
        [
            ("Experiment", experiment.parameters.experiment_name),
            ("Runs", in_words(experiment.model) if table is None else f"as in {shown_path(table)}, in its order"),
            ("Repeated", _repeated(experiment)),
            ("Intervals", _ASSUMED if experiment.parameters.repeat_until else ""),
            ("Order", order_in_words(experiment.model) if table is None else ""),
            ("Warm-up", warm_ups_in_words(experiment.model, experiment.model.plan())),
            ("Plugins", ", ".join(plugin.name for plugin in experiment.plugins) or "none"),
            ("Measures", measures_in_words(experiment.columns)),
            *_seen(probe),
            ("Robot", ", ".join(experiment.parameters.robots) or experiment.parameters.robot or "none"),
            ("Mode", experiment.parameters.operation_type.name),
            ("Registered", f"{found.registered_at}, SHA-256 {found.sha256}" if found else ""),
            ("Results", shown_path(experiment.folder.root)),
            ("Set", ", ".join(f"{name}={value}" for name, value in shown_settings(experiment.overrides).items())),
        ],
    )


#: What is to be known before an experiment is repeated until it is precise.
_ASSUMED = "hold at 95 % for values that are near to normal, in 88 to 95 % for skewed ones"


def _repeated(experiment: Experiment) -> str:
    """Return until when combinations are repeated, and how often at least and at most; empty where they are not."""
    return rule_in_words(experiment.parameters.repeat_until, as_configured(experiment.model).repetitions)


def _seen(probe: Probe | None) -> Iterator[tuple[str, str]]:
    """Yield the measures of each profiler during the probe, in words."""
    heading = "Probe"
    for profiler in probe.profilers if probe is not None else ():
        values = ", ".join(
            f"{name} {shown_value(each.value)} {each.unit}".rstrip() for name, each in profiler.measures.items()
        )
        yield heading, f"{profiler.label}: {values}"
        heading = ""
    if probe is not None and not probe.profilers:
        yield heading, "no profiler can be tried before the mission"


def _as_json(config: str, preparation: Preparation, probe: Probe | None) -> dict[str, Any]:
    experiment = preparation.experiment
    return {
        "config": config,
        "is_executable": experiment is not None,
        "findings": as_json(preparation.findings),
        "experiment": _experiment_as_json(experiment) if experiment else None,
        **({} if probe is None else {"probe": probe.fields()}),
    }


def _experiment_as_json(experiment: Experiment) -> dict[str, Any]:
    return {
        "name": experiment.parameters.experiment_name,
        "folder": str(experiment.folder.root),
        "robot": experiment.parameters.robot,
        "operation_type": experiment.parameters.operation_type.value,
        "plugins": [{"name": plugin.name, "class": type(plugin).__name__} for plugin in experiment.plugins],
        "measures": columns_as_json(experiment.columns),
        "set": shown_settings(experiment.overrides),
        "repeat_until": _repeated(experiment) or None,
        **design_as_json(experiment.model),
    }
