"""The section on the outcome of each run: status, reason of failure, time of execution, completeness of samples.

For a covering array it also lists the pairs of treatments with failed runs, which is the purpose of such a design.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations, compress
from typing import Any, NamedTuple

import pandas as pd

from robot_runner.analysis.figures.missions import AttemptSpan, draw_timeline
from robot_runner.analysis.report.blocks import (
    Block,
    Cell,
    FigureBlock,
    Paragraph,
    Part,
    Remark,
    Remarks,
    Section,
    Table,
    Tone,
)
from robot_runner.analysis.report.charts import even_share, in_order_of_execution
from robot_runner.analysis.report.material import Material, RunQuality, by_plugin
from robot_runner.analysis.report.tables import Field, build_table, field, number, number_cell, text
from robot_runner.analysis.wording import MISSING, kind_of, listed
from robot_runner.core.design.columns import EXCLUDED, RUN_ID, STATUS
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.words import counted, shown_duration

_TONES = {RunStatus.DONE.value: Tone.GOOD, RunStatus.FAILED.value: Tone.BAD}
_WORDS = {RunStatus.TODO.value: "To do"}
#: Runs of a timeline: more would be thinner than the dots of a printer.
_MOST_ROWS = 2_000
#: The events at which a measurement begins and ends.
_EDGES = ("start_measurement", "stop_measurement")
#: Stamps and durations are rounded to milliseconds and taken one after the other: so much may be between them, s.
_ROUNDED = 0.1


def outcome_section(material: Material) -> Section:
    """Return the section on the outcome of each run."""
    blocks: list[Block] = [Paragraph(_counts(material))]
    failures = failures_in_words(material)
    if failures:
        blocks.append(Remarks(tuple(Remark(title, reason, Tone.BAD, "Failed") for title, reason in failures)))
    blocks += failed_pair_parts(material)
    spans = attempt_spans(material)
    if spans:
        blocks.append(_timeline(material, spans))
    blocks.append(Part("outcome-runs", "Each run", (_run_table(material),)))
    if len(material.doubted):
        blocks.append(Part("outcome-values", "Doubtful and missing values", (_value_table(material),)))
    if material.qualities:
        blocks.append(Part("outcome-quality", "Quality of the raw data", (_quality_table(material.qualities),)))
    return Section("outcome-of-each-run", "Outcome of each run", tuple(blocks))


def _counts(material: Material) -> str:
    counts = material.counts
    left = counts[RunStatus.TODO] + counts[RunStatus.RUNNING]
    again = int((material.results.attempts["attempt"] > 1).sum())
    parts = [
        f"{counted(counts[RunStatus.DONE], 'run')} of {len(material.runs):,} done",
        f"{counts[RunStatus.FAILED]:,} failed" if counts[RunStatus.FAILED] else "none failed",
        f"{left:,} still to do" if left else "",
        f"{len(material.excluded):,} excluded" if len(material.excluded) else "",
        f"{counted(again, 'attempt')} more than one a run" if again else "",
    ]
    return f"{', '.join(filter(None, parts))}."


def failures_in_words(material: Material) -> list[tuple[str, str]]:
    """Return failed runs and reasons, grouped by reason."""
    failed = material.runs.loc[material.runs[STATUS].astype("str") == RunStatus.FAILED.value, RUN_ID]
    last = material.last_attempts.set_index("run_id")["failure"]
    by_reason: dict[str, list[str]] = {}
    for run_id in failed:
        reason = last.get(run_id)
        known = reason if isinstance(reason, str) and reason else "No reason is recorded."
        by_reason.setdefault(known, []).append(run_id)
    return [(listed(run_ids), reason) for reason, run_ids in by_reason.items()]


def _run_table(material: Material) -> Table:
    results = material.results
    attempts = results.attempts["run_id"].value_counts().to_dict()
    tried_again = any(count > 1 for count in attempts.values())
    took = material.last_attempts.set_index("run_id")["seconds"].dropna().to_dict()
    odd: dict[str, str] = {}
    for run, owner, problem in results.odd[["run_id", "owner", "problem"]].itertuples(index=False):
        odd[run] = f"{odd[run]}; {owner}: {problem}" if run in odd else f"{owner}: {problem}"

    def status(row: dict[str, Any]) -> Cell:
        word = str(row[STATUS])
        return Cell(word, _WORDS.get(word, word), _TONES.get(word, Tone.PLAIN))

    def duration(row: dict[str, Any]) -> Cell:
        seconds = took.get(row[RUN_ID])
        return Cell(seconds, MISSING if seconds is None else shown_duration(seconds))

    repetition = [name for name in (results.repetition, results.batch) if name]
    fields = (
        text("Run", lambda row: str(row[RUN_ID])),
        field("Status", status),
        *(_values(name, name, is_number=False) for name in results.factors),
        *(_values(name, name) for name in repetition),
        *(_values(results.label(name), name) for name in results.measures),
        field("Took", duration, is_number=True),
        number("Attempts", lambda row: attempts.get(row[RUN_ID]) if tried_again else None),
        text("Excluded", lambda row: str(row[EXCLUDED]) if pd.notna(row.get(EXCLUDED)) else ""),
        text("What looked odd", lambda row: odd.get(row[RUN_ID], "")),
    )
    caption = "All runs, in the order of the run table."
    # The time stamps, which the table does not show, would take as long as the rest of it.
    shown = {RUN_ID, STATUS, EXCLUDED, *results.factors, *repetition, *results.measures}
    runs = results.all_runs
    table = build_table("runs", caption, runs[[name for name in runs if name in shown]].to_dict("records"), fields)
    return table.without_blank("Excluded", "What looked odd", "Attempts", "Took")


def _value_table(material: Material) -> Table:
    """Return a table of values that are not good; similar reasons are listed once."""
    groups: dict[tuple[str, str, str], list[tuple[str, str]]] = {}
    for run, measure, quality, reasons in material.doubted.itertuples(index=False):
        groups.setdefault((measure, str(quality), kind_of(reasons, run)), []).append((str(run), reasons))

    def reason(group: tuple[str, str, str]) -> str:
        told = list(dict.fromkeys(reasons for _, reasons in groups[group]))
        return f"{told[0]}{', and the like' if len(told) > 1 else ''}" if told[0] else "No reason was given."

    fields = (
        text("Measure", lambda group: group[0]),
        text("Quality", lambda group: group[1], lambda _: Tone.WARNING),
        number("Values", lambda group: len(groups[group])),
        text("Runs", lambda group: listed(run for run, _ in groups[group])),
        text("Reason", reason),
    )
    return build_table("doubtful values", "Values of runs that are done which are doubtful or missing.", groups, fields)


def _values(heading: str, name: str, *, is_number: bool = True) -> Field:
    """Return a column of the run table: a factor, or a measure of any type."""

    def cell(row: dict[str, Any]) -> Cell:
        value = row[name]
        if not is_number or isinstance(value, bool | str):
            return Cell.of_text(str(value))
        if value is None or pd.isna(value):
            return Cell(None, MISSING)
        return number_cell(value) if isinstance(value, int | float) else Cell.of_text(str(value))

    return field(heading, cell, is_number=is_number)


def _quality_table(qualities: Sequence[RunQuality]) -> Table:
    mine = by_plugin(qualities)

    def of_all(combine: Callable[..., Any], name: str) -> Callable[[str], Any]:
        def combined(plugin: str) -> Any:
            known = [value for each in mine[plugin] if (value := getattr(each, name)) is not None]
            return combine(known) if known else None

        return combined

    fields = (
        text("Plugin", str),
        number("Runs", lambda plugin: len(mine[plugin])),
        number("Samples", of_all(sum, "got")),
        number("Least coverage (%)", of_all(min, "coverage")),
        number("Lost", of_all(sum, "lost"), warns=True),
        number("Damaged", of_all(sum, "corrupt"), warns=True),
        number("Twice", of_all(sum, "duplicates")),
        number("Longest gap (s)", of_all(max, "largest_gap"), 3),
        number("Saturated", of_all(sum, "saturated")),
        text("Sensor", lambda plugin: _sensor(mine[plugin])),
    )
    caption = "Completeness of the raw samples, all runs together."
    return build_table("quality", caption, mine, fields).without_blank("Twice", "Saturated")


def _sensor(qualities: Sequence[RunQuality]) -> str:
    kinds = {each.is_simulated for each in qualities}
    if kinds == {True}:
        return "simulated"
    return "some simulated" if True in kinds else "real" if kinds == {False} else "not recorded"


def _timeline(material: Material, spans: tuple[AttemptSpan, ...]) -> FigureBlock:
    labels = {span.run_id: span.label for span in spans}
    is_shown, share = even_share(labels.values(), _MOST_ROWS)
    drawn = set(compress(labels, is_shown))
    shown = [span for span in spans if span.run_id in drawn]
    some = f" Of {len(labels):,} runs, one in {share} of each treatment is shown." if share > 1 else ""
    return FigureBlock(
        "timeline",
        "When each run was executed. Dark: measuring; light: getting ready and tidying up; hatched: an attempt that "
        f"failed or was broken off.{some}",
        f"{counted(len(shown), 'attempt')} beneath each other over the time since the experiment began.",
        lambda: draw_timeline(shown, order=material.order),
        is_wide=True,
    )


def attempt_spans(material: Material) -> tuple[AttemptSpan, ...]:
    """Return all attempts with known times, in their order."""
    attempts = in_order_of_execution(material, material.results.attempts)
    if attempts.empty:
        return ()
    set_by, set_in = (_clock_set(material, name) for name in ("clock_set_by", "clock_set_in"))
    first = attempts.iloc[0]
    # As numbers: moments, of which there may be hundreds of thousands, take ten times as long.
    since = attempts.assign(began=_seconds_since(first["started_at"], attempts["started_at"]))
    began = -set_by(first)
    earlier = AttemptSpan("", "", 0.0, 0.0, None, is_done=True)
    events = material.results.events()
    told = events[events["event"].isin(_EDGES)]
    told = told.assign(at=_seconds_since(first["started_at"], told["at"]))[["run_id", "event", "at", "clock_s"]]
    stamps = {(run, event): (at, clock) for run, event, at, clock in told.itertuples(index=False)}
    last = set(attempts.drop_duplicates("run_id", keep="last").index)
    spans = []
    for row in since[["run_id", "attempt", "status", "began", "seconds"]].itertuples():
        label = material.labels.get(row.run_id, "")
        if not label:  # its run is no longer in the table
            continue
        by = set_by(row)
        start = row.began - began - by
        if start < earlier.start:  # the clock was set back: draw the attempt after the previous one
            began -= earlier.end - start
            start = earlier.end
        end = start + (0.0 if pd.isna(row.seconds) else float(row.seconds))
        edges = [stamps.get((row.run_id, name)) for name in _EDGES]
        known = [(edge[0] - began - by, edge[1]) for edge in edges if edge and row.Index in last]
        measured = _measured(known, (start, end), set_in(row))
        earlier = AttemptSpan(row.run_id, label, start, end, measured, is_done=row.status == "done")
        spans.append(earlier)
    return tuple(spans)


def _seconds_since(origin: pd.Timestamp, moments: pd.Series[pd.Timestamp]) -> pd.Series[float]:
    return (moments - origin).dt.total_seconds()


def _clock_set(material: Material, name: str) -> Callable[[Any], float]:
    """Return a function of an attempt's row: by how many seconds the clock was set, of the attribute of this name."""
    told: Mapping[str, Mapping[int, float]] = material.results.attempts.attrs.get(name, {})
    return lambda row: told.get(row.run_id, {}).get(row.attempt, 0.0)


def _measured(
    edges: Sequence[tuple[float, float]], attempt: tuple[float, float], set_by: float
) -> tuple[float, float] | None:
    """Return when a measurement began and ended; None where that is not known.

    Args:
        edges: both, by the time stamps in s, with the run's clock at each.
        attempt: when the attempt began and ended, s.
        set_by: by how much the clock of time stamps was set meanwhile, s: before, in or after the measurement.
    """
    if len(edges) != 2:  # noqa: PLR2004 - beginning and end
        return None
    (first, clock), (last, later) = edges
    possible = dict.fromkeys([(first, last), (first, last - set_by), (first - set_by, last - set_by)])
    fitting = [each for each in possible if attempt[0] - _ROUNDED <= each[0] <= each[1] <= attempt[1] + _ROUNDED]
    return min(fitting, key=lambda each: abs(each[1] - each[0] - (later - clock)), default=None)


#: Rows of the table; nobody would read more. Pairs whose runs all failed come first.
_MOST = 20


class FailedPair(NamedTuple):
    """A pair of treatments, its number of runs and how many of them failed."""

    pair: str
    runs: int
    failed: int


def failed_pairs(runs: pd.DataFrame, factors: tuple[str, ...]) -> list[FailedPair]:
    """Return the pairs of treatments with failed runs, those with the largest share of failures first."""
    texts = runs[list(factors)].astype("str")
    has_failed = runs[STATUS].astype("str") == RunStatus.FAILED.value
    found = []
    for one, other in combinations(factors, 2):
        for (a, b), failures in has_failed.groupby([texts[one], texts[other]], sort=False):
            if failures.any():
                found.append(FailedPair(f"{one} = {a}, {other} = {b}", len(failures), int(failures.sum())))
    return sorted(found, key=lambda each: (-each.failed / each.runs, -each.failed, each.pair))


def failed_pair_parts(material: Material) -> Iterator[Block]:
    """Yield the part on failures by pairs, if the design is a screening and runs failed."""
    if material.statistics.design.kind != "covering_array" or not material.counts[RunStatus.FAILED]:
        return
    ended = material.runs[material.runs[STATUS].astype("str").isin([RunStatus.DONE.value, RunStatus.FAILED.value])]
    found = failed_pairs(ended, material.statistics.design.factors)
    fields = (text("Treatments", "pair"), number("Runs", "runs"), number("Failed", "failed"))
    shown = f", of {len(found):,} the {_MOST} that failed most" if len(found) > _MOST else ""
    caption = f"The pairs of treatments that runs failed with{shown}."
    words = (
        "Each pair of treatments was executed at least once. A pair all of whose runs failed may be the cause; others "
        "go along with it. Repeat the first ones by themselves."
    )
    table = build_table("failed pairs", caption, found[:_MOST], fields)
    yield Part("outcome-pairs", "Failures by pairs of treatments", (Paragraph(words, Tone.NOTE), table))
