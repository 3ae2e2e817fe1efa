"""Compare two experiments and say whether they are equivalent, or combine three and more.

They may be real and simulated, measured and estimated, original and replication: each is an experiment's folder, or its
config file. Of two, FIRST is the reference and SECOND the other one, and runs are matched by the factors of both. With
a bound - the largest difference that does not matter - each measure gets a verdict: identical, equivalent, different,
or undecided.

Three and more (or two, with --meta) are combined in a meta-analysis of replications: the average difference of each
pair of treatments over all experiments, how much experiments differ, and what a further one may find.

    robot-runner compare original replication --bound 5%
    robot-runner compare real simulated --rope "5 J" --measure Energy
    robot-runner compare lab_a lab_b lab_c --html combined.html
    robot-runner compare a b c --measure Energy=E_total --same Task=Job
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from rich.cells import cell_len
from rich.text import Text

from robot_runner.analysis.libraries import require_libraries
from robot_runner.analysis.wording import shown_number
from robot_runner.cli.console import (
    Column,
    UserConsole,
    aligned,
    output,
    print_facts,
    print_folded,
    print_json,
    shortened,
    shown_path,
    width_of,
)
from robot_runner.cli.parser import Parser, UsageError, add_json
from robot_runner.cli.target import folder_of_target
from robot_runner.core.errors import Finding, RobotRunnerError, StorageError
from robot_runner.core.words import counted, one_line

if TYPE_CHECKING:
    from robot_runner.analysis.comparison.combined import MetaAnalysis
    from robot_runner.analysis.comparison.compared import Comparison, MeasureComparison
    from robot_runner.analysis.report.blocks import Document, Table

_STYLES = {"identical": "green", "equivalent": "green", "different": "red", "undecided": "yellow"}


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    parser.add_argument("first", metavar="FIRST", help="the reference experiment")
    parser.add_argument("second", metavar="SECOND", help="the other one")
    parser.add_argument("more", metavar="MORE", nargs="*", default=[], help="further replications, for a meta-analysis")

    def add_repeated(option: str, metavar: str, text: str) -> None:
        parser.add_argument(option, metavar=metavar, action="append", help=f"{text}; may be given several times")

    add_repeated("--measure", "NAME", "compare this measure, or NAME=OTHER if its name differs")
    parser.add_argument("--meta", action="store_true", help="make a meta-analysis of two experiments, too")
    add_repeated("--same", "NAME=OTHER", "in a meta-analysis: a factor or treatment whose name differs")
    add_repeated(
        "--bound",
        "BOUND",
        "the largest difference that does not matter: 5%%, 10 (in the measure's unit), or NAME=BOUND",
    )
    add_repeated(
        "--rope",
        "REGION",
        "say how probable it is that a difference lies within this region of practical equivalence: 2%%, 10, '5 J' or "
        "NAME=REGION",
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
    parser.add_argument(
        "--files",
        metavar="FOLDER",
        help="write its figures (SVG, PDF, PNG) and tables (CSV, LaTeX) into this folder, too",
    )
    add_json(parser)


def execute(arguments: Namespace) -> int:
    """Print the comparison; a difference is not a failure, so the exit code is 0."""
    is_meta = bool(arguments.more) or arguments.meta
    _check_options(arguments, is_meta=is_meta)
    if arguments.html is not None:
        _refuse_to_lose(Path(arguments.html).expanduser())
    require_libraries()
    from robot_runner.analysis.report.writing import write_page, write_parts  # noqa: PLC0415 - slow, and an extra

    found = (_combined if is_meta else _compared)(arguments, [arguments.first, arguments.second, *arguments.more])
    written = {}
    for what, given, write in (("Page", arguments.html, write_page), ("Files", arguments.files, write_parts)):
        if given is not None:
            path = Path(given).expanduser()
            write(found.document, path)
            written[what] = path
    if arguments.json:
        print_json(found.json)
    else:
        console = output()
        found.show(console)
        print_facts(console, [(what, shown_path(path.resolve())) for what, path in written.items()])
    return 0


class _Found(NamedTuple):
    """The findings, for each kind of output."""

    document: Document
    json: str
    show: Callable[[UserConsole], None]


def _check_options(arguments: Namespace, *, is_meta: bool) -> None:
    """Refuse options that would have no effect.

    Raises:
        UsageError: there are some; `findings` lists all of them.
    """
    given = ("--bound", "--rope", "--paired") if is_meta else ("--same",)
    where = "a meta-analysis" if is_meta else "a comparison of two experiments"
    fix = "Leave it out, or compare two experiments at a time." if is_meta else "Add --meta, or leave it out."
    UsageError.refuse(
        Finding.error(name, f"this option is not for {where}", fix)
        for name in given
        if getattr(arguments, name.lstrip("-"))
    )


def _refuse_to_lose(page: Path) -> None:
    if page.exists() and page.suffix.casefold() not in {".html", ".htm"}:
        fix = "Name a page, or one that is not there yet: --html comparison.html."
        raise StorageError("the file is no page, and would be lost", where=f"--html {page}", fix=fix)


def _folders(targets: Sequence[str]) -> list[Path]:
    """Return the folders of all experiments.

    Raises:
        StorageError: some of the targets hold none; `findings` lists all of them.
    """
    folders: list[Path] = []
    findings: list[Finding] = []
    for target in targets:
        try:
            folders.append(folder_of_target(target, []).root)
        except RobotRunnerError as error:
            findings += error.findings
    StorageError.refuse(findings)
    return folders


def _compared(arguments: Namespace, targets: Sequence[str]) -> _Found:
    from robot_runner.analysis.comparison import comparison_document as document  # noqa: PLC0415 - slow, and an extra
    from robot_runner.analysis.comparison.comparing import compare  # noqa: PLC0415 - slow, and an extra
    from robot_runner.analysis.report.writing import made_by  # noqa: PLC0415 - slow, and an extra

    comparison = compare(
        *_folders(targets),
        measures=arguments.measure,
        bound=arguments.bound,
        alpha=arguments.alpha,
        is_paired=True if arguments.paired else None,
        rope=arguments.rope or (),
    )
    page = document.comparison_document(comparison, made=made_by("Comparison", datetime.now(UTC)))
    return _Found(page, document.json_of_comparison(comparison), partial(_print, comparison))


def _combined(arguments: Namespace, targets: Sequence[str]) -> _Found:
    from robot_runner.analysis.comparison import combined_document as document  # noqa: PLC0415 - slow, and an extra
    from robot_runner.analysis.comparison.averaging import meta_analyse  # noqa: PLC0415 - slow, and an extra
    from robot_runner.analysis.report.writing import made_by  # noqa: PLC0415 - slow, and an extra

    same, measures = arguments.same or (), arguments.measure
    found = meta_analyse(*_folders(targets), measures=measures, alpha=arguments.alpha, same=same)
    page = document.combined_document(found, made=made_by("Meta-analysis", datetime.now(UTC)))
    return _Found(page, document.json_of_meta_analysis(found), partial(_print_combined, found))


def _print(comparison: Comparison, console: UserConsole) -> None:
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
    for note in filter(None, (comparison.again, *comparison.notes)):
        print_folded(console, "  ! ", one_line(note), style="bold yellow")


def _print_measure(console: UserConsole, comparison: Comparison, measure: MeasureComparison) -> None:
    from robot_runner.analysis.comparison.comparison_document import difference_table  # noqa: PLC0415 - slow, and an extra

    console.print()
    head = Text(measure.label, style="bold").append("  ").append(measure.verdict.value, _STYLES[measure.verdict.value])
    origins = (measure.first_origin, measure.second_origin)
    if not {None, "measured"}.issuperset(origins):
        head.append(f"  ({'; '.join(each or 'unknown' for each in origins)})", "not bold yellow")
    console.print(head)
    _print_rows(console, difference_table(comparison, measure))
    agreement = measure.agreement
    if agreement is not None and agreement.error is not None:
        pairs = counted(sum(map(len, agreement.pairs.values())), "pair")
        print(f"  relative error {shown_number(agreement.error, 3)} %, bias {shown_number(agreement.bias)} ({pairs})")
    print_folded(console, "  ", one_line(measure.conclusion), style="")
    for missed in measure.not_computed:
        print_folded(console, "  ! ", one_line(f"{missed.what}: {missed.why}"), style="bold yellow")


def _print_rows(console: UserConsole, table: Table) -> None:
    shown = table.for_readers
    texts = [[cell.text for cell in row] for row in shown.rows]
    names = [column.name for column in shown.columns]
    widths = [width_of([name]) if _width(names) == width_of(names) else cell_len(one_line(name)) for name in names]
    columns = [
        Column(column.name, max(width, _width([row[place] for row in texts])), is_number=column.is_number)
        for place, (column, width) in enumerate(zip(shown.columns, widths, strict=True))
    ]
    console.print(f"  {aligned(columns, [column.heading for column in columns])}", style="dim", soft_wrap=True)
    for row in texts:
        print(f"  {aligned(columns, row)}")


def _width(texts: Sequence[str]) -> int:
    """Return the width of a column: a reasonable one, unless texts that differ would be cut to the same."""
    lines = {one_line(each) for each in texts}
    width = width_of(lines)
    are_apart = len({shortened(each, width) for each in lines}) == len(lines)
    return width if are_apart else max(map(cell_len, lines))


def _print_combined(found: MetaAnalysis, console: UserConsole) -> None:
    from robot_runner.analysis.comparison.combined_document import effect_table  # noqa: PLC0415 - slow, and an extra

    names = ", ".join(one_line(each.name) for each in found.experiments)
    console.print(Text(f"{counted(len(found.experiments), 'experiment')} combined: {names}", style="bold"))
    print_facts(console, [(each[0], "; ".join(map(one_line, each[1:]))) for each in found.differing])
    for measure in found.measures:
        console.print()
        console.print(Text(measure.label, style="bold"))
        for effect in measure.effects:
            console.print(Text(f"  {one_line(effect.label)}", style="bold"))
            _print_rows(console, effect_table(found, measure, effect))
            print_folded(console, "  ", one_line(effect.conclusion), style="")
        for missed in measure.not_computed:
            print_folded(console, "  ! ", one_line(f"{missed.what}: {missed.why}"), style="bold yellow")
    if found.findings:
        console.print()
    for finding in found.findings:
        print_folded(console, "  ! ", one_line(str(finding)), style="bold yellow")
