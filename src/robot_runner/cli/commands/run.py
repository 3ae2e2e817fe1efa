"""Execute an experiment, or resume it.

Runs that are done are not executed again. Exit code 0: all runs are done; 1: some run failed; 2: refused;
130: interrupted.
"""

from __future__ import annotations

import re
import sys
from argparse import Namespace
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from robot_runner.cli.byte_code import no_byte_code
from robot_runner.cli.console import command_line, output, print_json
from robot_runner.cli.executing import Execution, execute_on_screen, page_beside, read_or_not
from robot_runner.cli.findings import as_json, show_findings
from robot_runner.cli.guard import REFUSED
from robot_runner.cli.parser import RUNS_HELP, Parser, UsageError, add_config, add_json, add_set
from robot_runner.cli.screens.ending import print_outcome
from robot_runner.cli.screens.plain import terminal_input
from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.loader import parse_assignments
from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import Finding, RobotRunnerError
from robot_runner.core.execution.left_systems import robots_left, see_to_it_first
from robot_runner.core.execution.resumption import Resumption, TableChoice, TableDisagreementError, config_changes
from robot_runner.core.secret_names import shown_assignments

#: What a name has where the time is a part of it: 2026, 12:30, 12-30.
_OF_TIME = re.compile(r"\d\d\D?\d\d")
#: Options that stand for a static parameter.
_SHORTCUTS = ("cluster", "workers")
#: The options that choose runs, and what becomes of those that are chosen.
_CHOICES = {
    "--only": "execute these runs alone",
    "--skip": "leave these runs for another time",
    "--first": "execute these runs before all others; the order of execution is recorded",
    "--redo": "execute these runs again though they are done or excluded; what they left is kept",
}


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add_config(parser)
    add_set(parser)
    for option, meaning in _CHOICES.items():
        parser.add_several(option, "RUNS", f"{meaning}: {RUNS_HELP}")
    parser.add_argument(
        "--accept-changes",
        action="store_true",
        help="go on though the config, the settings or the run table differ from what was executed before",
    )
    parser.add_argument(
        "--no-probe", action="store_true", help="do not try the profilers for a moment before the first run"
    )
    parser.add_argument(
        "--table",
        choices=[choice.value for choice in TableChoice],
        help="which one counts where run_table.csv and the journal disagree about executed runs: the journal "
        "(the file is kept beside), or the file (each change is recorded)",
    )
    parser.add_argument(
        "--workers",
        metavar="N|auto",
        help="how many runs this machine executes at the same time, or auto for as many as it has cores; the same as "
        "--set workers=N",
    )
    parser.add_argument(
        "--cluster",
        metavar="ADDRESS",
        help="execute the runs on the workers of a Dask cluster: the address of its scheduler, such as "
        "tcp://scheduler:8786 or tls://scheduler:8786; the same as --set cluster=ADDRESS",
    )
    parser.add_argument(
        "--wait",
        action="store_true",
        help="wait where another experiment has claimed the same robot or meter, instead of being refused",
    )
    parser.add_argument(
        "--page", action="store_true", help="serve a live page of the experiment meanwhile, on this machine alone"
    )
    parser.add_argument(
        "--page-at",
        metavar="ADDRESS[:PORT]",
        help="serve the live page there: 0.0.0.0 for phones in the same network; see `robot-runner watch`",
    )
    parser.add_argument("--plain", action="store_true", help="print plain lines on a terminal, too")
    add_json(parser)


def apply_shortcuts(arguments: Namespace) -> None:
    """Take options that stand for a static parameter as if given by `--set`.

    Raises:
        UsageError: the parameter is given by `--set`, too.
    """
    for name in _SHORTCUTS:
        if (given := getattr(arguments, name)) is not None:
            if name in parse_assignments(arguments.set):
                raise UsageError(f"--set {name} is given, too", where=f"--{name} {given}", fix="Leave one of them out.")
            arguments.set = [*arguments.set, f"{name}={given}"]


def settings_to_resume(arguments: Namespace, experiment: Experiment) -> list[str]:
    """Return the assignments of `--set` by which a later command means this experiment.

    Where the config makes its name or folder from the time, they are others then, and so among the assignments.
    """
    known = str(experiment.config_path)
    with suppress(OSError):
        known += experiment.config_path.read_text(encoding="utf-8", errors="replace")
    own = {name: str(getattr(experiment.parameters, name)) for name in ("experiment_name", "results_output_path")}
    made = (name for name, value in own.items() if any(each not in known for each in _OF_TIME.findall(value)))
    given = parse_assignments(arguments.set)
    return [*arguments.set, *(f"{name}={own[name]}" for name in made if name not in given)]


def under_given_names(findings: Sequence[Finding], arguments: Namespace) -> tuple[Finding, ...]:
    """Return findings on values of such options under the option's name, as the config is not the place to correct."""

    def named(finding: Finding) -> Finding:
        name = finding.where.removeprefix("--set ").partition("=")[0].rpartition(".")[2]
        is_given = name in _SHORTCUTS and getattr(arguments, name) is not None
        return replace(finding, where=f"--{name} {getattr(arguments, name)}") if is_given else finding

    return tuple(map(named, findings))


def execute(arguments: Namespace) -> int:
    """Execute every run that is not done."""
    if not arguments.json:
        return prepare_and_execute(arguments)[0]
    # What is told on the way is not what a program reads.
    with redirect_stdout(sys.stderr):
        try:
            code, facts = prepare_and_execute(arguments)
        except RobotRunnerError as error:
            show_findings(error.findings)
            code, facts = REFUSED, _refused(error.findings)
    with read_or_not():
        print_json({"config": arguments.config, "exit_code": code, **facts})
    return code


def prepare_and_execute(arguments: Namespace) -> tuple[int, dict[str, Any]]:
    """Prepare the experiment and execute it on a screen; return the exit code, and how it went as plain data."""
    apply_shortcuts(arguments)
    with no_byte_code():
        preparation = prepare(Path(arguments.config), parse_assignments(arguments.set), first=see_to_it_first)
    findings = under_given_names(preparation.findings, arguments)
    if preparation.experiment is None:
        findings = (*findings, *robots_left())  # nobody stops a robot now that a killed execution has left moving
        show_findings(findings)
        return REFUSED, _refused(findings)
    with _page(arguments, preparation.experiment):
        execution = _execute(arguments, preparation.experiment, findings)
    resuming = shown_assignments(settings_to_resume(arguments, preparation.experiment))
    settings = [word for each in resuming for word in ("--set", each)]
    command = command_line(arguments.config, *settings)
    with read_or_not():
        if execution.finished:
            print_outcome(output(), execution.finished, execution.progress, command=command)
    return execution.exit_code, _facts(preparation.experiment, execution)


@contextmanager
def _page(arguments: Namespace, experiment: Experiment) -> Iterator[None]:
    """Serve a live page meanwhile, if requested, and print its address."""
    if not arguments.page and arguments.page_at is None:
        yield
        return
    with page_beside(experiment.folder.root, arguments.page_at) as told:
        print(told, flush=True)
        yield


def _execute(arguments: Namespace, experiment: Experiment, findings: Sequence[Finding]) -> Execution:
    """Execute the experiment; if table and journal disagree, ask which of them counts, and execute it again."""
    resumption = Resumption(
        accept_changes=arguments.accept_changes or _changes_are_accepted(experiment),
        **{option[2:]: tuple(getattr(arguments, option[2:])) for option in _CHOICES},
        probe=not arguments.no_probe,
        table=TableChoice(arguments.table) if arguments.table else None,
    )

    on_screen = partial(
        execute_on_screen,
        experiment,
        findings,
        plain=arguments.plain or arguments.json,
        waits_for_claims=arguments.wait,
    )
    try:
        return on_screen(resumption=resumption)
    except TableDisagreementError as disagreement:
        chosen = _chosen_table(disagreement)
        if chosen is None:
            raise
        return on_screen(resumption=replace(resumption, table=chosen))


def _refused(findings: Sequence[Finding]) -> dict[str, Any]:
    return {"was_executed": False, "findings": as_json(findings)}


def _facts(experiment: Experiment, execution: Execution) -> dict[str, Any]:
    named = {"experiment": experiment.parameters.experiment_name, "folder": str(experiment.folder.root)}
    finished = execution.finished
    if finished is None:
        return {"was_executed": True, **named, "findings": as_json(execution.failure)}
    return {
        "was_executed": True,
        **named,
        "run_table": str(finished.run_table),
        "runs": {"done": finished.done_count, "failed": finished.failed_count, "to_do": finished.todo_count},
        "failed": list(finished.failed),
        "failures": list(finished.failures),
        "excluded": list(finished.excluded),
        "is_interrupted": finished.interrupted,
        "stopped_by": finished.stopped_by or None,
        "seconds": finished.seconds,
        "findings": as_json([*execution.failure, *finished.findings]),
    }


def _changes_are_accepted(experiment: Experiment) -> bool:
    """Ask at a terminal whether to go on though the config has changed since it was executed."""
    if terminal_input() is None or not (changes := config_changes(experiment)):
        return False
    show_findings(changes)
    sys.stderr.write("The config has changed since this experiment was executed. Go on with it as it is now? [y/N] ")
    sys.stderr.flush()
    return sys.stdin.readline().strip().casefold() in {"y", "yes"}


def _chosen_table(disagreement: TableDisagreementError) -> TableChoice | None:
    """Ask at a terminal whether table or journal counts; None if there is no answer."""
    if terminal_input() is None:
        return None
    show_findings(disagreement.findings)
    sys.stderr.write(
        "Which one counts: the journal of what was executed, or the run table on disk (file)? [journal/file/N] "
    )
    sys.stderr.flush()
    said = sys.stdin.readline().strip().casefold()
    return next((choice for choice in TableChoice if said and choice.value.startswith(said)), None)
