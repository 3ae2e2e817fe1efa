"""Runs that are left out: recorded with the reason, out of the statistics, and never silently."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
from tests.cli.conftest import refuse_as_full

from robot_runner.cli import excluding
from robot_runner.cli.excluding import exclude_runs, include_runs
from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.errors import ExecutionError, StorageError
from robot_runner.core.execution.experiment_status import read_status
from robot_runner.core.execution.notices import ExperimentFinished, SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.resumption import Resumption, TableChoice, TableDisagreementError
from robot_runner.core.storage.layout import ExperimentFolder
from robot_runner.core.storage.lock import ExperimentLock
from robot_runner.core.storage.table_schema import read_schema

if TYPE_CHECKING:
    from pathlib import Path

Execute = Callable[..., Any]

COUNTING = """
run_process = RunProcess.IN_PROCESS

def populate_run_data(self, context):
    return {"Energy": 10 * context.run_number + context.attempt}
"""
WHY = "the door was open, so the room cooled down"


def resume(executed: Any, **asked: Any) -> ExperimentFinished:
    return execute_experiment(prepare_or_refuse(executed.config), SilentObserver(), resumption=Resumption(**asked))


def folder_of(executed: Any) -> ExperimentFolder:
    return ExperimentFolder.found_at(executed.folder)


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


def killed(*_: object) -> None:
    raise KeyboardInterrupt


def include_second(folder: ExperimentFolder) -> tuple[str, ...]:
    return include_runs(folder, ["r_2"])


def reasons(executed: Any) -> list[str]:
    return [row["excluded"] for row in executed.table]


@pytest.mark.long
def test_the_run_and_its_reason_are_kept_in_journal_table_schema_and_status(execute: Execute) -> None:
    executed = execute(COUNTING)
    before = executed.table
    assert exclude_runs(folder_of(executed), ["r_2,r_3"], f"  {WHY}\n") == ("r_2", "r_3")
    assert reasons(executed) == ["", WHY, WHY, ""]
    assert [{name: row[name] for name in before[0]} for row in executed.table] == before
    records = executed.journal("excluded")
    assert [(each["run"], each["reason"]) for each in records] == [("r_2", WHY), ("r_3", WHY)]
    assert all(set(each) == {"kind", "at", "run", "reason"} for each in records)
    column = next(each for each in read_schema(executed.folder / "run_table.schema.json") if each.name == "excluded")
    assert (column.role.value, column.type) == ("progress", "string")
    assert read_status(executed.folder).excluded == {"r_2": WHY, "r_3": WHY}


@pytest.mark.long
@pytest.mark.parametrize("lost", ["run_table.csv", "run_table.schema.json", "manifest.json"])
def test_it_survives_a_table_a_schema_or_a_manifest_that_is_made_anew(execute: Execute, lost: str) -> None:
    executed = execute(COUNTING)
    exclude_runs(folder_of(executed), ["Task=Video"], WHY)
    table = executed.table
    (executed.folder / lost).unlink()
    finished = resume(executed)
    assert executed.table == table
    assert finished.excluded == ("r_1", "r_3")
    assert len(executed.journal("attempt_started")) == 4


@pytest.mark.long
def test_an_experiment_that_goes_on_finds_nothing_odd(execute: Execute) -> None:
    executed = execute(COUNTING)
    exclude_runs(folder_of(executed), ["r_2"], WHY)
    text = (executed.folder / "run_table.csv").read_text(encoding="utf-8")
    assert resume(executed).findings == ()
    assert (executed.folder / "run_table.csv").read_text(encoding="utf-8") == text
    assert executed.journal("deviation") == []


@pytest.mark.long
def test_what_the_journal_has_counts_where_the_table_was_not_written_any_more(
    execute: Execute, monkeypatch: pytest.MonkeyPatch
) -> None:
    executed = execute(COUNTING)
    with monkeypatch.context() as patched:
        patched.setattr(excluding, "write_run_table", killed)
        with pytest.raises(KeyboardInterrupt):
            exclude_runs(folder_of(executed), ["r_2"], WHY)
    assert "excluded" not in executed.table[0]
    resume(executed)
    assert reasons(executed) == ["", WHY, "", ""]


@pytest.mark.long
def test_an_edited_reason_is_a_deviation_like_any(execute: Execute) -> None:
    executed = execute(COUNTING)
    exclude_runs(folder_of(executed), ["r_2"], WHY)
    path = executed.folder / "run_table.csv"
    edit(path, f'"{WHY}"', "")
    with pytest.raises(TableDisagreementError) as refused:
        resume(executed)
    (finding,) = refused.value.findings
    assert finding.where.endswith("run r_2, column 'excluded'")
    assert finding.problem == f"the table has nothing, the journal {WHY!r}"
    resume(executed, table=TableChoice.JOURNAL)
    assert reasons(executed) == ["", WHY, "", ""]
    edit(path, f'"{WHY}"', "")
    finished = resume(executed, table=TableChoice.FILE)
    assert finished.excluded == ()
    (record,) = executed.journal("deviation")
    assert (record["column"], record["was"], record["is"]) == ("excluded", WHY, "")
    path.unlink()
    assert resume(executed).excluded == ()


@pytest.mark.long
def test_an_edit_that_nobody_has_judged_is_still_found_after_a_run_was_excluded(execute: Execute) -> None:
    executed = execute(COUNTING)
    edit(executed.folder / "run_table.csv", "Video,1,11", "Video,1,12")
    exclude_runs(folder_of(executed), ["r_2"], WHY)
    with pytest.raises(TableDisagreementError, match="the table has '12', the journal '11'"):
        resume(executed)


@pytest.mark.long
def test_an_excluded_run_that_is_to_do_or_failed_is_not_executed(execute: Execute) -> None:
    executed = execute(
        COUNTING + "\ndef start_run(self, context):\n    if context.run_number > 2: raise ValueError('x')"
    )
    exclude_runs(folder_of(executed), ["r_3"], WHY)
    finished = resume(executed)
    assert (finished.done_count, finished.failed, finished.todo_count) == (2, ("r_4",), 0)
    assert [each["run"] for each in executed.journal("attempt_started")] == ["r_1", "r_2", "r_3", "r_4", "r_4"]
    status = read_status(executed.folder)
    assert (status.done, status.failed, status.todo) == (2, 1, 0)


@pytest.mark.long
def test_a_run_that_is_executed_again_counts_again(execute: Execute) -> None:
    executed = execute(COUNTING)
    exclude_runs(folder_of(executed), ["r_2"], WHY)
    with pytest.raises(ExecutionError, match="the run is excluded: the door was open"):
        resume(executed, only=("r_2",))
    finished = resume(executed, redo=("r_2",))
    assert (finished.excluded, reasons(executed)) == ((), ["", "", "", ""])
    assert executed.journal("included")[0]["reason"] == "the run is executed again"
    assert executed.table[1]["Energy"] == "22"


def test_included_runs_count_again_and_the_journal_keeps_both(execute: Execute) -> None:
    executed = execute(COUNTING)
    exclude_runs(folder_of(executed), ["r_2", "r_4"], WHY)
    assert include_runs(folder_of(executed), ["r_4"], "the sensor was in another room") == ("r_4",)
    assert reasons(executed) == ["", WHY, "", ""]
    assert exclude_runs(folder_of(executed), ["r_2"], WHY) == ()
    with pytest.raises(ExecutionError, match="none of these runs is excluded"):
        include_runs(folder_of(executed), ["r_1"])


def test_everything_that_is_wrong_is_said_at_once_and_nothing_is_changed(execute: Execute) -> None:
    executed = execute(COUNTING)
    journal = executed.journal()
    with pytest.raises(ExecutionError) as refused:
        exclude_runs(folder_of(executed), ["r_22,Task=Vidoe", "Taks=Video", "Repetition=3"], " \n")
    assert [str(each) for each in refused.value.findings] == [
        "RUNS r_22: the run table has no such run → Did you mean 'r_2'?",
        "RUNS Task=Vidoe: 'Vidoe' is not a treatment of 'Task' in the run table → Did you mean 'Video'?",
        "RUNS Taks=Video: there is no factor 'Taks' → Did you mean 'Task'?",
        "RUNS Repetition=3: '3' is not a treatment of 'Repetition' in the run table → Choose one of: '1', '2'.",
        '--reason: the reason is empty → Say why, for the readers of the results: --reason "the door was open".',
    ]
    with pytest.raises(ExecutionError, match="the reason holds control characters"):
        exclude_runs(folder_of(executed), ["r_2"], "\x1b[2J")
    assert executed.journal() == journal


def test_nothing_is_corrected_while_somebody_executes_the_experiment(execute: Execute) -> None:
    executed = execute(COUNTING)
    folder = folder_of(executed)
    holder = executed.folder / "holder.py"
    with ExperimentLock(folder.lock):  # a lock of one process does not keep the same process out
        child = os.fork()
        if not child:
            try:
                exclude_runs(folder, ["r_2"], WHY)
            except ExecutionError as error:
                holder.write_text(json.dumps([error.problem, error.fix]), encoding="utf-8")
            finally:
                os._exit(0)
        os.waitpid(child, 0)
    problem, fix = json.loads(holder.read_text(encoding="utf-8"))
    assert "the experiment is being executed by process" in problem
    assert "Wait until it ends" in fix
    assert executed.journal("excluded") == []


@pytest.mark.parametrize("unwritten", ["write_run_table", "write_schema"])
def test_a_kill_between_the_files_leaves_runs_that_can_be_excluded_and_included(
    execute: Execute, monkeypatch: pytest.MonkeyPatch, unwritten: str
) -> None:
    executed = execute(COUNTING)
    with monkeypatch.context() as patched:
        patched.setattr(excluding, unwritten, killed)
        with pytest.raises(KeyboardInterrupt):
            exclude_runs(folder_of(executed), ["r_2"], WHY)
    assert exclude_runs(folder_of(executed), ["r_2"], WHY) == ()
    assert reasons(executed) == ["", WHY, "", ""]
    assert exclude_runs(folder_of(executed), ["r_3"], WHY) == ("r_3",)
    assert include_runs(folder_of(executed), ["r_2"]) == ("r_2",)
    assert reasons(executed) == ["", "", WHY, ""]


@pytest.mark.parametrize("unwritten", ["write_run_table", "write_schema"])
def test_where_a_disk_is_full_it_is_said_that_the_correction_counts_nevertheless(
    execute: Execute, monkeypatch: pytest.MonkeyPatch, unwritten: str
) -> None:
    executed = execute(COUNTING)
    with monkeypatch.context() as patched:
        patched.setattr(excluding, unwritten, refuse_as_full)
        with pytest.raises(StorageError, match="the disk is full; the correction counts all the same") as told:
            exclude_runs(folder_of(executed), ["r_2"], WHY)
    assert told.value.fix == "Make room. The next execution of the experiment brings the other files up to date."
    resume(executed)
    assert reasons(executed) == ["", WHY, "", ""]


@pytest.mark.long
@pytest.mark.parametrize("unwritten", ["write_run_table", "write_schema"])
@pytest.mark.parametrize("correct", [lambda folder: exclude_runs(folder, ["r_3"], WHY), include_second])
def test_a_second_correction_that_is_killed_is_no_edit_by_hand_and_can_be_made_again(
    execute: Execute, monkeypatch: pytest.MonkeyPatch, correct: Callable[..., Any], unwritten: str
) -> None:
    executed = execute(COUNTING)
    for is_made_again in (False, True):
        exclude_runs(folder_of(executed), ["r_2"], WHY)
        with monkeypatch.context() as patched:
            patched.setattr(excluding, unwritten, killed)
            with pytest.raises(KeyboardInterrupt):
                correct(folder_of(executed))
        correct(folder_of(executed)) if is_made_again else resume(executed)
        assert reasons(executed) == (["", "", "", ""] if correct is include_second else ["", WHY, WHY, ""])
    assert executed.journal("deviation") == []


@pytest.mark.long
@pytest.mark.parametrize("name", ["run_table.csv", "run_table.schema.json"])
def test_of_what_is_lost_it_is_said_how_it_comes_back(execute: Execute, name: str) -> None:
    executed = execute(COUNTING)
    (executed.folder / name).unlink()
    with pytest.raises(StorageError, match=f"{name} is missing") as refused:
        exclude_runs(folder_of(executed), ["r_1"], WHY)
    assert "it is rebuilt" in refused.value.fix
    resume(executed)
    assert exclude_runs(folder_of(executed), ["r_1"], WHY) == ("r_1",)


@pytest.mark.parametrize("correct", [exclude_runs, include_runs])
def test_nothing_is_corrected_where_the_journal_is_missing(execute: Execute, correct: Callable[..., Any]) -> None:
    executed = execute(COUNTING)
    (executed.folder / "journal.jsonl").unlink()
    before = (executed.folder / "run_table.csv").read_bytes()
    with pytest.raises(StorageError, match=r"journal\.jsonl is missing") as refused:
        correct(folder_of(executed), ["r_2"], WHY)
    assert "Restore it from a backup" in refused.value.fix
    assert (executed.folder / "run_table.csv").read_bytes() == before
    assert not (executed.folder / "journal.jsonl").exists(), "an empty one would look as if nothing had been executed"
