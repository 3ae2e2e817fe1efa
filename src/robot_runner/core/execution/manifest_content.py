"""The content of the manifest, by which others judge and repeat an experiment; and copies of its files."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.local_modules import editable_code
from robot_runner.core.design.batches import as_configured, described_design
from robot_runner.core.design.precision import rules_as_mapping
from robot_runner.core.entry_points import EntryPoint
from robot_runner.core.errors import ExecutionError, Finding, PluginError, StorageError
from robot_runner.core.execution.given_values import changed_values, given_values, is_from_file, is_reordered
from robot_runner.core.execution.resumption import config_files
from robot_runner.core.plugin import Plugin, described_circumstances, installed_plugins
from robot_runner.core.secret_names import hidden_settings
from robot_runner.core.storage.git_repository import LARGEST_DIFF, repository_state, uncommitted_changes
from robot_runner.core.storage.guarded_files import MissingFileError, make_folder, read_bytes, replace
from robot_runner.core.storage.input_files import kept_contents, let_programs_execute
from robot_runner.core.storage.journal import read_journal, utc_now
from robot_runner.core.storage.layout import members_in, next_in
from robot_runner.core.storage.manifest import (
    describe_host,
    describe_software,
    installed_packages,
    installed_system_packages,
    is_damaged,
    read_manifest,
)
from robot_runner.core.storage.system_refusals import storage_errors
from robot_runner.core.treatments import factors_of
from robot_runner.core.words import listed


def manifest_of(experiment: Experiment) -> dict[str, Any]:
    """Return the manifest of an experiment that is executed for the first time."""
    model = experiment.model
    by_hand = experiment.folder.run_table.exists()
    return {
        **described_circumstances(),  # first, so that none of them takes the place of what follows
        "experiment_name": experiment.parameters.experiment_name,
        "config": _config(experiment),
        # What was set from outside the config file: a replication has to know.
        "deviations": hidden_settings(experiment.overrides),
        "robot": experiment.parameters.robot,
        **({"robots": dict(robots)} if (robots := experiment.parameters.robots) else {}),
        "design": {"source": "run_table.csv" if by_hand else "config", **described_design(model)},
        "seed": model.seed,
        "seed_is_given": model.seed_is_given,
        # What was fixed for the analysis before the first run: statistics tell it from what is exploratory.
        "analysis": _analysis(experiment),
        "registration": experiment.registration.facts() if experiment.registration is not None else None,
        "repeat_until": _repeat_until(experiment),
        "authors": [author.as_mapping() for author in experiment.parameters.authors],
        "licence": experiment.parameters.licence,
        "citation": experiment.parameters.citation,
        # Where this experiment executes a package again: which one, and what was changed on purpose.
        "replication": dict(experiment.replication) if experiment.replication else None,
        "plugins": [_described(plugin) for plugin in experiment.plugins],
        "host": describe_host(),
        "software": describe_software() | {"editable_code": editable_code()},
        "executions": [_execution(experiment)],
    }


def _config(experiment: Experiment) -> dict[str, str]:
    # A class from a notebook has no file of its own: what was kept of it is said.
    kept = {} if experiment.kept == "file" else {"kept": experiment.kept}
    return {"file": experiment.config_path.name, "class": experiment.class_name, **kept}


#: What a resumed experiment is compared with.
_NEEDED = {"design", "executions", "experiment_name", "seed"}
_NEEDED_OF_DESIGN = {"factors", "repetitions", "source"}


def kept_manifest(experiment: Experiment) -> dict[str, Any]:
    """Read the manifest in the folder of an experiment that has begun.

    Raises:
        StorageError: it cannot be read.
        ExecutionError: the folder holds another experiment.
    """
    manifest = read_manifest(experiment.folder.manifest)
    if manifest.keys() >= _NEEDED and manifest["design"].keys() >= _NEEDED_OF_DESIGN and manifest["executions"]:
        return manifest
    problem = "the manifest in this folder was not written by Robot Runner"
    fix = "Choose another experiment_name or results_output_path."
    raise ExecutionError(problem, where=str(experiment.folder.manifest), fix=fix)


def resumed_manifest(experiment: Experiment, manifest: dict[str, Any]) -> dict[str, Any]:
    """Return the manifest of a resumed experiment, with the present execution added."""
    # The user has accepted these changes: the manifest tells them with this execution.
    others = {"changed_values": values} if (values := changed_values(experiment, manifest)) else {}
    manifest["executions"].append(_execution(experiment) | {"changed": changed_circumstances(manifest)} | others)
    manifest.pop("given_to_extension", None)
    manifest["config"] = _config(experiment)  # the file may have another name by now, and is kept by it
    # Values of plugins that are gone by now are in the table.
    known = {each.get("name"): each for each in manifest.get("plugins") or ()}
    manifest["plugins"] = list((known | {each.name: _described(each) for each in experiment.plugins}).values())
    if robots := experiment.parameters.robots:  # others than before may have been accepted
        manifest["robots"] = {**(manifest.get("robots") or {}), **robots}
    if experiment.model.batches:  # the journal has them, and an extension that broke off left the manifest behind
        manifest["design"] |= described_design(experiment.model)
    if _analysis(experiment) != manifest.get("analysis"):
        manifest.setdefault("analysis_changes", []).append({"at": utc_now(), "analysis": _analysis(experiment)})
    now = experiment.registration.facts() if experiment.registration is not None else None
    changes = manifest.get("registration_changes") or [{}]
    if now not in (None, manifest.get("registration"), changes[-1].get("registration", {})):
        manifest.setdefault("registration_changes", []).append({"at": utc_now(), "registration": now})
    if (rule := _repeat_until(experiment)) != manifest.get("repeat_until"):
        manifest.setdefault("repeat_until_changes", []).append({"at": utc_now(), "was": manifest.get("repeat_until")})
        manifest["repeat_until"] = rule
    return manifest


#: Facts of the host that influence measures. Its memory is left out: the number of bytes changes with each kernel.
_OF_HOST = ("processor", "machine", "cores", "system", "release", "governor")
#: A finding names at most so many changes.
_NAMED = 8


def changed_circumstances(manifest: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the circumstances that differ from those of the first execution in the manifest: `was` and `is`, by name.

    A part that the manifest lacks, as an earlier version wrote it, counts as unchanged.
    """
    host, software, code = describe_host(), describe_software(), editable_code()
    first, then = manifest.get("host") or {}, manifest.get("software") or {}
    pairs = [
        *((name, first[name], host[name]) for name in _OF_HOST if name in first),
        *((name, then[name], software[name]) for name in ("python", "robot_runner") if name in then),
        *_package_pairs(then, software["packages"], software["system_packages"]),
        *_pairs("code of package", _common(then.get("editable_code"), code), code),
        *_described_pairs(manifest),
    ]
    return {name: {"was": was, "is": now} for name, was, now in pairs if was != now}


def replaced_packages(path: Path, manifest: dict[str, Any]) -> Iterator[Finding]:
    """Yield a warning where packages were replaced since the present execution began, and add them to its changes.

    Runs may have had either version: a process that has begun keeps the modules that it imported, and no others.
    """
    now = manifest["executions"][-1]
    changed = now.get("changed") or {}
    before = {name: each["is"] for name, each in changed.items()}
    pairs = _package_pairs(manifest.get("software") or {}, installed_packages(), installed_system_packages())
    replaced = {name: (was, new) for name, was, new in pairs if before.get(name, was) != new}
    if replaced:
        told = (f"{name} ({before.get(name, was)}, now {new or 'absent'})" for name, (was, new) in replaced.items())
        problem = f"replaced while the experiment was executed: {listed(told, _NAMED)}"
        fix = "Find out from when on, and execute these runs again (--redo). Keep updates off until all runs are done."
        yield Finding.warning(str(path), problem, fix)
        now["changed"] = changed | {name: {"was": was, "is": new} for name, (was, new) in replaced.items()}


def _package_pairs(
    then: Mapping[str, Any], packages: Mapping[str, str], system_packages: Mapping[str, str]
) -> Iterator[tuple[str, Any, Any]]:
    yield from _pairs("package", then.get("packages"), packages)
    yield from _pairs("system package", then.get("system_packages"), system_packages)


def _pairs(what: str, before: Mapping[str, Any] | None, now: Mapping[str, Any]) -> Iterator[tuple[str, Any, Any]]:
    """Yield name, version before and version now (None if it is gone) of each package; new ones are left out."""
    return ((f"{what} {name}", release, now.get(name)) for name, release in (before or {}).items())


def _common(before: Mapping[str, Any] | None, now: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of `before` whose packages are imported now, too: which are imported is up to the config."""
    return {name: was for name, was in (before or {}).items() if name in now}


def _described_pairs(manifest: Mapping[str, Any]) -> Iterator[tuple[str, Any, Any]]:
    """Yield name, earlier and present value of the facts that packages add, such as the middleware of ROS."""
    for name, described in described_circumstances().items():
        before, now = manifest.get(name) or {}, described or {}
        if name not in manifest or not (isinstance(before, dict) and isinstance(now, dict)):
            continue
        for part in dict.fromkeys([*before, *now]):
            was, is_now = before.get(part), now.get(part)
            if isinstance(was, dict) and isinstance(is_now, dict):
                yield from _pairs(f"{name} {part.removesuffix('s')}", was, is_now)
            elif not isinstance(was, dict) and not isinstance(is_now, dict):
                yield f"{name} {part}", "none" if was is None and is_now is not None else was, is_now


def change_findings(experiment: Experiment, manifest: Mapping[str, Any]) -> Iterator[Finding]:
    """Yield a warning where the machine, software, the order of values, or the clock is another than before.

    A single-board computer without a clock of its own starts in the past until it has reached a time server, also where
    the study was registered on another machine.
    """
    where, now = str(experiment.folder.manifest), manifest["executions"][-1]
    if changed := now.get("changed") or {}:
        pairs = (f"{name} ({each['was']}, now {each['is'] or 'absent'})" for name, each in changed.items())
        problem = f"the machine or its software is not what the experiment began with: {listed(pairs, _NAMED)}"
        fix = "Go on where it began if runs are to be compared; the manifest and the report tell the difference."
        yield Finding.warning(where, problem, fix)
    for name, pair in (now.get("changed_values") or {}).items():
        if is_reordered(pair):
            problem = f"the order of {name} was {pair['was']!r}, and is {pair['is']!r} now"
            fix = "What is made of a set has another order in each process: where it matters, settle it by sorted(...)."
            yield Finding.warning(str(experiment.config_path), problem, fix)
    stamps = ("started_at", "finished_at")
    latest = max(str(each.get(stamp) or "") for each in manifest["executions"] for stamp in stamps)
    registered = str((manifest.get("registration") or {}).get("registered_at", ""))
    at, what = max((latest, "the experiment was executed"), (registered, "the study was registered"))
    if at > str(now.get("started_at", "")):  # of one form and length, texts are ordered as times
        problem = f"this machine's clock shows {now.get('started_at')}, and {what} at {at} already"
        fix = "Set the clock (chrony, systemd-timesyncd) before you go on: stamps are to tell when runs were."
        yield Finding.warning(where, problem, fix)


def restored_manifest(experiment: Experiment) -> tuple[dict[str, Any], Finding] | None:
    """Return a manifest made from the journal where the folder's is missing or damaged, and the finding that says so.

    None where the manifest is sound, or the journal has no start of an experiment. The seed is the journal's, so that
    the plan is the same as before. A damaged file is kept under another name.

    Raises:
        StorageError: the manifest is of a newer format, or the journal cannot be read.
    """
    folder = experiment.folder
    started = next(read_journal(folder.journal, kinds={"experiment_started"}), None)
    if started is None:
        return None
    problem = "the manifest is missing"
    if folder.manifest.exists():
        try:
            read_manifest(folder.manifest)
        except StorageError as error:
            if not is_damaged(folder.manifest):
                raise
            problem = error.problem
            folder.manifest.replace(folder.manifest.with_suffix(".damaged.json"))
        else:
            return None
    manifest = manifest_of(experiment)
    manifest["seed"] = started["seed"]
    manifest["design"]["source"] = started.get("design", "config")
    if not experiment.model.batches:  # the config may have changed since
        manifest["design"] |= {name: started[name] for name in ("factors", "repetitions") if name in started}
    manifest["restored_at"] = utc_now()
    deviations = [
        {name: record[name] for name in ("at", "run", "column", "was", "is")}
        for record in read_journal(folder.journal, kinds={"deviation"})
    ]
    if deviations:
        manifest["table_deviations"] = deviations
        manifest["design"]["is_reordered"] = any(not each["run"] for each in deviations)
    told = f"{problem}: it is rebuilt, with the seed of the journal; of earlier executions it tells nothing"
    return manifest, Finding.warning(str(folder.manifest), told)


def keep_config(experiment: Experiment, manifest: dict[str, Any]) -> None:
    """Copy the config file and the local modules that it imported, as executed, as `keep_config_files` does.

    What was not committed to the repository of the config is kept as well, and the manifest says where.

    Raises:
        StorageError: the copy cannot be written.
    """
    keep_config_files(experiment)
    # Once another config replaces this one, the number is its name below earlier_configs.
    manifest["executions"][-1]["config_number"] = 1 + members_in(experiment.folder.earlier_configs)
    with storage_errors(experiment.folder.config, "written"):
        _keep_uncommitted(experiment, manifest)


def keep_config_files(experiment: Experiment) -> None:
    """Copy the config file, the local modules that it imported and the files that its plugins read.

    Changed ones replace earlier copies, which are kept beside, numbered in the order in which they were executed.

    Raises:
        StorageError: the copy cannot be written.
    """
    kept = experiment.folder.config
    root = experiment.folder.root
    contents = {target: source.read_bytes() for source, target in config_files(experiment, kept).items()}
    with storage_errors(kept, "written"):
        contents = kept_contents(experiment.inputs, experiment.config_path.parent, kept) | contents
        unfinished = experiment.folder.unfinished_config
        shutil.rmtree(unfinished, ignore_errors=True)  # of an execution that was killed, or had no room
        if not kept.exists() or not all(_holds(target, content, root) for target, content in contents.items()):
            for target, content in contents.items():
                copy = unfinished / target.relative_to(kept)
                make_folder(copy.parent, root)
                replace(copy, content, root)
            let_programs_execute(unfinished, unfinished)
            if kept.exists():  # it may be missing where a kill came between these two lines
                kept.rename(next_in(experiment.folder.earlier_configs, root))
            unfinished.rename(kept)
        # The registration is that of the first run, and is never replaced.
        if experiment.registration is not None and not experiment.folder.manifest.exists():
            replace(experiment.folder.registration, read_bytes(experiment.registration.path))


def _holds(target: Path, content: bytes, root: Path) -> bool:
    try:
        return read_bytes(target, root) == content
    except MissingFileError:
        return False


def _analysis(experiment: Experiment) -> dict[str, Any] | None:
    plan = experiment.parameters.analysis
    return plan.as_mapping() if plan else None


def _repeat_until(experiment: Experiment) -> dict[str, Any] | None:
    return rules_as_mapping(experiment.parameters.repeat_until, as_configured(experiment.model).repetitions)


def _execution(experiment: Experiment) -> dict[str, Any]:
    execution = {"started_at": utc_now(), "pid": os.getpid(), "deviations": hidden_settings(experiment.overrides)}
    execution["given"] = given_values(experiment)
    if not is_from_file(experiment):
        execution["config_is_object"] = True
    state = repository_state(experiment.config_path.parent)
    return execution if state is None else execution | {"repository": state.facts()}


def _keep_uncommitted(experiment: Experiment, manifest: dict[str, Any]) -> None:
    """Keep the uncommitted changes of the config's repository, so that the code as executed can be restored."""
    repository = manifest["executions"][-1].get("repository") or {}
    changes = uncommitted_changes(experiment.config_path.parent) if repository.get("is_dirty") else b""
    if not changes:
        return
    repository["diff_sha256"] = digest = hashlib.sha256(changes).hexdigest()
    if len(changes) <= LARGEST_DIFF:
        kept = experiment.folder.uncommitted(digest)
        make_folder(kept.parent, experiment.folder.root)
        replace(kept, changes, experiment.folder.root)
        repository["diff"] = kept.relative_to(experiment.folder.root).as_posix()


def _is_of(point: EntryPoint, kind: type[Plugin]) -> bool:
    with suppress(PluginError):  # a broken one of this name is not the one in use
        return point.load() is kind
    return False


def _described(plugin: Plugin) -> dict[str, Any]:
    kind = type(plugin)
    # The entry point of another package may differ in name from its class: then only the class is known.
    named = [each for each in installed_plugins() if each.name == kind.__name__]
    announced = next((each for each in named if _is_of(each, kind)), None)
    return {
        "name": plugin.name,
        "class": f"{kind.__module__}:{kind.__qualname__}",
        "package": announced.package if announced else None,
        "version": announced.version if announced else None,
        "measures": [measure.name for measure in plugin.measures],
        # The factor of each: the journal has the value of each run.
        "bound_parameters": dict(factors_of(plugin)),
    }
