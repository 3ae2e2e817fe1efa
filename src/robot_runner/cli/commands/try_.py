"""Try a profiler without an experiment.

One run of it alone is executed, and everything that the framework sees of it is shown. PROFILER is the name of an
installed one (`robot-runner plugins` lists them), a class as `module:Class`, or a file that holds one, as `my_meter.py`
or `my_meter.py:Meter`.
"""

from __future__ import annotations

import ast
import importlib
import importlib.util
import inspect
import shutil
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.text import Text

from robot_runner.cli.console import UserConsole, output, print_facts, print_folded, print_json, quiet_loading
from robot_runner.cli.findings import as_json, print_findings, show_findings
from robot_runner.cli.guard import REFUSED, SOME_FAILED
from robot_runner.cli.parser import add_json
from robot_runner.core.config.loader import parse_assignments
from robot_runner.core.errors import PluginError, RobotRunnerError, did_you_mean
from robot_runner.core.execution.task import AttemptStatus
from robot_runner.core.execution.trial import try_plugin
from robot_runner.core.plugin import Plugin, Profiler, find_plugin
from robot_runner.core.words import one_line, shown_duration, shown_value

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterator, Mapping, Sequence
    from types import ModuleType

    from robot_runner.cli.parser import Parser
    from robot_runner.core.execution.trial import CalledEvent, RawFile, Trial
    from robot_runner.core.plugin import Plugin

__all__ = ["add_arguments", "execute", "make_plugin", "profiler_class"]


# A profiler as a user names it on the command line, made with the parameters that were set there.

_ROBOT = "robot"


def make_plugin(chosen: str, values: Mapping[str, str]) -> tuple[Plugin, str | None]:
    """Return an instance of the profiler, and how a robot is reached if `robot` was set.

    Args:
        chosen: as `profiler_class` takes it.
        values: the parameters, by name, each as it was typed: a Python literal, or else a text.

    Raises:
        PluginError: there is no such profiler or parameter, or it cannot be made; what its code raises is told.
    """
    kind = profiler_class(chosen)
    parameters = inspect.signature(kind).parameters
    takes_any = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())
    robot = None if _ROBOT in parameters else values.get(_ROBOT)
    own = {name: text for name, text in values.items() if name in parameters or name != _ROBOT}
    for name in own:
        if name not in parameters and not takes_any:
            raise PluginError(
                f"the profiler has no parameter {name!r}",
                where=kind.__name__,
                fix=did_you_mean(name, [*parameters, _ROBOT]),
            )
    try:
        plugin = kind(**{name: _value(text) for name, text in own.items()})
    except PluginError:
        raise
    except Exception as error:
        raise _raised(kind.__name__, "when it was made", error) from error
    if not hasattr(plugin, "name"):
        fix = "Call super().__init__(name=name) in its __init__."
        raise PluginError("the profiler has no name", where=kind.__name__, fix=fix)
    return plugin, robot


def profiler_class(chosen: str) -> type[Plugin]:
    """Return the class of an installed profiler, or that of `module:Class`, `file.py` or `file.py:Class`.

    Raises:
        PluginError: there is no such profiler, or it cannot be imported.

    Example:
        >>> profiler_class("robot_runner.plugins.profilers:PsUtil").__name__
        'PsUtil'
    """
    source, _, name = chosen.partition(":")
    if source.endswith(".py"):
        module = _imported_file(Path(source))
        return _class_in(module, name, where=source)
    if name:
        return _class_in(_imported_module(source), name, where=source)
    return find_plugin("profilers", chosen).load()


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
        if isinstance(found, type) and issubclass(found, Profiler) and found.__module__ == module.__name__
    }
    if not name:
        if len(own) == 1:
            return next(iter(own.values()))
        found_here = (
            f"the module holds {len(own)} profilers" if own else "the module holds no class that derives from Profiler"
        )
        raise PluginError(found_here, where=where, fix=f"Name one: {where}:{next(iter(own), 'MyProfiler')}.")
    found = getattr(module, name, None)
    if found is None:
        raise PluginError(f"the module has no class {name!r}", where=where, fix=did_you_mean(name, own))
    if not (isinstance(found, type) and issubclass(found, Profiler)):
        raise PluginError(f"{name} is no Profiler", where=where, fix="Derive it from robot_runner.plugins.Profiler.")
    return found


def _value(text: str) -> Any:
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return text


def _raised(where: str, when: str, error: BaseException) -> PluginError:
    problem = f"the code raised {type(error).__name__} {when}: {error}"
    return PluginError(problem, where=where, fix="Mend it, or tell its author; --debug shows the traceback.")


_SECONDS = 5.0
_MOST_LINES = 20


def add_arguments(parser: Parser) -> None:
    """Add what the command takes."""
    parser.add_argument(
        "profiler", metavar="PROFILER", help="the profiler's name, `module:Class`, `file.py` or `file.py:Class`"
    )
    parser.add_argument(
        "--seconds", metavar="S", type=float, default=_SECONDS, help="how long it measures, in seconds (%(default)g)"
    )
    parser.add_argument(
        "--set",
        metavar="NAME=VALUE",
        action="append",
        default=[],
        help="set a parameter of the profiler, or robot=simulated; may be given several times",
    )
    parser.add_argument("--keep", metavar="FOLDER", help="keep its raw data in this folder, which must not exist")
    add_json(parser)


def execute(arguments: Namespace) -> int:
    """Try the profiler; 0 where its run went well, 1 where it failed, 2 where it was refused."""
    _check(arguments)
    values = parse_assignments(arguments.set)
    with quiet_loading():
        plugin, robot = make_plugin(arguments.profiler, values)
    with tempfile.TemporaryDirectory(prefix="robot-runner-try-") as folder, quiet_loading():
        trial = try_plugin(plugin, Path(folder), seconds=arguments.seconds, robot=robot)
        kept = _kept(trial, arguments.keep)
    if arguments.json:
        print_json(_as_json(plugin, trial, kept))
    elif trial.outcome is None:
        show_findings(trial.findings)
    else:
        _print(output(), plugin, trial, kept)
    if trial.outcome is None:
        return REFUSED
    return 0 if trial.outcome.status is AttemptStatus.DONE else SOME_FAILED


def _check(arguments: Namespace) -> None:
    if not 0 < arguments.seconds < float("inf"):
        raise RobotRunnerError(f"--seconds is {arguments.seconds:g}", where="try", fix="Give a number above 0.")
    if arguments.keep is not None and Path(arguments.keep).exists():
        raise RobotRunnerError(
            "the folder to keep is there already", where=arguments.keep, fix="Name a folder that does not exist."
        )


def _kept(trial: Trial, wanted: str | None) -> Path | None:
    if wanted is None or trial.folder is None or not trial.folder.exists():
        return None
    with _writing(wanted):
        return Path(shutil.copytree(trial.folder, wanted))


@contextmanager
def _writing(path: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        fix = "Name another folder."
        raise RobotRunnerError(f"the folder cannot be written: {error.strerror}", where=path, fix=fix) from error


def _print(console: UserConsole, plugin: Plugin, trial: Trial, kept: Path | None) -> None:
    kind = type(plugin)
    console.print(Text(kind.__name__, style="bold").append(f"  {kind.__module__}:{kind.__qualname__}", "not bold dim"))
    print_folded(console, "  ", (kind.__doc__ or "").strip().partition("\n\n")[0].replace("\n", " "), style="")
    _print_section(console, "Events", [(event.name, _called(event)) for event in trial.events])
    _print_section(console, "Measures", list(_measures(plugin, trial)))
    _print_section(console, "Raw data", [(file.name, _file(file)) for file in trial.raw_files] or [("", "none")])
    _print_section(console, "Samples", list(_quality(trial)))
    if kept:
        console.print(f"\nIts raw data are in {kept}.")
    _print_log(console, trial.log)
    _print_verdict(console, trial)


def _print_section(console: UserConsole, heading: str, facts: Sequence[tuple[str, str]]) -> None:
    if facts:
        console.print(Text(f"\n{heading}", style="bold underline"))
        print_facts(console, facts)


def _called(event: CalledEvent) -> str:
    if not event.was_emitted:
        return "not reached"
    if not event.has_callback:
        return "no callback"
    return "called" if event.seconds is None else f"called; {shown_duration(event.seconds)} to the next event"


def _measures(plugin: Plugin, trial: Trial) -> Iterator[tuple[str, str]]:
    published = trial.outcome.measures if trial.outcome else {}
    for measure in plugin.measures:
        found = published.get(measure.name)
        if found is None:
            yield measure.name, "never published"
        elif found.value is None:
            yield measure.name, "no value"
        else:
            unit = "" if measure.unit == "1" else f" {measure.unit}".rstrip()
            yield measure.name, f"{shown_value(found.value)}{unit}  ({found.origin.value})"
    for value in trial.refused:
        yield one_line(str(value["name"])), f"refused: {one_line(str(value['value']))}"


def _file(file: RawFile) -> str:
    return f"{file.size:,} bytes" + (f": {one_line(' | '.join(file.head))}" if file.head else "")


def _quality(trial: Trial) -> Iterator[tuple[str, str]]:
    """Yield what the plugin's `quality.json` says, if it keeps one as the sampling kit writes it."""
    samples = _samples(trial)
    if samples is None:
        return
    yield "got", f"{samples['got']} of {samples['expected']} expected, covering {samples['coverage']:.1f} % of the time"
    yield "largest gap", shown_duration(samples["largest_gap"])
    if samples.get("jitter"):
        yield "jitter", ", ".join(f"{name} {shown_duration(value)}" for name, value in samples["jitter"].items())
    if samples.get("cpu_seconds") is not None:
        yield "own CPU time", shown_duration(samples["cpu_seconds"])


def _samples(trial: Trial) -> dict[str, Any] | None:
    samples = trial.quality.get("samples") if isinstance(trial.quality, dict) else None
    needed = {"got", "expected", "coverage", "largest_gap"}
    return samples if isinstance(samples, dict) and needed <= samples.keys() else None


def _print_log(console: UserConsole, log: str) -> None:
    lines = log.splitlines()
    if lines:
        console.print(Text("\nPrinted", style="bold underline"))
        for line in lines[:_MOST_LINES]:
            console.print(Text(f"  {one_line(line)}"), soft_wrap=True)
        if len(lines) > _MOST_LINES:
            console.print(f"  … and {len(lines) - _MOST_LINES} more lines")


def _print_verdict(console: UserConsole, trial: Trial) -> None:
    console.print()
    print_findings(console, trial.findings)
    failure = trial.outcome.failure if trial.outcome else None
    if failure is None:
        console.print("It went well." if not trial.findings else "It went through; look at the warnings.", style="bold")
        return
    console.print(Text("failed: ", style="bold red").append(one_line(str(failure)), "not bold default"), soft_wrap=True)
    for line in failure.traceback.splitlines():
        console.print(Text(f"  {line}", style="dim"), soft_wrap=True)


def _as_json(plugin: Plugin, trial: Trial, kept: Path | None) -> dict[str, Any]:
    outcome = trial.outcome
    published = outcome.measures if outcome else {}
    return {
        "name": plugin.name,
        "class": f"{type(plugin).__module__}:{type(plugin).__qualname__}",
        "status": outcome.status.value if outcome else "refused",
        "failure": str(outcome.failure) if outcome and outcome.failure else None,
        "findings": as_json(trial.findings),
        "events": [
            {
                "name": event.name,
                "is_heard": event.has_callback,
                "was_emitted": event.was_emitted,
                "seconds": event.seconds,
            }
            for event in trial.events
        ],
        "measures": {
            name: {"value": measure.value, "unit": measure.unit, "origin": measure.origin.value}
            for name, measure in published.items()
        },
        "refused": [dict(each) for each in trial.refused],
        "raw_files": [{"name": file.name, "bytes": file.size} for file in trial.raw_files],
        "quality": trial.quality,
        "log": trial.log,
        "kept": None if kept is None else str(kept),
    }
