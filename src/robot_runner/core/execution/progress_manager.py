"""The progress manager: the one writer of the journal and the run table (paper, II.C)."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import replace
from functools import lru_cache
from typing import Any, Self

from robot_runner.core.config.experiment import Experiment
from robot_runner.core.config.treatment_makers import PREPARED, known_treatments
from robot_runner.core.design.batches import described_design
from robot_runner.core.design.factor import texts_of
from robot_runner.core.errors import Finding, StorageError
from robot_runner.core.execution.before_first_run import begun_manifest, made_folder, refuse_unfit_treatments
from robot_runner.core.execution.deciding import Deciding, Growth
from robot_runner.core.execution.durations import Durations, TimeLeft, durations_of
from robot_runner.core.execution.left_systems import see_to_what_is_left, told_if_refused
from robot_runner.core.execution.manifest_content import keep_config, replaced_packages
from robot_runner.core.execution.notices import NextDecided
from robot_runner.core.execution.probe import Probe
from robot_runner.core.execution.recovered_table import RecoveredTable, TableOnDisk
from robot_runner.core.execution.resumption import Resumption, selected_places, with_session_warm_ups
from robot_runner.core.execution.run_facts import (
    CALLED,
    ReportedFacts,
    UnreadFactors,
    large_log,
    left_logs,
    missing_measures,
)
from robot_runner.core.execution.systems_state import SystemsFile
from robot_runner.core.execution.table_recovery import recover_table
from robot_runner.core.execution.task import AttemptStatus, PendingRun, RunOutcome, RunTask, seed_of_run
from robot_runner.core.storage.cells import RunStatus
from robot_runner.core.storage.journal import Journal, utc_now
from robot_runner.core.storage.layout import drop_empty_log, keep_log, put_earlier_attempt_away, remove_half_written
from robot_runner.core.storage.lock import ExperimentLock, forget_requests
from robot_runner.core.storage.manifest import write_manifest
from robot_runner.core.storage.run_table_rows import RunTableRows

#: The kinds of a run's records that are kept in the journal; measures are kept with the end of the attempt.
_OF_RUN = ("event", "window", "phase", "shared", "finding", "refused", "failure", "clock", "machine", "bound", CALLED)
_OF_ATTENDANCE = ("waited", "guard", "asked", "answered", "subject", "mission_stopped", "outlives")
_KEPT = frozenset((*_OF_RUN, *_OF_ATTENDANCE))


class ProgressManager:
    """Holds an experiment's folder while it is executed. A context manager: on leaving, everything is on the disk.

    `probe` tries the profilers with the first run, once the folder is locked and before anything is written. `prepare`
    makes treatments that have to be made; it gets the facts that it returned in the first execution.

    Raises:
        RobotRunnerError: on entering: another process executes the experiment, the folder cannot be written, the run
            table on disk cannot be read or differs from the plan, or the probe refuses a profiler.
    """

    def __init__(
        self,
        experiment: Experiment,
        resumption: Resumption,
        probe: Callable[[RunTask], Probe] | None = None,
        prepare: Callable[[Mapping[str, Any]], dict[str, Any]] = lambda _: {},
    ) -> None:
        self._experiment = experiment
        self._folder = experiment.folder
        self._resumption = resumption
        self._probe = probe
        self._prepare = prepare
        self._failed: dict[str, str] = {}
        self._findings: list[Finding] = []
        self._unread = UnreadFactors(experiment)
        self._resources = ExitStack()
        self._last_outcomes: dict[str, RunOutcome] = {}
        self._systems_file = lru_cache(lambda slot: SystemsFile(experiment.folder.at_slot(slot)))

    def __enter__(self) -> Self:
        with told_if_refused() as seen_to, ExitStack() as opened:
            self._left_behind = made_folder(self._folder)
            self._lock = opened.enter_context(ExperimentLock(self._folder.lock))
            opened.callback(forget_requests, self._folder.pause, self._folder.stop)
            forget_requests(self._folder.pause, self._folder.stop)  # left by a session that was killed
            remove_half_written(self._folder)
            seen_to.extend(see_to_what_is_left(self._experiment))
            accept = self._resumption.accept_changes
            self._manifest, odd = begun_manifest(self._experiment, accept_changes=accept)
            self._findings += [*seen_to, *odd]
            if self._resumption.selection:
                self._manifest["executions"][-1]["selection"] = self._resumption.selection
            started = time.monotonic()
            recovered = recover_table(self._experiment, self._manifest, self._resumption)
            reading = time.monotonic() - started  # writing the table takes less
            self._selected = selected_places(recovered.rows, self._resumption, self._experiment.model.warm_up)
            refuse_unfit_treatments(self._experiment, self._manifest, recovered, self._selected, accept_changes=accept)
            self._take(recovered)
            self._deciding = Deciding(self._experiment, self._manifest)
            prepared = self._prepare(known_treatments(self._folder))
            self._manifest |= prepared
            self._durations = self._expected_durations()
            probed = self._probed()
            self._findings += left_logs(self._folder, recovered.unfinished)
            self._left_behind.update(recovered.unfinished, recovered.put_back_attempts())
            self._journal = opened.enter_context(Journal(self._folder.journal, self._lock.successor))
            recovered.keep_deviations(self._journal, self._manifest)
            if prepared:
                self._journal.append(PREPARED, flush=True, treatments=prepared)
            keep_config(self._experiment, self._manifest)
            write_manifest(self._folder.manifest, self._manifest)
            self._reported = ReportedFacts(self._folder, self._manifest)
            self._file = TableOnDisk(self._folder.run_table, self._table, self._journal, reading)
            if not recovered.is_on_disk:
                recovered.write_schema(self._folder.schema)
                self._file.write()
            self._resources = opened.pop_all()
        self.note(
            "experiment_started",
            flush=True,
            pid=os.getpid(),
            name=self._manifest["experiment_name"],
            seed=self.seed,
            runs=self.run_count,
            design=self._manifest["design"]["source"],
            factors=self._manifest["design"]["factors"],
            repetitions=self._manifest["design"]["repetitions"],
            steps_after=[each.name for each in self._experiment.parameters.operator_steps if each.is_after],
            **({"selection": chosen} if (chosen := self._resumption.selection) else {}),
            repository=self._manifest["executions"][-1].get("repository"),
        )
        if probed is not None and probed.profilers:
            self.note("probe", **probed.fields())
            self._findings += probed.findings
        return self

    def __exit__(self, *raised: object) -> None:
        # The error that ended the experiment is reported, not that its folder cannot be written any more.
        with nullcontext() if raised[0] is None else suppress(StorageError), self._resources:
            for slot in self._folder.used_slots():
                drop_empty_log(self._folder.at_slot(slot))
            self._file.bring_up_to_date()

    @property
    def seed(self) -> int:
        """The experiment's seed, as recorded when it was first executed."""
        return int(self._manifest["seed"])

    @property
    def run_count(self) -> int:
        """How many runs the table has."""
        return len(self._rows)

    @property
    def done_count(self) -> int:
        """How many runs are done."""
        return self._rows.count(RunStatus.DONE)

    @property
    def done_before(self) -> int:
        """How many runs are done, without those that this session executes again."""
        return self.done_count - sum(self._rows.status(place) is RunStatus.DONE for place in self._selected)

    @property
    def todo_count(self) -> int:
        """How many runs are left to be executed: neither done nor failed, nor excluded."""
        rows, left = self._rows, self.run_count - self.done_count - len(self._failed)
        return left - sum(rows.status(rows.index_of(run)) is not RunStatus.DONE for run in self.excluded)

    @property
    def excluded(self) -> tuple[str, ...]:
        """The ids of the runs that are left out."""
        rows = self._rows
        places = range(len(rows)) if rows.layout.has_exclusions else ()
        return tuple(rows.run_id(place) for place in places if rows.excluded(place) is not None)

    @property
    def failed(self) -> tuple[str, ...]:
        """The ids of the runs that failed."""
        return tuple(self._failed)

    @property
    def failures(self) -> tuple[str, ...]:
        """Why each failed run failed, one line each."""
        return tuple(f"{run_id}: {reason}" for run_id, reason in self._failed.items())

    def last_outcome(self, place: str) -> RunOutcome:
        """Return the outcome that was recorded last at a place."""
        return self._last_outcomes[place]

    @property
    def time_left(self) -> TimeLeft | None:
        """How long the run that has begun and those to come take; None where that is not known."""
        return self._durations.left()

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Findings on the table on disk and on the runs."""
        return (*self._findings, *self._unread.findings)

    @property
    def combinations_left(self) -> Iterator[Mapping[str, Any]]:
        """The treatments of each run that is to be executed in this session."""
        return map(self._rows.combination, self._selected)

    @property
    def rows(self) -> RunTableRows:
        """The run table as it stands."""
        return self._rows

    def expect_places(self, count: int, again: Sequence[PendingRun] = ()) -> None:
        """Set for the estimate how many runs go on at a time; after a place was lost, which runs are executed again."""
        self._durations.places = min(count, self._durations.places) if again else count
        self._durations.expect_again(self._rows.combination(run.place) for run in again)

    def pending(self, first: int = 0) -> Iterator[PendingRun]:
        """Yield the runs to execute, from number `first` on: those to do, failed ones, those requested again."""
        return (PendingRun(self._rows.run_id(place), place) for place in self._selected[first:])

    def decide(self) -> NextDecided | None:
        """Add the runs that follow from the results, where some do; they are in the journal when this returns.

        Return what was decided and why; None where nothing is to be decided, or runs are left to do.
        """
        is_of_part = bool(self._resumption.only or self._resumption.skip)
        return None if self.todo_count else self._deciding.decide(self, self._table, is_of_part=is_of_part)

    def grow(self, growth: Growth) -> None:
        """Add runs that were decided on, and record why."""
        self.note(growth.kind, flush=True, **growth.record)
        # Where the session had no other runs, it warms up before these.
        warm_up = None if self._selected else self._experiment.model.warm_up
        places = with_session_warm_ups(growth.rows, list(growth.places), warm_up)
        self._selected += places
        self._rows = self._table.rows = growth.rows
        self._table.write_schema(self._folder.schema)  # there may be new columns
        self._file.refresh()
        self._durations.plan(map(growth.rows.combination, places), follows=self._deciding.follows(self._rows))
        self._manifest["design"] |= described_design(growth.model)
        write_manifest(self._folder.manifest, self._manifest)

    def runs_left(self, run: PendingRun) -> int:
        """Return how many runs are to be executed in this session from this one on, itself included."""
        return len(self._selected) - self._selected.index(run.place)

    def task_of(self, run: PendingRun, place: str = "", slot: int = 1) -> RunTask:
        """Return the task of a run's latest attempt, as executed at this place."""
        return RunTask(
            run_id=run.run_id,
            run_number=run.number,
            run_count=self.run_count,
            attempt=self._attempts[run.run_id],
            combination=self._rows.combination(run.place).of_one_run(),
            repetition=self._rows.repetition(run.place),
            experiment_seed=self.seed,
            run_seed=seed_of_run(self.seed, run.run_id),
            place=place,
            slot=slot,
        )

    def look_after_lock(self) -> None:
        """Check that this process still holds the experiment, see `ExperimentLock.look_after`."""
        self._findings += self._lock.look_after(self._journal)

    def begin(self, run: PendingRun, place: str = "", slot: int = 1) -> RunTask:
        """Begin another attempt at a run at a place; the files of an earlier attempt are moved, not lost."""
        self.look_after_lock()
        if run.run_id in self._left_behind:
            put_earlier_attempt_away(self._folder, run.run_id, self._attempts[run.run_id])
        self._attempts[run.run_id] += 1
        if self._rows.status(run.place) is not RunStatus.TODO:
            self._rows.clear(run.run_id)
        if self._rows.excluded(run.place) is not None:  # the reason was about the earlier attempt
            self._rows.exclude(run.run_id, None)
            self.note("included", run=run.run_id, reason="the run is executed again")
        self._left_behind.add(run.run_id)
        self._rows.record(run.run_id, status=RunStatus.RUNNING)
        self._failed.pop(run.run_id, None)
        task = self.task_of(run, place, slot)
        self._durations.begin(task.combination, time.monotonic(), run.run_id, place)
        self.note(
            "attempt_started",
            run=run.run_id,
            attempt=task.attempt,
            combination=texts_of(task.combination),
            repetition=task.repetition,
            **task.whereabouts,
            **self._left(),
        )
        self._file.refresh()
        return task

    def record(self, task: RunTask, kind: str, fields: dict[str, Any]) -> None:
        """Keep a record of a run that is being executed."""
        if kind in _KEPT:
            self._journal.append(kind, run=task.run_id, attempt=task.attempt, **fields)
        self._reported.take(task.run_id, kind, fields)
        if kind == "event" and fields["event"] == "continue" and "continue_at" in self._rows.layout.stamps:
            self._rows.record(task.run_id, stamps={"continue_at": fields["at"]})
            self._file.refresh()

    def record_outcome(
        self, task: RunTask, outcome: RunOutcome, *, is_last: bool, to_ask: Sequence[str] = ()
    ) -> tuple[Finding, ...]:
        """Record how an attempt went and which steps follow; return findings that are about all runs to come."""
        self._lock.refuse_other_folder(self._journal)  # a run whose files are in two folders is not done
        if task.slot and keep_log(self._folder.at_slot(task.slot), task.run_id):
            self._findings += large_log(self._folder.log(task.run_id))
        self._durations.end(time.monotonic(), outcome.status.value, is_last=is_last, run=task.run_id)
        self._findings += [*outcome.findings, *missing_measures(self._experiment, task, outcome)]
        if outcome.status is AttemptStatus.FAILED:  # also before another attempt, which an interruption may prevent
            self._failed[task.run_id] = str(outcome.failure)
        self._keep_outcome(task, outcome, {"is_last": is_last} | ({"to_ask": [*to_ask]} if to_ask else {}))
        self._systems_file(task.slot).remove()  # the outcome tells what became of its systems
        return self._unread.take(task, outcome)

    def amend_outcome(self, task: RunTask, before: RunOutcome, later: RunOutcome) -> RunOutcome:
        """Record later measures, findings and the time stamp of `continue` of an attempt; return its whole outcome."""
        found = later.findings[len(before.findings) :]
        if (later.measures, later.stamps) == (before.measures, before.stamps) and not found:
            return before
        outcome = replace(before, stamps=later.stamps, measures=later.measures, findings=later.findings)
        missing = missing_measures(self._experiment, task, outcome)
        no_more = set(missing_measures(self._experiment, task, before)).difference(missing)
        self._findings = [each for each in self._findings if each not in no_more] + list(found)
        # A later record of an attempt's end replaces the earlier one. A stamp alone need not be flushed at once.
        is_lasting = later.measures != before.measures or bool(found)
        self._keep_outcome(task, outcome, {"is_last": True, "is_amended": True}, flush=is_lasting)
        return outcome

    def _keep_outcome(self, task: RunTask, outcome: RunOutcome, facts: dict[str, Any], *, flush: bool = True) -> None:
        self._last_outcomes[task.place] = outcome
        told = {**facts, **outcome.fields(), **self._left()}
        self._journal.append("attempt_finished", run=task.run_id, attempt=task.attempt, **told)
        if self._table.take_outcome(task.run_id, outcome):  # without the types there, "1" would be read as a number
            self._table.write_schema(self._folder.schema)
        if flush:  # where the disk refuses that, the journal has the record all the same, and the table is to have it
            self._journal.flush()
        self._file.refresh()

    def note(self, kind: str, *, flush: bool = False, **fields: Any) -> None:
        """Append a record to the journal."""
        self._journal.append(kind, flush=flush, **fields)

    def tend_table(self) -> float | None:
        """Write the run table if that is due, while a run or a wait lasts; see `TableOnDisk.tend`."""
        return self._file.tend()

    def find(self, *findings: Finding) -> None:
        """Keep findings for the end of the experiment."""
        self._findings += findings

    def look_at_packages(self) -> None:
        """Warn of packages that were replaced since this execution began; the manifest is to name them."""
        self._findings += replaced_packages(self._folder.manifest, self._manifest)

    def bring_table_up_to_date(self) -> None:
        """Write the run table as it stands: a callback of `after_experiment` may read it."""
        self._file.bring_up_to_date()

    def finish(self, *, interrupted: bool) -> None:
        """Bring table, schema and manifest up to date, and record that the experiment has ended."""
        self._lock.refuse_other_folder(self._journal)
        self.bring_table_up_to_date()
        self._table.write_schema(self._folder.schema)
        self._manifest["executions"][-1]["finished_at"] = utc_now()
        self._reported.describe_programs()
        write_manifest(self._folder.manifest, self._manifest)
        counts = {"done": self.done_count, "failed": len(self._failed), "runs": self.run_count}
        self.note("experiment_finished", flush=True, interrupted=interrupted, **counts)

    def _take(self, recovered: RecoveredTable) -> None:
        self._table = recovered
        self._rows = recovered.rows
        self._attempts = Counter(recovered.attempts)
        out = set(self.excluded)
        self._failed.update((run, reason) for run, reason in recovered.failed.items() if run not in out)
        self._findings += recovered.findings

    def _probed(self) -> Probe | None:
        # Where no run is left but more may be decided on, the first one of the table stands for them.
        of_table = PendingRun(self._rows.run_id(0), 0) if self._deciding.follows(self._rows) else None
        first = next(self.pending(), of_table)
        return self._probe(self.task_of(first)) if self._probe is not None and first is not None else None

    def _expected_durations(self) -> Durations:
        each, journal = self._experiment, self._folder.journal
        combinations = [run.combination for run in self._rows.planned]
        durations = durations_of(each.config, each.plugins, each.events, each.parameters, combinations, journal)
        durations.plan(map(combinations.__getitem__, self._selected), follows=self._deciding.follows(self._rows))
        return durations

    def _left(self) -> dict[str, Any]:
        return {} if (left := self.time_left) is None else {"left": left.facts()}
