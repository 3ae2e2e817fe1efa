"""Write the report of an experiment: tables, figures, tests, threats to validity.

HTML is one file that needs nothing beside it. Tables (CSV, LaTeX) and figures (SVG, PDF, PNG) are written beside it. An
experiment that is not over, or that failed in part, has a report too. Nothing but the folder is needed. A notebook or
an R script beside it computes every number again from the run table alone.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.analysis.declared_design import with_declared_design
from robot_runner.analysis.libraries import require_libraries
from robot_runner.analysis.plan_file import PlanFile, read_plan
from robot_runner.cli.console import complaints, output, print_facts, shown_path
from robot_runner.cli.findings import print_findings
from robot_runner.cli.parser import Parser, UsageError, add_set, add_target
from robot_runner.cli.screens.progress_bars import step_progress
from robot_runner.cli.target import refuse_unwritable, target_or_only
from robot_runner.core.errors import Finding, did_you_mean
from robot_runner.core.words import counted

if TYPE_CHECKING:
    from robot_runner.analysis.figures.style import FigureFormat
    from robot_runner.analysis.report.writing import WrittenReport
    from robot_runner.analysis.results import Results

_FORMATS = ("html", "md", "json")
_FIGURES = ("svg", "pdf", "png")
_NO_FIGURES = "none"
_MOST_LETTERS = 8  # in a message


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add_target(parser, is_the_only_one=True)
    add_set(parser)
    parser.add_argument("--format", metavar="FORMAT", default="html", help="html, md or json (%(default)s)")
    parser.add_argument("--output", metavar="FOLDER", help="where to write it; report/ in the experiment's folder")
    parser.add_argument(
        "--figures",
        metavar="KINDS",
        default=",".join(_FIGURES),
        help="which files to make of each figure: some of svg,pdf,png, or none (%(default)s)",
    )
    parser.add_argument(
        "--measure",
        metavar="NAME",
        action="append",
        help="analyse this measure only; may be given several times",
    )
    parser.add_argument(
        "--notebook", action="store_true", help="write a Jupyter notebook too that computes every number again"
    )
    parser.add_argument("--r", action="store_true", help="write an R script too that computes every number again")
    parser.add_argument(
        "--alpha", metavar="LEVEL", type=float, help="the level of significance (that of the config's plan, or 0.05)"
    )
    parser.add_argument(
        "--plan",
        metavar="FILE",
        help="a plan of the analysis, as TOML, in the place of the config's; everything is exploratory then. It may "
        "declare the [design] of results that were made elsewhere",
    )


def execute(arguments: Namespace) -> int:
    """Write the report, and print where it is."""
    require_libraries()
    kind = _one_of(_FORMATS, arguments.format, "--format")
    figures = _figures(arguments.figures)
    folder = target_or_only("report", arguments.target, arguments.set)
    if not arguments.output:
        refuse_unwritable(folder.report, "--output")
    from robot_runner.analysis.recomputing.recomputations import (  # noqa: PLC0415 - slow, and an extra
        Recomputation,
        write_recomputations,
    )
    from robot_runner.analysis.report.writing import ReportFormat, write_report  # noqa: PLC0415 - as above
    from robot_runner.analysis.results import load_results  # noqa: PLC0415 - as above

    results = load_results(folder.root)
    given = read_plan(Path(arguments.plan).expanduser()) if arguments.plan else PlanFile(None, None)
    if given.design is not None:
        results = with_declared_design(results, given.design, shown_path(Path(arguments.plan)))
    chosen: dict[str, Any] = {
        "output": Path(arguments.output).expanduser() if arguments.output else None,
        "measures": arguments.measure,
        "alpha": arguments.alpha,
        "plan": given.analysis,
    }
    with step_progress() as on_step:
        written = write_report(results, ReportFormat(kind), figures=figures, **chosen, on_step=on_step)
    kinds = [Recomputation.NOTEBOOK] * arguments.notebook + [Recomputation.R] * arguments.r
    _print(written, write_recomputations(results, kinds, **chosen) if kinds else ())
    if kind != ReportFormat.JSON.value:  # pages and Markdown have all figures, whatever files are asked for
        print_findings(complaints(), list(_font_warnings(results)))
    return 0


def _font_warnings(results: Results) -> Iterator[Finding]:
    """Yield a warning if letters of the names have no font, and would be boxes in the figures."""
    from robot_runner.analysis.figures.style import letters_without_font  # noqa: PLC0415 - slow, and an extra

    treatments = (str(each) for factor in results.factors for each in results.all_runs[factor].unique())
    if missing := letters_without_font([*results.factors, *results.measures, *treatments]):
        yield Finding.warning(
            "figures",
            f"no font of theirs is installed for {', '.join(missing[:_MOST_LETTERS])}"
            f"{' and others' if len(missing) > _MOST_LETTERS else ''}: in figures these are boxes",
            "Install a font that has them, such as Noto Sans CJK (Debian and Ubuntu: fonts-noto-cjk), and write the "
            "report again.",
        )


def _print(written: WrittenReport, recomputations: Sequence[Path]) -> None:
    facts = [("Report", shown_path(written.document.resolve()))]
    for name, paths in (("Tables", written.tables), ("Figures", written.figures)):
        if paths:
            facts.append((name, f"{counted(len(paths), 'file')} in {shown_path(paths[0].parent.resolve())}/"))
    facts += [("Computes it again", shown_path(path.resolve())) for path in recomputations]
    print_facts(output(), facts)


def _one_of(known: tuple[str, ...], word: str, option: str) -> str:
    if word not in known:
        raise UsageError(f"there is no {option} {word!r}", where="robot-runner report", fix=did_you_mean(word, known))
    return word


def _figures(text: str) -> tuple[FigureFormat, ...]:
    words = [] if text == _NO_FIGURES else [word.strip() for word in text.split(",")]
    for word in words:
        _one_of(_FIGURES, word, "--figures")
    from robot_runner.analysis.figures.style import FigureFormat  # noqa: PLC0415 - slow, and an extra

    return tuple(FigureFormat(word) for word in dict.fromkeys(words))
