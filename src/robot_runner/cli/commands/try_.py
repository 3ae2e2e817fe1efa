"""Try a profiler or a system without an experiment.

One run of it alone is executed, and everything that the framework sees of it is shown. The mission of a profiler is to
wait, that of a system its own. PLUGIN is the name of an installed one (`robot-runner plugins` lists them), a class as
`module:Class`, or a file that holds one, as `my_meter.py` or `my_meter.py:Meter`.
"""

from __future__ import annotations

import shutil
import tempfile
from argparse import Namespace
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from rich.text import Text

from robot_runner.cli.console import UserConsole, output, print_facts, print_folded, print_json, quiet_loading
from robot_runner.cli.findings import as_json, print_findings, show_findings
from robot_runner.cli.guard import REFUSED, SOME_FAILED
from robot_runner.cli.parser import Parser, add_json
from robot_runner.cli.trial import CalledEvent, RawFile, Trial, has_mission, make_plugin, parsed_value, try_plugin
from robot_runner.core.config.loader import parse_assignments
from robot_runner.core.errors import RobotRunnerError
from robot_runner.core.execution.task import AttemptStatus
from robot_runner.core.links.connect import is_simulated
from robot_runner.core.plugin import Plugin, System, installed_plugins
from robot_runner.core.words import enumerated, one_line, shown_duration, shown_value

_SECONDS = 5.0
#: A mission of a system is longer than most measurements, and breaks off by itself only where it hangs.
_LONGEST_MISSION_S = 600.0
_MOST_LINES = 20


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "plugin",
        metavar="PLUGIN",
        help="the plugin's name, `module:Class`, `file.py` or `file.py:Class`",
        completer=lambda **_: [each.name for each in installed_plugins()],
    )
    parser.add_argument(
        "--seconds",
        metavar="S",
        type=float,
        help=f"how long it measures, in seconds ({_SECONDS:g}); of a system with a mission of its own, how long that "
        f"may take ({_LONGEST_MISSION_S:g})",
    )
    parser.add_several("--set", "NAME=VALUE", "set a parameter of the plugin, or robot=simulated")
    meaning = "give the run a treatment that the plugin reads, such as Task=Video"
    parser.add_several("--factor", "NAME=VALUE", meaning)
    parser.add_argument("--yes", action="store_true", help="let a system operate a robot that is not simulated")
    parser.add_argument("--keep", metavar="FOLDER", help="keep its raw data in this folder, which must not exist")
    add_json(parser)


def execute(arguments: Namespace) -> int:
    """Try the plugin; 0 where its run went well, 1 where it failed or yielded no value, 2 where it was refused."""
    _check(arguments)
    values = parse_assignments(arguments.set)
    treatments = {name: parsed_value(text) for name, text in parse_assignments(arguments.factor).items()}
    with quiet_loading():
        plugin, robot = make_plugin(arguments.plugin, values)
    if isinstance(plugin, System) and robot is not None and not is_simulated(robot) and not arguments.yes:
        fix = "See that nothing is in its way, and add --yes. Or: --set robot=simulated."
        raise RobotRunnerError(f"the plugin operates the robot {robot!r}, which may move", where=plugin.name, fix=fix)
    seconds = arguments.seconds or (_LONGEST_MISSION_S if has_mission(plugin) else _SECONDS)
    with tempfile.TemporaryDirectory(prefix="robot-runner-try-") as folder, quiet_loading():
        trial = try_plugin(plugin, Path(folder), seconds=seconds, robot=robot, treatments=treatments)
        kept = _kept(trial, arguments.keep)
    if arguments.json:
        print_json(_as_json(plugin, trial, kept))
    elif trial.outcome is None:
        show_findings(trial.findings)
    else:
        _print(output(), plugin, trial, kept)
    if trial.outcome is None:
        return REFUSED
    return 0 if trial.outcome.status is AttemptStatus.DONE and not trial.missing else SOME_FAILED


def _check(arguments: Namespace) -> None:
    if arguments.seconds is not None and not 0 < arguments.seconds < float("inf"):
        raise RobotRunnerError(f"--seconds is {arguments.seconds:g}", where="try", fix="Give a number above 0.")
    if arguments.keep is not None and Path(arguments.keep).exists():
        fix = "Name a folder that does not exist."
        raise RobotRunnerError("the folder to keep is there already", where=arguments.keep, fix=fix)


def _kept(trial: Trial, wanted: str | None) -> Path | None:
    if wanted is None or trial.folder is None or not trial.folder.exists():
        return None
    try:
        return Path(shutil.copytree(trial.folder, wanted))
    except OSError as error:
        # `copytree` tells of single files together: the first one says why.
        reason = error.args[0][0][2] if isinstance(error, shutil.Error) else error.strerror
        fix = "Name another folder."
        raise RobotRunnerError(f"the folder cannot be written: {reason}", where=wanted, fix=fix) from error


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
            doubtful = ", doubtful" if found.doubts else ""
            yield measure.name, f"{shown_value(found.value)}{unit}  ({found.origin.value}{doubtful})"
    for value in trial.refused:
        yield one_line(str(value["name"])), f"refused: {one_line(str(value['value']))}"


def _file(file: RawFile) -> str:
    return f"{file.size:,} bytes" + (f": {one_line(' | '.join(file.head))}" if file.head else "")


def _quality(trial: Trial) -> Iterator[tuple[str, str]]:
    """Yield the facts of the plugin's `quality.json`, if it keeps one as the sampling kit writes it."""
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
    if trial.missing:
        missing = f"the plugin measured nothing: no value of {enumerated(trial.missing)}"
        print_folded(console, "failed: ", missing, style="bold red")
    elif failure is None:
        console.print("It went well." if not trial.findings else "It went through, with warnings.", style="bold")
    else:
        print_folded(console, "failed: ", one_line(str(failure)), style="bold red")
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
            name: {
                "value": measure.value,
                "unit": measure.unit,
                "origin": measure.origin.value,
                "quality": measure.quality.value,
                "doubts": list(measure.doubts),
            }
            for name, measure in published.items()
        },
        "missing": list(trial.missing),
        "refused": [dict(each) for each in trial.refused],
        "raw_files": [{"name": file.name, "bytes": file.size} for file in trial.raw_files],
        "quality": trial.quality,
        "log": trial.log,
        "kept": None if kept is None else str(kept),
    }
