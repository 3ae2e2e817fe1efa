"""Say how many repetitions a study needs, by simulation through the tests that its report will use.

Experiments are drawn from what is assumed and analysed as the config's plan says: its tests, families, corrections,
contrasts and bounds, in its design and its blocks. What is assumed comes from a pilot (--pilot) or from options (--sd
and --difference, or --means). Each figure has its Monte Carlo error.
"""

from __future__ import annotations

import json
import re
import sys
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from robot_runner.analysis.libraries import require_libraries
from robot_runner.analysis.wording import shown_number
from robot_runner.cli.console import (
    Column,
    UserConsole,
    aligned,
    complaints,
    is_live_terminal,
    output,
    print_facts,
    print_folded,
    print_json,
    quiet_loading,
    shown_path,
)
from robot_runner.cli.findings import show_findings
from robot_runner.cli.parser import Parser, UsageError, add_config, add_json, add_set
from robot_runner.cli.target import folder_of_target
from robot_runner.core.config.loader import parse_assignments
from robot_runner.core.config.preparation import prepare
from robot_runner.core.design.batches import GrownRunTableModel
from robot_runner.core.errors import ConfigError
from robot_runner.core.storage.system_refusals import storage_errors
from robot_runner.core.words import counted, listed

if TYPE_CHECKING:
    from robot_runner.analysis.planning.assumed_values import AssumedMeasure
    from robot_runner.analysis.planning.planned_study import Study
    from robot_runner.analysis.planning.power_analysis import PowerAnalysis
    from robot_runner.analysis.planning.power_search import PowerPoint, ScenarioPower, Search
    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.design.run_table_model import RunTableModel

_RANGE = re.compile(r"(\d+)(?:\.\.(\d+))?")
_BAR = 30
#: Above so many combinations, means are only in `--json`.
_MOST_MEANS = 12
#: The default range. With one repetition nothing can be tested, except in blocks and other special designs.
_FIRST, _LAST = 2, 50


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add_config(parser)
    add_set(parser)
    add_assumptions(parser)
    parser.add_argument("--output", metavar="FOLDER", help="write power.json, power.svg and power.png there")
    add_json(parser)


def add_assumptions(parser: Parser) -> None:
    """Add the options of the assumed values and of the effects to find."""
    parser.add_argument("--pilot", metavar="FOLDER", help="an experiment to take means, spreads and blocks from")
    parser.add_argument("--means", metavar="FILE", help="a CSV file with the mean of each combination")
    for name, metavar, text in (
        ("--sd", "[MEASURE=]SD", "standard deviation of runs of one combination, in the measure's unit"),
        ("--share", "[MEASURE=]PERCENT", "share of yes over all runs of a measure that is yes or no, as a success"),
        (
            "--difference",
            "[MEASURE:]FACTOR=SIZE",
            "what the last treatment adds to the first (beside a pilot: the smallest of interest; 'A x B' interact)",
        ),
        ("--block-sd", "[MEASURE=]SD", "standard deviation of what a block adds to all of its runs"),
        (
            "--response-sd",
            "[[MEASURE:]FACTOR=]SD",
            "standard deviation of what a block adds to all of its runs of a treatment, of each factor or of one",
        ),
        ("--measure", "NAME", "simulate this measure; without the option, those of the plan"),
        ("--effect", "CLAIM", "the effect to find: a hypothesis, Task or 'Task x Speed'"),
    ):
        parser.add_argument(
            name, metavar=metavar, action="append", default=[], help=f"{text}; may be given several times"
        )
    parser.add_argument("--power", metavar="SHARE", type=float, default=0.8, help="the power to reach (%(default)s)")
    parser.add_argument(
        "--repetitions",
        metavar="FROM..TO",
        help="the numbers of repetitions to try (2..50; from 1 on for special designs)",
    )
    parser.add_argument(
        "--first-batch",
        metavar="REPETITIONS",
        type=int,
        help="the number of repetitions executed already; further ones are a second batch, as after `extend`",
    )
    parser.add_argument(
        "--simulations", metavar="NUMBER", type=int, help="most experiments for each number of repetitions (10,000)"
    )
    parser.add_argument("--seed", metavar="NUMBER", type=int, default=1, help="seed of the simulation (%(default)s)")


def execute(arguments: Namespace) -> int:
    """Print the table, the curve and the answer."""
    analysis = computed_power(arguments)
    if arguments.output is not None:
        _write(analysis, Path(arguments.output).expanduser())
    if arguments.json:
        print_json(analysis.as_mapping())
        return 0
    console = output()
    for scenario in analysis.scenarios:
        _print(console, analysis, scenario)
    for note in analysis.notes:
        print_folded(console, "  ! ", note, style="yellow")
    if arguments.output is not None:
        print_facts(console, [("Written", f"{shown_path(Path(arguments.output).expanduser().resolve())}/")])
    return 0


def computed_power(arguments: Namespace) -> PowerAnalysis:
    """Return the power of the study that a config plans, under the assumptions of the options.

    Raises:
        ConfigError: the config is refused.
        UsageError: an option is invalid.
        AnalysisError: the assumptions do not suffice.
    """
    require_libraries()
    search = _search(arguments)
    pilot_folder = folder_of_target(arguments.pilot, []).root if arguments.pilot else None
    study = _study(arguments)
    if arguments.repetitions is None and study.arranged is not None and search.first_batch is None:
        search = replace(search, first=1)
    from robot_runner.analysis.planning.power_analysis import Assumptions, power_analysis  # noqa: PLC0415 - slow, and an extra
    from robot_runner.analysis.results import load_results  # noqa: PLC0415 - as above

    assumptions = Assumptions(
        pilot=load_results(pilot_folder) if pilot_folder is not None else None,
        means=Path(arguments.means).expanduser() if arguments.means else None,
        measures=arguments.measure,
        spreads=arguments.sd,
        differences=arguments.difference,
        blocks=arguments.block_sd,
        responses=arguments.response_sd,
        shares=arguments.share,
    )

    def tell(repetitions: int, experiments: int) -> None:
        show_progress(f"{counted(repetitions, 'repetition')}: {experiments:,} experiments")

    return power_analysis(study, assumptions, search, tell)


def planned_experiment(arguments: Namespace) -> tuple[Experiment, RunTableModel, dict[str, str]]:
    """Return the experiment of a config, its run-table model without later batches, and its measures' units.

    The order of the runs is drawn from `--seed` where the config gives none.

    Raises:
        ConfigError: the config is refused.
    """
    with quiet_loading():
        preparation = prepare(Path(arguments.config), parse_assignments(arguments.set), is_for_here=False)
    experiment = preparation.experiment
    if experiment is None:
        raise ConfigError.of_findings(preparation.findings)
    show_findings([each for each in preparation.findings if each.where.startswith("analysis")])
    model = experiment.model.as_configured if isinstance(experiment.model, GrownRunTableModel) else experiment.model
    if not (model.seed_is_given or model.seed_is_registered):
        model.take_seed(arguments.seed)  # otherwise a new order, and so other figures, in each call
    units = {column.name: column.measure.unit for column in experiment.columns.in_table if not column.tells_of}
    return experiment, model, units


def _study(arguments: Namespace) -> Study:
    from robot_runner.analysis.planning.planned_study import Study  # noqa: PLC0415 - slow, and an extra

    experiment, model, units = planned_experiment(arguments)
    study = Study.of_model(experiment.parameters.experiment_name, model, experiment.parameters.analysis, units)
    return replace(study, is_repeated=bool(experiment.parameters.repeat_until))


def _search(arguments: Namespace) -> Search:
    from robot_runner.analysis.planning.power_search import Search  # noqa: PLC0415 - slow, and an extra

    def refuse(option: str, given: object, fix: str) -> UsageError:
        return UsageError(f"{option} is {given}", where="robot-runner power", fix=fix)

    match = _RANGE.fullmatch(arguments.repetitions or f"{_FIRST}..{_LAST}")
    if match is None:
        raise refuse("--repetitions", arguments.repetitions, "Give two numbers, as in 5..40.")
    first, last = int(match[1]), int(match[2] or match[1])
    if not 1 <= first <= last:
        raise refuse("--repetitions", arguments.repetitions, "Begin with 1 or more, and end no lower.")
    if not 0 < arguments.power < 1:
        raise refuse("--power", arguments.power, "Give a share between 0 and 1, such as 0.8.")
    if arguments.simulations is not None and arguments.simulations < 1:
        raise refuse("--simulations", arguments.simulations, "Give a number above 0.")
    if arguments.seed < 0:
        raise refuse("--seed", arguments.seed, "Give a number from 0 on.")
    batch = arguments.first_batch
    if batch is not None and not 0 < batch < first:
        raise refuse("--first-batch", batch, "Give --repetitions that begin above it.")
    return Search(arguments.power, first, last, tuple(arguments.effect), arguments.simulations, arguments.seed, batch)


def show_progress(text: str = "") -> None:
    """Show progress in the place of the previous one; only on a terminal."""
    if is_live_terminal(sys.stderr):
        complaints().erase_line()
        complaints().print(text, end="")


def _print(console: UserConsole, analysis: PowerAnalysis, scenario: ScenarioPower) -> None:
    from robot_runner.analysis.planning.power_analysis import answer_in_words, share_in_words  # noqa: PLC0415 - slow, and an extra

    show_progress()
    console.print(f"Power at {scenario.scenario.title}", style="bold")
    for measure in scenario.scenario.measures:
        print_folded(console, "  ", _assumed_in_words(measure), style="dim")
    columns = [
        Column("Repetitions", 11, is_number=True),
        Column("Runs", 6, is_number=True),
        Column("Power (Monte Carlo)", 24),
        Column(f"0 {'·' * (_BAR - 8)} 100 %", _BAR),
    ]
    console.print(f"  {aligned(columns, [column.heading for column in columns])}", style="dim", soft_wrap=True)
    for point in scenario.points:
        cells = [
            f"{point.repetitions}",
            f"{point.runs}",
            share_in_words(point.least),
            _bar(point, analysis.search.power),
        ]
        print(f"  {aligned(columns, cells)}")
    print_folded(console, "  ", answer_in_words(analysis, scenario), style="")
    _print_claims(console, analysis, scenario)
    console.print()


def _assumed_in_words(measure: AssumedMeasure) -> str:
    unit = " %" if measure.is_share else ""
    means = [f"{shown_number(mean)}{unit} for {' / '.join(cell)}" for cell, mean in measure.means.items()]
    if measure.is_share:
        return f"Assumed shares of yes of {measure.name}: {listed(means, _MOST_MEANS)}"
    ends = [shown_number(spread) for spread in (min(measure.spreads.values()), max(measure.spreads.values()))]
    spread = " to ".join(dict.fromkeys(ends))
    return f"Assumed means of {measure.name}: {listed(means, _MOST_MEANS)}; standard deviation {spread}"


def _bar(point: PowerPoint, target: float) -> str:
    """Return the power as a bar, with a mark at the target."""
    filled, mark = round(_BAR * point.least.share), min(_BAR - 1, round(_BAR * target))
    return "".join("|" if place == mark else "█" if place < filled else " " for place in range(_BAR)).rstrip()


def _print_claims(console: UserConsole, analysis: PowerAnalysis, scenario: ScenarioPower) -> None:
    """Print how often each claim is found with the recommended number of repetitions."""
    from robot_runner.analysis.planning.power_analysis import share_in_words  # noqa: PLC0415 - slow, and an extra

    repetitions = analysis.search.last if scenario.needed is None else scenario.needed.repetitions
    point = scenario.point(repetitions)
    finds = f"{counted(repetitions, 'repetition')} find{'s' if repetitions == 1 else ''}"
    print_folded(console, "  ", f"What {finds} (* is sought):", style="dim")
    for place, (claim, found) in enumerate(zip(scenario.claims, point.claims, strict=True)):
        mark = "*" if place in scenario.sought else " "
        print_folded(console, f"   {mark} ", f"{claim.label}: {share_in_words(found)}", style="")
    if len(scenario.sought) > 1:
        print_folded(
            console, "     ", f"all that are sought, in one experiment: {share_in_words(point.together)}", style=""
        )


def _write(analysis: PowerAnalysis, folder: Path) -> None:
    from robot_runner.analysis.figures.effects import draw_power  # noqa: PLC0415 - slow, and an extra
    from robot_runner.analysis.figures.style import FigureFormat, figure_bytes  # noqa: PLC0415 - as above

    curves = {
        each.scenario.title: [(point.repetitions, point.least.share, *point.least.interval) for point in each.points]
        for each in analysis.scenarios
    }
    figure = draw_power(curves, analysis.search.power)
    text = json.dumps(analysis.as_mapping(), indent=2, ensure_ascii=False) + "\n"
    with storage_errors(folder, "written"):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "power.json").write_text(text, encoding="utf-8")
        for kind in (FigureFormat.SVG, FigureFormat.PNG):
            (folder / f"power.{kind.value}").write_bytes(figure_bytes(figure, kind))
