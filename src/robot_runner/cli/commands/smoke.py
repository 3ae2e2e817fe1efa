"""Execute one run of each treatment in a scratch folder, and say what that has proved.

Missions are shortened where a plugin, or `smoke = {...}` in the config, says how; rests, SEMI and restarts of hosts
are left out. The experiment's own folder is not touched. Exit codes as of `run`.
"""

from __future__ import annotations

import shutil
import tempfile
from argparse import Namespace
from collections.abc import Iterator, Mapping
from pathlib import Path

from robot_runner.cli.byte_code import no_byte_code
from robot_runner.cli.console import output, print_facts, quiet_loading, shown_path
from robot_runner.cli.executing import Execution, execute_on_screen, read_or_not
from robot_runner.cli.findings import print_odd, show_findings
from robot_runner.cli.guard import REFUSED
from robot_runner.cli.parser import Parser, add_config, add_set
from robot_runner.cli.planning import plan_of
from robot_runner.cli.smoke_test import (
    Shortening,
    SmokeResult,
    covering_runs,
    result_of,
    shortened_loader,
    study_estimate,
)
from robot_runner.core.config import preparation
from robot_runner.core.config.dialects import load_config
from robot_runner.core.config.loader import parse_assignments
from robot_runner.core.execution.durations import Estimate
from robot_runner.core.execution.resumption import Resumption
from robot_runner.core.words import counted, shown_duration


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add_config(parser)
    add_set(parser)
    parser.add_argument("--plain", action="store_true", help="print plain lines on a terminal, too")
    parser.add_argument("--keep", action="store_true", help="keep the scratch folder where all went well, too")


def execute(arguments: Namespace) -> int:
    """Execute the smoke test."""
    config, settings = Path(arguments.config), parse_assignments(arguments.set)
    folder = Path(tempfile.mkdtemp(prefix="robot-runner-smoke-"))
    code = 1
    try:
        code = _tested(config, settings, folder, plain=arguments.plain)
    finally:
        is_needed = (code not in {0, REFUSED} or arguments.keep) and any(folder.iterdir())
        if not is_needed:
            shutil.rmtree(folder, ignore_errors=True)
    if is_needed:
        with read_or_not():
            print_facts(output(), [("Kept", shown_path(folder))])
    return code


def _tested(config: Path, settings: Mapping[str, str], folder: Path, *, plain: bool) -> int:
    told = Shortening()
    with quiet_loading():
        study = plan_of(config, settings)
    with no_byte_code():
        prepared = preparation.prepare(config, settings, shortened_loader(load_config, folder, told))
    experiment = prepared.experiment
    if experiment is None:
        show_findings(prepared.findings)
        return REFUSED
    plan = list(experiment.model.plan())
    chosen = covering_runs([run for run in plan if not run.is_warm_up])
    warm_ups = tuple(run.run_id for run in plan if run.is_warm_up)  # with `only` alone, they come before these runs
    wanted = Resumption(only=tuple(run.run_id for run in chosen), skip=warm_ups)
    execution = execute_on_screen(experiment, prepared.findings, plain=plain, resumption=wanted)
    result = result_of(experiment, plan, chosen, told)
    estimate = study_estimate(study.durations, experiment, chosen, result, told) if study.durations else study.duration
    with read_or_not():
        _print(execution, result, told, estimate, len(chosen))
    return execution.exit_code


def _print(execution: Execution, result: SmokeResult, told: Shortening, estimate: Estimate, wanted: int) -> None:
    console, done = output(), len(result.seconds)
    console.print()
    each = "has" if wanted == 1 else "have"
    style = f"bold {'green' if done == wanted else 'red'}"
    console.print(f"{done} of {counted(wanted, 'run')} done, which {each} each treatment.", style=style)
    if execution.finished is not None:
        print_odd(console, failures=(), findings=execution.finished.findings, run_ids=execution.progress.run_ids)
    print_facts(console, _shown(result))
    facts = [("Not proved", each) for each in result.not_proved[:1]]
    facts += [("", each) for each in result.not_proved[1:]]
    took = f"{shown_duration(sum(result.seconds.values()) / done)} a run" if done else ""
    shortened = "; ".join([*told.parameters, *told.attributes])
    print_facts(console, [*facts, ("Shortened", shortened), ("Took", took), ("The study", str(estimate))])


def _shown(result: SmokeResult) -> Iterator[tuple[str, str]]:
    for name, treatments in result.treatments.items():
        yield "Executed", f"{name}: {', '.join(treatments)}"
    if result.with_values:
        yield "Measured", ", ".join(result.with_values)
    for name, treatments in result.without.items():
        yield "Not executed", f"{name}: {', '.join(treatments)}"
    for name, count in result.without_values.items():
        yield "No value", f"{name}, in {counted(count, 'run')}"
    for name, reason in result.doubtful.items():
        yield "Doubtful", f"{name}: {reason}"
    for run, reason in result.failures.items():
        yield "Failed", f"{run}: {reason}"
