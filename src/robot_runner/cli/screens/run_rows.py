"""Finished runs as rows of a table that grows: run, treatments, measures, and how long it took."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from rich.text import Text

from robot_runner.cli.console import Column, aligned, fitting, shortened, width_of
from robot_runner.cli.design_words import heading_of, run_cells, run_columns
from robot_runner.core.design.columns import REPETITION, numbered_run_id
from robot_runner.core.events.measure import PublishedMeasure, Quality
from robot_runner.core.execution.task import AttemptStatus, RunTask
from robot_runner.core.words import enumerated, one_line, shown_duration, shown_treatment, shown_value

if TYPE_CHECKING:
    from robot_runner.core.config.experiment import Experiment
    from robot_runner.core.design.run_table_model import RunTableModel
    from robot_runner.core.execution.notices import AttemptFinished, WaitingForUser

#: A measure in four significant digits needs as much, with exponent and question mark.
_MEASURE = 10
_TOOK = 11
_INDENT = "  "


def shown_measure(published: PublishedMeasure | None) -> str:
    """Return a value in four significant digits, with a question mark where it is doubtful; a missing one as a dash."""
    if published is None:
        return shown_value(None)
    return shortened(shown_value(published.value)) + ("?" if published.quality is Quality.DOUBTFUL else "")


def treatments_in_words(task: RunTask | WaitingForUser, model: RunTableModel) -> str:
    """Return what a run varies, as `Task=Video, Repetition=3`."""
    parts = [f"{name}={shortened(shown_treatment(treatment))}" for name, treatment in task.combination.items()]
    if task.repetition == 0:
        parts.append("warm-up")
    elif model.repetitions > 1:
        parts.append(f"{REPETITION}={task.repetition}")
    return ", ".join(parts)


class RunRows:
    """Makes the rows for the runs of one experiment.

    Args:
        experiment: whose runs they are.
        measures: the units of the measure columns, by name.
        run_count: how many runs there are, for the width of their ids.
    """

    def __init__(self, experiment: Experiment, measures: Mapping[str, str], run_count: int) -> None:
        self._model = experiment.model
        self._measures = tuple(measures)
        self._what = run_columns(experiment.model, numbered_run_id(run_count))
        headings = [heading_of(name, unit) for name, unit in measures.items()]
        self._yields = [Column(heading, max(_MEASURE, width_of([heading])), is_number=True) for heading in headings]
        self._yields.append(Column("took", _TOOK, is_number=True))

    def header(self, width: int) -> Text:
        """Return the headings."""
        columns = self._fitting(width)
        return Text(_INDENT + aligned(columns, [column.heading for column in columns]), style="bold")

    def left_out(self, width: int) -> str:
        """Return which columns do not fit, in words; nothing where all do."""
        hidden = [column.heading for column in [*self._what, *self._yields][len(self._fitting(width)) :]]
        return f"too narrow for {enumerated(hidden)}; run_table.csv has all measures" if hidden else ""

    def row(self, finished: AttemptFinished, width: int) -> Text:
        """Return the row of an attempt that has ended."""
        columns = self._fitting(width)
        task, outcome = finished.task, finished.outcome
        what = run_cells(self._model, task.run_id, task.combination, task.repetition)
        if outcome.status is AttemptStatus.DONE:
            published = (outcome.measures.get(name) for name in self._measures)
            values = [shown_measure(each) for each in published]
            return Text(_INDENT + aligned(columns, [*what, *values, shown_duration(outcome.seconds)]))
        reason = one_line(str(outcome.failure)) if outcome.status is AttemptStatus.FAILED else "interrupted"
        again = "" if finished.is_last else f"attempt {task.attempt}, tried again: "
        head = aligned(columns[: len(what)], what)
        style = "red" if finished.is_last else "yellow"
        return Text(f"{_INDENT}{head}  ✗ {again}{reason}", style=style)

    def _fitting(self, width: int) -> list[Column]:
        columns = [*self._what, *self._yields]
        return columns[: fitting(columns, width - len(_INDENT))]
