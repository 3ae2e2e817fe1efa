"""Robots take turns: which of those that are free takes a run, and which takes none any more."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import TYPE_CHECKING

from robot_runner.core.errors import Finding
from robot_runner.core.events.measure import ROBOT
from robot_runner.core.execution.mission_knowledge import combination_key
from robot_runner.core.execution.task import AttemptStatus
from robot_runner.core.storage.cells import RunStatus

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from typing import Any

    from robot_runner.core.execution.places import Place
    from robot_runner.core.execution.task import PendingRun, RunOutcome, RunTask
    from robot_runner.core.storage.run_table_rows import RunTableRows

__all__ = ["Turns", "turns_of"]

#: A robot on which as many runs in a row have failed takes no more, while another one is left.
_MOST_FAILURES = 3


class Turns:
    """Has each combination executed equally often on each robot, where that is possible.

    Args:
        planned: the combination and the repetition of each run of the experiment.
        done: the combination and the repetition of each run that is done, and the robot that executed it.
    """

    def __init__(
        self,
        planned: Iterable[tuple[Mapping[str, Any], int]],
        done: Iterable[tuple[Mapping[str, Any], int, str]] = (),
    ) -> None:
        self._planned = Counter(_group(*each) for each in planned)
        self._taken: Counter[tuple[object, str]] = Counter()
        self._all: Counter[str] = Counter()
        self._failed: defaultdict[str, list[PendingRun]] = defaultdict(list)
        for combination, repetition, robot in done:
            self._count(_group(combination, repetition), robot, 1)

    def choose(self, task: RunTask, free: Sequence[Place], count: int) -> Place | None:
        """Return the robot that takes a run; None where it is to wait for one that is busy.

        Args:
            task: the run.
            free: the robots that could take it now.
            count: how many robots take runs.
        """
        group = _group(task.combination, task.repetition)
        share = -(-self._planned[group] // max(1, count))
        fair = [place for place in free if self._taken[group, place.name] < share]
        return min(fair, key=lambda place: (self._taken[group, place.name], self._all[place.name]), default=None)

    def begin(self, task: RunTask, place: Place) -> None:
        """Take down that a robot takes a run."""
        self._count(_group(task.combination, task.repetition), place.name, 1)

    def end(
        self, run: PendingRun, task: RunTask, place: Place, outcome: RunOutcome | None, count: int
    ) -> tuple[list[PendingRun], Finding | None]:
        """Take down how a run went.

        Args:
            run: the run.
            task: the same, with its treatments.
            place: the robot.
            outcome: of its last attempt; None where there was none.
            count: how many robots take runs.

        Returns:
            the runs that others are to execute again, as this robot is to be set aside, and why; none where it is not.
        """
        if outcome is not None and outcome.status is AttemptStatus.DONE:
            self._failed[place.name].clear()
            return [], None
        self._count(_group(task.combination, task.repetition), place.name, -1)
        if outcome is None or outcome.status is AttemptStatus.INTERRUPTED:
            return [], None
        failed = self._failed[place.name]
        failed.append(run)
        if len(failed) < _MOST_FAILURES or count < 2:  # noqa: PLR2004 - the last robot is never set aside
            return [], None
        problem = f"{len(failed)} runs in a row failed on it, so that it takes no more; others execute these again"
        fix = f"Look at the robot, the last failure was: {outcome.failure}. It takes part again in the next session."
        return failed, Finding.warning(f"robot {place.name}", problem, fix)

    def _count(self, group: object, robot: str, more: int) -> None:
        self._taken[group, robot] += more
        self._all[robot] += more


def turns_of(rows: RunTableRows) -> Turns:
    """Return which robots have executed what, as the run table has it."""
    places = [place for place in range(len(rows)) if rows.excluded(place) is None]
    runs = {place: (rows.combination(place), rows.repetition(place)) for place in places}
    done = [(*runs[place], str(rows.row(place)[ROBOT])) for place in places if rows.status(place) is RunStatus.DONE]
    return Turns(runs.values(), done)


def _group(combination: Mapping[str, Any], repetition: int) -> object:
    """Return what is to be executed equally often on each robot: a combination, and what warms up."""
    return "warm-up" if repetition == 0 else combination_key(combination)
