"""Whether the runs of a replication yielded the very same values: what a deterministic simulation has to do."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from robot_runner.core.config.dialects import prepare
from robot_runner.core.errors import ConfigError, Finding, PackageError
from robot_runner.core.execution.recovery import table_differences
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.run_table_rows import write_run_table
from robot_runner.core.storage.safe_write import storage_error
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.storage.table_schema import read_schema
from robot_runner.replication.contents import SUMS
from robot_runner.replication.differences import lacking
from robot_runner.replication.redaction import REDACTED

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.storage.run_table_rows import RunTableRows

__all__ = ["Replication", "Sameness", "identical_values", "original_settings", "prepare_replication"]


# From a verified package to an experiment that executes the same runs in the same order from the same seed.

_PATH = "results_output_path"


@dataclass(frozen=True, slots=True)
class Replication:
    """An experiment of a package, ready to be executed again.

    Attributes:
        original: the folder of the experiment in the package.
        deviations: what was set by who replicates.
        findings: what validation had to say.
    """

    experiment: Experiment
    original: Path
    deviations: Mapping[str, str]
    findings: tuple[Finding, ...]


def original_settings(manifest: Mapping[str, Any]) -> dict[str, str]:
    """Return what was set by hand when the package's experiment was executed last, but for where its results went."""
    executions = manifest.get("executions") or [manifest]
    settings = executions[-1].get("deviations") or {}
    return {str(name): str(text) for name, text in settings.items() if name != _PATH}


def prepare_replication(root: Path, target: Path, deviations: Mapping[str, str]) -> Replication:
    """Load the config of a package and make the experiment of it that is to be executed. This executes its code.

    Args:
        root: the unpacked package, or an experiment's folder; verified, and agreed to by the user.
        target: the folder in which the new experiment's folder is made.
        deviations: static parameters that are to be other than they were.

    Raises:
        PackageError: something that it needs is not here, or another experiment is in the folder.
        ConfigError: the config is refused; carries every finding.
        StorageError: something cannot be read or written.
    """
    files = ExperimentFolder.found_at(root)
    manifest = read_manifest(files.manifest)
    config = _config(files, manifest)
    _refuse_lacking(root, manifest)
    settings = {**original_settings(manifest), **deviations, _PATH: str(target)}
    _refuse_redacted(settings)
    preparation = prepare(config, settings)
    if preparation.experiment is None:
        raise ConfigError.of_findings(preparation.findings)
    facts = _facts(files, manifest, deviations)
    # Where its results go is no deviation from the original.
    overrides = {name: text for name, text in settings.items() if name != _PATH}
    experiment = replace(preparation.experiment, replication=facts, overrides=overrides)
    findings = list(preparation.findings)
    if experiment.folder.manifest.exists():
        _refuse_other(experiment, facts)
    else:
        experiment.model.take_seed(int(manifest["seed"]))
        findings += _settle_table(experiment, files, manifest, has_deviations=bool(deviations))
    return Replication(experiment, root, deviations, tuple(findings))


def _config(files: ExperimentFolder, manifest: Mapping[str, Any]) -> Path:
    name = (manifest.get("config") or {}).get("file")
    path = files.config / str(name)
    if not name or path.parent != files.config or not path.is_file():
        problem = f"the config {name} is missing" if name else "it holds no config: these results were made elsewhere"
        raise PackageError(problem, where=str(files.config), fix="Ask its authors for it.")
    if "seed" not in manifest:
        raise PackageError("its manifest has no seed", where=str(files.manifest), fix="Ask its authors for it.")
    return path


def _refuse_lacking(root: Path, manifest: Mapping[str, Any]) -> None:
    try:
        findings = lacking(root, manifest)
    except OSError as error:
        raise storage_error(root, "read", error) from error
    if findings:
        raise PackageError.of_findings(findings)


def _refuse_redacted(settings: Mapping[str, str]) -> None:
    hidden = [name for name, text in settings.items() if REDACTED in text]
    if hidden:
        raise PackageError.of_findings(
            [
                Finding.error(
                    f"--set {name}", "its value was replaced when it was packed", f"Give yours: --set {name}=..."
                )
                for name in hidden
            ]
        )


def _facts(files: ExperimentFolder, manifest: Mapping[str, Any], deviations: Mapping[str, str]) -> dict[str, Any]:
    sums = files.root / SUMS
    identity = sums if sums.is_file() else files.manifest
    try:
        digest = hashlib.sha256(identity.read_bytes()).hexdigest()
    except OSError as error:
        raise storage_error(identity, "read", error) from error
    return {
        "of": manifest.get("experiment_name"),
        "identified_by": identity.name,
        "sha256": digest,
        "seed": manifest.get("seed"),
        "deviations": dict(deviations),
    }


def _refuse_other(experiment: Experiment, facts: Mapping[str, Any]) -> None:
    recorded = read_manifest(experiment.folder.manifest).get("replication") or {}
    if recorded.get("sha256") != facts["sha256"]:
        problem = "another experiment is in this folder"
        raise PackageError(problem, where=str(experiment.folder.root), fix="Name another folder with --to.")
    if recorded.get("deviations") != facts["deviations"]:
        was = " ".join(f"--set {name}={text}" for name, text in recorded.get("deviations", {}).items()) or "no --set"
        problem = f"this replication was begun with {was}"
        raise PackageError(problem, where=str(experiment.folder.root), fix="Go on with the same, or name another --to.")


def _settle_table(
    experiment: Experiment, files: ExperimentFolder, manifest: Mapping[str, Any], *, has_deviations: bool
) -> list[Finding]:
    """Make sure that the runs are the original ones; return what is to be said of it."""
    rows = read_run_table(files.run_table, experiment.table_layout())
    planned = list(experiment.model.plan(manifest["seed"]))
    by_hand = (manifest.get("design") or {}).get("source") != "config"
    is_same = [run.run_id for run in planned] == [rows.run_id(place) for place in range(len(rows))] and not any(
        table_differences(files.run_table, experiment.model.plan(manifest["seed"]), rows)
    )
    if is_same and not by_hand:
        return []
    where = str(files.run_table)
    if has_deviations and not by_hand:
        problem = "with what is set, the config plans other runs than those of the package"
        return [Finding.warning(where, problem, "Leave --set out for the same runs.")]
    _lay_table(experiment, rows)
    if by_hand:
        return []
    problem = "the config plans other runs here, or in another order: those of the package are executed"
    return [
        Finding.warning(where, problem, "Look for what its create_run_table takes from chance or from the machine.")
    ]


def _lay_table(experiment: Experiment, rows: RunTableRows) -> None:
    """Put the original's runs where a run table that was written by hand stands, all of them still to be executed."""
    for place in range(len(rows)):
        rows.clear(rows.run_id(place))
    folder = experiment.folder.root
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise storage_error(folder, "made", error) from error
    write_run_table(experiment.folder.run_table, rows)


@dataclass(frozen=True, slots=True)
class Sameness:
    """One measure in the runs that are done in both experiments.

    Attributes:
        runs: how many of them have a value in either.
        identical: in how many of these the two values are the same, to the last digit.

    Example:
        >>> Sameness(15, 15).is_complete
        True
    """

    runs: int
    identical: int

    @property
    def is_complete(self) -> bool:
        """Whether there are values, and all are the same."""
        return self.runs > 0 and self.identical == self.runs


def identical_values(original: Path, replication: Path) -> dict[str, Sameness]:
    """Compare the run tables of two experiments run by run, by the runs' ids.

    Returns:
        Each measure that both have.

    Raises:
        StorageError: a run table cannot be read.
    """
    ours, theirs = _rows(original), _rows(replication)
    pairs = [
        (place, other)
        for place in range(len(ours))
        if (other := theirs.place_of(ours.run_id(place))) is not None
        and ours.status(place) is theirs.status(other) is RunStatus.DONE
    ]
    return {
        name: _sameness(ours, theirs, name, pairs) for name in ours.layout.measures if name in theirs.layout.measures
    }


def _sameness(ours: RunTableRows, theirs: RunTableRows, name: str, pairs: list[tuple[int, int]]) -> Sameness:
    first_values, second_values = list(ours.values(name)), list(theirs.values(name))
    values = [(first_values[place], second_values[other]) for place, other in pairs]
    with_value = [pair for pair in values if pair != (None, None)]
    return Sameness(len(with_value), sum(first == second for first, second in with_value))


def _rows(folder: Path) -> RunTableRows:
    files = ExperimentFolder.found_at(folder)
    return read_run_table(files.run_table, TableLayout.of_schema(read_schema(files.schema)))
