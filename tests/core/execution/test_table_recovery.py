"""The journal is the truth: what becomes of a table, a schema or a manifest that was deleted, damaged or edited."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
from tests.conftest import TABLE
from tests.core.execution.conftest import Executed

from robot_runner.core.config.preparation import prepare_or_refuse
from robot_runner.core.errors import ExecutionError, Severity
from robot_runner.core.execution.experiment_status import read_status
from robot_runner.core.execution.notices import ExperimentFinished, SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.recovered_table import Deviation, TableOnDisk
from robot_runner.core.execution.resumption import Resumption, TableChoice, TableDisagreementError
from robot_runner.core.execution.table_deviations import deviation_findings
from robot_runner.core.storage.executed_runs import ROW, changes_in_words
from robot_runner.core.storage.journal import Journal, read_journal

if TYPE_CHECKING:
    from pathlib import Path

Execute = Callable[..., Any]

#: Executed once only: an attempt more gives another value.
COUNTING = """
run_process = RunProcess.IN_PROCESS

def populate_run_data(self, context):
    return {"Energy": 10 * context.run_number + context.attempt}
"""
SHUFFLED = """\
    def create_run_table(self):
        return RunTableModel(
            [Factor("Task", ["Video", "Network", "Computation"])], repetitions=2, data_columns=["Energy"], shuffle=True
        )
"""


def resume(executed: Any, **asked: Any) -> ExperimentFinished:
    experiment = prepare_or_refuse(executed.config)
    return execute_experiment(experiment, SilentObserver(), resumption=Resumption(**asked))


def attempts(executed: Any) -> int:
    return len(executed.journal("attempt_started"))


def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def edited(executed: Any, old: str, new: str) -> None:
    path = executed.folder / "run_table.csv"
    text = text_of(path)
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


@pytest.mark.long
@pytest.mark.parametrize("content", [None, "", "\n"], ids=["deleted", "emptied", "blank"])
@pytest.mark.parametrize("table", [None, SHUFFLED], ids=["in order", "shuffled"])
def test_a_lost_run_table_is_made_whole_and_nothing_is_executed_again(
    execute: Execute, content: str | None, table: str | None
) -> None:
    executed = execute(COUNTING, **({"table": table} if table else {}))
    path = executed.folder / "run_table.csv"
    before = text_of(path)
    path.unlink() if content is None else path.write_text(content, encoding="utf-8")
    finished = resume(executed)
    assert text_of(path) == before
    assert attempts(executed) == len(executed.table)
    assert any("rebuilt from the plan and the journal" in finding.problem for finding in finished.findings)


@pytest.mark.long
@pytest.mark.parametrize("name", ["run_table.schema.json", "manifest.json"])
@pytest.mark.parametrize("content", [None, "", '{"fields": 3'], ids=["deleted", "emptied", "torn"])
def test_a_lost_schema_or_manifest_is_made_whole(execute: Execute, name: str, content: str | None) -> None:
    executed = execute(COUNTING, table=SHUFFLED)
    table, path = text_of(executed.folder / "run_table.csv"), executed.folder / name
    before = json.loads(text_of(path))
    path.unlink() if content is None else path.write_text(content, encoding="utf-8")
    resume(executed)
    after = json.loads(text_of(path))
    assert attempts(executed) == 6
    assert text_of(executed.folder / "run_table.csv") == table
    if name == "manifest.json":
        assert (after["seed"], after["design"]) == (before["seed"], before["design"])
    else:
        assert after == before


@pytest.mark.parametrize("is_there", [True, False], ids=["older", "deleted"])
def test_what_was_found_and_doubted_since_a_schema_was_written_is_taken_from_the_journal(
    execute: Execute, is_there: bool
) -> None:
    body = """
    run_process = RunProcess.IN_PROCESS
    def populate_run_data(self, context):
        if context.run_number + context.attempt < 4:
            context.doubt(f"attempt {context.attempt} was hot", measures=["Energy"])
        return {"Energy": 7.5}
    """
    executed = execute(body)
    path = executed.folder / "run_table.schema.json"
    older = json.loads(text_of(path))
    (energy,) = (each for each in older["fields"] if each["name"] == "Energy")
    assert energy["robot_runner:doubts"].keys() == {"r_1", "r_2"}
    resume(executed, redo=["r_2"])  # which is not doubtful this time
    newer = text_of(path)
    del energy["robot_runner:doubts"]["r_1"], energy["robot_runner:findings"][0]  # as before the end of r_1
    path.write_text(json.dumps(older), encoding="utf-8") if is_there else path.unlink()
    resume(executed)
    assert text_of(path) == newer


def test_a_manifest_that_is_made_anew_tells_what_was_changed_by_hand(execute: Execute) -> None:
    executed = execute(COUNTING)
    path, manifest = executed.folder / "run_table.csv", executed.folder / "manifest.json"
    edited(executed, "Video,1,11", "Video,1,7.5")
    heading, *rows = text_of(path).splitlines(keepends=True)
    path.write_text("".join([heading, *reversed(rows)]), encoding="utf-8")
    resume(executed, table=TableChoice.FILE)
    before = json.loads(text_of(manifest))
    assert before["design"]["is_reordered"]
    manifest.unlink()
    resume(executed)
    after = json.loads(text_of(manifest))
    cells = [
        [(each["run"], each["column"], each["was"], each["is"]) for each in kept["table_deviations"]]
        for kept in (before, after)
    ]
    assert cells[0] == cells[1]
    assert after["design"] == before["design"]


def test_the_end_of_an_interrupted_attempt_is_compared_with_no_row(execute: Execute) -> None:
    executed = execute(COUNTING)
    journal = executed.folder / "journal.jsonl"
    records = text_of(journal).splitlines(keepends=True)
    ends = [line.replace('"status":"done"', '"status":"interrupted"') for line in records if "attempt_finished" in line]
    written = next(line for line in records if "table_written" in line)
    journal.write_text("".join([*records, ends[0], written]), encoding="utf-8")
    edited(executed, "r_1,Done", "r_1,-")
    edited(executed, "Network,1,21", "Network,1,22")
    with pytest.raises(TableDisagreementError) as refused:
        resume(executed)
    assert [finding.where.rpartition(", run ")[2] for finding in refused.value.findings] == ["r_2, column 'Energy'"]


def test_everything_but_the_journal_may_be_lost_at_once(execute: Execute) -> None:
    executed = execute(COUNTING, table=SHUFFLED)
    before = text_of(executed.folder / "run_table.csv")
    for name in ("run_table.csv", "run_table.schema.json", "manifest.json"):
        (executed.folder / name).unlink()
    resume(executed)
    assert text_of(executed.folder / "run_table.csv") == before


def test_the_status_is_told_also_where_the_beginning_of_the_journal_was_cut_off(execute: Execute) -> None:
    executed = execute("run_process = RunProcess.IN_PROCESS")
    path = executed.folder / "journal.jsonl"
    path.write_text(text_of(path).splitlines(keepends=True)[-1], encoding="utf-8")
    assert read_status(executed.folder).done == 4


def test_an_edit_of_a_finished_run_is_refused_cell_by_cell(execute: Execute) -> None:
    executed = execute(COUNTING)
    edited(executed, "Video,1,11", "Video,1,12")
    with pytest.raises(TableDisagreementError) as refused:
        resume(executed)
    (finding,) = refused.value.findings
    assert finding.where.endswith("run r_1, column 'Energy'")
    assert finding.problem == "the table has '12', the journal '11'"
    assert "--table journal" in finding.fix
    assert "--table file" in finding.fix


def test_the_journal_may_count_and_the_file_is_kept(execute: Execute) -> None:
    executed = execute(COUNTING)
    before = text_of(executed.folder / "run_table.csv")
    edited(executed, "Video,1,11", "Video,1,12")
    finished = resume(executed, table=TableChoice.JOURNAL)
    assert text_of(executed.folder / "run_table.csv") == before
    assert "Video,1,12" in text_of(executed.folder / "earlier_tables" / "1.csv")
    assert any("earlier_tables/1.csv" in finding.fix for finding in finished.findings)


def test_the_file_may_count_and_each_change_is_recorded_once(execute: Execute) -> None:
    executed = execute(COUNTING)
    edited(executed, "Video,1,11", "Video,1,12")
    resume(executed, table=TableChoice.FILE)
    changed = {"run": "r_1", "column": "Energy", "was": "11", "is": "12"}
    (record,) = executed.journal("deviation")
    assert {name: record[name] for name in changed} == changed
    (told,) = json.loads(text_of(executed.folder / "manifest.json"))["table_deviations"]
    assert {name: told[name] for name in changed} == changed
    problems = [finding.problem for finding in read_status(executed.folder).findings]
    assert "Energy was changed by hand from '11' to '12'" in problems
    resume(executed)
    edited(executed, "Network,1,21", "Network,1,22")
    with pytest.raises(TableDisagreementError) as refused:
        resume(executed)
    assert [finding.where.rpartition(", run ")[2] for finding in refused.value.findings] == ["r_2, column 'Energy'"]
    assert executed.table[0]["Energy"] == "12"


@pytest.mark.parametrize("said", [{"accept_changes": True}, {"table": TableChoice.FILE}], ids=["changes", "the file"])
def test_the_treatment_of_a_finished_run_is_changed_on_record_alone(execute: Execute, said: dict[str, Any]) -> None:
    executed = execute(COUNTING)
    edited(executed, "Video,1,11", "Network,1,11")
    with pytest.raises(ExecutionError, match="the table has 'Network', the plan 'Video'"):
        resume(executed)
    finished = resume(executed, **said)
    changed = {"run": "r_1", "column": "Task", "was": "Video", "is": "Network"}
    (record,) = executed.journal("deviation")
    assert {name: record[name] for name in changed} == changed
    assert [finding.problem for finding in finished.findings] == ["the table has 'Network', the journal 'Video'"]
    problems = [finding.problem for finding in read_status(executed.folder).findings]
    assert "Task was changed by hand from 'Video' to 'Network'" in problems
    resume(executed)
    assert len(executed.journal("deviation")) == 1
    assert executed.table[0]["Task"] == "Network"


def test_the_quality_of_a_value_that_is_emptied_or_filled_in_by_hand_follows_it_on_record(execute: Execute) -> None:
    body = """
run_process = RunProcess.IN_PROCESS
quality_columns = True

def populate_run_data(self, context):
    if context.run_number > 2: context.doubt("it was dark", measures=["Energy"])
    return {"Energy": 10 * context.run_number if context.run_number % 2 else None}
"""
    executed = execute(body)
    edited(executed, "1,10,good", "1,,good")
    edited(executed, "1,,missing", "1,21,missing")
    edited(executed, "2,30,doubtful: it was dark", "2,,doubtful: it was dark")
    edited(executed, "2,,missing: it was dark", "2,41,missing: it was dark")
    resume(executed, table=TableChoice.FILE)
    qualities = [(row["Energy"], row["Energy.quality"]) for row in executed.table]
    assert qualities == [
        ("", "missing"),
        ("21", "good"),
        ("", "missing"),
        ("41", "good"),
    ]
    changes = [(each["column"], each["is"]) for each in executed.journal("deviation")]
    assert [is_now for column, is_now in changes if column == "Energy.quality"] == [how for _, how in qualities]
    edited(executed, "1,21,good", "1,22,good")
    resume(executed, table=TableChoice.FILE)
    assert len(executed.journal("deviation")) == len(changes) + 1


def test_the_treatment_of_a_run_still_to_do_is_changed_on_record_and_accepted_once(
    execute: Execute, write_config: Any
) -> None:
    executed = execute(COUNTING.replace("context.attempt", "context.attempt / (context.run_number < 4)"))
    write_config(COUNTING)
    assert executed.table[3]["status"] == "Failed"
    edited(executed, "Network,2,", "Video,2,")
    resume(executed, accept_changes=True)
    changed = {"run": "r_4", "column": "Task", "was": "Network", "is": "Video"}
    (record,) = executed.journal("deviation")
    assert {name: record[name] for name in changed} == changed
    for _ in range(2):
        resume(executed)
        edited(executed, "r_4,", '"r_4",')  # as another program saves it
    resume(executed)
    assert (executed.table[3]["Task"], executed.table[3]["Energy"]) == ("Video", "42")
    assert len(executed.journal("deviation")) == 1


def test_a_row_that_was_removed_and_accepted_is_on_record_once(execute: Execute) -> None:
    executed = execute(COUNTING)
    edited(executed, text_of(executed.folder / "run_table.csv").splitlines()[-1] + "\n", "")
    resume(executed, accept_changes=True)
    edited(executed, "Network,1,21", "Network,1,22")
    resume(executed, accept_changes=True)
    changes = [(each["run"], each["column"]) for each in executed.journal("deviation")]
    assert changes == [("r_4", "row"), ("r_2", "Energy")]


def test_a_factor_called_row_is_no_removed_row(execute: Execute) -> None:
    executed = execute(COUNTING, table=TABLE.replace('"Task", ["Video", "Network"]', '"row", [1, 2]'))
    path = executed.folder / "run_table.csv"
    edited(executed, ",2,1,21", ",1,1,21")
    (finding,) = resume(executed, table=TableChoice.FILE).findings
    assert (finding.where, finding.problem) == (f"{path}, run r_2, column 'row'", "the table has '1', the journal '2'")
    path.unlink()
    assert "removed" not in str(resume(executed).findings)
    edited(executed, next(line for line in text_of(path).splitlines(keepends=True) if line.startswith("r_2,")), "")
    resume(executed, table=TableChoice.FILE)
    changes = [(each["run"], each["column"], each["is"]) for each in executed.journal("deviation")]
    assert changes == [("r_2", "row", "1"), ("r_2", "row", "")]
    told = [finding.problem for finding in read_status(executed.folder).findings]
    assert told == ["row was changed by hand from '2' to '1'", "its row was removed by hand"]
    path.unlink()
    (finding,) = resume(executed).findings
    assert finding.problem.endswith("with 4 runs done; r_2 had been removed by hand")
    manifest = json.loads(text_of(executed.folder / "manifest.json"))
    assert changes_in_words(manifest).endswith(": row of r_2 from '2' to '1', the row of r_2, which was removed")


def test_a_plan_that_was_changed_is_accepted_once_and_is_no_change_of_the_table(
    execute: Execute, write_config: Any
) -> None:
    executed = execute(COUNTING)
    write_config(COUNTING, table=TABLE.replace('["Video", "Network"]', '["Network", "Video"]'))
    with pytest.raises(ExecutionError):
        resume(executed, table=TableChoice.FILE)
    resume(executed, accept_changes=True)
    resume(executed)
    assert executed.journal("deviation") == []
    write_config(COUNTING, table=TABLE.replace("repetitions=2", "repetitions=1"))
    with pytest.raises(ExecutionError):
        resume(executed)


def test_where_the_journal_counts_a_run_has_the_treatment_with_which_it_was_executed(execute: Execute) -> None:
    executed = execute(COUNTING)
    before = text_of(executed.folder / "run_table.csv")
    edited(executed, "Video,2,", "Network,1,")
    finished = resume(executed, table=TableChoice.JOURNAL)
    assert text_of(executed.folder / "run_table.csv") == before
    assert any("earlier_tables/1.csv" in finding.fix for finding in finished.findings)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("r_4,-,,,,,,,,,Network,2,", "r_4,-,,,,,,,,,Video,2,"),
        ("r_4,-,,,,,,,,,Network,2,\n", "r_4,-,,,,,,,,,Network,2,\nr_5,-,,,,,,,,,Network,3,\n"),
    ],
    ids=["another treatment", "a run more"],
)
def test_where_the_journal_counts_no_run_is_executed_otherwise_than_planned(
    write_config: Any, old: str, new: str
) -> None:
    config, first = write_config(COUNTING), Resumption(only=("r_1", "r_2"))
    executed = Executed(config, execute_experiment(prepare_or_refuse(config), SilentObserver(), resumption=first), [])
    edited(executed, old, new)
    with pytest.raises(ExecutionError, match="the plan"):
        resume(executed)
    finished = resume(executed, table=TableChoice.JOURNAL)
    assert [(row["run_id"], row["Task"]) for row in executed.table] == [
        ("r_1", "Video"),
        ("r_2", "Network"),
        ("r_3", "Video"),
        ("r_4", "Network"),
    ]
    assert any("had other runs than are planned" in finding.problem for finding in finished.findings)
    assert new in text_of(executed.folder / "earlier_tables" / "1.csv")
    assert resume(executed).done_count == 4, "it goes on without a question"


def test_a_run_that_was_added_by_hand_is_recorded_once_where_the_file_counts(write_config: Any) -> None:
    config, first = write_config(COUNTING), Resumption(only=("r_1", "r_2"))
    executed = Executed(config, execute_experiment(prepare_or_refuse(config), SilentObserver(), resumption=first), [])
    last = "r_4,-,,,,,,,,,Network,2,\n"
    edited(executed, last, f"{last}r_5,-,,,,,,,,,Network,3,\n")
    resume(executed, table=TableChoice.FILE, only=("r_3",))
    assert resume(executed).done_count == 5
    assert [(each["run"], each["column"], each["was"], each["is"]) for each in executed.journal("deviation")] == [
        ("r_5", ROW, "", "-")
    ]
    assert "its row was added by hand" in [each.problem for each in read_status(executed.folder).findings]
    told = changes_in_words(json.loads(text_of(executed.folder / "manifest.json")))
    assert told.endswith(": the row of r_5, which was added")
    edited(executed, "Video,1,11", "Video,1,12")
    resume(executed, table=TableChoice.JOURNAL)
    assert [row["Energy"] for row in executed.table] == ["11", "21", "31", "41", "51"]


def test_of_a_run_that_was_added_by_hand_and_is_lost_with_the_table_it_is_told(write_config: Any) -> None:
    config, first = write_config(COUNTING), Resumption(only=("r_1",))
    executed = Executed(config, execute_experiment(prepare_or_refuse(config), SilentObserver(), resumption=first), [])
    last = "r_4,-,,,,,,,,,Network,2,\n"
    edited(executed, last, f"{last}r_5,-,,,,,,,,,Network,3,\n")
    resume(executed, table=TableChoice.FILE, only=("r_2",))
    (executed.folder / "run_table.csv").unlink()
    problems = [finding.problem for finding in resume(executed).findings]
    assert any(each.endswith("; r_5, which had been added by hand, is lost") for each in problems)


def test_a_table_restored_from_yesterday_executes_nothing_again_unasked(execute: Execute) -> None:
    executed = execute(COUNTING)
    edited(executed, "r_3,Done", "r_3,-")
    with pytest.raises(TableDisagreementError, match="the table has '-', the journal 'Done'"):
        resume(executed)
    resume(executed, table=TableChoice.JOURNAL)
    assert attempts(executed) == 4


def test_a_measure_column_that_was_removed_comes_back_with_its_values(execute: Execute) -> None:
    executed = execute(COUNTING)
    path = executed.folder / "run_table.csv"
    before = text_of(path)
    path.write_text("\n".join(line.rpartition(",")[0] for line in before.splitlines()) + "\n", encoding="utf-8")
    with pytest.raises(TableDisagreementError, match="the table has nothing, the journal '11'"):
        resume(executed)
    resume(executed, table=TableChoice.JOURNAL)
    assert text_of(path) == before


def test_a_column_that_is_no_measure_any_more_keeps_nothing_of_an_earlier_attempt(
    execute: Execute, write_config: Any
) -> None:
    executed = execute(COUNTING)
    path = executed.folder / "run_table.csv"
    head, first, *rest = text_of(path).splitlines()
    lines = [f"{head},Notes", f"{first},slippery", *(f"{each}," for each in rest)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    write_config(COUNTING.replace("Energy", "Power"), table=TABLE.replace("Energy", "Power"))
    for run_id, energies in (("r_1", ["", "21", "31", "41"]), ("r_2", ["", "", "31", "41"])):
        resume(executed, redo=(run_id,), accept_changes=True)
        assert [row["Energy"] for row in executed.table] == energies
    assert [(row["Power"], row["Notes"]) for row in executed.table][:2] == [("12", "slippery"), ("22", "")]


def test_a_column_that_is_no_measure_any_more_has_the_values_of_runs_that_the_table_had_not_yet(
    execute: Execute, write_config: Any
) -> None:
    executed = execute(COUNTING)
    journal = executed.folder / "journal.jsonl"
    lines = text_of(journal).splitlines(keepends=True)
    journal.write_text("".join(line for line in lines if '"table_written"' not in line), encoding="utf-8")
    last = text_of(executed.folder / "run_table.csv").splitlines()[-1]
    edited(executed, last, last.replace("Done", "-").replace(",41", ","))
    write_config(COUNTING.replace("Energy", "Power"), table=TABLE.replace("Energy", "Power"))
    resume(executed, accept_changes=True)
    assert attempts(executed) == 4
    assert [(row["status"], row["Energy"]) for row in executed.table] == [
        ("Done", each) for each in ("11", "21", "31", "41")
    ]


def test_a_truncated_table_is_made_anew_where_the_journal_counts(execute: Execute) -> None:
    executed = execute(COUNTING)
    path = executed.folder / "run_table.csv"
    before = text_of(path)
    path.write_text(before[: len(before) // 2], encoding="utf-8")
    with pytest.raises(ExecutionError) as refused:
        resume(executed)
    assert any("--table journal" in finding.fix for finding in refused.value.findings)
    resume(executed, table=TableChoice.JOURNAL)
    assert text_of(path) == before
    assert attempts(executed) == 4


def test_what_a_spreadsheet_writes_in_another_way_is_no_change(execute: Execute) -> None:
    executed = execute(COUNTING)
    path = executed.folder / "run_table.csv"
    before = text_of(path)
    # As pandas does beside a missing value, and where it was told to read dates.
    other = before.replace("\n", "\r\n").replace(",11\r", ",11.0\r").replace("T", " ").replace("Z", "+00:00")
    path.write_text(other.replace(" ask", "Task"), encoding="utf-8-sig")
    finished = resume(executed)
    assert text_of(path) == before
    assert (finished.findings, executed.journal("deviation")) == ((), [])


def test_a_failed_run_that_is_done_by_hand_stays_so_also_where_a_kill_kept_the_table_from_being_written(
    execute: Execute,
) -> None:
    executed = execute(COUNTING.replace("context.attempt", "context.attempt / (context.run_number != 4)"))
    journal, table = executed.folder / "journal.jsonl", executed.folder / "run_table.csv"
    row = text_of(table).splitlines()[4]
    edited(executed, row, f"{row.replace('Failed', 'Done')}44")
    by_hand = text_of(table)
    resume(executed, table=TableChoice.FILE)
    lines = text_of(journal).splitlines(keepends=True)
    last = max(place for place, line in enumerate(lines) if "is_amended" in line)
    journal.write_text("".join(lines[: last + 1]), encoding="utf-8")
    table.write_text(by_hand, encoding="utf-8")
    assert (resume(executed).done_count, attempts(executed)) == (4, 4)
    assert text_of(table) == by_hand
    assert len(executed.journal("deviation")) == 2


def test_a_missing_text_that_another_program_wrote_as_na_is_no_change(execute: Execute) -> None:
    executed = execute(
        "run_process = RunProcess.IN_PROCESS\n"
        "def populate_run_data(self, context): return {'Energy': 'full' if context.run_number > 1 else None}"
    )
    before = text_of(executed.folder / "run_table.csv")
    edited(executed, "Video,1,\n", "Video,1,NA\n")
    resume(executed)
    assert (text_of(executed.folder / "run_table.csv"), executed.journal("deviation")) == (before, [])


@pytest.mark.parametrize("entered", ["eleven", "True"])
def test_what_is_no_number_among_numbers_is_refused_also_where_the_file_counts(execute: Execute, entered: str) -> None:
    executed = execute(COUNTING)
    edited(executed, "Video,1,11", f"Video,1,{entered}")
    with pytest.raises(ExecutionError) as refused:
        resume(executed, table=TableChoice.FILE)
    (finding,) = refused.value.findings
    assert finding.where.endswith("run_table.csv, run r_1, column 'Energy'")
    assert finding.problem == f"'{entered}' is not an integer, as the column's other values"
    assert executed.journal("deviation") == []
    edited(executed, f"Video,1,{entered}", "Video,1,NaN")
    resume(executed, table=TableChoice.FILE)
    assert executed.table[0]["Energy"] == ""


def test_where_one_cause_changed_many_cells_it_is_told_once(execute: Execute) -> None:
    executed = execute(COUNTING, table=SHUFFLED)
    path = executed.folder / "run_table.csv"
    path.write_text(text_of(path).replace("1\n", "1.0001\n"), encoding="utf-8")
    with pytest.raises(TableDisagreementError) as refused:
        resume(executed)
    (finding,) = refused.value.findings
    assert finding.where == f"{path}, column 'Energy'"
    assert finding.problem.startswith("6 runs have another value than the journal: r_1 has '11.0001' for '11', ")


def test_many_rows_that_are_gone_are_told_once(tmp_path: Path) -> None:
    gone = [Deviation(f"r_{number}", ROW, "done", "") for number in range(1, 8)]
    (finding,) = deviation_findings(tmp_path / "run_table.csv", gone, Severity.ERROR, "Choose.")
    problem = "7 runs were executed, and the table has no such runs any more: r_1, r_2, r_3 and 4 more"
    assert (finding.problem, finding.fix) == (problem, "Choose.")


@pytest.mark.long
def test_rows_that_a_user_sorts_are_executed_in_that_order_and_told(execute: Execute) -> None:
    executed = execute("def populate_run_data(self): return {'Energy': 1}", table=SHUFFLED)
    path = executed.folder / "run_table.csv"
    heading, *rows = text_of(path).splitlines()
    path.write_text("\n".join([heading, *reversed(rows)]) + "\n", encoding="utf-8")
    finished = resume(executed)
    assert any("put into another order" in finding.problem for finding in finished.findings)
    manifest = json.loads(text_of(executed.folder / "manifest.json"))
    assert manifest["design"]["is_reordered"] is True
    resume(executed)
    assert len(executed.journal("deviation")) == 1


def test_a_lost_table_that_was_written_by_hand_is_not_planned_anew(execute: Execute, write_config: Any) -> None:
    config = write_config(COUNTING)
    path = config.parent / "results" / "trial" / "run_table.csv"
    path.parent.mkdir(parents=True)
    path.write_text("Task,Repetition\nNetwork,1\nNetwork,2\n", encoding="utf-8")
    executed = execute(COUNTING)
    path.unlink()
    with pytest.raises(ExecutionError, match="the run was executed with"):
        resume(executed)
    assert attempts(executed) == 2


def test_runs_that_ended_after_the_table_was_written_are_no_disagreement(execute: Execute) -> None:
    executed = execute(COUNTING)
    journal = executed.folder / "journal.jsonl"
    lines = text_of(journal).splitlines(keepends=True)
    journal.write_text("".join(line for line in lines if '"table_written"' not in line), encoding="utf-8")
    edited(executed, "r_4,Done", "r_4,-")
    resume(executed)
    assert attempts(executed) == 4
    assert [record["kind"] for record in read_journal(journal, kinds={"deviation"})] == []


@pytest.mark.parametrize("since", ["nothing", "executed again", "begun again and killed"])
def test_cells_that_were_changed_on_record_are_in_a_table_that_is_made_anew(execute: Execute, since: str) -> None:
    executed = execute(COUNTING)
    path = executed.folder / "run_table.csv"
    edited(executed, "Video,1,11", "Video,1,7.5")
    edited(executed, "Network,1,21", "Idle,1,")
    resume(executed, accept_changes=True)
    if since == "executed again":
        resume(executed, redo=("r_1",))
    elif since == "begun again and killed":
        journal = executed.folder / "journal.jsonl"
        begun = next(line for line in text_of(journal).splitlines(keepends=True) if "attempt_started" in line)
        journal.write_text(text_of(journal) + begun, encoding="utf-8")
    before = text_of(path)
    path.unlink()
    finished = resume(executed)
    now = text_of(path)
    values = {"nothing": "7.5", "executed again": "12", "begun again and killed": "13"}
    assert f"Video,1,{values[since]}\n" in now
    assert "Idle,1,\n" in now
    assert now == before or since == "begun again and killed"
    changed = 2 + (since == "nothing")
    assert any(f"and {changed} cells as they were changed by hand" in each.problem for each in finished.findings)
    assert len(executed.journal("deviation")) == 3


def test_a_row_that_was_removed_on_record_is_in_a_table_that_is_made_anew_and_told(execute: Execute) -> None:
    executed = execute(COUNTING)
    path = executed.folder / "run_table.csv"
    lines = text_of(path).splitlines(keepends=True)
    path.write_text("".join(line for line in lines if not line.startswith("r_3,")), encoding="utf-8")
    resume(executed, accept_changes=True)
    path.unlink()
    finished = resume(executed)
    assert "r_3,Done" in text_of(path)
    assert any("r_3 had been removed by hand" in each.problem for each in finished.findings)


FAILS_AT_FIRST = "\ndef stop_run(self, context):\n    assert context.attempt > 1\n"


@pytest.mark.parametrize("table", ["newer than its record", "older than the attempt", "lost"])
@pytest.mark.parametrize("first", ["", FAILS_AT_FIRST], ids=["done", "failed"])
def test_a_run_whose_execution_once_more_was_killed_is_to_do_and_no_disagreement(
    execute: Execute, monkeypatch: pytest.MonkeyPatch, first: str, table: str
) -> None:
    executed = execute(COUNTING + first)
    path, append = executed.folder / "run_table.csv", Journal.append

    def append_or_die(journal: Journal, kind: str, **fields: Any) -> None:
        if kind == "table_written" and "r_1,Running" in text_of(path):
            os._exit(9)
        append(journal, kind, **fields)
        if kind == "attempt_started" and table == "older than the attempt":
            os._exit(9)

    pid = os.fork()
    if pid == 0:
        monkeypatch.setattr(Journal, "append", append_or_die)
        monkeypatch.setattr(TableOnDisk, "refresh", TableOnDisk.write)  # as where the last one was long ago
        resume(executed, redo=("r_1",))
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 9
    if table == "lost":
        path.unlink()
    resume(executed, skip=("r_1",))
    assert "r_1,-" in text_of(path)
    path.write_text(text_of(path) + "\n", encoding="utf-8")  # and it is compared cell by cell once more
    assert resume(executed).done_count == 4
    assert executed.journal("deviation") == []
    assert [each["attempt"] for each in executed.journal("attempt_finished") if each["run"] == "r_1"] == [1, 3]


def test_a_killed_run_whose_row_counts_as_changed_by_hand_is_not_executed_again_later(execute: Execute) -> None:
    executed = execute(COUNTING)
    journal = executed.folder / "journal.jsonl"
    begun = next(line for line in text_of(journal).splitlines(keepends=True) if "attempt_started" in line)
    journal.write_text(text_of(journal) + begun, encoding="utf-8")
    edited(executed, "Video,1,11", "Video,1,7.5")
    for asked in ({"table": TableChoice.FILE}, {}):
        assert resume(executed, **asked).done_count == 4
        assert "Video,1,7.5\n" in text_of(executed.folder / "run_table.csv")
    ends = [record for record in executed.journal("attempt_finished") if record["run"] == "r_1"]
    assert [(record["attempt"], record.get("is_amended", False)) for record in ends] == [(1, False), (1, True)]


@pytest.mark.parametrize("lines", [None, 1, "r_2"], ids=["missing", "its first line alone", "to the end of r_2"])
def test_done_runs_of_which_an_older_journal_has_no_end_are_told_and_settled(
    execute: Execute, lines: int | str | None
) -> None:
    executed = execute(COUNTING)
    table, journal = executed.folder / "run_table.csv", executed.folder / "journal.jsonl"
    before, records = text_of(table), text_of(journal).splitlines(keepends=True)
    if isinstance(lines, str):
        lines = 1 + max(place for place, line in enumerate(records) if "attempt_finished" in line and lines in line)
    unended = {"r_1", "r_2", "r_3", "r_4"} if lines is None or lines == 1 else {"r_3", "r_4"}

    def roll_back() -> None:
        journal.write_text("".join(records[:lines]), encoding="utf-8") if lines else journal.unlink()

    roll_back()
    with pytest.raises(TableDisagreementError, match=r"are done in the run table, and the journal has no end") as told:
        resume(executed)
    assert all(run in str(told.value) for run in unended)
    assert "Restore journal.jsonl" in str(told.value)
    assert [each for each in read_status(executed.folder).findings if "no end of" in each.problem]
    finished = resume(executed, table=TableChoice.FILE)
    assert (finished.done_count, text_of(table)) == (4, before)
    assert any("no end of them" in each.problem for each in finished.findings)
    assert {each["run"] for each in executed.journal("deviation")} == unended
    assert not any("no end" in each.problem for each in resume(executed).findings)  # it was accepted, and is told once


def test_done_runs_that_an_older_journal_does_not_know_can_be_executed_again(execute: Execute) -> None:
    executed = execute(COUNTING)
    (executed.folder / "journal.jsonl").unlink()
    finished = resume(executed, table=TableChoice.JOURNAL)
    assert attempts(executed) == finished.done_count == 4
    assert (executed.folder / "earlier_tables" / "1.csv").exists()


def test_runs_that_are_done_in_a_table_written_by_hand_are_no_fault(execute: Execute, write_config: Any) -> None:
    config = write_config(COUNTING)
    path = config.parent / "results" / "trial" / "run_table.csv"
    path.parent.mkdir(parents=True)
    path.write_text("Task,Repetition,status,Energy\nNetwork,1,Done,5\nNetwork,2,-,\n", encoding="utf-8")
    executed = execute(COUNTING)
    assert resume(executed).done_count == 2
    assert attempts(executed) == 1
    assert not any("no end" in each.problem for each in read_status(executed.folder).findings)
    (executed.folder / "journal.jsonl").unlink()
    with pytest.raises(TableDisagreementError, match=r"1 run is done .* \(r_2\): it is missing"):
        resume(executed)
