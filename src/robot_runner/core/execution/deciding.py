"""Deciding from the results, once all planned runs are done, which runs follow; and adding them to the plan.

An answer is in the journal, run by run, before any run of it is begun, so that an experiment that was killed goes on
with the same plan; where the kill came before, the same is asked again, and answered in the same way.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

from robot_runner.core.config.experiment import Experiment
from robot_runner.core.design.asking import HOW_OFTEN, WHICH_RUNS, AdaptiveDesign, Asking, Decision, Told
from robot_runner.core.design.batches import (
    EXTENDED,
    GrownRunTableModel,
    as_configured,
    extended_batch,
    first_batch,
    next_batch,
    records_of,
)
from robot_runner.core.design.columns import WARM_UP
from robot_runner.core.design.extended_design import Begun, ExtendedDesign
from robot_runner.core.design.outliers import Doubtful
from robot_runner.core.design.planned_runs import PlannedRun, RunOrder
from robot_runner.core.design.precise_estimates import UntilPrecise
from robot_runner.core.design.precision import LEAST_REPETITIONS, Precision
from robot_runner.core.design.run_table_model import RunTableModel
from robot_runner.core.errors import Finding
from robot_runner.core.execution.notices import NextDecided
from robot_runner.core.execution.recovered_table import RecoveredTable
from robot_runner.core.execution.task import seed_of_run
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.journal import utc_now
from robot_runner.core.storage.run_table_rows import RunTableRows


@dataclass(frozen=True, slots=True)
class Growth:
    """Runs to be added: kind and fields of their record, the design and the run table with them, and their places."""

    kind: str
    record: Mapping[str, Any]
    model: RunTableModel
    rows: RunTableRows
    places: Sequence[int]


class Bookkeeper(Protocol):
    """What `Deciding` needs of the progress manager."""

    def grow(self, growth: Growth) -> None:
        """Add the runs that were decided on."""

    def note(self, kind: str, *, flush: bool = False, **fields: Any) -> None:
        """Append a record to the journal."""

    def find(self, *findings: Finding) -> None:
        """Keep findings for the end of the experiment."""


def asking_of(model: RunTableModel, rules: Sequence[Precision]) -> Asking | None:
    """Return the design, or the rules of `repeat_until`, that decide from results which runs follow; else None."""
    config = as_configured(model)
    if isinstance(config.design, AdaptiveDesign):
        return config.design.asking(config.factors, config.allowed, config.repetitions)
    least = config.repetitions  # one run that is only tried is not repeated
    return UntilPrecise(rules, model.factors, least) if rules and least >= LEAST_REPETITIONS else None


def what_follows(asking: Asking | None, runs: Sequence[PlannedRun]) -> str:
    """Return in words which runs may follow these; empty where none does."""
    if asking is None or not asking.may_add(runs):
        return ""
    return HOW_OFTEN if isinstance(asking, UntilPrecise) else WHICH_RUNS


class Deciding:
    """Decides, whenever all planned runs are done, whether and which runs follow."""

    def __init__(self, experiment: Experiment, manifest: Mapping[str, Any]) -> None:
        model = experiment.model
        self._experiment = experiment
        self._where = f"{experiment.config_path}, {'repeat_until' if model.is_full_factorial else 'design'}"
        self._config = as_configured(model)
        self._model = model
        plan = experiment.parameters.analysis
        self._leaves_out = plan is not None and plan.doubtful is Doubtful.LEAVE_OUT
        self._seed = int(manifest["seed"])
        asking = asking_of(model, experiment.parameters.repeat_until)
        is_by_hand = manifest["design"]["source"] != "config"
        self._is_passed_over = is_by_hand and asking is not None
        self._asks = None if is_by_hand else asking

    def follows(self, rows: RunTableRows) -> str:
        """Return in words which runs may follow those of this table; empty where none does."""
        return what_follows(self._asks, list(rows.planned))

    def decide(self, progress: Bookkeeper, table: RecoveredTable, *, is_of_part: bool = False) -> NextDecided | None:
        """Add the runs that follow, or record why none does; where only a part was chosen, tell that others may follow.

        Return what was decided and why; None where nothing is to be decided.
        """
        if self._is_passed_over:
            problem = "the run table was written by hand and is executed as it is: nothing is repeated"
            fix = "Have the config plan the runs, or leave the rule out."
            progress.find(Finding.warning(self._where, problem, fix))
        if self._asks is None:
            return None
        if is_of_part:
            if follows := self.follows(table.rows):
                fix = "Start the experiment without them: it decides, and goes on where runs follow."
                progress.find(Finding.warning("--only and --skip", f"it is not decided {follows}", fix))
            return None
        decision = self._asks.ask(list(self._told(self._asks.measures, table)))
        if not decision.runs:
            progress.note("judged", **decision.facts)
            progress.find(*decision.warnings(self._where))
            return NextDecided(decision.in_words, len(table.rows))
        growth = self._grown(table.rows, decision)
        progress.grow(growth)
        return NextDecided(decision.in_words, len(growth.rows), len(growth.places))

    def _told(self, measures: Sequence[str], table: RecoveredTable) -> Iterator[Told]:
        rows = table.rows
        values = {name: list(rows.values(name)) for name in measures}
        doubtful = {name: table.reasons[name] if self._leaves_out else () for name in measures}
        for place, run in enumerate(rows.planned):
            if run.is_warm_up:
                continue
            is_excluded = rows.excluded(place) is not None
            has_values = rows.status(place) is RunStatus.DONE and not is_excluded
            own = {
                name: values[name][place]
                for name in measures
                if has_values and values[name][place] is not None and run.run_id not in doubtful[name]
            }
            is_doubtful = has_values and any(run.run_id in doubtful[name] for name in measures)
            yield Told(run, own, is_excluded or is_doubtful, is_doubtful)

    def _grown(self, rows: RunTableRows, decision: Decision) -> Growth:
        combinations = [*(run.combination for run in rows.planned), *(combination for combination, _ in decision.runs)]
        begun = Begun(
            factors=tuple(each.with_chosen(combinations) for each in self._model.factors),
            runs=list(rows.planned),
            chosen={},
            has_repetition=rows.layout.has_repetition,
            is_by_hand=False,
        )
        batches = self._model.batches or (first_batch(begun, self._order(self._seed)),)
        repetitions = max(batches[-1].repetitions, *(repetition for _, repetition in decision.runs))
        design = ExtendedDesign(begun.factors, [], repetitions, {}, {})
        order = self._order(seed_of_run(self._seed, decision.name), decision.blocks)
        number, at = (batches[-1].number + 1, utc_now()) if decision.confirms else (batches[-1].number, "")
        planned = next_batch(begun, design, None, order=order, number=number, at=at, wanted=decision.runs)
        is_first = not self._model.batches
        if decision.confirms:
            kind, batches = EXTENDED, (*batches, replace(planned, confirms=True))
            *_, record = records_of(batches)
        else:
            kind = decision.kind
            grown, record = extended_batch(batches[-1], decision, planned, is_first=is_first)
            batches = (*batches[:-1], grown)
        self._model = GrownRunTableModel(self._config, batches)
        new = {run.run_id for run in planned.runs}
        added = [run for run in self._model.plan() if run.run_id in new]
        was = rows.layout
        layout = replace(self._experiment, model=self._model).table_layout(was.types, warms_up=WARM_UP in was.marks)
        layout = replace(layout, extras=was.extras, former_measures=was.former_measures)
        layout = replace(layout, has_exclusions=was.has_exclusions)
        places = range(len(rows), len(rows) + len(added))
        grown_rows = rows.with_plan([*rows.planned, *added], layout)
        return Growth(kind, {**record, **decision.facts}, self._model, grown_rows, places)

    def _order(self, seed: int, blocks: str | None = None) -> RunOrder:
        blocks = blocks or self._config.blocks
        return RunOrder(shuffle=self._config.shuffle, blocks=blocks, seed=seed, seed_is_given=True)
