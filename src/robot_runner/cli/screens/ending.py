"""The summary at the end of an experiment: runs done and failed, place of the results, warnings, next steps."""

from __future__ import annotations

from pathlib import Path

from robot_runner.cli.console import UserConsole, command_line, print_facts, shown_path
from robot_runner.cli.findings import print_odd, quality_in_words
from robot_runner.cli.screens.progress import Progress
from robot_runner.core.execution.notices import ExperimentFinished
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.words import counted, listed, shown_duration

_UNMEASURED = {
    "simulated": "simulated, not measured",
    "estimated": "estimated, not measured",
    "entered by hand": "entered by hand",
}


def print_outcome(console: UserConsole, finished: ExperimentFinished, progress: Progress, *, command: str) -> None:
    """Print how an experiment ended; `command` executes it again."""
    print_verdict(console, finished, progress)
    following = _next(finished, progress, command)
    print_facts(console, [*whereabouts(finished, progress), ("Next", following)])


def print_verdict(console: UserConsole, finished: ExperimentFinished, progress: Progress) -> None:
    """Print how many runs are done, why others failed, and the warnings."""
    console.print()
    console.print(_verdict(finished, progress), style=f"bold {_colour(finished)}")
    print_odd(console, failures=finished.failures, findings=finished.findings, run_ids=progress.run_ids)


def whereabouts(finished: ExperimentFinished, progress: Progress) -> list[tuple[str, str]]:
    """Return where the results are, and which of them are not good or were not measured."""
    facts = [("Results", shown_path(finished.run_table))]
    runs = ExperimentFolder.found_at(finished.folder).runs
    if runs.is_dir() and any(runs.iterdir()):
        facts.append(("", f"{shown_path(runs)}/<run>/ has what the run printed, and its raw data"))
    if progress.gate_seconds >= 1:
        facts.append(("Waited", f"{shown_duration(progress.gate_seconds)} at gates"))
    if progress.bad_values:
        facts.append(("Quality", f"{quality_in_words(progress.bad_values)} (`robot-runner explain RUN` says why)"))
    if finished.excluded:
        facts.append(("Excluded", f"{listed(finished.excluded)} (`robot-runner explain RUN` says why)"))
    known = ((names, _UNMEASURED[origin]) for origin, names in progress.origins.items() if origin in _UNMEASURED)
    return facts + [("Origin", f"{', '.join(names)}: {how}") for names, how in known]


def _colour(finished: ExperimentFinished) -> str:
    if finished.failed_count:
        return "red"
    return "yellow" if finished.todo_count else "green"


def _verdict(finished: ExperimentFinished, progress: Progress) -> str:
    total = finished.done_count + finished.failed_count + finished.todo_count
    if finished.done_count == total and not progress.run_ids:
        return f"{_everything(total)} done before: nothing was executed."
    if finished.done_count == total:
        return f"{_everything(total)} done ({shown_duration(finished.seconds)})."
    stopped = f"Stopped by {finished.stopped_by}: " if finished.stopped_by else ""
    why = "Interrupted: " if finished.interrupted else stopped
    return (
        f"{why}{finished.done_count:,} of {counted(total, 'run')} done, {finished.failed_count:,} failed, "
        f"{finished.todo_count:,} to do ({shown_duration(finished.seconds)})."
    )


def _story_of_failure(finished: ExperimentFinished) -> Path:
    folder = ExperimentFolder.found_at(finished.folder)
    log = folder.log(finished.failed[0])
    return log if log.exists() else folder.journal  # it may have failed before its process could print


def _everything(total: int) -> str:
    return "The one run is" if total == 1 else f"All {total:,} runs are"


def _next(finished: ExperimentFinished, progress: Progress, command: str) -> str:
    if finished.failed_count:
        left = f"{finished.failed_count:,} failed, {finished.todo_count:,} to do"
        return f"look at {shown_path(_story_of_failure(finished))}, then execute what is left ({left}): {command}"
    if finished.todo_count:
        left = counted(finished.todo_count, "run")
        return f"go on with the {left} that {'is' if finished.todo_count == 1 else 'are'} left: {command}"
    if not progress.run_ids:
        return f"to execute it again beside these results: {command} --set experiment_name=..."
    report = command_line("report", shown_path(finished.folder))
    return f"for figures, tests and threats to validity: {report} (or run_table.csv in R or pandas)"
