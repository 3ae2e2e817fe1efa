"""Show how far an experiment is, also while it is executed.

It is told from what is on disk alone, so from any terminal.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from rich.text import Text

from robot_runner.cli.console import UserConsole, output, print_facts, print_json, shown_path
from robot_runner.cli.findings import as_json, print_odd, quality_in_words
from robot_runner.cli.parser import add_json, add_set, add_target
from robot_runner.cli.planning import folder_of_target
from robot_runner.core.execution.experiment_status import ExperimentStatus, read_status
from robot_runner.core.words import counted, enumerated

if TYPE_CHECKING:
    from argparse import Namespace

    from robot_runner.cli.parser import Parser

__all__ = ["add_arguments", "execute"]

_BAR = 30


def add_arguments(parser: Parser) -> None:
    """Add what the command takes."""
    add_target(parser)
    add_set(parser)
    add_json(parser)


def execute(arguments: Namespace) -> int:
    """Print how far the experiment is."""
    status = read_status(folder_of_target(arguments.target, arguments.set).root)
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
            ("Now", _now(status)),
            ("Quality", quality_in_words(status.bad_values)),
            ("Started", status.started_at or ""),
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


def _now(status: ExperimentStatus) -> str:
    if status.current_run is None:
        return ""
    return f"{status.current_run}, {status.current_event or 'about to start'}"


def _counts(status: ExperimentStatus) -> str:
    failed = f", {status.failed:,} failed" if status.failed else ""
    return f"{status.done:,} of {counted(status.run_count, 'run')} done{failed}, {status.todo:,} to do"


def _warm_ups(status: ExperimentStatus) -> str:
    if not status.warm_ups:
        return ""
    are = "is a warm-up run" if status.warm_ups == 1 else "are warm-up runs"
    return f"{status.warm_ups:,} of these {are}, {status.warm_ups_done:,} done: kept, and not analysed"


def _batches(status: ExperimentStatus) -> str:
    sizes = enumerated(f"{runs:,}" for runs in status.batches)
    return f"{len(status.batches)}, of {sizes} runs: the experiment was extended" if status.batches else ""


def _state(status: ExperimentStatus) -> str:
    if status.holder is None:
        if status.todo or status.failed:
            return "nobody executes it; `robot-runner run` with its config goes on"
        return "all runs are done"
    who = f"process {status.holder.pid} on {status.holder.host}"
    if status.is_waiting_for_user:
        return f"waits for you ({who}): robot-runner continue {shown_path(status.folder)}"
    return f"is being executed by {who}"


def _as_json(status: ExperimentStatus) -> dict[str, Any]:
    return {
        **{name: getattr(status, name) for name in status.__dataclass_fields__},
        "folder": str(status.folder),
        "holder": asdict(status.holder) if status.holder else None,
        "findings": as_json(status.findings),
    }
