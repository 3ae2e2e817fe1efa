"""Load a config file of an earlier tool as a config object of ours, with all findings."""

from __future__ import annotations

import os
import random
import re
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from random import Random
from secrets import randbits
from typing import Any, NoReturn

from robot_runner.core.config.loader import (
    LoadedConfig,
    apply_overrides,
    execute_source,
    make_importable,
    threads_since,
)
from robot_runner.core.config.local_modules import local_modules_among
from robot_runner.core.config.original import replicated_original
from robot_runner.core.config.parameters import PARAMETERS
from robot_runner.core.config.raised_errors import raised_in
from robot_runner.core.config.source import ConfigSource
from robot_runner.core.errors import ConfigError, Finding, StorageError, did_you_mean
from robot_runner.core.plugin import Plugin
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.manifest import read_manifest
from robot_runner.core.storage.table_columns import EARLIER_SPELLING
from robot_runner.legacy.config_checks import (
    check_file,
    check_packages,
    check_plugins,
    check_subscriptions,
    check_waiting,
    is_robot_operated,
)
from robot_runner.legacy.earlier_experiment import EarlierExperiment
from robot_runner.legacy.profilers.programs import COLUMN, SelfMeasure
from robot_runner.legacy.recognition import Recognised
from robot_runner.legacy.run_ids import clone_around
from robot_runner.legacy.run_tables import EarlierDesign, design_of
from robot_runner.legacy.session import Session, active_session
from robot_runner.legacy.stand_ins.modules import StandIns


@contextmanager
def exits_raised() -> Iterator[None]:
    """Make `os._exit`, by which some configs end their program, raise instead, so that this process goes on.

    Raises:
        SystemExit: `os._exit` was called in this process.
    """
    end, own_process = os._exit, os.getpid()

    def exit_or_raise(status: int = 0) -> NoReturn:
        if os.getpid() != own_process:  # in a process that the config forked
            end(status)
        raise SystemExit(status)

    os._exit = exit_or_raise
    try:
        yield
    finally:
        os._exit = end


@contextmanager
def seeding_noted(session: Session) -> Iterator[None]:
    """Note a whole number with which the config seeds `random`: the earlier tools shuffled by what that yields."""
    seed = random.seed

    def noted(a: Any = None, version: int = 2) -> None:
        if not session.is_begun:
            session.own_seed = abs(a) if isinstance(a, int) else None  # a negative one yields the same
        seed(a, version)

    random.seed = noted
    try:
        yield
    finally:
        random.seed = seed


#: The earlier tools' names of static parameters, by our names. Attributes with other names of ours have another meaning
#: in their configs.
EARLIER_NAMES = {
    "experiment_name": "name",
    "results_output_path": "results_output_path",
    "operation_type": "operation_type",
    "time_between_runs_in_ms": "time_between_runs_in_ms",
    "required_ros_version": "required_ros_version",
    "required_ros_distro": "required_ros_distro",
}
_TABLE_METHODS = ("create_run_table_model", "create_run_table")
_UNFIT_FOR_NAME = re.compile(r"[^A-Za-z0-9 ._-]")


def lift(recognised: Recognised, overrides: Mapping[str, str]) -> LoadedConfig:
    """Execute a config file of an earlier tool, make its run table, and return it as a config of ours.

    Raises:
        ConfigError: its code raises, it misuses the tool's API, or an override is for an unknown parameter.
    """
    refused = check_file(recognised)
    if any(finding.is_error for finding in refused):
        raise ConfigError.of_findings(refused)
    lifting = _Lifting(recognised, overrides)
    lifting.session.findings += refused
    with active_session(lifting.session):
        try:
            with lifting.executing("while it was loaded"):
                lifting.load()
        except ConfigError as error:
            raise ConfigError.of_findings([*error.findings, *lifting.lacking(error)]) from error
        return lifting.lifted()


class _Lifting:
    def __init__(self, recognised: Recognised, overrides: Mapping[str, str]) -> None:
        self.session = Session(recognised)
        self._recognised = recognised
        self._source = ConfigSource(recognised.path, recognised.text, recognised.dialect.class_name)
        self._overrides = overrides
        self._stand_ins = StandIns(recognised.path)
        self._set: dict[str, Any] = {}
        self._config: Any = None
        self._local_modules: Mapping[Path, Path] = {}
        self._threads: tuple[str, ...] = ()
        self._random_state = random.getstate()

    @contextmanager
    def executing(self, when: str) -> Iterator[None]:
        """Make the earlier tool's modules importable, and turn exceptions into a ConfigError."""
        # Those beside the config come first, then those beside the tool's `__main__.py`.
        for folder in (*reversed(clone_around(self._recognised.path).entries), self._recognised.path.parent):
            make_importable(folder)
        with (
            active_session(self.session),
            seeding_noted(self.session),
            self._stand_ins.present(),
            raised_in(self._recognised.path, when),
            exits_raised(),
        ):
            yield

    def load(self) -> None:
        """Execute the file, apply the overrides, and instantiate the config class."""
        before, threads_before = set(sys.modules), set(threading.enumerate())
        class_name = self._source.class_name
        config_class = getattr(execute_source(self._source), class_name, None)
        if not isinstance(config_class, type):
            fix = f"Describe the experiment in a class {class_name}."
            raise ConfigError(f"the file has no class named {class_name}", fix=fix)
        self._apply(config_class)
        self.session.config_class = config_class
        self._config = config_class()
        for name, value in self._set.items():
            earlier_name = EARLIER_NAMES.get(name, name)
            if earlier_name in getattr(self._config, "__dict__", {}):
                setattr(self._config, earlier_name, value)
        self._local_modules = local_modules_among(self._recognised.path, set(sys.modules) - before)
        self._threads = threads_since(threads_before)
        self._random_state = random.getstate()

    def lacking(self, error: ConfigError) -> list[Finding]:
        """Return further missing requirements of a file that failed to load, so that one report has all."""
        said = {finding.where for finding in error.findings}
        found = [*check_packages(self._recognised), *check_plugins((self._recognised.path,))]
        return [finding for finding in found if finding.is_error and finding.where not in said]

    def lifted(self) -> LoadedConfig:
        """Make the run table, and return the loaded config."""
        folder = self._folder()
        self._settle_seed(folder)
        if folder is not None:
            self._config.experiment_path = folder.root
        plugins = self._plugins()
        design = self._design(plugins)
        config = EarlierExperiment(self.session, self._stand_ins, self._parameters(), design, plugins)
        return LoadedConfig(
            source=self._source,
            config=config,
            subscriptions=(),
            activated=(),
            overrides=dict(self._overrides),
            local_modules=self._local_modules,
            findings=(
                *self.session.findings,
                *check_waiting(self.session, getattr(self._config, "operation_type", None)),
                *check_subscriptions(self.session, self._config),
            ),
            folder=folder,
            spelling=design.spelling if isinstance(design, EarlierDesign) else EARLIER_SPELLING,
            threads=self._threads,
            lacking=tuple(check_plugins(self._files)),
        )

    def _settle_seed(self, folder: ExperimentFolder | None) -> None:
        """Take the seed with which the experiment or its original began, if it has; else the config's, or draw one."""
        recorded = _recorded_seed(folder) if folder else None
        if recorded is None and (original := replicated_original()) is not None:
            recorded = original.seed, original.seed_is_given
        own = self.session.own_seed
        if recorded is None:
            self.session.seed = randbits(32) if own is None else own
            return
        self.session.is_begun = True
        self.session.seed, is_own = recorded
        if is_own and own != self.session.seed:
            self._random_state = Random(self.session.seed).getstate()  # noqa: S311 - as the config's first seed did
        self.session.own_seed = self.session.seed if is_own else None

    def _apply(self, config_class: type) -> None:
        others = {}
        for name, text in self._overrides.items():
            if name in {"experiment_name", "name"}:
                self._set["experiment_name"] = text
                config_class.name = text  # type: ignore[attr-defined] # what the earlier tools call it
            else:
                others[name] = text
        self._set |= apply_overrides(config_class, others)

    @property
    def _files(self) -> tuple[Path, ...]:
        return (self._recognised.path, *self._local_modules)

    def _value(self, name: str, default: Any) -> Any:
        if name in EARLIER_NAMES:
            return getattr(self._config, EARLIER_NAMES[name], default)
        return self._set.get(name, default)

    def _parameters(self) -> dict[str, Any]:
        values = {parameter.name: self._value(parameter.name, parameter.default) for parameter in PARAMETERS.values()}
        if values["robot"] is None and is_robot_operated(self._files):
            values["robot"] = "auto"  # the earlier tools used the sourced ROS
        name = values["experiment_name"]
        if isinstance(name, str):
            # The folder keeps the original name; this is the name of the experiment.
            values["experiment_name"] = _UNFIT_FOR_NAME.sub("_", Path(name).name).strip(" ._-") or name
        return values

    def _folder(self) -> ExperimentFolder | None:
        """Return the experiment's folder: relative to the current folder, with run folders at its top level."""
        results, name = getattr(self._config, "results_output_path", None), getattr(self._config, "name", None)
        if not isinstance(results, str | Path) or not isinstance(name, str) or "\0" in f"{results}{name}":
            return None  # the check of the static parameters says why
        return ExperimentFolder(Path(f"{results}/{name}").expanduser().absolute(), runs_name="")

    def _plugins(self) -> list[Plugin]:
        if not getattr(self._config, "self_measure", False):
            return []
        binary = getattr(self._config, "self_measure_bin", None)
        return [SelfMeasure(binary=binary, logfile=getattr(self._config, "self_measure_logfile", None))]

    def _design(self, plugins: list[Plugin]) -> EarlierDesign | ConfigError:
        state = random.getstate()
        if self.session.own_seed is None:
            random.seed(self.session.seed)  # a config that shuffles its own rows gets the same order again
        else:
            random.setstate(self._random_state)
        try:
            with self.executing("in the making of the run table"):
                return design_of(self.session, self._table_method()(), self._config, [COLUMN] if plugins else [])
        except ConfigError as error:
            return error
        finally:
            random.setstate(state)

    def _table_method(self) -> Any:
        for name in _TABLE_METHODS:
            if callable(getattr(self._config, name, None)):
                return getattr(self._config, name)
        near = did_you_mean(_TABLE_METHODS[0], [name for name in dir(self._config) if not name.startswith("_")])
        fix = near.replace("Did you mean", "Rename") if near.startswith("Did") else f"Define {_TABLE_METHODS[0]}."
        raise ConfigError("the config makes no run table", where=type(self._config).__name__, fix=fix)


def _recorded_seed(folder: ExperimentFolder) -> tuple[int, bool] | None:
    """Return the seed with which an experiment began and whether it was the config's own, or None if it has not."""
    try:
        manifest = read_manifest(folder.manifest) if folder.manifest.exists() else {}
        return (int(manifest["seed"]), bool(manifest.get("seed_is_given"))) if manifest else None
    except (StorageError, KeyError):  # reading it again for the execution reports the error
        return None
