"""Execute a package again, and say whether the results agree.

The same runs are executed in the same order from the same seed. First the package is verified, and the differences
between its environment and this machine are shown; its code is not executed, and nothing is installed, before you have
said yes. If packages that the experiment imports have other versions here, the package's own environment is offered,
and made with --yes. The same command continues an interrupted replication.

The last lines say for each primary measure (those of the plan, or all) whether it is identical, equivalent within a
bound, different or undecided; the very last line is the verdict on all. Exit code 0: identical or equivalent; 3:
different; 4: undecided, or nothing could be compared; 1: some run failed; 2: refused; 130: interrupted.

    robot-runner replicate study.zip
    robot-runner replicate study.zip --environment venv --yes --bound Energy=10
"""

from __future__ import annotations

import os
import re
import sys
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

from robot_runner.analysis.comparison.compared import Bounds
from robot_runner.cli.byte_code import no_byte_code
from robot_runner.cli.console import command_line, output, print_json, shown_path
from robot_runner.cli.executing import execute_on_screen, read_or_not
from robot_runner.cli.guard import SOME_FAILED
from robot_runner.cli.parser import Parser, UsageError, add_json, add_set
from robot_runner.cli.screens.ending import print_verdict
from robot_runner.cli.screens.progress_bars import byte_progress
from robot_runner.cli.target import only_package
from robot_runner.core.config.loader import parse_assignments
from robot_runner.core.errors import Finding, PackageError, RobotRunnerError, did_you_mean
from robot_runner.core.execution.resumption import ACCEPT
from robot_runner.core.secret_names import shown_assignments
from robot_runner.core.storage.input_files import kept_copies
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.replication.about import imported_facts
from robot_runner.replication.commands.replication_plan import (
    make_sure,
    print_container,
    print_made_environment,
    print_plan,
    wants_own_environment,
)
from robot_runner.replication.commands.replication_verdict import Comparing, facts_of
from robot_runner.replication.differences import differing_environment
from robot_runner.replication.replicating import (
    Source,
    find_source,
    original_settings,
    prepare_replication,
    replicated_folder,
    working_files,
)
from robot_runner.replication.run_by_run import is_executed
from robot_runner.replication.virtual_environments import execute_with, make_environment, program_in

#: The folders beside the results: the unpacked package, its environment, and that of the comparison.
_FOLDERS = frozenset({"package", "environment", "comparison_environment"})
_HERE, _VENV, _CONTAINER = _ENVIRONMENTS = ("here", "venv", "container")


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "package",
        metavar="PACKAGE",
        nargs="?",
        help="the package, the folder that it was unpacked to, or an experiment's; the only zip file here if left out",
    )
    parser.add_argument(
        "--to", metavar="FOLDER", help="the folder for all files; NAME_replication in the current folder if left out"
    )
    parser.add_argument(
        "--environment",
        metavar="WHICH",
        help="here: this machine's; venv: make the package's Python environment first; a folder: the virtual "
        "environment in it; container: print the commands that build and start a container; if left out, venv is "
        "offered if it makes a difference, and here is used otherwise",
    )
    add_set(parser)
    parser.add_argument(
        "--bound",
        metavar="BOUND",
        action="append",
        default=[],
        help="the largest difference that does not matter: 5%%, 10 (in the measure's unit), or NAME=BOUND; may be "
        "given several times; if left out, the margin in the original's plan, or else 5%%",
    )
    parser.add_argument(
        "--yes", action="store_true", help="execute the package's code, and install its requirements, without asking"
    )
    parser.add_argument(
        "--all-differences", action="store_true", help="show every package that differs on this machine"
    )
    parser.add_argument("--without-verdict", action="store_true", help="execute the runs, and compare nothing")
    parser.add_argument("--plain", action="store_true", help="print plain lines on a terminal, too")
    add_json(parser)


def execute(arguments: Namespace) -> int:
    """Verify, show differences, ask, execute, compare; the exit code is the verdict."""
    _check_options(arguments)
    # Progress goes to standard error, since a program reads the JSON from standard output.
    with redirect_stdout(sys.stderr) if arguments.json else nullcontext():
        facts = _replicate(arguments)
    if arguments.json:
        print_json(facts)
    return int(facts["exit_code"])


def _check_options(arguments: Namespace) -> None:
    chosen = arguments.environment
    if chosen not in (None, *_ENVIRONMENTS) and not program_in(Path(chosen).expanduser()).is_file():
        fix = did_you_mean(chosen, _ENVIRONMENTS)
        if Path(chosen).is_dir():
            fix = "Install robot-runner into it, or name another one."
        raise UsageError(f"there is no environment {chosen!r}", where="--environment", fix=fix)
    Bounds.parse(arguments.bound)


def _replicate(arguments: Namespace) -> dict[str, Any]:
    deviations = parse_assignments(arguments.set)
    arguments.package = arguments.package or only_package("replicate")
    with byte_progress("verifying") as progress:
        source = find_source(Path(arguments.package).expanduser(), progress)
    if imported_facts(source.manifest) is not None:
        problem = "there is no config: these results were made elsewhere"
        raise PackageError(problem, where=str(arguments.package), fix="Ask its authors for it.")
    target = Path(arguments.to or f"{_harmless(source.experiment)}_replication").expanduser().resolve()
    source.refuse_target(target)
    _refuse_name(deviations.get("experiment_name", source.experiment))
    robot = deviations.get("robot", original_settings(source.manifest).get("robot", source.manifest.get("robot")))
    differing = differing_environment(source.environment, robot=robot, manifest=source.manifest)
    print_plan(output(), source, differing, deviations, target, has_all=arguments.all_differences)
    facts = facts_of(arguments.package, source, differing, deviations)
    if arguments.environment == _CONTAINER:
        print_container(output(), source, _unpacked(source, target))
        return facts
    make_sure(source.kind, is_agreed=arguments.yes)
    own = arguments.environment
    if not own:
        is_own = source.is_sealed and wants_own_environment(differing, is_agreed=arguments.yes)
        own = _VENV if is_own else _HERE
    root = _unpacked(source, target)
    comparing = Comparing(root, target, arguments.bound, is_agreed=arguments.yes)
    if not arguments.without_verdict:
        comparing.prepare(is_simulated=str(robot or "").startswith("simulated"))
    if own == _HERE:
        code = _execute_here(arguments, root, target)
    else:
        code = _execute_elsewhere(arguments, source, root, target, own)
    facts |= {"environment": own, "exit_code": code}
    with read_or_not():
        return _ended(arguments, comparing, facts)


def _refuse_name(name: str) -> None:
    """Refuse an experiment whose results would be in a folder that a replication makes for itself."""
    if name in _FOLDERS:
        problem = f"the experiment is called {name!r}, as a folder that replications make is"
        fix = f"Give the replication another name: --set experiment_name={name}_again"
        raise PackageError(problem, where="experiment_name", fix=fix)


def _harmless(name: str) -> str:
    """Return an untrusted name without folders and control characters."""
    return re.sub(r"[^\w .-]", "_", Path(name).name)


def _unpacked(source: Source, target: Path) -> Path:
    with byte_progress("unpacking") as progress:
        return source.unpacked_below(target, progress)


def _execute_here(arguments: Namespace, root: Path, target: Path) -> int:
    """Execute the package's experiment in this environment; return the exit code of the execution."""
    with _no_traces(), kept_copies(ExperimentFolder.found_at(root).config, working_files(root, target)):
        replication = prepare_replication(root, target, parse_assignments(arguments.set))
        with _own_remedies():
            execution = execute_on_screen(replication.experiment, replication.findings, plain=arguments.plain)
    if execution.finished is not None:
        with read_or_not():
            print_verdict(output(), execution.finished, execution.progress)
    return execution.exit_code


#: The fixes of a replication instead of those that name options of `robot-runner run`.
_REMEDIES = {
    ACCEPT: "Have it be as it was when this replication was begun, or begin another: --to FOLDER.",
    "--table": "Restore run table and journal from a backup, or begin another replication: --to FOLDER.",
}


@contextmanager
def _own_remedies() -> Iterator[None]:
    """Replace fixes in errors that name options of `robot-runner run`."""

    def remedied(finding: Finding) -> Finding:
        own = next((fix for option, fix in _REMEDIES.items() if option in finding.fix), finding.fix)
        return replace(finding, fix=own)

    try:
        yield
    except RobotRunnerError as error:
        raise PackageError.of_findings(tuple(map(remedied, error.findings))) from error


def _execute_elsewhere(arguments: Namespace, source: Source, root: Path, target: Path, which: str) -> int:
    """Execute it by the program of another environment; the package's own environment is made first."""
    if which == _VENV:
        output().print("Making the environment of the package ...", style="bold")
        sys.stdout.flush()
        folder = target / "environment"
        program = make_environment(root, folder, source.environment)
        print_made_environment(output(), folder, source.environment)
    else:
        program = program_in(Path(which).expanduser().resolve())
    words = ["replicate", str(root), "--to", str(target), "--environment", _HERE, "--yes"]
    words += [word for each in arguments.set for word in ("--set", each)]
    words += ["--plain"] if arguments.plain else []
    sys.stdout.flush()
    return execute_with(program, words, quietly="--without-verdict", output=sys.stderr if arguments.json else None)


@contextmanager
def _no_traces() -> Iterator[None]:
    """Write no byte code beside the package's modules, in this process and its children."""
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


def _ended(arguments: Namespace, comparing: Comparing, facts: dict[str, Any]) -> dict[str, Any]:
    """Return the result, with the verdict if all runs were executed; otherwise print how to continue."""
    if arguments.without_verdict or facts["exit_code"] not in {0, SOME_FAILED}:
        return facts
    folder = replicated_folder(comparing.target, comparing.root, parse_assignments(arguments.set))
    is_complete = is_executed(folder)
    if is_complete:
        facts = comparing.end(folder, facts)
    if facts["exit_code"] == SOME_FAILED:
        words = ["replicate", arguments.package, "--to", shown_path(comparing.target)]
        words += [word for each in shown_assignments(arguments.set) for word in ("--set", each)]
        words += ["--environment", arguments.environment] if arguments.environment else []
        verdict = "" if is_complete else "The verdict comes once every run was executed. "
        output().print(f"{verdict}Go on with what is left: {command_line(*words)}", soft_wrap=True)
    return facts
