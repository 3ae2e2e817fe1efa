"""After a replication: compare its results with the original's, and print the verdict."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robot_runner.analysis.libraries import MissingLibraryError, require_libraries
from robot_runner.cli.console import UserConsole, output, print_facts, print_folded, shown_path
from robot_runner.cli.findings import show_findings
from robot_runner.core.errors import PackageError, RobotRunnerError, did_you_mean
from robot_runner.core.secret_names import shown_settings
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.storage.safe_write import write_beside_and_rename
from robot_runner.core.storage.table_schema import read_schema
from robot_runner.core.words import one_line
from robot_runner.replication.commands.replication_plan import agrees
from robot_runner.replication.run_by_run import Sameness, identical_values
from robot_runner.replication.verdicts import (
    Conclusion,
    ReplicationVerdict,
    margins_of,
    reached_verdict,
    why_not_primary,
)
from robot_runner.replication.virtual_environments import compare_with, is_complete, make_comparison_environment

if TYPE_CHECKING:
    from robot_runner.replication.differences import Difference
    from robot_runner.replication.replicating import Source

_STYLES = {
    Conclusion.IDENTICAL: "green",
    Conclusion.EQUIVALENT: "green",
    Conclusion.DIFFERENT: "red",
    Conclusion.UNDECIDED: "yellow",
}


def facts_of(
    package: str, source: Source, differing: Sequence[Difference], deviations: Mapping[str, str]
) -> dict[str, Any]:
    """Return the facts before the execution as plain data: without a verdict, and with exit code 0."""
    return {
        "package": package,
        "experiment": source.experiment,
        "is_sealed": source.is_sealed,
        "deviations": shown_settings(deviations),
        "differences": [asdict(each) for each in differing],
        "environment": None,
        "exit_code": 0,
        "verdict": None,
        "sentence": None,
        "measures": [],
    }


class Comparing:
    """The comparison of a replication with its original, in an environment with the libraries for it.

    Args:
        root: the unpacked package, or the experiment's folder that is replicated.
        target: the folder for all files.
        bounds: the values of `--bound`.
        is_agreed: whether libraries may be installed below `target` without asking.

    Raises:
        PackageError: a bound is for a measure that the original does not have.
        StorageError: the original cannot be read.
    """

    def __init__(self, root: Path, target: Path, bounds: Sequence[str], *, is_agreed: bool) -> None:
        self.root, self.target = root, target
        self._is_agreed = is_agreed
        files = ExperimentFolder.found_at(root)
        self._manifest = read_manifest(files.manifest)
        self._columns = read_schema(files.schema)
        self._secondary = why_not_primary(self._columns, self._manifest)
        for name in (each.rpartition("=")[0] for each in bounds if "=" in each):
            if name not in self._secondary:
                fix = did_you_mean(name, list(self._secondary))
                raise PackageError(f"there is no measure {name!r}", where="--bound", fix=fix)
        units = {each.name: each.unit for each in self._columns if each.name in self._secondary}
        self._margins = margins_of(units, self._manifest, bounds)

    def prepare(self, *, is_simulated: bool) -> None:
        """Make the environment for the statistics before a robot moves; a simulated experiment rarely needs it.

        Raises:
            PackageError: the environment cannot be made.
            StorageError: the environment cannot be written.
        """
        if not (is_simulated or _has_libraries()):
            self._environment()

    def end(self, replication: Path, facts: dict[str, Any]) -> dict[str, Any]:
        """Compare, print the verdict, and write it beside the results; this also works without statistics.

        Returns:
            The facts with the verdict.

        Raises:
            StorageError: the results cannot be read, or the verdict cannot be written.
        """
        same = identical_values(self.root, replication)
        try:
            comparison = self._comparison(replication, same)
        except RobotRunnerError as error:
            show_findings(error.findings)
            comparison = None
        verdict = reached_verdict(self._columns, self._manifest, same, self._margins, comparison)
        facts = facts | {
            "exit_code": facts["exit_code"] or verdict.conclusion.exit_code,
            "verdict": verdict.conclusion.value,
            "sentence": verdict.sentence,
            "measures": [{**asdict(each), "conclusion": each.conclusion.value} for each in verdict.measures],
            "original": str(self.root),
            "replication": str(replication),
        }
        text = json.dumps(facts, indent=2, ensure_ascii=False) + "\n"
        write_beside_and_rename(self.target / "verdict.json", lambda file: file.write(text))
        self._print(output(), replication, verdict, comparison)
        return facts

    def _comparison(self, replication: Path, same: Mapping[str, Sameness]) -> Mapping[str, Any] | None:
        """Return the result of the statistics as plain data; None if they are not needed, or the user declined."""
        # Texts have no bound; the comparison decides whether it compares them.
        bounded = {each.name for each in self._columns if each.type not in {"string", "any"}} & same.keys()
        bounds = [f"{name}={margin.text.strip()}" for name, margin in self._margins.items() if name in bounded]
        page, beside = self.target / "comparison.html", self.target / "comparison.json"
        if _has_libraries():
            text = _compared(self.root, replication, bounds, page)
        else:
            differ = [name for name, because in self._secondary.items() if not because and _differs(same.get(name))]
            program = self._environment() if differ else None
            if program is None:
                return None
            text = json.dumps(compare_with(program, self.root, replication, bounds, page), indent=2, ensure_ascii=False)
        write_beside_and_rename(beside, lambda file: file.write(text + "\n"))
        found: dict[str, Any] = json.loads(text)
        return found

    def _environment(self) -> Path | None:
        """Return the program of an environment with the libraries; None if the user declined to make one."""
        folder = self.target / "comparison_environment"
        question = f"Install what the comparison needs (the extra `analysis`) into {shown_path(folder)}? [Y/n]"
        if not is_complete(folder):
            if not (self._is_agreed or agrees(question, otherwise=True)):
                return None
            output().print("Making an environment for the comparison: minutes on a slow connection ...", style="bold")
        return make_comparison_environment(folder)

    def _print(
        self, console: UserConsole, replication: Path, verdict: ReplicationVerdict, comparison: Mapping[str, Any] | None
    ) -> None:
        console.print()
        paths = {"Original": self.root, "Again": replication, "Verdict": self.target / "verdict.json"}
        if comparison is not None:
            paths["All of it"] = self.target / "comparison.html"
        print_facts(console, [(what, shown_path(path)) for what, path in paths.items()])
        for note in (comparison or {}).get("notes", ()):
            print_folded(console, "  ! ", one_line(note), style="bold yellow")
        console.print()
        for each in verdict.measures:
            beside = f" It does not count: {each.secondary_because}." if each.secondary_because else ""
            print_folded(console, "  ", one_line(f"{each.sentence}{beside}"), style="")
        console.tell(one_line(verdict.sentence), style=f"bold {_STYLES[verdict.conclusion]}")


def _differs(same: Sameness | None) -> bool:
    return same is not None and same.runs > 0 and not same.is_same


def _has_libraries() -> bool:
    try:
        require_libraries()
    except MissingLibraryError:
        return False
    return True


def _compared(original: Path, replication: Path, bounds: Sequence[str], page: Path) -> str:
    """Compare with the libraries of this environment, and write the page."""
    from robot_runner.analysis.comparison.comparing import compare  # noqa: PLC0415 - slow, and an extra
    from robot_runner.analysis.comparison.comparison_document import json_of_comparison, write_comparison  # noqa: PLC0415 - as above

    comparison = compare(original, replication, bound=bounds or None)
    write_comparison(comparison, page)
    return json_of_comparison(comparison)
