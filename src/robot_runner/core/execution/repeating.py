"""Repeating an experiment until it is precise: the repetition that is added, and what is known before it.

A repetition is every combination once more. It is in the journal, run by run, before any run of it is begun, so that an
experiment that was killed goes on with the same plan; it is judged again where the kill came before.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import chain
from typing import TYPE_CHECKING, Any, Protocol

from robot_runner.core.design.batches import (
    GrownRunTableModel,
    as_configured,
    first_batch,
    next_batch,
    repetition_record,
)
from robot_runner.core.design.growing import Begun, GrownDesign
from robot_runner.core.design.outliers import Doubtful
from robot_runner.core.design.planned_runs import RunOrder
from robot_runner.core.design.precise_estimates import Observed, judge
from robot_runner.core.design.precision import LEAST_REPETITIONS, most_repetitions
from robot_runner.core.errors import Finding
from robot_runner.core.execution.notices import PrecisionJudged
from robot_runner.core.execution.task import seed_of_run
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.words import counted

if TYPE_CHECKING:
    from collections.abc import Container, Iterator, Mapping, Sequence

    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.design.precise_estimates import Judgement
    from robot_runner.core.design.run_table_model import RunTableModel
    from robot_runner.core.execution.recovered_table import RecoveredTable
    from robot_runner.core.storage.run_table_rows import RunTableRows

__all__ = ["Bookkeeper", "Growth", "Repeating"]


@dataclass(frozen=True, slots=True)
class Growth:
    """A repetition that is to be added.

    Attributes:
        record: the fields of its record in the journal.
        model: the design with it.
        rows: the run table with it.
        places: of its runs, in the order of execution.
    """

    record: Mapping[str, Any]
    model: RunTableModel
    rows: RunTableRows
    places: Sequence[int]


class Bookkeeper(Protocol):
    """Takes down what is decided: the progress manager."""

    def grow(self, growth: Growth) -> None:
        """Add the runs of a repetition."""

    def note(self, kind: str, *, flush: bool = False, **fields: Any) -> None:
        """Keep what was known when it ended."""

    def find(self, finding: Finding) -> None:
        """Take down what is to be told at the end."""


class Repeating:
    """Decides after each repetition whether another one is needed.

    Args:
        experiment: what is executed.
        manifest: tells the seed, and whether the run table was written by hand: then it is executed as it is.
    """

    def __init__(self, experiment: Experiment, manifest: Mapping[str, Any]) -> None:
        is_by_hand = manifest["design"]["source"] != "config"
        self._where = f"{experiment.config_path}, repeat_until"
        model = experiment.model
        self._config = as_configured(model)
        self._model = model
        plan = experiment.parameters.analysis
        self._leaves_out = plan is not None and plan.doubtful is Doubtful.LEAVE_OUT
        self._seed = int(manifest["seed"])
        self._is_passed_over = is_by_hand and bool(experiment.parameters.repeat_until)
        planned_often = self._config.repetitions >= LEAST_REPETITIONS  # one run that is only tried is not
        self._rules = experiment.parameters.repeat_until if planned_often and not is_by_hand else ()

    @property
    def may_add(self) -> bool:
        """Whether there may be a repetition more."""
        return self._model.repetitions < most_repetitions(self._rules)

    def judge(self, progress: Bookkeeper, table: RecoveredTable) -> PrecisionJudged | None:
        """Have a repetition added where one is needed, and else take down why not.

        Args:
            progress: takes it down.
            table: a run table of which no run is to do.

        Returns:
            what is known by now; None without rules.
        """
        if self._is_passed_over:
            problem = "the run table was written by hand and is executed as it is: nothing is repeated"
            progress.find(
                Finding.warning(self._where, problem, "Have the config plan the runs, or leave the rule out.")
            )
        looks, now = (self._config.repetitions, most_repetitions(self._rules)), self._model.repetitions
        rows = table.rows
        doubtful = {rule.measure: table.reasons[rule.measure] if self._leaves_out else () for rule in self._rules}
        judged = [
            judge(rule, looks, now, _observed(rows, rule.measure, doubtful[rule.measure])) for rule in self._rules
        ]
        if not judged:
            return None
        facts = list(map(_facts, judged))
        if any(each.needs_more for each in judged):
            growth = self._grown(rows, facts)
            progress.grow(growth)
            return PrecisionJudged(now, judged, len(growth.rows), len(growth.places))
        progress.note("judged", repetition=now, precision=facts)
        for finding in chain.from_iterable(_ending_findings(each, self._where) for each in judged):
            progress.find(finding)
        return PrecisionJudged(now, judged, len(rows))

    def _grown(self, rows: RunTableRows, facts: Sequence[Mapping[str, Any]]) -> Growth:
        begun = Begun(
            factors=self._model.factors,
            runs=list(rows.planned),
            chosen={},
            has_repetition=rows.layout.has_repetition,
            is_by_hand=False,
        )
        batches = self._model.batches or (first_batch(begun, self._order(self._seed)),)
        number = batches[-1].repetitions + 1
        combinations = {tuple(map(str, run.combination.treatments)): run.combination for run in begun.runs}
        design = GrownDesign(self._model.factors, list(combinations.values()), number, {}, {})
        order = self._order(seed_of_run(self._seed, f"repetition {number}"))
        planned = next_batch(begun, design, None, order=order, number=batches[-1].number, at="")
        record = repetition_record(batches[-1], planned.runs, is_first=not self._model.batches)
        record["precision"] = facts
        self._model = GrownRunTableModel(
            self._config, [*batches[:-1], batches[-1].with_repetition(number, planned.runs)]
        )
        new = {run.run_id for run in planned.runs}
        added = [run for run in self._model.plan() if run.run_id in new]
        places = range(len(rows), len(rows) + len(added))
        return Growth(record, self._model, rows.with_plan([*rows.planned, *added], rows.layout), places)

    def _order(self, seed: int) -> RunOrder:
        return RunOrder(shuffle=self._config.shuffle, blocks=self._config.blocks, seed=seed, seed_is_given=True)


def _observed(rows: RunTableRows, measure: str, doubtful: Container[str]) -> Iterator[Observed]:
    """Yield what each run yielded; those that were excluded and those that only warm up are left out."""
    for place, (run, value) in enumerate(zip(rows.planned, rows.values(measure), strict=True)):
        if not run.is_warm_up and rows.excluded(place) is None:
            treatments = {name: str(treatment) for name, treatment in run.combination.items()}
            is_done = rows.status(place) is RunStatus.DONE and run.run_id not in doubtful
            yield Observed(run.run_id, treatments, run.repetition, value if is_done else None)


def _facts(judgement: Judgement) -> dict[str, Any]:
    """Return a judgement as plain data, for the journal."""
    return {
        **judgement.rule.as_mapping(),
        "is_precise": judgement.is_precise,
        "level": judgement.level,
        "in_words": judgement.in_words(),
        "known": [{name: value for name, value in asdict(each).items() if value} for each in judgement.known],
    }


def _ending_findings(judgement: Judgement, where: str) -> Iterator[Finding]:
    """Yield what is to be told at the end of an experiment that is repeated no further."""
    measure = judgement.rule.measure
    for problem in judgement.problems:
        fix = "See why, or ask for a half width in the measure's unit. It was not repeated for this."
        yield Finding.warning(where, f"{measure}: {problem}", fix)
    for each in judgement.known:
        if each.oddity:
            yield Finding.warning(where, f"{measure} of {each.of}: {each.oddity}", "Look whether it is resolved.")
    if not judgement.is_precise and not judgement.problems:
        often = counted(judgement.repetitions, "repetition")
        problem = f"not as precise as wanted after {often}, which is at_most. {judgement.in_words()}"
        yield Finding.warning(where, problem, "Report the interval that there is: more was not planned.")
