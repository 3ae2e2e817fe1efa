"""What an experiment finds that goes on: its manifest, and treatments that were put into its table by hand."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robot_runner.core.config.plugin_checks import check_treatments
from robot_runner.core.errors import ExecutionError, Finding
from robot_runner.core.execution.circumstances import manifest_of, restored_manifest, resumed_manifest
from robot_runner.core.execution.extension import refuse_unplanned, unplanned_additions
from robot_runner.core.execution.recovery import config_changes
from robot_runner.core.storage.guarded_files import make_experiment_folder, make_folder
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.storage.system_refusals import fsync_folder, storage_error

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.execution.recovered_table import RecoveredTable
    from robot_runner.core.storage.layout import ExperimentFolder

__all__ = ["begun_manifest", "made_folder", "refuse_unfit_treatments"]


def made_folder(folder: ExperimentFolder) -> set[str]:
    """Make the folder of an experiment where it is not there; return the names of what runs have left in it.

    Raises:
        StorageError: it cannot be made.
    """
    try:
        make_experiment_folder(folder.root)
        if folder.runs != folder.root:
            make_folder(folder.runs, folder.root)
        left_behind = {path.name for path in folder.runs.iterdir()}
        fsync_folder(folder.root)
    except OSError as error:
        raise storage_error(folder.root, "made", error) from error
    return left_behind


def begun_manifest(experiment: Experiment, *, accept_changes: bool) -> tuple[dict[str, Any], tuple[Finding, ...]]:
    """Return the manifest of an experiment that starts or goes on, and what looks odd in it.

    Raises:
        ExecutionError: the config differs from what was executed, and that is not accepted, or plans runs that the
            experiment does not have.
    """
    manifest, findings = _found(experiment, accept_changes=accept_changes)
    return manifest, (*findings, *refuse_unplanned(experiment, manifest))


def _found(experiment: Experiment, *, accept_changes: bool) -> tuple[dict[str, Any], tuple[Finding, ...]]:
    lost = restored_manifest(experiment)
    if lost is not None:
        return lost.manifest, (lost.finding,)
    if not experiment.folder.manifest.exists():
        return manifest_of(experiment), ()
    manifest = read_manifest(experiment.folder.manifest)
    if not accept_changes and (changes := config_changes(experiment)):
        config, others = experiment.config_path, config_changes(experiment, of_design=False, of_settings=False)
        unplanned = unplanned_additions(config, experiment.model, manifest, has_other_changes=bool(others))
        raise ExecutionError.of_findings([*changes, *unplanned])
    return resumed_manifest(experiment, manifest), ()


def refuse_unfit_treatments(
    experiment: Experiment,
    manifest: Mapping[str, Any],
    recovered: RecoveredTable,
    places: Iterable[int],
    *,
    accept_changes: bool,
) -> None:
    """See that plugins can be built with the treatments of a table that was written or changed by hand.

    Args:
        experiment: what is executed.
        manifest: tells where the table comes from.
        recovered: the table.
        places: of the runs that are to be executed.
        accept_changes: whether the table may differ from the plan.

    Raises:
        ExecutionError: one of them cannot be.
    """
    by_hand = manifest["design"]["source"] != "config" or accept_changes
    if not by_hand or (not recovered.is_on_disk and not experiment.folder.run_table.exists()):
        return
    combinations = (recovered.rows.combination(place) for place in places)
    found = check_treatments(experiment.plugins, experiment.model, experiment.parameters.robot, combinations)
    refused = [finding for finding in found if finding.is_error]
    if refused:
        raise ExecutionError.of_findings(refused)
