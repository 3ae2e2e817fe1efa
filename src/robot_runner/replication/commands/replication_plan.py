"""Before a replication: print the plan and the differences, and ask for consent."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.text import Text

from robot_runner.cli.console import (
    Column,
    UserConsole,
    aligned,
    output,
    print_facts,
    print_folded,
    shown_path,
    width_of,
)
from robot_runner.cli.findings import show_findings
from robot_runner.cli.parser import UsageError
from robot_runner.cli.screens.plain import terminal_input
from robot_runner.core.errors import Finding
from robot_runner.core.secret_names import shown_settings
from robot_runner.core.words import counted, listed, one_line
from robot_runner.replication.container import container_commands, is_pinned
from robot_runner.replication.contents import config_of
from robot_runner.replication.differences import Difference, ranked, remaining_differences
from robot_runner.replication.replicating import Source, original_settings

#: Up to so many are named instead of counted.
_FEW = 5


def make_sure(kind: str, *, is_agreed: bool) -> None:
    """Ask at a terminal whether the code of the original, a package or an experiment, may be executed.

    Raises:
        UsageError: the user refuses, or there is no terminal.
    """
    if is_agreed:
        return
    where = "robot-runner replicate"
    if terminal_input() is None:
        fix = "Look at its config, then add --yes."
        raise UsageError(f"nobody can be asked whether the {kind}'s code may be executed", where=where, fix=fix)
    if not agrees(f"Execute the code of this {kind}? [y/N]", otherwise=False):
        raise UsageError("nothing was executed", where=where, fix="Look at its config first: robot-runner verify")


def agrees(question: str, *, otherwise: bool) -> bool:
    """Ask the user at the terminal; ENTER alone means `otherwise`."""
    answer = input(f"{question} ").strip().casefold()
    return answer in {"y", "yes"} or (otherwise and answer not in {"n", "no"})


def wants_own_environment(differing: Sequence[Difference], *, is_agreed: bool) -> bool:
    """Return whether to make the package's own environment, because packages that the experiment imports differ here.

    Args:
        differing: the differences.
        is_agreed: whether the user agreed to everything beforehand; otherwise the user is asked.
    """
    names = [one_line(each.what) for each in ranked(differing)[0] if each.is_package]
    if not names:
        return False
    because = f"as {listed(names)} {'differs' if len(names) == 1 else 'differ'} here"
    if is_agreed:
        output().print(f"The package's own environment is taken, {because} (--environment here: not).")
        return True
    return agrees(f"Make the package's own environment first, {because}? [Y/n]", otherwise=True)


def print_plan(
    console: UserConsole,
    source: Source,
    differing: Sequence[Difference],
    deviations: Mapping[str, str],
    target: Path,
    *,
    has_all: bool,
) -> None:
    """Print what will be executed, and the differences from the original.

    Args:
        console: prints it.
        source: the package.
        differing: the differences between its environment and this machine.
        deviations: the settings that deviate from the original.
        target: the folder for all files.
        has_all: whether to show all differing packages, also those that the experiment does not import.
    """
    manifest, settings = source.manifest, original_settings(source.manifest)
    sealed = ("verified: every file is as it was packed", "green") if source.is_sealed else ("not sealed", "yellow")
    head = Text(one_line(source.experiment), style="bold").append(f"  {sealed[0]}", f"not bold {sealed[1]}")
    console.print(head, soft_wrap=True)
    kept = {name: text for name, text in settings.items() if name not in deviations}
    facts = [
        ("Executes", f"{config_of(manifest)}, seed {manifest.get('seed')}"),
        ("As then", _settings_in_words(kept)),
        ("Deviates", _settings_in_words(deviations)),
        ("Replaced", _replaced(source)),
        ("Left out", ", ".join(str(each.get("name")) for each in source.description.get("left_out", ()))),
        ("Results", f"{shown_path(target)}/"),
    ]
    print_facts(console, [(what, one_line(text)) for what, text in facts])  # a stranger's text may hold escapes
    if source.findings:
        show_findings(source.findings)
    _print_differences(console, differing, f"This machine differs from the {source.kind}'s:", "here", has_all=has_all)


def print_made_environment(console: UserConsole, folder: Path, environment: Mapping[str, Any]) -> None:
    """Print the differences between a virtual environment and the package's list from which it was made."""
    differing = remaining_differences(folder, environment)
    if not differing:
        same = "the same versions, and the same files where that is known"
        console.print(f"The environment has what the package lists: {same}.")
    _print_differences(console, differing, "The environment that was made differs:", "made", has_all=False)


def print_container(console: UserConsole, source: Source, root: Path) -> None:
    """Print the commands that build an image and replicate in it."""
    image = source.description.get("base_image")
    if not (isinstance(image, str) and is_pinned(image)):
        problem = "no digest of its base image is known, so that it may change"
        fix = "`--build-arg BASE=NAME@sha256:...` pins it."
        show_findings([Finding.warning("Containerfile", problem, fix)])
    console.print()
    console.print("Build the image and replicate in it (docker takes the same words):", style="bold")
    for command in container_commands(source.experiment, shlex.quote(shown_path(root))):
        console.print(f"  {command}", soft_wrap=True)


def _settings_in_words(settings: Mapping[str, Any]) -> str:
    return ", ".join(f"{name}={text}" for name, text in shown_settings(settings).items())


def _replaced(source: Source) -> str:
    """Return the kinds of replaced secrets, with a hint if configs had some: they may not work without."""
    replaced = source.description.get("replaced", ())
    names = sorted({str(each.get("name")) for each in replaced if str(each.get("name")).startswith("config/")})
    advice = f" (in {', '.join(names)}, too: look whether it works without)" if names else ""
    return ", ".join(sorted({str(each.get("what")) for each in replaced})) + advice


def _print_differences(
    console: UserConsole, differing: Sequence[Difference], head: str, second: str, *, has_all: bool
) -> None:
    """Print the differences as a table: imported packages before the machine; other packages are counted."""
    if not differing:
        return
    console.print(head, style="bold")
    telling, rest = ranked(differing)
    shown = [*telling, *rest] if has_all else telling
    rows = [
        [one_line(text) for text in (each.what, each.original, each.here, listed(each.imported_by, shown=2))]
        for each in shown
    ]
    headings = ["", "original", second, "imported by" if any(each.imported_by for each in shown) else ""]
    columns = [Column(name, width_of([name, *(row[place] for row in rows)])) for place, name in enumerate(headings)]
    if rows:
        console.print(f"  {aligned(columns, headings)}", style="dim", soft_wrap=True)
    for row in rows:
        console.print(f"  {aligned(columns, row)}", soft_wrap=True)
    if rest and not has_all:
        named = listed((one_line(each.what) for each in rest), shown=_FEW) if len(rest) <= _FEW else ""
        what = f"{counted(len(rest), 'package')} that the experiment does not import itself"
        print_folded(console, "  and ", f"{what}: {named or '--all-differences shows them'}", style="")
