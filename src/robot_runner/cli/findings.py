"""Findings as a user reads them: severity, place, problem and fix; the same finding of many runs is printed once."""

from __future__ import annotations

import importlib.util
import os
import re
import shlex
import sys
from collections.abc import Collection, Iterable, Mapping, Sequence

from rich.text import Text

from robot_runner.cli.console import UserConsole, complaints, print_folded
from robot_runner.core.errors import Finding, errors_first
from robot_runner.core.words import counted, listed, one_line

_STYLES = {"error": "bold red", "warning": "bold yellow"}


def show_findings(findings: Sequence[Finding]) -> None:
    """Print findings to stderr, errors first, and how many there are."""
    console = complaints()
    print_findings(console, findings)
    if len(findings) > 1:
        console.print(f"{tally(findings)}.", style="bold")


def print_findings(console: UserConsole, findings: Sequence[Finding]) -> None:
    """Print findings, errors first."""
    for finding in errors_first(findings):
        problem = f"{finding.where}: {finding.problem}" if finding.where else finding.problem
        severity = finding.severity.value
        print_folded(console, f"{severity}: ", one_line(problem), style=_STYLES[severity])
        if finding.fix:
            print_folded(console, "  fix: ", one_line(installed_here(finding.fix)), style="bold")


_ADDING = re.compile(r"(?<!-m )\bpip install (?='?robot-runner\[)")


def installed_here(fix: str) -> str:
    """Return a fix whose `pip install` adds the extra to this very environment, whichever tool has made it.

    A plain `pip` is that of the user's shell, which does not reach the environments of uv or pipx.
    """
    return _ADDING.sub(lambda _: _pip_install(), fix)


def _pip_install() -> str:
    python = shlex.quote(sys.executable)
    if importlib.util.find_spec("pip") is None:  # made by uv
        return f"uv pip install --python {python} "
    is_active = os.environ.get("VIRTUAL_ENV") == sys.prefix
    return "pip install " if is_active else f"{python} -m pip install "


def quality_in_words(bad: Mapping[str, Mapping[str, Sequence[str]]]) -> str:
    """Return which values are not good, by measure and quality.

    Example:
        >>> quality_in_words({"Energy": {"doubtful": ["r_1", "r_2"], "missing": ["r_3"]}})
        'Energy is doubtful in r_1, r_2, missing in r_3'
        >>> quality_in_words({"CPU": {"doubtful": ["r_1"]}, "Memory": {"doubtful": ["r_1"]}})
        'CPU, Memory are doubtful in r_1'
    """
    alike: dict[tuple[tuple[str, tuple[str, ...]], ...], list[str]] = {}
    for measure, by_quality in bad.items():
        alike.setdefault(tuple((quality, tuple(runs)) for quality, runs in by_quality.items()), []).append(measure)
    return "; ".join(
        f"{listed(names)} {'is' if len(names) == 1 else 'are'} "
        f"{', '.join(f'{quality} in {listed(runs)}' for quality, runs in qualities)}"
        for qualities, names in alike.items()
    )


def tally(findings: Sequence[Finding]) -> str:
    """Return how many errors and warnings there are.

    Example:
        >>> from robot_runner.core.errors import Finding
        >>> tally([Finding.error("a", "b", "c"), Finding.warning("a", "b")])
        '1 error, 1 warning'
    """
    errors = sum(finding.is_error for finding in findings)
    parts = [counted(errors, "error"), counted(len(findings) - errors, "warning")]
    return ", ".join(part for part in parts if not part.startswith("0 "))


def as_json(findings: Sequence[Finding]) -> list[dict[str, str]]:
    """Return findings as plain data, errors first."""
    return [
        {"severity": finding.severity.value, "where": finding.where, "problem": finding.problem, "fix": finding.fix}
        for finding in errors_first(findings)
    ]


_NUMBER = re.compile(r"\d+(?:[.,]\d+)*")
_PLANNED_ID = re.compile(r"[rw]_\d+")
_MOST = 8


def print_odd(
    console: UserConsole, *, failures: Sequence[str], findings: Sequence[Finding], run_ids: Collection[str] | None
) -> None:
    """Print why runs failed, a line each, and the warnings; without `run_ids`, ids are recognised by their form."""
    reasons = _reasons(failures)
    for reason in reasons[:_MOST]:
        print_folded(console, "  ✗ ", one_line(reason), style="bold red")
    if len(reasons) > _MOST:
        more = counted(len(reasons) - _MOST, "more reason")
        console.print(Text(f"  ✗ {more}: journal.jsonl has them all", style="red"))
    groups = grouped(findings, run_ids)
    for text, fix in groups[:_MOST]:
        print_folded(console, "  ! ", one_line(text), style="bold yellow")
        if fix:
            print_folded(console, "    ", one_line(installed_here(fix)), style="")
    if len(groups) > _MOST:
        more = counted(len(groups) - _MOST, "more finding")
        console.print(Text(f"  ! {more}: journal.jsonl has them all", style="yellow"))


def _reasons(failures: Sequence[str]) -> list[str]:
    """Return why runs failed, each reason once with its runs."""
    runs_by_reason: dict[str, list[str]] = {}
    for failure in failures:
        run_id, _, reason = failure.partition(": ")
        runs_by_reason.setdefault(reason, []).append(run_id)
    return [f"{listed(runs)}: {reason}" for reason, runs in runs_by_reason.items()]


def grouped(findings: Iterable[Finding], run_ids: Collection[str] | None) -> list[tuple[str, str]]:
    """Return each finding's text and fix; findings that differ only in run and numbers, or in the owner, become one.

    Example:
        >>> from robot_runner.core.errors import Finding
        >>> grouped([Finding.warning(f"r_{n}, Ina219", f"{n} samples lost") for n in (1, 2)], None)
        [('Ina219: 1 samples lost, and the like (in r_1, r_2)', '')]
        >>> grouped([Finding.warning(f"r_1, {owner}", "swap was used") for owner in ("PsUtil", "Rapl")], None)
        [('PsUtil, Rapl: swap was used (in r_1)', '')]
    """
    groups: dict[tuple[str, str, str], list[tuple[str, Finding]]] = {}
    for finding in findings:
        run_id, place = _split(finding.where, run_ids)
        groups.setdefault((place, _NUMBER.sub("#", finding.problem), finding.fix), []).append((run_id, finding))
    places: dict[tuple[str, str], list[str]] = {}
    for (place, _, fix), members in groups.items():
        places.setdefault((_text(members), fix), []).append(place)
    return [
        (f"{listed(filter(None, owners))}: {text}" if any(owners) else text, fix)
        for (text, fix), owners in places.items()
    ]


def _split(where: str, run_ids: Collection[str] | None) -> tuple[str, str]:
    head, _, rest = where.partition(", ")
    is_run = head in run_ids if run_ids is not None else _PLANNED_ID.fullmatch(head) is not None
    return (head, rest) if is_run else ("", where)


def _text(members: Sequence[tuple[str, Finding]]) -> str:
    problem = members[0][1].problem
    alike = "" if all(finding.problem == problem for _, finding in members) else ", and the like"
    runs = list(dict.fromkeys(run_id for run_id, _ in members if run_id))
    where = f" (in {listed(runs)})" if runs else ""
    return f"{problem}{alike}{where}"
