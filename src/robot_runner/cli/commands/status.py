"""Show how far an experiment is, also while it is executed.

It is told from what is on disk alone, so from any terminal.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator
from dataclasses import asdict
from shlex import quote
from typing import Any

from rich.text import Text

from robot_runner.cli.console import UserConsole, output, print_facts, print_json, shown_path
from robot_runner.cli.findings import as_json, print_odd, quality_in_words
from robot_runner.cli.parser import Parser, add_json, add_set, add_target
from robot_runner.cli.screens.plain import continue_command
from robot_runner.cli.target import target_or_only
from robot_runner.core.execution.experiment_history import Session
from robot_runner.core.execution.experiment_status import ExperimentStatus, questions_of, read_status
from robot_runner.core.words import counted, enumerated, one_line, shown_duration

_BAR = 30


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add_target(parser, is_the_only_one=True)
    add_set(parser)
    add_json(parser)


def execute(arguments: Namespace) -> int:
    """Print how far the experiment is."""
    status = read_status(target_or_only("status", arguments.target, arguments.set, takes_older=True).root)
    if arguments.json:
        print_json(_as_json(status))
    else:
        _print(output(), status)
    return 0


def _print(console: UserConsole, status: ExperimentStatus) -> None:
    console.print(Text(status.experiment_name, style="bold"), _bar(status))
    print_facts(
        console,
        [
            ("State", _state(status)),
            ("Runs", _counts(status)),
            ("Warm-up", _warm_ups(status)),
            ("Batches", _batches(status)),
            *_now(status),
            ("To do", _to_do(status)),
            ("Left", _left(status)),
            ("Waited", f"{shown_duration(status.gate_seconds)} at gates" if status.gate_seconds else ""),
            ("Quality", quality_in_words(status.bad_values)),
            ("Excluded", "; ".join(f"{run}: {reason}" for run, reason in status.excluded.items())),
            ("Repeated", status.repeated),
            ("Precision", "; ".join(status.precision)),
            ("Decided", status.decided),
            ("Order", status.order),
            ("Sessions", _sessions(status)),
            ("Started", status.sessions[0].started_at if status.sessions else status.started_at or ""),
            ("Resumed", status.sessions[-1].started_at if len(status.sessions) > 1 else ""),
            ("Chosen", _chosen(status)),
            ("Ended", status.finished_at or ""),
            ("Results", shown_path(status.folder)),
        ],
    )
    print_odd(console, failures=status.failures, findings=status.findings, run_ids=None)


def _bar(status: ExperimentStatus) -> Text:
    total = max(1, status.run_count)
    done = status.done * _BAR // total
    failed = -(-status.failed * _BAR // total)
    bar = Text("━" * min(done, _BAR - failed), style="green")
    bar.append("━" * failed, style="red")
    return bar.append("─" * (_BAR - len(bar)), style="dim")


def _now(status: ExperimentStatus) -> Iterator[tuple[str, str]]:
    """Yield the present activity: a line for each place, where there are several."""
    heading = "Now"
    for gate in status.gates:
        seen = f": {one_line(gate['seen'])}" if gate["seen"] else ""
        after = f"after {shown_duration(gate['seconds'])}, at {gate['at']}"
        yield heading, f"{gate['run']} waits until {one_line(gate['condition'])}{seen} ({after})"
        heading = ""
    places = len(status.in_flight) > 1
    for each in status.in_flight:
        place = f"{each.place}: " if places and each.place else ""
        yield heading, f"{place}{each.run}, {each.event or 'about to start'}"
        heading = ""


def _to_do(status: ExperimentStatus) -> str:
    if status.waiting_for is None:
        return ""
    place = f" ({status.waiting_for['place']})" if status.waiting_for["place"] else ""
    run = f"say that {status.waiting_for['next_run']}{place} may start"
    is_in = any(each.run == status.waiting_for["next_run"] for each in status.in_flight)
    when = "after" if status.waiting_for["is_after"] else "in" if is_in else "before"
    step = f"{status.waiting_for['step']}, {when} {status.waiting_for['next_run']}{place}"
    asked = ", ".join(question.asked for question in questions_of(status))
    return (step if status.waiting_for["step"] else run) + (f"; then tell {asked}" if asked else "")


def _left(status: ExperimentStatus) -> str:
    if status.seconds_left is None:
        return ""
    return f"{'at least' if status.left_is_least else 'about'} {shown_duration(status.seconds_left)}"


def _counts(status: ExperimentStatus) -> str:
    failed = f", {status.failed:,} failed" if status.failed else ""
    if status.lacks_plan:
        return f"{status.done:,} done{failed}; how many are planned is not known"
    return f"{status.done:,} of {counted(status.run_count, 'run')} done{failed}, {status.todo:,} to do"


def _warm_ups(status: ExperimentStatus) -> str:
    if not status.warm_ups:
        return ""
    are = "is a warm-up run" if status.warm_ups == 1 else "are warm-up runs"
    return f"{status.warm_ups:,} of these {are}, {status.warm_ups_done:,} done: kept, and not analysed"


def _batches(status: ExperimentStatus) -> str:
    sizes = enumerated(f"{runs:,}" for runs in status.batches)
    if status.batches and status.decided:
        return f"2, of {sizes} runs: the second one confirms what was found"
    return f"{len(status.batches)}, of {sizes} runs: the experiment was extended" if status.batches else ""


def _sessions(status: ExperimentStatus) -> str:
    """Return how the time was spent where it was in more than one go."""
    if len(status.sessions) < 2:  # noqa: PLR2004 - one is told by its start and end
        return ""
    executed = shown_duration(sum(session.seconds for session in status.sessions))
    ended = status.sessions if status.holder is None else status.sessions[:-1]
    broken = sum(not session.is_whole for session in ended)
    killed = f", {broken} of them broken off" if broken else ""
    return f"{len(status.sessions)}{killed}; {executed} in all"


def _chosen(status: ExperimentStatus) -> str:
    chosen = status.sessions[-1].selection if status.sessions else {}
    return " ".join(f"--{option} {quote(each)}" for option, several in chosen.items() for each in several)


_IMPORTED = "imported: the runs were executed elsewhere, and there is no config with which to go on"


def _state(status: ExperimentStatus) -> str:
    if status.is_of_older_tool or status.is_imported:
        older = "another tool began it; `robot-runner run` with its config goes on, `robot-runner import` adopts it"
        return _IMPORTED if status.is_imported else older
    if status.holder is None:
        if status.todo or status.failed or status.lacks_plan:
            return "not being executed; `robot-runner run` with its config resumes it"
        decides = f"; `robot-runner run` with its config decides {status.follows}" if status.follows else ""
        return f"all runs{' so far' if decides else ''} are done{decides}"
    who = f"process {status.holder.pid} on {status.holder.host}"
    to_go_on = continue_command(status.folder)
    if status.is_waiting_for_user:
        pause = "is paused" if status.is_paused else "pauses then" if status.pause_is_requested else ""
        beside = f"; {pause}, which {to_go_on} ends first" if pause else ""
        return f"waits for you ({who}): {continue_command(status.folder, questions_of(status))}{beside}"
    if status.is_paused:
        return f"is paused ({who}): {to_go_on}"
    after = f" and pauses before the next run (to take it back: {to_go_on})" if status.pause_is_requested else ""
    return f"is being executed by {who}{after}"


def _as_json(status: ExperimentStatus) -> dict[str, Any]:
    return {
        **{name: getattr(status, name) for name in status.__dataclass_fields__},
        "folder": str(status.folder),
        "bad_values": dict(status.bad_values),
        "excluded": dict(status.excluded),
        "holder": asdict(status.holder) if status.holder else None,
        "sessions": [_session_as_json(session) for session in status.sessions],
        "findings": as_json(status.findings),
        "in_flight": list(map(asdict, status.in_flight)),
        "gates": list(status.gates),
    }


def _session_as_json(session: Session) -> dict[str, Any]:
    told = {"started_at": session.started_at, "ended_at": session.ended_at, "seconds": session.seconds}
    return {**told, "is_whole": session.is_whole, "selection": dict(session.selection)}
