"""A config that is given as a class or as its instance, by a script, a notebook or a test."""

from __future__ import annotations

import ast
import inspect
import linecache
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import Enum
from importlib.util import decode_source
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from robot_runner.core.config.loader import LoadedConfig, apply_overrides
from robot_runner.core.config.local_modules import local_modules_among
from robot_runner.core.config.parameters import RunProcess, StaticParameters
from robot_runner.core.config.raised_errors import raised_in
from robot_runner.core.config.source import ConfigSource, parsed, read_source
from robot_runner.core.errors import ConfigError, Finding
from robot_runner.core.events.manager import recorded_subscriptions
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.treatments import parameters_guarded
from robot_runner.notebook.stale_modules import holds_values_of, stale_names

_NOT_REPLICABLE = "a replication package of it cannot be executed"
_NO_FILE = "Write the class to a file and give its path: then all of it is kept."


#: The folder and the file in which the source of a class that stands in none is put for a moment.
PREFIX, NAME = "robot-runner-config-", "config_from_python.py"


def is_config(value: object) -> bool:
    """Whether a value can be a config: a class, or an instance of one, that makes a run table."""
    return callable(getattr(value, "create_run_table", None))


def as_texts(settings: Mapping[str, Any]) -> dict[str, str]:
    """Return values of static parameters as `--set` writes them, so that the manifest has them alike.

    Raises:
        ConfigError: a value cannot be written so; all of them are told.

    Example:
        >>> from robot_runner import OperationType
        >>> as_texts({"operation_type": OperationType.SEMI, "attempts": 2, "robot": None})
        {'operation_type': 'semi', 'attempts': '2', 'robot': 'None'}
    """
    texts: dict[str, str] = {}
    findings: list[Finding] = []
    for name, value in settings.items():
        if not isinstance(name, str):
            problem = f"{name!r} is not the name of a static parameter"
            findings.append(Finding.error("settings", problem, "Give names as texts, such as 'robot'."))
        elif isinstance(value, Enum):
            texts[name] = str(value.value)
        elif value is None or isinstance(value, str | int | float | Path):
            texts[name] = str(value)
        elif isinstance(value, list | tuple) and all(isinstance(each, str) for each in value):
            texts[name] = ",".join(value)
        else:
            problem = f"a value of type {type(value).__name__} cannot be set from outside"
            findings.append(Finding.error(f"settings[{name!r}]", problem, "Set it in the config."))
    ConfigError.refuse(findings)
    return texts


def runs_named(option: str, runs: Sequence[str] | str) -> tuple[str, ...]:
    """Return the runs that are chosen as `--only` and `--redo` take them, where one text alone is one of these, too.

    Raises:
        ConfigError: something among them is not text.

    Example:
        >>> runs_named("only", "r_1,r_2"), runs_named("only", ["r_1", "Task=Video"])
        (('r_1,r_2',), ('r_1', 'Task=Video'))
    """
    named = (runs,) if isinstance(runs, str) else tuple(runs)
    wrong = [each for each in named if not isinstance(each, str)]
    if wrong:
        fix = "Give ids or treatments as texts, such as 'r_1' or 'Task=Video'."
        raise ConfigError(f"{wrong[0]!r} names no run", where=f"run_experiment, {option}", fix=fix)
    return named


@contextmanager
def config_of_object(given: Any, overrides: Mapping[str, str]) -> Iterator[LoadedConfig]:
    """Load a config class, or an instance of one; what is set from outside is gone from an instance afterwards.

    The file that the class stands in is kept as the config. A class that has none, such as one of a notebook, is kept
    as far as its source can be found, and a finding says so.

    Raises:
        ConfigError: it is not a config, making it raised, or a parameter that is to be set does not exist.
    """
    kind = given if isinstance(given, type) else type(given)
    with TemporaryDirectory(prefix=PREFIX) as folder:
        source, kept, findings = _source(kind, Path(folder))
        with recorded_subscriptions() as subscriptions, raised_in(source.path, "while it was made"):
            # A class of its own each time: what is set for one call must not be there in the next one.
            own = type(kind.__name__, (kind,), {"__module__": kind.__module__, "__doc__": kind.__doc__})
            values = apply_overrides(own, overrides)
            with parameters_guarded():
                config = own() if isinstance(given, type) else given
            before = {name: vars(config)[name] for name in values if name in vars(config)}
            for name, value in values.items():
                setattr(config, name, value)
        findings += _process_findings(config, kind, is_class=isinstance(given, type), kept=kept)
        local_modules = local_modules_among(source.path, set(sys.modules)) if kept == "file" else {}
        findings += _stale_findings([source.path, *local_modules])
        try:
            yield LoadedConfig(
                source=source,
                config=config,
                subscriptions=tuple(subscriptions),
                activated=(),
                overrides=dict(overrides),
                local_modules=local_modules,
                findings=tuple(findings),
                folder=_folder(config) if kept != "file" else None,
                kept=kept,
            )
        finally:
            for name in values:
                delattr(config, name)
            vars(config).update(before)


def _source(kind: type, folder: Path) -> tuple[ConfigSource, str, list[Finding]]:
    """Return what is kept as the config, how much of it that is, and what is to be said of it."""
    where = f"class {kind.__name__}"
    try:
        file = Path(inspect.getsourcefile(kind) or "")
    except (TypeError, OSError):
        file = Path()
    if file.is_file():
        path = file.resolve()
        text = decode_source(path.read_bytes())
        return ConfigSource(path, text, kind.__name__), "file", _unloadable(where, path, kind, text)
    # Also those of the classes that it is derived from, a change of which is a change of the experiment.
    cells = [_cell(each) for each in reversed(kind.__mro__) if each.__module__ == kind.__module__]
    text = "\n".join(dict.fromkeys(filter(None, cells)))
    if cells[-1]:
        kept, problem = "cell", "it stands in no file: its cell is kept, and not what else it uses of other cells"
    else:
        kept, problem = "nothing", "it stands in no file, and its source is not kept: it cannot be found"
        text += f"# The source of {kind.__name__} could not be found.\n"
    path = folder / NAME
    path.write_text(text, encoding="utf-8")
    return ConfigSource(path, text, kind.__name__), kept, [Finding.warning(where, problem, _NO_FILE)]


def _cell(kind: type) -> str:
    """Return the source of a notebook's or a console's cell in which a class was written; nothing if it is gone.

    `inspect.getsource` looks for the file of the class's module, which a notebook does not have; the code of its
    methods knows its cell. A class without methods is in the latest cell that has its name and its values.
    """
    codes = (getattr(value, "__code__", None) for value in vars(kind).values())
    names = dict.fromkeys(code.co_filename for code in codes if code is not None)
    for name in names or [name for name in reversed(list(linecache.cache)) if not Path(name).exists()]:
        text = "".join(linecache.getlines(name))
        if re.search(rf"^\s*class {kind.__name__}\b", text, re.MULTILINE) and (names or holds_values_of(text, kind)):
            return text
    return ""


def _is_loaded_from(path: Path, kind: type) -> bool:
    try:
        return "<locals>" not in kind.__qualname__ and read_source(path).class_name == kind.__name__
    except ConfigError:
        return False


def _unloadable(where: str, path: Path, kind: type, text: str) -> list[Finding]:
    """Return a warning where `robot-runner` could not load the class from its file, as a replication has to."""
    if not _is_loaded_from(path, kind):
        problem = f"robot-runner would not find it in {path.name}: {_NOT_REPLICABLE}"
        return [Finding.warning(where, problem, "Give it a file of its own, at the top level, to have it replicated.")]
    for node in ast.walk(parsed(text)):
        if isinstance(node, ast.ImportFrom) and node.level:
            line = f"{path.name}, line {node.lineno},"
            problem = f"{line} imports relative to a package, in which robot-runner does not load it: {_NOT_REPLICABLE}"
            fix = "Import it by its name, without the dots: the folder of the file is searched for modules."
            return [Finding.warning(where, problem, fix)]
    return []


def _stale_findings(files: Sequence[Path]) -> list[Finding]:
    """Return a warning of each file that was changed after it was imported: it is kept, and another one executed."""
    return [
        Finding.warning(
            str(path),
            f"{name} is not in memory as it is in the file, which is kept: what is executed is another version",
            "Restart Python (in a notebook the kernel) after a change, or give the path of the config file.",
        )
        for path, name in stale_names(files).items()
    ]


def _process_findings(config: Any, kind: type, *, is_class: bool, kept: str) -> list[Finding]:
    if getattr(config, "run_process", None) is not RunProcess.SPAWN or (is_class and kept == "file"):
        return []
    problem = "run_process is SPAWN, which loads the config from its file again, and this one is an object in memory"
    return [Finding.error(f"{kind.__name__}.run_process", problem, "Leave it out, or give the path of a file.")]


def _folder(config: Any) -> ExperimentFolder | None:
    """Return where an experiment without a file is kept: a relative path begins where the program was started."""
    name = getattr(config, "experiment_name", None)
    results = getattr(config, "results_output_path", StaticParameters.results_output_path)
    if not isinstance(name, str) or not isinstance(results, str | Path):
        return None  # which validation says
    return ExperimentFolder((Path.cwd() / Path(results).expanduser()).resolve() / name)
