"""Runs are added to an experiment that has begun: nothing is executed twice, and the journal alone makes it whole."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.cli.conftest import refuse_as_full
from tests.conftest import HEAD, TABLE, written_config
from tests.core.execution.conftest import execute_in

from robot_runner.cli import extension as extending
from robot_runner.cli.excluding import exclude_runs
from robot_runner.cli.extension import Extension, ExtensionRequest, extend_experiment
from robot_runner.cli.planning import plan_of
from robot_runner.core.config.preparation import prepare, prepare_or_refuse
from robot_runner.core.design.extended_design import Additions, NewFactor
from robot_runner.core.errors import DesignError, ExecutionError, RobotRunnerError, StorageError
from robot_runner.core.execution.experiment_status import read_status
from robot_runner.core.execution.notices import ExperimentFinished, SilentObserver
from robot_runner.core.execution.orchestrator import execute_experiment
from robot_runner.core.execution.resumption import Resumption, TableChoice, TableDisagreementError
from robot_runner.core.storage.executed_runs import executed_order
from robot_runner.core.storage.journal import read_journal
from robot_runner.core.storage.layout import ExperimentFolder

if TYPE_CHECKING:
    from pathlib import Path

Execute = Callable[..., Any]

#: Another attempt gives another value.
COUNTING = """
run_process = RunProcess.IN_PROCESS

def launch_mission(self, context):
    context.combination["Task"]

def populate_run_data(self, context):
    return {"Energy": 10 * context.run_number + context.attempt}
"""
HOLDING = """
import sys
from pathlib import Path
from robot_runner.core.storage.lock import ExperimentLock
with ExperimentLock(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""
SHUFFLED = TABLE.replace("repetitions=2", "repetitions=2, shuffle=True")


def changed(table: str = TABLE, **replaced: str) -> str:
    for old, new in replaced.items():
        assert old in table
        table = table.replace(old, new)
    return table


class Begun:
    """An experiment that was begun by hand."""

    def __init__(self, config: Path) -> None:
        self.config = config
        self.folder = config.parent / "results" / "trial"


def extend(executed: Any, repetitions: int | None = None, **asked: Any) -> Extension:
    treatments, factors = asked.pop("treatments", {}), asked.pop("factors", {})
    request = ExtensionRequest(added=Additions(repetitions, treatments, factors), **asked)
    preparation = prepare(executed.config, is_for_here=False)
    assert preparation.experiment is not None, preparation.findings
    return extend_experiment(preparation.experiment, request)


def resume(executed: Any, **asked: Any) -> ExperimentFinished:
    return execute_experiment(prepare_or_refuse(executed.config), SilentObserver(), resumption=Resumption(**asked))


def text_of(executed: Any, name: str = "run_table.csv") -> str:
    return str((executed.folder / name).read_text(encoding="utf-8"))


def problems(raised: pytest.ExceptionInfo[RobotRunnerError]) -> list[str]:
    return [str(finding) for finding in raised.value.findings]


@pytest.mark.long
def test_a_finished_experiment_goes_on_with_the_new_runs_alone(execute: Execute) -> None:
    executed = execute(COUNTING, table=SHUFFLED)
    before = executed.table
    extension = extend(executed, 4, treatments={"Task": ["Audio"]}, seed=7)
    assert len(extension.runs) == 8
    assert len(executed.journal("attempt_started")) == 4
    assert [row["status"] for row in executed.table] == ["Done"] * 4 + ["-"] * 8
    assert resume(executed).done_count == 12
    assert len(executed.journal("attempt_started")) == 12
    after = executed.table
    assert [{name: row[name] for name in before[0]} for row in after[:4]] == before
    assert [row["run_id"] for row in after] == [f"r_{number}" for number in range(1, 13)]
    assert [row["batch"] for row in after] == ["1"] * 4 + ["2"] * 8
    each = {(row["Task"], row["Repetition"]) for row in after}
    assert each == {(task, str(number)) for task in ("Video", "Network", "Audio") for number in range(1, 5)}
    manifest = json.loads(text_of(executed, "manifest.json"))
    first, second = manifest["design"]["batches"]
    assert (first["batch"], first["runs"], first["seed"]) == (1, 4, manifest["seed"])
    assert (second["batch"], second["runs"], second["seed"], second["first"]) == (2, 8, 7, "r_5")
    assert manifest["design"]["repetitions"] == 4
    assert manifest["design"]["factors"]["Task"] == ["Video", "Network", "Audio"]
    (batch,) = [
        each for each in json.loads(text_of(executed, "run_table.schema.json"))["fields"] if each["name"] == "batch"
    ]
    assert (batch["robot_runner:role"], batch["type"]) == ("batch", "integer")
    assert resume(executed).done_count == 12
    assert len(executed.journal("attempt_started")) == 12


@pytest.mark.long
def test_a_half_done_experiment_executes_what_is_left_of_the_first_plan_before(
    execute: Execute, tmp_path: Path
) -> None:
    config = written_config(tmp_path, COUNTING)
    execute_experiment(prepare_or_refuse(config), SilentObserver(), resumption=Resumption(only=("r_1",)))
    executed = Begun(config)
    extend(executed, 3)
    resume(executed)
    started = read_journal(executed.folder / "journal.jsonl", kinds={"attempt_started"})
    assert [record["run"] for record in started] == [f"r_{number}" for number in range(1, 7)]


lost = pytest.mark.parametrize(
    "names",
    [
        ("run_table.csv",),
        ("run_table.schema.json",),
        ("manifest.json",),
        ("run_table.csv", "run_table.schema.json", "manifest.json"),
    ],
    ids=["table", "schema", "manifest", "all"],
)


@pytest.mark.long
@lost
def test_whatever_is_deleted_the_grown_experiment_is_made_whole(execute: Execute, names: tuple[str, ...]) -> None:
    executed = execute(COUNTING, table=SHUFFLED)
    extend(executed, 3, factors={"Floor": NewFactor("carpet", ("wood",))})
    resume(executed, only=("r_5", "r_6"))
    table, design = text_of(executed), json.loads(text_of(executed, "manifest.json"))["design"]
    schema = text_of(executed, "run_table.schema.json")
    for name in names:
        (executed.folder / name).unlink()
    assert resume(executed, only=("r_5",)).done_count == 6
    assert text_of(executed) == table
    assert text_of(executed, "run_table.schema.json") == schema
    assert json.loads(text_of(executed, "manifest.json"))["design"] == design
    assert len(executed.journal("attempt_started")) == 6


@pytest.mark.long
@pytest.mark.parametrize("is_older", [True, False], ids=["restored from yesterday", "not written any more"])
def test_a_table_that_is_older_than_a_batch_gets_its_runs(execute: Execute, *, is_older: bool) -> None:
    executed = execute(COUNTING)
    kept = {name: text_of(executed, name) for name in ("run_table.csv", "run_table.schema.json", "manifest.json")}
    extend(executed, 3, factors={"Floor": NewFactor("carpet", ("wood",))})
    grown = text_of(executed)
    if is_older:
        resume(executed, only=("r_1",))
    else:  # it broke off as soon as the journal had the record
        journal = executed.folder / "journal.jsonl"
        lines = journal.read_text(encoding="utf-8").splitlines(keepends=True)
        end = next(place for place, line in enumerate(lines) if line.startswith('{"kind":"extended"'))
        journal.write_text("".join(lines[: end + 1]), encoding="utf-8")
    for name, text in kept.items():
        (executed.folder / name).write_text(text, encoding="utf-8")
    finished = resume(executed, only=("r_1",))
    assert any(
        "the run table is older than batch 2: 8 runs taken from the journal" in str(each) for each in finished.findings
    )
    assert text_of(executed) == grown
    assert [each["batch"] for each in json.loads(text_of(executed, "manifest.json"))["design"]["batches"]] == [1, 2]
    assert resume(executed).done_count == 12
    assert len(executed.journal("attempt_started")) == 12


@pytest.mark.long
def test_an_extension_that_was_killed_before_its_table_was_written_is_still_to_do(execute: Execute) -> None:
    executed = execute(COUNTING)
    kept = {name: text_of(executed, name) for name in ("run_table.csv", "run_table.schema.json", "manifest.json")}
    executed.config.write_text(executed.config.read_text().replace("repetitions=2", "repetitions=3"))
    extend(executed)
    journal = executed.folder / "journal.jsonl"
    *lines, last = journal.read_text(encoding="utf-8").splitlines(keepends=True)
    assert last.startswith('{"kind":"table_written"')
    journal.write_text("".join(lines), encoding="utf-8")
    for name, text in kept.items():
        (executed.folder / name).write_text(text, encoding="utf-8")
    for lost in ("", "run_table.csv"):
        (executed.folder / lost).unlink() if lost else None
        status = read_status(executed.folder)
        assert (status.run_count, status.done, status.todo) == (6, 4, 2), lost
        plan = plan_of(executed.config, {})
        assert plan.is_recorded, lost
        assert plan.duration.parts[0].startswith("2 runs"), lost
        assert not [each for each in plan.findings if "plans more" in each.problem], lost
    assert resume(executed).done_count == 6


@pytest.mark.long
def test_treatments_that_a_grown_experiment_has_and_its_config_lost_are_told(
    execute: Execute, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TASKS", "Video Network")
    table = TABLE.replace('["Video", "Network"]', '__import__("os").environ["TASKS"].split()')
    executed = execute(COUNTING, table=table)
    extend(executed, 3, treatments={"Task": ["Audio"]})
    monkeypatch.setenv("TASKS", "Video")
    finished = resume(executed)
    told = [str(each) for each in finished.findings if "does not plan any more" in str(each)]
    assert len(told) == 1
    assert "runs have 1 treatment of Task that the config does not plan any more: Network" in told[0]


@pytest.mark.long
def test_numbers_that_json_does_not_have_grow_as_others_do(execute: Execute) -> None:
    table = TABLE.replace('["Video", "Network"]', '[0.5, float("inf"), float("-inf")]')
    executed = execute(COUNTING, table=table)
    extend(executed, 3)
    assert resume(executed).done_count == 9
    (record,) = executed.journal("extended")
    assert record["factors"]["Task"] == [0.5, {"text": "inf"}, {"text": "-inf"}]
    assert {row["Task"] for row in executed.table} == {"0.5", "inf", "-inf"}


def test_an_extension_names_a_manifest_that_is_none_of_ours(execute: Execute) -> None:
    executed = execute(COUNTING)
    manifest = json.loads(text_of(executed, "manifest.json"))
    del manifest["design"]["source"]
    (executed.folder / "manifest.json").write_text(json.dumps(manifest), encoding="utf-8")
    with pytest.raises(ExecutionError, match="the manifest in this folder was not written by Robot Runner"):
        extend(executed, 3)


@pytest.mark.long
def test_rows_that_were_deleted_by_hand_come_back_where_the_journal_is_to_count(execute: Execute) -> None:
    executed = execute(COUNTING)
    extend(executed, 4)
    whole = text_of(executed)
    (executed.folder / "run_table.csv").write_text("".join(whole.splitlines(keepends=True)[:-1]), encoding="utf-8")
    with pytest.raises(ExecutionError, match="the table lacks this run of the plan"):
        resume(executed)
    resume(executed, table=TableChoice.JOURNAL, only=("r_1",))
    assert text_of(executed) == whole


@pytest.mark.long
def test_an_edited_batch_is_a_difference_like_any_other(execute: Execute) -> None:
    executed = execute(COUNTING)
    extend(executed, 3)
    table = text_of(executed)
    (executed.folder / "run_table.csv").write_text(table.replace("Network,3,2,", "Network,3,1,"), encoding="utf-8")
    with pytest.raises(ExecutionError) as refused:
        resume(executed)
    assert "column 'batch': the table has 1, the plan 2" in problems(refused)[0]


@pytest.mark.long
@settings(max_examples=4)
@given(
    st.lists(st.tuples(st.integers(0, 2), st.booleans(), st.booleans()), min_size=1, max_size=3),
    st.booleans(),
    st.booleans(),
)
def test_random_growths_execute_each_run_once_and_come_back_from_the_journal(
    tmp_path_factory: pytest.TempPathFactory,
    growths: list[tuple[int, bool, bool]],
    warms_up: bool,
    is_executed_between: bool,
) -> None:
    table = TABLE.replace(
        "repetitions=2", f"warm_up={int(warms_up)}, shuffle=True, exclude_combinations=[{{'Speed': 2}}]"
    )
    table = table.replace('"Network"])', '"Network"]), Factor("Speed", [1, 2])')
    executed = execute_in(tmp_path_factory.mktemp("grown"), COUNTING, table=table)
    repetitions = 1
    for number, (more, has_treatment, has_factor) in enumerate(growths):
        known = text_of(executed)
        treatments = {"Task": [f"T{number}"]} if has_treatment else {}
        factors = {f"F{number}": NewFactor("0", ("1",))} if has_factor else {}
        if not more and not treatments and not factors:
            with pytest.raises(ExecutionError, match="there is nothing to add"):
                extend(executed, treatments=treatments)
            assert text_of(executed) == known
            continue
        repetitions += more
        extend(executed, repetitions, treatments=treatments, factors=factors)
        if is_executed_between:
            resume(executed)
    resume(executed)
    started = [record["run"] for record in executed.journal("attempt_started")]
    assert len(started) == len(set(started)) == len(executed.table)
    own = [row for row in executed.table if row.get("warm_up") != "True"]
    varied = [name for name in own[0] if name in {"Task", "Speed"} or name[:1] == "F"]
    counts: dict[tuple[str, ...], int] = {}
    for row in own:
        combination = tuple(row[name] for name in varied)
        counts[combination] = counts.get(combination, 0) + 1
    assert set(counts.values()) == {repetitions}
    table = text_of(executed)
    for name in ("run_table.csv", "run_table.schema.json", "manifest.json"):
        (executed.folder / name).unlink()
    resume(executed)
    assert text_of(executed) == table


# Why 6: a config that plans more than there is.


@pytest.mark.long
def test_more_repetitions_in_the_config_are_refused_with_the_command_that_adds_them(execute: Execute) -> None:
    executed = execute(COUNTING)
    written_config(executed.config.parent, COUNTING, table=changed(TABLE, **{"repetitions=2": "repetitions=5"}))
    for asked in ({}, {"accept_changes": True}):
        with pytest.raises(ExecutionError) as refused:
            resume(executed, **asked)
        (told,) = [each for each in problems(refused) if "plans more" in each]
        assert "the config plans more than the run table has: 5 repetitions of each combination instead of 2" in told
        assert "robot-runner extend" in told
        assert str(executed.config) in told
    assert len(executed.journal("attempt_started")) == 4
    assert len(extend(executed).runs) == 6
    assert resume(executed).done_count == 10


def test_a_factor_that_was_renamed_is_not_called_one_that_an_extension_adds(execute: Execute) -> None:
    executed = execute(COUNTING)
    written_config(executed.config.parent, COUNTING, table=changed(TABLE, **{'Factor("Task"': 'Factor("Job"'}))
    with pytest.raises(ExecutionError) as refused:
        resume(executed, accept_changes=True)
    (finding,) = [each for each in refused.value.findings if "plans more" in each.problem]
    assert finding.problem.endswith(": the factor 'Job'; and it has the factor 'Task' no more")
    assert "robot-runner extend" not in finding.fix


@pytest.mark.long
def test_treatments_and_factors_of_the_config_are_named_too(execute: Execute) -> None:
    executed = execute(COUNTING)
    more = {'"Network"])': '"Network", "Audio"]), Factor("Floor", ["carpet", "wood"])'}
    written_config(executed.config.parent, COUNTING, table=changed(TABLE, **more))
    with pytest.raises(ExecutionError, match=r"has: 1 treatment of Task \(Audio\) and the factor 'Floor'"):
        resume(executed, accept_changes=True)
    with pytest.raises(DesignError, match="nothing says which treatment the runs so far had"):
        extend(executed)
    extension = extend(executed, factors={"Floor": NewFactor("carpet")})
    assert len(extension.runs) == 2 * (3 * 2 - 2)
    assert resume(executed).done_count == 12
    assert [row["Floor"] for row in executed.table[:4]] == ["carpet"] * 4


@pytest.mark.long
def test_a_design_that_has_less_as_well_is_a_warning_where_changes_are_accepted(execute: Execute) -> None:
    executed = execute(COUNTING)
    written_config(executed.config.parent, COUNTING, table=changed(TABLE, **{'"Network"': '"Audio"'}))
    finished = resume(executed, accept_changes=True)
    assert any(
        "plans more than the run table has: 1 treatment of Task (Audio)" in str(each) for each in finished.findings
    )
    assert finished.done_count == 4


def test_a_manifest_that_is_lost_does_not_hide_that_the_config_plans_more(execute: Execute) -> None:
    executed = execute(COUNTING)
    written_config(executed.config.parent, COUNTING, table=changed(TABLE, **{"repetitions=2": "repetitions=3"}))
    (executed.folder / "manifest.json").unlink()
    with pytest.raises(ExecutionError, match="3 repetitions of each combination instead of 2"):
        resume(executed, accept_changes=True)


# What an extension refuses.


def test_an_experiment_that_has_not_begun_has_nothing_to_add_to(tmp_path: Path) -> None:
    with pytest.raises(ExecutionError, match="the experiment has not begun"):
        extend(Begun(written_config(tmp_path, COUNTING)), 3)
    assert not (tmp_path / "results").exists()


@pytest.mark.long
def test_an_experiment_that_is_being_executed_is_left_alone(execute: Execute) -> None:
    executed = execute(COUNTING)
    journal = text_of(executed, "journal.jsonl")
    # In another process, as a lock keeps out other processes alone.
    command = [sys.executable, "-c", HOLDING, str(executed.folder / ".lock")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        with pytest.raises(ExecutionError, match="is being executed by process"):
            extend(executed, 3)
        holder.communicate()
    assert text_of(executed, "journal.jsonl") == journal


@pytest.mark.long
@pytest.mark.parametrize("unwritten", ["write_run_table", "write_manifest"])
def test_where_a_disk_is_full_it_is_said_that_the_runs_are_added_nevertheless(
    execute: Execute, monkeypatch: pytest.MonkeyPatch, unwritten: str
) -> None:
    executed = execute(COUNTING)
    with monkeypatch.context() as patched:
        patched.setattr(extending, unwritten, refuse_as_full)
        with pytest.raises(StorageError, match="the disk is full; the extension counts all the same"):
            extend(executed, 3)
    resume(executed)
    assert [row["status"] for row in executed.table] == ["Done"] * 6


@pytest.mark.long
def test_a_dry_run_writes_nothing(execute: Execute) -> None:
    executed = execute(COUNTING)
    before = {path: path.read_bytes() for path in executed.folder.rglob("*") if path.is_file()}
    extension = extend(executed, 3, dry_run=True, seed=5)
    assert [run.run_id for run in extension.runs] == ["r_5", "r_6"]
    assert {path: path.read_bytes() for path in executed.folder.rglob("*") if path.is_file()} == before
    assert [str(run) for run in extend(executed, 3, seed=5).runs] == [str(run) for run in extension.runs]


@pytest.mark.long
def test_a_change_beside_the_design_is_refused_until_it_is_accepted(execute: Execute) -> None:
    executed = execute(COUNTING)
    table = changed(TABLE, **{"repetitions=2": "repetitions=3"})
    written_config(executed.config.parent, COUNTING.replace("10 *", "20 *"), table=table)
    with pytest.raises(ExecutionError) as refused:
        extend(executed)
    assert [each for each in problems(refused) if "10 * context.run_number" in each]
    assert len(extend(executed, accept_changes=True).runs) == 2
    assert resume(executed).done_count == 6
    assert "20 *" in text_of(executed, "config/config.py")


@pytest.mark.long
def test_a_table_that_disagrees_with_the_journal_is_settled_before(execute: Execute) -> None:
    executed = execute(COUNTING)
    path = executed.folder / "run_table.csv"
    path.write_text(text_of(executed).replace(",11\n", ",99\n"), encoding="utf-8")
    for asked in ({}, {"accept_changes": True}):
        with pytest.raises(TableDisagreementError) as refused:
            extend(executed, 3, **asked)
        assert "--table journal (or file)" in problems(refused)[-1]
    resume(executed, table=TableChoice.FILE)
    assert len(extend(executed, 3).runs) == 2


@pytest.mark.long
def test_a_design_and_a_table_that_were_both_changed_tell_nothing(execute: Execute) -> None:
    executed = execute(COUNTING)
    written_config(executed.config.parent, COUNTING, table=changed(TABLE, **{"repetitions=2": "repetitions=3"}))
    (executed.folder / "run_table.csv").unlink()
    with pytest.raises(ExecutionError, match="nothing tells which runs were planned"):
        extend(executed)


@pytest.mark.long
def test_an_experiment_with_excluded_runs_takes_what_a_changed_config_adds(execute: Execute) -> None:
    executed = execute(COUNTING)
    exclude_runs(ExperimentFolder.found_at(executed.folder), ["r_2"], "the door was open")
    written_config(executed.config.parent, COUNTING, table=changed(**{"repetitions=2": "repetitions=3"}))
    assert [run.run_id for run in extend(executed).runs] == ["r_5", "r_6"]
    resume(executed)
    assert [row["excluded"] for row in executed.table] == ["", "the door was open", "", "", "", ""]
    assert executed.journal("deviation") == []


@pytest.mark.long
def test_a_factor_may_be_called_batch_until_there_is_one(execute: Execute) -> None:
    body = "def launch_mission(self, context): context.combination['batch']"
    executed = execute(body, table=TABLE.replace('"Task"', '"batch"'))
    assert resume(executed).done_count == 4
    with pytest.raises(DesignError, match="two columns are called 'batch'"):
        extend(executed, 3)
    assert executed.journal("extended") == []


def test_a_treatment_that_a_plugin_cannot_be_built_with_is_refused(execute: Execute) -> None:
    body = """
        class Paced(Profiler):
            def __init__(self, pace=1):
                super().__init__()
                if pace > 2:
                    raise ValueError("too fast")

        plugins = [Paced(pace=treatment("Pace"))]
    """
    head = HEAD.replace(
        "from robot_runner import *", "from robot_runner import *\nfrom robot_runner.plugins import Profiler"
    )
    table = TABLE.replace('Factor("Task", ["Video", "Network"])', 'Factor("Pace", [1, 2])').replace('"Energy"', "")
    executed = execute(body, head=head, table=table)
    with pytest.raises(ExecutionError, match="too fast"):
        extend(executed, treatments={"Pace": ["3"]})
    assert executed.journal("extended") == []


# Designs of other kinds.


@pytest.mark.long
def test_a_table_that_was_written_by_hand_gets_repetitions_of_its_combinations(tmp_path: Path) -> None:
    config = written_config(tmp_path, COUNTING)
    folder = tmp_path / "results" / "trial"
    folder.mkdir(parents=True)
    (folder / "run_table.csv").write_text("run_id,Task,Weather\na,Video,sunny\nb,Video,rain\n", encoding="utf-8")
    execute_experiment(prepare_or_refuse(config), SilentObserver())
    executed = Begun(config)
    extend(executed, 4, as_written=True)
    assert resume(executed).done_count == 4
    rows = [line.split(",") for line in text_of(executed).splitlines()]
    names = rows[0]
    shown = [
        tuple(row[names.index(name)] for name in ("run_id", "Task", "Repetition", "batch", "Weather"))
        for row in rows[1:]
    ]
    assert shown == [
        ("a", "Video", "1", "1", "sunny"),
        ("b", "Video", "2", "1", "rain"),
        ("r_3", "Video", "3", "2", ""),
        ("r_4", "Video", "4", "2", ""),
    ]
    table = text_of(executed)
    (folder / "run_table.csv").unlink()
    resume(executed)
    assert [line.rpartition(",")[0] for line in table.splitlines()] == text_of(executed).splitlines()


@pytest.mark.long
def test_the_status_tells_batches_and_warm_up_runs(execute: Execute) -> None:
    executed = execute(COUNTING, table=changed(TABLE, **{"repetitions=2": "repetitions=2, warm_up=1"}))
    extend(executed, 3)
    status = read_status(executed.folder)
    assert (status.run_count, status.warm_ups, status.warm_ups_done, status.batches) == (8, 2, 1, (4, 2))


# Warm-up runs.


@pytest.mark.long
def test_warm_up_runs_are_executed_once_kept_and_marked(execute: Execute) -> None:
    body = COUNTING + "\ndef start_run(self, context): print(context.is_warm_up, context.repetition)"
    executed = execute(body, table=changed(TABLE, **{"repetitions=2": "repetitions=2, warm_up=2"}))
    assert [(row["run_id"], row["warm_up"], row["Repetition"]) for row in executed.table] == [
        ("w_1", "True", "0"),
        ("w_2", "True", "0"),
        ("r_1", "False", "1"),
        ("r_2", "False", "1"),
        ("r_3", "False", "2"),
        ("r_4", "False", "2"),
    ]
    assert executed.log("w_1") == "True 0\n"
    assert executed.log("r_3") == "False 2\n"
    assert resume(executed).done_count == 6
    assert len(executed.journal("attempt_started")) == 6
    table = text_of(executed)
    (executed.folder / "run_table.csv").unlink()
    resume(executed)
    assert text_of(executed) == table


@pytest.mark.long
def test_a_session_warms_up_again_where_the_config_says_so(tmp_path: Path) -> None:
    table = changed(TABLE, **{"repetitions=2": "repetitions=2, warm_up=WarmUp(1, each_session=True)"})
    config = written_config(tmp_path, COUNTING, table=table)

    def executed_runs(**asked: Any) -> list[str]:
        journal = tmp_path / "results" / "trial" / "journal.jsonl"
        before = len(list(read_journal(journal, kinds={"attempt_started"})))
        execute_experiment(prepare_or_refuse(config), SilentObserver(), resumption=Resumption(**asked))
        return [record["run"] for record in read_journal(journal, kinds={"attempt_started"})][before:]

    assert executed_runs(only=("w_1", "r_1")) == ["w_1", "r_1"]
    assert executed_runs(only=("r_2",)) == ["w_1", "r_2"]
    assert executed_runs() == ["w_1", "r_3", "r_4"]
    assert executed_runs() == []
    folder = tmp_path / "results" / "trial"
    assert read_status(folder).order == ""
    assert executed_order(folder / "journal.jsonl") == ["r_1", "r_2", "r_3", "r_4"]


@pytest.mark.long
def test_warm_up_runs_stay_what_they_are_when_the_config_has_none_any_more(execute: Execute) -> None:
    executed = execute(COUNTING, table=changed(TABLE, **{"repetitions=2": "warm_up=1"}))
    written_config(executed.config.parent, COUNTING, table=changed(TABLE, **{"repetitions=2, ": ""}))
    resume(executed, accept_changes=True)
    assert [(row["run_id"], row["warm_up"]) for row in executed.table][:2] == [("w_1", "True"), ("r_1", "False")]


def test_an_experiment_whose_journal_is_missing_has_begun_all_the_same(execute: Execute) -> None:
    executed = execute("")
    (executed.folder / "journal.jsonl").unlink()
    with pytest.raises(StorageError, match=r"journal\.jsonl is missing"):
        extend_experiment(prepare_or_refuse(executed.config), ExtensionRequest(added=Additions(repetitions=3)))
    assert not (executed.folder / "journal.jsonl").exists()
