"""Show the run table before anything is executed.

It has every run in its order, and tells what the order comes from.
"""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.cli.console import (
    Column,
    UserConsole,
    aligned,
    fitting,
    output,
    print_facts,
    print_json,
    quiet_loading,
)
from robot_runner.cli.design_words import (
    columns_as_json,
    design_as_json,
    in_words,
    measures_in_words,
    run_as_json,
    run_cells,
    run_columns,
)
from robot_runner.cli.findings import show_findings
from robot_runner.cli.parser import add_config, add_json, add_set
from robot_runner.cli.planning import Plan, plan_of
from robot_runner.core.config.loader import parse_assignments
from robot_runner.core.words import counted, listed

if TYPE_CHECKING:
    from argparse import Namespace

    from robot_runner.cli.parser import Parser
    from robot_runner.core.design.planned_runs import PlannedRun
    from robot_runner.core.design.run_table_model import RunTableModel

__all__ = ["add_arguments", "execute"]

#: A table of more runs than this is abbreviated on a terminal.
_LONG = 40
_FIRST, _LAST = 20, 5


def add_arguments(parser: Parser) -> None:
    """Add what the command takes."""
    add_config(parser)
    add_set(parser)
    parser.add_argument("--all", action="store_true", help="show every run of a long table on a terminal, too")
    add_json(parser)


def execute(arguments: Namespace) -> int:
    """Print the run table as it would be executed now."""
    with quiet_loading():
        plan = plan_of(Path(arguments.config), parse_assignments(arguments.set))
    if arguments.json:
        print_json(_as_json(plan))
        return 0
    show_findings(plan.findings)
    is_abbreviated = sys.stdout.isatty() and not arguments.all and len(plan.runs) > _LONG
    console = output()
    _print_table(console, plan, is_abbreviated=is_abbreviated)
    console.print()
    print_facts(
        console,
        [
            ("Runs", in_words(plan.model) if plan.source is None else counted(len(plan.runs), "run")),
            ("Measures", measures_in_words(plan.columns)),
            ("Order", plan.order),
            ("Excluded", listed(f"{run}: {reason}" for run, reason in plan.excluded.items())),
            ("To repeat", plan.how_to_repeat),
            ("Duration", str(plan.duration)),
        ],
    )
    return 0


def _print_table(console: UserConsole, plan: Plan, *, is_abbreviated: bool) -> None:
    columns = _columns(plan)
    shown = columns[: fitting(columns, console.width)]
    console.print(aligned(shown, [column.heading for column in columns]), style="bold", soft_wrap=True)
    for run in plan.runs[:_FIRST] if is_abbreviated else plan.runs:
        print(aligned(shown, _cells(run, plan.model)))
    if is_abbreviated:
        left_out = len(plan.runs) - _FIRST - _LAST
        console.print(f"… {counted(left_out, 'run')} left out: --all shows them …", style="dim")
        for run in plan.runs[-_LAST:]:
            print(aligned(shown, _cells(run, plan.model)))
    if len(shown) < len(columns):
        names = ", ".join(column.heading for column in columns[len(shown) :])
        console.print(f"No room for: {names}. A wider terminal shows them, and so does --json.", style="dim")


def _columns(plan: Plan) -> list[Column]:
    columns = run_columns(plan.model, plan.runs[-1].run_id)
    if plan.runs[0].block is not None:
        columns.append(Column("block", len("block"), is_number=True))
    return columns


def _cells(run: PlannedRun, model: RunTableModel) -> list[str]:
    cells = run_cells(model, run.run_id, run.combination, run.repetition)
    return cells if run.block is None else [*cells, str(run.block)]


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
        "run_table": str(plan.source) if plan.source else None,
        "measures": columns_as_json(plan.columns),
        "duration": asdict(plan.duration),
        "runs": list(map(run_as_json, plan.runs)),
    }
