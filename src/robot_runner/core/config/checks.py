"""Checks of a config: names, static parameters, the run table, the results folder, threads."""

from __future__ import annotations

import inspect
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import nullcontext, suppress
from enum import Enum
from pathlib import Path
from typing import Any

from robot_runner.core.config.experiment import experiment_folder
from robot_runner.core.config.loader import LoadedConfig
from robot_runner.core.config.original import replicated_original
from robot_runner.core.config.parameters import PARAMETERS, REQUIRED, Parameter, Parameters, RunProcess
from robot_runner.core.config.plugin_checks import announced_findings
from robot_runner.core.config.raised_errors import raised_in
from robot_runner.core.config.registered_config import take_registered_seed
from robot_runner.core.design.asking import AdaptiveDesign, decides_order
from robot_runner.core.design.batches import as_configured
from robot_runner.core.design.columns import BATCH, column_name
from robot_runner.core.design.design_findings import listed_elsewhere
from robot_runner.core.design.precise_estimates import uncompared
from robot_runner.core.design.precision import precision_findings
from robot_runner.core.design.run_table_model import RunTable, RunTableModel
from robot_runner.core.errors import SLIP, ConfigError, Finding, RobotRunnerError, StorageError, did_you_mean, nearest
from robot_runner.core.events.manager import EVENTS_BY_CALLBACK
from robot_runner.core.events.measure import CONFIG_OWNER, ROBOT, Measure, MeasureColumns
from robot_runner.core.late_annotations import names_in
from robot_runner.core.links.declared_host import Reboot
from robot_runner.core.links.robot_name import Robots
from robot_runner.core.plugin import Plugin
from robot_runner.core.secret_names import shown_settings
from robot_runner.core.storage.executed_runs import done_runs
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.run_table_reading import read_run_table
from robot_runner.core.storage.table_columns import TableLayout
from robot_runner.core.treatments import parameters_guarded
from robot_runner.core.words import counted

# Columns with misspelt names of measures.


def check_columns(columns: MeasureColumns) -> list[Finding]:
    """Return a warning for each column of the config whose name is close to a plugin's measure without a column."""
    left_out = {each.name: each for each in columns.declared if not each.is_in_table}
    yielded = {each.measure.name for each in left_out.values()}  # by several plugins: that is an error of its own
    findings = []
    for column in columns.in_table:
        if column.owner != CONFIG_OWNER or column.measure != Measure(column.name):  # one with a unit is meant as it is
            continue
        name, near = column.name, nearest(column.name, left_out, SLIP)
        if near is not None and name not in yielded:
            problem = f"no plugin yields {name!r}, and {left_out[near].owner}'s {near!r} has no column"
            own = f"If the config publishes {name!r}, declare it: Measure({name!r}, unit, meaning)."
            findings.append(Finding.warning("data_columns", problem, f"Did you mean {near!r}? {own}"))
    return findings


# The analysis plan: its factors and measures.


def check_analysis(parameters: Parameters, model: RunTableModel | None, columns: MeasureColumns) -> list[Finding]:
    """Return findings on names of the plan that the run table does not have, and on hypotheses about blocks."""
    if parameters.analysis is None or model is None:
        return []
    blocks = [factor.name for factor in model.factors]
    if parameters.robots:
        blocks.append(ROBOT)
    findings = list(parameters.analysis.findings(blocks, columns.names))
    listed = {factor.name: factor.texts for factor in model.factors if factor.range is None}
    for hypothesis in parameters.analysis.hypotheses:
        findings += hypothesis.treatment_findings(listed)
    own = as_configured(model)
    taken_out = {*own.design_facts.get("block_columns", ()), own.blocks, parameters.analysis.blocks}
    fix = "State it of a factor that is studied, or compute it from the run table."
    for hypothesis in parameters.analysis.hypotheses:
        for name in filter(taken_out.__contains__, hypothesis.factors):
            problem = f"{name} is a block: what it adds is taken out of the comparison, and is not tested"
            findings.append(Finding.warning(f"analysis, hypothesis {hypothesis.statement!r}", problem, fix))
    return findings


def check_reboots(loaded: LoadedConfig, parameters: Parameters, model: RunTableModel | None) -> list[Finding]:
    """Return a warning for each host that is to be restarted where blocks change, of runs that have no blocks."""
    own = as_configured(model) if model is not None else None
    if own is None or own.blocks or own.design_facts.get("block_columns") or isinstance(own.design, AdaptiveDesign):
        return []
    problem = "reboot is Reboot.PER_BLOCK, and the runs have no blocks: it is restarted before the first run alone"
    fix = "Give the RunTableModel blocks=..., or choose Reboot.ONCE or Reboot.PER_RUN."
    names = [name for name, host in parameters.hosts.items() if host.reboot is Reboot.PER_BLOCK]
    return [Finding.warning(f"{loaded.where}.hosts[{name!r}]", problem, fix) for name in names]


def check_repeat_until(
    loaded: LoadedConfig, parameters: Parameters, model: RunTableModel | None, columns: MeasureColumns
) -> list[Finding]:
    """Return findings on `repeat_until` where it does not fit the design, and on the measures of an adaptive design."""
    if model is None:
        return []
    own, where = as_configured(model), f"{loaded.where}.repeat_until"
    units = {column.name: column.measure.unit for column in columns.in_table if not column.tells_of}
    if parameters.repeat_until and decides_order(own.design):
        problem = "the design decides on the runs and their order, and has no place for a repetition more"
        return [Finding.error(where, problem, "Leave repeat_until out, or take a design that leaves order open.")]
    if not isinstance(own.design, AdaptiveDesign):
        executed = () if own.is_too_large else (run.combination for run in own.plan())
        found = precision_findings(where, parameters.repeat_until, own.repetitions, units)
        return [*found, *uncompared(where, parameters.repeat_until, executed)]
    place = f"{loaded.where}.create_run_table, design"
    missing = [name for name in own.design.measures if name not in units]
    findings = [
        Finding.error(place, f"there is no measure {name!r} to decide by", did_you_mean(name, units))
        for name in missing
    ]
    if parameters.repeat_until:
        problem = "the design decides on the runs, and so would repeat_until"
        findings.append(Finding.error(where, problem, "Leave one of them out."))
    at_a_time = int(own.design_facts.get("at_a_time", 0)) * own.repetitions
    workers = parameters.workers
    if isinstance(workers, int) and 0 < at_a_time < workers:
        problem = f"{at_a_time} of the runs are decided on at a time, which is fewer than there are workers, {workers}"
        findings.append(Finding.warning(place, problem, f"Give the design at_a_time={-(-workers // own.repetitions)}."))
    return findings


# Misspelt attributes and callbacks: names that are close to one of ours.


def check_names(loaded: LoadedConfig) -> list[Finding]:
    """Return a finding for each public name of the config that nearly is a parameter or a callback."""
    names = {name for parent in type(loaded.config).__mro__[:-1] for name in names_in(parent)}
    names |= set(vars(loaded.config)) if hasattr(loaded.config, "__dict__") else set()
    inherited = {name for parent in type(loaded.config).__mro__[1:] for name in names_in(parent)}
    inherited -= names_in(type(loaded.config))
    parameters = [*PARAMETERS, "plugins"]
    callbacks = [*EVENTS_BY_CALLBACK, "create_run_table"]
    findings = []
    for name in sorted(names):
        if name.startswith("_") or name in parameters or name in callbacks:
            continue
        found = inspect.getattr_static(loaded.config, name, None)  # without executing a property
        is_method = callable(found) or isinstance(found, classmethod)
        ours = callbacks if is_method else parameters
        meant = nearest(name, ours, SLIP)
        if meant is not None and meant not in names - inherited:
            what = "no event is called" if is_method else "there is no static parameter"
            fix = f"Did you mean {meant!r}? Otherwise begin the name with '_'."
            findings.append(Finding.error(f"{loaded.where}.{name}", f"{what} {name!r}", fix))
    return findings


# Type and range of every static parameter.


def read_parameters(loaded: LoadedConfig) -> tuple[Parameters | None, list[Finding]]:
    """Return the static parameters, or None where one of them is missing or malformed, and the findings."""
    values: dict[str, Any] = {}
    findings: list[Finding] = []
    for parameter in PARAMETERS.values():
        value = getattr(loaded.config, parameter.name, parameter.default)
        if value is REQUIRED:
            fix = f"Give it a value: it must be {parameter.kind.expected}."
            findings.append(Finding.error(f"{loaded.where}.{parameter.name}", "this static parameter is missing", fix))
        elif not parameter.kind.accepts(value):
            findings.append(_malformed(loaded, parameter, value))
        else:
            values[parameter.name] = parameter.kind.normalise(value)
    if isinstance(robots := values.get("robot"), Robots):
        values |= {"robot": next(iter(robots.links.values())), "robots": robots.links}
    return (None if findings else Parameters(**values)), findings


def _malformed(loaded: LoadedConfig, parameter: Parameter, value: object) -> Finding:
    shown = "..." if parameter.kind.is_secret else repr(value)
    text = shown_settings(loaded.overrides).get(parameter.name)
    return Finding.error(
        f"{loaded.where}.{parameter.name}" if text is None else f"--set {parameter.name}={text}",
        f"the value is {shown}, of type {type(value).__name__}",
        f"It must be {parameter.kind.expected}.{_meant(parameter, value)}",
    )


def _meant(parameter: Parameter, value: object) -> str:
    """Return a hint where the value is a text that would be valid on the command line."""
    if not isinstance(value, str) or not value.strip() or parameter.kind.is_secret:
        return ""
    try:
        read = parameter.kind.from_text(value)
    except (ValueError, KeyError):
        return ""
    if not parameter.kind.accepts(read) or read == value:
        return ""
    written = f"{read} (from robot_runner import {type(read).__name__})" if isinstance(read, Enum) else repr(read)
    return f" Write {parameter.name} = {written}."


# Checks of installed packages.


def announced_checks(where: str, parameters: Parameters, plugins: Sequence[Plugin]) -> list[Finding]:
    """Return the findings of the checks that installed packages announce in the group `robot_runner.checks`.

    Each is a function that takes these arguments and returns findings.
    """
    return announced_findings("checks", lambda point: point.load()(where, parameters, plugins))


# The results folder: whether it can be made or written, without touching it.

#: The size of a run's records in the journal, its row and its log, bytes.
_BYTES_PER_RUN = 4096


def check_results_path(loaded: LoadedConfig, parameters: Parameters) -> list[Finding]:
    """Return an error if the experiment's folder cannot be made or written."""
    where = f"{loaded.where}.results_output_path"
    try:
        existing = _nearest_existing(experiment_folder(parameters, loaded).root)
    except ConfigError as error:
        return list(error.findings)
    if not existing.is_dir():
        return [Finding.error(where, f"{existing} is not a folder", "Name a folder, or move this file away.")]
    if not os.access(existing, os.W_OK | os.X_OK):
        fix = "Correct its permissions, or name another folder: --set results_output_path=..."
        return [Finding.error(where, f"{existing} cannot be written", fix)]
    return []


def check_disk_space(
    loaded: LoadedConfig, parameters: Parameters, plugins: Sequence[Plugin], runs: int
) -> list[Finding]:
    """Return a finding if the disk has too little room for the files of the plugins."""
    each = _BYTES_PER_RUN + sum(plugin.bytes_per_run for plugin in plugins)
    try:
        files = experiment_folder(parameters, loaded)
        folder = _nearest_existing(files.root)
        free = shutil.disk_usage(folder).free
    except (ConfigError, OSError):  # found by the check of the path
        return []
    if free >= runs * each or free >= (left := _left(files, runs)) * each:  # most have room, and no journal is read
        return []
    where = f"{loaded.where}.results_output_path"
    size = f"{left * each / 1e6:,.2f} MB"
    problem = f"{counted(left, 'run')} will keep about {size}, and {free / 1e6:,.2f} MB are free in {folder}"
    return [Finding.error(where, problem, "Make room, or name a folder on another disk: --set results_output_path=...")]


def _left(files: ExperimentFolder, runs: int) -> int:
    """Return how many runs are still to be executed."""
    try:
        return max(0, runs - len(done_runs(files.journal)))
    except StorageError:  # found when the experiment is resumed
        return runs


def _nearest_existing(folder: Path) -> Path:
    return next(path for path in (folder, *folder.parents) if path.exists())


# The run table's model, as the config makes it.


def _listed_in(loaded: LoadedConfig) -> Path | None:
    """Return the run table on disk that lists the runs of an experiment, or of its original, if there is one."""
    parameters, _ = read_parameters(loaded)
    own, original = None, replicated_original()
    with suppress(ConfigError):  # found by the check of the path
        own = experiment_folder(parameters, loaded).run_table if parameters is not None else None
    tables = (own, original.run_table if original is not None else None)
    return next((path for path in tables if path is not None and path.exists()), None)


def _take_listed(model: RunTableModel, path: Path | None) -> list[Finding]:
    """Plan a design that is too large from the run table that lists its runs."""
    if path is None or not model.is_too_large:
        return []
    try:
        # Only the plan is read: columns of measures count as a user's own.
        rows = read_run_table(path, TableLayout.of_model(model, ()))
    except RobotRunnerError as error:
        return list(error.findings)
    model.take_runs(rows.planned)
    return []


def create_model(loaded: LoadedConfig) -> tuple[RunTableModel | None, list[Finding]]:
    """Let the config create its run table; return the model, or None and the findings that refuse it.

    A design that is too large to be planned is planned from the run table on disk, where there is one.
    """
    create = getattr(loaded.config, "create_run_table", None)
    where = f"{loaded.where}.create_run_table"
    if not callable(create):
        fix = "Define create_run_table(self) and return a RunTableModel."
        return None, [Finding.error(where, "the config does not define it", fix)]
    table = _listed_in(loaded)
    try:
        with (
            raised_in(loaded.source.path, "in create_run_table"),
            parameters_guarded(),
            listed_elsewhere() if table is not None else nullcontext(),
        ):
            created = create()
    except ConfigError as error:
        return None, list(error.findings)
    model = created.model if isinstance(created, RunTable) else created
    if isinstance(created, RunTable):
        created.model.take_order(created.order)
    if isinstance(model, RunTableModel):
        refused = _take_listed(model, table)
        take_registered_seed(loaded, model)
        if refused:
            return None, refused
        return model, [*model.warnings, *_empty_treatments(model), *_named_batch(model)]
    problem = f"create_run_table returned {_shown(created)}"
    return None, [Finding.error(where, problem, "Return the RunTableModel (`return run_table`).")]


def _empty_treatments(model: RunTableModel) -> Iterator[Finding]:
    problem = "treatment '' is an empty cell of the run table, which R and pandas read as a missing value"
    fix = "Give it a name, such as 'none', and translate that where it is used."
    for factor in model.factors:
        if factor.position_of_text("") is not None:
            yield Finding.warning(f"factor {factor.name!r}", problem, fix)


def _named_batch(model: RunTableModel) -> Iterator[Finding]:
    """Yield a warning for a factor or measure with the name of the column that `extend` adds."""
    for kind, names in (("factor", [each.name for each in model.factors]), ("measure", model.data_columns or ())):
        if any(column_name(each) == BATCH for each in names):
            problem = f"robot-runner extend adds a column {BATCH!r}, and refuses an experiment that has one already"
            yield Finding.warning(
                f"{kind} {BATCH!r}", problem, f"Choose another name for it, such as '{BATCH}_number'."
            )


def _shown(created: object) -> str:
    text = repr(created)
    return text if len(text) <= 60 else f"{text[:57]}..."  # noqa: PLR2004 - one line of a terminal


def check_run_process(loaded: LoadedConfig, parameters: Parameters) -> list[Finding]:
    """Return warnings of threads in a process that forks runs, and of deadlines of which nobody takes care."""
    found = []
    if loaded.threads and parameters.run_process is RunProcess.FORK:
        problem = f"the config starts threads while it is loaded ({', '.join(loaded.threads)}); a forked run may hang"
        found.append((problem, "Start them in start_run, or choose run_process = RunProcess.SPAWN."))
    given = [each for each in ("run_deadline_in_s", "event_deadline_in_s") if getattr(parameters, each) is not None]
    if given and parameters.run_process is RunProcess.IN_PROCESS:
        problem = f"run_process is IN_PROCESS: nothing ends a run that takes longer than {' or '.join(given)}"
        found.append((problem, "Leave run_process out: a run in a process of its own can be ended."))
    return [Finding.warning(loaded.where, problem, fix) for problem, fix in found]
