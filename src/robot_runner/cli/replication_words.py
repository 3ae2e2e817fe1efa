"""A replication in words: what will be executed and with what differences, and what came of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.text import Text

from robot_runner.cli.aligned import Column, aligned, width_of
from robot_runner.cli.console import UserConsole, shown_path
from robot_runner.cli.facts import print_facts, print_folded
from robot_runner.cli.findings import show_findings
from robot_runner.cli.wording import counted, one_line
from robot_runner.replication.preparing import original_settings
from robot_runner.replication.sameness import identical_values
from robot_runner.storage.safe_write import write_beside_and_rename

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from robot_runner.analysis.comparison.outcome import Comparison, MeasureComparison
    from robot_runner.replication.differences import Difference
    from robot_runner.replication.preparing import Replication
    from robot_runner.replication.sameness import Sameness
    from robot_runner.replication.source import Source

__all__ = ["print_container", "print_plan", "print_remaining", "print_verdicts"]

_MOST_LINES = 12
_STYLES = {"equivalent": "green", "different": "red", "undecided": "yellow"}


def print_plan(
    console: UserConsole, source: Source, differing: Sequence[Difference], deviations: Mapping[str, str], target: Path
) -> None:
    """Print what will be executed, and what differs from how it was."""
    manifest = source.manifest
    sealed = ("  verified: every file is as it was packed", "green") if source.is_sealed else ("  not sealed", "yellow")
    console.print(
        Text(one_line(source.experiment), style="bold").append(sealed[0], f"not bold {sealed[1]}"), soft_wrap=True
    )
    settings = original_settings(manifest)
    facts = [
        ("Executes", f"config/{(manifest.get('config') or {}).get('file')}, seed {manifest.get('seed')}"),
        ("As then", ", ".join(f"{name}={text}" for name, text in settings.items() if name not in deviations)),
        ("Deviates", ", ".join(f"{name}={text}" for name, text in deviations.items())),
        ("Replaced", _replaced(source)),
        ("Left out", ", ".join(str(each.get("name")) for each in source.description.get("left_out", ()))),
        ("Results", f"{shown_path(target)}/"),
    ]
    print_facts(console, [(what, one_line(text)) for what, text in facts])  # what a stranger wrote commands no terminal
    show_findings(source.findings) if source.findings else None
    _print_differences(console, differing, "This machine differs from the package's:", "package", "here")


def print_remaining(console: UserConsole, differing: Sequence[Difference]) -> None:
    """Print how the environment that was made differs from the package's."""
    if differing:
        _print_differences(console, differing, "The environment that was made differs:", "package", "made")
    else:
        console.print("It has what the package names: the same versions, and the same files where that is known.")


def print_container(console: UserConsole, commands: Sequence[str]) -> None:
    """Print the commands that build an image and replicate in it."""
    console.print()
    console.print("Build the image and replicate in it (docker takes the same words):", style="bold")
    for command in commands:
        console.print(f"  {command}", soft_wrap=True)


def print_verdicts(console: UserConsole, replication: Replication, target: Path, bound: Sequence[str]) -> None:
    """Compare the replication with its original; print the verdict on each measure, and write everything to a page.

    Raises:
        RobotRunnerError: they cannot be compared.
    """
    same = identical_values(replication.original, replication.experiment.folder.root)
    _print_identical(console, same)
    from robot_runner.analysis.comparison.comparing import compare  # noqa: PLC0415 - slow, and an extra
    from robot_runner.analysis.comparison.writing import (  # noqa: PLC0415 - slow, and an extra
        json_of_comparison,
        write_comparison,
    )

    comparison = compare(replication.original, replication.experiment.folder.root, bound=list(bound))
    write_beside_and_rename(target / "comparison.json", lambda file: file.write(json_of_comparison(comparison) + "\n"))
    write_comparison(comparison, target / "comparison.html")
    _print_table(console, comparison, same)
    print_facts(
        console,
        [
            ("Original", shown_path(replication.original)),
            ("Again", shown_path(replication.experiment.folder.root)),
            ("All of it", shown_path(target / "comparison.html")),
        ],
    )


def _replaced(source: Source) -> str:
    kinds = {str(each.get("what")) for each in source.description.get("replaced", ())}
    in_config = {str(each.get("name")) for each in source.description.get("replaced", ())}
    of_config = sorted(name for name in in_config if name.startswith("config/"))
    told = f" (in {', '.join(of_config)}, too: look whether it works without)" if of_config else ""
    return f"{', '.join(sorted(kinds))}{told}" if kinds else ""


def _print_differences(
    console: UserConsole, differing: Sequence[Difference], head: str, first: str, second: str
) -> None:
    if not differing:
        return
    console.print(head, style="bold")
    shown = [each for each in differing if not each.is_package] + [each for each in differing if each.is_package]
    rows = [[one_line(text) for text in (each.what, each.original, each.here)] for each in shown[:_MOST_LINES]]
    headings = ["", first, second]
    columns = [Column(name, width_of([name, *(row[place] for row in rows)])) for place, name in enumerate(headings)]
    console.print(f"  {aligned(columns, headings)}", style="dim", soft_wrap=True)
    for row in rows:
        console.print(f"  {aligned(columns, row)}", soft_wrap=True)
    if len(shown) > _MOST_LINES:
        console.print(f"  and {len(shown) - _MOST_LINES} more", style="dim")


def _print_identical(console: UserConsole, same: Mapping[str, Sameness]) -> None:
    if same and all(each.is_complete for each in same.values()):
        runs = max(each.runs for each in same.values())
        text = f"The results are identical: every value of {counted(runs, 'run')}, to the last digit."
        console.print(text, style="bold green")


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
    from robot_runner.analysis.comparison.wording import shown_bound  # noqa: PLC0415 - slow, and an extra

    if same is not None and same.is_complete:
        return "equivalent", f"Identical in all {counted(same.runs, 'run')}; the bound was {shown_bound(measure)}."
    return measure.verdict.value, measure.conclusion
