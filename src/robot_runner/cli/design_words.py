"""A run-table model in words and as plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from robot_runner.cli.console import Column, UserConsole, aligned, fitting, width_of
from robot_runner.core.design.batch import Batch
from robot_runner.core.design.columns import BATCH, REPETITION
from robot_runner.core.design.factor import Factor
from robot_runner.core.design.full_factorial import full_size
from robot_runner.core.design.listed_runs import ListedRunTableModel
from robot_runner.core.design.numeric_range import is_number
from robot_runner.core.design.planned_runs import PlannedRun
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.events.measure import QUALITY_SUFFIX, MeasureColumns
from robot_runner.core.words import INACTIVE, counted, enumerated, listed, plain, shown_treatment

# The columns that distinguish runs: id, treatments, repetition.


def run_columns(model: RunTableModel, last_run_id: str) -> list[Column]:
    """Return the columns for the runs of a design."""
    columns = [Column("run", width_of(["run", last_run_id])), *map(_factor_column, model.factors)]
    if model.repetitions > 1:
        columns.append(Column(REPETITION, len(REPETITION), is_number=True))
    return columns


def run_cells(model: RunTableModel, run_id: str, combination: Mapping[str, object], repetition: int) -> list[str]:
    """Return the cells of one run."""
    cells = [run_id, *map(shown_treatment, combination.values())]
    return [*cells, str(repetition) if repetition else "warm-up"] if model.repetitions > 1 else cells


#: Of a table of more runs than this, the first and the last ones are shown.
_LONG = 40
_FIRST, _LAST = 20, 5


def print_runs(
    console: UserConsole, model: RunTableModel, runs: Sequence[PlannedRun], *, shows_all: bool = False
) -> None:
    """Print planned runs as a table; of a long one its head and its tail, unless all runs are requested."""
    is_abbreviated = not shows_all and len(runs) > _LONG
    head, tail = (runs[:_FIRST], runs[-_LAST:]) if is_abbreviated else (runs, ())
    longest = max((run.run_id for run in (*head, *tail)), key=len)
    columns = [*run_columns(model, longest), *_mark_columns(model, runs)]
    shown = columns[: fitting(columns, console.width)]
    console.print(aligned(shown, [column.heading for column in columns]), style="bold", soft_wrap=True)
    for run in head:
        print(aligned(shown, _cells(run, model)))
    if is_abbreviated:
        left_out = len(runs) - _FIRST - _LAST
        console.print(f"… {counted(left_out, 'run')} left out: --all shows them …", style="dim")
    for run in tail:
        print(aligned(shown, _cells(run, model)))
    if len(shown) < len(columns):
        names = listed((column.heading for column in columns[len(shown) :]), _MOST_NAMES)
        console.print(f"No room for: {names}. A wider terminal shows them, and so does --json.", style="dim")


#: How many factors or measures are named in one line at most; for more factors of a design only their number is shown.
_MOST_NAMES = 12


def _mark_columns(model: RunTableModel, runs: Sequence[PlannedRun]) -> list[Column]:
    marks = [BATCH] if model.is_extended else []
    marks += ["block"] if any(run.block is not None for run in runs) else []
    return [Column(name, len(name), is_number=True) for name in marks]


def _cells(run: PlannedRun, model: RunTableModel) -> list[str]:
    cells = run_cells(model, run.run_id, run.combination, run.repetition)
    batch = [str(run.batch)] if model.is_extended else []
    return [*cells, *batch, *([] if run.block is None else [str(run.block)])]


def _factor_column(factor: Factor) -> Column:
    are_numbers = all(map(is_number, factor.treatments))
    return Column(factor.name, width_of([factor.name, *map(shown_treatment, factor.treatments)]), are_numbers)


def in_words(model: RunTableModel) -> str:
    """Return the number of runs and its factors, in words.

    Example:
        >>> from robot_runner.core.design.factor import Factor
        >>> from robot_runner.core.design.run_table_model import RunTableModel
        >>> in_words(RunTableModel([Factor("Task", ["Video", "Network"]), Factor("Speed", [1])], repetitions=3))
        '6 runs: Task (2) x Speed (1) x 3 repetitions'
        >>> factors = [Factor("Sensor", ["camera", "lidar"]), Factor("Pixels", [720, 1080], when={"Sensor": "camera"})]
        >>> in_words(RunTableModel(factors))
        '3 runs: Sensor (2) x Pixels (2, where Sensor=camera)'
    """
    parts = [f"{factor.name} ({_treatments_in_words(factor)})" for factor in model.factors]
    if isinstance(model, ListedRunTableModel):
        return f"{counted(len(model.runs), 'run')}, listed one by one: {', '.join(parts) or 'nothing is varied'}"
    combinations = full_size(model.factors)
    runs = sum(not run.is_warm_up for run in model.plan())
    if not model.is_full_factorial and not model.is_extended:
        size = combinations * model.repetitions
        shown = f"{size:,}" if size < _LARGE else f"some 10^{len(str(size)) - 1}"
        has_ranges = any(factor.range is not None for factor in model.factors)
        full = "" if has_ranges else f"; the full factorial has {shown}"
        named = " x ".join(parts) if len(parts) <= _MOST_NAMES else f"{len(parts):,} factors"
        return f"{counted(runs, 'run')}, {kind_in_words(model)}{full}: {named}"
    if model.repetitions > 1 and not model.design_facts.get("decides"):  # then it varies from one to another
        parts.append(f"{model.repetitions:,} repetitions")
    if model.is_extended:
        sizes = enumerated(f"{len(batch.run_ids):,}" for batch in model.batches)
        return f"{counted(runs, 'run')} in {len(model.batches)} batches of {sizes}: {' x '.join(parts)}"
    excluded = combinations - runs // model.repetitions
    less = f", {counted(excluded, 'combination')} excluded" if excluded else ""
    return f"{counted(runs, 'run')}: {' x '.join(parts)}{less}"


def kind_in_words(model: RunTableModel) -> str:
    """Return the kind of a design, as in `fractional factorial`."""
    return str(model.design_facts.get("kind", "design")).replace("_", " ")


def design_in_words(model: RunTableModel) -> list[tuple[str, str]]:
    """Return the choice of a design other than the full factorial, and its price, as headed lines."""
    if model.is_full_factorial:
        return []
    facts = model.design_facts
    if "layout" in facts:  # it is printed as tables, which show the rest
        return [("Design", "; ".join([kind_in_words(model), *facts.get("notes", ())]))]
    told = [f"{name.replace('_', ' ')}: {_fact(value)}" for name, value in facts.items() if name not in _TOLD_APART]
    return [
        ("Design", "; ".join([kind_in_words(model), *told])),
        ("Resolution", _RESOLUTIONS.get(min(facts.get("resolution", 0), 5), "")),
        ("Aliases", _aliases_in_words(facts)),
    ]


_LARGE = 10**12
_TOLD_APART = frozenset({"kind", "resolution", "aliases", "aliases_listed", "ranges", "decides"})
_RESOLUTIONS = {
    3: "3: main effects can be told from each other, but not from interactions of two factors",
    4: "4: main effects can be told from interactions of two factors, but these not from each other",
    5: "5 or more: main effects and interactions of two factors can all be told apart",
}


def _fact(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} {each}" for name, each in value.items())
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def _aliases_in_words(facts: Mapping[str, Any]) -> str:
    """Return which effects cannot be told apart, as in `Load = Speed x Task`."""
    if "aliases" not in facts:
        return ""
    if facts.get("aliases_listed") is False:
        return "too many effects to list them"
    groups = (" = ".join(" x ".join(effect) for effect in group) for group in facts["aliases"])
    return "; ".join(groups) or "none among main effects and interactions of two factors"


def _treatments_in_words(factor: Factor) -> str:
    span = factor.range
    count = sum(each is not INACTIVE for each in factor.treatments)
    told = f"{count:,}" if span is None else f"{span.lower} to {span.upper} {span.unit}".rstrip()
    where = (f"{name}={' or '.join(map(shown_treatment, wanted))}" for name, wanted in (factor.when or {}).items())
    return f"{told}, where {' and '.join(where)}" if factor.when else told


def warm_ups_in_words(model: RunTableModel, runs: Sequence[PlannedRun]) -> str:
    """Return which runs only warm up; empty where none does."""
    ids = [run.run_id for run in runs if run.is_warm_up]
    if not ids:
        return ""
    how = f" ({model.warm_up})" if model.warm_up else ""
    again = ", and again in each session" if model.warm_up and model.warm_up.each_session else ""
    return f"{listed(ids)}{how}: executed and kept, not analysed{again}"


def shown_order(*, shuffle: bool, blocks: str | None, origin: str) -> str:
    """Return the rule of the order of runs; `origin` is the source of a randomised one.

    Example:
        >>> shown_order(shuffle=True, blocks="Repetition", origin=" from seed 7")
        'randomised within blocks of Repetition from seed 7'
    """
    if not shuffle:
        return f"as written, in blocks of {blocks}" if blocks else "as written"
    return f"randomised{f' within blocks of {blocks}' if blocks else ''}{origin}"


def batch_order_in_words(batch: Batch) -> str:
    """Return how the runs of a batch were put in order among themselves."""
    order = batch.order
    return shown_order(shuffle=order.shuffle, blocks=order.blocks, origin=f" among themselves from seed {order.seed}")


def batch_as_json(batch: Batch) -> dict[str, Any]:
    """Return how a batch was planned as plain data."""
    return {**batch.summary(), "order": batch_order_in_words(batch)}


def order_in_words(model: RunTableModel, seed: int | None = None) -> str:
    """Return in which order the runs are executed, batch by batch; `seed` is that of a table that was made."""
    is_known = model.seed_is_given or model.seed_is_registered
    origin = f", from seed {model.seed}" if is_known else ", from a seed that is drawn at the start and recorded"
    origin = origin if seed is None else f" from seed {seed}"
    first = shown_order(shuffle=model.shuffle, blocks=model.blocks, origin=origin)
    return "; ".join([first, *(f"batch {each.number} {batch_order_in_words(each)}" for each in model.batches[1:])])


def measures_in_words(columns: MeasureColumns) -> str:
    """Return the measure columns of the run table with their units, and whether each has one of its quality."""
    telling = {each.name + QUALITY_SUFFIX for each in columns.in_table}
    measures = [each for each in columns.in_table if each.name not in telling]
    told = listed((heading_of(each.name, each.measure.unit) for each in measures), _MOST_NAMES) or "none"
    return told if len(measures) == len(columns.in_table) else f"{told}; each with its quality"


def heading_of(measure: str, unit: str) -> str:
    """Return the heading of a measure's column.

    Example:
        >>> heading_of("Energy", "J"), heading_of("Errors", "1")
        ('Energy (J)', 'Errors')
    """
    return f"{measure} ({unit})" if unit not in {"", "1"} else measure


def design_as_json(model: RunTableModel) -> dict[str, Any]:
    """Return factors, repetitions and order as plain data."""
    warm_up = {"warm_up": asdict(model.warm_up)} if model.warm_up else {}
    batches = {"batches": list(map(batch_as_json, model.batches))} if model.is_extended else {}
    chosen = {**model.design.as_mapping(), "facts": dict(model.design_facts)}
    design = {} if model.is_full_factorial else {"design": chosen}
    return {
        "run_count": len(model.plan()),
        "factors": {factor.name: list(map(plain, factor.treatments)) for factor in model.factors},
        "repetitions": model.repetitions,
        "order": {
            "is_randomised": model.shuffle,
            "blocks": model.blocks,
            "seed": model.seed if model.seed_is_given else None,
        },
        **design,
        **warm_up,
        **batches,
    }


def columns_as_json(columns: MeasureColumns) -> list[dict[str, str]]:
    """Return the measure columns of the run table as plain data."""
    return [{"name": column.name, "unit": column.measure.unit, "owner": column.owner} for column in columns.in_table]


def run_as_json(run: PlannedRun) -> dict[str, Any]:
    """Return a planned run as plain data."""
    return {
        "run_id": run.run_id,
        "number": run.number,
        "combination": {name: plain(treatment) for name, treatment in run.combination.items()},
        "repetition": run.repetition,
        "block": run.block,
        "batch": run.batch,
        "is_warm_up": run.is_warm_up,
    }
