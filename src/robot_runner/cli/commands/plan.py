"""Show the run table before anything is executed.

It has every run in its order, and tells what the order comes from.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.cli.console import output, print_facts, print_json, quiet_loading
from robot_runner.cli.design_layouts import print_layouts
from robot_runner.cli.design_words import (
    columns_as_json,
    design_as_json,
    design_in_words,
    in_words,
    measures_in_words,
    print_runs,
    run_as_json,
    warm_ups_in_words,
)
from robot_runner.cli.findings import as_json, show_findings
from robot_runner.cli.parser import add_config, add_json, add_set
from robot_runner.cli.planning import Plan, plan_of
from robot_runner.core.config.loader import parse_assignments
from robot_runner.core.words import counted, listed

if TYPE_CHECKING:
    from argparse import Namespace

    from robot_runner.cli.parser import Parser


def add_arguments(parser: Parser) -> None:
    """Add what the command takes."""
    add_config(parser)
    add_set(parser)
    parser.add_argument("--all", action="store_true", help="show every run of a long table")
    add_json(parser)


def execute(arguments: Namespace) -> int:
    """Print the run table as it would be executed now."""
    with quiet_loading():
        plan = plan_of(Path(arguments.config), parse_assignments(arguments.set))
    if arguments.json:
        print_json(_as_json(plan))
        return 0
    show_findings(plan.findings)
    console = output()
    print_runs(console, plan.model, plan.runs, shows_all=arguments.all)
    print_layouts(console, plan.model.design_facts, shows_all=arguments.all)
    console.print()
    print_facts(
        console,
        [
            ("Runs", in_words(plan.model) if plan.source is None else counted(len(plan.runs), "run")),
            *design_in_words(plan.model),
            ("Repeated", plan.repeated),
            ("Decided", str(plan.model.design_facts.get("decides", ""))),
            ("Warm-up", warm_ups_in_words(plan.model, plan.runs)),
            ("Measures", measures_in_words(plan.columns)),
            ("Order", plan.order),
            ("Excluded", listed(f"{run}: {reason}" for run, reason in plan.excluded.items())),
            ("To repeat", plan.how_to_repeat),
            ("Duration", str(plan.duration)),
        ],
    )
    return 0


def _as_json(plan: Plan) -> dict[str, object]:
    design = design_as_json(plan.model)
    design["order"]["seed"] = plan.seed
    return {
        **design,
        "run_count": len(plan.runs),
        "seed_is_given": plan.model.seed_is_given,
        "is_begun": plan.is_recorded,
        "executed": list(plan.executed),
        "excluded": dict(plan.excluded),
        "repeat_until": plan.repeated or None,
        "decides": plan.model.design_facts.get("decides"),
        "run_table": str(plan.source) if plan.source else None,
        "measures": columns_as_json(plan.columns),
        "duration": asdict(plan.duration),
        "runs": list(map(run_as_json, plan.runs)),
        "findings": as_json(plan.findings),
    }
