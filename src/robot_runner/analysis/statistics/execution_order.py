"""The execution of the runs that are done: their order, runs out of order, and the robots that executed them.

If a run of a crossover failed and was executed again after later periods of its unit, the period in its row and the
previous treatment are wrong. If a run of a split plot was executed after another whole plot had begun, its whole plot
had to be set up a second time, which the design does not have. The model of the design is not valid for such runs.

Robots take turns so that each combination is executed equally often on each. This is no longer so if a robot was set
aside, or runs failed or were excluded: with unequal shares, a difference between robots may look like an effect.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from robot_runner.analysis.arrays import Floats
from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.design.design import HELD_ORDER, HeldOrder
from robot_runner.core.events.measure import ROBOTS_OWNER
from robot_runner.core.words import counted, enumerated, listed

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from robot_runner.analysis.results import Results
    from robot_runner.analysis.statistics.outcome import DesignSummary

#: The time stamp that determines the order of runs.
STAMP = "start_measurement_at"


@dataclass(frozen=True, slots=True)
class ExecutionOrder:
    """The order of execution of the runs that are done.

    Attributes:
        places: the position of each run, from 1.
        is_known: whether it is known from time stamps or the journal; else it is the order of the table.
        has_times: whether differences of time stamps are elapsed times; not so if the clock was set, or if machines
            that executed runs have different times.
    """

    places: NDArray[np.int64]
    is_known: bool
    has_times: bool


def execution_order(results: Results) -> ExecutionOrder:
    """Return the order by time stamps, or that of the journal if some are missing or of another clock."""
    done = results.confirming.done
    is_stamped = STAMP in done and bool(done[STAMP].notna().all())
    attempts, is_imported = results.attempts, results.manifest.get("origin") == "imported"
    # The journal of an import has the order of the table, and its times are not those of execution.
    is_set = bool(attempts.attrs.get("clock_was_set")) and not is_imported
    if is_stamped and not is_set:
        places = np.asarray(done[STAMP].rank(method="first"), dtype=np.int64)
        return ExecutionOrder(places, is_known=True, has_times=True)
    begun = () if is_imported else attempts.drop_duplicates(RUN_ID, keep="last")[RUN_ID]
    place_of = {run_id: place for place, run_id in enumerate(begun)}
    told = [place_of[run_id] for run_id in done[RUN_ID] if run_id in place_of] if place_of else []
    is_told = bool(told) and len(told) == len(done)
    places = np.argsort(np.argsort(told)) + 1 if is_told else np.arange(1, len(done) + 1, dtype=np.int64)
    return ExecutionOrder(places, is_known=is_told, has_times=not is_set)


def displaced_runs(results: Results) -> dict[str, str]:
    """Return the runs that are done but were executed out of order, with the reason in words.

    There are none if the design does not restrict the order, or if the journal has no attempts.
    """
    held = _held(results)
    if held.is_open or results.attempts.empty:
        return {}
    treatments = _treatments(results, [held.one_by_one, held.rest_between, held.one_after_another])
    attempts = [run_id for run_id in results.attempts[RUN_ID] if run_id in treatments]
    found: dict[str, str] = {}
    if held.one_by_one and held.rest_between:
        found |= dict(_out_of_period(attempts, treatments, held, results))
    if held.one_after_another:
        found |= dict(_out_of_plot(attempts, treatments, held.one_after_another))
    done = set(results.done[RUN_ID])
    return {run_id: why for run_id, why in found.items() if run_id in done}


def followed_failures(results: Results) -> dict[str, str]:
    """Return the runs of a crossover after failed attempts at their unit's previous treatment, with the failed run.

    The carry-over from such an attempt may be less, or more, than that from a completed run.
    """
    held = _held(results)
    if not (held.one_by_one and held.rest_between) or results.attempts.empty:
        return {}
    treatments = _treatments(results, [held.one_by_one, held.rest_between])
    found: dict[str, str] = {}
    last: dict[str, tuple[str, bool]] = {}
    for run_id, status in results.attempts[[RUN_ID, "status"]].itertuples(index=False):
        if run_id not in treatments:
            continue
        mine = treatments[run_id]
        before = last.get(mine[held.one_by_one])
        found.pop(run_id, None)
        if before is not None and not before[1]:
            if treatments[before[0]][held.rest_between] != mine[held.rest_between]:
                found[run_id] = before[0]
            elif before[0] in found:
                found[run_id] = found[before[0]]
        last[mine[held.one_by_one]] = (run_id, status == "done")
    done = set(results.done[RUN_ID]) - set(displaced_runs(results))
    return {run_id: before for run_id, before in found.items() if run_id in done}


def _held(results: Results) -> HeldOrder:
    facts: Any = (results.manifest.get("design") or {}).get("facts")
    held = facts.get(HELD_ORDER) if isinstance(facts, dict) else None
    known = set(results.runs.columns)
    if not isinstance(held, dict):
        return HeldOrder()

    def column(name: str) -> str:
        return found if (found := str(held.get(name, ""))) in known else ""

    return HeldOrder(column("one_by_one"), column("one_after_another"), column("rest_between"))


def _treatments(results: Results, names: Sequence[str]) -> dict[str, dict[str, str]]:
    """Return the treatments of each run of the table, as texts, by its id."""
    frame = results.all_runs
    columns = [name for name in names if name]
    texts = zip(*(frame[name].astype("str") for name in columns), strict=True)
    return {run_id: dict(zip(columns, row, strict=True)) for run_id, row in zip(frame[RUN_ID], texts, strict=True)}


def _out_of_period(
    attempts: Sequence[str], treatments: Mapping[str, Mapping[str, str]], held: HeldOrder, results: Results
) -> Iterator[tuple[str, str]]:
    """Yield the runs that were executed after a later period of their unit, or that skipped one."""
    order = list(dict.fromkeys(results.all_runs[held.rest_between].cat.categories.astype("str")))
    place = {period: number for number, period in enumerate(order)}
    planned: dict[str, set[str]] = {}
    for each in treatments.values():
        planned.setdefault(each[held.one_by_one], set()).add(each[held.rest_between])
    begun: dict[str, set[str]] = {}
    told: dict[str, str] = {}
    for run_id in attempts:
        unit, period = treatments[run_id][held.one_by_one], treatments[run_id][held.rest_between]
        mine = begun.setdefault(unit, set())
        later = [each for each in mine if place[each] > place[period]]
        skipped = [each for each in planned[unit] if place[each] < place[period] and each not in mine]
        told.pop(run_id, None)
        if later:
            after = max(later, key=place.__getitem__)
            told[run_id] = f"executed after {held.rest_between} {after} of {held.one_by_one} {unit} had begun"
        elif skipped:
            before = max(skipped, key=place.__getitem__)
            told[run_id] = f"executed before {held.rest_between} {before} of {held.one_by_one} {unit}"
        mine.add(period)
    yield from told.items()


def _out_of_plot(
    attempts: Sequence[str], treatments: Mapping[str, Mapping[str, str]], plot: str
) -> Iterator[tuple[str, str]]:
    """Yield the runs whose whole plot had been interrupted by another one."""
    begun: list[str] = []  # the whole plots in order; one that was left and begun again is listed twice
    told: dict[str, str] = {}
    for run_id in attempts:
        mine = treatments[run_id][plot]
        told.pop(run_id, None)
        if not begun or begun[-1] != mine:
            begun.append(mine)
        if mine in begun[:-1]:
            other = next(each for each in reversed(begun) if each != mine)
            told[run_id] = f"executed after {plot} {other} had begun"
    yield from told.items()


#: Smaller differences of shares, and of numbers of runs from those of equal shares, are due to rounding.
_LEAST_SHARE, _LEAST_RUNS = 0.2, 1.0
_MOST_TOLD = 4


def robot_warnings(results: Results, design: DesignSummary) -> Iterator[str]:
    """Yield a warning for each factor whose treatments are unevenly spread over robots, unless robots are blocks."""
    done = results.confirming.done
    robots = [name for name in results.measures if results.columns[name].owner == ROBOTS_OWNER and name != design.block]
    for column in robots:
        for name in design.factors:
            counts = pd.crosstab(done[name].astype("str"), done[column])
            if _are_uneven(counts.to_numpy(dtype=np.float64)):
                told = [f"{treatment} {_of_robots(row)}" for treatment, row in counts.iterrows()]
                yield (
                    f"Treatments of {name} are unevenly spread over robots: {listed(told, _MOST_TOLD)}. What robots "
                    f"differ in may pass for an effect of {name}."
                )


def _are_uneven(counts: Floats) -> bool:
    if counts.size == 0:
        return False
    shares = counts / counts.sum(axis=1, keepdims=True)
    even = counts.sum(axis=1, keepdims=True) * counts.sum(axis=0, keepdims=True) / counts.sum()
    return bool(np.ptp(shares, axis=0).max() > _LEAST_SHARE and np.abs(counts - even).max() > _LEAST_RUNS)


def _of_robots(row: pd.Series) -> str:
    return enumerated(f"{counted(int(runs), 'run')} on {robot}" for robot, runs in row.items() if runs)
