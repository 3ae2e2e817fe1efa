"""One run of one plugin, without an experiment, for its author: made as the command line names it, seen as by us."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.loader import LoadedConfig
from robot_runner.core.config.parameters import ExperimentConfig
from robot_runner.core.config.preparation import prepare
from robot_runner.core.config.source import CONFIG_CLASS, ConfigSource
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import Finding, PluginError, StorageError, did_you_mean
from robot_runner.core.events.context import RobotRunnerContext
from robot_runner.core.events.manager import RUN_EVENTS, RobotRunnerEvents
from robot_runner.core.execution.notices import AttemptFinished, Notice, RunRecord, SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.probe import without_values
from robot_runner.core.execution.task import AttemptStatus, RunOutcome
from robot_runner.core.late_annotations import needed_parameters, signature_of
from robot_runner.core.plugin import Plugin, installed_plugins, load_plugin, refused_name
from robot_runner.core.storage.guarded_files import open_to_read, read_json, read_text
from robot_runner.core.storage.journal import seconds_of
from robot_runner.core.words import enumerated

_NAME = "try"
#: How long a callback may take beyond the time that is measured, s; a plugin that hangs is ended then.
_PATIENCE = 30.0
_GRACE = 5.0
#: How much of a raw file is shown.
_SHOWN_LINES = 2
_SHOWN_BYTES = 400


@dataclass(frozen=True, slots=True)
class CalledEvent:
    """One event of the run.

    Attributes:
        name: as the callback is named.
        has_callback: whether the plugin has a callback for it.
        was_emitted: whether the run came so far.
        seconds: real time that went by until the next event; None for the last one.
    """

    name: str
    has_callback: bool
    was_emitted: bool
    seconds: float | None


@dataclass(frozen=True, slots=True)
class RawFile:
    """A file that the plugin wrote: its path within the plugin's folder, its bytes, its first lines if it is text."""

    name: str
    size: int
    head: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Trial:
    """The result of trying a plugin.

    Attributes:
        findings: of its check, and of the run, errors first.
        outcome: how the run went; None where it was refused.
        refused: values that it published and that the run table could not take.
        quality: what its `quality.json` says, if it keeps one.
        missing: its measures, where the run is done and none of them has a value.
    """

    findings: tuple[Finding, ...]
    outcome: RunOutcome | None = None
    events: tuple[CalledEvent, ...] = ()
    refused: tuple[Mapping[str, Any], ...] = ()
    raw_files: tuple[RawFile, ...] = ()
    log: str = ""
    folder: Path | None = None
    quality: Any = None
    missing: tuple[str, ...] = ()


class _Witness(SilentObserver):
    """An observer that records the reports of a run, and shows nothing."""

    def __init__(self) -> None:
        self.records: list[RunRecord] = []
        self.outcome: RunOutcome | None = None

    def notice(self, notice: Notice) -> None:
        if isinstance(notice, RunRecord):
            self.records.append(notice)
        elif isinstance(notice, AttemptFinished):
            self.outcome = notice.outcome


def has_mission(plugin: Plugin) -> bool:
    """Whether a plugin has something to do between the start and the stop of the measurement."""
    return hasattr(plugin, RobotRunnerEvents.LAUNCH_MISSION.callback_name)


def try_plugin(
    plugin: Plugin, folder: Path, *, seconds: float, robot: str | None, treatments: Mapping[str, Any]
) -> Trial:
    """Execute one run in a process of its own, in which this plugin is the only one, and measures for `seconds`.

    The mission is the plugin's own, or else to wait.
    """
    config = folder / "trial.py"
    config.write_text(f"# One run of {type(plugin).__name__}, {seconds:g} s long, robot={robot!r}.\n", encoding="utf-8")
    preparation = prepare(config, load=lambda path, _: _loaded(path, plugin, seconds, robot, treatments))
    experiment = preparation.experiment
    if experiment is None:
        return Trial(preparation.findings)
    witness = _Witness()
    finished = execute_experiment(experiment, witness)
    return _trial(experiment, plugin, witness, (*preparation.findings, *finished.findings))


def _loaded(
    path: Path, plugin: Plugin, seconds: float, robot: str | None, treatments: Mapping[str, Any]
) -> LoadedConfig:
    class RobotRunnerConfig(ExperimentConfig):
        experiment_name = _NAME
        results_output_path = path.parent
        probe = False  # the trial itself is more than a probe
        event_deadline_in_s = seconds + _PATIENCE
        grace_in_s = _GRACE

        def launch_mission(self, context: RobotRunnerContext) -> None:
            if not has_mission(plugin):
                context.clock.sleep(seconds)

        def create_run_table(self) -> RunTableModel:
            return RunTableModel([Factor(name, [value]) for name, value in (treatments or {"Trial": 1}).items()])

    config: Any = RobotRunnerConfig()
    config.robot, config.plugins = robot, [plugin]
    source = ConfigSource(path, path.read_text(encoding="utf-8"), CONFIG_CLASS)
    return LoadedConfig(source, config, (), (), {}, {})


def _trial(experiment: Experiment, plugin: Plugin, witness: _Witness, findings: Sequence[Finding]) -> Trial:
    run = experiment.folder.run("r_1")
    folder = run / plugin.name
    log = experiment.folder.log("r_1")
    outcome = witness.outcome
    is_done = outcome is not None and outcome.status is AttemptStatus.DONE
    return Trial(
        findings=tuple(dict.fromkeys(findings)),
        outcome=outcome,
        events=tuple(_events(experiment, plugin, witness.records)),
        refused=tuple(record.fields for record in witness.records if record.kind == "refused"),
        raw_files=tuple(_raw_file(path, folder) for path in sorted(folder.rglob("*")) if path.is_file()),
        log=read_text(log, experiment.folder.root, errors="replace") if log.exists() else "",
        folder=folder,
        quality=_quality(folder / "quality.json"),
        missing=without_values(experiment.columns.declared, outcome.measures) if outcome and is_done else (),
    )


def _quality(path: Path) -> Any:
    try:
        return read_json(path)
    except StorageError:
        return None


def _events(experiment: Experiment, plugin: Plugin, records: Sequence[RunRecord]) -> Iterator[CalledEvent]:
    emitted = [record.fields for record in records if record.kind == "event"]
    at = {fields["event"]: place for place, fields in enumerate(emitted)}
    for event in RUN_EVENTS:
        place = at.get(event.value)
        has_callback = any(subscriber.owner == plugin.name for subscriber in experiment.events.subscribers(event))
        yield CalledEvent(event.callback_name, has_callback, place is not None, _seconds(emitted, place))


def _seconds(emitted: Sequence[Mapping[str, Any]], place: int | None) -> float | None:
    """Return the real time from one event to the next one."""
    if place is None or place + 1 >= len(emitted):
        return None
    return seconds_of(emitted[place + 1]["at"]) - seconds_of(emitted[place]["at"])


def _raw_file(path: Path, folder: Path) -> RawFile:
    with open_to_read(path, folder) as file:
        begin = file.read(_SHOWN_BYTES)
    try:
        lines = begin.decode("utf-8").splitlines()[:_SHOWN_LINES]
    except UnicodeDecodeError:
        lines = []
    return RawFile(str(path.relative_to(folder)), path.stat().st_size, tuple(lines))


_ROBOT = "robot"


def make_plugin(chosen: str, values: Mapping[str, str]) -> tuple[Plugin, str | None]:
    """Return an instance of the plugin, and how a robot is reached if `robot` was set.

    `chosen` is as `plugin_class` takes it; values are as they were typed: a Python literal, or else a text.

    Raises:
        PluginError: there is no such plugin or parameter, or it cannot be made; what its code raises is told.
    """
    kind = plugin_class(chosen)
    parameters = signature_of(kind).parameters
    robot = None if _ROBOT in parameters else values.get(_ROBOT)
    own = {name: text for name, text in values.items() if name in parameters or name != _ROBOT}
    _check_names(kind, own)
    try:
        plugin = _built(kind, {name: parsed_value(text) for name, text in own.items()})
    except PluginError:
        raise
    except Exception as error:
        raise _raised(kind.__name__, "when it was made", error) from error
    if refused := refused_name(plugin):
        raise refused
    return plugin, robot


def _built(kind: type[Plugin], values: dict[str, Any]) -> Plugin:
    """Return the plugin with these parameters; `*several` takes a list, or one value."""
    positional: list[Any] = []
    for name, each in signature_of(kind).parameters.items():
        if each.kind is each.VAR_POSITIONAL and name in values:
            several = values.pop(name)
            before = [values.pop(given.name, given.default) for given in positional]
            return kind(*before, *(several if isinstance(several, list | tuple) else [several]), **values)
        positional.append(each)
    return kind(**values)


def _check_names(kind: type, own: Mapping[str, str]) -> None:
    """Refuse a parameter that the class does not have, and name those without which it cannot be made.

    Raises:
        PluginError: there is one.
    """
    parameters = signature_of(kind).parameters
    takes_any = any(each.kind is each.VAR_KEYWORD for each in parameters.values())
    unknown = [name for name in own if name not in parameters and not takes_any]
    if unknown:
        fix = did_you_mean(unknown[0], [*parameters, _ROBOT])
        raise PluginError(f"the plugin has no parameter {unknown[0]!r}", where=kind.__name__, fix=fix)
    missing = [name for name in needed_parameters(kind) if name not in own]
    if missing:
        settings = " ".join(f"--set {name}=..." for name in missing)
        problem = f"the plugin cannot be built without {enumerated(missing)}"
        fix = f"Add {settings}; `robot-runner plugins` describes its parameters."
        raise PluginError(problem, where=kind.__name__, fix=fix)


def plugin_class(chosen: str) -> type[Plugin]:
    """Return the class of an installed plugin, or that of `module:Class`, `file.py` or `file.py:Class`.

    Raises:
        PluginError: there is no such plugin, or it cannot be imported.

    Example:
        >>> plugin_class("robot_runner.plugins.profilers:PsUtil").__name__
        'PsUtil'
    """
    source, _, name = chosen.partition(":")
    if source.endswith(".py"):
        module = _imported_file(Path(source))
        return _class_in(module, name, where=source)
    if name:
        return _class_in(_imported_module(source), name, where=source)
    known = {plugin.name: plugin for plugin in reversed(installed_plugins())}  # of one name, the first counts: ours
    if chosen not in known:
        fix = f"{did_you_mean(chosen, known)} `robot-runner plugins` describes them."
        raise PluginError(f"no plugin named {chosen!r} is installed", where="try", fix=fix)
    return load_plugin(known[chosen])


def _imported_module(name: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except Exception as error:
        raise _raised(name, "when it was imported", error) from error


def _imported_file(path: Path) -> ModuleType:
    if not path.is_file():
        raise PluginError("there is no such file", where=str(path), fix="Name a file that is there.")
    sys.path.insert(0, str(path.parent.resolve()))  # what it imports beside it is found
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise PluginError("the file cannot be imported", where=str(path), fix="Name a Python file.")
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        raise _raised(str(path), "when it was imported", error) from error
    return module


def _class_in(module: ModuleType, name: str, *, where: str) -> type[Plugin]:
    own = {
        each: found
        for each, found in vars(module).items()
        if isinstance(found, type) and issubclass(found, Plugin) and found.__module__ == module.__name__
    }
    if not name:
        if len(own) == 1:
            return next(iter(own.values()))
        there = f"{len(own)} plugins" if own else "no class that derives from Profiler or System"
        fix = f"Name one: {where}:{next(iter(own), 'MyPlugin')}."
        raise PluginError(f"the module holds {there}", where=where, fix=fix)
    found = getattr(module, name, None)
    if found is None:
        raise PluginError(f"the module has no class {name!r}", where=where, fix=did_you_mean(name, own))
    if not (isinstance(found, type) and issubclass(found, Plugin)):
        fix = "Derive it from robot_runner.plugins.Profiler or .System."
        raise PluginError(f"{name} is not a plugin", where=where, fix=fix)
    return found


def parsed_value(text: str) -> Any:
    """Return the Python literal that a text is, or else the text."""
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return text


def _raised(where: str, when: str, error: BaseException) -> PluginError:
    problem = f"the code raised {type(error).__name__} {when}: {error}"
    return PluginError(problem, where=where, fix="Correct it, or tell its author; --debug shows the traceback.")
