"""Add runs to an experiment that has begun.

More repetitions, treatments or factors, as the config has them now or as is asked for here. What was executed stays.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator, Sequence
from pathlib import Path

from robot_runner.cli.console import command_line, output, print_facts, print_json, quiet_loading
from robot_runner.cli.design_words import (
    batch_as_json,
    batch_order_in_words,
    print_runs,
    run_as_json,
    warm_ups_in_words,
)
from robot_runner.cli.extension import Extension, ExtensionRequest, extend_experiment
from robot_runner.cli.findings import as_json, show_findings
from robot_runner.cli.parser import Parser, UsageError, add_config, add_json, add_set
from robot_runner.core.config.loader import parse_assignments
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.design.asking import decides_order
from robot_runner.core.design.batches import as_configured
from robot_runner.core.design.design_findings import is_seed
from robot_runner.core.design.extended_design import Additions, NewFactor
from robot_runner.core.secret_names import shown_assignments
from robot_runner.core.words import counted


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add_config(parser)
    add_set(parser)
    parser.add_argument(
        "--repetitions",
        metavar="TOTAL",
        type=int,
        help="how often each combination is to be executed in the end, what is done included",
    )
    parser.add_several("--treatments", "FACTOR=T1,T2", "further treatments of a factor")
    parser.add_several(
        "--factor",
        "NAME=DEFAULT:T1,T2",
        "a new factor: the treatment that the runs so far had, then the others, which may be left out where "
        "the config has them",
    )
    parser.add_argument(
        "--seed",
        metavar="SEED",
        type=int,
        help="the seed that the order of the new runs comes from; drawn if it is left out",
    )
    parser.add_argument(
        "--as-written", action="store_true", help="keep the new runs in the order of the config, not randomised"
    )
    parser.add_argument("--dry-run", action="store_true", help="show what would be added, and write nothing")
    parser.add_argument(
        "--accept-changes",
        action="store_true",
        help="go on though the config differs in more than create_run_table from what was executed before, or the run "
        "table from the plan",
    )
    add_json(parser)


def execute(arguments: Namespace) -> int:
    """Add the runs, or show them."""
    request = ExtensionRequest(
        added=Additions(arguments.repetitions, dict(_treatments(arguments)), dict(_factors(arguments))),
        seed=_checked_seed(arguments.seed),
        as_written=arguments.as_written,
        accept_changes=arguments.accept_changes,
        dry_run=arguments.dry_run,
    )
    with quiet_loading():
        experiment = prepare_or_refuse(Path(arguments.config), parse_assignments(arguments.set), is_for_here=False)
    extension = extend_experiment(experiment, request)
    if arguments.json:
        print_json(_as_json(extension, is_written=not request.dry_run))
        return 0
    show_findings(extension.findings)
    _print(extension, arguments)
    return 0


def _treatments(arguments: Namespace) -> Iterator[tuple[str, tuple[str, ...]]]:
    for text in arguments.treatments:
        name, treatments = _parts(text, "--treatments", "FACTOR=T1,T2", arguments.treatments)
        yield name, _listed(treatments)


def _factors(arguments: Namespace) -> Iterator[tuple[str, NewFactor]]:
    for text in arguments.factor:
        name, treatments = _parts(text, "--factor", "NAME=DEFAULT:T1,T2", arguments.factor)
        default, _, others = treatments.partition(":")
        yield name, NewFactor(default.strip(), _listed(others))


def _parts(text: str, option: str, form: str, given: Sequence[str]) -> tuple[str, str]:
    """Return the text before and behind the equals sign.

    Raises:
        UsageError: one of them is missing, or the same name is given twice.
    """
    name, _, value = (part.strip() for part in text.partition("="))
    if not name or not value:
        raise UsageError(f"{text!r} is not of the form {form}", where=option, fix=f"Write {option} {form}.")
    if sum(each.partition("=")[0].strip() == name for each in given) > 1:
        raise UsageError(f"{name!r} is given twice", where=option, fix="List everything behind one equals sign.")
    return name, value


def _listed(text: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))


def _checked_seed(seed: int | None) -> int | None:
    if seed is not None and not is_seed(seed):
        raise UsageError(f"{seed} is not a seed", where="--seed", fix="Give a whole number from 0.")
    return seed


def _print(extension: Extension, arguments: Namespace) -> None:
    console, batch, model = output(), extension.batch, extension.model
    print_runs(console, model, extension.runs)
    console.print()
    config = [arguments.config, *(word for each in shown_assignments(arguments.set) for word in ("--set", each))]
    command = command_line(*config)
    count = sum(len(each.run_ids) for each in model.batches)
    facts = [
        ("Batch", f"{batch.number}: {counted(len(batch.run_ids), 'run')}, {batch.run_ids[0]} to {batch.run_ids[-1]}"),
        ("Warm-up", warm_ups_in_words(model, extension.runs)),
        ("In total", f"{counted(count, 'run')}, {counted(batch.repetitions, 'repetition')} of each combination"),
        ("Count as", ", ".join(f"{name}={text} in the runs before" for name, text in batch.defaults.items())),
        ("Order", batch_order_in_words(batch)),
    ]
    if arguments.dry_run:
        again = "" if arguments.as_written else f", in this order with --seed {batch.order.seed}"
        if decides_order(as_configured(model).design):
            again = ", in this order"
        facts.append(("Written", f"nothing: the same command without --dry-run adds these runs{again}"))
    else:
        facts.append(("Next", f"execute them: {command}"))
    print_facts(console, facts)


def _as_json(extension: Extension, *, is_written: bool) -> dict[str, object]:
    return {
        **batch_as_json(extension.batch),
        "is_written": is_written,
        "run_count": sum(len(each.run_ids) for each in extension.model.batches),
        "new_runs": list(map(run_as_json, extension.runs)),
        "findings": as_json(extension.findings),
    }
