"""Preparing an experiment before its first run: its folder, its manifest, and its treatments."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.plugin_checks import check_plugins, check_treatments
from robot_runner.core.config.treatment_makers import Workshop, made_treatments
from robot_runner.core.design.asking import AdaptiveDesign
from robot_runner.core.design.batches import GrownRunTableModel, as_configured, described_design
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.revision import Revision
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import ExecutionError, Finding, StorageError
from robot_runner.core.execution.interruption import Interruption
from robot_runner.core.execution.manifest_content import (
    change_findings,
    kept_manifest,
    manifest_of,
    restored_manifest,
    resumed_manifest,
)
from robot_runner.core.execution.recovered_table import RecoveredTable
from robot_runner.core.execution.resumption import ACCEPT, Resumption, config_changes, selected_places
from robot_runner.core.execution.table_recovery import is_blank, recover_table
from robot_runner.core.storage.git_repository import refused_repository
from robot_runner.core.storage.guarded_files import make_experiment_folder, make_folder
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.lock import holder_of
from robot_runner.core.storage.manifest import is_damaged
from robot_runner.core.storage.system_refusals import fsync_folder, storage_errors
from robot_runner.core.treatments import factors_of
from robot_runner.core.words import counted, enumerated, listed


def made_folder(folder: ExperimentFolder) -> set[str]:
    """Make the folder of an experiment where it is not there; return the names of what runs have left in it.

    Raises:
        StorageError: it cannot be made.
    """
    with storage_errors(folder.root, "made"):
        make_experiment_folder(folder.root)
        if folder.runs != folder.root:
            make_folder(folder.runs, folder.root)
        left_behind = {path.name for path in folder.runs.iterdir()}
        fsync_folder(folder.root)
    return left_behind


def folder_findings(experiment: Experiment) -> tuple[Finding, ...]:
    """Return the errors for which an execution in this folder would be refused, else what is odd in a table by hand.

    Nothing is changed. There are no findings while it is executed, as its files change.
    """
    folder = experiment.folder
    try:
        if folder.root.exists() and holder_of(folder.lock) is None and not is_damaged(folder.manifest):
            manifest, _ = begun_manifest(experiment, accept_changes=False)
            if not is_blank(folder.run_table):  # such a one, as a damaged manifest, is made anew
                recovered = recover_table(experiment, manifest, Resumption())
                places = selected_places(recovered.rows, Resumption(), experiment.model.warm_up)
                refuse_unfit_treatments(experiment, manifest, recovered, places, accept_changes=False)
                return () if folder.manifest.exists() else recovered.findings
    except (ExecutionError, StorageError) as error:
        return error.findings
    return ()


def begun_manifest(experiment: Experiment, *, accept_changes: bool) -> tuple[dict[str, Any], tuple[Finding, ...]]:
    """Return the manifest of an experiment that starts or goes on, and findings on it.

    Raises:
        ExecutionError: the config differs from what was executed, and that is not accepted, or plans runs that the
            experiment does not have.
    """
    manifest, findings = _found(experiment, accept_changes=accept_changes)
    findings = (*findings, *refuse_unplanned(experiment, manifest))
    is_recorded = "repository" in manifest["executions"][-1]
    refused = None if is_recorded else refused_repository(experiment.config_path.parent)
    return manifest, findings if refused is None else (*findings, refused)


def _found(experiment: Experiment, *, accept_changes: bool) -> tuple[dict[str, Any], tuple[Finding, ...]]:
    if (restored := restored_manifest(experiment)) is not None:
        manifest, finding = restored
        return manifest, (finding,)
    if not experiment.folder.manifest.exists():
        manifest = manifest_of(experiment)
        return manifest, tuple(change_findings(experiment, manifest))
    manifest = kept_manifest(experiment)
    if not accept_changes and (changes := config_changes(experiment)):
        config, others = experiment.config_path, config_changes(experiment, of_design=False, of_settings=False)
        unplanned = unplanned_additions(config, experiment.model, manifest, has_other_changes=bool(others))
        raise ExecutionError.of_findings([*changes, *unplanned])
    manifest = resumed_manifest(experiment, manifest)
    return manifest, tuple(change_findings(experiment, manifest))


def refuse_unfit_treatments(
    experiment: Experiment,
    manifest: Mapping[str, Any],
    recovered: RecoveredTable,
    places: Iterable[int],
    *,
    accept_changes: bool,
) -> None:
    """Check that plugins can be built with the treatments of a table that was written or changed by hand.

    Raises:
        ExecutionError: one cannot be built.
    """
    by_hand = manifest["design"]["source"] != "config" or accept_changes
    if not by_hand or (not recovered.is_on_disk and not experiment.folder.run_table.exists()):
        return
    combinations = (recovered.rows.combination(place) for place in places)
    found = check_treatments(experiment.plugins, experiment.model, experiment.parameters.robot, combinations)
    ExecutionError.refuse(each for each in found if each.is_error)


def prepared_treatments(
    experiment: Experiment, known: Mapping[str, Any], interruption: Interruption, tell: Callable[[str], None]
) -> dict[str, Any]:
    """Make the treatments that have to be made (revisions are built), and return plain facts about them.

    The experiment's treatments are changed in place. `known` are the facts that this returned when it first began; a
    replication begins with the original's.

    Raises:
        RobotRunnerError: one cannot be made, or a plugin cannot use what was made.
        KeyboardInterrupt: the user has interrupted it.
    """
    known = known or (experiment.replication or {}).get("treatments", {})
    workshop = Workshop(experiment.folder.revisions, lambda: interruption.is_requested, tell)
    made = made_treatments(experiment.model.factors, known, workshop)
    if made:
        _refuse_unfit(experiment)
    return made


def _refuse_unfit(experiment: Experiment) -> None:
    """Check again the plugins that are bound to treatments made just now: they did not exist before."""
    names = {
        each.name for each in experiment.model.factors if any(isinstance(one, Revision) for one in each.treatments)
    }
    bound = [each for each in experiment.plugins if names.intersection(factors_of(each).values())]
    found = check_plugins(bound, experiment.model, experiment.parameters.robot)
    ExecutionError.refuse(each for each in found if each.is_error)


def refuse_unplanned(experiment: Experiment, manifest: Mapping[str, Any]) -> tuple[Finding, ...]:
    """Return the warnings of `unplanned_additions`.

    Raises:
        ExecutionError: the config plans more than the run table has, and an extension would add just that.
    """
    has_others = bool(config_changes(experiment, of_design=False, of_settings=False))
    found = unplanned_additions(experiment.config_path, experiment.model, manifest, has_other_changes=has_others)
    if any(each.is_error for each in found):
        raise ExecutionError.of_findings(found)
    return (*found, *_lost_treatments(experiment.config_path, experiment.model, manifest))


def _lost_treatments(config: Path, model: RunTableModel, manifest: Mapping[str, Any]) -> Iterator[Finding]:
    """Yield a warning for each factor of an extended experiment that has lost treatments in the config.

    Where treatments come from outside the config file, no changed line shows that. A plan that was not extended needs
    no warning: it differs from its run table.
    """
    for own, lost in _lost(model, manifest["design"]) if model.batches else ():
        if own.range is None:
            many = counted(len(lost), "treatment")
            problem = f"runs have {many} of {own.name} that the config does not plan any more: {listed(sorted(lost))}"
            fix = "They are executed as the run table has them; leave them out with robot-runner exclude."
            yield Finding.warning(f"{config}, create_run_table", problem, fix)


def _lost(model: RunTableModel, design: Mapping[str, Any]) -> Iterator[tuple[Factor, set[str]]]:
    """Yield each factor of the config that has lost treatments since the experiment was planned, and their texts."""
    chosen = _chosen(model)
    for own in as_configured(model).factors:
        if lost := set(design["factors"].get(own.name, ())).difference(own.texts, chosen.get(own.name, ())):
            yield own, lost


def _chosen(model: RunTableModel) -> Mapping[str, Sequence[str]]:
    """Return the treatments that came by extensions and not from the config, by factor."""
    return model.chosen if isinstance(model, GrownRunTableModel) else {}


def unplanned_additions(
    config: Path, model: RunTableModel, manifest: Mapping[str, Any], *, has_other_changes: bool = False
) -> tuple[Finding, ...]:
    """Return a finding where the config plans more than the experiment was planned with, which an extension would add.

    It is an error where the config only has more than before, and a warning where it also has less: then somebody
    changed the design, and accepted that the run table counts. `model` has the batches that there are. With
    `has_other_changes` the config has changed outside what makes the run table, too, which an extension has to be told
    to accept.
    """
    design = dict(manifest.get("design") or {})
    if model.batches:  # the journal has them, and an extension that broke off left the manifest behind
        design |= described_design(model)
    if design.get("source") != "config" or "factors" not in design:
        return ()
    now = as_configured(model)
    more = list(_more(now, design))
    if not more:
        return ()
    problem = f"the config plans more than the run table has: {enumerated(more)}"
    accepting = f" {ACCEPT}" if has_other_changes else ""
    fix = f"Add these runs: robot-runner extend {shown_config(config)}{accepting}. Or undo the change."
    if isinstance(now.design, AdaptiveDesign):
        fix = "A design that decides by results cannot be extended: undo the change, or choose another experiment_name."
    there, chosen = {factor.name for factor in now.factors}, _chosen(model)
    if gone := [repr(name) for name in design["factors"] if name not in there and name not in chosen]:
        problem += f"; and it has the {'factor' if len(gone) == 1 else 'factors'} {enumerated(gone)} no more"
        fix = "No extension renames a factor, or takes one away: undo the change, or choose another experiment_name."
    finding = Finding.warning if any(_lost(model, design)) else Finding.error
    return (finding(f"{config}, create_run_table", problem, fix),)


def _more(model: RunTableModel, design: Mapping[str, Any]) -> Iterator[str]:
    if model.repetitions > int(design.get("repetitions", 1)):
        before = int(design.get("repetitions", 1))
        yield f"{model.repetitions} repetitions of each combination instead of {before}"
    for factor in model.factors:
        known = design["factors"].get(factor.name)
        there = frozenset(known or ())
        new = [text for text in factor.texts if text not in there]
        if known is None:
            yield f"the factor {factor.name!r}"
        elif new:
            yield f"{counted(len(new), 'treatment')} of {factor.name} ({listed(new)})"


def shown_config(path: Path) -> str:
    """Return a path as it is named in a command of a shell: from the present folder, where it is below it."""
    return shlex.quote(str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path))
