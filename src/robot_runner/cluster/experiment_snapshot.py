"""An experiment as it is sent to a worker: config file, its modules, what it reads, and settings from outside.

The worker loads the config as a fresh interpreter does (`RunProcess.SPAWN`): it has nothing of what `before_experiment`
and `before_run` set up in the memory of the orchestrator.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from robot_runner.core.config.checks import announced_checks
from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.plugin_checks import check_plugins
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.design.batches import GROWTH
from robot_runner.core.errors import ConfigError, ExecutionError, Finding
from robot_runner.core.execution.given_values import given_elsewhere, last_given
from robot_runner.core.execution.resumption import config_files
from robot_runner.core.execution.task import RunTask
from robot_runner.core.execution.worker import describe_revisions, restore_revisions, task_of
from robot_runner.core.links.connect import link_findings
from robot_runner.core.storage.input_files import copy_kept, kept_copies, missing_inputs
from robot_runner.core.storage.journal import journal_lines
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import read_manifest

#: The setting by which a worker has no cluster of its own, and executes its runs itself.
_NO_CLUSTER = "none"
#: The folder of the config and its modules, within the folder of the process that executes runs.
SOURCE = "source"
_GIVEN_FIX = "Start the workers with the same variables of the environment, or set it for all: --set NAME=VALUE."
_TREATMENTS_FIX = (
    "Have the config make the same ones on each machine: give random ones a seed, and name files that they are read "
    "from in its method input_files."
)
_TREES_FIX = "Have XDG_CACHE_HOME be a folder that workers see as well, and start the experiment again."


def snapshot_of(experiment: Experiment) -> dict[str, Any]:
    """Return an experiment as plain data; raise an `ExecutionError` if it cannot be sent: its config is in no file."""
    if experiment.kept != "file":
        problem = "the config stands in no file, and cannot travel to the workers of a cluster"
        raise ExecutionError(problem, where=experiment.class_name, fix="Write the class to a file and give its path.")
    batches = journal_lines(experiment.folder.journal, kinds=GROWTH) if experiment.folder.journal.exists() else ()
    robot, name = experiment.parameters.robot, experiment.parameters.experiment_name
    manifest = experiment.folder.manifest
    return {
        "config": experiment.config_path.name,
        # Byte by byte, each as the character of its number: Python reads the encoding from the file itself.
        "files": {
            place.as_posix(): path.read_bytes().decode("latin-1")
            for path, place in config_files(experiment, Path()).items()
        },
        # The robot that `auto` has found here is the one for the worker, too; the name may have the time in it.
        "set": {
            **experiment.overrides,
            "experiment_name": name,
            **({"robot": robot} if isinstance(robot, str) else {}),
        },
        "given": last_given(read_manifest(manifest)) if manifest.exists() else None,
        "treatments": {factor.name: list(factor.texts) for factor in experiment.model.factors},
        "folders": list(map(str, _spellings(experiment.config_path))),
        "batches": "".join(line.decode("utf-8").rstrip("\n") + "\n" for line in batches),
        "revisions": describe_revisions(experiment.model.factors),
    }


def experiment_of(snapshot: Mapping[str, Any], folder: Path) -> Experiment:
    """Return the experiment of a snapshot, to be executed on this worker.

    `folder` is the worker's own, for the config and all that a run writes.

    Raises:
        ConfigError: the config cannot be loaded here, has other values, or lacks what it needs; carries every finding.
    """
    for name, text in snapshot["files"].items():
        path = folder / SOURCE / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(text.encode("latin-1"))
    settings = {**snapshot["set"], "cluster": _NO_CLUSTER, "results_output_path": str(folder / "experiments")}
    path = folder / SOURCE / snapshot["config"]
    # Not for here: the orchestrator has checked the disk space for all runs, and the registration.
    load = partial(prepare_or_refuse, path, settings, is_for_here=False)
    if snapshot["batches"]:  # the design has grown; the folder of its journal is known once the config is loaded
        name = load().parameters.experiment_name
        journal = ExperimentFolder(folder / "experiments" / name).journal
        journal.parent.mkdir(parents=True, exist_ok=True)
        journal.write_text(snapshot["batches"], encoding="utf-8")
    experiment = load()
    others = given_elsewhere(experiment, {"given_to_extension": snapshot["given"]}, snapshot["set"])
    ConfigError.refuse(Finding.error(f"config, {each}", "the value is another one here", _GIVEN_FIX) for each in others)
    _refuse_unfit(experiment, snapshot["revisions"])
    restore_revisions(experiment.model.factors, snapshot["revisions"])
    experiment.folder.root.mkdir(parents=True, exist_ok=True)
    experiment.folder.runs.mkdir(exist_ok=True)
    return experiment


def texts_here(snapshot: Mapping[str, Any], experiment: Experiment) -> dict[str, dict[str, str]]:
    """Return, for each factor, the texts of treatments that differ on this worker, by those of the orchestrator.

    A treatment that names a file beside the config (`Path(__file__).parent / "hall.yaml"`) names its copy here.

    Raises:
        ConfigError: a treatment is not there.
    """
    folders = [*zip(snapshot["folders"], map(str, _spellings(experiment.config_path)), strict=True)]
    differing: dict[str, dict[str, str]] = {}
    for factor in experiment.model.factors:
        for text in snapshot["treatments"].get(factor.name, ()):
            if factor.position_of_text(text) is not None:
                continue
            candidates = (text.replace(old, new) for old, new in folders)
            moved = next((each for each in candidates if factor.position_of_text(each) is not None), None)
            if moved is None:
                problem = f"treatment {text!r} is not there when the config is loaded on this worker"
                raise ConfigError(problem, where=f"factor {factor.name!r}", fix=_TREATMENTS_FIX)
            differing.setdefault(factor.name, {})[text] = moved
    return differing


def task_here(
    experiment: Experiment, described: Mapping[str, Any], differing: Mapping[str, Mapping[str, str]]
) -> RunTask:
    """Return the task that the orchestrator has described, with the treatments of this worker (`texts_here`).

    Raises:
        ConfigError: a treatment is not there.
    """
    combination = {
        name: (is_treatment, differing.get(name, {}).get(value, value) if is_treatment else value)
        for name, (is_treatment, value) in described["combination"].items()
    }
    return task_of(experiment, {**described, "combination": combination})


def _spellings(config: Path) -> tuple[Path, Path]:
    """Return the folder of a config as it was given, and without links."""
    return config.parent, config.resolve().parent


@contextmanager
def inputs_of(kept: Path, folder: Path) -> Iterator[None]:
    """While this lasts, the experiment reads the copies that were sent with it instead of files of this machine.

    `kept` is the experiment's folder of configs, or the part of it that was sent; `folder`, as for `experiment_of`, is
    empty.

    Raises:
        ConfigError: a file that is too large to be copied is missing or different here.
        StorageError: a copy cannot be read or written.
    """
    fix = "Put it there, as it is on the machine that starts the experiment."
    ConfigError.refuse(Finding.error(each.where, each.problem, fix) for each in missing_inputs(kept))
    copy_kept(kept, folder / SOURCE)
    with kept_copies(kept, folder / SOURCE):
        yield


def _refuse_unfit(experiment: Experiment, revisions: Sequence[Sequence[str]]) -> None:
    """Check whether this machine has what the experiment needs.

    Raises:
        ConfigError: it has not; carries every finding.
    """
    parameters = experiment.parameters
    found = [
        *check_plugins(experiment.plugins, experiment.model, parameters.robot),
        *link_findings(parameters.robot),
        *announced_checks(experiment.class_name, parameters, experiment.plugins),
        *(
            Finding.error(f"factor {name!r}", f"the work tree of {text!r} is not here: {path}", _TREES_FIX)
            for name, text, _, path in revisions
            if not Path(path).is_dir()
        ),
    ]
    ConfigError.refuse(finding for finding in found if finding.is_error)
