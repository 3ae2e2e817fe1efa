"""What became of each run: status, failures, quality of the data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pandas as pd

from robot_runner.analysis.figures.effects import AttemptSpan, draw_timeline
from robot_runner.analysis.report.blocks import (
    Block,
    Cell,
    Column,
    FigureBlock,
    Paragraph,
    Part,
    Remark,
    Remarks,
    Section,
    Table,
    Tone,
)
from robot_runner.analysis.report.numbers import MISSING, listed, number_cell, shown_duration, shown_number
from robot_runner.analysis.wording import counted
from robot_runner.core.design.columns import RUN_ID, STATUS
from robot_runner.core.storage.cells import RunStatus

if TYPE_CHECKING:
    from collections.abc import Sequence

    from robot_runner.analysis.report.material import Material, RunQuality

__all__ = ["failures_in_words", "outcome_section"]

_TONES = {RunStatus.DONE.value: Tone.GOOD, RunStatus.FAILED.value: Tone.BAD}
_WORDS = {RunStatus.TODO.value: "To do"}


def outcome_section(material: Material) -> Section:
    """Return the section."""
    blocks: list[Block] = [Paragraph(_counts(material))]
    failures = failures_in_words(material)
    if failures:
        blocks.append(Remarks(tuple(Remark(title, text, Tone.BAD, "Failed") for title, text in failures)))
    spans = _spans(material)
    if spans:
        blocks.append(_timeline(material, spans))
    blocks.append(Part("outcome-runs", "Each run", (_run_table(material),)))
    if material.qualities:
        blocks.append(Part("outcome-quality", "Quality of the raw data", (_quality_table(material.qualities),)))
    return Section("outcome-of-each-run", "Outcome of each run", tuple(blocks))


def _counts(material: Material) -> str:
    counts = material.counts
    parts = [f"{counted(counts[RunStatus.DONE], 'run')} of {len(material.runs):,} done"]
    parts += [f"{counts[RunStatus.FAILED]:,} failed"] if counts[RunStatus.FAILED] else ["none failed"]
    left = counts[RunStatus.TODO] + counts[RunStatus.RUNNING]
    parts += [f"{left:,} still to do"] if left else []
    again = int((material.results.attempts["attempt"] > 1).sum())
    parts += [f"{counted(again, 'attempt')} more than one a run"] if again else []
    return f"{', '.join(parts)}."


def failures_in_words(material: Material) -> list[tuple[str, str]]:
    """Return the runs that failed with why, those of one reason together."""
    attempts = material.results.attempts
    failed = material.runs.loc[material.runs[STATUS].astype("str") == RunStatus.FAILED.value, RUN_ID]
    last = attempts.drop_duplicates("run_id", keep="last").set_index("run_id")["failure"]
    by_reason: dict[str, list[str]] = {}
    for run_id in failed:
        reason = last.get(run_id)
        text = reason if isinstance(reason, str) and reason else "No reason is recorded."
        by_reason.setdefault(text, []).append(run_id)
    return [(listed(run_ids), reason) for reason, run_ids in by_reason.items()]


def _run_table(material: Material) -> Table:
    results = material.results
    repetition = [results.repetition] if results.repetition else []
    columns = (
        Column("Run"),
        Column("Status"),
        *(Column(name) for name in results.factors),
        *(Column(name, is_number=True) for name in repetition),
        *(Column(results.label(name), is_number=True) for name in results.measures),
        Column("Took", is_number=True),
        Column("Attempts", is_number=True),
        Column("What looked odd"),
    )
    took, attempts, odd = _by_run(material)
    tried_again = any(count > 1 for count in attempts.values())
    rows = []
    for row in material.runs.to_dict("records"):
        run_id, status = str(row[RUN_ID]), str(row[STATUS])
        rows.append(
            (
                Cell.of_text(run_id),
                Cell(status, _WORDS.get(status, status), _TONES.get(status, Tone.PLAIN)),
                *(Cell.of_text(str(row[name])) for name in results.factors),
                *(_value(row[name]) for name in repetition),
                *(_value(row[name]) for name in results.measures),
                Cell(took.get(run_id), shown_duration(took.get(run_id))),
                number_cell(attempts.get(run_id) if tried_again else None),
                Cell.of_text(odd.get(run_id, "")),
            )
        )
    table = Table("runs", "All runs, in the order of the run table.", columns, tuple(rows))
    return table.without_blank("What looked odd", "Attempts", "Took")


def _by_run(material: Material) -> tuple[dict[str, float], dict[str, int], dict[str, str]]:
    """Return, by run: how long its last attempt took, how many attempts there were, what looked odd."""
    frame = material.results.attempts
    last = frame.drop_duplicates("run_id", keep="last")
    took = {
        run: float(seconds) for run, seconds in zip(last["run_id"], last["seconds"], strict=True) if pd.notna(seconds)
    }
    attempts = {str(run): int(count) for run, count in frame["run_id"].value_counts().items()}
    odd: dict[str, str] = {}
    for run, owner, problem in material.results.odd[["run_id", "owner", "problem"]].itertuples(index=False):
        text = f"{owner}: {problem}"
        odd[run] = f"{odd[run]}; {text}" if run in odd else text
    return took, attempts, odd


def _value(value: Any) -> Cell:
    if value is None or pd.isna(value):
        return Cell(None, MISSING)
    if isinstance(value, bool | str) or not isinstance(value, int | float):
        return Cell.of_text(str(value))
    return Cell(value, shown_number(value))


def _quality_table(qualities: Sequence[RunQuality]) -> Table:
    names = ("Runs", "Samples", "Least coverage (%)", "Lost", "Damaged", "Twice", "Longest gap (s)", "Saturated")
    columns = (Column("Plugin"), *(Column(name, is_number=True) for name in names), Column("Sensor"))
    rows = []
    for plugin in dict.fromkeys(each.plugin for each in qualities):
        mine = [each for each in qualities if each.plugin == plugin]
        lost, damaged = _total(mine, "lost"), _total(mine, "corrupt")
        rows.append(
            (
                Cell.of_text(plugin),
                number_cell(len(mine)),
                number_cell(_total(mine, "got")),
                number_cell(min((each.coverage for each in mine if each.coverage is not None), default=None)),
                number_cell(lost, tone=Tone.WARNING if lost else Tone.PLAIN),
                number_cell(damaged, tone=Tone.WARNING if damaged else Tone.PLAIN),
                number_cell(_total(mine, "duplicates")),
                _seconds(max((each.largest_gap for each in mine if each.largest_gap is not None), default=None)),
                number_cell(_total(mine, "saturated")),
                Cell.of_text(_sensor(mine)),
            )
        )
    table = Table("quality", "Completeness of the raw samples, all runs together.", columns, tuple(rows))
    return table.without_blank("Twice", "Saturated")


def _seconds(value: float | None) -> Cell:
    return Cell(value, MISSING if value is None else f"{value:.3g}")


def _total(qualities: Sequence[RunQuality], name: str) -> int | None:
    known = [value for each in qualities if (value := getattr(each, name)) is not None]
    return sum(known) if known else None


def _sensor(qualities: Sequence[RunQuality]) -> str:
    kinds = {each.is_simulated for each in qualities}
    if kinds == {True}:
        return "simulated"
    return "some simulated" if True in kinds else "real" if kinds == {False} else "not recorded"


def _timeline(material: Material, spans: tuple[AttemptSpan, ...]) -> FigureBlock:
    return FigureBlock(
        "timeline",
        "When each run was executed. Dark: measuring; light: getting ready and tidying up; hatched: an attempt that "
        "failed or was broken off.",
        f"{counted(len(spans), 'attempt')} beneath each other over the time since the experiment began.",
        lambda: draw_timeline(spans, order=material.order),
        is_wide=True,
    )


def _spans(material: Material) -> tuple[AttemptSpan, ...]:
    """Return all attempts with their times, in their order."""
    attempts = material.results.attempts.dropna(subset=["started_at"])
    if attempts.empty:
        return ()
    began = attempts["started_at"].min()
    events = material.results.events()
    measured = events[events["event"].isin(["start_measurement", "stop_measurement"])]
    stamps = {(run, str(event)): at for run, event, at in measured[["run_id", "event", "at"]].itertuples(index=False)}
    last = set(attempts.drop_duplicates("run_id", keep="last").index)
    spans = []
    for row in attempts.sort_values("started_at").itertuples():
        start = (row.started_at - began).total_seconds()
        edges = [stamps.get((row.run_id, name)) for name in ("start_measurement", "stop_measurement")]
        known = [(edge - began).total_seconds() for edge in edges if edge is not None and row.Index in last]
        seconds = 0.0 if pd.isna(row.seconds) else float(row.seconds)
        spans.append(
            AttemptSpan(
                row.run_id,
                material.labels.get(row.run_id, ""),
                start,
                start + seconds,
                (known[0], known[1]) if len(known) == len(edges) else None,
                is_done=row.status == "done",
            )
        )
    return tuple(span for span in spans if span.label)
