"""Have experiments executed one after another, and let them wait for each other's robots and meters.

    queue add CONFIG [OPTIONS]  add an experiment, with options of `run`
    queue list [--json]         show what is in it, and who waits for whom
    queue drop NUMBER...        take them out; with --ended, all that ended
    queue run [NUMBER]          execute all or one; --stay waits for more

The queue is kept on the disk: `queue run` goes on after a restart. The first experiment begins whose robots and meters
are free; a second `queue run` beside the first executes another one at once. One that fails holds up no other.
"""

from __future__ import annotations

import argparse
import os
import sys
from argparse import Namespace
from collections.abc import Iterator
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from typing import Any

from robot_runner.cli.commands import run
from robot_runner.cli.console import command_line, output, print_json, quiet_loading, shown_path
from robot_runner.cli.findings import as_json, show_findings
from robot_runner.cli.guard import REFUSED
from robot_runner.cli.parser import Parser, UsageError, add_json
from robot_runner.cli.queued_experiments import ExperimentQueue, QueuedExperiment
from robot_runner.cli.queueing import NAMES_A_ROBOT, QueueRunner, awaited_by, digest_of, execute_queued, named
from robot_runner.core.config.claims import Claims, held_claims
from robot_runner.core.config.loader import parse_assignments
from robot_runner.core.config.preparation import prepare
from robot_runner.core.errors import Finding, StorageError, did_you_mean
from robot_runner.core.links.commanded_topics import MAY_BE_MOVING
from robot_runner.core.secret_names import shown_assignments

_WHERE = "robot-runner queue"


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "action",
        metavar="ACTION",
        nargs="?",
        default="list",
        help="add, list, drop or run",
        completer=lambda **_: action_parsers(),
    )
    parser.add_argument("words", metavar="WORDS", nargs=argparse.REMAINDER, help="what the action takes, as above")


def action_parsers() -> dict[str, Parser]:
    """Return a parser for each action."""
    listing = Parser("queue list", "Show what is in the queue, and who waits for whom.")
    add_json(listing)
    dropping = Parser("queue drop", "Take experiments out of the queue; their results stay.")
    dropping.add_argument("numbers", metavar="NUMBER", nargs="*", type=int, help="as `queue list` shows them")
    dropping.add_argument(
        "--ended", action="store_true", help="take out all that have ended, but those that may have left a robot moving"
    )
    running = Parser("queue run", "Execute what is in the queue, one experiment after another.")
    running.add_argument("number", metavar="NUMBER", nargs="?", type=int, help="execute this one alone")
    running.add_argument("--stay", action="store_true", help="wait for more where none is left")
    adding = Parser("queue add", "Add an experiment to the queue, with the options of `robot-runner run`.")
    run.add_arguments(adding)
    return {"add": adding, "list": listing, "drop": dropping, "run": running}


def execute(arguments: Namespace) -> int:
    """Do what is asked for with the queue."""
    parsers = action_parsers()
    if arguments.action not in parsers:
        fix = did_you_mean(arguments.action, parsers)
        raise UsageError(f"there is no action {arguments.action!r}", where=_WHERE, fix=fix)
    parser = parsers[arguments.action]
    given = parser.parse([word for word in arguments.words if word != "--debug"])  # which has done its work already
    match arguments.action:
        case "add":
            return _add(given, parser)
        case "list":
            return _list(is_json=given.json)
        case "drop":
            return _drop(given)
        case _:
            return _run(given)


# add


def _add(arguments: Namespace, parser: Parser) -> int:
    run.apply_shortcuts(arguments)
    refused = [*_refused_options(arguments)]
    with quiet_loading():
        preparation = prepare(Path(arguments.config), parse_assignments(arguments.set), looks_at_graph=False)
    experiment = preparation.experiment
    show_findings([*run.under_given_names(preparation.findings, arguments), *refused])
    if experiment is None or refused:
        return REFUSED
    arguments.set = run.settings_to_resume(arguments, experiment)
    config = str(Path(arguments.config).absolute())
    parameters = experiment.parameters
    queue = ExperimentQueue()
    added = queue.add(
        config=config,
        options=_options(arguments, parser),
        started_in=str(Path.cwd()),
        experiment=parameters.experiment_name,
        results=str(experiment.folder.root),
        claims=sorted(held_claims(Claims(parameters, experiment.plugins, experiment.events), experiment.model)),
        python=sys.executable,
        environment={name: os.environ[name] for name in NAMES_A_ROBOT if name in os.environ},
        config_sha256=digest_of(config),
    )
    awaited = awaited_by(queue, added, queue.read()[0])
    if arguments.json:
        print_json(_as_json(added, "waits", f"for {awaited or 'its turn'}"))
        return 0
    print(f"{named(added)} is in the queue{f'; it waits for {awaited}' if awaited else ''}")
    if not queue.is_attended:
        print("To execute what is in the queue: robot-runner queue run")
    return 0


def _refused_options(arguments: Namespace) -> Iterator[Finding]:
    """Yield why options cannot be kept, or not be repeated where a process is killed."""
    for given, shown in zip(arguments.set, shown_assignments(arguments.set), strict=True):
        if given != shown:
            fix = "Have the config read it from the environment or from a file of its own."
            yield Finding.error(_WHERE, f"--set {shown} is a secret, which is not kept in the queue", fix)
    if arguments.redo:
        problem = "--redo would execute these runs once more each time that the experiment is begun again after a kill"
        redo = chain.from_iterable(("--redo", runs) for runs in arguments.redo)
        by_hand = command_line("run", arguments.config, *redo, "--wait")
        yield Finding.error(_WHERE, problem, f"Execute it by hand: {by_hand}")


def _options(arguments: Namespace, parser: Parser) -> list[str]:
    """Return the options that were given, as words."""
    words: list[str] = []
    for action in parser.documented:
        given = getattr(arguments, action.dest, None)
        if not action.option_strings or not given or action.dest in {"workers", "cluster", "json"}:
            continue
        name = action.option_strings[0]
        values = given if isinstance(given, list) else [given]
        words += [name] if given is True else [f"{name}={each}" for each in values]
    return words


# list


def _list(*, is_json: bool) -> int:
    queue = ExperimentQueue()
    known, findings = queue.read()
    left = [each for each in known if not each.has_ended]
    states = {each.number: _state(each, queue, known) for each in known}
    if is_json:
        print_json(
            {
                "is_attended": queue.is_attended,
                "experiments": [_as_json(each, *states[each.number]) for each in known],
                "findings": as_json(findings),
            }
        )
        return 0
    show_findings(findings)
    console = output()
    for each in known:
        state, more = states[each.number]
        console.print(f"{each.number:>4}  {each.experiment}: {state}{f' {more}' if more else ''}", soft_wrap=True)
        console.print(f"      {shown_path(Path(each.config))}", style="dim", soft_wrap=True)
    if not known and not findings:
        print("The queue is empty. To add an experiment: robot-runner queue add CONFIG")
    elif left and not queue.is_attended and not any(queue.is_taken(each.number) for each in left):
        waiting = "1 experiment that waits" if len(left) == 1 else f"{len(left)} experiments that wait"
        print(f"To execute {waiting}: robot-runner queue run")
    return 0


def _state(queued: QueuedExperiment, queue: ExperimentQueue, known: list[QueuedExperiment]) -> tuple[str, str]:
    """Return the state of an experiment in one word, and details in others."""
    if queued.has_ended:
        how = "done" if queued.exit_code == 0 else "failed"
        return how, f"at {queued.ended_at}{f': {queued.problem}' if queued.problem else ''}"
    awaited = awaited_by(queue, queued, known)
    changed = _changed(queued)
    if queue.is_taken(queued.number) and not awaited:
        return "executed", f"since {queued.began_at}{changed}"
    return "waits", f"for {awaited or 'its turn'}, since {queued.added_at}{changed}"


def _changed(queued: QueuedExperiment) -> str:
    try:
        is_changed = digest_of(queued.config) != queued.config_sha256
    except StorageError as error:
        return f"; {error.problem}"
    return "; the config has changed since then" if is_changed else ""


def _as_json(queued: QueuedExperiment, state: str, more: str) -> dict[str, Any]:
    facts = asdict(queued)
    del facts["environment"], facts["python"]
    return {**facts, "state": state, "in_words": f"{state} {more}".rstrip()}


# drop


def _drop(arguments: Namespace) -> int:
    queue = ExperimentQueue()
    if arguments.ended and arguments.numbers:
        raise UsageError("--ended names all that have ended", where=f"{_WHERE} drop", fix="Leave one of them out.")
    if not (arguments.ended or arguments.numbers):
        raise UsageError("NUMBER is missing", where=f"{_WHERE} drop", fix="See `robot-runner queue list`.")
    ended = [each for each in queue.read()[0] if each.has_ended] if arguments.ended else []
    moving = [each.number for each in ended if each.may_have_left_a_robot_moving]
    for number in dict.fromkeys([*arguments.numbers, *(each.number for each in ended if each.number not in moving)]):
        queue.drop(number)
        print(f"{number} is out of the queue")
    for number in moving:
        look = f"look at it, then name it: robot-runner queue drop {number}"
        print(f"{number} stays in the queue: {MAY_BE_MOVING}; {look}")
    return 0


# run


def _run(arguments: Namespace) -> int:
    queue = ExperimentQueue()
    if arguments.number is not None:
        return execute_queued(queue, arguments.number)
    return QueueRunner(queue, stays=arguments.stay).execute()
