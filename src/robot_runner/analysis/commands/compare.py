"""Compare two experiments, and say whether they are equivalent.

They may be real and simulated, measured and estimated, original and replication. FIRST is what is compared with, SECOND
the other one: each an experiment's folder, or the config file that it comes from. Runs are matched by the factors that
both have. With a bound - the difference that would not matter - each measure gets a verdict: equivalent, different, or
undecided.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rich.text import Text

from robot_runner.analysis.libraries import require_libraries
from robot_runner.cli.console import (
    Column,
    UserConsole,
    aligned,
    output,
    print_facts,
    print_folded,
    shown_path,
    width_of,
)
from robot_runner.cli.parser import add_json
from robot_runner.cli.planning import folder_of_target
from robot_runner.core.words import counted, one_line

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterator

    from robot_runner.analysis.comparison.compared import Comparison, MeasureComparison
    from robot_runner.cli.parser import Parser

__all__ = ["add_arguments", "execute"]

_STYLES = {"equivalent": "green", "different": "red", "undecided": "yellow"}


def add_arguments(parser: Parser) -> None:
    """Add what the command takes."""
    parser.add_argument("first", metavar="FIRST", help="the experiment that is compared with")
    parser.add_argument("second", metavar="SECOND", help="the other one")
    parser.add_argument(
        "--measure",
        metavar="NAME",
        action="append",
        help="compare this measure, or NAME=OTHER where SECOND calls it otherwise; may be given several times",
    )
    parser.add_argument(
        "--bound",
        metavar="BOUND",
        action="append",
        help="what would not matter: 5%%, 10 (in the measure's unit), or NAME=BOUND; may be given several times",
    )
    parser.add_argument(
        "--paired",
        action="store_true",
        help="runs of the same combination and repetition belong together (as they do within one experiment)",
    )
    parser.add_argument(
        "--alpha", metavar="LEVEL", type=float, default=0.05, help="level of significance (%(default)g)"
    )
    parser.add_argument("--html", metavar="FILE", help="write the comparison with its figures to this page, too")
    add_json(parser)


def execute(arguments: Namespace) -> int:
    """Print the comparison; a difference is no failure, so the exit code is 0."""
    require_libraries()
    first, second = (folder_of_target(target, []).root for target in (arguments.first, arguments.second))
    from robot_runner.analysis.comparison.comparing import compare  # noqa: PLC0415 - slow, and an extra

    comparison = compare(
        first,
        second,
        measures=arguments.measure,
        bound=arguments.bound,
        alpha=arguments.alpha,
        is_paired=True if arguments.paired else None,
    )
    _write(comparison, arguments.html)
    if arguments.json:
        from robot_runner.analysis.comparison.comparison_document import json_of_comparison  # noqa: PLC0415 - slow, and an extra

        print(json_of_comparison(comparison))
    else:
        _print(output(), comparison, arguments.html)
    return 0


def _write(comparison: Comparison, path: str | None) -> None:
    if path is not None:
        from robot_runner.analysis.comparison.comparison_document import write_comparison  # noqa: PLC0415 - slow, and an extra

        write_comparison(comparison, Path(path).expanduser())


def _print(console: UserConsole, comparison: Comparison, page: str | None) -> None:
    console.print(Text(f"{comparison.second.name} compared with {comparison.first.name}", style="bold"))
    print_facts(
        console, [(name, f"{one_line(ours)}; {one_line(theirs)}") for name, ours, theirs in comparison.differing]
    )
    for measure in comparison.measures:
        _print_measure(console, comparison, measure)
    console.print()
    if all(measure.bound is None for measure in comparison.measures):
        print_folded(
            console, "  ! ", "no bound was stated, so nothing can be called equivalent: --bound 5%", style="yellow"
        )
    for note in comparison.notes:
        print_folded(console, "  ! ", one_line(note), style="bold yellow")
    if page is not None:
        print_facts(console, [("Page", shown_path(Path(page).expanduser().resolve()))])


def _print_measure(console: UserConsole, comparison: Comparison, measure: MeasureComparison) -> None:
    from robot_runner.analysis.comparison.comparison_document import difference_table  # noqa: PLC0415 - slow, and an extra

    console.print()
    head = Text(measure.label, style="bold").append("  ").append(measure.verdict.value, _STYLES[measure.verdict.value])
    console.print(head.append("".join(_origins(measure)), "not bold yellow"))
    table = difference_table(comparison, measure).for_readers
    texts = [[one_line(cell.text) for cell in row] for row in table.rows]
    columns = [
        Column(column.name, width_of([column.name, *(row[place] for row in texts)]), is_number=column.is_number)
        for place, column in enumerate(table.columns)
    ]
    console.print(f"  {aligned(columns, [column.heading for column in columns])}", style="dim", soft_wrap=True)
    for row in texts:
        print(f"  {aligned(columns, row)}")
    agreement = measure.agreement
    if agreement is not None and agreement.error is not None:
        pairs = counted(sum(map(len, agreement.pairs.values())), "pair")
        print(f"  relative error {agreement.error:.2f} %, bias {agreement.bias:.4g} ({pairs})")
    print_folded(console, "  ", one_line(measure.conclusion), style="")
    for missed in measure.not_computed:
        print_folded(console, "  ! ", one_line(f"{missed.what}: {missed.why}"), style="bold yellow")


def _origins(measure: MeasureComparison) -> Iterator[str]:
    origins = [origin for origin in (measure.first_origin, measure.second_origin) if origin not in {None, "measured"}]
    if origins:
        yield f"  ({measure.first_origin or 'unknown'}; {measure.second_origin or 'unknown'})"
