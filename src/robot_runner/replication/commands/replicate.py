"""Execute a package again, and say whether the results agree.

The same runs are executed in the same order from the same seed. The package is verified first, and what differs between
its environment and this machine is shown; nothing of it is executed before you have said yes. The same command goes on
with a replication that was interrupted. Exit code 0: all runs are done, whatever the verdict; 1: some run failed; 2:
refused; 130: interrupted.
"""

from __future__ import annotations

import os
import re
import shlex
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.text import Text

from robot_runner.analysis.libraries import MissingLibraryError, require_libraries
from robot_runner.cli.console import (
    Column,
    UserConsole,
    aligned,
    no_byte_code,
    output,
    print_facts,
    print_folded,
    shown_path,
    width_of,
)
from robot_runner.cli.executing import execute_on_screen, read_or_not
from robot_runner.cli.findings import show_error, show_findings
from robot_runner.cli.parser import UsageError, add_set
from robot_runner.cli.screens.byte_progress import byte_progress
from robot_runner.cli.screens.ending import print_verdict
from robot_runner.cli.screens.plain import terminal_input
from robot_runner.core.config.loader import parse_assignments
from robot_runner.core.errors import Finding, RobotRunnerError, did_you_mean
from robot_runner.core.storage.safe_write import write_beside_and_rename
from robot_runner.core.words import counted, one_line
from robot_runner.replication.about import container_commands
from robot_runner.replication.differences import differing_environment, remaining_differences
from robot_runner.replication.environment import make_environment
from robot_runner.replication.replicating import (
    find_source,
    identical_values,
    original_settings,
    prepare_replication,
)

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterator, Mapping, Sequence

    from robot_runner.analysis.comparison.compared import Comparison, MeasureComparison
    from robot_runner.cli.executing import Execution
    from robot_runner.cli.parser import Parser
    from robot_runner.replication.differences import Difference
    from robot_runner.replication.replicating import Replication, Sameness, Source

__all__ = ["add_arguments", "execute"]

_HERE, _VENV, _CONTAINER = _ENVIRONMENTS = ("here", "venv", "container")
_DEFAULT_BOUND = "5%"
_MOST_LINES = 12
_STYLES = {"equivalent": "green", "different": "red", "undecided": "yellow"}


def add_arguments(parser: Parser) -> None:
    """Add what the command takes."""
    parser.add_argument(
        "package", metavar="PACKAGE", help="the package, the folder that it was unpacked to, or an experiment's"
    )
    parser.add_argument(
        "--to", metavar="FOLDER", help="where everything is written; NAME_replication in the current folder if left out"
    )
    parser.add_argument(
        "--environment",
        metavar="WHICH",
        default=_HERE,
        help="here: as it is on this machine (if left out); venv: make the package's Python environment first; "
        "container: print the commands that build and start a container",
    )
    add_set(parser)
    parser.add_argument(
        "--bound",
        metavar="BOUND",
        action="append",
        help="what difference would not matter: 5%% (if left out), 10 (in the measure's unit), or NAME=BOUND; "
        "may be given several times",
    )
    parser.add_argument("--yes", action="store_true", help="execute the package's code without asking")
    parser.add_argument("--plain", action="store_true", help="print plain lines on a terminal, too")


def execute(arguments: Namespace) -> int:
    """Verify, show what differs, ask, execute, compare."""
    if arguments.environment not in _ENVIRONMENTS:
        fix = did_you_mean(arguments.environment, _ENVIRONMENTS)
        raise UsageError(f"there is no environment {arguments.environment!r}", where="--environment", fix=fix)
    deviations = parse_assignments(arguments.set)
    bound = arguments.bound or [_DEFAULT_BOUND]
    if arguments.environment == _HERE:
        _refuse_bound(bound)
    with byte_progress("verifying") as progress:
        source = find_source(Path(arguments.package).expanduser(), progress)
    target = Path(arguments.to or f"{_harmless(source.experiment)}_replication").expanduser().resolve()
    source.refuse_target(target)
    robot = deviations.get("robot", original_settings(source.manifest).get("robot", source.manifest.get("robot")))
    _print_plan(output(), source, differing_environment(source.environment, robot=robot), deviations, target)
    if arguments.environment == _CONTAINER:
        _print_container(output(), source.experiment, _unpacked(source, target))
        return 0
    _make_sure(arguments)
    root = _unpacked(source, target)
    if arguments.environment == _VENV:
        return _in_own_environment(arguments, source, root, target)
    with _no_traces():
        replication = prepare_replication(root, target, deviations)
        execution = execute_on_screen(replication.experiment, replication.findings, plain=arguments.plain)
    with read_or_not():
        _tell(arguments, replication, execution, target, bound)
    return execution.exit_code


def _harmless(name: str) -> str:
    """Return a name that a stranger chose so that it leads nowhere else and commands no terminal."""
    return re.sub(r"[^\w .-]", "_", Path(name).name)


def _refuse_bound(bound: list[str]) -> None:
    """Look at the bounds before the robot moves; that no verdict will be possible is said then, too.

    Raises:
        AnalysisError: one of them cannot be.
    """
    try:
        require_libraries()
    except MissingLibraryError as error:
        fix = "Install it to have the results compared: pip install 'robot-runner[analysis]'"
        show_findings([Finding.warning("verdict", f"there will be none: {error}", fix)])
        return
    from robot_runner.analysis.comparison.compared import Bounds  # noqa: PLC0415 - slow, and an extra

    Bounds.parse(bound)


def _make_sure(arguments: Namespace) -> None:
    """Ask at a terminal whether the code of the package may be executed.

    Raises:
        UsageError: it may not, or nobody can be asked.
    """
    if arguments.yes:
        return
    where = "robot-runner replicate"
    if terminal_input() is None:
        fix = "Look at its config, then add --yes."
        raise UsageError("nobody can be asked whether the package's code may be executed", where=where, fix=fix)
    answer = input("Execute the code of this package? [y/N] ").strip().casefold()
    if answer not in {"y", "yes"}:
        raise UsageError("nothing was executed", where=where, fix="Look at its config first: robot-runner verify")


def _unpacked(source: Source, target: Path) -> Path:
    with byte_progress("unpacking") as progress:
        return source.unpacked_below(target, progress)


def _in_own_environment(arguments: Namespace, source: Source, root: Path, target: Path) -> int:
    """Make the environment, and let the program in it take this process's place."""
    output().print("Making the environment of the package ...", style="bold")
    sys.stdout.flush()
    folder = target / "environment"
    program = make_environment(root, folder, source.environment)
    differing = remaining_differences(folder, source.environment)
    _print_differences(output(), differing, "The environment that was made differs:", "package", "made")
    if not differing:
        same = "the same versions, and the same files where that is known"
        output().print(f"The environment has what the package lists: {same}.")
    words = [str(program), "replicate", str(root), "--to", str(target), "--environment", _HERE, "--yes"]
    words += [word for each in arguments.set for word in ("--set", each)]
    words += [word for each in arguments.bound or () for word in ("--bound", each)]
    words += ["--plain"] if arguments.plain else []
    sys.stdout.flush()
    sys.stderr.flush()
    os.execv(program, words)  # noqa: S606 - no shell is meant
    return 0  # pragma: no cover - this process is another one now


@contextmanager
def _no_traces() -> Iterator[None]:
    """Write no byte code beside the package's modules, here and in what is started from here."""
    name = "PYTHONDONTWRITEBYTECODE"
    before = os.environ.get(name)
    os.environ[name] = "1"
    try:
        with no_byte_code():
            yield
    finally:
        if before is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = before


def _tell(arguments: Namespace, replication: Replication, execution: Execution, target: Path, bound: list[str]) -> None:
    console = output()
    if execution.finished is None:
        return
    print_verdict(console, execution.finished, execution.progress)
    if execution.finished.done_count and not execution.finished.todo_count:
        try:
            _print_verdicts(console, replication, target, bound)
        except RobotRunnerError as error:
            show_error(error)
    if execution.finished.todo_count or execution.finished.failed_count:
        words = ["robot-runner", "replicate", arguments.package, "--to", shown_path(target)]
        words += [word for each in arguments.set for word in ("--set", each)]
        words += ["--environment", arguments.environment] if arguments.environment != _HERE else []
        verdict = "" if not execution.finished.todo_count else "The verdict comes once every run was executed. "
        console.print(f"{verdict}Go on with what is left: {shlex.join(words)}", soft_wrap=True)


def _print_plan(
    console: UserConsole, source: Source, differing: Sequence[Difference], deviations: Mapping[str, str], target: Path
) -> None:
    """Print what will be executed, and what differs from how it was."""
    manifest, settings = source.manifest, original_settings(source.manifest)
    sealed = ("verified: every file is as it was packed", "green") if source.is_sealed else ("not sealed", "yellow")
    head = Text(one_line(source.experiment), style="bold").append(f"  {sealed[0]}", f"not bold {sealed[1]}")
    console.print(head, soft_wrap=True)
    facts = [
        ("Executes", f"config/{(manifest.get('config') or {}).get('file')}, seed {manifest.get('seed')}"),
        ("As then", ", ".join(f"{name}={text}" for name, text in settings.items() if name not in deviations)),
        ("Deviates", ", ".join(f"{name}={text}" for name, text in deviations.items())),
        ("Replaced", _replaced(source)),
        ("Left out", ", ".join(str(each.get("name")) for each in source.description.get("left_out", ()))),
        ("Results", f"{shown_path(target)}/"),
    ]
    print_facts(console, [(what, one_line(text)) for what, text in facts])  # a stranger's text may hold escapes
    if source.findings:
        show_findings(source.findings)
    _print_differences(console, differing, "This machine differs from the package's:", "package", "here")


def _print_container(console: UserConsole, experiment: str, root: Path) -> None:
    """Print the commands that build an image and replicate in it."""
    console.print()
    console.print("Build the image and replicate in it (docker takes the same words):", style="bold")
    for command in container_commands(experiment, shlex.quote(shown_path(root))):
        console.print(f"  {command}", soft_wrap=True)


def _print_verdicts(console: UserConsole, replication: Replication, target: Path, bound: Sequence[str]) -> None:
    """Compare the replication with its original; print the verdict on each measure, and write everything to a page.

    Raises:
        RobotRunnerError: they cannot be compared.
    """
    same = identical_values(replication.original, replication.experiment.folder.root)
    if same and all(each.is_complete for each in same.values()):
        runs = counted(max(each.runs for each in same.values()), "run")
        console.print(f"The results are identical: every value of {runs}, to the last digit.", style="bold green")
    require_libraries()
    from robot_runner.analysis.comparison.comparing import compare  # noqa: PLC0415 - slow, and an extra
    from robot_runner.analysis.comparison.comparison_document import (  # noqa: PLC0415
        json_of_comparison,
        write_comparison,
    )

    comparison = compare(replication.original, replication.experiment.folder.root, bound=list(bound))
    write_beside_and_rename(target / "comparison.json", lambda file: file.write(json_of_comparison(comparison) + "\n"))
    write_comparison(comparison, target / "comparison.html")
    _print_table(console, comparison, same)
    paths = {
        "Original": replication.original,
        "Again": replication.experiment.folder.root,
        "All of it": target / "comparison.html",
    }
    print_facts(console, [(what, shown_path(path)) for what, path in paths.items()])


def _replaced(source: Source) -> str:
    """Return the kinds of secrets that were replaced; a config may not work without those that were in it."""
    replaced = source.description.get("replaced", ())
    names = sorted({str(each.get("name")) for each in replaced if str(each.get("name")).startswith("config/")})
    advice = f" (in {', '.join(names)}, too: look whether it works without)" if names else ""
    return ", ".join(sorted({str(each.get("what")) for each in replaced})) + advice


def _print_differences(
    console: UserConsole, differing: Sequence[Difference], head: str, first: str, second: str
) -> None:
    if not differing:
        return
    console.print(head, style="bold")
    shown = sorted(differing, key=lambda each: each.is_package)  # the facts first; there may be many packages
    rows = [[one_line(text) for text in (each.what, each.original, each.here)] for each in shown[:_MOST_LINES]]
    headings = ["", first, second]
    columns = [Column(name, width_of([name, *(row[place] for row in rows)])) for place, name in enumerate(headings)]
    console.print(f"  {aligned(columns, headings)}", style="dim", soft_wrap=True)
    for row in rows:
        console.print(f"  {aligned(columns, row)}", soft_wrap=True)
    if len(shown) > _MOST_LINES:
        console.print(f"  and {len(shown) - _MOST_LINES} more", style="dim")


def _print_table(console: UserConsole, comparison: Comparison, same: Mapping[str, Sameness]) -> None:
    console.print()
    widest = max((len(measure.label) for measure in comparison.measures), default=0)
    for measure in comparison.measures:
        verdict, why = _verdict(measure, same.get(measure.first_name))
        print_folded(console, f"  {measure.label:{widest}}  {verdict:10}  ", one_line(why), style=_STYLES[verdict])
    for note in comparison.notes:
        print_folded(console, "  ! ", one_line(note), style="bold yellow")
    console.print()


def _verdict(measure: MeasureComparison, same: Sameness | None) -> tuple[str, str]:
    """Return the verdict and its reason; what is the same in every run needs no statistics."""
    from robot_runner.analysis.comparison.comparison_document import shown_bound  # noqa: PLC0415 - slow, and an extra

    if same is not None and same.is_complete:
        return "equivalent", f"Identical in all {counted(same.runs, 'run')}; the bound was {shown_bound(measure)}."
    return measure.verdict.value, measure.conclusion
