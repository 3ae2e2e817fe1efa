"""Write an experiment's results for other tools: Parquet and a data package.

The data package describes every column: its type, unit, meaning and owner.
"""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from robot_runner.analysis.libraries import require_libraries
from robot_runner.cli.console import output, print_facts, print_json, shown_path
from robot_runner.cli.parser import Parser, add_json, add_set, add_target
from robot_runner.cli.target import refuse_unwritable, target_or_only


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add_target(parser, is_the_only_one=True)
    add_set(parser)
    parser.add_argument("--to", metavar="FOLDER", help="where to; export/ in the experiment's folder if left out")
    parser.add_argument(
        "--spreadsheets",
        action="store_true",
        help="write the run table and the report's tables into spreadsheets/, too, as workbooks (.xlsx) without "
        "formulas, whose numbers are read alike in every language",
    )
    add_json(parser)


def execute(arguments: Namespace) -> int:
    """Write the files, and print where they are."""
    require_libraries()
    from robot_runner.analysis.results import load_results  # noqa: PLC0415 - takes a second to import

    folder = target_or_only("export", arguments.target, arguments.set).root
    if not arguments.to:
        refuse_unwritable(folder / "export", "--to")
    results = load_results(folder)
    target = Path(arguments.to) if arguments.to else None
    files = results.export(target, for_spreadsheets=arguments.spreadsheets)
    if arguments.json:
        print_json({"files": list(map(str, files))})
        return 0
    console = output()
    console.print(results.name, style="bold")
    facts = [("Data package", shown_path(files[-1])), ("Files", f"{len(files)} in {shown_path(files[-1].parent)}")]
    if arguments.spreadsheets:
        facts.append(("Spreadsheets", shown_path(files[-1].parent / "spreadsheets")))
    print_facts(console, facts)
    return 0
