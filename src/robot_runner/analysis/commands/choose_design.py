"""Compare what can be learnt from different designs within a budget of time, and recommend one with reasons.

The factors, exclusions and measures are those of the config. The command compares the full factorial (also in blocks),
fractions, a covering array, one factor at a time, D-optimal combinations and, with --hard, a split plot. The duration
of a run comes from plugins, from runs of the experiment or of --pilot, or from --run-time. Power is simulated as by
`robot-runner power`.
"""

from __future__ import annotations

import re
from argparse import Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.analysis.commands.power import planned_experiment, show_progress
from robot_runner.analysis.libraries import require_libraries
from robot_runner.analysis.planning.candidate_designs import RunTimes, candidates_of
from robot_runner.cli.console import Column, UserConsole, aligned, output, print_folded, print_json
from robot_runner.cli.parser import Parser, UsageError, add_config, add_json, add_set
from robot_runner.cli.planning import plan_of
from robot_runner.cli.target import folder_of_target
from robot_runner.core.config.loader import parse_assignments
from robot_runner.core.design.listed_runs import ListedRunTableModel
from robot_runner.core.errors import AnalysisError, did_you_mean
from robot_runner.core.words import shown_duration

if TYPE_CHECKING:
    from robot_runner.analysis.planning.design_comparison import DesignComparison
    from robot_runner.core.design.run_table_model import RunTableModel
    from robot_runner.core.execution.durations import Durations

_DURATION = re.compile(r"(\d+(?:\.\d+)?)\s*(s|min|h|d)")
_UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}
_WHERE = "robot-runner design"


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add_config(parser)
    add_set(parser)
    parser.add_argument("--budget", metavar="TIME", required=True, help="the available time, as in 90min, 8h or 2d")
    parser.add_argument("--run-time", metavar="TIME", help="how long a run takes, if nothing else tells it")
    parser.add_argument("--pilot", metavar="FOLDER", help="an experiment to take durations, means and spreads from")
    for name, metavar, text in (
        ("--hard", "FACTOR=TIME", "a factor that is hard to change, and how long a change takes"),
        ("--measure", "NAME", "simulate this measure; without the option, those of the plan"),
        ("--effect", "CLAIM", "the effect to find: a hypothesis, Task or 'Task x Speed'"),
        ("--sd", "[MEASURE=]SD", "standard deviation of runs of one combination"),
        ("--difference", "[MEASURE:]FACTOR=SIZE", "what the last treatment adds to the first"),
        ("--block-sd", "[MEASURE=]SD", "standard deviation of what a block, or a whole plot, adds to all of its runs"),
    ):
        parser.add_argument(name, metavar=metavar, action="append", default=[], help=f"{text}; may be repeated")
    parser.add_argument("--power", metavar="SHARE", type=float, default=0.8, help="the power to reach (%(default)s)")
    parser.add_argument("--seed", metavar="NUMBER", type=int, default=1, help="seed of the simulation (%(default)s)")
    add_json(parser)


def execute(arguments: Namespace) -> int:
    """Print the designs side by side, and the one that is recommended."""
    comparison = _comparison(arguments)
    if arguments.json:
        print_json(comparison.as_mapping())
        return 0
    _print(output(), comparison)
    return 0


def _comparison(arguments: Namespace) -> DesignComparison:
    require_libraries()
    budget = _seconds("--budget", arguments.budget)
    if not 0 < arguments.power < 1:
        problem = f"--power is {arguments.power}"
        raise UsageError(problem, where=_WHERE, fix="Give a share between 0 and 1, such as 0.8.")
    hard = _hard(arguments.hard)
    from robot_runner.analysis.planning.design_comparison import Asked, compare_designs  # noqa: PLC0415 - slow, and an extra
    from robot_runner.analysis.planning.planned_study import counting_factor, counts_repetitions  # noqa: PLC0415 - as above
    from robot_runner.analysis.planning.power_analysis import Assumptions  # noqa: PLC0415 - as above
    from robot_runner.analysis.results import load_results  # noqa: PLC0415 - as above

    experiment, model, units = planned_experiment(arguments)
    if isinstance(model, ListedRunTableModel):
        fix = "Describe the design with factors and repetitions."
        raise AnalysisError("the runs are listed one by one", where=arguments.config, fix=fix)
    if (counting := counting_factor(model)) is not None:
        raise counts_repetitions(counting, arguments.config)
    names = [factor.name for factor in model.factors]
    for name in hard:
        if name not in names:
            raise AnalysisError(f"there is no factor {name!r}", where="--hard", fix=did_you_mean(name, names))
    pilot = folder_of_target(arguments.pilot, []) if arguments.pilot else None
    durations = plan_of(Path(arguments.config), parse_assignments(arguments.set)).durations
    if durations is not None and pilot is not None:
        durations.learn_from(pilot.journal)
    times = _times(arguments, durations, model, hard)
    asked = Asked(
        experiment.parameters.experiment_name,
        experiment.parameters.analysis,
        units,
        Assumptions(
            pilot=load_results(pilot.root) if pilot is not None else None,
            measures=arguments.measure,
            spreads=arguments.sd,
            differences=arguments.difference,
            blocks=arguments.block_sd,
        ),
        tuple(arguments.effect),
        budget,
        arguments.power,
        arguments.seed,
    )
    candidates = candidates_of(model, list(hard))
    return compare_designs(candidates, times, asked, lambda name: show_progress(f"Comparing: {name}"))


def _times(
    arguments: Namespace, durations: Durations | None, model: RunTableModel, hard: Mapping[str, float]
) -> RunTimes:
    """Return how long runs take, from options, plugins or earlier runs.

    Raises:
        AnalysisError: nothing tells it.
    """
    pause = durations.pause if durations is not None else 0.0
    if arguments.run_time is not None:
        seconds = _seconds("--run-time", arguments.run_time)
        return RunTimes(lambda _: seconds, pause, hard)
    first = model.plan()[0].combination
    if durations is None or durations.of_run(first) is None:
        problem = "how long a run takes is not known: neither the config nor an option says it, and no run has ended"
        fix = "Give --run-time 95s, or --pilot FOLDER of an experiment like it."
        raise AnalysisError(problem, where=_WHERE, fix=fix)
    mean = durations.of_run(first) or 0.0
    return RunTimes(lambda combination: durations.of_run(combination) or mean, pause, hard)


def _hard(texts: list[str]) -> dict[str, float]:
    found = {}
    for text in texts:
        name, has_cost, cost = text.partition("=")
        found[name.strip()] = _seconds("--hard", cost) if has_cost else 0.0
    return found


def _seconds(option: str, text: str) -> float:
    match = _DURATION.fullmatch(text.strip())
    if match is None or float(match[1]) <= 0:
        raise UsageError(
            f"{option} is {text!r}", where=_WHERE, fix="Give a number with its unit: 95s, 90min, 8h or 2d."
        )
    return float(match[1]) * _UNITS[match[2]]


def _print(console: UserConsole, comparison: DesignComparison) -> None:
    show_progress()
    console.print(f"What can be learnt within {shown_duration(comparison.asked.budget)}", style="bold")
    columns = [
        Column("Design", max(len(each.name) for each in comparison.designs) + 2),
        Column("Combinations", 12, is_number=True),
        Column("Times", 5, is_number=True),
        Column("Runs", 6, is_number=True),
        Column("Duration", 14),
        Column("Power", 6, is_number=True),
    ]
    console.print(f"  {aligned(columns, [column.heading for column in columns])}", style="dim", soft_wrap=True)
    for each in comparison.designs:
        mark = "* " if each.name == comparison.recommended else "  "
        if not each.combinations:
            print_folded(console, "  ", f"  {each.name}: {each.problem}", style="dim")
            continue
        power = "" if each.power is None else f"{each.power:.0%}"
        duration = shown_duration(each.seconds)
        cells = [f"{each.combinations}", f"{each.repetitions}", f"{each.runs}", duration, power]
        print(f"  {aligned(columns, [f'{mark}{each.name}', *cells])}")
        if each.problem or each.aliased != "nothing":
            told = each.problem or f"not told apart: {each.aliased}"
            print_folded(console, "      ", told, style="dim")
    console.print()
    if comparison.recommended:
        console.print(f"Recommended: {comparison.recommended}", style="bold")
    for reason in comparison.reasons:
        print_folded(console, "  ", reason, style="")
    for note in comparison.notes:
        print_folded(console, "  ! ", note, style="yellow")
