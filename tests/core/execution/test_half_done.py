"""What somebody finds who comes back to an experiment that is half done."""

from __future__ import annotations

import csv
import errno
import os
import shutil
import signal
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from tests.conftest import HEAD

from robot_runner.core.config.preparation import prepare, prepare_or_refuse
from robot_runner.core.errors import ExecutionError, StorageError
from robot_runner.core.execution.experiment_status import read_status
from robot_runner.core.execution.notices import AttemptFinished, ExperimentStarted, Notice, SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.resumption import Resumption
from robot_runner.core.storage.lock import leave_request

Execute = Callable[..., Any]
Write = Callable[..., Path]

MANY_FACTORS = """\
    def create_run_table(self):
        factors = [Factor(f"F{number}", ["off", "on"]) for number in range(200)]
        return RunTableModel(factors, data_columns=["Energy"], exclude_combinations=[{"F0": "on", "F1": "on"}])
"""
TWO_RUNS = """\
    def create_run_table(self):
        return RunTableModel([Factor("Task", ["Video", "Network"])], data_columns=["Energy"])
"""
READING = "def populate_run_data(self, context): return {'Energy': sum(map(len, context.combination.values()))}"


def resume(config: Path, **asked: Any) -> Any:
    return execute_experiment(prepare_or_refuse(config), SilentObserver(), resumption=Resumption(**asked))


def test_a_resume_needs_room_only_for_the_runs_that_are_left(
    write_config: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = write_config(READING)
    resume(config, only=("r_1", "r_2", "r_3"))
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=4096))
    assert prepare(config).experiment is not None
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=4095))
    (finding,) = prepare(config).findings
    assert finding.problem.startswith("1 run will keep about 0.00 MB")


@pytest.mark.long
def test_a_run_whose_end_the_disk_took_and_did_not_flush_is_not_executed_again(
    execute: Execute, monkeypatch: pytest.MonkeyPatch
) -> None:
    ends = iter(range(10))

    def flushed(descriptor: int) -> None:
        last = os.pread(descriptor, 1 << 20, 0).splitlines()[-1]
        if b'"kind":"attempt_finished"' in last and next(ends) == 1:
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    with monkeypatch.context() as patched:
        patched.setattr("robot_runner.core.storage.journal.fsync_file", flushed)
        with pytest.raises(StorageError, match="journal"):
            execute(READING)
    again = execute(READING)
    assert [row["status"] for row in again.table] == ["Done"] * 4
    assert [each["run"] for each in again.journal("attempt_started")] == ["r_1", "r_2", "r_3", "r_4"]


@pytest.mark.long
def test_a_design_of_many_factors_is_planned_from_the_table_that_lists_its_runs(write_config: Write) -> None:
    config = write_config(READING, table=MANY_FACTORS)
    (refused,) = prepare(config).findings
    assert "runs before exclusions; 10,000,000 is the most" in refused.problem
    table = config.parent / "results" / "trial" / "run_table.csv"
    table.parent.mkdir(parents=True)
    names = [f"F{number}" for number in range(200)]
    rows = [["on" if (run * 7 + place) % 3 else "off" for place in range(200)] for run in range(30)]
    with table.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([names, *rows])
    finished = resume(config, only=("r_1", "r_30"))
    assert (finished.done_count, finished.todo_count) == (2, 28)
    assert resume(config, only=("F0=off",)).done_count == 11
    with table.open(encoding="utf-8", newline="") as file:
        written = list(csv.DictReader(file))
    assert [[row[name] for name in names] for row in written] == rows
    assert written[0]["Energy"] == str(sum(map(len, rows[0])))


def test_a_treatment_none_is_known_again_where_a_spreadsheet_left_its_cell_empty(write_config: Write) -> None:
    body = "def populate_run_data(self, context): return {'Energy': str(context.combination['Load'])}"
    config = write_config(
        body,
        table="    def create_run_table(self):\n"
        "        return RunTableModel([Factor('Load', [None, 'stress'])], data_columns=['Energy'])",
    )
    finished = resume(config, only=("r_1",))
    table = finished.run_table
    text = table.read_text(encoding="utf-8")
    assert ",None,None\n" in text
    table.write_text(text.replace(",None,None\n", ",,None\n"), encoding="utf-8")
    finished = resume(config)
    assert finished.findings == ()
    assert finished.done_count == 2


class UntilDoneIsSeen(SilentObserver):
    """Interrupts the experiment once its run table on disk says, during a rest, that the first run is done."""

    refresh_interval = 0.05

    def __init__(self, table: Path) -> None:
        self.was_seen = self.is_resting = False
        self._table = table

    def notice(self, notice: Notice) -> None:
        self.is_resting |= isinstance(notice, AttemptFinished)

    def refresh(self) -> None:
        if self.is_resting and not self.was_seen and "r_1,Done" in self._table.read_text(encoding="utf-8"):
            self.was_seen = True
            signal.raise_signal(signal.SIGINT)


def test_the_table_on_disk_is_up_to_date_while_a_run_or_a_rest_lasts(write_config: Write) -> None:
    config = write_config(
        """
        time_between_runs_in_ms = 30_000

        def launch_mission(self, context):
            table, end = context.experiment_folder / "run_table.csv", time.monotonic() + 30
            while "r_1,Running" not in table.read_text() and time.monotonic() < end:
                time.sleep(0.02)

        def populate_run_data(self, context):
            return {"Energy": time.monotonic()}
        """,
        head="import time\n" + HEAD,
        table=TWO_RUNS,
    )
    experiment = prepare_or_refuse(config)
    observer = UntilDoneIsSeen(experiment.folder.run_table)
    started = time.monotonic()
    finished = execute_experiment(experiment, observer)
    assert (observer.was_seen, finished.done_count, finished.interrupted) == (True, 1, True)
    assert time.monotonic() - started < 30  # neither the run nor the rest had to come to its end


def test_nothing_but_results_stays_behind(execute: Execute) -> None:
    executed = execute(READING)
    assert sorted(path.name for path in executed.folder.iterdir() if not path.name.startswith(".")) == [
        "config",
        "journal.jsonl",
        "manifest.json",
        "run_table.csv",
        "run_table.schema.json",
        "runs",
    ]


def test_a_lock_that_is_removed_while_a_run_lasts_is_put_back_and_told(execute: Execute) -> None:
    executed = execute(
        "def populate_run_data(self, context):\n"
        "    lock = context.experiment_folder / '.lock'\n"
        "    if context.run_number == 1: lock.unlink()\n"
        "    return {'Energy': 1.0}",
    )
    assert executed.finished.done_count == 4
    (finding,) = [each for each in executed.finished.findings if ".lock was removed" in each.problem]
    assert "locked again" in finding.problem


def test_an_experiment_whose_folder_is_moved_tells_that_and_not_what_cannot_be_written_there(
    write_config: Write,
) -> None:
    config = write_config(
        "def launch_mission(self, context):\n"
        "    context.experiment_folder.rename(context.experiment_folder.with_name('moved'))"
    )
    with pytest.raises(ExecutionError, match="moved or renamed while it was executed"):
        resume(config)


def test_an_experiment_that_somebody_else_has_gone_on_with_executes_no_further_run(write_config: Write) -> None:
    config = write_config(
        "def populate_run_data(self, context):\n"
        "    folder = context.experiment_folder\n"
        "    if context.run_number == 1:\n"
        "        (folder / '.lock').unlink()\n"
        "        with (folder / 'journal.jsonl').open('a') as journal:\n"
        '            journal.write(\'{"kind":"resumed","at":"2026-01-01T00:00:00.000Z"}\\n\')\n'
        "    return {'Energy': 1.0}"
    )
    with pytest.raises(ExecutionError, match="another process has executed it since") as refused:
        resume(config)
    assert "start the experiment again: it resumes" in refused.value.fix
    assert resume(config).done_count == 4


def test_a_run_that_is_not_tried_again_as_the_user_interrupts_has_failed_and_is_told_so(write_config: Write) -> None:
    class Interrupting(SilentObserver):
        def notice(self, notice: Notice) -> None:
            if isinstance(notice, AttemptFinished):
                signal.raise_signal(signal.SIGINT)

    config = write_config("attempts = 2\ndef launch_mission(self, context): raise ValueError('the wheel fell off')")
    finished = execute_experiment(prepare_or_refuse(config), Interrupting())
    status = read_status(finished.folder)
    assert (finished.done_count, finished.failed_count, finished.todo_count) == (0, 1, 3)
    assert (status.done, status.failed, status.todo) == (0, 1, 3)
    assert finished.failures == status.failures == ("r_1: launch_mission of config: ValueError: the wheel fell off",)


def test_what_a_run_had_printed_that_the_journal_does_not_know_is_in_no_log_of_another(write_config: Write) -> None:
    config = write_config("def launch_mission(self, context): print('mission of', context.run_id)")
    folder = config.parent / "results" / "trial"
    resume(config, only=("r_1", "r_2"))
    journal = folder / "journal.jsonl"
    lines = journal.read_text().splitlines(keepends=True)
    end_of_second = max(place for place, line in enumerate(lines) if line.startswith('{"kind":"attempt_finished"'))
    journal.write_text("".join(lines[:end_of_second]))  # an older one was put back, and
    (folder / "run_table.csv").unlink()
    (folder / "current_log.txt").write_text("mission of r_3, which was killed")
    finished = resume(config)
    assert {name: (folder / "runs" / name / "log.txt").read_text() for name in ("r_1", "r_2", "r_3", "r_4")} == {
        name: f"mission of {name}\n" for name in ("r_1", "r_2", "r_3", "r_4")
    }
    assert (folder / "earlier_attempts" / "r_2" / "1" / "log.txt").read_text() == "mission of r_2\n"
    kept = folder / "earlier_attempts" / "unknown run" / "1" / "log.txt"
    assert kept.read_text() == "mission of r_3, which was killed"
    assert [each.problem for each in finished.findings if each.where == str(kept)] == [
        "a run printed this of which the journal does not tell that it was begun"
    ]


def test_what_a_killed_execution_has_written_by_half_is_gone_and_what_another_process_writes_is_not(
    write_config: Write,
) -> None:
    config = write_config()
    folder = config.parent / "results" / "trial"
    resume(config, only=("r_1",))
    of_killed = [folder / f".{name}.4711.tmp" for name in ("run_table.csv", "run_table.schema.json", "manifest.json")]
    of_another = folder / ".control.4712.tmp"
    for each in (*of_killed, of_another):
        each.write_text("half of")
    resume(config, only=("r_2",))
    assert [each.exists() for each in (*of_killed, of_another)] == [False, False, False, True]


def test_what_was_put_away_for_an_attempt_that_a_kill_kept_from_beginning_is_put_back(write_config: Write) -> None:
    config = write_config("def launch_mission(self, context): print('attempt', context.attempt, 'at', context.run_id)")
    folder = config.parent / "results" / "trial"
    resume(config)
    resume(config, redo=("r_2",))
    (folder / "earlier_attempts" / "r_1").mkdir()
    (folder / "runs" / "r_1").rename(folder / "earlier_attempts" / "r_1" / "1")
    assert resume(config).done_count == 4
    assert (folder / "runs" / "r_1" / "log.txt").read_text() == "attempt 1 at r_1\n"
    assert (folder / "runs" / "r_2" / "log.txt").read_text() == "attempt 2 at r_2\n"
    resume(config, redo=("r_1",))
    logs = {each.relative_to(folder).as_posix(): each.read_text() for each in folder.glob("earlier_attempts/*/*/*")}
    assert logs == {f"earlier_attempts/{run}/1/log.txt": f"attempt 1 at {run}\n" for run in ("r_1", "r_2")}


def test_the_status_after_a_kill_has_a_run_that_was_executed_once_more_as_one_to_do(write_config: Write) -> None:
    config = write_config()
    folder = config.parent / "results" / "trial"
    resume(config)
    with (folder / "journal.jsonl").open("a") as journal:
        journal.write('{"kind":"attempt_started","at":"2026-01-01T00:00:00.000Z","run":"r_2","attempt":2}\n')
    status = read_status(folder)
    assert (status.done, status.failed, status.todo) == (3, 0, 1)


@pytest.mark.parametrize("how", ["Ctrl-C", "robot-runner stop"])
def test_an_experiment_that_is_interrupted_before_it_begins_calls_nobody(write_config: Write, how: str) -> None:
    class Interrupting(SilentObserver):
        def notice(self, notice: Notice) -> None:
            if isinstance(notice, ExperimentStarted) and how == "Ctrl-C":
                signal.raise_signal(signal.SIGINT)
            elif isinstance(notice, ExperimentStarted):
                leave_request(notice.folder / ".stop")

    config = write_config(
        "def before_experiment(self): self.tell('before')\n"
        "def after_experiment(self): self.tell('after')\n"
        "def tell(self, what): Path(__file__).with_name(what).touch()"
    )
    finished = execute_experiment(prepare_or_refuse(config), Interrupting())
    assert (finished.interrupted, finished.todo_count) == (True, 4)
    assert not any(config.with_name(what).exists() for what in ("before", "after"))
    assert read_status(finished.folder).finished_at is not None
