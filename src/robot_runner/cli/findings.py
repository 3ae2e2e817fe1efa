"""Findings and errors as a user reads them: severity, place, problem, and beneath it how to mend it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.text import Text

from robot_runner.cli.console import complaints
from robot_runner.cli.wording import counted, one_line

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robot_runner.cli.console import UserConsole
    from robot_runner.errors import Finding, RobotRunnerError

__all__ = ["as_json", "print_findings", "show_error", "show_findings", "tally"]

_STYLES = {"error": "bold red", "warning": "bold yellow"}


def show_error(error: RobotRunnerError) -> None:
    """Print everything that an error found, to stderr."""
    show_findings(error.findings)


def show_findings(findings: Sequence[Finding]) -> None:
    """Print findings to stderr, errors first, and how many they are."""
    console = complaints()
    print_findings(console, findings)
    if len(findings) > 1:
        console.print(f"{tally(findings)}.", style="bold")


def print_findings(console: UserConsole, findings: Sequence[Finding]) -> None:
    """Print findings, errors first."""
    for finding in sorted(findings, key=lambda each: not each.is_error):
        head = Text()
        head.append(f"{finding.severity.value}: ", style=_STYLES[finding.severity.value])
        head.append(one_line(f"{finding.where}: {finding.problem}" if finding.where else finding.problem))
        console.print(head, soft_wrap=True)
        if finding.fix:
            console.print(Text("  fix: ", style="bold").append(one_line(finding.fix), style="not bold"), soft_wrap=True)


def tally(findings: Sequence[Finding]) -> str:
    """Return how many errors and warnings there are.

    Example:
        >>> from robot_runner.errors import Finding
        >>> tally([Finding.error("a", "b", "c"), Finding.warning("a", "b")])
        '1 error, 1 warning'
    """
    errors = sum(finding.is_error for finding in findings)
    parts = [counted(errors, "error"), counted(len(findings) - errors, "warning")]
    return ", ".join(part for part in parts if not part.startswith("0 "))


def as_json(findings: Sequence[Finding]) -> list[dict[str, str]]:
    """Return findings as plain data, errors first."""
    return [
        {
            "severity": finding.severity.value,
            "where": finding.where,
            "problem": finding.problem,
            "fix": finding.fix,
        }
        for finding in sorted(findings, key=lambda each: not each.is_error)
    ]
