"""Runs that were executed out of the place that their design gave them, so that its model does not hold for them.

A run of a crossover that failed and was executed again after later periods of its unit has the wrong period in its
row, and the wrong treatment before it. A run of a split plot that was executed after another whole plot had begun
belongs to none that the design knows: its floor was laid anew.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robot_runner.core.design.columns import RUN_ID
from robot_runner.core.design.design import HELD_ORDER, HeldOrder

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from robot_runner.analysis.results import Results


def displaced_runs(results: Results) -> dict[str, str]:
    """Return the runs that are done and were executed out of their place, with the reason in words.

    Designs that leave the order open have none, nor have results whose journal does not tell the order.
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
    """Return the runs of a crossover whose unit had only failed attempts at the treatment before, with that run.

    What such an attempt carries over is less than what the treatment would have left, or more.
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
    """Return the treatments of each run of the table by its id, as texts."""
    frame = results.all_runs
    columns = [name for name in names if name]
    texts = zip(*(frame[name].astype("str") for name in columns), strict=True)
    return {run_id: dict(zip(columns, row, strict=True)) for run_id, row in zip(frame[RUN_ID], texts, strict=True)}


def _out_of_period(
    attempts: Sequence[str], treatments: Mapping[str, Mapping[str, str]], held: HeldOrder, results: Results
) -> Iterator[tuple[str, str]]:
    """Yield the runs that came after a later period of their unit, or that skipped one."""
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
    """Yield the runs that came after another whole plot had begun since the first run of their own."""
    begun: list[str] = []  # the whole plots, one after another; one that was left and laid again is there twice
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
