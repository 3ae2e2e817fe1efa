"""Show the run table before anything is executed.

It has every run in its order, and tells what the order comes from.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from rich.cells import cell_len

from robot_runner.cli import design_words
from robot_runner.cli.console import (
    Column,
    UserConsole,
    aligned,
    output,
    print_facts,
    print_json,
    quiet_loading,
    width_of,
)
from robot_runner.cli.findings import as_json, show_findings
from robot_runner.cli.parser import Parser, add_config, add_json, add_set
from robot_runner.cli.planning import Plan, plan_of
from robot_runner.core.config.loader import parse_assignments
from robot_runner.core.words import counted, listed, one_line


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
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
    design_words.print_runs(console, plan.model, plan.runs, shows_all=arguments.all)
    _print_layouts(console, plan.model.design_facts, shows_all=arguments.all)
    console.print()
    print_facts(
        console,
        [
            ("Runs", design_words.in_words(plan.model) if plan.source is None else counted(len(plan.runs), "run")),
            *design_words.design_in_words(plan.model),
            ("Repeated", plan.repeated),
            ("Decided", str(plan.model.design_facts.get("decides", ""))),
            ("Warm-up", design_words.warm_ups_in_words(plan.model, plan.runs)),
            ("Measures", design_words.measures_in_words(plan.columns)),
            ("Order", plan.order),
            ("Excluded", listed(f"{run}: {reason}" for run, reason in plan.excluded.items())),
            ("To repeat", plan.how_to_repeat),
            ("Duration", str(plan.duration)),
        ],
    )
    return 0


def _as_json(plan: Plan) -> dict[str, object]:
    design = design_words.design_as_json(plan.model)
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
        "measures": design_words.columns_as_json(plan.columns),
        "duration": asdict(plan.duration),
        "runs": list(map(design_words.run_as_json, plan.runs)),
        "findings": as_json(plan.findings),
    }


#: More tables than this, and more rows of one, are left to `--json`, where not all are asked for.
_MOST_TABLES = 4
_MOST_ROWS = 40


def _print_layouts(console: UserConsole, facts: Mapping[str, Any], *, shows_all: bool) -> None:
    """Print the squares, sequences, whole plots or blocks of a design, which it has as tables among its facts."""
    layouts = facts.get("layout", ())
    shown = layouts if shows_all else layouts[:_MOST_TABLES]
    for layout in shown:
        console.print()
        console.print(layout["title"], style="bold", markup=False)
        _print_table(console, [layout["heading"], *layout["rows"]], shows_all=shows_all)
    if len(shown) < len(layouts):
        console.print(f"… {counted(len(layouts) - len(shown), 'table')} more: --all shows them …", style="dim")


def _print_table(console: UserConsole, rows: Sequence[Sequence[str]], *, shows_all: bool) -> None:
    """Print rows, the first of which is the heading."""
    columns = [Column(str(cells[0]), width_of(list(cells))) for cells in zip(*rows, strict=True)]
    widest = max(cell_len(one_line(row[-1])) for row in rows)
    columns[-1] = replace(columns[-1], width=widest)  # nothing beside it needs the room
    shown = rows if shows_all else rows[: _MOST_ROWS + 1]
    for place, row in enumerate(shown):
        console.print(aligned(columns, row), style="dim" if not place else None, soft_wrap=True, markup=False)
    if len(shown) < len(rows):
        console.print(f"… {counted(len(rows) - len(shown), 'row')} more: --all shows them …", style="dim")
