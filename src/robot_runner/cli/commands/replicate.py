"""Execute a package again: the same runs in the same order from the same seed, and say whether the results agree.

The package is verified first, and what differs between its environment and this machine is shown; nothing of it is
executed before you have said yes. The same command goes on with a replication that was interrupted. Exit code 0: all
runs are done, whatever the verdict; 1: some run failed; 2: refused; 130: interrupted.
"""

from __future__ import annotations

import os
import re
import shlex
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.cli.arguments import add_set
from robot_runner.cli.console import no_byte_code, output, shown_path
from robot_runner.cli.execution import execute_on_screen, read_or_not
from robot_runner.cli.findings import show_error, show_findings
from robot_runner.cli.parser import UsageError
from robot_runner.cli.replication_words import print_container, print_plan, print_remaining, print_verdicts
from robot_runner.cli.screens.byte_progress import byte_progress
from robot_runner.cli.screens.outcome import print_verdict
from robot_runner.cli.screens.prompts import terminal_input
from robot_runner.config.overrides import parse_assignments
from robot_runner.errors import Finding, RobotRunnerError, did_you_mean
from robot_runner.replication.container import container_commands
from robot_runner.replication.differences import differing_environment
from robot_runner.replication.preparing import original_settings, prepare_replication
from robot_runner.replication.source import Source, find_source
from robot_runner.replication.virtual_environment import make_environment, remaining_differences

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterator

    from robot_runner.cli.execution import Execution
    from robot_runner.cli.parser import Parser
    from robot_runner.replication.preparing import Replication

__all__ = ["add_arguments", "execute"]

_HERE, _VENV, _CONTAINER = _ENVIRONMENTS = ("here", "venv", "container")
_DEFAULT_BOUND = "5%"


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
    print_plan(output(), source, differing_environment(source.environment, robot=robot), deviations, target)
    if arguments.environment == _CONTAINER:
        return _container(source, target)
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
        from robot_runner.analysis.comparison.bounds import Bounds  # noqa: PLC0415 - an extra
    except ImportError as error:
        fix = "Install it to have the results compared: pip install 'robot-runner[analysis]'"
        show_findings([Finding.warning("verdict", f"there will be none: {error}", fix)])
        return
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


def _container(source: Source, target: Path) -> int:
    root = _unpacked(source, target)
    print_container(output(), container_commands(source.experiment, shlex.quote(shown_path(root))))
    return 0


def _in_own_environment(arguments: Namespace, source: Source, root: Path, target: Path) -> int:
    """Make the environment, and let the program in it take this process's place."""
    output().print("Making the environment of the package ...", style="bold")
    sys.stdout.flush()
    folder = target / "environment"
    program = make_environment(root, folder, source.environment)
    print_remaining(output(), remaining_differences(folder, source.environment))
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
            print_verdicts(console, replication, target, bound)
        except RobotRunnerError as error:
            show_error(error)
    if execution.finished.todo_count or execution.finished.failed_count:
        words = ["robot-runner", "replicate", arguments.package, "--to", shown_path(target)]
        words += [word for each in arguments.set for word in ("--set", each)]
        words += ["--environment", arguments.environment] if arguments.environment != _HERE else []
        verdict = "" if not execution.finished.todo_count else "The verdict comes once every run was executed. "
        console.print(f"{verdict}Go on with what is left: {shlex.join(words)}", soft_wrap=True)
