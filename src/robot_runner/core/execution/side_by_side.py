"""Which run begins next, at which place, and the poll loop for all runs in flight."""

from __future__ import annotations

from collections import Counter, defaultdict, deque
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import chain
from typing import Any

from robot_runner.core.design.design import HeldOrder
from robot_runner.core.errors import ExecutionError, Finding
from robot_runner.core.events.measure import ROBOT
from robot_runner.core.execution.attempts import Attempts
from robot_runner.core.execution.known_durations import combination_key
from robot_runner.core.execution.left_processes import forget_runs_elsewhere, runs_elsewhere
from robot_runner.core.execution.orchestrator_events import OngoingExperiment
from robot_runner.core.execution.places import Awaited, Place, Places
from robot_runner.core.execution.poll_loop import Pause, Steps
from robot_runner.core.execution.task import AttemptStatus, PendingRun, RunOutcome, RunTask
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.run_table_rows import RunTableRows

#: How many runs that cannot begin yet are passed over at most to find one that can.
_AHEAD = 64
#: A robot on which so many runs in a row have failed is set aside, unless it is the last one.
_MOST_FAILURES = 3


@dataclass(slots=True)
class _Busy:
    """A place whose run is in flight.

    Attributes:
        holds: the claims of the run.
        task: the run with its treatments.
        steps: of the run, see `poll_loop.py`.
        awaited: what it waits for now.
    """

    place: Place
    run: PendingRun
    holds: frozenset[str]
    task: RunTask
    steps: Steps[RunOutcome | None]
    awaited: Awaited


class SideBySide:
    """Keeps as many runs in flight as there are free places whose claims do not clash.

    `claims` returns what a run claims with a robot that is reached like this.
    """

    def __init__(
        self, ongoing: OngoingExperiment, places: Places, claims: Callable[[RunTask, str | None], frozenset[str]]
    ) -> None:
        self._ongoing = ongoing
        self._progress = ongoing.progress
        self._places = places
        self._claims = claims
        self._attempts = Attempts(ongoing)
        self._held = HeldOrder.of_facts(ongoing.experiment.model.design_facts)
        self._turns = _Turns() if ongoing.experiment.parameters.robots else None
        self._busy: list[_Busy] = []
        self._finished: dict[str, PendingRun] = {}
        self._passed_over: deque[PendingRun] = deque()
        self._begun = 0
        self._may_begin = True
        self._left: Iterator[PendingRun] = iter(())
        self._there: list[Place] = []

    def execute(self, *, is_cleared: bool) -> bool:
        """Execute the runs that are left; return whether all of them were, and the experiment may go on.

        With `is_cleared`, a callback has asked the user already whether the first run may start.
        """
        if not self._begun:
            self._await_elsewhere()
            self._ongoing.poll_loop.follow(self._attempts.ask_about_earlier())
        self._left = self._progress.pending(self._begun)
        self._may_begin = True
        if self._turns is not None:
            self._turns.plan(self._progress.rows, {run.place for run in self._progress.pending(self._begun)})
        try:
            while True:
                while self._may_begin and not self._ongoing.is_ending and (chosen := self._choose()) is not None:
                    self._begin(*chosen, is_cleared=is_cleared)
                self._may_begin = False
                if self._busy:
                    self._await()
                elif self._ongoing.is_ending or not self._passed_over:
                    return not self._ongoing.is_ending
                else:
                    self._await_place()
        finally:
            self._let_go()

    def _await_elsewhere(self) -> None:
        """Wait until runs of a killed execution on other machines have ended: else two runs would command one robot."""
        ongoing, folder = self._ongoing, self._ongoing.experiment.folder
        if ongoing.experiment.parameters.cluster is not None:  # its places wait themselves
            return
        found = runs_elsewhere(folder)
        if not found or next(iter(self._progress.pending(0)), None) is None:
            return
        for each in found:
            ongoing.find(each.finding)
        pause = Pause(max(each.seconds for each in found))
        while not ongoing.poll_loop.turn([pause]):
            pass
        if not ongoing.is_interrupted:
            forget_runs_elsewhere(folder)

    def _choose(self) -> tuple[PendingRun, RunTask, Place, frozenset[str]] | None:
        """Return the first run that can begin now, with its place and its claims; None if there is none."""
        busy = {each.place.name for each in self._busy}
        free = [each for each in self._places.all if not each.is_unavailable and each.name not in busy]
        for place_in_queue in range(_AHEAD if free else 1):
            if place_in_queue == len(self._passed_over):
                following = next(self._left, None)
                if following is None:
                    return None
                self._begun += 1
                self._passed_over.append(following)
            if not free:  # there is a run to do, but no place yet
                return None
            run = self._passed_over[place_in_queue]
            task = self._progress.task_of(run)
            if any(each.task.is_warm_up is not task.is_warm_up for each in self._busy):
                return None  # warm-up runs and measured runs are never in flight together
            if self._has_to_wait(task, place_in_queue):
                continue
            suitable = dict(self._suitable(free, task))
            place = self._place_for(task, list(suitable))
            if place is not None:
                del self._passed_over[place_in_queue]
                return run, task, place, suitable[place]
            if task.is_warm_up:
                return None
        return None

    def _has_to_wait(self, task: RunTask, place_in_queue: int) -> bool:
        """Return whether by the design this run waits for one that is in flight, or for an earlier one that waits."""
        if self._held.is_open:
            return False
        waiting = (self._progress.task_of(self._passed_over[place]) for place in range(place_in_queue))
        before = chain((each.task for each in self._busy), waiting)
        return any(self._held.waits_for(task.combination, each.combination) for each in before)

    def _suitable(self, free: Sequence[Place], task: RunTask) -> Iterator[tuple[Place, frozenset[str]]]:
        """Yield the free places where a run can begin now, and the claims that it would hold there."""
        claims: dict[str | None, frozenset[str]] = {}
        for place in free:
            if (robot := place.experiment.parameters.robot) not in claims:
                claims[robot] = self._claims(task, robot)
            holds = place.claimed(claims[robot], task.combination)
            if holds is not None and all(holds.isdisjoint(each.holds) for each in self._busy):
                yield place, holds

    def _place_for(self, task: RunTask, suitable: Sequence[Place]) -> Place | None:
        if self._turns is None:
            return suitable[0] if suitable else None
        return self._turns.choose(task, suitable, self._count)

    @property
    def _count(self) -> int:
        """How many places take runs."""
        return sum(not place.is_unavailable for place in self._places.all)

    def _begin(self, run: PendingRun, task: RunTask, place: Place, holds: frozenset[str], *, is_cleared: bool) -> None:
        finished = self._finished.get(place.name)
        steps = self._attempts.execute(run, place, finished, is_cleared=is_cleared and finished is None)
        if self._turns is not None:
            self._turns.begin(task, place)
        try:
            awaited = next(steps)
        except StopIteration as end:
            self._end(run, place, end.value)
            return
        self._busy.append(_Busy(place, run, holds, task, steps, awaited))

    def _end(self, run: PendingRun, place: Place, outcome: RunOutcome | None) -> None:
        """Note that a run has ended at a place, and set a robot aside after `_MOST_FAILURES` in a row."""
        self._may_begin = True
        self._finished[place.name] = run
        if self._turns is None:
            return
        again, finding = self._turns.end(run, self._progress.task_of(run), place, outcome, self._count)
        if finding is not None:
            place.is_unavailable = True
            self._passed_over.extendleft(reversed(again))
            self._progress.expect_places(self._count, again)
            self._progress.note("set_aside", flush=True, place=place.name, problem=finding.problem)
            self._ongoing.find(finding)

    def _await(self) -> None:
        """Wait until runs in flight can go on, and resume their steps."""
        over = self._ongoing.poll_loop.turn([each.awaited for each in self._busy], self._places)
        self._take_note_of_places()
        for each in [each for each in self._busy if each.awaited in over]:
            try:
                each.awaited = next(each.steps)
            except StopIteration as end:
                self._busy.remove(each)
                self._end(each.run, each.place, end.value)
                if self._attempts.is_to_do_elsewhere(each.run):
                    self._passed_over.appendleft(each.run)

    def _await_place(self) -> None:
        """Wait for a place that can execute one of the runs left, while none is in flight.

        Raises:
            ExecutionError: none can come.
        """
        if not (self._places.descriptors or self._places.due is not None):
            problem = "no place is left where a run can be executed"
            fix = "See to the robots or workers that were set aside, and start the experiment again: it resumes."
            raise ExecutionError(problem, where=self._passed_over[0].run_id, fix=fix)
        self._ongoing.poll_loop.turn([], self._places)
        self._take_note_of_places(is_idle=True)

    def _take_note_of_places(self, *, is_idle: bool = False) -> None:
        if not (self._places.descriptors or self._places.due is not None):
            return
        for problem in self._places.advance(is_idle=is_idle):
            self._progress.note("place", problem=problem)
            self._ongoing.find(Finding.warning("places", problem))
        there = [each for each in self._places.all if not each.is_unavailable]
        if there != self._there:
            self._may_begin, self._there = True, there
            self._progress.expect_places(max(1, len(there)))

    def _let_go(self) -> None:
        """End the runs that are in flight where the experiment cannot go on: ask all to stop, then close each."""
        for each in self._busy:
            each.awaited.stop("the experiment could not go on")
        with ExitStack() as closing:  # all of them, whatever one of them raises
            for each in self._busy:
                closing.callback(each.steps.close)
        self._busy.clear()


class _Turns:
    """Chooses robots so that each combination is executed equally often on each of them, where that is possible."""

    def __init__(self) -> None:
        self._planned: Counter[object] = Counter()
        self._taken: Counter[tuple[object, str]] = Counter()
        self._all: Counter[str] = Counter()
        self._failed: defaultdict[str, list[PendingRun]] = defaultdict(list)

    def plan(self, rows: RunTableRows, to_do: Container[int]) -> None:
        """Count the planned runs, and those that each robot has executed, without runs that are executed again.

        Failures in a row are not reset: an adaptive design adds runs one by one, each with a plan.
        """
        places = [place for place in range(len(rows)) if rows.excluded(place) is None or place in to_do]
        groups = {place: _group(rows.combination(place), rows.repetition(place)) for place in places}
        self._planned = Counter(groups.values())
        self._taken.clear()
        self._all.clear()
        for place in places:
            if place not in to_do and rows.status(place) is not RunStatus.TODO:
                self._count(groups[place], str(rows.row(place)[ROBOT]), 1)

    def choose(self, task: RunTask, free: Sequence[Place], count: int) -> Place | None:
        """Return the robot that takes a run; None if the run waits for a busy one."""
        group = _group(task.combination, task.repetition)
        share = -(-self._planned[group] // max(1, count))
        fair = [place for place in free if self._taken[group, place.name] < share]
        return min(fair, key=lambda place: (self._taken[group, place.name], self._all[place.name]), default=None)

    def begin(self, task: RunTask, place: Place) -> None:
        self._count(_group(task.combination, task.repetition), place.name, 1)

    def end(
        self, run: PendingRun, task: RunTask, place: Place, outcome: RunOutcome | None, count: int
    ) -> tuple[list[PendingRun], Finding | None]:
        """Note how a run went; if its robot is to be set aside, return the runs for others, and the finding."""
        if outcome is not None and outcome.status is AttemptStatus.DONE:
            self._failed[place.name].clear()
            return [], None
        if outcome is None or outcome.status is AttemptStatus.INTERRUPTED or outcome.is_lost:
            self._count(_group(task.combination, task.repetition), place.name, -1)  # it is to do again
        if outcome is None or outcome.status is AttemptStatus.INTERRUPTED:
            return [], None
        # A run that failed is of the robot's share: one that fails a treatment soon would take most runs of it.
        failed = self._failed[place.name]
        failed.append(run)
        if len(failed) < _MOST_FAILURES or count < 2:  # noqa: PLR2004 - the last robot is never set aside
            return [], None
        problem = f"{len(failed)} runs in a row failed on it, so that it takes no more; others execute these again"
        last = str(outcome.failure).removesuffix(".")
        fix = f"Look at the robot, the last failure was: {last}. It takes part again in the next session."
        return failed, Finding.warning(f"robot {place.name}", problem, fix)

    def _count(self, group: object, robot: str, more: int) -> None:
        self._taken[group, robot] += more
        self._all[robot] += more


def _group(combination: Mapping[str, Any], repetition: int) -> object:
    """Return the key of the runs that each robot executes equally often: a combination, or all warm-up runs."""
    return "warm-up" if repetition == 0 else combination_key(combination)
