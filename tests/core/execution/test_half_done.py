"""What somebody finds who comes back to an experiment that is half done."""

from __future__ import annotations

import csv
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
from robot_runner.core.errors import ExecutionError
from robot_runner.core.execution.notices import AttemptFinished, Notice, SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.recovery import Resumption

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
    assert "locked anew" in finding.problem


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
