"""Fit a software power model to the measured runs of an experiment.

The model estimates power from CPU utilisation, motion and task, by least squares. The profiler PowerModel reads its
file, and estimates energy where there is no meter. The experiment must have measured power (Ina219, say), and sampled
what explains the power (PsUtil, BasicTurtlebot3).
"""

from __future__ import annotations

import json
from argparse import Namespace
from collections import defaultdict
from collections.abc import Container, Iterator, Sequence
from pathlib import Path
from typing import Any

from rich.text import Text

from robot_runner.cli.console import UserConsole, output, print_facts, print_json, shown_path
from robot_runner.cli.findings import show_findings
from robot_runner.cli.parser import Parser, UsageError, add_json, add_set, add_target
from robot_runner.cli.target import folder_of_target
from robot_runner.cli.templating import write_new_file
from robot_runner.core.errors import Finding, did_you_mean
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.run_table_reading import read_described_table
from robot_runner.core.storage.table_schema import read_schema
from robot_runner.core.words import counted, listed, shown_duration
from robot_runner.meters.power_model.power_model import PowerModel

_NONE = "none"
#: By option: what its plugin measured to explain power, and the default plugin.
_PLUGINS = {
    "utilisation": ("sampled CPU and memory", "PsUtil"),
    "phases": ("recorded the phases of the mission", "BasicTurtlebot3"),
    "frequency": ("sampled the frequency of each core, such as LinuxThermal", _NONE),
    "network": ("sampled what went over the network, such as Network", _NONE),
    "gpu": ("sampled the GPUs, such as Nvml", _NONE),
}
_UNITS = {"cpu": "W per %", "memory": "W per %", "gpu": "W per %", "network": "W per MB/s", "cycles": "W per GHz"}


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add_target(parser)
    add_set(parser)
    parser.add_argument(
        "--out", metavar="FILE", help="where to write the model (JSON); an existing file is never overwritten"
    )
    parser.add_argument(
        "--power", metavar="PLUGIN", default="Ina219", help="the plugin that measured power (%(default)s)"
    )
    for name, (does, usual) in _PLUGINS.items():
        told = f"the plugin that {does}, or none (%(default)s)"
        parser.add_argument(f"--{name}", metavar="PLUGIN", default=usual, help=told)
    parser.add_argument(
        "--terms",
        metavar="TERMS",
        help="what power is explained by, such as constant,cpu,has_moved,motion:forward,task:video; all that was seen "
        "if it is left out",
    )
    parser.add_argument(
        "--runs", metavar="RUNS", help="the runs to fit on, such as r_1,r_2; all that are done if it is left out"
    )
    add_json(parser)


def execute(arguments: Namespace) -> int:
    """Fit the model, print how well it fits, and write it if a file was named."""
    folder = folder_of_target(arguments.target, arguments.set)
    run_ids, terms = _chosen(_done_runs(folder), arguments.runs), _split(arguments.terms) or None
    plugins = {name: None if (given := getattr(arguments, name)).casefold() == _NONE else given for name in _PLUGINS}
    model = PowerModel.fit(folder.root, run_ids, power=arguments.power, terms=terms, **plugins)
    if arguments.out:
        text = json.dumps(model, indent=2, ensure_ascii=False) + "\n"
        write_new_file(Path(arguments.out).expanduser(), text, instead="Choose another name, or remove the old model.")
    show_findings(tuple(_doubts(folder, {arguments.power, *plugins.values()}, model["fit"]["runs"])))
    if arguments.json:
        print_json(model)
    else:
        _print(output(), model, arguments.out)
    return 0


def _split(text: str | None) -> list[str]:
    return [word.strip() for word in (text or "").split(",") if word.strip()]


def _done_runs(folder: ExperimentFolder) -> list[str]:
    rows = read_described_table(folder)
    places = (place for place in range(len(rows)) if rows.excluded(place) is None and not rows.is_warm_up(place))
    return [rows.run_id(place) for place in places if rows.status(place) is RunStatus.DONE]


def _chosen(done: Sequence[str], wanted: str | None) -> Sequence[str]:
    chosen = _split(wanted)
    for run_id in chosen:
        if run_id not in done:
            fix = did_you_mean(run_id, done) if done else "Execute the experiment first."
            problem = f"no run {run_id!r} is done, or it is left out"
            raise UsageError(problem, where="robot-runner fit-power-model", fix=fix)
    return chosen or done


def _doubts(folder: ExperimentFolder, plugins: Container[str | None], run_ids: Sequence[str]) -> Iterator[Finding]:
    """Yield what makes values of these plugins doubtful in the runs of the fit, once for all of their measures."""
    found = defaultdict[tuple[str, str], dict[str, None]](dict)
    for column in read_schema(folder.schema):
        for run_id in run_ids if column.owner in plugins else ():
            for doubt in column.doubts.get(run_id, ()):
                found[column.owner, doubt][run_id] = None
    for (owner, doubt), runs in found.items():
        fix = "Look at its samples, and leave out by --runs what is wrong: the model is fitted on these, too."
        yield Finding.warning(owner, f"what it measured in {listed(runs)} is doubtful: {doubt}", fix)


def _print(console: UserConsole, model: dict[str, Any], path: str | None) -> None:
    fit = model["fit"]
    for term, watts in model["coefficients_W"].items():
        low, high = fit["intervals"][term]
        unit = _UNITS.get(term, "W per core" if term.startswith("frequency:") else "W")
        shown = f"{watts:9.4f}  ± {(high - low) / 2:.4f}  {unit}"
        console.print(Text("  ").append(f"{term:24}", style="bold").append(shown))
    console.print()
    kept = "not kept; --out FILE keeps it, for PowerModel(model=FILE)"
    fitted_on = f"{counted(len(fit['runs']), 'run')}, {shown_duration(fit['seconds'])} of {fit['power_source']}"
    lag = f"correlation allowed for over {counted(fit['correlation_lag'], 'piece')} of time"
    ranges = (f"{term} {low:.0f} to {high:.0f} %" for term, (low, high) in model["ranges_percent"].items())
    print_facts(
        console,
        [
            ("Fitted on", fitted_on),
            ("Origin", "power was simulated, not measured" if fit["is_simulated"] else ""),
            ("Explained", f"{100 * fit['r_squared']:.1f} % of the variance of power (R² {fit['r_squared']:.3f})"),
            ("Residual", f"{fit['residual_W']:.3f} W (root mean square)"),
            ("Errors", f"± covers the true value in 95 of 100 experiments ({lag})"),
            ("Linearity", _linearity(fit["linearity"])),
            ("Held out", _held_out(fit["energy_errors"], len(fit["runs"]))),
            ("Range", "; ".join(ranges)),
            ("Left out", listed(f"{run} ({why})" for run, why in fit["left_out"].items())),
            ("Model", shown_path(Path(path).expanduser().resolve()) if path else kept),
        ],
    )


def _linearity(linearity: dict[str, Any] | None) -> str:
    """Return, in words, whether power is a linear function of the terms."""
    if linearity is None:
        return "nothing to be told: every term is on or off"
    if linearity["doubt"]:
        return f"doubtful: {linearity['doubt']}"
    p_value = linearity["p_value"]
    shown = "p < 0.001" if p_value < 0.001 else f"p = {p_value:.3f}"  # noqa: PLR2004 - as p is written
    return f"bending the model changes it by {linearity['curvature_W']:.3f} W only (Ramsey's RESET, {shown})"


def _held_out(errors: dict[str, float], run_count: int) -> str:
    """Return, in words, the error of a run's energy by a model that was fitted on the other runs."""
    if not errors:
        why = "there is one run only" if run_count == 1 else "each run has something, such as a task, that no other has"
        return f"no run: {why}; repeat the runs to learn how far off the model is on others"
    sizes = [abs(error) for error in errors.values()]
    mean, worst = sum(sizes) / len(sizes), max(errors, key=lambda run: abs(errors[run]))
    return f"a run's energy is off by {mean:.1f} % on average, {abs(errors[worst]):.1f} % at worst ({worst})"
