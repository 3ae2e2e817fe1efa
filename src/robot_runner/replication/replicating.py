"""Prepare the experiment of a package, or of an experiment's folder that was not packed, to be executed again."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from robot_runner.core.config.experiment import Experiment, extended_model
from robot_runner.core.config.original import Original, replicating
from robot_runner.core.config.preparation import prepare
from robot_runner.core.config.treatment_makers import known_treatments
from robot_runner.core.design.batches import EXTENDED, REPEATED, records_of
from robot_runner.core.errors import ConfigError, Finding, PackageError
from robot_runner.core.execution.given_values import given_elsewhere
from robot_runner.core.execution.left_systems import see_to_it_first, told_if_refused
from robot_runner.core.execution.recovered_table import with_later_batches
from robot_runner.core.execution.resumption import table_differences
from robot_runner.core.secret_names import REDACTED, hidden_settings, is_same_setting, shown_settings
from robot_runner.core.storage.declared_shapes import shape_findings
from robot_runner.core.storage.guarded_files import make_experiment_folder, sha256_of
from robot_runner.core.storage.input_files import copy_kept, let_programs_execute, missing_inputs, read_index
from robot_runner.core.storage.journal import Journal
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import last_execution, read_manifest
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.run_table_rows import RunTableRows, write_run_table
from robot_runner.core.storage.system_refusals import storage_errors
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.storage.table_schema import read_schema
from robot_runner.core.words import listed
from robot_runner.replication.contents import DESCRIPTION, SUMS
from robot_runner.replication.differences import missing_modules
from robot_runner.replication.distributions import canonical
from robot_runner.replication.opening import open_package, unpack
from robot_runner.replication.plain_zip import Progress
from robot_runner.replication.run_by_run import is_same_treatment
from robot_runner.replication.verification import Environment, refuse_faults, verify_package

_UNPACKED = "package"
#: Beside the unpacked package: copies of its input files, which may be written to.
_WORKING = "files"
#: A replication never takes its results folder, its cluster or the path of its registration from the original.
_NAME, _PATH, _CLUSTER, _REGISTRATION = "experiment_name", "results_output_path", "cluster", "registration"
#: At most so many differing values are named.
_NAMED = 8


@dataclass(frozen=True, slots=True)
class Source:
    """A package or folder that can be executed again.

    Attributes:
        path: the zip file or the folder.
        is_sealed: whether it has checksums; they were checked.
        experiment: the experiment's name.
        description: the package's description of itself; empty if it is not sealed.
        environment: the environment from the package or from the manifest.
        findings: the findings of verification, none of them an error.
    """

    path: Path
    is_sealed: bool
    experiment: str
    manifest: Mapping[str, Any]
    description: Mapping[str, Any]
    environment: Mapping[str, Any]
    findings: tuple[Finding, ...]

    @property
    def kind(self) -> str:
        """The noun for it in messages: package, or experiment if it is not sealed."""
        return "package" if self.is_sealed else "experiment"

    def refuse_target(self, target: Path) -> None:
        """Refuse a target inside the original, or one that is a file.

        Raises:
            PackageError: the target is inside the original, or is a file.
        """
        root = self.path.resolve()
        if target == root or root in target.parents:
            fix = "Name a folder outside of it with --to."
            raise PackageError("a replication cannot be written into its original", where=str(target), fix=fix)
        if target.exists() and not target.is_dir():
            raise PackageError("this is a file, not a folder", where=str(target), fix="Name another one with --to.")

    def unpacked_below(self, target: Path, progress: Progress) -> Path:
        """Return the folder that holds the original; a zip file is unpacked below `target`.

        Raises:
            PackageError: another package is there, the unpacked files were altered, or the disk is full.
            StorageError: the folder cannot be written.
        """
        if self.path.is_dir():
            return self.path.resolve()
        root = target / _UNPACKED
        was_there = root.exists()
        with open_package(self.path) as package:
            unpack(package, root, progress)
        with storage_errors(root, "written"):
            let_programs_execute(root / "config", root / "config")
        if was_there:
            with open_package(root) as package:
                refuse_faults(verify_package(package, progress))
        return root


def find_source(path: Path, progress: Progress) -> Source:
    """Open and verify a package or an experiment's folder; nothing is written, and none of its code is executed.

    Raises:
        PackageError: the package is not intact, or `path` is neither a package nor an experiment's folder.
        StorageError: a file cannot be read.
    """
    if path.is_dir() and not (path / DESCRIPTION).exists():
        manifest = read_manifest(ExperimentFolder.found_at(path).manifest)
        problem = "this is an experiment's folder and no package: nothing tells whether it was altered"
        finding = Finding.warning(str(path), problem, "Seal it: robot-runner pack")
        name = str(manifest.get("experiment_name", path.name))
        return Source(path, False, name, manifest, {}, _environment(path, manifest), (finding,))  # noqa: FBT003
    with open_package(path) as package:
        found = verify_package(package, progress)
    refuse_faults(found)
    environment = found.environment or _environment(path, found.manifest)
    return Source(path, True, found.experiment, found.manifest, found.description, environment, found.findings)  # noqa: FBT003


def _environment(path: Path, manifest: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the environment from the manifest, in the form of a package's `environment.json`.

    Raises:
        PackageError: the manifest's entries have the wrong shape.
    """
    software = manifest.get("software") or {}
    packages = {
        canonical(name): {"name": name, "version": release, "is_needed": True}
        for name, release in (software.get("packages") or {}).items()
    }
    known = {name: manifest.get(name) for name in ("robot", "ros", "host", "programs")}
    found = {"python": software.get("python"), "packages": packages, "system": software.get("system"), **known}
    fix = "Ask its authors for the original."
    PackageError.refuse(shape_findings(str(path), "a manifest", found, Environment, fix))
    return found


class Replication(NamedTuple):
    """An experiment of a package, ready to be executed again, and the findings of its validation."""

    experiment: Experiment
    findings: tuple[Finding, ...]


def original_settings(manifest: Mapping[str, Any]) -> dict[str, str]:
    """Return the settings of the original's last execution, except its results folder and its cluster."""
    executions = manifest.get("executions") or [manifest]
    settings = executions[-1].get("deviations") or {}
    return {str(name): str(text) for name, text in settings.items() if name not in {_PATH, _CLUSTER}}


def prepare_replication(root: Path, target: Path, deviations: Mapping[str, str]) -> Replication:
    """Load a package's config, which executes its code, and prepare its experiment.

    Args:
        root: the unpacked package, or an experiment's folder; verified, and accepted by the user.
        target: the folder in which the new experiment's folder is made.
        deviations: static parameters with values that differ from the original's.

    Raises:
        PackageError: a module is not installed, a file of the original is missing, another experiment is in the
            folder, or a deviation is not allowed.
        ConfigError: the config is refused; carries every finding.
        StorageError: a file cannot be read or written.
    """
    if given := deviations.keys() & {_PATH, _REGISTRATION}:
        fix = "Leave it out: results go below the folder of --to, and a registration is that of the original."
        raise PackageError("a replication takes no such setting", where=f"--set {min(given)}", fix=fix)
    files = ExperimentFolder.found_at(root)
    manifest = read_manifest(files.manifest)
    config = _config(files, manifest)
    with storage_errors(root, "read"):
        PackageError.refuse(missing_modules(root, manifest))
    # The config may make its name from the time, and a replication that goes on would be another one.
    named = {_NAME: str(manifest[_NAME])} if _NAME in manifest else {}
    settings = {_CLUSTER: "none", **named, **original_settings(manifest), **deviations, _PATH: str(target)}
    if files.registration.exists():
        settings[_REGISTRATION] = str(files.registration)
    _refuse_redacted(settings)
    facts = _facts(files, manifest, deviations)
    original = Original(
        run_table=files.run_table,
        treatments=facts["treatments"],
        seed=int(manifest["seed"]),
        seed_is_given=bool(manifest.get("seed_is_given")),
    )
    with replicating(original):
        preparation = prepare(config, settings, first=see_to_it_first)
    absent = list(missing_inputs(files.config))
    if preparation.experiment is None:
        raise ConfigError.of_findings([*preparation.findings, *absent])
    # Its cluster, name, results folder and the path of its registration do not count as deviations from the original.
    own = {_CLUSTER, _NAME, _PATH, _REGISTRATION} - deviations.keys()
    overrides = {name: text for name, text in settings.items() if name not in own}
    experiment = replace(preparation.experiment, replication=facts, overrides=overrides)
    with told_if_refused() as findings:  # what was done to a robot just now is told also where it is refused
        findings.extend([*preparation.findings, *absent])
        findings.extend([*_other_values(experiment, manifest, deviations), *_changed(files)])
        if experiment.folder.manifest.exists():
            _refuse_other(experiment, facts, deviations)
        else:
            experiment.model.take_seed(int(manifest["seed"]))
            experiment = _with_batches(experiment, files)
            findings.extend(_settle_table(experiment, files, manifest, has_deviations=bool(deviations)))
    return Replication(experiment, tuple(findings))


def _config(files: ExperimentFolder, manifest: Mapping[str, Any]) -> Path:
    name = (manifest.get("config") or {}).get("file")
    path = files.config / str(name)
    if not name or path.parent != files.config or not path.is_file():
        problem = f"the config {name} is missing" if name else "there is no config"
        raise PackageError(problem, where=str(files.config), fix="Ask its authors for it.")
    if "seed" not in manifest:
        raise PackageError("the manifest has no seed", where=str(files.manifest), fix="Ask its authors for it.")
    return path


def _refuse_redacted(settings: Mapping[str, str]) -> None:
    problem = "the value was replaced when the experiment was packed"
    replaced = (name for name, text in settings.items() if REDACTED in text)
    PackageError.refuse(Finding.error(f"--set {name}", problem, f"Give yours: --set {name}=...") for name in replaced)


def _facts(files: ExperimentFolder, manifest: Mapping[str, Any], deviations: Mapping[str, str]) -> dict[str, Any]:
    name, digest = _identity(files)
    return {
        "of": manifest.get("experiment_name"),
        "identified_by": name,
        "sha256": digest,
        "seed": manifest.get("seed"),
        "deviations": hidden_settings(deviations),
        "treatments": made_for(files),  # a branch may point at another commit by now
    }


def made_for(files: ExperimentFolder) -> dict[str, Any]:
    """Return the facts of the original's treatments, with the paths of the kept copies of their repositories."""
    known = known_treatments(files)
    for factor in _mappings_in(known.get("revisions")):
        for facts in _mappings_in(factor):
            if isinstance(kept := facts.get("kept"), str):
                facts["kept"] = str(files.revisions / kept)
    return known


def _mappings_in(value: object) -> list[dict[str, Any]]:
    """Return the values of a mapping that are mappings; a package from elsewhere may hold any values."""
    return [each for each in value.values() if isinstance(each, dict)] if isinstance(value, dict) else []


def _identity(files: ExperimentFolder) -> tuple[str, str]:
    """Return the name of the file that identifies the original, and its SHA-256."""
    sums = files.root / SUMS
    identity = sums if sums.is_file() else files.manifest
    return identity.name, sha256_of(identity)


def _other_values(
    experiment: Experiment, manifest: Mapping[str, Any], deviations: Mapping[str, str]
) -> Iterator[Finding]:
    """Yield a warning if the config reads other values from outside, such as the environment, than it did then."""
    if told := given_elsewhere(experiment, manifest, deviations):
        problem = f"what the config is given is not what the original was given: {listed(told, _NAMED)}"
        fix = "Have it be the same if results are to be compared: it may come from a variable of the environment."
        yield Finding.warning(experiment.config_path.name, problem, fix)


def _changed(files: ExperimentFolder) -> Iterator[Finding]:
    """Yield a warning if runs of the original were executed by another version of the config than the last one."""
    if files.earlier_configs.is_dir():
        problem = "the config was changed while the original was executed: runs that were done before are executed by "
        fix = f"See what changed before you judge differences: diff -r {files.earlier_configs}/1 {files.config}"
        yield Finding.warning(files.earlier_configs.name, f"{problem}its last version here", fix)


def _refuse_other(experiment: Experiment, facts: Mapping[str, Any], deviations: Mapping[str, str]) -> None:
    recorded = read_manifest(experiment.folder.manifest).get("replication") or {}
    if recorded.get("sha256") != facts["sha256"]:
        problem = "another experiment is in this folder"
        raise PackageError(problem, where=str(experiment.folder.root), fix="Name another folder with --to.")
    before = recorded.get("deviations") or {}
    if not _are_same(before, deviations):
        was = " ".join(f"--set {name}={text}" for name, text in shown_settings(before).items()) or "no --set"
        problem = f"this replication was begun with {was}"
        raise PackageError(problem, where=str(experiment.folder.root), fix="Go on with the same, or name another --to.")


def _settle_table(
    experiment: Experiment, files: ExperimentFolder, manifest: Mapping[str, Any], *, has_deviations: bool
) -> list[Finding]:
    """Make sure that the runs are the original ones; return a finding if the config plans others."""
    has_exclusions = files.schema.exists() and TableLayout.of_schema(read_schema(files.schema)).has_exclusions
    layout = replace(experiment.table_layout(), has_exclusions=has_exclusions)
    plan = experiment.model.plan(manifest["seed"])
    # Where the original was killed, the file may lack runs that were added last, and the journal has them.
    rows, _ = with_later_batches(files.run_table, plan, read_run_table(files.run_table, layout))
    same_ids = [run.run_id for run in plan] == [rows.run_id(place) for place in range(len(rows))]
    if (manifest.get("design") or {}).get("source") != "config":  # written by hand
        _put_table(experiment, rows)
        return []
    moved = {
        (run.run_id, name, str(there))
        for place, run in enumerate(plan if same_ids else ())
        for name, there in rows.combination(place).items()
        if is_same_treatment(there, run.combination.get(name), files.config)
    }
    if same_ids and not any(table_differences(files.run_table, plan, rows, moved)):
        return []
    if has_deviations:
        problem = "with what is set, the config plans other runs than those of the original"
        fix = "Leave --set out for the same runs."
    else:
        _put_table(experiment, rows)
        problem = "the config plans other runs here, or in another order: those of the original are executed"
        fix = "Look for what its create_run_table takes from chance or from the machine."
    return [Finding.warning(str(files.run_table), problem, fix)]


def _with_batches(experiment: Experiment, files: ExperimentFolder) -> Experiment:
    """Return the experiment with the original's later batches and repetitions, and write them to its journal.

    Raises:
        DesignError: the config lacks a treatment that runs of the original have.
    """
    model = extended_model(experiment.model, files)
    if not model.batches:
        return experiment
    make_experiment_folder(experiment.folder.root)
    with Journal(experiment.folder.journal) as journal:
        for fields in records_of(model.batches):
            if fields.get("batch", 1) > len(experiment.model.batches):  # else an earlier attempt has written it
                journal.append(EXTENDED if "batch" in fields else REPEATED, flush=True, **fields)
    return replace(experiment, model=model)


def _put_table(experiment: Experiment, rows: RunTableRows) -> None:
    """Write the original's runs as a run table by hand, all to be executed, also those that were excluded."""
    make_experiment_folder(experiment.folder.root)
    write_run_table(experiment.folder.run_table, rows.to_do_again())


def working_files(root: Path, target: Path) -> Path | None:
    """Return a folder with copies of the original's input files, made if it is missing; None without such files.

    Software under test may write to its input files, and the original must not change.

    Raises:
        StorageError: a file cannot be read or written.
    """
    files = ExperimentFolder.found_at(root)
    if not read_index(files.config):
        return None
    folder = target / f"{_WORKING}_{_identity(files)[1][:8]}"
    if not folder.exists():
        copy_kept(files.config, folder)
    return folder


def replicated_folder(target: Path, root: Path, deviations: Mapping[str, str]) -> Path:
    """Return the folder of a package's replication; of several, the one that was executed last.

    Args:
        target: the folder that contains it.
        root: the unpacked package, or the experiment's folder that was replicated.
        deviations: its deviations: the same package may have been replicated before with another name or path.

    Raises:
        PackageError: there is no such folder.
        StorageError: a file cannot be read.
    """
    digest = _identity(ExperimentFolder.found_at(root))[1]
    found = []
    for folder in sorted(each for each in target.iterdir() if each.resolve() != root.resolve()):
        path = ExperimentFolder.found_at(folder).manifest
        manifest = read_manifest(path) if path.is_file() else {}
        facts = manifest.get("replication") or {}
        if facts.get("sha256") == digest and _are_same(facts.get("deviations") or {}, deviations):
            found.append((str(last_execution(manifest).get("started_at")), folder))
    if not found:
        fix = "Repeat the command: what was executed before is kept."
        raise PackageError("the original was not executed again here", where=str(target), fix=fix)
    return max(found)[1]


def _are_same(before: Mapping[str, str], deviations: Mapping[str, str]) -> bool:
    return before.keys() == deviations.keys() and all(
        is_same_setting(before[name], deviations[name]) for name in before
    )
